/*! Robot import: adapts an MJCF or URDF file written for other purposes, and reports every change. Read `source` (the files),
`newer` and `words` (what newer MuJoCos write), `urdf`, `weld`, `names` (joints), `feet`, `normalise` (the changes) and `sandbox` (the
child process), in this order.

A file such as the widely used Go1 brings its own servos, damping, contact softness, solver options and floor. Here the only controller is
the PD law with its torque limits, the only damping is K_d, and the ground's friction is the scenario's; otherwise numbers of two robots
could not be compared. So the file is compiled once to see what MuJoCo reads from it. It is then written again with our names for trunk,
joints and feet, with motors instead of servos, and without the parts that contradict these rules. Masses, inertias, shapes, joint limits
and armature stay as they are.
*/

mod angles;
mod feet;
mod load;
mod masses;
mod names;
mod newer;
mod normalise;
mod sandbox;
mod source;
mod torque;
mod urdf;
mod weld;
mod words;

use std::path::{Path, PathBuf};

pub(crate) use names::recognise;
pub use sandbox::isolate_imports;
use serde::{Deserialize, Serialize};
pub(super) use source::Source;

use super::JOINTS;
use super::error::RobotError;

/// An imported robot that fits our scenes.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Imported {
    /// MJCF document: compiler settings, defaults, assets, the trunk in a world body, motors, the starting pose.
    pub(super) mjcf: String,
    /// The changes made to the file and the parts left out, one on a line.
    pub(super) report: Vec<String>,
    /// True if the file gives a starting pose; false if all its angles are zero.
    pub(super) has_pose: bool,
    /// Base height below which the robot counts as fallen, if its description states one \[m\].
    pub(super) fall_height_m: Option<f64>,
    /// SHA-256 of the content of all its files, independent of their paths.
    pub(super) sha256: String,
    /// Names that the file gives the joints, in Supple's order.
    pub(super) joints: [String; JOINTS],
    /// Paths of its meshes and textures.
    pub(super) assets: Vec<PathBuf>,
}

/// Imports the robot at `path`, in a child process if the program called [`isolate_imports`].
pub(super) fn import(source: &Source, path: &Path) -> Result<Imported, RobotError> {
    sandbox::import(path).unwrap_or_else(|| normalise::adapt(source))
}
