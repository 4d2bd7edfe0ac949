//! The live session: robots driven on one clock.
//!
//! The clock ticks at [`RATE_HZ`]. A robot's policy step begins at the first tick at or after the time given by its own
//! policy rate, so that robots of different rates share a session; inputs take effect with the first step that begins
//! at their tick or later.

use std::sync::Arc;

use rayon::prelude::*;

use super::{Act, AgentCache, Input, Seat, SessionError, Setup};
use crate::config::Simulation;
use crate::mujoco;
use crate::policy::Agent;
use crate::scenario::trace::{Event, EventKind, Frame};
use crate::scenario::{Playback, Script};
use crate::sim::Scene;
use crate::task::Command;
use crate::util::files;

/// Rate of the ticks, the paper's physics rate \[Hz\].
pub const RATE_HZ: u64 = 240;

/// Maximum number of robots in a session.
const MOST_ROBOTS: usize = 2;

/// A policy step of one robot.
#[derive(Debug, Clone)]
pub struct RobotStep {
    /// Index of the robot.
    pub robot: usize,
    /// True if the robot was placed before this step: at the start, or on its feet after a fall.
    pub is_beginning: bool,
    /// The state after the step; `None` if the physics failed.
    pub frame: Option<Arc<Frame>>,
    /// Events that occurred in the step.
    pub events: Vec<Event>,
}

/// One or two robots that receive the same inputs.
#[derive(Debug)]
pub struct LiveSession {
    setup: Setup,
    players: Vec<Player>,
    /// Tick at which this setup started.
    since: u64,
}

struct Player {
    agent: Arc<Agent>,
    script: Script,
    rollout: Playback<'static>,
    is_beginning: bool,
    steps: u64,
    falls: u32,
}

impl std::fmt::Debug for Player {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Player").field("steps", &self.steps).field("falls", &self.falls).finish_non_exhaustive()
    }
}

impl LiveSession {
    /// Starts a session.
    ///
    /// # Errors
    /// A policy, robot or scene cannot be loaded, or the setup does not fit.
    pub fn new(setup: Setup, shelf: &mut AgentCache) -> Result<Self, SessionError> {
        if !(1..=MOST_ROBOTS).contains(&setup.robots.len()) {
            return Err(SessionError::Robots { found: setup.robots.len().to_string(), expected: "one or two".into() });
        }
        let player = |seat: &Seat| Player::new(&setup, seat, shelf.take(seat)?);
        let players = setup.robots.iter().map(player).collect::<Result<_, SessionError>>()?;
        Ok(LiveSession { setup, players, since: 0 })
    }

    /// Sets the tick at which a session that has not been stepped starts.
    pub(super) fn starting_at(self, since: u64) -> Self {
        LiveSession { since, ..self }
    }

    /// Continues with the robots of another session, which has not been stepped: the same as an [`Input::Setup`], but the robots and their
    /// scene were built before, maybe on another thread.
    pub fn replace(&mut self, next: LiveSession) {
        *self = next.starting_at(self.tick());
    }

    methods! {
        /// Returns the present setup.
        fn setup(&self) -> &Setup = &self.setup;
        /// Iterates over the scene of each robot.
        fn scenes(&self) -> impl Iterator<Item = &Scene> = self.players.iter().map(|player| &player.script.scene);
        /// Iterates over the number of falls of each robot.
        fn falls(&self) -> impl Iterator<Item = u32> = self.players.iter().map(|player| player.falls);
        /// Returns the tick at which the next step begins.
        fn tick(&self) -> u64 = self.since + self.players.iter().map(Player::due).min().unwrap_or(0);
    }

    /// Iterates over weight \[N\] and policy period \[s\] of each robot, for [`LiveReadout`](super::LiveReadout).
    pub fn weights_and_periods(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.players.iter().map(|player| {
            let trace = player.rollout.empty_trace();
            (trace.weight_n, trace.period_s)
        })
    }

    /// Iterates over the range of commanded compliance and the own compliance of each robot [m/s/N]; `None` without
    /// calibration.
    pub fn reaches(&self) -> impl Iterator<Item = Option<([f64; 2], [f64; 2])>> + '_ {
        let calibrations = self.players.iter().map(|player| player.agent.calibration.as_ref());
        calibrations.map(|calibration| calibration.map(|found| (found.range(), found.own_m_s_per_n)))
    }

    /// Returns rates, gains and latency of a robot.
    pub fn simulation(&self, robot: usize) -> Option<&Simulation> {
        Some(&self.players.get(robot)?.agent.config.simulation)
    }

    /// Iterates over the mass of each robot \[kg\].
    pub(super) fn masses_kg(&self) -> impl Iterator<Item = f64> + '_ {
        self.players.iter().map(|player| player.script.scene.robot.mass_kg)
    }

    /// Returns the largest commands that all policies were trained for.
    pub fn range(&self) -> Command {
        let ranges = self.players.iter().map(|player| &player.agent.config.command);
        let least = [f64::INFINITY; 3];
        let [forward, left, yaw] = ranges.fold(least, |[forward, left, yaw], range| {
            [forward.min(range.forward_m_s), left.min(range.left_m_s), yaw.min(range.yaw_rad_s)]
        });
        Command::velocity(forward, left, yaw)
    }

    /// Applies an input, which takes effect with the next step of each robot.
    ///
    /// # Errors
    /// The input does not fit the session; the session is then unchanged. Or MuJoCo fails in a reset, which may have reset
    /// the first robot but not the second: the session cannot go on.
    pub fn apply(&mut self, input: &Input, shelf: &mut AgentCache) -> Result<(), SessionError> {
        match input {
            Input::Act(act) => self.act(act)?,
            Input::Renew { robot, sha256 } => {
                let (seat, player) = self.robot(*robot)?;
                let mut renewed = Seat { sha256: sha256.clone(), ..seat.clone() };
                let agent = shelf.renewed(&renewed)?;
                renewed.compliance = agent.resolve_compliance(seat.compliance, None).unwrap_or(None);
                ensure!(agent.config.simulation == player.agent.config.simulation, SessionError::OtherBody);
                player.rollout.hand_over(agent.shared_controller());
                player.rollout.ask(Command { compliance: renewed.compliance, ..*player.rollout.command() });
                *seat = renewed;
                player.agent = agent;
            }
            Input::Setup(setup) => self.replace(Self::new(setup.clone(), shelf)?),
        }
        Ok(())
    }

    fn act(&mut self, act: &Act) -> Result<(), SessionError> {
        ensure!(act.is_finite(), SessionError::NotFinite);
        match act {
            Act::Command(command) => self.rollouts().for_each(|rollout| {
                rollout.ask(Command { compliance: rollout.command().compliance, ..*command });
            }),
            Act::Push { size, unit } => self.rollouts().for_each(|rollout| {
                let linear = unit.velocity(*size, rollout.sim().robot().mass_kg);
                rollout.push(linear);
            }),
            Act::Hand(force) => self.rollouts().for_each(|rollout| rollout.pull(*force)),
            Act::Comply { robot, compliance } => {
                let (seat, player) = self.robot(*robot)?;
                seat.compliance = player.agent.resolve_compliance(*compliance, None)?;
                player.rollout.ask(Command { compliance: seat.compliance, ..*player.rollout.command() });
            }
            Act::Reset => self.players.iter_mut().try_for_each(Player::restart)?,
        }
        Ok(())
    }

    fn robot(&mut self, robot: usize) -> Result<(&mut Seat, &mut Player), SessionError> {
        let expected = format!("0 to {}", self.players.len() - 1);
        let found = self.setup.robots.get_mut(robot).zip(self.players.get_mut(robot));
        found.ok_or_else(|| SessionError::Robots { found: format!("number {robot}"), expected })
    }

    fn rollouts(&mut self) -> impl Iterator<Item = &mut Playback<'static>> {
        self.players.iter_mut().map(|player| &mut player.rollout)
    }

    /// Plays the step of every robot whose step begins at [`LiveSession::tick`], in parallel.
    ///
    /// # Errors
    /// MuJoCo fails even after a reset of the robot.
    pub fn step(&mut self) -> Result<Vec<RobotStep>, SessionError> {
        let tick = self.tick() - self.since;
        let due = self.players.par_iter_mut().enumerate().filter(|(_, player)| player.due() == tick);
        Ok(due.map(|(robot, player)| player.step(robot)).collect::<mujoco::Result<_>>()?)
    }

    /// Returns the SHA-256 of all positions and velocities, to compare states bit by bit.
    pub fn fingerprint(&self) -> String {
        let numbers = self.players.iter().flat_map(|player| {
            let data = player.rollout.sim().data();
            data.positions().iter().chain(data.velocities())
        });
        let bytes: Vec<u8> = numbers.flat_map(|number| number.to_bits().to_le_bytes()).collect();
        files::sha256(&[&bytes])
    }
}

impl Player {
    fn new(setup: &Setup, seat: &Seat, agent: Arc<Agent>) -> Result<Self, SessionError> {
        let mut script = setup.scene.script(setup.seed, &agent.config)?;
        script.command.compliance = agent.resolve_compliance(seat.compliance, None)?;
        let rollout =
            Playback::new(&script, &agent.config, agent.shared_controller())?.with_felt_forces()?.with_bodies();
        Ok(Player { agent, script, rollout, is_beginning: true, steps: 0, falls: 0 })
    }

    /// Returns the start of the next step, counted from the start of the setup \[ticks\].
    fn due(&self) -> u64 {
        (self.steps * RATE_HZ).div_ceil(u64::from(self.agent.config.simulation.policy_rate_hz))
    }

    /// Plays one policy step. Before it, a robot that has lain for a while is set on its feet, and one whose physics failed
    /// is reset to its start.
    fn step(&mut self, robot: usize) -> mujoco::Result<RobotStep> {
        self.steps += 1;
        let played = match self.rollout.next() {
            Some(played) => Some(played),
            None => {
                if self.rollout.has_failed() {
                    self.rollout.restart()?;
                } else {
                    self.rollout.set_on_feet()?;
                }
                self.is_beginning = true;
                self.rollout.next()
            }
        };
        let is_beginning = std::mem::take(&mut self.is_beginning);
        let Some(played) = played else {
            return Ok(RobotStep { robot, is_beginning, frame: None, events: Vec::new() });
        };
        let fell = played.events.iter().filter(|event| event.kind == EventKind::Fall).count();
        self.falls += u32::try_from(fell).unwrap_or(0);
        Ok(RobotStep { robot, is_beginning, frame: played.frame.map(Arc::new), events: played.events })
    }

    fn restart(&mut self) -> mujoco::Result<()> {
        self.is_beginning = true;
        self.rollout.restart()
    }
}
