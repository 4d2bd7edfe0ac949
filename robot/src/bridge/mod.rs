/*! The controller's side: a policy on the robot's own interface.

Read in this order: [`reading`] (the robot's state as the bridge understands it), [`perceive`] (from readings to the state that a
policy acts on), [`phase`] (passive, stand up, hold, policy, lie down), [`safety`] (what ends in damping), [`orders`] (what people
want), [`log`] (what happened), [`outlet`] (the last way out, watched), and [`Bridge`], which joins them without a network;
[`drive`] puts it on one.
*/

mod core;
mod drive;
pub mod log;
pub mod orders;
pub mod outlet;
pub mod perceive;
pub mod phase;
pub mod reading;
pub mod safety;

pub use self::core::{Bridge, BridgeError, Output};
pub use drive::{DriveError, Report, Settings, drive};
