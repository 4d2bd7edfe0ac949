/*! The experiments of the paper for Python: measures one policy and returns arrays.

Trials have the scenarios and seeds of the program `evaluate`: two policies are paired trial by trial, and a policy file gives
the numbers that the program stores.
*/

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use numpy::{IntoPyArray, PyArray2, PyArray3, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use supple_evaluate::policy_sets::PolicySets;
use supple_evaluate::protocol::Protocol;
use supple_evaluate::report::{CommandLine, Report, summary};
use supple_evaluate::runner::{self, RunError};
use supple_evaluate::study::Study;
use supple_evaluate::trial::{self, Beginnings, Sample};

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
        let (info, sensing, stop) = (experiment.info(), sensing(estimated), AtomicBool::new(false));
        let shape = [conditions.len(), info.trials as usize];
        // None for functions, which must be called once for each step.
        let beginnings = (!policy.is_function()).then(Beginnings::default);
        let trial = |index: usize| {
            if stop.load(Ordering::Relaxed) {
                return Err(failed(RunError::Stopped));
            }
            let agent = &policy.agent;
            let sample = trial::play_at(index, experiment, &conditions, seed, agent, sensing, beginnings.as_ref());
            // The sample is invalid if a policy function has raised.
            policy.check()?;
            sample.map_err(failed)
        };
        let trials = 0..shape[0] * shape[1];
        // Policy functions run on the calling thread.
        let samples: Vec<Sample> = if policy.is_function() {
            apart(py, || trials.map(trial).collect::<PyResult<_>>())?
        } else {
            let trials = trials.into_par_iter().with_max_len(1).map(trial);
            apart(py, || interruptibly(&stop, || pool(threads)?.install(|| trials.collect::<PyResult<_>>())))?
        };
        let values = samples.iter().flat_map(|sample| sample.values.iter().map(|value| value.unwrap_or(f64::NAN)));
        let values = values.collect::<Vec<_>>().into_pyarray(py);
        let ends = samples.iter().map(|sample| sample.end as i8); // Indices into `ENDS` of the Python half.
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
    let study = Study::new(&protocol, &policies.sets, &out, false);
    let stop = AtomicBool::new(false);
    let progress = |_: runner::Update| {
        if stop.load(Ordering::Relaxed) { Err(RunError::Stopped) } else { Ok(()) }
    };
    let measure = || {
        let pool = pool(threads)?;
        let run = |jobs: &[runner::Job]| pool.install(|| runner::run(jobs, &progress));
        study.measure(&experiments, sensing(estimated), run).map_err(failed)
    };
    apart(py, || interruptibly(&stop, measure))?;
    let mut report = Report::new(&policies, name, CommandLine { experiments, options: Vec::new() });
    study.add_to(&mut report).map_err(failed)?;
    Ok(summary::json(&report))
}

fn pool(threads: usize) -> PyResult<ThreadPool> {
    ThreadPoolBuilder::new().num_threads(threads).build().map_err(failed)
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
