//! Names of another robot's joints and feet, and the YAML description that states them if they cannot be guessed.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::mujoco::{Kind, Model, Shape};
use crate::robot::{JOINTS, Joints, LEGS, PARTS, joint_name, same_in_every_leg};
use crate::util::files;
use crate::util::yaml::{Text, layered};

/// One value for each leg.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(non_snake_case)]
struct Legs<T> {
    FR: T,
    FL: T,
    RR: T,
    RL: T,
}

impl<T> Legs<T> {
    fn in_order(self) -> [T; 4] {
        [self.FR, self.FL, self.RR, self.RL]
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawDescription {
    mjcf: PathBuf,
    joints: Option<Legs<[String; 3]>>,
    feet: Option<Legs<String>>,
    nominal_pose_rad: Option<Vec<f64>>,
    min_height_m: Option<f64>,
    torque_limits_n_m: Option<Vec<f64>>,
}

/// The robot's YAML description; empty for an MJCF file alone.
#[derive(Debug, Clone, Default)]
pub(super) struct Description {
    /// Path of the MJCF file.
    pub(super) mjcf: PathBuf,
    /// Names of the joints, in the order of [`joint_names`](crate::robot::joint_names).
    pub(super) joints: Option<Vec<String>>,
    /// Names of the feet's geometries, in the order of [`LEGS`](crate::robot::LEGS).
    pub(super) feet: Option<[String; 4]>,
    /// Joint angles of the starting pose, in the same order \[rad\].
    pub(super) pose: Option<Joints>,
    /// Base height below which the robot counts as fallen \[m\].
    pub(super) fall_height_m: Option<f64>,
    /// Largest torques, in the same order [N·m].
    pub(super) torque_limits: Option<Joints>,
}

impl Description {
    /// Reads an MJCF file, or a YAML file that names one.
    pub(super) fn read(path: &Path) -> Result<Self, String> {
        if !files::is_yaml(path) {
            return Ok(Description { mjcf: path.to_owned(), ..Description::default() });
        }
        let text = Text::read(path).map_err(|error| error.to_string())?;
        // The caller adds the file's name to the error.
        let raw: RawDescription = layered(&[text]).map_err(|error| error.without_name())?;
        let pose = raw.nominal_pose_rad.map(|pose| of_joints("nominal_pose_rad", pose)).transpose()?;
        if pose.is_some_and(|pose| !pose.iter().all(|angle| angle.abs() <= std::f64::consts::TAU)) {
            return Err("nominal_pose_rad has an angle beyond one turn".into());
        }
        let torque_limits = raw.torque_limits_n_m.map(|limits| of_joints("torque_limits_n_m", limits)).transpose()?;
        if torque_limits.is_some_and(|limits| !limits.iter().all(|limit| (1e-3..=1e6).contains(limit))) {
            return Err("torque_limits_n_m must be 0.001 to 1000000 N m".into());
        }
        if raw.min_height_m.is_some_and(|height| !(0.0..=10.0).contains(&height)) {
            return Err("min_height_m must be 0 to 10 m".into());
        }
        Ok(Description {
            mjcf: path.parent().unwrap_or(Path::new("")).join(raw.mjcf),
            joints: raw.joints.map(|legs| legs.in_order().into_iter().flatten().collect()),
            feet: raw.feet.map(Legs::in_order),
            pose,
            fall_height_m: raw.min_height_m,
            torque_limits,
        })
    }

    /// Returns the ids of the model's joints in Supple's order, by the given names or by the usual ones.
    pub(super) fn joints(&self, model: &Model) -> Result<[usize; JOINTS], String> {
        let names: Vec<&str> = (0..model.count(Kind::Joint)).map(|joint| model.name(Kind::Joint, joint)).collect();
        let find = |index: usize| {
            let position = match &self.joints {
                Some(given) => names.iter().position(|name| *name == given[index]),
                None => names.iter().position(|name| usual(name, index)),
            };
            position.ok_or_else(|| {
                let wanted = self.joints.as_ref().map_or_else(|| joint_name(index), |given| given[index].clone());
                format!(
                    "it has no joint '{wanted}'; its joints are: {}. Say in a YAML file which is which, as \
                     examples/robots/quadruped.yaml does",
                    names.join(", ")
                )
            })
        };
        let found = (0..JOINTS).map(find).collect::<Result<Vec<_>, _>>()?;
        let joints = <[usize; JOINTS]>::try_from(found).map_err(|_| "it has too few joints".to_owned())?;
        match (0..JOINTS).find(|index| joints[..*index].contains(&joints[*index])) {
            Some(twice) => Err(format!("its joint '{}' is named twice", names[joints[twice]])),
            None => Ok(joints),
        }
    }
}

/// Expands three numbers to every leg, or accepts twelve in Supple's order.
fn of_joints(key: &str, numbers: Vec<f64>) -> Result<Joints, String> {
    match numbers[..] {
        [hip, thigh, calf] => Ok(same_in_every_leg([hip, thigh, calf])),
        _ => <Joints>::try_from(numbers)
            .map_err(|numbers| format!("{key} has {} numbers, expected 3, or 12 for FR, FL, RR, RL", numbers.len())),
    }
}

/// Returns true if a name is usual for joint `index`, such as `FR_hip_joint`, `rf_haa` or `FR_abduction`.
fn usual(name: &str, index: usize) -> bool {
    let name = name.to_lowercase();
    let legs = [["fr", "rf"], ["fl", "lf"], ["rr", "rh"], ["rl", "lh"]][index / PARTS.len()];
    let parts: &[&str] = match index % PARTS.len() {
        0 => &["hip", "haa", "abduction", "hip_abduction", "hx"],
        1 => &["thigh", "hfe", "hip_flexion", "upper", "hy"],
        _ => &["calf", "kfe", "knee", "shank", "lower", "kn"],
    };
    let short = name.strip_suffix("_joint").unwrap_or(&name);
    legs.iter().any(|leg| {
        short.strip_prefix(leg).and_then(|rest| rest.strip_prefix('_')).is_some_and(|rest| parts.contains(&rest))
    })
}

/// Finds the foot of a leg: the geometry of the given name, or the lowest sphere that collides below the calf.
pub(super) fn foot(model: &Model, given: Option<&String>, leg: usize, calf: usize) -> Result<usize, String> {
    if let Some(name) = given {
        let foot = model.id(Kind::Geom, name).map_err(|error| error.to_string())?;
        return match model.geom(foot).shape {
            Shape::Sphere | Shape::Capsule => Ok(foot),
            other => Err(format!("its foot '{name}' is a {other:?}, expected a sphere or the round end of a capsule")),
        };
    }
    // A foot may be a body of its own, fixed to the calf.
    let spheres = (0..model.count(Kind::Geom)).filter(|geom| {
        let shape = model.geom(*geom).shape;
        shape == Shape::Sphere && model.geom_contact(*geom).collides() && model.is_below(model.geom_body(*geom), calf)
    });
    let depth = |geom: &usize| model.geom_position_at_rest(*geom)[2];
    spheres.min_by(|a, b| depth(a).total_cmp(&depth(b))).ok_or_else(|| {
        format!("the calf of leg {} has no sphere that collides: name the feet's geometries in a YAML file", LEGS[leg])
    })
}
