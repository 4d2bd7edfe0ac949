//! Walking without disturbance (E0).

use super::Parameters;

parameters! {
    /// Walk without disturbance.
    pub struct Walk {}
}

impl Parameters for Walk {}
