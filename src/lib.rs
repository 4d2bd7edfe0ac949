/*! Supple trains and studies compliant legged locomotion: a quadruped that yields when pushed, pulled or blocked.

It reproduces "Deep Compliant Control for Legged Robots" in Rust on MuJoCo 2.2.2. Data flow one way: a [`config`] and a
[`robot`] make a [`sim`]ulation on [`mujoco`]; an [`observation`] says what a policy sees of it, the [`task`] what it is
paid; [`train`] collects both, learns [`network`]s with [`ppo`] and leaves a [`policy`] behind. A [`scenario`] puts a policy
to the test, on the true state or on what it can [`estimate`] from its sensors, and leaves a [`trace`](scenario::trace),
which the packages `supple-evaluate` and `supple-record` read. Several processes train as
[`ranks`] of one run. [`util`] has what all of them need.
*/

pub mod config;
pub mod estimate;
pub mod guide;
pub mod mujoco;
pub mod network;
pub mod observation;
pub mod policy;
pub mod ppo;
pub mod ranks;
pub mod robot;
pub mod scenario;
pub mod sim;
pub mod task;
pub mod train;
pub mod util;
