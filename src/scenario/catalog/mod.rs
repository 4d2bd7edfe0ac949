/*! The scenarios: parameters in, script out, and which numbers each is about.

Parameters are flags of the `scenario` program and keys of the YAML files under `configs/scenarios/`, by the same names;
the files hold the defaults, which are the protocols of the paper's experiments. Each scenario is a file of its own here:
its parameters, what they make of the script, and the numbers it is about.
*/

mod ball_pit;
mod free_box;
mod leash;
mod outdoor;
mod pendulum;
mod pulley;
mod push;
mod rubble;
mod terrain;
mod walk;

use clap::{Args, Subcommand};
use rand::RngExt;
use rand_distr::StandardNormal;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::Script;
use super::metrics::{self, Metric};
use crate::config::{Config, ConfigError, layered};
use crate::random::{Purpose, stream};
use crate::scene::{RobotFile, Scene};
use crate::sim::Conditions;
use crate::task::Command;
use crate::task::episode::GRAVITY;
use crate::trace::Trace;

pub use ball_pit::BallPit;
pub use free_box::FreeBox;
pub use leash::Leash;
pub use outdoor::Outdoor;
pub use pendulum::{Impact, Pendulum};
pub use pulley::Pulley;
pub use push::PushAway;
pub use rubble::Rubble;
pub use terrain::{Terrain, TerrainKind};
pub use walk::Walk;

/// Default parameters, one file for each scenario.
pub const DEFAULTS: &[(&str, &str)] = &[
    ("walk", include_str!("../../../configs/scenarios/walk.yaml")),
    ("push", include_str!("../../../configs/scenarios/push.yaml")),
    ("leash", include_str!("../../../configs/scenarios/leash.yaml")),
    ("box", include_str!("../../../configs/scenarios/box.yaml")),
    ("ball-pit", include_str!("../../../configs/scenarios/ball-pit.yaml")),
    ("terrain", include_str!("../../../configs/scenarios/terrain.yaml")),
    ("pulley", include_str!("../../../configs/scenarios/pulley.yaml")),
    ("pendulum", include_str!("../../../configs/scenarios/pendulum.yaml")),
    ("rubble", include_str!("../../../configs/scenarios/rubble.yaml")),
    ("outdoor", include_str!("../../../configs/scenarios/outdoor.yaml")),
];

/// The default parameters of a scenario.
///
/// # Errors
/// [`ConfigError`] if there is no scenario of this name, or its parameters are of another type.
pub fn defaults<T: DeserializeOwned>(name: &str) -> Result<T, ConfigError> {
    let text = DEFAULTS.iter().find(|(known, _)| *known == name).map_or("", |(_, text)| text);
    layered(name, &[text])
}

/// Length still shown after a fall \[s\].
const AFTER_FALL_S: f64 = 1.0;

/// A parameter outside its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("--{name} is {found}, expected {expected}")]
pub struct ParameterError {
    /// The flag's name.
    pub name: &'static str,
    /// What was found.
    pub found: String,
    /// What would be valid.
    pub expected: &'static str,
}

/// What every scenario asks of the policy.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Task {
    /// Commanded forward velocity (m/s)
    #[arg(long)]
    pub forward_m_s: f64,
    /// Commanded velocity to the left (m/s)
    #[arg(long)]
    pub left_m_s: f64,
    /// Commanded yaw rate, counter-clockwise (rad/s)
    #[arg(long)]
    pub yaw_rad_s: f64,
    /// Length of the rollout (s)
    #[arg(long)]
    pub duration_s: f64,
    /// What the encoders are off by, as a standard deviation; drawn from the seed (rad)
    #[arg(long)]
    pub joint_offset_sd_rad: f64,
}

/// What a scenario's parameters do.
trait Parameters {
    /// What is asked of the policy.
    fn task(&self) -> &Task;

    /// Checks the parameters and puts into the script what the scenario adds to an undisturbed walk on a plane.
    fn prepare(&self, _: &mut Script, _seed: u64) -> Result<(), ParameterError> {
        Ok(())
    }

    /// Adds the numbers that the scenario is about to those that all have.
    fn metrics(&self, _: &Script, _: &Trace, _found: &mut Vec<Metric>) {}
}

/// All scenarios.
#[derive(Subcommand, Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Scenario {
    /// Walk without disturbance (E0)
    Walk(Walk),
    /// Push the trunk once or again and again (E1 to E4)
    Push(PushAway),
    /// Pull the trunk with a constant force (E5)
    Leash(Leash),
    /// Walk into a free box (E6)
    Box(FreeBox),
    /// Cross a field of loose balls (E7)
    BallPit(BallPit),
    /// Walk over Perlin terrain, steps or a slope (E8)
    Terrain(Terrain),
    /// Pull the trunk with a weight over a pulley (E9)
    Pulley(Pulley),
    /// Swing a ball on a string into the trunk (E10)
    Pendulum(Pendulum),
    /// Walk over wooden blocks and soft mats (E11)
    Rubble(Rubble),
    /// Walk over hills of varied friction (E11)
    Outdoor(Outdoor),
}

impl Scenario {
    /// Its name on the command line.
    pub fn name(&self) -> &'static str {
        match self {
            Scenario::Walk(_) => "walk",
            Scenario::Push(_) => "push",
            Scenario::Leash(_) => "leash",
            Scenario::Box(_) => "box",
            Scenario::BallPit(_) => "ball-pit",
            Scenario::Terrain(_) => "terrain",
            Scenario::Pulley(_) => "pulley",
            Scenario::Pendulum(_) => "pendulum",
            Scenario::Rubble(_) => "rubble",
            Scenario::Outdoor(_) => "outdoor",
        }
    }

    fn parameters(&self) -> &dyn Parameters {
        match self {
            Scenario::Walk(walk) => walk,
            Scenario::Push(push) => push,
            Scenario::Leash(leash) => leash,
            Scenario::Box(free_box) => free_box,
            Scenario::BallPit(pit) => pit,
            Scenario::Terrain(terrain) => terrain,
            Scenario::Pulley(pulley) => pulley,
            Scenario::Pendulum(pendulum) => pendulum,
            Scenario::Rubble(rubble) => rubble,
            Scenario::Outdoor(outdoor) => outdoor,
        }
    }

    /// Its task.
    pub fn task(&self) -> &Task {
        self.parameters().task()
    }

    /// The script for a seed, for the robot and rates of a policy's configuration.
    ///
    /// # Errors
    /// [`ParameterError`] that names the flag.
    pub fn script(&self, seed: u64, config: &Config) -> Result<Script, ParameterError> {
        let task = self.task();
        in_range("forward-m-s", task.forward_m_s, -5.0, 5.0, "-5 to 5 m/s")?;
        in_range("left-m-s", task.left_m_s, -5.0, 5.0, "-5 to 5 m/s")?;
        in_range("yaw-rad-s", task.yaw_rad_s, -10.0, 10.0, "-10 to 10 rad/s")?;
        in_range("duration-s", task.duration_s, 0.1, 3600.0, "0.1 to 3600 s")?;
        in_range("joint-offset-sd-rad", task.joint_offset_sd_rad, 0.0, 1.0, "0 to 1 rad")?;
        let mut rng = stream(seed, Purpose::Offsets, 0, 0);
        let mut script = Script {
            scene: Scene::flat(RobotFile::from_name(&config.robot.model), config.simulation.timestep_s()),
            conditions: Conditions {
                gravity: [0.0, 0.0, -GRAVITY],
                friction: config.randomisation.default_friction,
                joint_offsets: std::array::from_fn(|_| task.joint_offset_sd_rad * rng.sample::<f64, _>(StandardNormal)),
            },
            command: Command { forward: task.forward_m_s, left: task.left_m_s, yaw: task.yaw_rad_s },
            duration_s: task.duration_s,
            after_fall_s: AFTER_FALL_S,
            pushes: Vec::new(),
            pull: None,
            rig: None,
            goal: None,
        };
        self.parameters().prepare(&mut script, seed)?;
        Ok(script)
    }

    /// The numbers this scenario is about.
    pub fn metrics(&self, script: &Script, trace: &Trace) -> Vec<Metric> {
        let end_s = trace.frames.last().map_or(0.0, |frame| frame.time_s);
        let settled_s = metrics::SETTLE_S.min(0.5 * end_s);
        let mut found = vec![
            metric("duration_s", "simulated", Some(end_s), "s"),
            truth("fell", "fell", trace.fall().map(|_| true).or(trace.fault().is_none().then_some(false))),
            metric("fall_time_s", "fell after", trace.fall().map(|fall| fall.time_s), "s"),
        ];
        let errors = metrics::velocity_errors(trace, settled_s, end_s);
        for (index, (name, label, unit)) in [
            ("forward_error_m_s", "forward velocity error", "m/s"),
            ("left_error_m_s", "sideways velocity error", "m/s"),
            ("yaw_error_rad_s", "yaw rate error", "rad/s"),
        ]
        .into_iter()
        .enumerate()
        {
            found.push(metric(name, label, errors.map(|errors| errors[index]), unit));
        }
        let all = metrics::window(trace, settled_s, end_s);
        found.push(metric("power_w", "mechanical power", metrics::mean(all.clone(), |f| f.power_w), "W"));
        found.push(metric("torque_n_m", "torque norm", metrics::mean(all.clone(), |f| f.torque_n_m), "N m"));
        let transport = metrics::cost_of_transport(trace, settled_s, end_s);
        found.push(metric("cost_of_transport", "cost of transport", transport, ""));
        let strides = metrics::stride_frequency(trace, settled_s, end_s);
        found.push(metric("stride_frequency_hz", "stride frequency", strides, "Hz"));
        let flight = metrics::flight_share(trace, settled_s, end_s);
        found.push(metric("flight_percent", "in flight", flight.map(|share| 100.0 * share), "%"));
        let swing = metrics::swing_height(trace, settled_s, end_s);
        found.push(metric("swing_height_m", "swing height", swing, "m"));
        // The first step from rest is harder than those of a walk.
        let peak = metrics::largest(all, |frame| frame.peak_foot_force_n);
        found.push(metric("peak_foot_force_n", "peak foot force", peak, "N"));
        let distance = trace.frames.last().map(|frame| frame.position[0]);
        found.push(metric("distance_m", "distance ahead", distance, "m"));

        self.parameters().metrics(script, trace, &mut found);
        found
    }
}

fn metric(name: &'static str, label: &'static str, value: Option<f64>, unit: &'static str) -> Metric {
    Metric { name, label, value, unit }
}

fn truth(name: &'static str, label: &'static str, value: Option<bool>) -> Metric {
    Metric { name, label, value: value.map(|truth| f64::from(u8::from(truth))), unit: metrics::TRUTH }
}

/// Loads on ropes are aimed at where a straight walk leads.
fn no_turn(task: &Task) -> Result<(), ParameterError> {
    in_range("yaw-rad-s", task.yaw_rad_s, 0.0, 0.0, "0: the load is aimed at where a straight walk leads")
}

fn in_range(name: &'static str, found: f64, low: f64, high: f64, expected: &'static str) -> Result<(), ParameterError> {
    if (low..=high).contains(&found) {
        Ok(())
    } else {
        Err(ParameterError { name, found: found.to_string(), expected })
    }
}
