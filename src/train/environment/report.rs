//! The reports of a step and of a finished episode of the training environment.

use serde::{Deserialize, Serialize};

use crate::task::{Stage, Terms};

/// The way in which an episode ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EpisodeEnd {
    /// The robot fell: the return ends here.
    Fall,
    /// The time limit was reached, or there are no pushes yet: the value of the last state continues the return.
    TimeLimit,
    /// The physics failed: the step has no advantage, and the fault is counted.
    Fault,
}

/// The result of one policy step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EnvStep {
    /// Reward of equation 3, or of the recovery stage.
    pub reward: f64,
    /// Set if this step ended the episode. The observation afterwards is the final one.
    pub end: Option<EpisodeEnd>,
    /// Stage of the episode that the step belongs to.
    pub stage: Stage,
    /// The terms of the reward as measured (never replaced); zero if the physics failed.
    pub terms: Terms,
}

/// Summary of a finished episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpisodeReport {
    /// The way in which the episode ended.
    pub end: EpisodeEnd,
    /// Length of the episode \[steps\].
    pub steps: usize,
    /// True if the robot was pushed.
    pub pushed: bool,
    /// Sum of the rewards over the episode.
    pub reward: f64,
    /// Sums of the terms over all steps, as measured (never replaced).
    pub terms: Terms,
    /// Mean `r_lin` of the walking stage, if the episode completed it.
    pub walking_linear: Option<f64>,
    /// Mean peak height of the swings that ended in this episode \[m\].
    pub swing_height_m: Option<f64>,
    /// Level of the terrain, if the episode was on uneven ground.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub terrain_level: Option<usize>,
    /// Report of the physics fault, if one ended the episode.
    pub fault: Option<Box<EpisodeFault>>,
}

/// Report of a physics fault.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpisodeFault {
    /// Error message of MuJoCo.
    pub error: String,
    /// Index of the environment in its run.
    pub environment: u64,
    /// Number of earlier episodes of this environment.
    pub episode: u64,
    /// Number of earlier steps in the episode.
    pub step: usize,
    /// CSV of the last second before the fault.
    pub last_second: String,
}
