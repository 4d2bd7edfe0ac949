/*! Training, from environments to a run's folder.

[`environment`] steps one robot through its episodes, [`collection`] many of them under the policy; [`Trainer`] collects,
learns and widens the curriculum; [`run`] keeps all of it on disk.
*/

pub mod checkpoint;
pub mod collection;
pub mod environment;
mod fault_report;
mod memory;
pub mod metrics;
pub mod run;
pub mod symmetry;
mod tensorboard;
mod trainer;

pub use memory::{MemoryError, MemoryEstimate};
pub use trainer::{TrainError, Trainer};
