/*! Joints that a robot's YAML file welds: those of an arm, a tail or wheels.

They keep the angles of the keyframe `home` (or the first), or those of the file without any; a URDF has all angles at zero.
*/

use super::load::load;
use super::newer::write_pose;
use super::source::Files;
use crate::mujoco::{Data, Object};
use crate::robot::error::RobotError;
use crate::util::xml::Element;

/// Returns those of the joints that are to be welded. A name with a star at its end stands for all that begin so.
fn chosen<'a>(weld: &[String], joints: &[&'a str]) -> Result<Vec<&'a str>, RobotError> {
    let fits = |wanted: &String, name: &str| match wanted.strip_suffix('*') {
        Some(beginning) => name.starts_with(beginning),
        None => name == wanted,
    };
    match weld.iter().find(|wanted| !joints.iter().any(|name| fits(wanted, name))) {
        Some(wanted) => Err(RobotError::NoWeld { wanted: wanted.clone(), known: joints.join(", ") }),
        None => Ok(joints.iter().copied().filter(|name| weld.iter().any(|wanted| fits(wanted, name))).collect()),
    }
}

fn note(joints: &[impl AsRef<str>], pose: &str) -> String {
    let names: Vec<&str> = joints.iter().map(AsRef::as_ref).collect();
    format!("welded: {}, {pose}", names.join(", "))
}

/// Welds joints of a URDF; returns a line for the report.
pub(super) fn weld_urdf(robot: &mut Element, weld: &[String]) -> Result<String, RobotError> {
    let moves = |child: &Element| child.name == "joint" && !matches!(child.get("type"), Some("fixed" | "floating"));
    let all: Vec<&str> = robot.children.iter().filter(|child| moves(child)).filter_map(|it| it.get("name")).collect();
    let joints: Vec<String> = chosen(weld, &all)?.into_iter().map(str::to_owned).collect();
    for joint in robot.children.iter_mut().filter(|child| moves(child)) {
        if joint.get("name").is_some_and(|name| joints.iter().any(|joint| joint == name)) {
            joint.set("type", "fixed");
        }
    }
    Ok(note(&joints, "all at zero"))
}

/// Welds joints of an MJCF document; returns a line for the report.
pub(super) fn weld(tree: &mut Element, weld: &[String], files: &Files) -> Result<String, RobotError> {
    let model = load(tree, files)?;
    let mut data = Data::new(model.try_clone()?)?;
    let moving = || (0..model.count(Object::Joint)).filter(|joint| !model.is_free(*joint));
    let names: Vec<&str> = moving().map(|joint| model.name(Object::Joint, joint)).filter(|it| !it.is_empty()).collect();
    let joints: Vec<String> = chosen(weld, &names)?.into_iter().map(str::to_owned).collect();
    let is_welded = |name: &str| joints.iter().any(|joint| joint == name);
    let ids: Vec<usize> = moving().filter(|joint| is_welded(model.name(Object::Joint, *joint))).collect();
    // Positions lie in the order of the joints; a ball has four.
    let end = |joint: usize| {
        if joint + 1 < model.count(Object::Joint) { model.joint_position_index(joint + 1) } else { model.nq() }
    };
    let places: Vec<usize> = ids.iter().flat_map(|joint| model.joint_position_index(*joint)..end(*joint)).collect();
    let bodies: Vec<usize> = ids.iter().map(|joint| model.joint_body(*joint)).collect();
    let (mut positions, mut pose) = (model.rest_positions().to_vec(), "at the angles of its file");
    if let Some(keyframe) = model.keyframe() {
        places.iter().for_each(|place| positions[*place] = keyframe[*place]);
        pose = "at the angles of its keyframe";
    }
    data.positions_mut().copy_from_slice(&positions);
    data.step1()?;
    let mut id = 0;
    for world in tree.children.iter_mut().filter(|child| child.name == "worldbody") {
        change(world, &mut id, &data, &bodies, &is_welded);
    }
    for section in &mut tree.children {
        match section.name.as_str() {
            "actuator" => section.children.retain(|actuator| {
                !["joint", "jointinparent"].iter().any(|it| actuator.get(it).is_some_and(is_welded))
            }),
            "keyframe" => section.children.iter_mut().for_each(|key| shorten(key, &places)),
            _ => {}
        }
    }
    Ok(note(&joints, pose))
}

/// Takes the joints out of the bodies below `element`, in the pose of `data`; `id` counts the bodies.
fn change(element: &mut Element, id: &mut usize, data: &Data, bodies: &[usize], is_welded: &impl Fn(&str) -> bool) {
    for body in element.children.iter_mut().filter(|child| child.name == "body") {
        *id += 1;
        if bodies.contains(id) {
            body.children.retain(|child| child.name != "joint" || !child.get("name").is_some_and(is_welded));
            let above = data.body_pose(data.model().body_parent(*id));
            write_pose(&(above.inverse() * data.body_pose(*id)), body);
        }
        change(body, id, data, bodies, is_welded);
    }
}

/// Takes the positions at some places out of a keyframe.
fn shorten(key: &mut Element, places: &[usize]) {
    let Some(qpos) = key.get("qpos") else { return };
    let numbers = qpos.split_whitespace().enumerate().filter(|(place, _)| !places.contains(place));
    let kept = numbers.map(|(_, number)| number).collect::<Vec<_>>().join(" ");
    key.set("qpos", kept);
}
