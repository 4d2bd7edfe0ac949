//! Scenarios for Python: plays a disturbance of a policy and returns metrics, trace and events.

use std::path::{Path, PathBuf};

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use supple::scenario::catalog::{DEFAULTS, ParameterError, Scenario, ScriptError};
use supple::scenario::estimation::{Estimation, felt_forces};
use supple::scenario::metrics::Metric;
use supple::scenario::trace::Trace;
use supple::scenario::{Playback, Script, Sensing};

use crate::failure::{apart, failed, refused};
use crate::policy::Policy;
use crate::trace;

/// Number of policy steps between two checks for Ctrl-C.
const STEPS: usize = 60;

/// Metrics: name, value and unit.
type Numbers = Vec<(&'static str, Option<f64>, &'static str)>;
/// Events: simulation time \[s\], kind and text.
type Events = Vec<(f64, String, String)>;

/// Plays a scenario. Returns metrics, trace, events, and a warning if a disturbance would come after the end.
#[pyfunction]
pub fn run_scenario<'py>(
    py: Python<'py>,
    name: &str,
    policy: &Policy,
    seed: u64,
    estimated: bool,
    parameters: &str,
    record: Option<PathBuf>,
) -> PyResult<(Numbers, Bound<'py, PyDict>, Events, Option<String>)> {
    let scenario = Scenario::named(name, parameters).map_err(refused)?;
    let recorded = |played: Option<(&Script, &Trace)>| {
        record.as_ref().map_or(Ok(()), |path| write_recording(path, scenario.name(), policy, played))
    };
    recorded(None)?;
    let sensing = sensing(estimated);
    let (script, trace) = apart(py, || {
        let mut script = scenario.script(seed, &policy.agent.config).map_err(unfit)?;
        script.command.compliance =
            policy.agent.resolve_compliance(None, script.command.compliance).map_err(refused)?;
        let trace = play(policy, &script, sensing, seed, record.is_some())?;
        recorded(Some((&script, &trace)))?;
        Ok((script, trace))
    })?;
    let mut metrics = scenario.metrics(&script, &trace);
    metrics.extend(felt_forces(&trace));
    if estimated {
        metrics.extend(Estimation::metrics(&trace));
    }
    let metrics = metrics.into_iter().map(|Metric { name, value, unit, .. }| (name, value, unit));
    let events =
        trace.events.iter().map(|event| (event.time_s, format!("{:?}", event.kind).to_lowercase(), event.text.clone()));
    Ok((metrics.collect(), trace::arrays(py, &trace)?, events.collect(), script.too_late()))
}

/// Selects the state that a policy acts on: true or estimated.
pub fn sensing(estimated: bool) -> Sensing {
    if estimated { Sensing::Estimated } else { Sensing::True }
}

fn play(policy: &Policy, script: &Script, sensing: Sensing, seed: u64, with_bodies: bool) -> PyResult<Trace> {
    let config = &policy.agent.config;
    let rollout = Playback::new(script, config, policy.agent.controller()).map_err(failed)?;
    let rollout = rollout.with_felt_forces().map_err(failed)?;
    let rollout = if with_bodies { rollout.with_bodies() } else { rollout };
    let rollout = rollout.with_sensing(sensing, seed).map_err(refused)?;
    let mut trace = rollout.empty_trace();
    for (step, played) in rollout.enumerate() {
        policy.check()?;
        if step % STEPS == 0 {
            Python::attach(|py| py.check_signals())?;
        }
        trace.events.extend(played.events);
        trace.frames.extend(played.frame);
    }
    Ok(trace)
}

/// Writes a recording, if this wheel was built for that; without a playback, only its name is checked.
#[cfg_attr(not(feature = "record"), allow(unused_variables))]
fn write_recording(path: &Path, name: &str, policy: &Policy, played: Option<(&Script, &Trace)>) -> PyResult<()> {
    #[cfg(feature = "record")]
    return match played {
        Some((script, trace)) => supple_record::record(path, name, &policy.name, &script.scene, trace).map_err(failed),
        None => supple_record::check_name(path).map_err(refused),
    };
    #[cfg(not(feature = "record"))]
    played.map_or(Ok(()), |_| Err(pyo3::exceptions::PyRuntimeError::new_err("this wheel was built without recordings")))
}

/// Converts an error, spelling a parameter as a Python argument (`push_m_s`) instead of a flag (`push-m-s`).
fn unfit(error: ScriptError) -> PyErr {
    match error {
        ScriptError::Parameter(ParameterError { name, found, expected }) => {
            PyValueError::new_err(format!("{} is {found}, expected {expected}", name.replace('-', "_")))
        }
        other => refused(other),
    }
}

/// Returns the name of every scenario and its default parameters as YAML.
#[pyfunction]
pub fn scenarios() -> Vec<(&'static str, &'static str)> {
    DEFAULTS.to_vec()
}
