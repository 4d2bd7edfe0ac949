/*! The experiments of the paper for Python: measures one policy and returns arrays.

Trials have the scenarios and seeds of the program `evaluate`: two policies are paired trial by trial, and a policy file gives
the numbers that the program stores.
*/

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use numpy::{IntoPyArray, PyArray2, PyArray3, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use supple::scenario::Sensing;
use supple_evaluate::policy_sets::PolicySets;
use supple_evaluate::protocol::Protocol;
use supple_evaluate::report::{CommandLine, Report, summary};
use supple_evaluate::runner::{self, RunError};
use supple_evaluate::study::Study;
use supple_evaluate::trial::{self, Beginnings, Sample, TrialEnd};
use supple_evaluate::{Condition, Experiment};

use crate::failure::{apart, failed, refused};
use crate::policy::Policy;
use crate::scenario::sensing;

/// Time between two checks for Ctrl-C.
const WAIT: Duration = Duration::from_millis(20);

/// An experiment: name, conditions, quantities, values of shape (conditions, trials, quantities), ends of shape
/// (conditions, trials).
type Measured<'py> =
    (&'static str, Vec<String>, Vec<&'static str>, Bound<'py, PyArray3<f64>>, Bound<'py, PyArray2<i8>>);

/// Measures a policy in the named experiments, or in all of them.
#[pyfunction]
pub fn evaluate<'py>(
    py: Python<'py>,
    policy: &Policy,
    experiments: Option<Vec<String>>,
    protocol: &str,
    seed: u64,
    estimated: bool,
    threads: usize,
) -> PyResult<Vec<Measured<'py>>> {
    let protocol = self::protocol(protocol)?;
    check(&protocol, experiments.iter().flatten())?;
    let wanted = |name: &str| experiments.as_ref().is_none_or(|wanted| wanted.iter().any(|known| known == name));
    let mut measured = Vec::new();
    for experiment in protocol.experiments().into_iter().filter(|experiment| wanted(experiment.info().name)) {
        let conditions = experiment.conditions().map_err(refused)?;
        let sensing = sensing(estimated);
        let beginnings = (!policy.is_function()).then(Beginnings::default);
        let work = Work { experiment, conditions: &conditions, policy, seed, sensing, beginnings };
        let samples = apart(py, || work.play(threads))?;
        let info = experiment.info();
        let shape = [conditions.len(), experiment.info().trials as usize];
        let values = samples.iter().flat_map(|sample| sample.values.iter().map(|value| value.unwrap_or(f64::NAN)));
        let values = values.collect::<Vec<_>>().into_pyarray(py);
        let ends = samples.iter().map(|sample| match sample.end {
            TrialEnd::Upright => 0,
            TrialEnd::Fell => 1,
            TrialEnd::Fault => 2,
            TrialEnd::OutOfReach => 3,
        });
        measured.push((
            info.name,
            conditions.into_iter().map(|condition| condition.label).collect(),
            info.quantities.iter().map(|quantity| quantity.name).collect(),
            values.reshape([shape[0], shape[1], info.quantities.len()])?,
            ends.collect::<Vec<i8>>().into_pyarray(py).reshape(shape)?,
        ));
    }
    Ok(measured)
}

/// An experiment, its conditions and the policy to measure.
struct Work<'a> {
    experiment: &'a dyn Experiment,
    conditions: &'a [Condition],
    policy: &'a Policy,
    seed: u64,
    sensing: Sensing,
    /// None for functions, which must be called once for each step.
    beginnings: Option<Beginnings>,
}

impl Work<'_> {
    /// Plays all trials and returns them by condition and trial. Policy functions run on the calling thread. Ctrl-C ends it.
    fn play(&self, threads: usize) -> PyResult<Vec<Sample>> {
        let count = self.conditions.len() * self.experiment.info().trials as usize;
        let (next, stop) = (AtomicUsize::new(0), AtomicBool::new(false));
        let played: Mutex<Vec<(usize, PyResult<Sample>)>> = Mutex::new(Vec::with_capacity(count));
        let worker = || {
            while !stop.load(Ordering::Relaxed) {
                let index = next.fetch_add(1, Ordering::Relaxed);
                if index >= count {
                    return;
                }
                let sample = self.trial(index);
                if sample.is_err() {
                    stop.store(true, Ordering::Relaxed);
                }
                played.lock().unwrap_or_else(PoisonError::into_inner).push((index, sample));
            }
        };
        if self.policy.is_function() {
            worker();
        } else {
            let all = || {
                std::thread::scope(|scope| (0..threads.clamp(1, count.max(1))).for_each(|_| drop(scope.spawn(worker))))
            };
            interruptibly(&stop, || {
                all();
                Ok(())
            })?;
        }
        let mut played = played.into_inner().unwrap_or_else(PoisonError::into_inner);
        played.sort_by_key(|(index, _)| *index);
        played.into_iter().map(|(_, sample)| sample).collect()
    }

    fn trial(&self, index: usize) -> PyResult<Sample> {
        let Work { experiment, conditions, policy, seed, sensing, beginnings } = self;
        // The sample is invalid if a policy function has raised.
        let sample =
            trial::play_at(index, *experiment, conditions, *seed, &policy.agent, *sensing, beginnings.as_ref());
        policy.check()?;
        sample.map_err(failed)
    }
}

/// Checks the names of experiments.
fn check<'a>(protocol: &Protocol, mut experiments: impl Iterator<Item = &'a String>) -> PyResult<()> {
    let known: Vec<&str> = protocol.experiments().iter().map(|experiment| experiment.info().name).collect();
    experiments.find(|name| !known.contains(&name.as_str())).map_or(Ok(()), |unknown| {
        Err(PyValueError::new_err(format!("no experiment '{unknown}'; there are: {}", known.join(", "))))
    })
}

/// Measures sets of policies, given by name and path, of which the first two are compared, and returns the report's summary as
/// JSON. The numbers are kept in the folder `out`, and so are not measured again.
#[pyfunction]
pub fn compare(
    py: Python<'_>,
    sets: Vec<(String, PathBuf)>,
    experiments: Vec<String>,
    protocol: &str,
    estimated: bool,
    threads: usize,
    out: PathBuf,
) -> PyResult<String> {
    let name = protocol.to_owned();
    let protocol = self::protocol(protocol)?;
    check(&protocol, experiments.iter())?;
    let policies = PolicySets::from_paths(&sets).map_err(refused)?;
    let compared = PolicySets::from_paths(&sets[..sets.len().min(2)]).map_err(refused)?;
    let study = Study::new(&protocol, &policies, &compared, &out, false);
    let stop = AtomicBool::new(false);
    let progress = |_: runner::Update| {
        if stop.load(Ordering::Relaxed) { Err(RunError::Stopped) } else { Ok(()) }
    };
    let measure = || {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(failed)?;
        let run = |jobs: &[runner::Job]| pool.install(|| runner::run(jobs, &progress));
        study.measure(&experiments, sensing(estimated), run).map_err(failed)
    };
    apart(py, || interruptibly(&stop, measure))?;
    let mut report = Report::new(&policies, name, CommandLine { experiments, options: Vec::new() });
    study.add_to(&mut report).map_err(failed)?;
    Ok(summary::json(&report))
}

/// Does work on a thread of its own; Ctrl-C sets `stop`, and its exception replaces the result.
fn interruptibly<T: Send>(stop: &AtomicBool, work: impl FnOnce() -> PyResult<T> + Send) -> PyResult<T> {
    std::thread::scope(|scope| {
        let worker = scope.spawn(work);
        let mut signals = Ok(());
        while signals.is_ok() && !worker.is_finished() {
            std::thread::sleep(WAIT);
            signals = Python::attach(|py| py.check_signals());
        }
        stop.store(true, Ordering::Relaxed);
        let done = worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        signals.and(done)
    })
}

fn protocol(name: &str) -> PyResult<Protocol> {
    match name {
        "full" => Protocol::full(),
        "quick" => Protocol::quick(),
        path => Protocol::load(Path::new(path)),
    }
    .map_err(refused)
}

/// Returns the name and the title of every experiment.
#[pyfunction]
pub fn experiments() -> PyResult<Vec<(&'static str, &'static str)>> {
    let protocol = Protocol::full().map_err(refused)?;
    Ok(protocol.experiments().iter().map(|experiment| (experiment.info().name, experiment.info().title)).collect())
}
