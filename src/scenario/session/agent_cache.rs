//! Policies at hand: found by name when somebody asks for one, by identity when a session is played again.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use super::Seat;
use crate::policy::compliance::PolicyCalibration;
use crate::policy::{Agent, AgentError, Policy, shipped};
use crate::robot::Robot;
use crate::util::files::{self, FileError};

/// Larger files are not policies.
const MAX_BYTES: u64 = 64 << 20;

/// Why a policy is not at hand.
#[derive(Debug, thiserror::Error)]
pub enum AgentCacheError {
    /// There is none of this name, or it is no good.
    #[error(transparent)]
    Agent(#[from] AgentError),
    /// It is no policy file, or the robot is no good.
    #[error(transparent)]
    File(#[from] FileError),
    /// It is there, but it is another one.
    #[error("{what} has changed since: it was {expected}, and is now {found}; put back the one that it was")]
    Changed {
        /// Policy or robot.
        what: String,
        /// Identity that was kept.
        expected: String,
        /// Identity that was found.
        found: String,
    },
}

/// Policies by identity, and the files of those that do not ship.
#[derive(Debug, Default)]
pub struct AgentCache {
    agents: HashMap<String, Arc<Agent>>,
    files: HashMap<String, Vec<u8>>,
    /// Out of a session: they go before those that lie beside the policies.
    calibrations: HashMap<String, PolicyCalibration>,
}

impl AgentCache {
    /// Finds a policy for a robot, its own one if none is named, and puts it on the shelf.
    ///
    /// # Errors
    /// [`AgentCacheError`]
    pub fn find(&mut self, policy: &str, robot: Option<&str>) -> Result<Seat, AgentCacheError> {
        let (mut agent, file) = AgentCache::read(policy)?;
        let robot = Robot::load(robot.unwrap_or(&agent.config.robot.model))?;
        agent.run_on(&robot);
        let seat = Seat {
            policy: policy.to_owned(),
            sha256: agent.sha256.clone(),
            robot: robot.name.clone(),
            robot_sha256: robot.sha256().to_owned(),
            compliance: 0.0,
        };
        self.put(agent, file);
        Ok(seat)
    }

    /// Puts a policy on the shelf, with its file if it does not ship.
    pub fn put(&mut self, mut agent: Agent, file: Option<Vec<u8>>) {
        if let Some(calibration) = self.calibrations.get(&agent.sha256) {
            agent.calibration = Some(calibration.clone());
        }
        if let Some(file) = file {
            self.files.insert(agent.sha256.clone(), file);
        }
        self.agents.insert(agent.sha256.clone(), Arc::new(agent));
    }

    /// Puts the file of a policy on the shelf.
    ///
    /// # Errors
    /// It is no policy file.
    pub fn put_file(&mut self, name: &str, file: Vec<u8>) -> Result<(), AgentCacheError> {
        let agent = Agent::from(Policy::from_bytes(&file, Path::new(name))?);
        self.put(agent, Some(file));
        Ok(())
    }

    /// Puts a calibration on the shelf, for a policy that is put there later.
    pub fn put_calibration(&mut self, calibration: PolicyCalibration) {
        self.calibrations.insert(calibration.sha256.clone(), calibration);
    }

    /// The policy of a seat, on its robot.
    ///
    /// # Errors
    /// [`AgentCacheError`] if policy or robot are gone or have changed.
    pub fn take(&mut self, seat: &Seat) -> Result<Arc<Agent>, AgentCacheError> {
        if !self.agents.contains_key(&seat.sha256) {
            let (agent, file) = AgentCache::read(&seat.policy)?;
            unchanged(&format!("the policy '{}'", seat.policy), &seat.sha256, &agent.sha256)?;
            self.put(agent, file);
        }
        let robot = Robot::load(&seat.robot)?;
        unchanged(&format!("the robot '{}'", seat.robot), &seat.robot_sha256, robot.sha256())?;
        let agent = Arc::clone(&self.agents[&seat.sha256]);
        if agent.config.robot.model == seat.robot {
            return Ok(agent);
        }
        // The policy comes out of the session, which knows where its robot is.
        let (mut agent, _) = match self.files.get(&seat.sha256) {
            Some(file) => (Agent::from(Policy::from_bytes(file, Path::new(&seat.policy))?), None),
            None => AgentCache::read(&seat.policy)?,
        };
        agent.calibration.clone_from(&self.agents[&seat.sha256].calibration);
        agent.run_on(&robot);
        let agent = Arc::new(agent);
        self.agents.insert(seat.sha256.clone(), Arc::clone(&agent));
        Ok(agent)
    }

    /// The file of a policy that does not ship.
    pub fn file(&self, sha256: &str) -> Option<&[u8]> {
        self.files.get(sha256).map(Vec::as_slice)
    }

    /// How far a policy yields, if that has been measured.
    pub fn calibration(&self, sha256: &str) -> Option<&PolicyCalibration> {
        self.agents.get(sha256)?.calibration.as_ref()
    }

    /// Leaves only the policies of these seats: a run that is watched saves many.
    pub fn tidy(&mut self, seats: &[Seat]) {
        let used = |sha256: &String| seats.iter().any(|seat| seat.sha256 == *sha256);
        self.agents.retain(|sha256, _| used(sha256));
        self.files.retain(|sha256, _| used(sha256));
    }

    /// Reads a policy by name or path, and its file if it is one of ours that does not ship.
    ///
    /// # Errors
    /// [`AgentCacheError`]
    pub fn read(name: &str) -> Result<(Agent, Option<Vec<u8>>), AgentCacheError> {
        let agent = shipped::find(name)?;
        let Some(path) = shipped::file_of(name).filter(|_| agent.policy().is_some()) else { return Ok((agent, None)) };
        let file = files::read_bounded(&path, MAX_BYTES).map_err(FileError::of("policy", &path))?;
        if files::sha256(&[&file]) != agent.sha256 {
            // Training has saved another one between the two looks.
            return AgentCache::read(name);
        }
        Ok((agent, Some(file)))
    }
}

fn unchanged(what: &str, expected: &str, found: &str) -> Result<(), AgentCacheError> {
    if expected == found {
        return Ok(());
    }
    let [expected, found] = [expected, found].map(|sha256| sha256.chars().take(12).collect());
    Err(AgentCacheError::Changed { what: what.to_owned(), expected, found })
}
