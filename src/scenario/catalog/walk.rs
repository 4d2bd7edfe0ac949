//! The scenario `walk`: walking without disturbance (E0).

use clap::Args;
use serde::{Deserialize, Serialize};

use super::{Parameters, Task};

/// Walk without disturbance.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Walk {
    /// The parameters that every scenario has.
    #[command(flatten)]
    #[serde(flatten)]
    pub task: Task,
}

impl Parameters for Walk {}
