/*! What a policy sees, as data: one description for training, shipped and external policies, ONNX, cards and the mirror.

An observation is a list of [`Observed`] quantities, each of now or of steps ago, `(value − offset) · scale`. The paper's
83 numbers are one such list, in `configs/compliant.yaml`; a policy of another framework brings its own. [`Layout`] is the
list checked and made ready for a robot; an [`Observer`] measures it and keeps the history that it needs.

A new quantity is a variant of [`Quantity`], described and measured in `quantity.rs` and nowhere else,
unless its numbers are of a kind that there is not yet.
*/

mod entry;
mod layout;
mod observer;
mod quantity;

pub use entry::{Ages, Block, Nominal, Numbers, Observed, Word};
pub(crate) use entry::{limit, numbers};
pub use layout::Layout;
pub use observer::{Moment, Observer};
pub use quantity::Quantity;

use serde::{Deserialize, Serialize};

/// The command to a policy, base frame.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Command {
    /// `v_z*` of the paper [m/s].
    pub forward: f64,
    /// `v_x*` of the paper [m/s].
    pub left: f64,
    /// `ω_y*` of the paper [rad/s].
    pub yaw: f64,
    /// Commanded compliance: velocity per sustained horizontal force [m/s/N]; not in the paper. `None` leaves the policy its
    /// own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub compliance: Option<f64>,
}

impl Command {
    /// A walk: forward and left [m/s], yaw rate [rad/s].
    pub fn velocity(forward: f64, left: f64, yaw: f64) -> Self {
        Command { forward, left, yaw, ..Command::default() }
    }
}
