/*! The learning task (section III) as pure functions.

Read in this order: [`reward`] (what the policy is rewarded for), [`episode`] (stages, pushes and the curriculum),
[`deviation`] (how a robot and its feet differ from the simulation), [`compliance`] (the outer loop that makes compliance a command). Only the [`SwingTracker`] keeps state while physics
steps.
*/
pub mod compliance;
pub mod deviation;
pub mod episode;
pub mod reward;

pub use compliance::VirtualMass;
pub use episode::{Curriculum, EpisodePlan, Stage, Stages};
pub use reward::{SwingTracker, Terms};

pub use crate::observation::Command;
