//! Plays the trials of an experiment on rayon's global pool; results do not depend on the number of threads.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use rayon::prelude::*;

use super::measurement_store::{self, MeasurementStore};
use super::policy_sets::{PolicySets, SetMember};
use super::results::{PolicyResult, Results};
use super::trial::{self, Sample, TrialError};
use super::{Condition, Experiment};
use supple::config::ConfigError;
use supple::scenario::Sensing;
use supple::util::files::FileError;

/// The reason why an experiment was not finished.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// A trial cannot be played.
    #[error("experiment {experiment} with policy {policy}: {source}")]
    Trial {
        /// The name of the experiment.
        experiment: &'static str,
        /// The file of the policy.
        policy: String,
        /// The reason.
        source: TrialError,
    },
    /// The results cannot be written.
    #[error("cannot write the {0}")]
    Store(#[from] FileError),
    /// A scenario file inside the program is invalid.
    #[error(transparent)]
    Config(#[from] ConfigError),
}

/// Trials to play or played, and their cost.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Work {
    /// The number of trials.
    pub trials: u64,
    /// The cost of all of them \[seconds of simulated time\].
    pub cost_s: f64,
}

/// An event while an experiment is measured.
#[derive(Debug, Clone, PartialEq)]
pub enum Update {
    /// Trials were played, by this process or by another.
    Played(Work),
    /// Another process measures the experiment: this one waits for it. The text says which one it is.
    Waits(String),
}

/// The words in the name of a job whose robots act on their sensors.
pub const ON_SENSORS: &str = " on sensors";

/// The settings of measurements.
#[derive(Debug, Clone)]
pub struct Settings {
    /// True to repeat finished measurements.
    pub again: bool,
    /// The state that the policies act on.
    pub sensing: Sensing,
    /// The finished measurements.
    pub store: MeasurementStore,
}

/// The results of an experiment, with the time they took and the programs that measured them.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// The results of all trials.
    pub results: Results,
    /// The time that the trials took when they were played, now or earlier \[s\].
    pub wall_s: f64,
    /// The revisions of the programs that played the trials.
    pub revisions: BTreeSet<String>,
}

/// The trials of one policy in one experiment that are not measured yet.
pub struct Job<'a> {
    /// The text that no other job of a report has: `E1 push-grid on sensors, real-seed1`.
    pub name: String,
    /// The trials.
    pub work: Work,
    experiment: &'a dyn Experiment,
    conditions: Vec<Condition>,
    member: &'a SetMember,
    settings: &'a Settings,
    key: String,
}

/// Returns the jobs of an experiment, one for each policy whose trials are not measured yet. `way` says in their names how the
/// robots are played.
///
/// # Errors
/// A scenario file inside the program is invalid, which a test rules out.
pub fn jobs<'a>(
    experiment: &'a dyn Experiment,
    policies: &'a PolicySets,
    settings: &'a Settings,
    way: &str,
) -> Result<Vec<Job<'a>>, RunError> {
    let (info, conditions) = (experiment.info(), experiment.conditions()?);
    let cost_s = f64::from(info.trials) * conditions.iter().map(|c| c.scenario.cost()).sum::<f64>();
    let work = Work { trials: u64::from(info.trials) * conditions.len() as u64, cost_s };
    let mut jobs: Vec<Job> = Vec::new();
    for (set, member) in policies.members() {
        let key = measurement_store::key(experiment, &conditions, member, settings.sensing);
        // A policy that two sets have is measured once.
        if !jobs.iter().any(|job| job.key == key) && (settings.again || settings.store.read(experiment, &key).is_none())
        {
            let name = format!("{} {}{way}, {}", info.id, info.name, PolicySets::member_name(set, member));
            let conditions = conditions.clone();
            jobs.push(Job { name, work, experiment, conditions, member, settings, key });
        }
    }
    Ok(jobs)
}

/// Returns the results of an experiment; none if some are not measured yet.
///
/// # Errors
/// A scenario file inside the program is invalid, which a test rules out.
pub fn finished(
    experiment: &dyn Experiment,
    policies: &PolicySets,
    store: &MeasurementStore,
    sensing: Sensing,
) -> Result<Option<Measurement>, RunError> {
    let conditions = experiment.conditions()?;
    let (mut sets, mut wall_s, mut revisions) = (Vec::new(), 0.0, BTreeSet::new());
    for set in &policies.sets {
        let mut by_seed = BTreeMap::new();
        for member in &set.members {
            let key = measurement_store::key(experiment, &conditions, member, sensing);
            let Some(stored) = store.read(experiment, &key) else { return Ok(None) };
            wall_s += stored.wall_s;
            revisions.insert(stored.revision);
            by_seed.insert(stored.seed, stored.samples);
        }
        sets.push(by_seed);
    }
    let results = Results { names: policies.names(), conditions, quantities: experiment.info().quantities, sets };
    Ok(Some(Measurement { results, wall_s, revisions }))
}

impl Job<'_> {
    /// Plays the trials and keeps their numbers; returns false if another process has measured them meanwhile.
    ///
    /// # Errors
    /// A trial cannot be played, or the results cannot be written.
    pub fn run(&self, progress: &(dyn Fn(Update) + Sync)) -> Result<bool, RunError> {
        let Job { experiment, conditions, member, settings, key, .. } = self;
        let waits = |other: &str| progress(Update::Waits(other.to_owned()));
        let is_there = || !settings.again && settings.store.read(*experiment, key).is_some();
        let lock = if is_there() { None } else { Some(settings.store.lock_experiment(*experiment, waits)?) };
        if lock.is_none() || is_there() {
            progress(Update::Played(self.work));
            return Ok(false);
        }
        let start = Instant::now();
        let fail = |source| {
            let (experiment, policy) = (experiment.info().name, member.file.display().to_string());
            RunError::Trial { experiment, policy, source }
        };
        let samples = play_all(*experiment, conditions, member, settings, progress).map_err(fail)?;
        settings.store.write(*experiment, key, member, start.elapsed().as_secs_f64(), samples)?;
        Ok(true)
    }
}

/// Plays all trials of one policy, shape (conditions, trials). If several fail, it returns the error of the first of them.
fn play_all(
    experiment: &dyn Experiment,
    conditions: &[Condition],
    member: &SetMember,
    settings: &Settings,
    progress: &(dyn Fn(Update) + Sync),
) -> Result<PolicyResult, TrialError> {
    let trials = experiment.info().trials as usize;
    let play = |index: usize| {
        let sample = trial::play_at(index, experiment, conditions, member.seed, &member.agent, settings.sensing)?;
        progress(Update::Played(Work { trials: 1, cost_s: conditions[index / trials].scenario.cost() }));
        Ok(sample)
    };
    // All are played: which of them fails first would depend on the threads.
    let played: Vec<Result<Sample, TrialError>> = (0..conditions.len() * trials).into_par_iter().map(play).collect();
    let mut samples = played.into_iter();
    conditions.iter().map(|_| samples.by_ref().take(trials).collect::<Result<Vec<Sample>, TrialError>>()).collect()
}

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    use super::*;
    use crate::protocol::Protocol;

    #[test]
    fn error_is_that_of_the_first_trial_that_fails() {
        let mut agent = supple::policy::shipped::find("compliant").unwrap();
        // Sensors cannot be simulated at this rate, which is found when the terrain has been made and compiled.
        (agent.config.simulation.physics_rate_hz, agent.config.simulation.policy_rate_hz) = (200, 50);
        let member = SetMember { seed: 0, file: PathBuf::from("x"), agent };
        let mut terrain = Protocol::quick().unwrap().terrain;
        // The second height is refused at once.
        (terrain.heights_m, terrain.frequencies_per_m, terrain.trials) = (vec![0.05, 3.0], vec![0.5], 1);
        let conditions = terrain.conditions().unwrap();
        let store = MeasurementStore::new(Path::new("nowhere"));
        let settings = Settings { again: false, sensing: Sensing::Estimated, store };
        let threads = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
        let error = threads.install(|| play_all(&terrain, &conditions, &member, &settings, &|_| ())).unwrap_err();
        assert!(matches!(error, TrialError::Sensing(_)), "{error}");
    }
}
