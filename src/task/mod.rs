/*! The learning task (section III) as pure functions.

Read in this order: [`reward`] (what the policy is rewarded for), [`stages`] (when), [`compliance`] (the outer loop that makes
compliance a command). Only the [`SwingTracker`] keeps state while physics steps.
*/
pub mod compliance;
pub mod reward;
pub mod stages;

pub use compliance::VirtualMass;
pub use reward::{SwingTracker, Terms};
pub use stages::{Stage, Stages};

pub use crate::observation::Command;
