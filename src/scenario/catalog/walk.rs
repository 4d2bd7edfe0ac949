//! The scenario `walk`: walking without disturbance (E0).

use super::{ParameterError, Parameters, Task};
use crate::scenario::Script;

parameters! {
    /// Walk without disturbance.
    Walk {}
}

impl Parameters for Walk {
    fn prepare(&self, _: &mut Script, _: u64) -> Result<(), ParameterError> {
        self.check_ranges()
    }
}
