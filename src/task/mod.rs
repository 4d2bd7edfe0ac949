/*! The learning task of section III as pure functions: what the policy is paid, how an episode unfolds.

Everything takes values and returns values; only the swing tracker looks on while physics steps.
*/

pub mod compliance;
pub mod episode;
pub mod reward;

pub use compliance::OuterLoop;
pub use episode::{Curriculum, EpisodePlan, Stage, Stages};
pub use reward::{SwingTracker, Terms};

pub use crate::observation::Command;
