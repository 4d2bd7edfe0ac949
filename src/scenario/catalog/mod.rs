/*! The catalog of scenarios: each one turns parameters into a script and adds its own metrics.

Start with [`Scenario`] and its method `script`. Parameters are flags of the program `scenario` and keys of the YAML
files in `configs/scenarios/`, by the same names; the files contain the defaults, which are the protocols of the paper's
experiments. Each scenario has its own file here: its parameters, their effect on the script, and its metrics.
*/

/// Declares the parameters of a scenario: flags of the command line and keys of YAML files, in addition to those of every scenario.
/// Behind `=` is the range of a number and its text in errors; ranges that depend on other parameters are checked in `prepare`.
macro_rules! parameters {
    ($(#[$doc:meta])* $Name:ident {
        $($(#[$flag:meta])* $key:ident: $type:ty $(= $low:literal to $high:literal, $expected:literal)?;)*
    }) => {
        $(#[$doc])*
        #[derive(clap::Args, Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
        pub struct $Name {
            /// The parameters that every scenario has.
            #[command(flatten)]
            #[serde(flatten)]
            pub task: Task,
            $($(#[$flag])* #[arg(long)] pub $key: $type,)*
        }

        impl $Name {
            fn check_ranges(&self) -> Result<(), super::ParameterError> {
                $($(super::in_range(stringify!($key).replace('_', "-"), self.$key.into(), $low, $high, $expected)?;)?)*
                Ok(())
            }
        }
    };
}

mod ball_pit;
mod free_box;
mod lead;
mod leash;
mod outdoor;
mod pendulum;
mod pulley;
mod push;
mod rubble;
mod terrain;
mod walk;
mod wall;

use std::borrow::Cow;
use std::collections::BTreeMap;

use clap::{Args, Subcommand};
use rand::RngExt;
use rand_distr::StandardNormal;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::Script;
use super::metrics::{self, Decay, Metric};
use crate::config::{Config, ConfigError};
use crate::robot::GRAVITY_M_S2;
use crate::scenario::trace::Trace;
use crate::sim::{Conditions, Scene};
use crate::task::Command;
use crate::util::files::FileError;
use crate::util::numbers::brief;
use crate::util::random::{Purpose, stream};
use crate::util::yaml::{Text, YamlError, flat_parameters, layered, to_text};

pub use ball_pit::*;
pub use free_box::*;
pub use lead::*;
pub use leash::*;
pub use outdoor::*;
pub use pendulum::*;
pub use pulley::*;
pub use push::*;
pub use rubble::*;
pub use terrain::*;
pub use walk::*;
pub use wall::*;

/// Defines [`Scenario`] and its defaults from the list of scenarios: text of the command line, name, type of the parameters, and
/// the cost of the simulation relative to the robot alone, if it differs.
macro_rules! scenarios {
    ($($text:literal, $name:literal => $Variant:ident($Parameters:ty) $(at $cost:literal)?;)*) => {
        /// Default parameters of every scenario: name and YAML text.
        pub const DEFAULTS: &[(&str, &str)] =
            &[$(($name, include_str!(concat!("../../../configs/scenarios/", $name, ".yaml")))),*];

        /// A scenario with its parameters.
        ///
        /// ```
        /// use supple::config::Config;
        /// use supple::scenario::catalog::Scenario;
        ///
        /// let scenario = Scenario::named("push", "{push_m_s: 0.5, at_s: 1.0}")?; // the other parameters have defaults
        /// let script = scenario.script(3, &Config::load("compliant")?)?;
        /// let push = script.pushes().next().ok_or("no push")?;
        /// assert_eq!(push.linear[0].hypot(push.linear[1]), 0.5); // [m/s]
        /// assert!((1.0..1.65).contains(&push.at_s)); // the seed draws the phase of the gait
        /// # Ok::<(), Box<dyn std::error::Error>>(())
        /// ```
        #[derive(Subcommand, Debug, Clone, PartialEq, Serialize)]
        #[serde(untagged)]
        pub enum Scenario {
            $(#[doc = $text] $Variant($Parameters),)*
        }

        impl Scenario {
            /// Returns the scenario `name` with its default parameters, except those given in `parameters` as YAML.
            ///
            /// # Errors
            /// There is no such scenario (the error lists those that exist), or a parameter is unknown or has the wrong type.
            pub fn named(name: &str, parameters: &str) -> Result<Self, YamlError> {
                Ok(match name {
                    $($name => Scenario::$Variant(with_parameters(name, parameters)?),)*
                    _ => {
                        let known: Vec<&str> = DEFAULTS.iter().map(|(name, _)| *name).collect();
                        let problem = format!("no such scenario; there are: {}", known.join(", "));
                        return Err(YamlError::new(name, problem));
                    }
                })
            }

            /// Returns name, common parameters and all parameters.
            fn parts(&self) -> (&'static str, &Task, &dyn Parameters) {
                match self {
                    $(Scenario::$Variant(it) => ($name, &it.task, it),)*
                }
            }

            /// Returns the cost of a trial, in seconds of simulation of the robot alone, for progress bars.
            pub fn cost(&self) -> f64 {
                let relative = match self {
                    $(Scenario::$Variant(_) => [$($cost,)? 1.0][0],)*
                };
                relative * self.task().duration_s
            }

            fn parameters_mut(&mut self) -> &mut dyn Parameters {
                match self {
                    $(Scenario::$Variant(it) => it,)*
                }
            }
        }
    };
}

scenarios! {
    "Walk without disturbance (E0)", "walk" => Walk(Walk);
    "Push the trunk once or again and again (E1 to E4)", "push" => Push(PushTrunk);
    "Pull the trunk with a constant force (E5)", "leash" => Leash(Leash);
    "Lead the robot by a leash (E14)", "lead" => Lead(Lead);
    "Walk into a soft wall (E14)", "wall" => Wall(Wall);
    "Walk into a free box (E6)", "box" => Box(FreeBox) at 3.5;
    "Cross a field of loose balls (E7)", "ball-pit" => BallPit(BallPit) at 100.0;
    "Walk over Perlin terrain, steps or a slope (E8)", "terrain" => Terrain(UnevenGround) at 4.0;
    "Pull the trunk with a weight over a pulley (E9)", "pulley" => Pulley(Pulley) at 1.5;
    "Swing a ball on a string into the trunk (E10)", "pendulum" => Pendulum(Pendulum) at 1.5;
    "Walk over wooden blocks and soft mats (E11)", "rubble" => Rubble(Rubble) at 20.0;
    "Walk over hills of varied friction (E11)", "outdoor" => Outdoor(Outdoor) at 4.0;
}

impl Scenario {
    /// Returns the scenario's name on the command line.
    pub fn name(&self) -> &'static str {
        self.parts().0
    }

    /// Returns the parameters that every scenario has.
    pub fn task(&self) -> &Task {
        self.parts().1
    }
}

/// Returns the default parameters of a scenario.
///
/// # Errors
/// There is no scenario of this name, or its parameters have another type.
pub fn defaults<T: DeserializeOwned>(name: &str) -> Result<T, ConfigError> {
    Ok(with_parameters(name, "{}")?)
}

/// Returns the default parameters of a scenario, overridden by the given ones.
pub(super) fn with_parameters<T: DeserializeOwned>(scenario: &str, parameters: &str) -> Result<T, YamlError> {
    let defaults = DEFAULTS.iter().find(|(known, _)| *known == scenario).map_or("", |(_, text)| text);
    let texts = [Text::new(scenario, defaults), Text::new(scenario, parameters)];
    let [known, given] = [flat_parameters(&texts[0])?, flat_parameters(&texts[1])?];
    if let Some((unknown, _)) = given.iter().find(|(name, _)| known.iter().all(|(known, _)| known != name)) {
        let known: Vec<&str> = known.iter().map(|(name, _)| name.as_str()).collect();
        return Err(YamlError::new(scenario, format!("it has no parameter '{unknown}'; it has: {}", known.join(", "))));
    }
    layered(&texts).map_err(|error| {
        // serde does not name the parameters that all scenarios have, as they are flattened. So each is tried alone to find the invalid
        // one.
        let fits = |name: &str| {
            let alone = texts[1].parse().map(|given| to_text(&BTreeMap::from([(name, &given[name])])));
            alone.is_ok_and(|alone| layered::<T>(&[texts[0].clone(), Text::new(scenario, &alone)]).is_ok())
        };
        match given.iter().find(|(name, _)| !fits(name)) {
            Some((name, _)) if !error.message.starts_with(name.as_str()) => {
                YamlError { message: format!("{name}: {}", error.message), ..error }
            }
            _ => error,
        }
    })
}

/// Time still played after a fall \[s\].
const AFTER_FALL_S: f64 = 1.0;

/// The error of a parameter outside its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("--{name} is {found}, expected {expected}")]
pub struct ParameterError {
    /// Name of the flag, such as `push-m-s`.
    pub name: Cow<'static, str>,
    /// The value that was found.
    pub found: String,
    /// The valid range.
    pub expected: &'static str,
}

/// Error while building a script.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ScriptError {
    /// A parameter is out of range.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// The robot cannot be loaded.
    #[error(transparent)]
    Robot(#[from] FileError),
    /// The default parameters of a scenario are invalid.
    #[error(transparent)]
    Defaults(#[from] YamlError),
}

/// The parameters that every scenario has.
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
    /// Length of the playback (s)
    #[arg(long)]
    pub duration_s: f64,
    /// Standard deviation of the encoder bias, drawn from the seed (rad)
    #[arg(long)]
    pub encoder_bias_sd_rad: f64,
    /// Commanded compliance: velocity per newton of sustained pull (m/s/N) [default: the policy's own]
    #[arg(long)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub compliance: Option<f64>,
    /// Mass added to the trunk but not to the robot's description; negative: taken away (kg)
    #[arg(long)]
    #[serde(default, skip_serializing_if = "is_zero")]
    pub extra_mass_kg: f64,
    /// Rolling friction of the ground, except in `outdoor` (m) [default: 0, contacts that do not resist rolling]
    #[arg(long)]
    #[serde(default, skip_serializing_if = "is_zero")]
    pub rolling_m: f64,
}

#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// Behaviour of a scenario's parameters; the defaults are an undisturbed walk on a plane.
trait Parameters {
    /// Checks the parameters and adds the scenario's parts to the script.
    fn prepare(&self, script: &mut Script, seed: u64) -> Result<(), ParameterError>;

    /// Adds the metrics of this scenario to the common ones.
    fn metrics(&self, _: &Script, _: &Trace, _found: &mut Vec<Metric>) {}

    /// Delays the disturbance \[s\]; does nothing if there is none.
    fn delay(&mut self, _phase_s: f64) {}
}

impl Scenario {
    /// Returns the scenario with its disturbance delayed \[s\], to meet the gait at another phase.
    pub fn later(&self, phase_s: f64) -> Self {
        let mut scenario = self.clone();
        scenario.parameters_mut().delay(phase_s);
        scenario
    }

    /// Builds the script for a seed, with the robot and rates of a policy's configuration.
    ///
    /// # Errors
    /// A parameter is out of range, or the robot cannot be loaded.
    pub fn script(&self, seed: u64, config: &Config) -> Result<Script, ScriptError> {
        let task = self.task();
        in_range("forward-m-s", task.forward_m_s, -5.0, 5.0, "-5 to 5 m/s")?;
        in_range("left-m-s", task.left_m_s, -5.0, 5.0, "-5 to 5 m/s")?;
        in_range("yaw-rad-s", task.yaw_rad_s, -10.0, 10.0, "-10 to 10 rad/s")?;
        in_range("duration-s", task.duration_s, 0.1, 3600.0, "0.1 to 3600 s")?;
        in_range("encoder-bias-sd-rad", task.encoder_bias_sd_rad, 0.0, 1.0, "0 to 1 rad")?;
        in_range("extra-mass-kg", task.extra_mass_kg, -2.0, 10.0, "-2 to 10 kg")?;
        in_range("rolling-m", task.rolling_m, 0.0, 0.1, "0 to 0.1 m")?;
        let mut rng = stream(seed, Purpose::Offsets, 0, 0);
        let mut script = Script {
            scene: Scene {
                extra_mass_kg: task.extra_mass_kg,
                rolling_m: task.rolling_m,
                ..Scene::flat(config.robot.load()?, config.simulation.timestep_s())
            },
            conditions: Conditions {
                gravity: [0.0, 0.0, -GRAVITY_M_S2],
                friction: config.randomisation.default_friction,
                encoder_bias: std::array::from_fn(|_| task.encoder_bias_sd_rad * rng.sample::<f64, _>(StandardNormal)),
            },
            command: Command {
                compliance: task.compliance,
                ..Command::velocity(task.forward_m_s, task.left_m_s, task.yaw_rad_s)
            },
            duration_s: task.duration_s,
            after_fall_s: AFTER_FALL_S,
            set_point_per_s: 0.0,
            disturbances: Vec::new(),
            goal: None,
        };
        self.parts().2.prepare(&mut script, seed)?;
        Ok(script)
    }

    /// Computes the metrics of a trace over the time before a fall.
    pub fn metrics(&self, script: &Script, trace: &Trace) -> Vec<Metric> {
        let last_s = |trace: &Trace| trace.frames.last().map_or(0.0, |frame| frame.time_s);
        let fall = trace.fall().map(|fall| fall.time_s);
        let fell = fall.map(|_| true).or(trace.fault().is_none().then_some(false));
        let mut found = vec![
            metric("duration_s", "simulated", Some(last_s(trace)), "s"),
            truth("fell", "fell", fell),
            metric("fall_time_s", "fell after", fall, "s").because(metrics::NO_FALL),
        ];
        let upright = trace.on_its_feet();
        let trace = upright.as_ref();
        let end_s = last_s(trace);
        let settled_s = metrics::SETTLE_S.min(0.5 * end_s);
        let errors = metrics::velocity_errors(trace, settled_s, end_s);
        let error = |axis: usize| errors.map(|errors| errors[axis]);
        let all = metrics::window(trace, settled_s, end_s);
        let flight = metrics::flight_fraction(trace, settled_s, end_s);
        let transport = metrics::cost_of_transport(trace, settled_s, end_s);
        let swing = metrics::swing_height(trace, settled_s, end_s);
        // Where there are no frames, there is another reason.
        let seen = |metric: Metric, reason| if flight.is_some() { metric.because(reason) } else { metric };
        found.extend([
            metric("window_s", "averages are over", Some(end_s - settled_s), "s"),
            metric("forward_error_m_s", "forward velocity error", error(0), "m/s"),
            metric("left_error_m_s", "sideways velocity error", error(1), "m/s"),
            metric("yaw_error_rad_s", "yaw rate error", error(2), "rad/s"),
            metric("power_w", "mechanical power", metrics::mean(all.clone(), |f| f.power_w), "W"),
            metric("torque_n_m", "torque norm", metrics::mean(all.clone(), |f| f.torque_n_m), "N m"),
            seen(metric("cost_of_transport", "cost of transport", transport, ""), "it stands"),
            metric("stride_frequency_hz", "stride frequency", metrics::stride_frequency(trace, settled_s, end_s), "Hz"),
            metric("flight_percent", "in flight", flight.map(|fraction| 100.0 * fraction), "%"),
            seen(metric("swing_height_m", "swing height", swing, "m"), "no foot was lifted and put down"),
            // The first step from rest is harder than those of a walk.
            metric("peak_foot_force_n", "peak foot force", metrics::largest(all, |f| f.peak_foot_force_n), "N"),
            metric("distance_m", "distance ahead", trace.frames.last().map(|frame| frame.position[0]), "m"),
        ]);
        self.parts().2.metrics(script, trace, &mut found);
        let reason = if trace.fault().is_some() {
            "the simulation stopped"
        } else if fall.is_some() {
            "it fell"
        } else {
            "the rollout is too short"
        };
        found.into_iter().map(|metric| metric.because(reason)).collect()
    }
}

fn metric(name: &'static str, label: &'static str, value: Option<f64>, unit: &'static str) -> Metric {
    Metric::new(name, label, value, unit)
}

/// Creates the metric of a disturbance's duration; it has a value if the disturbance is over by the end.
fn lasting(name: &'static str, label: &'static str, decay: Option<Decay>) -> Metric {
    let found = metric(name, label, decay.and_then(Decay::ended_s), "s");
    if decay.is_some() { found.because("it goes on to the end") } else { found }
}

fn truth(name: &'static str, label: &'static str, value: Option<bool>) -> Metric {
    metric(name, label, value.map(|truth| f64::from(u8::from(truth))), metrics::TRUTH)
}

/// Converts an angle from forward, counter-clockwise, to a unit vector (forward, left).
fn towards(direction_deg: f64) -> [f64; 2] {
    let angle = direction_deg.to_radians();
    [angle.cos(), angle.sin()]
}

/// Refuses a commanded yaw rate, because loads on ropes are aimed along a straight walk.
fn no_turn(task: &Task) -> Result<(), ParameterError> {
    in_range("yaw-rad-s", task.yaw_rad_s, 0.0, 0.0, "0: the load is aimed along a straight walk")
}

/// Checks that a parameter is within its range.
///
/// # Errors
/// The number is out of range or not finite; the error names the parameter, the number and the range.
pub fn in_range(
    name: impl Into<Cow<'static, str>>,
    found: f64,
    low: f64,
    high: f64,
    expected: &'static str,
) -> Result<(), ParameterError> {
    let fits = (low..=high).contains(&found);
    if fits { Ok(()) } else { Err(ParameterError { name: name.into(), found: brief(found), expected }) }
}
