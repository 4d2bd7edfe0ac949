//! Walking without disturbance (E0).

use clap::Args;
use serde::{Deserialize, Serialize};

use super::{Parameters, Task};

/// Walk without disturbance.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Walk {
    #[command(flatten)]
    #[serde(flatten)]
    #[allow(missing_docs)]
    pub task: Task,
}

impl Parameters for Walk {}
