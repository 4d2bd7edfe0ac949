/*! Supple trains and studies compliant legged locomotion: a quadruped that yields when pushed, pulled or blocked.

It reproduces "Deep Compliant Control for Legged Robots" in Rust on MuJoCo. The [`guide`] has examples of each use. To
read the code, follow the data:

1. [`config`] and [`robot`]: the settings and the quadruped as plain data;
2. [`sim`] on [`mujoco`]: the robot simulated in its scene, one policy step at a time;
3. [`observation`] and [`task`]: the policy's input, and its reward; [`world`]: the robot with disturbances and reward;
4. [`train`], [`ppo`] and [`network`]: rollouts, updates and weights; several processes train one run as [`ranks`];
5. [`policy`]: the result, as a file and as a controller;
6. [`scenario`] and [`estimate`]: disturbances of a policy that acts on the true state or on its sensors, and their
   [`trace`](scenario::trace), which the packages `supple-evaluate` and `supple-record` read.

[`provenance`] names the versions of program and MuJoCo; [`util`] contains helpers for all of them.
*/

/// Declares methods of a single expression, a line each.
macro_rules! methods {
    ($($(#[$doc:meta])* fn $name:ident($($given:tt)*) $(-> $type:ty)? = $value:expr;)*) => {
        $($(#[$doc])* pub fn $name($($given)*) $(-> $type)? { $value })*
    };
}

/// Returns an error, or one with this text, from a function unless a condition holds.
macro_rules! ensure {
    ($condition:expr, $text:literal $($given:tt)*) => { ensure!($condition, format!($text $($given)*)) };
    ($condition:expr, $error:expr) => { if $condition {} else { return Err($error.into()) } };
}

pub mod config;
pub mod estimate;
pub mod guide;
pub mod mujoco;
pub mod network;
pub mod observation;
pub mod policy;
pub mod ppo;
pub mod provenance;
pub mod ranks;
pub mod robot;
pub mod scenario;
pub mod sim;
pub mod task;
pub mod train;
pub mod util;
pub mod world;
