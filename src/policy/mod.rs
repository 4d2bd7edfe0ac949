/*! Policies: ours in their files, external ones behind a description, and both at work on a robot.

[`file`] is the format, [`shipped`] finds what is in the box, [`external`] plays networks of other frameworks through
[`onnx`], and an [`Agent`] is any of them. A [`Controller`] is one at work.
*/

mod agent;
pub mod compliance;
mod controller;
pub mod external;
mod file;
mod inference;
pub mod onnx;
pub mod shipped;

pub use agent::{Agent, AgentError};
pub use controller::Controller;
pub use file::{Policy, Provenance, Usage};
pub use inference::{Action, Buffers, Function, Inference, Meaning, Network, PolicyController};
