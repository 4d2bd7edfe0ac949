//! Plays the trials of an experiment on rayon's global pool; results do not depend on the number of threads.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use rayon::prelude::*;

use super::measurement_store::{self, MeasurementStore};
use super::policy_sets::{PolicySet, PolicySets, SetMember};
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
    #[error("cannot write the results of experiment {experiment}: {source}")]
    Store {
        /// The name of the experiment.
        experiment: &'static str,
        /// The file and the reason.
        source: FileError,
    },
    /// A scenario file inside the program is invalid.
    #[error(transparent)]
    Config(#[from] ConfigError),
}

/// An event while an experiment is measured.
#[derive(Debug, Clone, PartialEq)]
pub enum Update {
    /// A trial of this cost was played \[seconds of simulated time\].
    Played(f64),
    /// Another process measures the experiment: this one waits for it. The text says which one it is.
    Waits(String),
}

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

/// Returns the cost of the trials of an experiment that are not measured yet \[seconds of simulated time\].
///
/// # Errors
/// A scenario file inside the program is invalid, which a test rules out.
pub fn remaining_work(
    experiment: &dyn Experiment,
    policies: &PolicySets,
    settings: &Settings,
) -> Result<f64, RunError> {
    let conditions = experiment.conditions()?;
    let of_policy = f64::from(experiment.info().trials) * conditions.iter().map(|c| c.scenario.cost()).sum::<f64>();
    let missing = |(_, member): &(&PolicySet, &SetMember)| {
        let key = measurement_store::key(experiment, &conditions, member, settings.sensing);
        settings.again || settings.store.read(experiment, &key).is_none()
    };
    let policies = policies.members().filter(missing).count();
    Ok(of_policy * policies as f64)
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

/// Measures an experiment with each policy for which the store has no measurement, and reports its progress.
///
/// # Errors
/// A trial cannot be played, or the results cannot be written.
pub fn measure(
    experiment: &dyn Experiment,
    policies: &PolicySets,
    settings: &Settings,
    progress: &(dyn Fn(Update) + Sync),
) -> Result<(), RunError> {
    let (name, conditions) = (experiment.info().name, experiment.conditions()?);
    let store = |source| RunError::Store { experiment: name, source };
    for (_, member) in policies.members() {
        let key = measurement_store::key(experiment, &conditions, member, settings.sensing);
        let is_there = || !settings.again && settings.store.read(experiment, &key).is_some();
        if is_there() {
            continue;
        }
        let waits = |other: &str| progress(Update::Waits(other.to_owned()));
        let _lock = settings.store.lock_experiment(experiment, waits).map_err(store)?;
        // Another process may have measured it meanwhile.
        if is_there() {
            continue;
        }
        let start = Instant::now();
        let samples = play_all(experiment, &conditions, member, settings, progress).map_err(|source| {
            RunError::Trial { experiment: name, policy: member.file.display().to_string(), source }
        })?;
        let wall_s = start.elapsed().as_secs_f64();
        settings.store.write(experiment, &key, member, wall_s, samples).map_err(store)?;
    }
    Ok(())
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
        progress(Update::Played(conditions[index / trials].scenario.cost()));
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
