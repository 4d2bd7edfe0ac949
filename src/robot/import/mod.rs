/*! Imported robots: an MJCF file that was written for other purposes, made to fit, with a report of what changed.

A file such as the widely used Go1 brings its own servos, damping, contact softness, solver options and floor. Here the
only controller is the PD law with its torque limits, the only damping is K_d, and the ground's friction is the
scenario's; otherwise numbers of two robots could not be compared. So the file is read as it is, compiled once to learn
what MuJoCo makes of it, and written again with our names for trunk, joints and feet, motors instead of servos, and
without what contradicts that. Masses, inertias, shapes, joint limits and armature stay as they are.
*/

mod adapt;
mod names;
mod xml;

use std::path::Path;

/// A robot that fits our scenes.
pub(super) struct Imported {
    /// Compiler settings, defaults, assets, the trunk in a world body, motors, the starting pose.
    pub(super) mjcf: String,
    /// What was changed and what was left out, a line each.
    pub(super) report: Vec<String>,
    /// Base height below which it has fallen, if its description says so \[m\].
    pub(super) fall_height_m: Option<f64>,
}

/// Reads an MJCF file, or a YAML file that names one and says what its parts are called.
pub(super) fn read(path: &Path) -> Result<Imported, String> {
    let description = names::Description::read(path)?;
    let tree = xml::read(&description.mjcf)?;
    adapt::adapt(tree, &description)
}
