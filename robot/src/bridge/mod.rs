/*! The controller's side: a policy on the robot's own interface.

Read in this order: `reading` (the robot's state as the bridge understands it), `perceive` (from readings to the state that a policy acts
on), `phase` (passive, stand up, hold, policy, lie down), `safety` (faults that end in damping), `orders` (of the operator), `log`, `outlet`
(sends commands, and damps if they stop). `core` joins them without a network, and [`drive()`] connects them to one.
*/

mod core;
mod drive;
pub(crate) mod log;
mod orders;
mod outlet;
mod perceive;
pub(crate) mod phase;
pub(crate) mod reading;
mod safety;

pub(crate) use self::core::Bridge;
pub use drive::{Report, Settings, drive};
pub use orders::{KEYS, Order};
pub use phase::Wish;
