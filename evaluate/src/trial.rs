//! One trial: plays a scenario of a seed with a policy and measures it.

use std::cell::OnceCell;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use rand::RngExt;
use serde::{Deserialize, Serialize};

use super::{Condition, Experiment, ExperimentInfo, FELL, Quantity, TrialValues};
use supple::mujoco;
use supple::policy::Agent;
use supple::scenario::catalog::{Scenario, ScriptError};
use supple::scenario::estimation::Estimation;
use supple::scenario::metrics::{self, Metric, PHASE_S};
use supple::scenario::trace::Trace;
use supple::scenario::{Beginning, Playback, Script, Sensing, SensingError};
use supple::util::random::{Purpose, stream};

/// The reason why a trial cannot be played.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    /// A parameter of the protocol, or the robot, is invalid.
    #[error("a scenario of the protocol cannot be played: {0}")]
    Script(#[from] ScriptError),
    /// The scene does not compile.
    #[error(transparent)]
    Mujoco(#[from] mujoco::Error),
    /// The robot cannot be played with estimated sensing.
    #[error(transparent)]
    Sensing(#[from] SensingError),
}

/// The end of a trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TrialEnd {
    /// The robot stayed on its feet.
    Upright,
    /// The robot fell.
    Fell,
    /// The policy, the physics or the sensors failed; the trial counts as neither a fall nor a success.
    Fault,
    /// The trial was not played, because the policy does not support the compliance that the condition commands.
    OutOfReach,
}

impl TrialEnd {
    /// Reads the end of a trial from its trace.
    pub fn from_trace(trace: &Trace) -> Self {
        match (trace.fall(), trace.fault()) {
            (Some(_), _) => TrialEnd::Fell,
            (None, Some(_)) => TrialEnd::Fault,
            (None, None) => TrialEnd::Upright,
        }
    }

    /// Returns 1 for a fall and 0 for a robot that stayed on its feet; none for a failure or a trial that was not played.
    pub fn fell(self) -> Option<f64> {
        match self {
            TrialEnd::Fell => Some(1.0),
            TrialEnd::Upright => Some(0.0),
            TrialEnd::Fault | TrialEnd::OutOfReach => None,
        }
    }
}

/// The numbers kept of one trial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sample {
    /// The end of the trial.
    pub end: TrialEnd,
    /// The values of the experiment's quantities, in their order; none where the trial leaves one undefined.
    pub values: Vec<Option<f64>>,
    /// The time series that the experiment's figures draw, in the experiment's order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub series: Vec<Vec<f32>>,
    /// The time and the reason of a fault that ended the trial.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fault: Option<String>,
    /// The errors of the state estimates; none if the policy acted on the true state.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub estimation: Option<Estimation>,
}

impl Sample {
    /// Creates the sample of a trial without series, fault and estimates.
    pub fn new(end: TrialEnd, values: Vec<Option<f64>>) -> Self {
        Sample { end, values, series: Vec::new(), fault: None, estimation: None }
    }
}

/// A trial that was played, from which an experiment takes its numbers.
#[derive(Debug)]
pub struct Trial<'a> {
    /// The scenario.
    pub scenario: &'a Scenario,
    /// The script of the scenario for the trial's seed.
    pub script: &'a Script,
    /// The trace of the trial.
    pub trace: &'a Trace,
    /// The end of the trial.
    pub end: TrialEnd,
    metrics: OnceCell<Vec<Metric>>,
}

impl<'a> Trial<'a> {
    /// Creates a trial from a scenario, its script for a seed and the trace of a policy.
    pub fn new(scenario: &'a Scenario, script: &'a Script, trace: &'a Trace) -> Self {
        Trial { scenario, script, trace, end: TrialEnd::from_trace(trace), metrics: OnceCell::new() }
    }

    /// Returns true if the robot stayed on its feet to the end.
    pub fn is_upright(&self) -> bool {
        self.end == TrialEnd::Upright
    }

    /// Returns a metric of the scenario by name.
    pub fn metric(&self, name: &str) -> Option<f64> {
        let metrics = self.metrics.get_or_init(|| self.scenario.metrics(self.script, self.trace));
        metrics.iter().find(|metric| metric.name == name)?.value
    }

    /// Returns a metric of the scenario by name; none if the robot fell.
    pub fn upright_metric(&self, name: &str) -> Option<f64> {
        self.is_upright().then(|| self.metric(name))?
    }

    /// Returns the metrics of the quantities' names, none if the robot fell; [`FELL`] and `success`, no fall, are always defined. The
    /// velocity error is the length of mean velocity minus command in the horizontal plane, from 2 s to the end \[m/s\].
    pub fn upright_metrics(&self, quantities: &[Quantity]) -> TrialValues {
        let value = |quantity: &Quantity| match quantity.name {
            name if name == FELL.name => self.end.fell(),
            "success" => Some(f64::from(u8::from(self.is_upright()))),
            _ if !self.is_upright() => None,
            "velocity_error_m_s" => metrics::velocity_error(self.trace, metrics::SETTLE_S, self.script.duration_s),
            "flight_fraction" => metrics::flight_fraction(self.trace, metrics::SETTLE_S, self.script.duration_s),
            name => self.metric(name),
        };
        quantities.iter().map(value).collect::<Vec<_>>().into()
    }
}

/// Returns the seed of a trial. It does not depend on the policy, so that the trials of two policies of one `seed` are paired.
///
/// `experiment` is the number of the experiment, `condition` the index of the condition.
pub fn trial_seed(seed: u64, experiment: u32, condition: usize, trial: u32) -> u64 {
    // Counter 0 is reserved for the scenarios.
    let condition = u64::from(experiment) << 32 | (1 + condition as u64);
    stream(seed, Purpose::Scenario, condition, 1 + u64::from(trial)).random()
}

/// Returns the scenario with its disturbance delayed by a random time, so that it comes at any phase of the gait.
fn vary(scenario: &Scenario, seed: u64) -> Scenario {
    scenario.later(PHASE_S * stream(seed, Purpose::Scenario, 0, 2).random_range(0.0..1.0))
}

/// Returns the scenario and the script of a trial; none if the policy does not support the commanded compliance: that of the condition,
/// else C of the policy's `NAME@C`.
pub(crate) fn setup(condition: &Condition, seed: u64, agent: &Agent) -> Result<Option<(Scenario, Script)>, TrialError> {
    let scenario = vary(&condition.scenario, seed);
    let mut script = scenario.script(seed, &agent.config)?;
    let Ok(compliance) = agent.resolve_compliance(script.command.compliance, None) else { return Ok(None) };
    script.command.compliance = compliance;
    Ok(Some((scenario, script)))
}

/// A beginning that is played once, by the first trial that needs it.
type SharedBeginning = Arc<OnceLock<Option<Beginning>>>;

/// Undisturbed beginnings that trials of one policy share: a script without disturbances, and its playback until the latest time at which a
/// trial may be disturbed. It is `None` if an event occurs in it, such as a fall.
#[derive(Debug, Default)]
pub struct Beginnings(Mutex<Vec<(Script, SharedBeginning)>>);

impl Beginnings {
    /// Frees their memory.
    pub fn forget(&self) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }

    /// Plays a trial to its end, from the beginning that it shares with other trials.
    fn trace(
        &self,
        playback: Playback<'_>,
        script: &Script,
        agent: &Agent,
        with_felt_forces: bool,
    ) -> mujoco::Result<Trace> {
        let first_s = script.undisturbed_s();
        if script.goal.is_some() || !(first_s > 0.0 && first_s < script.duration_s) {
            return Ok(playback.trace());
        }
        let same = Script { disturbances: Vec::new(), duration_s: 0.0, ..script.clone() };
        let shared = {
            let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            match all.iter().find(|(other, _)| *other == same) {
                Some((_, shared)) => Arc::clone(shared),
                None => {
                    let shared = Arc::default();
                    all.push((same.clone(), Arc::clone(&shared)));
                    shared
                }
            }
        };
        // The disturbances of a condition's trials start within this time of each other.
        let undisturbed = Script { duration_s: first_s + PHASE_S, ..same };
        let play = || {
            let playback = Playback::new(&undisturbed, &agent.config, agent.controller()).ok()?;
            let playback = if with_felt_forces { playback.with_felt_forces().ok()? } else { playback };
            playback.beginning()
        };
        match shared.get_or_init(play) {
            Some(beginning) => playback.trace_after(beginning),
            None => Ok(playback.trace()),
        }
    }
}

/// Plays a trial of an experiment by its index over all conditions, each with all its trials, with a policy of a `seed`.
///
/// # Errors
/// A parameter of the scenario or the robot is invalid, the scene does not compile, or sensing cannot be simulated.
pub fn play_at(
    index: usize,
    experiment: &dyn Experiment,
    conditions: &[Condition],
    seed: u64,
    agent: &Agent,
    sensing: Sensing,
    beginnings: Option<&Beginnings>,
) -> Result<Sample, TrialError> {
    let ExperimentInfo { number, trials, .. } = experiment.info();
    let (condition, trial) = (index / trials as usize, index % trials as usize);
    let seed = trial_seed(seed, number, condition, trial as u32);
    play(experiment, &conditions[condition], seed, agent, sensing, beginnings)
}

/// Plays a trial of an experiment; a condition without a commanded compliance uses C of the policy's `NAME@C`. On the true state, nothing
/// is random before the disturbance: trials share `beginnings` of the same policy and experiment, which is faster and gives the same bits.
fn play(
    experiment: &dyn Experiment,
    condition: &Condition,
    seed: u64,
    agent: &Agent,
    sensing: Sensing,
    beginnings: Option<&Beginnings>,
) -> Result<Sample, TrialError> {
    let Some((scenario, mut script)) = setup(condition, seed, agent)? else {
        return Ok(Sample::new(TrialEnd::OutOfReach, vec![None; experiment.info().quantities.len()]));
    };
    // End the playback at the last measured instant or at the fall.
    script.duration_s = experiment.until_s(&script);
    script.after_fall_s = 0.0;
    let playback = Playback::new(&script, &agent.config, agent.controller())?.with_sensing(sensing, seed)?;
    let playback = if experiment.observes_forces() { playback.with_felt_forces()? } else { playback };
    let trace = match beginnings.filter(|_| sensing == Sensing::True) {
        Some(beginnings) => beginnings.trace(playback, &script, agent, experiment.observes_forces())?,
        None => playback.trace(),
    };
    let trial = Trial::new(&scenario, &script, &trace);
    let TrialValues { values, series } = experiment.measure(&trial);
    let fault = trace.fault().filter(|_| trial.end == TrialEnd::Fault);
    let fault = fault.map(|fault| format!("stopped after {:.2} s: {}", fault.time_s, fault.text));
    Ok(Sample { end: trial.end, values, series, fault, estimation: Estimation::of(&trace) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::Protocol;
    use supple::policy::compliance::{Point, PolicyCalibration};
    use supple::scenario::catalog::{Leash, defaults};

    #[test]
    fn trial_seeds_differ_in_every_coordinate() {
        let seeds = [trial_seed(0, 1, 0, 0), trial_seed(1, 1, 0, 0), trial_seed(0, 2, 0, 0), trial_seed(0, 1, 1, 0)];
        let mut all = [seeds.as_slice(), &[trial_seed(0, 1, 0, 1)]].concat();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), 5);
    }

    #[test]
    fn trial_out_of_compliance_range_has_no_values() {
        let protocol = Protocol::quick().unwrap();
        let mut condition = protocol.leash.conditions().unwrap().remove(0);
        let Scenario::Leash(leash) = &mut condition.scenario else { panic!("{condition:?}") };
        leash.task.compliance = Some(0.03);
        let mut agent = supple::policy::shipped::find("compliant").unwrap();
        let mut play = |low: f64| {
            let points = [low, 0.05].map(|c| Point { commanded: c, measured: [c; 2] }).to_vec();
            let sha256 = agent.sha256.clone();
            agent.calibration =
                Some(PolicyCalibration { sha256, mass_kg: 13.0, own_m_s_per_n: [0.02; 2], tracking: [1.0; 2], points });
            play(&protocol.leash, &condition, 1, &agent, Sensing::True, None).unwrap()
        };
        let refused = play(0.04);
        assert_eq!((refused.end, &refused.values[..]), (TrialEnd::OutOfReach, &[None, None, None][..]));
        assert!(play(0.01).values[1].is_some());
    }

    #[test]
    fn trials_that_share_their_beginning_give_the_same_numbers() {
        let protocol = Protocol::quick().unwrap();
        let mut agent = supple::policy::shipped::find("baseline").unwrap();
        let mut shared_by = Vec::new();
        for experiment in protocol.experiments() {
            let name = experiment.info().name;
            let beginnings = Beginnings::default();
            agent.commanded_compliance = (name == "leash").then_some(0.03);
            // Balls and blocks are slow to simulate and have no disturbance at a fixed time.
            let conditions = experiment.conditions().unwrap();
            let timed = |it: &&Condition| !matches!(it.scenario, Scenario::BallPit(_) | Scenario::Rubble(_));
            for (seed, condition) in conditions.iter().filter(timed).take(2).enumerate() {
                let play = |beginnings| play(experiment, condition, seed as u64, &agent, Sensing::True, beginnings);
                let [alone, shared] = [None, Some(&beginnings)].map(|shared| play(shared).unwrap());
                assert_eq!(alone, shared, "{name}: {}", condition.label);
            }
            let all = beginnings.0.into_inner().unwrap();
            shared_by.extend(all.iter().any(|(_, it)| matches!(it.get(), Some(Some(_)))).then_some(name));
        }
        for name in ["push-grid", "leash", "calibration"] {
            assert!(shared_by.contains(&name), "{name}: {shared_by:?}");
        }
        // A rig carries its load from the start.
        assert!(!shared_by.contains(&"pulley") && !shared_by.contains(&"pendulum"), "{shared_by:?}");
    }

    #[test]
    fn push_grid_trial_ends_after_the_watch() {
        let grid = Protocol::quick().unwrap().push_grid;
        let config = supple::config::Config::load("compliant").unwrap();
        for (seed, condition) in grid.conditions().unwrap().iter().enumerate().take(20) {
            let script = condition.scenario.script(seed as u64, &config).unwrap();
            assert_eq!(grid.until_s(&script), script.pushes().next().unwrap().at_s + grid.watch_s);
            assert!(grid.until_s(&script) < script.duration_s);
        }
    }

    #[test]
    fn pull_starts_at_any_phase() {
        let leash: Leash = defaults("leash").unwrap();
        let config = supple::config::Config::load("compliant").unwrap();
        let starts: Vec<f64> = (0..50)
            .map(|seed| {
                let script = vary(&Scenario::Leash(leash.clone()), seed).script(seed, &config).unwrap();
                let pull = script.pull().unwrap();
                assert!((pull.until_s - pull.from_s - leash.for_s).abs() < 1e-9);
                assert!(script.duration_s >= pull.until_s - 1e-9);
                pull.from_s - leash.at_s
            })
            .collect();
        assert!(starts.iter().all(|late| (0.0..PHASE_S).contains(late)));
        assert!(starts.iter().any(|late| *late < 0.1) && starts.iter().any(|late| *late > 0.5));
    }
}
