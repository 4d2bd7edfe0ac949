/*! Supple trains and studies compliant legged locomotion: a Unitree Go1 that yields when pushed, pulled or blocked.

It reproduces "Deep Compliant Control for Legged Robots" in Rust on MuJoCo 2.2.2. In training, data flow one way: [`config`]
→ [`scene`] → [`mujoco`] → [`sim`] → [`env`](mod@env) → [`rollout`] → [`ppo`] → [`checkpoint`] → [`policy`]; in a study,
[`policies`] → [`agent`] → [`scenario`] → [`trace`] → [`record`] or [`evaluate`].
*/

pub mod agent;
pub mod checkpoint;
pub mod config;
pub mod control;
pub mod env;
pub mod estimate;
pub mod evaluate;
pub mod files;
pub mod foreign;
pub mod go1;
pub mod guide;
pub mod last_second;
pub mod metrics;
pub mod mirror;
pub mod mujoco;
pub mod onnx;
pub mod policies;
pub mod policy;
pub mod ppo;
pub mod provenance;
pub mod random;
#[cfg(feature = "record")]
pub mod record;
pub mod robot;
pub mod rollout;
pub mod run;
pub mod scenario;
pub mod scene;
pub mod sim;
pub mod task;
pub mod tensorboard;
pub mod tensors;
pub mod terminal;
pub mod trace;
pub mod train;
