//! What this program is: stored with every run and policy.

/// Git revision of the source this was built from, with `-dirty` if it had changes, or `unknown` outside a checkout.
pub const GIT_REVISION: &str = env!("SUPPLE_GIT_REVISION");

/// MuJoCo version this was built against.
pub const MUJOCO_VERSION: &str = env!("SUPPLE_MUJOCO_VERSION");

/// Hash of the sources that a measurement of `evaluate` depends on: not of what only shows it.
pub const MEASURES: &str = env!("SUPPLE_MEASURES");
