//! The reasons why a robot's files are refused. The caller puts the file's name before them.

use std::path::PathBuf;

use super::{JOINTS, joint_name};
use crate::mujoco::{self, SizeError};
use crate::util::xml::XmlError;

/// Advice on files that need a newer MuJoCo than this program's.
pub(super) const SAVE_AGAIN: &str = "save the robot from that MuJoCo (mujoco.mj_saveLastXML after loading it), which writes \
                                     such words out, or build Supple with that MuJoCo";

/// The reason why a robot's files were refused.
#[derive(Debug, thiserror::Error)]
pub enum RobotError {
    /// A file that the main file includes is at fault.
    #[error("{}: {error}", file.display())]
    In {
        /// Path of the included file.
        file: PathBuf,
        /// The reason why it is refused.
        error: Box<RobotError>,
    },
    /// A file cannot be read.
    #[error("{0}")]
    Read(#[from] std::io::Error),
    /// A mesh or texture cannot be read.
    #[error("{}: {error}; put the file there, or take it out of the robot's file", file.display())]
    Asset {
        /// Path of the mesh or texture.
        file: PathBuf,
        /// Reason given by the operating system.
        error: std::io::Error,
    },
    /// A file is no XML that this program takes.
    #[error(transparent)]
    Xml(#[from] XmlError),
    /// The robot's YAML description is invalid.
    #[error("{0}")]
    Yaml(String),
    /// A key of the description has a value out of range.
    #[error("{key} has {found}, expected {expected}")]
    Key {
        /// Name of the key.
        key: &'static str,
        /// The value that was found.
        found: String,
        /// The values that are taken.
        expected: &'static str,
    },
    /// The root element is neither MJCF's nor URDF's.
    #[error("its root element is <{0}>, expected <mujoco> (MJCF) or <robot> (URDF)")]
    Root(String),
    /// The files have more parts than any robot, or include one another in a circle.
    #[error("it has more than {most} {what}{}", if *what == "files" { ": does one include itself?" } else { "" })]
    TooMany {
        /// The parts that are too many.
        what: &'static str,
        /// The largest number that is taken.
        most: usize,
    },
    /// An `<include>` names no file.
    #[error("{at}: an <include> names no file, expected file=\"…\"")]
    NamelessInclude {
        /// File and line.
        at: String,
    },
    /// A size or count is beyond what any robot needs.
    #[error(transparent)]
    Size(#[from] SizeError),
    /// A number is not finite.
    #[error("{at}: {attribute} of <{element}> is '{found}', expected finite numbers")]
    NotFinite {
        /// File and line.
        at: String,
        /// Name of the attribute.
        attribute: String,
        /// Name of the element.
        element: String,
        /// The value that was found.
        found: String,
    },
    /// An attribute has another form than MuJoCo takes.
    #[error("{at}: {attribute} of {element} is '{found}', expected {expected}")]
    Attribute {
        /// File and line.
        at: String,
        /// Name of the attribute.
        attribute: &'static str,
        /// The element.
        element: String,
        /// The value that was found.
        found: String,
        /// The values that are taken.
        expected: &'static str,
    },
    /// A word that only a newer MuJoCo knows, and that cannot be translated.
    #[error("{at}: {word} needs MuJoCo {since}, and robots are read in the words of 2.2.2; {advice}")]
    Newer {
        /// File and line.
        at: String,
        /// The element or attribute.
        word: String,
        /// The first MuJoCo that knows it.
        since: &'static str,
        /// A way on.
        advice: &'static str,
    },
    /// A word that MuJoCo 2.2.2 does not know, nor, as far as is known here, any newer one.
    #[error(
        "{at}: {word} is unknown to MuJoCo 2.2.2: a typing error, or a word of a newer MuJoCo; take it out, or {SAVE_AGAIN}"
    )]
    Unknown {
        /// File and line.
        at: String,
        /// The element or attribute.
        word: String,
    },
    /// MuJoCo refuses an element.
    #[error("{at}{}{element}: MuJoCo refuses it: {message}", if at.is_empty() { "" } else { ", " })]
    MuJoCo {
        /// File and line; empty if the element is not one of the file.
        at: String,
        /// The element.
        element: String,
        /// MuJoCo's message without its place.
        message: String,
    },
    /// MuJoCo fails, and does not say where.
    #[error("MuJoCo refuses it: {0}")]
    Engine(String),
    /// A section that no such quadruped has.
    #[error(
        "{at}: it has a section <{section}>, expected none: a trunk with four legs of three hinges each has none; take it out"
    )]
    Section {
        /// File and line.
        at: String,
        /// Name of the section.
        section: String,
    },
    /// A setting that changes what every number of the file means.
    #[error(
        "{at}: its compiler setting coordinate is 'global', expected 'local'; save it from MuJoCo 2.3.2 or older, which writes local coordinates"
    )]
    GlobalCoordinates {
        /// File and line.
        at: String,
    },
    /// A path cannot be written into MJCF.
    #[error("MJCF cannot name {}: its path is not UTF-8; move it", .0.display())]
    Path(PathBuf),
    /// A joint is missing.
    #[error(
        "it has no joint '{wanted}'; its joints are: {known}. Say in a YAML file which is which, as examples/robots/quadruped.yaml does"
    )]
    NoJoint {
        /// Name of the joint.
        wanted: String,
        /// Names of all joints.
        known: String,
    },
    /// One joint stands for two.
    #[error("its joint '{name}' is named twice, as {} and {}: name each joint once", joint_name(*first), joint_name(*second))]
    JointTwice {
        /// Name of the joint.
        name: String,
        /// Index of the first joint that it stands for.
        first: usize,
        /// Index of the second one.
        second: usize,
    },
    /// A joint of a leg moves in another way than about an axis.
    #[error("its joint '{name}', {}, is no hinge, expected a hinge: every leg has three", joint_name(*joint))]
    NoHinge {
        /// Name of the joint in the file.
        name: String,
        /// Index of the joint.
        joint: usize,
    },
    /// The trunk is not free.
    #[error(
        "its trunk is fixed to the world, or its hips are not children of the trunk: expected a trunk with a <freejoint/> and four legs of three hinges"
    )]
    NoTrunk,
    /// Three joints are not one below the other.
    #[error("{0}, {1} and {2} are not three hinges one below the other, expected hip, thigh and calf of one leg")]
    NotInLine(String, String, String),
    /// The robot has more joints than its legs'.
    #[error(
        "it has joints beside those of four legs: {0}; name them under weld in a YAML file, as examples/robots/quadruped.yaml does, \
         or take their <joint> out"
    )]
    OtherJoints(String),
    /// No joint has the name of one to weld.
    #[error(
        "weld has '{wanted}', expected the name of a joint, or the beginning of names with a * behind it; its joints are: {known}"
    )]
    NoWeld {
        /// The name that was found.
        wanted: String,
        /// Names of all joints.
        known: String,
    },
    /// There is no geometry of this name.
    #[error("it has no geometry '{name}' for the foot of leg {leg}; its geometries with names are: {known}")]
    NoGeometry {
        /// Name of the geometry.
        name: String,
        /// Name of the leg.
        leg: &'static str,
        /// Names of all geometries.
        known: String,
    },
    /// One geometry is the foot of two legs.
    #[error("its foot '{name}' is named twice, for the legs {first} and {second}: name one geometry for each leg")]
    FootTwice {
        /// Name of the geometry.
        name: String,
        /// Name of the first leg.
        first: &'static str,
        /// Name of the second leg.
        second: &'static str,
    },
    /// The foot of a leg belongs to another part.
    #[error(
        "its foot '{name}' of leg {leg} is not below the calf of that leg, but on {found}: name the geometry at the end of leg {leg}"
    )]
    ForeignFoot {
        /// Name of the geometry.
        name: String,
        /// Name of the leg.
        leg: &'static str,
        /// The part that it belongs to.
        found: String,
    },
    /// The foot of a leg has a shape that nothing can stand on.
    #[error(
        "its foot '{name}' of leg {leg} {found}, expected a sphere, capsule, cylinder, ellipsoid, box or mesh that collides"
    )]
    FootShape {
        /// Name of the geometry.
        name: String,
        /// Name of the leg.
        leg: &'static str,
        /// The reason why nothing can stand on it.
        found: &'static str,
    },
    /// Nothing at the end of a leg touches the ground.
    #[error(
        "nothing on the calf of leg {leg} collides: put a shape where its foot is, such as <geom type=\"sphere\" size=\"0.02\" \
         pos=\"…\"/>, or in a URDF <collision> with <sphere radius=\"0.02\"/>"
    )]
    NoFoot {
        /// Name of the leg.
        leg: &'static str,
    },
    /// The foot of a leg is a mesh of a URDF that cannot be read.
    #[error(
        "nothing on the calf of leg {leg} collides, because {unread}; or give the foot in the URDF a <collision> with <sphere \
         radius=\"0.02\"/>"
    )]
    FootMesh {
        /// Name of the leg.
        leg: &'static str,
        /// The mesh, the reason and a way on.
        unread: String,
    },
    /// Thigh and calf do not turn about one direction.
    #[error("the thigh and the calf of leg {0} turn about different axes, expected parallel ones")]
    Axes(&'static str),
    /// The largest torque of a joint is not stated.
    #[error(
        "its joint '{0}' has no actuator with a limited torque: write the largest torques of hip, thigh and calf into a YAML \
         file, as torque_limits_n_m in examples/robots/quadruped.yaml"
    )]
    NoTorque(String),
    /// The torque of a joint is limited to one direction.
    #[error(
        "its joint '{name}' takes torques from {low} to {high} N m, expected both directions: write the largest torques of hip, \
         thigh and calf into a YAML file, as torque_limits_n_m in examples/robots/quadruped.yaml"
    )]
    OneSidedTorque {
        /// Name of the joint.
        name: String,
        /// Least torque.
        low: f64,
        /// Largest torque.
        high: f64,
    },
    /// A part of the robot has the shape of ground.
    #[error("{at}: a part of the robot is a {shape}, expected a body's shape; take it out")]
    Ground {
        /// File and line.
        at: String,
        /// Name of the shape.
        shape: &'static str,
    },
    /// A URDF is not written out.
    #[error("it is a xacro, expected a URDF: write it out, with `xacro robot.urdf.xacro > robot.urdf`")]
    Xacro,
    /// A URDF has no first link, or several.
    #[error("its links have {0} roots, expected one: the trunk, which is no joint's child")]
    Links(usize),
    /// The converted robot has other numbers than it must have.
    #[error("its {what} has {found} numbers, expected {expected}")]
    Count {
        /// Name of the list.
        what: &'static str,
        /// The number of numbers that were found.
        found: usize,
        /// The number that there should be.
        expected: usize,
    },
    /// The process that reads robots ended without an answer, or refused it.
    #[error("{0}")]
    Child(String),
}

impl From<mujoco::Error> for RobotError {
    fn from(error: mujoco::Error) -> Self {
        RobotError::Engine(error.to_string())
    }
}

impl RobotError {
    /// Refuses a torque range that does not bound both directions.
    pub(super) fn one_sided(name: &str, [low, high]: [f64; 2]) -> Self {
        RobotError::OneSidedTorque { name: name.to_owned(), low, high }
    }

    /// A list with another number of numbers than joints.
    pub(super) fn joints(what: &'static str, found: usize) -> Self {
        RobotError::Count { what, found, expected: JOINTS }
    }
}
