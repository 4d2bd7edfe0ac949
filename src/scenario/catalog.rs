/*! The scenarios: parameters in, script out, and which numbers each is about.

Parameters are flags of the `scenario` program and keys of the YAML files under `configs/scenarios/`, by the same names;
the files hold the defaults, which are the protocols of the paper's experiments.
*/

use std::fmt::Write as _;

use clap::{Args, Subcommand, ValueEnum};
use rand::RngExt;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::metrics::{self, Metric, STRIDE_S};
use super::{Pull, Script, TimedPush, terrain};
use crate::config::{Config, ConfigError, layered};
use crate::go1::JOINT_COUNT;
use crate::random::{Purpose, stream};
use crate::scene::{Buffers, Ground, RobotFile, Scene};
use crate::sim::{Conditions, Push};
use crate::task::Command;
use crate::task::episode::GRAVITY;
use crate::trace::Trace;

/// Default parameters, one file for each scenario.
pub const DEFAULTS: &[(&str, &str)] = &[
    ("walk", include_str!("../../configs/scenarios/walk.yaml")),
    ("push", include_str!("../../configs/scenarios/push.yaml")),
    ("leash", include_str!("../../configs/scenarios/leash.yaml")),
    ("box", include_str!("../../configs/scenarios/box.yaml")),
    ("ball-pit", include_str!("../../configs/scenarios/ball-pit.yaml")),
    ("terrain", include_str!("../../configs/scenarios/terrain.yaml")),
];

/// The default parameters of a scenario.
///
/// # Errors
/// [`ConfigError`] if there is no scenario of this name, or its parameters are of another type.
pub fn defaults<T: DeserializeOwned>(name: &str) -> Result<T, ConfigError> {
    let text = DEFAULTS.iter().find(|(known, _)| *known == name).map_or("", |(_, text)| text);
    layered(name, &[text])
}

/// Half-length of height fields along x and y \[m\].
const FIELD_HALF_SIZE_M: [f64; 2] = [8.0, 4.0];

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
}

/// Walk without disturbance.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Walk {
    #[command(flatten)]
    #[serde(flatten)]
    #[allow(missing_docs)]
    pub task: Task,
}

/// Push: a sudden change of the trunk's velocity.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PushAway {
    #[command(flatten)]
    #[serde(flatten)]
    #[allow(missing_docs)]
    pub task: Task,
    /// Size of the velocity change (m/s)
    #[arg(long)]
    pub push_m_s: f64,
    /// Direction of the push: 0 forward, 90 left (deg)
    #[arg(long)]
    pub direction_deg: f64,
    /// Time of the push; up to one stride (0.4 s) later, as the seed has it (s)
    #[arg(long)]
    pub at_s: f64,
    /// Push again at this interval; 0 pushes once (s)
    #[arg(long)]
    pub every_s: f64,
}

/// Leash: a constant pull on the trunk.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Leash {
    #[command(flatten)]
    #[serde(flatten)]
    #[allow(missing_docs)]
    pub task: Task,
    /// Pulling force (N)
    #[arg(long)]
    pub force_n: f64,
    /// Direction of the pull in the world: 0 ahead, 90 left (deg)
    #[arg(long)]
    pub direction_deg: f64,
    /// When the pull begins (s)
    #[arg(long)]
    pub at_s: f64,
    /// How long it lasts (s)
    #[arg(long)]
    pub for_s: f64,
}

/// Box: walk into a free box.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FreeBox {
    #[command(flatten)]
    #[serde(flatten)]
    #[allow(missing_docs)]
    pub task: Task,
    /// Mass of the box (kg)
    #[arg(long)]
    pub mass_kg: f64,
    /// Edge length of the box (m)
    #[arg(long)]
    pub size_m: f64,
    /// From the robot's centre to the box's near face (m)
    #[arg(long)]
    pub distance_m: f64,
    /// Sliding friction of the box on the ground
    #[arg(long)]
    pub friction: f64,
    /// Largest sideways offset of the box, drawn from the seed (m)
    #[arg(long)]
    pub max_offset_m: f64,
}

/// Ball pit: cross a field of loose balls.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BallPit {
    #[command(flatten)]
    #[serde(flatten)]
    #[allow(missing_docs)]
    pub task: Task,
    /// Number of balls, laid out in a square
    #[arg(long)]
    pub balls: u32,
    /// Mass of a ball (kg)
    #[arg(long)]
    pub mass_kg: f64,
    /// Radius of a ball (m)
    #[arg(long)]
    pub radius_m: f64,
    /// Gap between neighbours (m)
    #[arg(long)]
    pub gap_m: f64,
    /// From the robot's centre to the first row (m)
    #[arg(long)]
    pub distance_m: f64,
}

/// Kind of terrain.
#[derive(ValueEnum, Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TerrainKind {
    /// Gradient noise.
    Perlin,
    /// Up and down again.
    Steps,
    /// An incline that begins 1 m ahead.
    Slope,
}

/// Terrain: uneven ground.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Terrain {
    #[command(flatten)]
    #[serde(flatten)]
    #[allow(missing_docs)]
    pub task: Task,
    /// Shape of the ground
    #[arg(long, value_enum)]
    pub kind: TerrainKind,
    /// Perlin: peak to peak; steps: rise of each (m)
    #[arg(long)]
    pub height_m: f64,
    /// Perlin: lattice cells per metre (1/m)
    #[arg(long)]
    pub frequency_per_m: f64,
    /// Steps: length of each (m)
    #[arg(long)]
    pub step_length_m: f64,
    /// Steps: number up, and as many down
    #[arg(long)]
    pub steps: u32,
    /// Slope: rise over run
    #[arg(long)]
    pub incline: f64,
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
        }
    }

    /// Its task.
    pub fn task(&self) -> &Task {
        match self {
            Scenario::Walk(walk) => &walk.task,
            Scenario::Push(push) => &push.task,
            Scenario::Leash(leash) => &leash.task,
            Scenario::Box(free_box) => &free_box.task,
            Scenario::BallPit(pit) => &pit.task,
            Scenario::Terrain(terrain) => &terrain.task,
        }
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
        let mut script = Script {
            scene: Scene::flat(RobotFile::from_name(&config.robot.model), config.simulation.timestep_s()),
            conditions: Conditions {
                gravity: [0.0, 0.0, -GRAVITY],
                friction: config.randomisation.default_friction,
                joint_offsets: [0.0; JOINT_COUNT],
            },
            command: Command { forward: task.forward_m_s, left: task.left_m_s, yaw: task.yaw_rad_s },
            duration_s: task.duration_s,
            after_fall_s: AFTER_FALL_S,
            pushes: Vec::new(),
            pull: None,
        };
        match self {
            Scenario::Walk(_) => {}
            Scenario::Push(push) => push.prepare(&mut script, seed)?,
            Scenario::Leash(leash) => leash.prepare(&mut script)?,
            Scenario::Box(free_box) => free_box.prepare(&mut script, seed)?,
            Scenario::BallPit(pit) => pit.prepare(&mut script)?,
            Scenario::Terrain(terrain) => terrain.prepare(&mut script, seed)?,
        }
        Ok(script)
    }

    /// The numbers this scenario is about.
    pub fn metrics(&self, script: &Script, trace: &Trace) -> Vec<Metric> {
        let end_s = trace.frames.last().map_or(0.0, |frame| frame.time_s);
        let settled_s = 2.0_f64.min(0.5 * end_s);
        let mut found = vec![
            metric("duration_s", "simulated", Some(end_s), "s"),
            metric("fell", "fell", Some(f64::from(u8::from(trace.fall().is_some()))), ""),
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
        found.push(metric("torque_n_m", "torque norm", metrics::mean(all, |f| f.torque_n_m), "N m"));
        let transport = metrics::cost_of_transport(trace, settled_s, end_s);
        found.push(metric("cost_of_transport", "cost of transport", transport, ""));
        let strides = metrics::stride_frequency(trace, settled_s, end_s);
        found.push(metric("stride_frequency_hz", "stride frequency", strides, "Hz"));
        let swing = metrics::swing_height(trace, settled_s, end_s);
        found.push(metric("swing_height_m", "swing height", swing, "m"));
        let whole = || metrics::window(trace, 0.0, end_s);
        let peak = metrics::largest(whole(), |frame| frame.peak_foot_force_n);
        found.push(metric("peak_foot_force_n", "peak foot force", peak, "N"));
        let distance = trace.frames.last().map(|frame| frame.position[0]);
        found.push(metric("distance_m", "distance ahead", distance, "m"));

        match self {
            Scenario::Push(_) => push_metrics(script, trace, &mut found),
            Scenario::Leash(_) => leash_metrics(script, trace, &mut found),
            Scenario::Box(free_box) => free_box.metrics(trace, &mut found),
            Scenario::BallPit(pit) => {
                let crossed = distance.is_some_and(|x| x > pit.far_edge_m()) && trace.fall().is_none();
                found.push(metric("crossed", "got across", Some(f64::from(u8::from(crossed))), ""));
            }
            Scenario::Walk(_) | Scenario::Terrain(_) => {}
        }
        found
    }
}

impl PushAway {
    fn prepare(&self, script: &mut Script, seed: u64) -> Result<(), ParameterError> {
        in_range("push-m-s", self.push_m_s, 0.0, 20.0, "0 to 20 m/s")?;
        in_range("direction-deg", self.direction_deg, -360.0, 360.0, "-360 to 360 degrees")?;
        in_range("at-s", self.at_s, 0.0, 3600.0, "0 to 3600 s")?;
        in_range("every-s", self.every_s, 0.0, 3600.0, "0 to 3600 s, 0 for a single push")?;
        let angle = self.direction_deg.to_radians();
        let push = Push { linear: [self.push_m_s * angle.cos(), self.push_m_s * angle.sin()], angular: [0.0; 3] };
        // A push may come at any phase of the gait.
        let phase_s = STRIDE_S * stream(seed, Purpose::Scenario, 0, 0).random_range(0.0..1.0);
        let mut time_s = self.at_s + phase_s;
        while time_s < script.duration_s {
            script.pushes.push(TimedPush { time_s, push });
            if self.every_s <= 0.0 {
                break;
            }
            time_s += self.every_s.max(0.1);
        }
        Ok(())
    }
}

fn push_metrics(script: &Script, trace: &Trace, found: &mut Vec<Metric>) {
    let Some(first) = script.pushes.first() else { return };
    let at_s = first.time_s;
    let before = metrics::window(trace, at_s - 1.0, at_s);
    let after = metrics::window(trace, at_s, at_s + 1.0);
    let decay = |threshold| metrics::decay_time(trace, at_s, first.push.linear, threshold, STRIDE_S);
    found.push(metric("push_time_s", "pushed at", Some(at_s), "s"));
    found.push(metric("decay_10_s", "decay to 10 %", decay(0.1), "s"));
    found.push(metric("decay_20_s", "decay to 20 %", decay(0.2), "s"));
    let power = |frames| metrics::mean(frames, |frame| frame.power_w);
    found.push(metric("power_before_w", "power, 1 s before", power(before.clone()), "W"));
    let torque_before = metrics::mean(before, |frame| frame.torque_n_m);
    found.push(metric("power_after_w", "power, 1 s after", metrics::mean(after.clone(), |f| f.power_w), "W"));
    found.push(metric("torque_before_n_m", "torque, 1 s before", torque_before, "N m"));
    found.push(metric("torque_after_n_m", "torque, 1 s after", metrics::mean(after, |f| f.torque_n_m), "N m"));
}

impl Leash {
    fn prepare(&self, script: &mut Script) -> Result<(), ParameterError> {
        in_range("force-n", self.force_n, 0.0, 10_000.0, "0 to 10000 N")?;
        in_range("direction-deg", self.direction_deg, -360.0, 360.0, "-360 to 360 degrees")?;
        in_range("at-s", self.at_s, 0.0, 3600.0, "0 to 3600 s")?;
        in_range("for-s", self.for_s, 0.0, 3600.0, "0 to 3600 s")?;
        let angle = self.direction_deg.to_radians();
        let force = [self.force_n * angle.cos(), self.force_n * angle.sin()];
        script.pull = Some(Pull { from_s: self.at_s, until_s: self.at_s + self.for_s, force });
        Ok(())
    }
}

fn leash_metrics(script: &Script, trace: &Trace, found: &mut Vec<Metric>) {
    let Some(pull) = script.pull else { return };
    let end_s = pull.until_s.min(script.duration_s);
    let offset = metrics::offset_along_force(trace, pull.force, (end_s - 5.0).max(pull.from_s), end_s);
    found.push(metric("leash_offset_m_s", "velocity along the pull", offset, "m/s"));
}

impl FreeBox {
    fn prepare(&self, script: &mut Script, seed: u64) -> Result<(), ParameterError> {
        in_range("mass-kg", self.mass_kg, 1e-3, 1e4, "0.001 to 10000 kg")?;
        in_range("size-m", self.size_m, 0.01, 10.0, "0.01 to 10 m")?;
        in_range("distance-m", self.distance_m, 0.4, 100.0, "0.4 to 100 m, clear of the robot")?;
        in_range("friction", self.friction, 1e-3, 10.0, "0.001 to 10")?;
        in_range("max-offset-m", self.max_offset_m, 0.0, 10.0, "0 to 10 m")?;
        let offset = self.max_offset_m * stream(seed, Purpose::Scenario, 0, 1).random_range(-1.0..=1.0);
        let half = 0.5 * self.size_m;
        // Priority 2: the box's friction holds on the ground too.
        script.scene.obstacles = format!(
            r#"    <body name="box" pos="{x} {offset} {half}">
      <freejoint name="box_joint"/>
      <geom name="box" type="box" size="{half} {half} {half}" mass="{mass}" friction="{friction} 0.005 0.0001"
            priority="2" rgba="0.72 0.53 0.33 1"/>
    </body>
"#,
            x = self.distance_m + half,
            mass = self.mass_kg,
            friction = self.friction,
        );
        script.scene.buffers = Buffers { contacts: 100, rows: 500, stack: 200_000 };
        Ok(())
    }

    fn metrics(&self, trace: &Trace, found: &mut Vec<Metric>) {
        let frames = || trace.frames.iter();
        let touching = |frame: &&crate::trace::Frame| frame.peak_obstacle_force_n > 0.0;
        let contact_s = frames().filter(touching).count() as f64 * trace.period_s;
        let impulse: f64 = frames().map(|frame| frame.obstacle_impulse_n_s).sum();
        let peak = metrics::largest(frames(), |frame| frame.peak_obstacle_force_n);
        // The box is the last body.
        let place = |frame: &crate::trace::Frame| frame.bodies.last().map(|pose| pose.position);
        let moved = trace
            .frames
            .first()
            .and_then(place)
            .zip(trace.frames.last().and_then(place))
            .map(|(a, b)| f64::from(b[0] - a[0]).hypot(f64::from(b[1] - a[1])));
        found.push(metric("box_displacement_m", "box moved by", moved, "m"));
        found.push(metric("contact_time_s", "in contact", Some(contact_s), "s"));
        found.push(metric("contact_impulse_n_s", "impulse on the box", Some(impulse), "N s"));
        let mean_force = (contact_s > 0.0).then(|| impulse / contact_s);
        found.push(metric("mean_contact_force_n", "mean contact force", mean_force, "N"));
        found.push(metric("peak_contact_force_n", "peak contact force", peak, "N"));
        let passed = trace.frames.last().and_then(|last| {
            let box_x = f64::from(place(last)?[0]);
            Some(f64::from(u8::from(last.position[0] > box_x + 0.5 * self.size_m)))
        });
        found.push(metric("passed", "got past", passed, ""));
    }
}

impl BallPit {
    fn side(&self) -> u32 {
        f64::from(self.balls).sqrt().ceil() as u32
    }

    /// Where the last row ends \[m\].
    pub fn far_edge_m(&self) -> f64 {
        let pitch = 2.0 * self.radius_m + self.gap_m;
        self.distance_m + f64::from(self.side()) * pitch
    }

    fn prepare(&self, script: &mut Script) -> Result<(), ParameterError> {
        in_range("balls", f64::from(self.balls), 0.0, 2000.0, "0 to 2000")?;
        in_range("mass-kg", self.mass_kg, 1e-3, 1e3, "0.001 to 1000 kg")?;
        in_range("radius-m", self.radius_m, 0.01, 0.5, "0.01 to 0.5 m")?;
        in_range("gap-m", self.gap_m, 0.0, 10.0, "0 to 10 m")?;
        in_range("distance-m", self.distance_m, 0.4, 100.0, "0.4 to 100 m, clear of the robot")?;
        let (side, pitch) = (self.side(), 2.0 * self.radius_m + self.gap_m);
        let mut balls = String::new();
        for ball in 0..self.balls {
            let (row, column) = (ball / side, ball % side);
            let x = self.distance_m + (f64::from(row) + 0.5) * pitch;
            let y = (f64::from(column) - 0.5 * (f64::from(side) - 1.0)) * pitch;
            // A little damping stands for what keeps a real ball from rolling for ever: it halves a ball's speed in
            // about a second, and is far too small to be felt by a foot.
            let _ = writeln!(
                balls,
                r#"    <body name="ball_{ball}" pos="{x:.4} {y:.4} {radius}"><joint name="ball_{ball}" type="free" damping="0.001"/><geom name="ball_{ball}" type="sphere" size="{radius}" mass="{mass}" priority="1" friction="0.6 0.005 0.0001" rgba="{rgba}"/></body>"#,
                radius = self.radius_m,
                mass = self.mass_kg,
                rgba = ["0.90 0.62 0.00 1", "0.34 0.71 0.91 1", "0.00 0.62 0.45 1", "0.80 0.47 0.65 1"]
                    [(row + 2 * column) as usize % 4],
            );
        }
        script.scene.obstacles = balls;
        // Conjugate gradients: Newton's method would need a stack of half a gigabyte.
        script.scene.solver = r#"solver="CG" iterations="20""#;
        let contacts = 100 + 3 * self.balls as usize;
        script.scene.buffers = Buffers { contacts, rows: 4 * contacts, stack: 2_000_000 + 40_000 * side as usize };
        Ok(())
    }
}

impl Terrain {
    fn prepare(&self, script: &mut Script, seed: u64) -> Result<(), ParameterError> {
        in_range("height-m", self.height_m, 0.0, 2.0, "0 to 2 m")?;
        in_range("frequency-per-m", self.frequency_per_m, 0.01, 10.0, "0.01 to 10 per metre")?;
        in_range("step-length-m", self.step_length_m, 0.1, 10.0, "0.1 to 10 m")?;
        in_range("steps", f64::from(self.steps), 1.0, 100.0, "1 to 100")?;
        in_range("incline", self.incline, -1.0, 1.0, "-1 to 1")?;
        let field = match self.kind {
            TerrainKind::Perlin => terrain::perlin(FIELD_HALF_SIZE_M, self.height_m, self.frequency_per_m, seed),
            TerrainKind::Steps => terrain::steps(FIELD_HALF_SIZE_M, self.height_m, self.step_length_m, self.steps),
            TerrainKind::Slope => terrain::slope(FIELD_HALF_SIZE_M, self.incline),
        };
        script.scene.ground = Ground::Field(field);
        script.scene.buffers = Buffers { contacts: 200, rows: 900, stack: 200_000 };
        Ok(())
    }
}

fn metric(name: &'static str, label: &'static str, value: Option<f64>, unit: &'static str) -> Metric {
    Metric { name, label, value, unit }
}

fn in_range(name: &'static str, found: f64, low: f64, high: f64, expected: &'static str) -> Result<(), ParameterError> {
    if (low..=high).contains(&found) {
        Ok(())
    } else {
        Err(ParameterError { name, found: found.to_string(), expected })
    }
}
