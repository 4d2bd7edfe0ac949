//! What another robot's joints and feet are called, and the YAML file that says so where it cannot be guessed.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::config::layered;
use crate::files;
use crate::go1::{JOINT_COUNT, Joints, LEGS, joint_name};
use crate::mujoco::{Kind, Model, Shape};

/// Larger files are not lists of names.
const MAX_BYTES: u64 = 64 << 10;

/// One entry for each leg.
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
}

/// What a YAML file says about a robot; empty for an MJCF file alone.
#[derive(Debug, Default)]
pub(super) struct Description {
    /// The MJCF file.
    pub(super) mjcf: PathBuf,
    /// Names of the joints, in our order.
    joints: Option<Vec<String>>,
    /// Names of the feet's geometries, in our order.
    pub(super) feet: Option<[String; 4]>,
    /// Joint angles at the start, in our order \[rad\].
    pub(super) pose: Option<Joints>,
    /// Base height below which it has fallen \[m\].
    pub(super) min_height_m: Option<f64>,
}

impl Description {
    /// Of an MJCF file, or of a YAML file that names one.
    ///
    /// # Errors
    /// In words.
    pub(super) fn read(path: &Path) -> Result<Self, String> {
        if !crate::agent::is_description(path) {
            return Ok(Description { mjcf: path.to_owned(), ..Description::default() });
        }
        let bytes = files::read_bounded(path, MAX_BYTES).map_err(|error| error.to_string())?;
        let raw: RawDescription = layered(&path.display().to_string(), &[&String::from_utf8_lossy(&bytes)])
            .map_err(|error| error.to_string())?;
        let pose = raw.nominal_pose_rad.map(|pose| match pose[..] {
            [hip, thigh, calf] => Ok(crate::go1::same_in_every_leg([hip, thigh, calf])),
            _ => <Joints>::try_from(pose).map_err(|pose| {
                format!("nominal_pose_rad has {} angles, expected 3, or 12 for FR, FL, RR, RL", pose.len())
            }),
        });
        let pose = pose.transpose()?;
        if pose.is_some_and(|pose| !pose.iter().all(|angle| angle.abs() <= std::f64::consts::TAU)) {
            return Err("nominal_pose_rad has an angle beyond one turn".into());
        }
        if raw.min_height_m.is_some_and(|height| !(0.0..=10.0).contains(&height)) {
            return Err("min_height_m must be 0 to 10 m".into());
        }
        Ok(Description {
            mjcf: path.parent().unwrap_or(Path::new("")).join(raw.mjcf),
            joints: raw.joints.map(|legs| legs.in_order().into_iter().flatten().collect()),
            feet: raw.feet.map(Legs::in_order),
            pose,
            min_height_m: raw.min_height_m,
        })
    }

    /// The model's joints in our order, by the names given or by the usual ones.
    ///
    /// # Errors
    /// In words, with the names that there are.
    pub(super) fn joints(&self, model: &Model) -> Result<[usize; JOINT_COUNT], String> {
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
        let found = (0..JOINT_COUNT).map(find).collect::<Result<Vec<_>, _>>()?;
        let joints = <[usize; JOINT_COUNT]>::try_from(found).map_err(|_| "it has too few joints".to_owned())?;
        match (0..JOINT_COUNT).find(|index| joints[..*index].contains(&joints[*index])) {
            Some(twice) => Err(format!("its joint '{}' is named twice", names[joints[twice]])),
            None => Ok(joints),
        }
    }
}

/// Whether a name is one of those that joint `index` usually has, such as `FR_hip_joint`, `rf_haa` or `FR_abduction`.
fn usual(name: &str, index: usize) -> bool {
    let name = name.to_lowercase();
    let legs = [["fr", "rf"], ["fl", "lf"], ["rr", "rh"], ["rl", "lh"]][index / 3];
    let parts: &[&str] = match index % 3 {
        0 => &["hip", "haa", "abduction", "hip_abduction", "hx"],
        1 => &["thigh", "hfe", "hip_flexion", "upper", "hy"],
        _ => &["calf", "kfe", "knee", "shank", "lower", "kn"],
    };
    let short = name.strip_suffix("_joint").unwrap_or(&name);
    legs.iter().any(|leg| {
        short.strip_prefix(leg).and_then(|rest| rest.strip_prefix('_')).is_some_and(|rest| parts.contains(&rest))
    })
}

/// The foot of a leg: the geometry of that name, or the lowest sphere that collides below the calf.
///
/// # Errors
/// In words.
pub(super) fn foot(model: &Model, given: Option<&String>, leg: usize, calf: usize) -> Result<usize, String> {
    if let Some(name) = given {
        let foot = model.id(Kind::Geom, name).map_err(|error| error.to_string())?;
        return match model.geom(foot).shape {
            Shape::Sphere | Shape::Capsule => Ok(foot),
            other => Err(format!("its foot '{name}' is a {other:?}, expected a sphere or the round end of a capsule")),
        };
    }
    let below = |mut body: usize| {
        // A foot may be a body of its own, fixed to the calf.
        while body > calf {
            body = model.body_parent(body);
        }
        body == calf
    };
    let spheres = (0..model.count(Kind::Geom)).filter(|geom| {
        let shape = model.geom(*geom).shape;
        shape == Shape::Sphere && model.geom_contact(*geom).collides() && below(model.geom_body(*geom))
    });
    let depth = |geom: &usize| model.geom_position_at_rest(*geom)[2];
    spheres.min_by(|a, b| depth(a).total_cmp(&depth(b))).ok_or_else(|| {
        format!("the calf of leg {} has no sphere that collides: name the feet's geometries in a YAML file", LEGS[leg])
    })
}
