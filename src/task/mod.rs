/*! The learning task of section III as pure functions: what the policy sees, what it is paid, how an episode unfolds.

Everything takes values and returns values; only the swing tracker looks on while physics steps.
*/

pub mod episode;
pub mod observation;
pub mod reward;

pub use episode::{Command, Curriculum, EpisodePlan, Stage, Stages};
pub use observation::Normaliser;
pub use reward::{SwingTracker, Terms};
