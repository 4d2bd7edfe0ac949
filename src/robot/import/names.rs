//! Names of another robot's joints and feet, and the YAML description that states them if they cannot be guessed.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::mujoco::{Model, Object};
use crate::robot::error::RobotError;
use crate::robot::{JOINTS, Joints, PARTS, joint_name, same_in_every_leg};
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
    #[serde(default)]
    weld: Vec<String>,
}

/// The robot's YAML description; empty for an MJCF file alone. Its text is a part of a robot's identity: a new key belongs
/// beside it, as `weld` is.
#[derive(Debug, Clone, Default)]
pub(super) struct Description {
    /// Path of the MJCF or URDF file.
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
    /// Reads an MJCF or URDF file, or a YAML file that names one; returns also the names of the joints to weld.
    pub(super) fn read(path: &Path) -> Result<(Self, Vec<String>), RobotError> {
        if !files::is_yaml(path) {
            return Ok((Description { mjcf: path.to_owned(), ..Description::default() }, Vec::new()));
        }
        let text = Text::read(path).map_err(|error| RobotError::Yaml(error.to_string()))?;
        // The caller adds the file's name to the error.
        let raw: RawDescription = layered(&[text]).map_err(|error| RobotError::Yaml(error.without_name()))?;
        let pose = raw.nominal_pose_rad.map(|pose| of_joints("nominal_pose_rad", &pose)).transpose()?;
        if let Some(angle) = pose.iter().flatten().find(|angle| angle.is_nan() || angle.abs() > std::f64::consts::TAU) {
            let expected = "angles of at most one turn, 6.283 rad";
            return Err(RobotError::Key { key: "nominal_pose_rad", found: angle.to_string(), expected });
        }
        let torque_limits = raw.torque_limits_n_m.map(|limits| of_joints("torque_limits_n_m", &limits)).transpose()?;
        if let Some(limit) = torque_limits.iter().flatten().find(|limit| !(1e-3..=1e6).contains(*limit)) {
            let expected = "0.001 to 1000000 N m";
            return Err(RobotError::Key { key: "torque_limits_n_m", found: limit.to_string(), expected });
        }
        if let Some(height) = raw.min_height_m.filter(|height| !(0.0..=10.0).contains(height)) {
            let expected = "0 to 10 m";
            return Err(RobotError::Key { key: "min_height_m", found: height.to_string(), expected });
        }
        let mjcf = path.parent().unwrap_or(Path::new("")).join(raw.mjcf);
        let joints = raw.joints.map(|legs| legs.in_order().into_iter().flatten().collect());
        let feet = raw.feet.map(Legs::in_order);
        let description = Description { mjcf, joints, feet, pose, fall_height_m: raw.min_height_m, torque_limits };
        Ok((description, raw.weld))
    }

    /// Returns the ids of the model's joints in Supple's order, by the given names or by the usual ones.
    pub(super) fn joints(&self, model: &Model) -> Result<[usize; JOINTS], RobotError> {
        let names: Vec<&str> = (0..model.count(Object::Joint)).map(|joint| model.name(Object::Joint, joint)).collect();
        let mut joints = [0; JOINTS];
        for index in 0..JOINTS {
            let position = match &self.joints {
                Some(given) => names.iter().position(|name| *name == given[index]),
                None => usual(&names, index),
            };
            joints[index] = position.ok_or_else(|| {
                let moving = (0..names.len()).filter(|joint| !model.is_free(*joint));
                let named = |joint: usize| if names[joint].is_empty() { "one without a name" } else { names[joint] };
                RobotError::NoJoint {
                    wanted: self.joints.as_ref().map_or_else(|| joint_name(index), |given| given[index].clone()),
                    known: moving.map(named).collect::<Vec<_>>().join(", "),
                }
            })?;
            let name = || names[joints[index]].to_owned();
            if let Some(first) = (0..index).find(|first| joints[*first] == joints[index]) {
                return Err(RobotError::JointTwice { name: name(), first, second: index });
            }
            ensure!(model.is_hinge(joints[index]), RobotError::NoHinge { name: name(), joint: index });
        }
        Ok(joints)
    }
}

/// Expands three numbers to every leg, or accepts twelve in Supple's order.
fn of_joints(key: &'static str, numbers: &[f64]) -> Result<Joints, RobotError> {
    match *numbers {
        [hip, thigh, calf] => Ok(same_in_every_leg([hip, thigh, calf])),
        _ => <Joints>::try_from(numbers).map_err(|_| RobotError::Key {
            key,
            found: format!("{} numbers", numbers.len()),
            expected: "3, or 12 for FR, FL, RR, RL",
        }),
    }
}

/// Words for a joint that lets a leg swing sideways.
const SIDEWAYS: &[&str] =
    &["haa", "abduction", "abductor", "abduct", "abad", "hip_abduction", "hip_aa", "hx", "hipx", "hip_x", "hip_roll"];

/// Words for a joint that swings a leg forward.
const FORWARD: &[&str] =
    &["thigh", "hfe", "hip_flexion", "hip_fe", "upper", "upper_leg", "hy", "hipy", "hip_y", "hip_pitch"];

/// Words for a knee.
const KNEE: &[&str] = &["calf", "kfe", "knee", "knee_fe", "knee_pitch", "shank", "lower", "lower_leg", "kn"];

/// Returns the position of joint `index` among names that are usual for it, such as `FR_hip_joint`, `rf_haa`, `fl_hx`,
/// `HL_KFE`, `FL_HipX_joint` or `knee_front_left`.
fn usual(names: &[&str], index: usize) -> Option<usize> {
    let (leg, part) = (index / PARTS.len(), index % PARTS.len());
    let word = |name: &&str| leg_and_part(name).filter(|(of, _)| *of == leg).map(|(_, word)| word);
    // A joint named hip swings sideways, unless another joint of the leg does.
    let has_abduction = names.iter().filter_map(word).any(|word| SIDEWAYS.contains(&word.as_str()));
    names.iter().position(|name| {
        word(name).is_some_and(|word| match part {
            0 => SIDEWAYS.contains(&word.as_str()) || word == "hip" && !has_abduction,
            1 => FORWARD.contains(&word.as_str()) || word == "hip" && has_abduction,
            _ => KNEE.contains(&word.as_str()),
        })
    })
}

/// Splits the name of a joint into the leg's number and the word for its part.
fn leg_and_part(name: &str) -> Option<(usize, String)> {
    let name = name.to_lowercase();
    let mut words: Vec<&str> = name.split(['_', '-', '.', '/', ' ']).filter(|word| *word != "joint").collect();
    let short = |word: &str| match word {
        "fr" | "rf" => Some(0),
        "fl" | "lf" => Some(1),
        "rr" | "rh" | "hr" | "br" | "rb" => Some(2),
        "rl" | "lh" | "hl" | "bl" | "lb" => Some(3),
        _ => None,
    };
    let long = |pair: &[&str]| {
        let rear = |word: &str| match word {
            "front" | "fore" => Some(0),
            "rear" | "hind" | "back" => Some(2),
            _ => None,
        };
        let left = |word: &str| match word {
            "right" => Some(0),
            "left" => Some(1),
            _ => None,
        };
        Some(rear(pair[0]).or(rear(pair[1]))? + left(pair[0]).or(left(pair[1]))?)
    };
    let leg = if let Some(at) = words.iter().position(|word| short(word).is_some()) {
        short(words.remove(at))
    } else {
        let at = words.windows(2).position(|pair| long(pair).is_some())?;
        long(&words.drain(at..at + 2).collect::<Vec<_>>())
    };
    Some((leg?, words.join("_")))
}

/// Returns, for each joint in Supple's order, its position among names that are usual for a quadruped's twelve joints; `None`
/// if one is not recognised.
pub(crate) fn recognise(names: &[&str]) -> Option<[usize; JOINTS]> {
    let mut places = [0; JOINTS];
    for index in 0..JOINTS {
        places[index] = usual(names, index).filter(|place| !places[..index].contains(place))?;
    }
    Some(places)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joints_of_known_robots_are_recognised() {
        type Name = fn(&str, &str) -> String;
        let legs = |legs: [&str; 4], parts: [&str; 3], name: Name| -> Vec<String> {
            legs.iter().flat_map(|leg| parts.map(|part| name(leg, part))).collect()
        };
        let (plain, joint): (Name, Name) =
            (|leg, part| format!("{leg}_{part}"), |leg, part| format!("{leg}_{part}_joint"));
        let back: Name = |leg, part| format!("{part}_{leg}");
        let unitree = ["FR", "FL", "RR", "RL"];
        for (robot, names) in [
            ("Go1", legs(unitree, ["hip", "thigh", "calf"], joint)),
            ("A1 in PyBullet", legs(unitree, ["hip", "upper", "lower"], joint)),
            ("ANYmal", legs(["RF", "LF", "RH", "LH"], ["HAA", "HFE", "KFE"], plain)),
            ("Spot", legs(["fr", "fl", "hr", "hl"], ["hx", "hy", "kn"], plain)),
            ("solo12", legs(["FR", "FL", "HR", "HL"], ["HAA", "HFE", "KFE"], plain)),
            ("Lite3", legs(unitree, ["HipX", "HipY", "Knee"], joint)),
            ("Mini Cheetah", legs(["fr", "fl", "hr", "hl"], ["abduct", "thigh", "knee"], back)),
            (
                "Barkour",
                legs(["front_right", "front_left", "hind_right", "hind_left"], ["abduction", "hip", "knee"], back),
            ),
        ] {
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            assert_eq!(recognise(&names), Some(std::array::from_fn(|joint| joint)), "{robot}");
            let reversed: Vec<&str> = names.iter().rev().copied().collect();
            assert_eq!(recognise(&reversed), Some(std::array::from_fn(|joint| JOINTS - 1 - joint)), "{robot}");
        }
        assert_eq!(recognise(&["FR_hip"; JOINTS]), None);
    }
}
