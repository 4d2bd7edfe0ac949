//! Policies: ours, external ones, and functions in Python.

use std::sync::{Arc, Mutex, PoisonError};

use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use supple::config::Config;
use supple::policy::{Agent, Buffers, Inference, Meaning, Network, external, shipped};
use supple::robot::{JOINTS, joint_names};

use crate::failure::{apart, refused};

/// The exception that a Python function has raised.
type Raised = Arc<Mutex<Option<PyErr>>>;

/// A policy with the robot, rates, gains and latency that it runs with.
#[pyclass(frozen, module = "supple._supple")]
pub struct Policy {
    pub(crate) name: String,
    pub(crate) agent: Agent,
    /// The exception, for policies that are functions.
    raised: Option<Raised>,
}

#[pymethods]
impl Policy {
    /// A policy file, a run's folder, the YAML file of an external policy, or a shipped one by name.
    #[staticmethod]
    fn load(name: &str) -> PyResult<Self> {
        let agent = shipped::find(name).map_err(refused)?;
        Ok(Policy { name: name.to_owned(), agent, raised: None })
    }

    /// A function from what is observed in the environment of a configuration, shape (length), to an action, shape
    /// (joints), both float32.
    #[staticmethod]
    fn of_function(config: &str, function: Py<PyAny>) -> PyResult<Self> {
        let config = Config::load(config).map_err(refused)?;
        let raised = Raised::default();
        let network = Network::Function(Box::new({
            let raised = Arc::clone(&raised);
            move |seen| act(&function, seen, &raised)
        }));
        let inference = Inference::in_environment(&config, network).map_err(refused)?;
        let agent = Agent::external(inference, config, "a function in Python".into());
        Ok(Policy { name: "function".into(), agent, raised: Some(raised) })
    }

    /// Actions, shape (n, joints), for observations as the network sees them, shape (n, length).
    fn act<'py>(
        &self,
        py: Python<'py>,
        observations: PyReadonlyArray2<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let (inference, rows) = (self.agent.inference(), observations.shape()[0]);
        let seen = observations.as_slice()?.to_vec();
        let actions = apart(py, || Ok(inference.actions(rows, &seen, &mut Buffers::default())))?;
        self.check()?;
        actions.into_pyarray(py).reshape([rows, JOINTS])
    }

    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    /// Identity: SHA-256 of its files.
    #[getter]
    fn sha256(&self) -> &str {
        &self.agent.sha256
    }

    /// Seed of its training, if it is ours.
    #[getter]
    fn seed(&self) -> Option<u64> {
        Some(self.agent.policy()?.provenance.seed)
    }

    /// Name and unit of every number that it sees, before it is scaled.
    fn observation_names(&self) -> Vec<String> {
        self.agent.inference().layout.names()
    }

    /// Names of the joints, in the order of its actions.
    fn action_names(&self) -> Vec<String> {
        let names = joint_names();
        self.agent.inference().layout.order().iter().map(|joint| names[*joint].clone()).collect()
    }

    /// Joint target = offset + scale · action \[rad\], in the order of its actions.
    fn action_scaling<'py>(&self, py: Python<'py>) -> (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>) {
        let Inference { layout, action, .. } = self.agent.inference();
        let offset = |joint: &usize| match action.meaning {
            Meaning::OffsetFromNominal => action.nominal_pose[*joint],
            Meaning::JointAngle => 0.0,
        };
        let offset: Vec<f64> = layout.order().iter().map(offset).collect();
        (offset.into_pyarray(py), action.scale_rad.to_vec().into_pyarray(py))
    }

    fn __reduce__(&self) -> PyResult<()> {
        Err(PyTypeError::new_err("policies cannot be pickled or copied: load them by name where they are needed"))
    }
}

impl Policy {
    /// Returns true for a Python function, which is called on the thread that steps it.
    pub(crate) fn is_function(&self) -> bool {
        self.raised.is_some()
    }

    /// Raises what its function has raised.
    pub(crate) fn check(&self) -> PyResult<()> {
        let raised = self.raised.as_ref().and_then(|raised| lock(raised).take());
        raised.map_or(Ok(()), Err)
    }
}

/// Calls a function. Once it has raised something it is called no more: what it would have answered is not a number.
fn act(function: &Py<PyAny>, seen: &[f32], raised: &Raised) -> [f32; JOINTS] {
    if lock(raised).is_some() {
        return [f32::NAN; JOINTS];
    }
    Python::attach(|py| call(py, function, seen)).unwrap_or_else(|error| {
        *lock(raised) = Some(error);
        [f32::NAN; JOINTS]
    })
}

/// The package in Python sees to it that an answer is twelve finite numbers. A function that is not written in Python does not
/// look for Ctrl-C itself.
fn call(py: Python<'_>, function: &Py<PyAny>, seen: &[f32]) -> PyResult<[f32; JOINTS]> {
    py.check_signals()?;
    let answer = function.bind(py).call1((PyArray1::from_slice(py, seen),))?;
    let answer: PyReadonlyArray1<'_, f32> = answer.extract()?;
    Ok(answer.as_slice()?.try_into()?)
}

fn lock(raised: &Raised) -> std::sync::MutexGuard<'_, Option<PyErr>> {
    raised.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The YAML file that describes an ONNX file of a network that acts in the environment of a configuration.
#[pyfunction]
pub fn describe(config: &str, onnx: &str) -> PyResult<String> {
    Ok(external::describe_network(config, &Config::load(config).map_err(refused)?, onnx))
}
