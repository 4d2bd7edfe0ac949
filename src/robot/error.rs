//! The reasons why a robot's files are refused. The caller puts the file's name before them.

use std::path::PathBuf;

use super::{JOINTS, joint_name};
use crate::mujoco::{self, SizeError};
use crate::util::xml::XmlError;

/// Advice on files that need a newer MuJoCo than this program's.
pub(super) const SAVE_AGAIN: &str = "save the robot from that MuJoCo (mujoco.mj_saveLastXML after loading it), which \
                                     writes the model without them, or build Supple with that MuJoCo";

/// The reason why a robot's files were refused.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RobotError {
    #[error("{}: {error}", file.display())]
    In { file: PathBuf, error: Box<RobotError> },
    #[error("{0}")]
    Read(#[from] std::io::Error),
    #[error("{}: {error}; put the file there, or take it out of the robot's file", file.display())]
    Asset { file: PathBuf, error: std::io::Error },
    #[error(transparent)]
    Xml(#[from] XmlError),
    #[error("{0}")]
    Yaml(String),
    #[error("{key} has {found}, expected {expected}")]
    Key { key: &'static str, found: String, expected: &'static str },
    #[error("its root element is <{0}>, expected <mujoco> (MJCF) or <robot> (URDF)")]
    Root(String),
    #[error("it has more than {most} {what}{}", if *what == "files" { ": does one include itself?" } else { "" })]
    TooMany { what: &'static str, most: usize },
    #[error("{at}: an <include> names no file, expected file=\"…\"")]
    NamelessInclude { at: String },
    #[error(transparent)]
    Size(#[from] SizeError),
    #[error("{at}: {attribute} of <{element}> is '{found}', expected finite numbers")]
    NotFinite { at: String, attribute: String, element: String, found: String },
    #[error("{at}: {attribute} of {element} is '{found}', expected {expected}")]
    Attribute { at: String, attribute: &'static str, element: String, found: String, expected: &'static str },
    #[error("{at}: {word} needs MuJoCo {since}, and robots are read as MJCF of 2.2.2; {advice}")]
    Newer { at: String, word: String, since: &'static str, advice: &'static str },
    #[error(
        "{at}: {word} is unknown to MuJoCo 2.2.2: a typing error, or new in a later MuJoCo; take it out, or {SAVE_AGAIN}"
    )]
    Unknown { at: String, word: String },
    #[error("{at}{}{element}: MuJoCo refuses it: {message}", if at.is_empty() { "" } else { ", " })]
    MuJoCo { at: String, element: String, message: String },
    #[error("MuJoCo refuses it: {0}")]
    Engine(String),
    #[error(
        "{at}: it has a section <{section}>, expected none: a trunk with four legs of three hinges each has none; take it out"
    )]
    Section { at: String, section: String },
    #[error(
        "{at}: its compiler setting coordinate is 'global', expected 'local'; save it from MuJoCo 2.3.2 or older, which writes local coordinates"
    )]
    GlobalCoordinates { at: String },
    #[error("MJCF cannot name {}: its path is not UTF-8; move it", .0.display())]
    Path(PathBuf),
    #[error(
        "it has no joint '{wanted}'; its joints are: {known}. Name the joints in a YAML file, as examples/robots/quadruped.yaml does"
    )]
    NoJoint { wanted: String, known: String },
    #[error("its joint '{name}' is named twice, as {} and {}: name each joint once", joint_name(*first), joint_name(*second))]
    JointTwice { name: String, first: usize, second: usize },
    #[error("its joint '{name}', {}, is no hinge, expected a hinge: every leg has three", joint_name(*joint))]
    NoHinge { name: String, joint: usize },
    #[error(
        "its trunk is fixed to the world, or its hips are not children of the trunk: expected a trunk with a <freejoint/> and four legs of three hinges"
    )]
    NoTrunk,
    #[error("{0}, {1} and {2} are not three hinges one below the other, expected hip, thigh and calf of one leg")]
    NotInLine(String, String, String),
    #[error(
        "it has joints beside those of four legs: {0}; name them under weld in a YAML file, as examples/robots/quadruped.yaml does, \
         or take their <joint> out"
    )]
    OtherJoints(String),
    #[error(
        "weld has '{wanted}', expected the name of a joint, or the beginning of names with a * behind it; its joints are: {known}"
    )]
    NoWeld { wanted: String, known: String },
    #[error("it has no geometry '{name}' for the foot of leg {leg}; its geometries with names are: {known}")]
    NoGeometry { name: String, leg: &'static str, known: String },
    #[error("its foot '{name}' is named twice, for the legs {first} and {second}: name one geometry for each leg")]
    FootTwice { name: String, first: &'static str, second: &'static str },
    #[error(
        "its foot '{name}' of leg {leg} is not below the calf of that leg, but on {found}: name the geometry at the end of leg {leg}"
    )]
    ForeignFoot { name: String, leg: &'static str, found: String },
    #[error(
        "its foot '{name}' of leg {leg} {found}, expected a sphere, capsule, cylinder, ellipsoid, box or mesh that collides"
    )]
    FootShape { name: String, leg: &'static str, found: &'static str },
    #[error(
        "nothing on the calf of leg {leg} collides: put a shape where its foot is, such as <geom type=\"sphere\" size=\"0.02\" \
         pos=\"…\"/>, or in a URDF <collision> with <sphere radius=\"0.02\"/>"
    )]
    NoFoot { leg: &'static str },
    #[error(
        "nothing on the calf of leg {leg} collides, because {unread}; or give the foot in the URDF a <collision> with <sphere \
         radius=\"0.02\"/>"
    )]
    FootMesh { leg: &'static str, unread: String },
    #[error("the thigh and the calf of leg {0} turn about different axes, expected parallel ones")]
    Axes(&'static str),
    #[error(
        "its joint '{0}' has no actuator with a limited torque: write the largest torques of hip, thigh and calf into a YAML \
         file, as torque_limits_n_m in examples/robots/quadruped.yaml"
    )]
    NoTorque(String),
    #[error(
        "its joint '{name}' takes torques from {low} to {high} N m, expected both directions: write the largest torques of hip, \
         thigh and calf into a YAML file, as torque_limits_n_m in examples/robots/quadruped.yaml"
    )]
    OneSidedTorque { name: String, low: f64, high: f64 },
    #[error("{at}: a part of the robot is a {shape}, expected a body's shape; take it out")]
    Ground { at: String, shape: &'static str },
    #[error("it is a xacro, expected a URDF: write it out, with `xacro robot.urdf.xacro > robot.urdf`")]
    Xacro,
    #[error("its links have {0} roots, expected one: the trunk, which is no joint's child")]
    Links(usize),
    #[error("its {what} has {found} numbers, expected {expected}")]
    Count { what: &'static str, found: usize, expected: usize },
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
