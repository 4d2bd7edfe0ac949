/*! The policy's observation as data: one description for training, shipped and external policies, ONNX, cards and the
mirror.

Read in this order: [`Quantity`] (what can be observed), [`Observed`] (an entry of the list in a file), [`Layout`] (the
checked list), [`Observer`] (measures it and keeps its history). Each number is `(value − offset) · scale` of a
quantity, now or some steps ago. The paper's 83 numbers are such a list, in `configs/compliant.yaml`; a policy of
another framework brings its own. A critic may observe more than the policy, also what only the simulator knows
([`Privileged`]).

To add a quantity, describe and measure it in `quantity.rs`; other files need changes only if its numbers are of a new kind.
*/

mod entry;
mod error;
mod layout;
mod observer;
mod quantity;

pub use entry::{NamedNumbers, NominalValues, Numbers, ObservationBlock, Observed, StepsAgo};
pub(crate) use entry::{limit, numbers};
pub use error::LayoutError;
pub use layout::Layout;
pub use observer::{ObservationInput, Observer};
pub use quantity::{Privileged, Quantity};

use serde::{Deserialize, Serialize};

/// The command to a policy, base frame.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Command {
    /// Forward velocity, `v_z*` of the paper [m/s].
    pub forward: f64,
    /// Velocity to the left, `v_x*` of the paper [m/s].
    pub left: f64,
    /// Yaw rate, counter-clockwise, `ω_y*` of the paper [rad/s].
    pub yaw: f64,
    /// Commanded compliance: velocity per sustained horizontal force [m/s/N]; not in the paper. `None` leaves the policy its
    /// own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub compliance: Option<f64>,
}

impl Command {
    /// Creates a walking command: forward and left [m/s], yaw rate [rad/s].
    pub fn velocity(forward: f64, left: f64, yaw: f64) -> Self {
        Command { forward, left, yaw, ..Command::default() }
    }
}
