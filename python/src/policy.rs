//! Policies for Python: policy files, external policies, and Python functions.

use std::sync::{Arc, Mutex, PoisonError};

use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use supple::config::Config;
use supple::policy::{Agent, Inference, InferenceBuffers, Meaning, Network, external, shipped};
use supple::robot::{JOINTS, joint_name, joint_names};

use crate::failure::{apart, refused};

/// The exception that a policy function raised, if any.
type Raised = Arc<Mutex<Option<PyErr>>>;

/// A policy with the robot, rates, gains and latency that it runs with.
#[pyclass(frozen, module = "supple._supple")]
pub struct Policy {
    pub(crate) name: String,
    pub(crate) agent: Agent,
    /// The exception raised by the function; `None` for other policies.
    raised: Option<Raised>,
}

#[pymethods]
impl Policy {
    /// Loads a policy file, a run's folder, the YAML file of an external policy, or a shipped policy by name.
    #[staticmethod]
    fn load(py: Python<'_>, name: &str) -> PyResult<Self> {
        let agent = apart(py, || shipped::find(name).map_err(refused))?;
        Ok(Policy { name: name.to_owned(), agent, raised: None })
    }

    /// Wraps a Python function from the normalised observation of the environment of `config`, shape (length), to an action,
    /// shape (12), both float32.
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

    /// Returns actions, float32 (n, 12), for normalised observations, float32 (n, length). Actions that are not finite are a
    /// ValueError.
    fn act<'py>(
        &self,
        py: Python<'py>,
        observations: PyReadonlyArray2<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        if self.agent.commanded_compliance.is_some() && self.agent.config.reward.reference_m_s_per_n.is_none() {
            let words = "commands a compliance, which acts around the network, in scenarios: give the name without '@'";
            return Err(PyValueError::new_err(format!("{} {words}", self.name)));
        }
        let (inference, rows) = (self.agent.inference(), observations.shape()[0]);
        let seen = observations.as_slice()?.to_vec();
        let actions = apart(py, || Ok(inference.actions(rows, &seen, &mut InferenceBuffers::default())))?;
        self.check()?;
        if let Some(at) = actions.iter().position(|action| !action.is_finite()) {
            let (name, row, joint) = (&self.name, at / JOINTS, joint_name(inference.layout.order()[at % JOINTS]));
            return Err(PyValueError::new_err(format!(
                "{name}: the action of {joint} is {}: the policy cannot cope with the observation in row {row}",
                actions[at]
            )));
        }
        actions.into_pyarray(py).reshape([rows, JOINTS])
    }

    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    /// SHA-256 of the policy's files, which identifies it.
    #[getter]
    fn sha256(&self) -> &str {
        &self.agent.sha256
    }

    /// Seed of the training run; `None` for external policies and functions.
    #[getter]
    fn seed(&self) -> Option<u64> {
        Some(self.agent.policy()?.provenance.seed)
    }

    /// Returns the name and the unit of every number of an observation, before it is scaled.
    fn observation_names(&self) -> Vec<String> {
        self.agent.inference().layout.names()
    }

    /// Returns the names of the joints in the order of the policy's actions.
    fn action_names(&self) -> Vec<String> {
        let names = joint_names();
        self.agent.inference().layout.order().iter().map(|joint| names[*joint].clone()).collect()
    }

    /// Returns offset and scale of each action: joint target \[rad\] = offset + scale · action.
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

    /// Raises the exception that the policy function raised, if any.
    pub(crate) fn check(&self) -> PyResult<()> {
        let raised = self.raised.as_ref().and_then(|raised| lock(raised).take());
        raised.map_or(Ok(()), Err)
    }
}

/// Calls a policy function. After an exception it is not called again, and the actions are NaN.
fn act(function: &Py<PyAny>, seen: &[f32], raised: &Raised) -> [f32; JOINTS] {
    if lock(raised).is_some() {
        return [f32::NAN; JOINTS];
    }
    Python::attach(|py| call(py, function, seen)).unwrap_or_else(|error| {
        *lock(raised) = Some(error);
        [f32::NAN; JOINTS]
    })
}

/// Calls the function once, after a check for Ctrl-C. The Python half of the package has checked that it returns twelve finite numbers.
fn call(py: Python<'_>, function: &Py<PyAny>, seen: &[f32]) -> PyResult<[f32; JOINTS]> {
    py.check_signals()?;
    let answer = function.bind(py).call1((PyArray1::from_slice(py, seen),))?;
    let answer: PyReadonlyArray1<'_, f32> = answer.extract()?;
    Ok(answer.as_slice()?.try_into()?)
}

fn lock(raised: &Raised) -> std::sync::MutexGuard<'_, Option<PyErr>> {
    raised.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns the YAML text that describes an ONNX network trained in the environment of `config`.
#[pyfunction]
pub fn describe(config: &str, onnx: &str) -> PyResult<String> {
    Ok(external::describe_network(config, &Config::load(config).map_err(refused)?, onnx))
}
