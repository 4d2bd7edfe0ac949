//! The trace of a playback: its frames and events, which metrics, tables, recordings and CSV files read.

use std::borrow::Cow;

use crate::estimate::external_force::Doubt;
use crate::robot::Joints;
use crate::task::{Command, Stage, Terms};
pub use crate::world::{DisturbanceMark, Event, EventKind, Rope, SpringState};

/// Position \[m\] and orientation (w, x, y, z) of a body, world frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pose {
    /// Origin of the body's frame \[m\].
    pub position: [f32; 3],
    /// Unit quaternion (w, x, y, z), world from body.
    pub quaternion: [f32; 4],
}

impl Pose {
    /// Returns position and quaternion as a row of poses, as [`Renderer::picture`](crate::mujoco::Renderer::picture) takes them.
    pub fn row(&self) -> [f32; 7] {
        let ([x, y, z], [w, i, j, k]) = (self.position, self.quaternion);
        [x, y, z, w, i, j, k]
    }
}

/// The estimated state at the end of a policy step, for a robot that acts on its sensors.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sensed {
    /// Trunk velocity (forward, left, up), base frame [m/s].
    pub velocity: [f64; 3],
    /// Base height above the ground under the feet \[m\].
    pub height_m: f64,
    /// Position of the trunk's origin, world frame; its horizontal part drifts \[m\].
    pub position: [f64; 3],
    /// True for each foot that is taken to stand.
    pub contacts: [bool; 4],
    /// True for each foot that [does](crate::robot::FootState::stands).
    pub true_contacts: [bool; 4],
}

/// The felt and true external forces in a policy step, heading frame, low-passed over 0.1 s.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Felt {
    /// Felt force on the trunk \[N\].
    pub force: [f64; 3],
    /// True force on the trunk, low-passed alike: pulls, spring, rope, and what touches the trunk \[N\].
    pub true_force: [f64; 3],
    /// Felt force on each foot \[N\].
    pub feet: [[f64; 3]; 4],
    /// Reason not to trust the felt forces of this step; `None` if they can be trusted.
    pub doubt: Option<Doubt>,
}

/// The state at the end of one policy step and what the step cost.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Frame {
    /// Simulation time \[s\].
    pub time_s: f64,
    /// Pose of every body in the model's order, body 0 being the world; empty unless requested.
    pub bodies: Vec<Pose>,
    /// Pose of the body from which the distance to the goal is measured, if the script has a goal.
    pub goal: Option<Pose>,
    /// The command in the step.
    pub command: Command,
    /// Trunk velocity (forward, left, up), base frame [m/s].
    pub velocity: [f64; 3],
    /// Trunk velocity (forward, left, up), heading frame [m/s].
    pub velocity_in_heading: [f64; 3],
    /// Position of the trunk's origin, world frame \[m\].
    pub position: [f64; 3],
    /// Yaw rate about the base's up axis [rad/s].
    pub yaw_rate: f64,
    /// Roll, pitch and yaw of the trunk relative to the world \[rad\].
    pub roll_pitch_yaw: [f64; 3],
    /// Base height above the ground under it \[m\].
    pub height_m: f64,
    /// Mechanical power `Σ|τ·q̇|`, mean over the step's physics steps \[W\].
    pub power_w: f64,
    /// Norm of the joint torques `‖τ‖₂`, mean over the step's physics steps [N·m].
    pub torque_n_m: f64,
    /// Reward of Table II, also in the recovery stage.
    pub reward: f64,
    /// Terms of the reward, before weights.
    pub terms: Terms,
    /// Joint angles \[rad\].
    pub joint_angles: Joints,
    /// Joint targets given to the controller \[rad\].
    pub joint_targets: Joints,
    /// Joint torques of the last physics step [N·m].
    pub torques: Joints,
    /// Foot centres, world frame \[m\].
    pub foot_positions: [[f64; 3]; 4],
    /// Lowest point of each foot above the ground under it \[m\].
    pub foot_heights: [f64; 4],
    /// Contact force on each foot, world frame, mean over the step's physics steps \[N\].
    pub foot_forces: [[f64; 3]; 4],
    /// Largest contact force on any one foot in the step's physics steps \[N\].
    pub peak_foot_force_n: f64,
    /// Largest contact force between the robot and obstacles in the step's physics steps \[N\].
    pub peak_obstacle_force_n: f64,
    /// Impulse between the robot and obstacles over the step [N·s].
    pub obstacle_impulse_n_s: f64,
    /// Time in contact with obstacles during the step \[s\].
    pub obstacle_contact_s: f64,
    /// The rope, if the scene has one.
    pub rope: Option<Rope>,
    /// The spring, if the script has one and it has begun.
    pub spring: Option<SpringState>,
    /// The estimated state; `None` if the robot acts on the true state.
    pub sensed: Option<Sensed>,
    /// The felt forces, if they are observed.
    pub felt: Option<Felt>,
    /// The drawn mark of the present disturbance.
    pub mark: Option<DisturbanceMark>,
    /// The matching stage of a training episode, for scripts with a single push.
    pub stage: Option<Stage>,
}

/// The frames and events of one playback.
///
/// ```
/// use supple::policy::shipped;
/// use supple::scenario::{Playback, catalog::Scenario};
///
/// let agent = shipped::find("compliant")?;
/// let script = Scenario::named("push", "{push_m_s: 0.75, at_s: 0.5, duration_s: 3.0}")?.script(3, &agent.config)?;
/// let trace = Playback::new(&script, &agent.config, agent.controller())?.trace();
/// let pushed_s = trace.disturbed("push").ok_or("no push")?;
/// let after = trace.after(pushed_s);
/// let speed = |velocity: [f64; 3]| velocity[0].hypot(velocity[1]); // [m/s]
/// assert!(trace.fall().is_none());
/// assert!(speed(after.frames[0].velocity) > 2.0 * speed(after.frames[60].velocity)); // decayed within 1 s
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trace {
    /// Time between two frames, the policy period \[s\].
    pub period_s: f64,
    /// Weight of the robot \[N\].
    pub weight_n: f64,
    /// Frames, one for each policy step.
    pub frames: Vec<Frame>,
    /// Events in order of time.
    pub events: Vec<Event>,
}

impl Trace {
    methods! {
        /// Returns the first fall, if any.
        fn fall(&self) -> Option<&Event> = self.events.iter().find(|event| event.kind == EventKind::Fall);
        /// Returns the fault of policy, physics or sensors that ended the playback, if any.
        fn fault(&self) -> Option<&Event> = self.events.iter().find(|event| event.kind == EventKind::Fault);
        /// Returns true if the robot reached the script's goal on its feet.
        fn reached_goal(&self) -> bool = self.events.iter().any(|event| event.kind == EventKind::Success);
    }

    /// Returns the part before the first fall, or the whole trace.
    pub fn on_its_feet(&self) -> Cow<'_, Trace> {
        self.fall().map_or(Cow::Borrowed(self), |fall| Cow::Owned(self.until(fall.time_s)))
    }

    /// Returns the time of the first disturbance whose text starts with `text` \[s\].
    pub fn disturbed(&self, text: &str) -> Option<f64> {
        let is_it = |event: &&Event| event.kind == EventKind::Disturbance && event.text.starts_with(text);
        Some(self.events.iter().find(is_it)?.time_s)
    }

    /// Returns the part up to a time \[s\].
    pub fn until(&self, time_s: f64) -> Trace {
        let until_s = time_s + 0.5 * self.period_s;
        Trace {
            frames: self.frames.iter().filter(|frame| frame.time_s < until_s).cloned().collect(),
            events: self.events.iter().filter(|event| event.time_s < until_s).cloned().collect(),
            ..*self
        }
    }

    /// Returns the part after a time \[s\].
    pub fn after(&self, time_s: f64) -> Trace {
        Trace {
            frames: self.frames.iter().filter(|frame| frame.time_s > time_s).cloned().collect(),
            events: self.events.iter().filter(|event| event.time_s > time_s).cloned().collect(),
            ..*self
        }
    }
}
