/*! Policies: policy files of Supple, external policies, and controllers that run them.

Start with [`shipped::find`], which returns an [`Agent`]: any policy with its robot and configuration. Then read
[`Policy`] (the policy file), [`Controller`] (the interface to a robot) and [`Inference`] (observation, network,
action). [`external`] runs networks of other frameworks through [`onnx`]; [`compliance`] makes a policy's compliance a
command.
*/

mod agent;
pub mod compliance;
mod controller;
pub mod external;
pub(crate) mod file;
mod inference;
pub mod onnx;
mod pytorch;
pub mod shipped;

pub use agent::{Agent, AgentError};
pub use controller::Controller;
pub use file::{Policy, Provenance, Usage};
pub use inference::{Function, Inference, InferenceBuffers, JointPositionAction, Meaning, Network, PolicyController};
