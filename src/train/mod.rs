/*! Training: from environments to a run's folder.

Read in this order: [`episode`] (what is drawn, and the curriculum), [`environment`] (one robot and its episodes), [`collection`] (a batch from many environments),
[`Trainer`] (collect, learn, advance the curriculum), [`run`] (the folder on disk).
*/

pub mod checkpoint;
pub mod collection;
pub mod deviation;
pub mod environment;
pub mod episode;
mod fault_report;
mod memory;
pub mod metrics;
pub mod run;
pub mod symmetry;
mod tensorboard;
mod terrain;
mod trainer;

pub use episode::{Curriculum, EpisodePlan};
pub use memory::{MemoryError, MemoryEstimate, environments_bytes};
pub use trainer::{TrainError, Trainer};
