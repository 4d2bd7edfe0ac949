/*! Robots from elsewhere: an MJCF file that was written for other purposes, made to fit, with a report of what changed.

A file such as the widely used Go1 brings its own servos, damping, contact softness, solver options and floor. Here the
only controller is the PD law with its torque limits, the only damping is K_d, and the ground's friction is the
scenario's; otherwise numbers of two robots could not be compared. So the file is read as it is, compiled once to learn
what MuJoCo makes of it, and written again with our names for trunk, joints and feet, motors instead of servos, and
without what contradicts that. Masses, inertias, shapes, joint limits and armature stay as they are.
*/

mod adapt;
mod names;
mod xml;

use std::path::{Path, PathBuf};

/// A file that is no robot we can use.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("robot {}: {problem}", path.display())]
pub struct RobotError {
    /// The MJCF or YAML file.
    pub path: PathBuf,
    /// What was found and expected.
    pub problem: String,
}

/// A robot that fits our scenes.
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// MJCF sections: compiler, defaults, assets, the trunk in a world body, motors, the starting pose.
    pub mjcf: String,
    /// What was changed and what was left out, a line each.
    pub report: Vec<String>,
    /// Base height below which it has fallen, if its description says so \[m\].
    pub min_height_m: Option<f64>,
}

impl Robot {
    /// Reads an MJCF file, or a YAML file that names one and says what its parts are called.
    ///
    /// # Errors
    /// [`RobotError`] that says what does not fit.
    pub fn load(path: &Path) -> Result<Self, RobotError> {
        let fail = |problem| RobotError { path: path.to_owned(), problem };
        let description = names::Description::read(path).map_err(fail)?;
        let tree = xml::read(&description.mjcf).map_err(fail)?;
        adapt::adapt(tree, &description).map_err(fail)
    }
}
