/*! Plays the trials of all experiments and policies on rayon's global pool, in one queue, the longest first.

Results do not depend on the number of threads. Those of a policy in an experiment are kept as soon as its last trial is played.
*/

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::measurement_store::{self, MeasurementStore};
use super::policy_sets::{PolicySet, SetMember};
use super::results::{PolicyResult, Results};
use super::trial::{self, Beginnings, Sample, TrialError};
use super::{Condition, Experiment};
use supple::config::ConfigError;
use supple::scenario::Sensing;
use supple::util::files::FileError;

/// The reason why an experiment was not finished.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// A trial cannot be played.
    #[error("experiment {0} with policy {1}: {2}")]
    Trial(&'static str, PathBuf, #[source] TrialError),
    /// The results cannot be written.
    #[error("cannot write the {0}")]
    Store(#[from] FileError),
    /// A scenario file inside the program is invalid.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The progress function asks to stop.
    #[error("stopped before all trials were played")]
    Stopped,
}

/// Trials to play or played, and their cost.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Work {
    /// The number of trials.
    pub trials: u64,
    /// The cost of all of them \[seconds of simulated time\].
    pub cost_s: f64,
}

/// An event while trials are played.
pub enum Update<'a> {
    /// A trial begins.
    Begins,
    /// Trials of the job were played, by this process or by another.
    Played(&'a Job<'a>, Work),
    /// The numbers of the job are kept; its trials took this time \[s\].
    Finished(&'a Job<'a>, f64),
    /// This process waits for another one, described by the text, which measures an experiment.
    Waits(&'a str),
}

/// A function that receives updates, on any thread; its error, usually [`RunError::Stopped`], ends the run.
pub type Progress<'p> = dyn Fn(Update) -> Result<(), RunError> + Sync + 'p;

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
    /// The name, unique within a report: `E1 push-grid on sensors, real-seed1`.
    pub name: String,
    /// The trials.
    pub work: Work,
    experiment: &'a dyn Experiment,
    conditions: Vec<Condition>,
    member: &'a SetMember,
    settings: &'a Settings,
    key: String,
}

/// Returns the jobs of an experiment, one for each policy whose trials are not measured yet. `way` is the part of their names for the way
/// in which the robots are played.
///
/// # Errors
/// A scenario file inside the program is invalid, which a test rules out.
pub fn jobs<'a>(
    experiment: &'a dyn Experiment,
    sets: &'a [PolicySet],
    settings: &'a Settings,
    way: &str,
) -> Result<Vec<Job<'a>>, RunError> {
    let (info, conditions) = (experiment.info(), experiment.conditions()?);
    let cost_s = f64::from(info.trials) * conditions.iter().map(|c| c.scenario.cost()).sum::<f64>();
    let work = Work { trials: u64::from(info.trials) * conditions.len() as u64, cost_s };
    let mut jobs: Vec<Job> = Vec::new();
    for (set, member) in sets.iter().flat_map(PolicySet::with_members) {
        let key = measurement_store::key(experiment, &conditions, member, settings.sensing);
        // A policy that two sets have is measured once.
        if !jobs.iter().any(|job| job.key == key) && (settings.again || settings.store.read(experiment, &key).is_none())
        {
            let name = format!("{} {}{way}, {}", info.id, info.name, set.member_name(member));
            let conditions = conditions.clone();
            jobs.push(Job { name, work, experiment, conditions, member, settings, key });
        }
    }
    Ok(jobs)
}

/// Returns the results of an experiment; none if some are not measured yet.
pub(crate) fn finished(
    experiment: &dyn Experiment,
    policies: &[PolicySet],
    store: &MeasurementStore,
    sensing: Sensing,
) -> Result<Option<Measurement>, RunError> {
    let conditions = experiment.conditions()?;
    let (mut sets, mut wall_s, mut revisions) = (Vec::new(), 0.0, BTreeSet::new());
    for set in policies {
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
    let results = Results {
        names: policies.iter().map(|set| set.name.clone()).collect(),
        conditions,
        quantities: experiment.info().quantities,
        sets,
    };
    Ok(Some(Measurement { results, wall_s, revisions }))
}

/// Plays the trials of all jobs and keeps their numbers. Jobs that another process measures come last, and are skipped if that process
/// finishes them.
///
/// # Errors
/// A trial cannot be played, or the results cannot be written. If several trials fail, the error is that of the first of them in the order
/// of the jobs; later trials are skipped.
pub fn run(jobs: &[Job], progress: &Progress) -> Result<(), RunError> {
    let mut left: Vec<&Job> = jobs.iter().collect();
    while let Some(first) = left.first() {
        let mut locks: BTreeMap<&str, Option<Arc<File>>> = BTreeMap::new();
        for job in &left {
            let name = job.experiment.info().name;
            if !locks.contains_key(name) {
                locks.insert(name, job.settings.store.try_lock_experiment(job.experiment)?.map(Arc::new));
            }
        }
        if locks.values().all(Option::is_none) {
            let waits = |other: &str| drop(progress(Update::Waits(other)));
            let lock = first.settings.store.lock_experiment(first.experiment, waits)?;
            locks.insert(first.experiment.info().name, Some(Arc::new(lock)));
        }
        let (mut queue, mut others) = (Vec::new(), Vec::new());
        for job in left {
            match &locks[job.experiment.info().name] {
                None => others.push(job),
                Some(_) if job.is_done() => progress(Update::Played(job, job.work))?,
                Some(lock) => queue.push(Active::new(job, Arc::clone(lock))),
            }
        }
        drop(locks);
        play(&queue, progress)?;
        left = others;
    }
    Ok(())
}

impl Job<'_> {
    fn is_done(&self) -> bool {
        !self.settings.again && self.settings.store.read(self.experiment, &self.key).is_some()
    }

    /// Returns the cost of a trial \[seconds of simulated time\].
    fn cost_s(&self, index: usize) -> f64 {
        self.conditions[index / self.experiment.info().trials as usize].scenario.cost()
    }

    fn play(&self, index: usize, beginnings: &Beginnings) -> Result<Sample, TrialError> {
        let Job { experiment, conditions, member, settings, .. } = self;
        trial::play_at(index, *experiment, conditions, member.seed, &member.agent, settings.sensing, Some(beginnings))
    }
}

/// A job in the queue.
struct Active<'a> {
    job: &'a Job<'a>,
    beginnings: Beginnings,
    played: Mutex<Played>,
}

/// The trials of a job that were played.
struct Played {
    /// The samples by index.
    samples: Vec<Option<Sample>>,
    /// The number of trials that are not played yet.
    left: usize,
    /// The time of all threads.
    took: Duration,
    /// Keeps other processes from measuring the same, until all are played.
    lock: Option<Arc<File>>,
}

impl<'a> Active<'a> {
    fn new(job: &'a Job<'a>, lock: Arc<File>) -> Self {
        let left = job.work.trials as usize;
        let played = Played { samples: vec![None; left], left, took: Duration::ZERO, lock: Some(lock) };
        Active { job, beginnings: Beginnings::default(), played: Mutex::new(played) }
    }

    /// Plays one trial, and keeps the job's numbers after the last one.
    fn play(&self, index: usize, progress: &Progress) -> Result<(), RunError> {
        let Job { experiment, conditions, member, settings, key, .. } = self.job;
        progress(Update::Begins)?;
        let start = Instant::now();
        let fail = |error| RunError::Trial(experiment.info().name, member.file.clone(), error);
        let sample = self.job.play(index, &self.beginnings).map_err(fail)?;
        let mut played = self.played.lock().unwrap_or_else(PoisonError::into_inner);
        played.samples[index] = Some(sample);
        played.took += start.elapsed();
        played.left -= 1;
        progress(Update::Played(self.job, Work { trials: 1, cost_s: self.job.cost_s(index) }))?;
        if played.left == 0 {
            let wall_s = played.took.as_secs_f64() / rayon::current_num_threads() as f64;
            let trials = experiment.info().trials as usize;
            let mut all = std::mem::take(&mut played.samples).into_iter().flatten();
            let by_condition: PolicyResult = conditions.iter().map(|_| all.by_ref().take(trials).collect()).collect();
            settings.store.write(*experiment, key, member, wall_s, by_condition)?;
            progress(Update::Finished(self.job, wall_s))?;
            played.lock = None;
            self.beginnings.forget();
        }
        Ok(())
    }
}

/// Plays all trials of a queue, the longest first.
fn play(queue: &[Active], progress: &Progress) -> Result<(), RunError> {
    let trials: Vec<(&Active, usize)> =
        queue.iter().flat_map(|it| (0..it.job.work.trials as usize).map(move |index| (it, index))).collect();
    let mut order: Vec<usize> = (0..trials.len()).collect();
    order.sort_by(|a, b| {
        let [a, b] = [a, b].map(|&place| trials[place].0.job.cost_s(trials[place].1));
        b.total_cmp(&a)
    });
    // The reported failure must not depend on the threads.
    let (next, failed) = (AtomicUsize::new(0), Mutex::new(None::<(usize, RunError)>));
    rayon::broadcast(|_| {
        while let Some(&place) = order.get(next.fetch_add(1, Ordering::Relaxed)) {
            let first = || failed.lock().unwrap_or_else(PoisonError::into_inner);
            if first().as_ref().is_some_and(|(earlier, _)| *earlier < place) {
                continue;
            }
            let (active, index) = trials[place];
            if let Err(error) = active.play(index, progress) {
                let mut first = first();
                if first.as_ref().is_none_or(|(earlier, _)| place < *earlier) {
                    *first = Some((place, error));
                }
            }
        }
    });
    match failed.into_inner().unwrap_or_else(PoisonError::into_inner) {
        Some((_, error)) => Err(error),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
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
        let folder = tempfile::tempdir().unwrap();
        let store = MeasurementStore::new(folder.path());
        let settings = Settings { again: false, sensing: Sensing::Estimated, store };
        let work = Work { trials: conditions.len() as u64, cost_s: 1.0 };
        let (name, key) = (String::new(), "0123456789abcdef".to_owned());
        let job = Job { name, work, experiment: &terrain, conditions, member: &member, settings: &settings, key };
        let threads = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
        let error = threads.install(|| run(&[job], &|_| Ok(()))).unwrap_err();
        assert!(matches!(error, RunError::Trial(_, _, TrialError::Sensing(_))), "{error}");
    }
}
