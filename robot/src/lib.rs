/*! The Go2's own interface, on both sides of it.

[`serve`] is the robot's side: a simulated Go2 that is as strict as a real one. [`bridge`] is the controller's: a policy of Supple, or an
external one, on whatever speaks the interface. On either side, one file connects to the network ([`dds`]), and the rest is free of it;
[`lockstep`] joins both sides without a network. [`check`] finds mismatches between a policy and a robot in a log. Messages are in
[`message`]; nothing is ever sent on another network interface than the one that is named.
*/

pub mod bridge;
pub mod check;
pub mod dds;
pub mod lockstep;
pub mod message;
pub mod motor;
mod remote;
pub mod serve;

pub use remote::FullSticks;
