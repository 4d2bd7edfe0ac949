//! Angles of a robot's document, converted to the unit and order of rotations of scenes.

use super::newer;
use crate::util::numbers::spaced;
use crate::util::xml::Element;

/// Writes all angles in radians, and rotations of another order than MuJoCo's as quaternions, because the unit and the order of a file
/// would hold for the whole scene. Returns a line for the report if the file has another order.
pub(super) fn settle_angles(tree: &mut Element) -> Option<String> {
    let setting = |name: &str| tree.all("compiler").filter_map(|compiler| compiler.get(name)).last().map(str::to_owned);
    let degrees = setting("angle").as_deref() != Some("radian");
    let sequence = setting("eulerseq").filter(|sequence| sequence != "xyz");
    for child in tree.children.iter_mut() {
        match child.name.as_str() {
            "compiler" => {
                child.set("angle", "radian");
                child.remove("eulerseq");
            }
            "default" | "worldbody" => settle(child, degrees, sequence.as_deref()),
            _ => {}
        }
    }
    sequence.map(|sequence| format!("angles: turns in the order {sequence} written as quaternions"))
}

fn settle(element: &mut Element, degrees: bool, sequence: Option<&str>) {
    let unit = if degrees { std::f64::consts::PI / 180.0 } else { 1.0 };
    let angles: &[&str] =
        if element.name == "joint" { &["range", "ref", "springref"] } else { &["axisangle", "euler"] };
    if degrees {
        for (name, value) in element.attributes.iter_mut().filter(|(name, _)| angles.contains(&name.as_str())) {
            // Of an axis and an angle, the last number is the angle.
            let from = if name == "axisangle" { 3 } else { 0 };
            let numbers = value.split_whitespace().enumerate().map(|(index, word)| match word.parse::<f64>() {
                Ok(number) if index >= from => (number * unit).to_string(),
                _ => word.to_owned(),
            });
            *value = numbers.collect::<Vec<_>>().join(" ");
        }
    }
    if let (Some(sequence), Some(euler)) = (sequence, element.get("euler"))
        && let Some(turn) = newer::euler(euler, sequence)
    {
        element.remove("euler");
        element.set("quat", spaced(&[turn.w, turn.i, turn.j, turn.k]));
    }
    element.children.iter_mut().for_each(|child| settle(child, degrees, sequence));
}
