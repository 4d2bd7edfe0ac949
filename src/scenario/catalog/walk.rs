//! Walking without disturbance (E0).

use clap::Args;
use serde::{Deserialize, Serialize};

use super::{Parameters, Task};

/// Walk without disturbance.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Walk {
    /// The command, the length of the playback and the encoder bias.
    #[command(flatten)]
    #[serde(flatten)]
    pub task: Task,
}

impl Parameters for Walk {}
