//! The parts whose mass or inertia MuJoCo changes, because of the compiler settings of a file.

use nalgebra::Matrix3;

use super::load::load;
use super::normalise::OF_MASSES;
use super::source::Files;
use crate::mujoco::{Model, Object};
use crate::util::xml::Element;

/// Largest relative difference of two masses or moments that count as the same: a file may have seven digits.
const SAME: f64 = 1e-6;

/// A mass \[kg\], then the three principal moments of inertia, rising [kg·m²].
type Inertia = [f64; 4];

fn found(model: &Model, body: usize) -> Inertia {
    rising(model.body_mass()[body], model.body_inertia(body))
}

fn rising(mass: f64, mut moments: [f64; 3]) -> Inertia {
    moments.sort_by(f64::total_cmp);
    [mass, moments[0], moments[1], moments[2]]
}

/// Returns what the `<inertial>` of a URDF or MJCF file states; `None` if it does not state both.
fn stated(inertial: &Element) -> Option<Inertia> {
    let numbers = |text: &str| text.split_whitespace().map(str::parse).collect::<Result<Vec<f64>, _>>().ok();
    let full =
        |[x, y, z, xy, xz, yz]: [f64; 6]| Matrix3::new(x, xy, xz, xy, y, yz, xz, yz, z).symmetric_eigenvalues().into();
    let own = |name: &str| inertial.get(name).and_then(numbers);
    if let (Some(mass), Some(inertia)) = (inertial.all("mass").next(), inertial.all("inertia").next()) {
        let moment = |name: &str| inertia.get(name).map_or(Some(0.0), |text| text.trim().parse().ok());
        let [x, y, z, xy, xz, yz] = ["ixx", "iyy", "izz", "ixy", "ixz", "iyz"].map(moment);
        return Some(rising(mass.get("value")?.trim().parse().ok()?, full([x?, y?, z?, xy?, xz?, yz?])));
    }
    let moments = match own("fullinertia") {
        Some(six) => full(six.try_into().ok()?),
        None => own("diaginertia")?.try_into().ok()?,
    };
    Some(rising(own("mass")?.first().copied()?, moments))
}

fn differ(a: &Inertia, b: &Inertia) -> bool {
    let scale = a[3].abs().max(b[3].abs());
    (a[0] - b[0]).abs() > SAME * a[0].abs() || (1..4).any(|k| (a[k] - b[k]).abs() > SAME * scale)
}

/// Returns the links of a URDF that have another mass or inertia in the model than in the file.
pub(super) fn changed_links(model: &Model, robot: &Element) -> Vec<String> {
    let links = robot.all("link").filter_map(|link| {
        let (name, stated) = (link.get("name")?, stated(link.all("inertial").next()?)?);
        differ(&stated, &found(model, model.id(Object::Body, name).ok()?)).then(|| format!("'{name}'"))
    });
    links.collect()
}

/// Returns the bodies of a robot's MJCF file that have another mass or inertia than without the settings [`OF_MASSES`]; `None` if
/// MuJoCo does not compile it without them.
pub(super) fn changed_bodies(model: &Model, trunk: usize, tree: &Element, files: &Files) -> Option<Vec<String>> {
    let mut plain = tree.clone();
    // Without joints, a body may have no mass.
    plain.children.retain(|child| !matches!(child.name.as_str(), "actuator" | "keyframe" | "custom"));
    for section in &mut plain.children {
        match section.name.as_str() {
            "compiler" => {
                OF_MASSES.iter().for_each(|name| section.remove(name));
                section.set("balanceinertia", "true");
            }
            "worldbody" => without_joints(section),
            _ => {}
        }
    }
    let plain = load(&plain, files).ok()?;
    let mut inertials = Vec::new();
    for world in tree.all("worldbody") {
        list(world, &mut inertials);
    }
    let changed = (1..model.count(Object::Body).min(plain.count(Object::Body))).filter(|body| {
        // Impossible moments are made equal in both.
        let stated = inertials.get(body - 1).copied().flatten().and_then(stated);
        let is_balanced = stated.is_none_or(|[_, a, b, c]| a + b >= c * (1.0 - SAME));
        let is_changed = !is_balanced || differ(&found(&plain, *body), &found(model, *body));
        is_changed && model.is_below(*body, trunk)
    });
    let named = |body| match model.name(Object::Body, body) {
        "" => "a body without a name".to_owned(),
        name => format!("'{name}'"),
    };
    Some(changed.map(named).collect())
}

fn without_joints(element: &mut Element) {
    element.children.retain(|child| !matches!(child.name.as_str(), "joint" | "freejoint"));
    element.children.iter_mut().for_each(without_joints);
}

/// Lists the `<inertial>` of every body, in the order of their numbers.
fn list<'a>(element: &'a Element, inertials: &mut Vec<Option<&'a Element>>) {
    for body in element.all("body") {
        inertials.push(body.all("inertial").next());
        list(body, inertials);
    }
}
