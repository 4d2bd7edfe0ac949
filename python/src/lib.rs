/*! The native half of the Python package `supple`: environments, policies, scenarios and experiments.

The public half is in `lib/supple/`, written in Python, and calls this one; start with `environments`. Everything long runs
without the interpreter's lock, returned arrays are not copied, and a panic becomes a Python exception: see `failure`.
*/

mod environments;
mod evaluation;
mod failure;
mod policy;
mod scenario;
mod trace;

use pyo3::prelude::*;

/// The native module that `lib/supple/` imports; `_supple.pyi` has its types.
#[pymodule]
mod _supple {
    #[pymodule_export]
    use super::environments::{Environments, cores};
    #[pymodule_export]
    use super::evaluation::{compare, evaluate, experiments};
    #[pymodule_export]
    use super::failure::panic;
    #[pymodule_export]
    use super::policy::{Policy, describe};
    #[pymodule_export]
    use super::scenario::{run_scenario, scenarios};

    use super::{Bound, PyModule, PyModuleMethods, PyResult};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("RECORDS", cfg!(feature = "record"))?;
        supple::announce_revision!();
        module.add("REVISION", supple::provenance::git_revision())?;
        module.add("CONFIGURATIONS", supple::config::EMBEDDED.iter().map(|(name, _)| *name).collect::<Vec<_>>())?;
        module.add("POLICIES", supple::policy::shipped::EMBEDDED.iter().map(|(name, _)| *name).collect::<Vec<_>>())
    }
}
