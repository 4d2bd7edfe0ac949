/*! Training: from environments to a run's folder.

Read in this order: [`environment`] (one robot and its episodes), [`collection`] (a batch from many environments),
[`Trainer`] (collect, learn, advance the curriculum), [`run`] (the folder on disk).
*/

pub mod checkpoint;
pub mod collection;
pub mod environment;
mod fault_report;
mod held_feet;
mod memory;
pub mod metrics;
pub mod run;
mod step_meter;
pub mod symmetry;
mod tensorboard;
mod terrain;
mod trainer;

pub use memory::{MemoryError, MemoryEstimate, environments_bytes};
pub use trainer::{TrainError, Trainer};
