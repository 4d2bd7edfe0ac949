//! The cache of policies: found by name when requested, by SHA-256 when a session is replayed.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use super::{Seat, SessionError};
use crate::policy::compliance::{PolicyCalibration, split_compliance};
use crate::policy::{Agent, Policy, shipped};
use crate::robot::Robot;
use crate::util::files::{self, FileError};

/// Maximum size of a policy file \[bytes\].
const MAX_BYTES: u64 = 64 << 20;

/// Policies by SHA-256, with the files of those that do not ship. A clone shares them.
#[derive(Debug, Clone, Default)]
pub struct AgentCache {
    agents: HashMap<String, Arc<Agent>>,
    files: HashMap<String, Arc<[u8]>>,
    /// Calibrations from a saved session; they take precedence over those stored next to the policies.
    calibrations: HashMap<String, PolicyCalibration>,
}

impl AgentCache {
    /// Loads a policy for a robot (by default its own) and adds it to the cache.
    ///
    /// # Errors
    /// The policy or robot does not exist or is invalid.
    pub fn find(&mut self, policy: &str, robot: Option<&str>) -> Result<Seat, SessionError> {
        let (policy, compliance) = split_compliance(policy);
        let (mut agent, file) = AgentCache::read(policy)?;
        let robot = Robot::load(robot.unwrap_or(&agent.config.robot.model))?;
        agent.run_on(&robot);
        let (sha256, robot_sha256) = (agent.sha256.clone(), robot.sha256().to_owned());
        let seat = Seat { policy: policy.to_owned(), sha256, robot: robot.name.clone(), robot_sha256, compliance };
        self.put(agent, file);
        Ok(seat)
    }

    /// Adds a policy, with its file if it does not ship.
    pub fn put(&mut self, mut agent: Agent, file: Option<Vec<u8>>) {
        if let Some(calibration) = self.calibrations.get(&agent.sha256) {
            agent.calibration = Some(calibration.clone());
        }
        if let Some(file) = file {
            self.files.insert(agent.sha256.clone(), file.into());
        }
        self.agents.insert(agent.sha256.clone(), Arc::new(agent));
    }

    /// Adds a policy given as the bytes of its file.
    pub(super) fn put_file(&mut self, name: &str, file: Vec<u8>) -> Result<(), SessionError> {
        let agent = Agent::from(Policy::from_bytes(&file, Path::new(name))?);
        self.put(agent, Some(file));
        Ok(())
    }

    /// Adds a calibration for a policy that is added later.
    pub(super) fn put_calibration(&mut self, calibration: PolicyCalibration) {
        self.calibrations.insert(calibration.sha256.clone(), calibration);
    }

    /// Returns the policy of a seat, adapted to its robot.
    ///
    /// # Errors
    /// The policy or robot no longer exists or has changed.
    pub fn take(&mut self, seat: &Seat) -> Result<Arc<Agent>, SessionError> {
        let robot = Robot::load(&seat.robot)?;
        unchanged(&format!("the robot '{}'", seat.robot), &seat.robot_sha256, robot.sha256())?;
        self.renewed(seat)
    }

    /// Returns the policy of a seat whose robot is in the session already, without reading the robot's files again, or those
    /// of a policy in the cache.
    pub(super) fn renewed(&mut self, seat: &Seat) -> Result<Arc<Agent>, SessionError> {
        if !self.agents.contains_key(&seat.sha256) {
            let (agent, file) = AgentCache::read(&seat.policy)?;
            unchanged(&format!("the policy '{}'", seat.policy), &seat.sha256, &agent.sha256)?;
            self.put(agent, file);
        }
        let agent = Arc::clone(&self.agents[&seat.sha256]);
        if agent.config.robot.model == seat.robot {
            return Ok(agent);
        }
        // The policy comes from a saved session, which names its robot.
        let (mut agent, _) = match self.files.get(&seat.sha256) {
            Some(file) => (Agent::from(Policy::from_bytes(file, Path::new(&seat.policy))?), None),
            None => AgentCache::read(&seat.policy)?,
        };
        unchanged(&format!("the policy '{}'", seat.policy), &seat.sha256, &agent.sha256)?;
        agent.calibration.clone_from(&self.agents[&seat.sha256].calibration);
        agent.config.robot.model.clone_from(&seat.robot);
        let agent = Arc::new(agent);
        self.agents.insert(seat.sha256.clone(), Arc::clone(&agent));
        Ok(agent)
    }

    /// Returns the file of a policy that does not ship.
    pub fn file(&self, sha256: &str) -> Option<&[u8]> {
        self.files.get(sha256).map(|file| &**file)
    }

    /// Returns the calibration of a policy, if it has been measured.
    pub fn calibration(&self, sha256: &str) -> Option<&PolicyCalibration> {
        self.agents.get(sha256)?.calibration.as_ref()
    }

    /// Removes all policies except those of these seats.
    pub fn tidy(&mut self, seats: &[Seat]) {
        let used = |sha256: &String| seats.iter().any(|seat| seat.sha256 == *sha256);
        self.agents.retain(|sha256, _| used(sha256));
        self.files.retain(|sha256, _| used(sha256));
    }

    /// Reads a policy by name or path, with its file if it does not ship.
    ///
    /// # Errors
    /// The policy does not exist or is invalid.
    pub fn read(name: &str) -> Result<(Agent, Option<Vec<u8>>), SessionError> {
        let agent = shipped::find(name)?;
        let Some(path) = shipped::file_of(name).filter(|_| agent.policy().is_some()) else { return Ok((agent, None)) };
        let file = files::read_bounded(&path, MAX_BYTES).map_err(FileError::of("policy", &path))?;
        if files::sha256(&[&file]) != agent.sha256 {
            // Training has replaced the file in between.
            return AgentCache::read(name);
        }
        Ok((agent, Some(file)))
    }
}

fn unchanged(what: &str, expected: &str, found: &str) -> Result<(), SessionError> {
    if expected == found {
        return Ok(());
    }
    let [expected, found] = [expected, found].map(|sha256| sha256.chars().take(12).collect());
    Err(SessionError::Changed { what: what.to_owned(), expected, found })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_external_policy_that_has_changed_is_refused_on_another_robot_too() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("policy.yaml");
        let text = std::fs::read_to_string(root.join("examples/policies/rsl_rl.yaml")).unwrap();
        std::fs::write(&path, &text).unwrap();
        std::fs::copy(root.join("tests/fixtures/onnx/rsl_rl.onnx"), folder.path().join("policy.onnx")).unwrap();
        let mut cache = AgentCache::default();
        let seat = cache.find(path.to_str().unwrap(), None).unwrap();
        let robot_sha256 = Robot::load("go2").unwrap().sha256().to_owned();
        let other = Seat { robot: "go2".to_owned(), robot_sha256, ..seat };
        std::fs::write(&path, format!("{text}# changed\n")).unwrap();
        let error = cache.take(&other).unwrap_err().to_string();
        assert!(error.contains("policy.yaml' has changed: its SHA-256 is"), "{error}");
        std::fs::write(&path, &text).unwrap();
        assert_eq!(cache.take(&other).unwrap().config.robot.model, "go2");
    }
}
