/*! Imported robots: an MJCF file that was written for other purposes, made to fit, with a report of what changed.

A file such as the widely used Go1 brings its own servos, damping, contact softness, solver options and floor. Here the
only controller is the PD law with its torque limits, the only damping is K_d, and the ground's friction is the
scenario's; otherwise numbers of two robots could not be compared. So the file is read as it is, compiled once to learn
what MuJoCo makes of it, and written again with our names for trunk, joints and feet, motors instead of servos, and
without what contradicts that. Masses, inertias, shapes, joint limits and armature stay as they are.
*/

mod names;
mod normalise;
mod resolve;
mod sandbox;

use std::path::Path;

pub(super) use resolve::Source;
pub use sandbox::isolate_imports;
use serde::{Deserialize, Serialize};

/// A robot that fits our scenes.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Imported {
    /// Compiler settings, defaults, assets, the trunk in a world body, motors, the starting pose.
    pub(super) mjcf: String,
    /// The changes made to the file and the parts left out, one on a line.
    pub(super) report: Vec<String>,
    /// True if the file gives a starting pose; false if all angles are merely zero.
    pub(super) has_pose: bool,
    /// Base height below which it has fallen, if its description says so \[m\].
    pub(super) fall_height_m: Option<f64>,
    /// Hash of all its files, wherever they lie.
    pub(super) sha256: String,
}

/// Makes a robot of the file at `path`, in a process of its own if this program has one: [`isolate_imports`].
pub(super) fn import(source: &Source, path: &Path) -> Result<Imported, String> {
    sandbox::import(path).unwrap_or_else(|| normalise::adapt(source))
}
