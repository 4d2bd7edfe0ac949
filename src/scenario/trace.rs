/*! What happened in a rollout, step by step: the one thing that metrics, tables, recordings and CSV files read.
*/

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use crate::robot::Joints;
use crate::task::{Command, Stage, Terms};

/// Position \[m\] and orientation (w, x, y, z) of a body, world frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pose {
    /// Origin of the body's frame \[m\].
    pub position: [f32; 3],
    /// Unit quaternion (w, x, y, z), world from body.
    pub quaternion: [f32; 4],
}

/// Something that acts on the robot from outside.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Disturbance {
    /// A velocity offset at this instant, world frame [m/s].
    Push {
        /// World frame [m/s].
        velocity: [f64; 3],
    },
    /// A force on the trunk, world frame \[N\]; drawn as a rope.
    Pull {
        /// World frame \[N\].
        force: [f64; 3],
    },
    /// A force on the trunk of something that is in its way; drawn as an arrow that ends there.
    Press {
        /// World frame \[N\].
        force: [f64; 3],
    },
}

/// A rope with a load, at the end of a step.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Rope {
    /// From one end to the other, over pulleys: world frame \[m\].
    pub points: Vec<[f32; 3]>,
    /// Pulling force, mean over the step's physics steps \[N\].
    pub force_n: f64,
    /// Largest pulling force in them \[N\].
    pub peak_force_n: f64,
    /// Least force in them; a rope cannot push, so that it is never below zero \[N\].
    pub least_force_n: f64,
}

/// A spring between the trunk and a point, in a step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stretch {
    /// By how much it is stretched in the last physics step; below zero, how far it is from that \[m\].
    pub stretch_m: f64,
    /// Force on the trunk, mean over the step's physics steps \[N\].
    pub force_n: f64,
    /// Largest force in them \[N\].
    pub peak_force_n: f64,
}

/// What the robot knows of its state at the end of a policy step, if it acts on its sensors.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sensed {
    /// Trunk velocity (forward, left, up), base frame [m/s].
    pub velocity: [f64; 3],
    /// Base height above the ground under the feet \[m\].
    pub height_m: f64,
    /// Origin of the trunk, world frame; its horizontal part drifts \[m\].
    pub position: [f64; 3],
    /// Feet that the contact network says touch.
    pub contacts: [bool; 4],
    /// Feet that touch.
    pub true_contacts: [bool; 4],
}

/// The state at the end of one policy step and what the step cost.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Frame {
    /// Simulation time \[s\].
    pub time_s: f64,
    /// Every body of the model, in the model's order; body 0 is the world. Empty if they were not asked for.
    pub bodies: Vec<Pose>,
    /// The body from which the way to the script's goal is measured, if there is a goal.
    pub goal: Option<Pose>,
    /// What the policy was asked to do.
    pub command: Command,
    /// Trunk velocity (forward, left, up), base frame [m/s].
    pub velocity: [f64; 3],
    /// Trunk velocity (forward, left, up), heading frame [m/s].
    pub velocity_in_heading: [f64; 3],
    /// Origin of the trunk, world frame \[m\].
    pub position: [f64; 3],
    /// About the base's up axis [rad/s].
    pub yaw_rate: f64,
    /// Roll, pitch, yaw \[rad\].
    pub roll_pitch_yaw: [f64; 3],
    /// Base height above the ground under it \[m\].
    pub height_m: f64,
    /// `Σ|τ·q̇|`, mean over the step's physics steps \[W\].
    pub power_w: f64,
    /// `‖τ‖₂`, mean over the step's physics steps [N·m].
    pub torque_n_m: f64,
    /// Reward of Table II, never replaced by the recovery stage's.
    pub reward: f64,
    /// Its terms.
    pub terms: Terms,
    /// Joint angles \[rad\].
    pub joint_angles: Joints,
    /// Joint targets given to the controller \[rad\].
    pub joint_targets: Joints,
    /// Torques of the last physics step [N·m].
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
    /// Time that they touched, of the step \[s\].
    pub obstacle_contact_s: f64,
    /// A rope, if the scene has one.
    pub rope: Option<Rope>,
    /// A leash in somebody's hand, or a wall that gives, if the script has one and it has begun.
    pub spring: Option<Stretch>,
    /// What the robot knew of it; none if it acts on the true state.
    pub sensed: Option<Sensed>,
    /// What acted from outside in this step.
    pub disturbance: Option<Disturbance>,
    /// Stage of the training episode that this would be, if it is one.
    pub stage: Option<Stage>,
}

/// Something worth a line of text.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Event {
    /// Simulation time \[s\].
    pub time_s: f64,
    /// What kind.
    pub kind: EventKind,
    /// In words.
    pub text: String,
}

/// Kinds of events.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EventKind {
    /// A disturbance began.
    Disturbance,
    /// The robot fell.
    Fall,
    /// The robot did what the scenario is about (crossed, passed, recovered).
    Success,
    /// The physics or the sensors failed.
    Fault,
}

/// A rollout.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trace {
    /// Time between frames \[s\].
    pub period_s: f64,
    /// Of the robot \[N\].
    pub weight_n: f64,
    /// One frame for each policy step.
    pub frames: Vec<Frame>,
    /// In order of time.
    pub events: Vec<Event>,
}

impl Trace {
    /// The first fall, if there was one.
    pub fn fall(&self) -> Option<&Event> {
        self.events.iter().find(|event| event.kind == EventKind::Fall)
    }

    /// What failed, if physics or sensors did and ended the rollout.
    pub fn fault(&self) -> Option<&Event> {
        self.events.iter().find(|event| event.kind == EventKind::Fault)
    }

    /// What happened while the robot was on its feet: all, or up to its fall.
    pub fn on_its_feet(&self) -> Cow<'_, Trace> {
        self.fall().map_or(Cow::Borrowed(self), |fall| Cow::Owned(self.until(fall.time_s)))
    }

    /// When the first disturbance came whose text begins like this \[s\].
    pub fn disturbed(&self, text: &str) -> Option<f64> {
        let is_it = |event: &&Event| event.kind == EventKind::Disturbance && event.text.starts_with(text);
        Some(self.events.iter().find(is_it)?.time_s)
    }

    /// What happened up to a time.
    pub fn until(&self, time_s: f64) -> Trace {
        let until_s = time_s + 0.5 * self.period_s;
        Trace {
            frames: self.frames.iter().filter(|frame| frame.time_s < until_s).cloned().collect(),
            events: self.events.iter().filter(|event| event.time_s < until_s).cloned().collect(),
            ..*self
        }
    }

    /// What happened after a time.
    pub fn after(&self, time_s: f64) -> Trace {
        Trace {
            frames: self.frames.iter().filter(|frame| frame.time_s > time_s).cloned().collect(),
            events: self.events.iter().filter(|event| event.time_s > time_s).cloned().collect(),
            ..*self
        }
    }

    /// Whether the robot got to the script's goal on its feet.
    pub fn reached_goal(&self) -> bool {
        self.events.iter().any(|event| event.kind == EventKind::Success)
    }
}
