//! What is put to the test in a scenario: a policy of ours, or one from elsewhere.

use std::path::Path;

use crate::config::Config;
use crate::foreign::{ForeignError, ForeignPolicy};
use crate::policy::{Policy, PolicyError};
use crate::robot::Robot;
use crate::scenario::Controller;

/// Why there is no agent.
#[derive(Debug, thiserror::Error)]
pub enum AgentError {
    /// A policy file of ours.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// A policy from elsewhere.
    #[error(transparent)]
    Foreign(#[from] ForeignError),
}

/// A policy with the robot, rates, gains and latency that it runs with.
#[derive(Debug)]
pub struct Agent {
    /// What it runs with.
    pub config: Config,
    /// Identity of the policy: SHA-256 of its files.
    pub sha256: String,
    mind: Mind,
}

#[derive(Debug)]
enum Mind {
    Ours(Box<Policy>),
    Foreign(Box<ForeignPolicy>),
}

impl Agent {
    /// Reads a policy: a YAML file describes one from elsewhere, everything else is a policy file of ours.
    ///
    /// # Errors
    /// [`AgentError`]
    pub fn load(path: &Path) -> Result<Self, AgentError> {
        if is_description(path) { Ok(ForeignPolicy::load(path)?.into()) } else { Ok(Policy::load(path)?.into()) }
    }

    /// A controller of one robot.
    pub fn controller(&self) -> Box<dyn Controller + '_> {
        match &self.mind {
            Mind::Ours(policy) => Box::new(policy.controller()),
            Mind::Foreign(policy) => Box::new(policy.controller()),
        }
    }

    /// Runs it on another robot, which was read from `path`.
    pub fn run_on(&mut self, path: &str, robot: &Robot) {
        self.config.robot.model = path.to_owned();
        if let Some(height) = robot.min_height_m {
            self.config.episode.min_height_m = height;
        }
    }

    /// The policy file, if it is ours.
    pub fn policy(&self) -> Option<&Policy> {
        match &self.mind {
            Mind::Ours(policy) => Some(policy),
            Mind::Foreign(_) => None,
        }
    }

    /// As [`Agent::policy`], to keep.
    pub fn into_policy(self) -> Option<Policy> {
        match self.mind {
            Mind::Ours(policy) => Some(*policy),
            Mind::Foreign(_) => None,
        }
    }
}

impl From<Policy> for Agent {
    fn from(policy: Policy) -> Self {
        Agent { config: policy.provenance.config.clone(), sha256: policy.sha256(), mind: Mind::Ours(Box::new(policy)) }
    }
}

impl From<ForeignPolicy> for Agent {
    fn from(policy: ForeignPolicy) -> Self {
        Agent { config: policy.config().clone(), sha256: policy.sha256.clone(), mind: Mind::Foreign(Box::new(policy)) }
    }
}

/// Whether a file describes a policy from elsewhere.
pub fn is_description(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "yaml" || extension == "yml")
}
