//! Agents: a policy of Supple or an external one, with the robot and configuration that it runs with.

use std::borrow::Borrow;
use std::path::Path;
use std::sync::Arc;

use super::compliance::{ComplianceError, CompliantController, PolicyCalibration, check_range};
use super::controller::Controller;
use super::external;
use super::file::Policy;
use super::inference::{Inference, PolicyController};
use crate::config::{Config, ConfigError};
use crate::robot::Robot;
use crate::util::files::{self, FileError};

/// The reason why a policy cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum AgentError {
    /// The policy file, or a file that it names, cannot be read or is invalid.
    #[error(transparent)]
    File(#[from] FileError),
    /// The simulation settings of an external policy are invalid.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The name is neither a file nor a shipped policy.
    #[error(
        "there is no policy '{name}': give a policy file, a run's folder, the YAML file of an external policy, or \
         one of: {known}"
    )]
    Unknown {
        /// The name that was given.
        name: String,
        /// Names of the shipped policies.
        known: String,
    },
    /// The path is an ONNX file without a description.
    #[error(
        "{0} has no description of its inputs and outputs: describe it in a YAML file that names it, as \
         examples/policies/rsl_rl.yaml does, and give that file"
    )]
    Undescribed(String),
    /// A compliance is commanded where the policy does not play.
    #[error("{0} commands a compliance, but no policy is played here; give the name without '@'")]
    Commanded(String),
    /// The policy is external.
    #[error("{0} is an external policy: this works with policy files of Supple")]
    External(String),
}

/// A policy with the robot, rates, gains and latency that it runs with.
///
/// ```
/// use supple::policy::shipped;
///
/// let agent = shipped::find("compliant")?; // Supple's policies and external ones alike
/// assert_eq!(agent.config.robot.model, "go1");
/// let controller = agent.controller(); // from the state and a command to joint targets
/// assert_eq!(controller.rest(), agent.config.action.nominal_pose_rad.joints());
/// assert_eq!(agent.resolve_compliance(None, Some(0.04))?, Some(0.04)); // commanded [m/s/N], in its range
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Agent {
    /// The configuration that the policy runs with.
    pub config: Config,
    /// SHA-256 of the policy's files, which identifies it.
    pub sha256: String,
    /// The measured compliance, if the policy was calibrated.
    pub calibration: Option<PolicyCalibration>,
    /// The compliance commanded behind the policy's name, as in `baseline@0.03` [m/s/N].
    pub commanded_compliance: Option<f64>,
    kind: AgentKind,
}

#[derive(Debug)]
enum AgentKind {
    Ours(Box<Policy>),
    External(Box<Inference>),
}

impl Agent {
    /// Reads a policy: a YAML file is the description of an external one, every other file is a policy file of Supple.
    ///
    /// # Errors
    /// A file cannot be read or is invalid, or the calibration next to it is invalid.
    pub fn load(path: &Path) -> Result<Self, AgentError> {
        let mut agent = Self::load_uncalibrated(path)?;
        agent.calibration = PolicyCalibration::load_for(path, &agent.sha256)?;
        Ok(agent)
    }

    /// Like [`Agent::load`], but leaves a calibration next to the policy unread.
    pub(crate) fn load_uncalibrated(path: &Path) -> Result<Self, AgentError> {
        let mut agent = if files::is_yaml(path) { external::load(path)? } else { Agent::from(Policy::load(path)?) };
        agent.find_robot(path.parent().unwrap_or(Path::new("")));
        Ok(agent)
    }

    /// Creates an agent from an inference that is in no policy file. `sha256` identifies it wherever results are stored
    /// by policy.
    pub fn external(inference: Inference, config: Config, sha256: String) -> Self {
        let kind = AgentKind::External(Box::new(inference));
        Agent { config, sha256, calibration: None, commanded_compliance: None, kind }
    }

    /// Resolves the path of a robot that does not ship: relative to the policy's folder, or as the run's configuration
    /// has it. If it does not exist, the policy can still be inspected, or run on another robot.
    fn find_robot(&mut self, folder: &Path) {
        let model = &mut self.config.robot.model;
        if Robot::ships(model) || Path::new(model).is_absolute() {
            return;
        }
        let beside = folder.join(&*model);
        let of_run = || Some(Config::load(&folder.join("config.yaml").display().to_string()).ok()?.robot.model);
        let of_run = if beside.exists() { None } else { of_run() };
        *model = of_run.unwrap_or_else(|| beside.display().to_string());
    }

    /// Creates a controller of one robot.
    pub fn controller(&self) -> Box<dyn Controller + '_> {
        self.compliant(Box::new(self.inference().controller()))
    }

    /// Creates a controller of one robot that shares the agent.
    pub fn shared_controller(self: &Arc<Self>) -> Box<dyn Controller> {
        self.compliant(Box::new(PolicyController::new(SharedAgent(Arc::clone(self)))))
    }

    /// Wraps a calibrated policy in the outer loop that makes its compliance a command, unless it observes that command itself.
    fn compliant<'a>(&self, policy: Box<dyn Controller + 'a>) -> Box<dyn Controller + 'a> {
        match &self.calibration {
            _ if self.config.reward.reference_m_s_per_n.is_some() => policy,
            None => policy,
            Some(calibration) => Box::new(CompliantController::new(policy, calibration, &self.config)),
        }
    }

    /// Returns the compliance to command [m/s/N]: the one that is required (by an experiment, or by a session that continues),
    /// else the one behind the policy's name, else the scenario's, else the least that it was trained with; `None` leaves the
    /// policy its own.
    ///
    /// # Errors
    /// The policy has not been calibrated, or the compliance is out of its range.
    pub fn resolve_compliance(
        &self,
        required: Option<f64>,
        scenario: Option<f64>,
    ) -> Result<Option<f64>, ComplianceError> {
        let trained = self.config.reward.reference_m_s_per_n;
        let asked = required.or(self.commanded_compliance).or(scenario).or(trained.map(|[least, _]| least));
        let Some(compliance) = asked else { return Ok(None) };
        let range = trained.or(self.calibration.as_ref().map(PolicyCalibration::range));
        check_range(range.ok_or(ComplianceError::NotCalibrated)?, compliance)?;
        Ok(Some(compliance))
    }

    /// Returns the inference from states to joint targets.
    pub fn inference(&self) -> &Inference {
        match &self.kind {
            AgentKind::Ours(policy) => policy.inference(),
            AgentKind::External(inference) => inference,
        }
    }

    /// Replaces the robot that the policy runs on.
    pub fn run_on(&mut self, robot: &Robot) {
        self.config.robot.model.clone_from(&robot.name);
    }

    /// Returns the policy file, if the policy is one of Supple.
    pub fn policy(&self) -> Option<&Policy> {
        match &self.kind {
            AgentKind::Ours(policy) => Some(policy),
            AgentKind::External(_) => None,
        }
    }

    /// Like [`Agent::policy`], but takes ownership.
    pub fn into_policy(self) -> Option<Policy> {
        match self.kind {
            AgentKind::Ours(policy) => Some(*policy),
            AgentKind::External(_) => None,
        }
    }
}

/// Borrows the agent's `Inference` through an `Arc<Agent>`.
struct SharedAgent(Arc<Agent>);

impl Borrow<Inference> for SharedAgent {
    fn borrow(&self) -> &Inference {
        self.0.inference()
    }
}

impl From<Policy> for Agent {
    fn from(policy: Policy) -> Self {
        let (config, sha256) = (policy.provenance.config.clone(), policy.sha256().to_owned());
        Agent { config, sha256, calibration: None, commanded_compliance: None, kind: AgentKind::Ours(Box::new(policy)) }
    }
}
