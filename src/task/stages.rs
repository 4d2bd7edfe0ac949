//! The stages of an episode: walking, recovery and post-recovery (section III-C).

use serde::{Deserialize, Serialize};

use crate::config::{Episode, Simulation};

/// The three stages of section III-C.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Undisturbed walking with the full reward.
    Walking,
    /// The stage from the push on: tracking rewards are constants, except in the baseline.
    Recovery,
    /// Walking after the recovery, with the full reward again.
    PostRecovery,
}

/// Lengths of the stages in policy steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stages {
    /// First step of the recovery stage, when the push happens.
    pub recovery_start: usize,
    /// First step of the post-recovery stage.
    pub post_recovery_start: usize,
    /// Number of steps of the episode.
    pub end: usize,
}

impl Stages {
    /// Converts the durations of a configuration to policy steps.
    pub fn new(episode: &Episode, simulation: &Simulation) -> Self {
        let recovery_start = simulation.policy_steps(episode.walking_s);
        let post_recovery_start = recovery_start + simulation.policy_steps(episode.recovery_s);
        let end = post_recovery_start + simulation.policy_steps(episode.post_recovery_s);
        Stages { recovery_start, post_recovery_start, end }
    }

    /// Returns the stage that a step, counted from 0, belongs to.
    pub fn at(&self, step: usize) -> Stage {
        if step < self.recovery_start {
            Stage::Walking
        } else if step < self.post_recovery_start {
            Stage::Recovery
        } else {
            Stage::PostRecovery
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    #[test]
    fn stages_are_two_one_and_one_second_at_60_hz() {
        let config = Config::load("compliant").unwrap();
        let stages = Stages::new(&config.episode, &config.simulation);
        assert_eq!(stages, Stages { recovery_start: 120, post_recovery_start: 180, end: 240 });
        let at = [0, 119, 120, 179, 180, 239].map(|step| stages.at(step));
        use Stage::{PostRecovery, Recovery, Walking};
        assert_eq!(at, [Walking, Walking, Recovery, Recovery, PostRecovery, PostRecovery]);
    }
}
