/*! Conversion of a MuJoCo model's geometries to rerun's solids.

Every body becomes one entity with up to four archetypes, each a batch of its geometries of one kind in the body's
frame, logged once. MuJoCo's conventions and rerun's differ in places: half-lengths against lengths, capsules about
their middle against capsules from their first end, quaternions with w first against w last.
*/

use re_sdk_types::archetypes::{Boxes3D, Capsules3D, Cylinders3D, Ellipsoids3D, Points3D};
use re_sdk_types::components::{Color, FillMode, HalfSize3D};
use re_sdk_types::datatypes::Quaternion;
use rerun::EntityPath;

use super::Result;
use super::stream::Stream;
use super::style::Rgb;
use supple::mujoco::{Geom, GeomShape, Model, Object};

/// Visual groups that are drawn: looks, feet, obstacles. Group 3 contains collision geometries.
const DRAWN_GROUPS: std::ops::RangeInclusive<i32> = 0..=2;
/// Number of free balls from which they are logged as one entity.
const FEWEST_BALLS: usize = 4;
/// Weight of the tint in light parts of a robot, 0 to 1.
const TINT_SHARE: f32 = 0.5;

/// The moving parts of a model and their names.
pub(super) struct Parts {
    pub(super) trunk: usize,
    /// Ids and paths of the bodies that have their own entity.
    pub(super) bodies: Vec<(usize, EntityPath)>,
    /// Ids of the bodies that are single balls.
    pub(super) balls: Vec<usize>,
}

/// Logs the visible geometries of a model below `root`, except its ground; returns the moving parts.
pub(super) fn log_model(stream: &Stream, root: &EntityPath, model: &Model, tint: Option<Rgb>) -> Result<Parts> {
    let trunk = model.id(Object::Body, "trunk")?;
    let geoms: Vec<Geom> = (0..model.count(Object::Geom)).map(|id| model.geom(id)).collect();
    let count = model.count(Object::Body);
    let is_robot: Vec<bool> = (0..count).map(|body| model.is_below(body, trunk)).collect();
    let looks: Vec<Vec<&Geom>> = (0..count).map(|body| looks_of(body, &geoms)).collect();

    let is_ball = |&body: &usize| {
        let alone = matches!(looks[body][..], [geom] if geom.shape == GeomShape::Sphere && geom.position == [0.0; 3]);
        alone && !is_robot[body] && model.body_parent(body) == 0
    };
    let mut balls: Vec<usize> = (1..count).filter(is_ball).collect();
    if balls.len() < FEWEST_BALLS {
        balls.clear();
    }

    let mut bodies = Vec::new();
    for body in (0..count).filter(|body| !balls.contains(body)) {
        let solid = |geom: &&Geom| Solid::new(geom, colour(geom.rgba, tint.filter(|_| is_robot[body])));
        let solids: Vec<Solid> = looks[body].iter().map(solid).collect();
        let path = match (body, model.name(Object::Body, body)) {
            (0, _) => child(&scene_path(root), "fixed"),
            (_, "") => child(root, &format!("body {body}")),
            (_, name) => child(root, name),
        };
        log_solids(stream, &path, &solids)?;
        if body != 0 {
            bodies.push((body, path));
        }
    }
    if !balls.is_empty() {
        let geoms = balls.iter().flat_map(|ball| looks[*ball].first());
        let (radii, colours): (Vec<f32>, Vec<Color>) =
            geoms.map(|geom| (geom.size[0] as f32, colour(geom.rgba, None))).unzip();
        let archetype = Points3D::update_fields().with_radii(radii).with_colors(colours);
        stream.log_static(&balls_path(root), &archetype)?;
    }
    Ok(Parts { trunk, bodies, balls })
}

/// Returns the path of the fixed parts of the scene: grounds, geometries of the world, balls.
pub(super) fn scene_path(root: &EntityPath) -> EntityPath {
    child(root, "scene")
}

/// Returns the path of the entity with all balls.
pub(super) fn balls_path(root: &EntityPath) -> EntityPath {
    child(&scene_path(root), "balls")
}

/// Returns true if the scene has more than the robot and the ground.
pub(super) fn has_obstacles(model: &Model) -> Result<bool> {
    let trunk = model.id(Object::Body, "trunk")?;
    let mut geoms = (0..model.count(Object::Geom)).map(|id| model.geom(id));
    Ok(geoms.any(|geom| !is_ground(&geom) && !model.is_below(geom.body, trunk)))
}

fn is_ground(geom: &Geom) -> bool {
    matches!(geom.shape, GeomShape::Plane | GeomShape::HeightField(_))
}

/// Returns the path of an entity below another one; its name may contain any character.
pub(super) fn child(parent: &EntityPath, name: &str) -> EntityPath {
    parent.join(&EntityPath::from_single_string(name.to_owned()))
}

/// Returns the drawn geometries of a body: its visual ones, or the collision geometries if it has no visual ones.
fn looks_of(body: usize, geoms: &[Geom]) -> Vec<&Geom> {
    let solid = |geom: &&Geom| {
        let flat = is_ground(geom) || matches!(geom.shape, GeomShape::Mesh(_));
        geom.body == body && !flat && geom.rgba[3] > 0.0
    };
    let (shown, hidden): (Vec<&Geom>, Vec<&Geom>) =
        geoms.iter().filter(solid).partition(|geom| DRAWN_GROUPS.contains(&geom.group));
    if shown.is_empty() && body != 0 { hidden } else { shown }
}

/// Returns the colour and opacity of every geometry in pictures, 0 to 1; `None` for those that are not drawn.
#[cfg(feature = "video")]
pub(super) fn colours(model: &Model, tint: Option<Rgb>) -> supple::mujoco::Result<Vec<Option<[f32; 4]>>> {
    let trunk = model.id(Object::Body, "trunk")?;
    let geoms: Vec<Geom> = (0..model.count(Object::Geom)).map(|id| model.geom(id)).collect();
    let rgba = |geom: &Geom| {
        if is_ground(geom) {
            return Some(geom.rgba);
        }
        looks_of(geom.body, &geoms).into_iter().find(|drawn| std::ptr::eq(*drawn, geom))?;
        let tint = tint.filter(|_| model.is_below(geom.body, trunk));
        Some(colour(geom.rgba, tint).to_array().map(|part| f32::from(part) / 255.0))
    };
    Ok(geoms.iter().map(rgba).collect())
}

/// Returns the drawn colour: light parts take on some of the tint, dark parts keep their colour.
fn colour([red, green, blue, alpha]: [f32; 4], tint: Option<Rgb>) -> Color {
    let share = if red.max(green).max(blue) > 0.6 { TINT_SHARE } else { 0.0 };
    let mixed = |own: f32, tint: u8| own + share * (f32::from(tint) / 255.0 * 1.1 - own);
    let tinted = tint.map(|tint| [mixed(red, tint[0]), mixed(green, tint[1]), mixed(blue, tint[2])]);
    let [red, green, blue] = tinted.unwrap_or([red, green, blue]);
    let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
    Color::from_unmultiplied_rgba(byte(red), byte(green), byte(blue), byte(alpha))
}

/// A geometry in rerun's conventions; the sizes are MuJoCo's, see [`GeomShape`] \[m\].
struct Solid {
    shape: GeomShape,
    size: [f32; 3],
    position: [f32; 3],
    quaternion: Quaternion,
    colour: Color,
}

impl Solid {
    fn new(geom: &Geom, colour: Color) -> Self {
        let mut size = geom.size.map(|x| x as f32);
        let mut position = geom.position.map(|x| x as f32);
        let [w, x, y, z] = geom.quaternion.map(|x| x as f32);
        match geom.shape {
            GeomShape::Sphere => size = [size[0]; 3],
            GeomShape::Capsule => position = capsule_start(size[1], position, [w, x, y, z]),
            // Grounds are drawn by `ground`; `looks_of` leaves out the rest.
            _ => {}
        }
        Solid { shape: geom.shape, size, position, quaternion: Quaternion::from_xyzw([x, y, z, w]), colour }
    }
}

/// Logs the geometries of a body, one batch for each kind.
fn log_solids(stream: &Stream, path: &EntityPath, solids: &[Solid]) -> Result<()> {
    let half_sizes = |batch: &[&Solid]| batch.iter().map(|solid| HalfSize3D::from(solid.size)).collect::<Vec<_>>();
    let lengths = |batch: &[&Solid]| batch.iter().map(|solid| 2.0 * solid.size[1]).collect::<Vec<f32>>();
    let radii = |batch: &[&Solid]| batch.iter().map(|solid| solid.size[0]).collect::<Vec<f32>>();
    macro_rules! log {
        ($shape:pat, $with_positions:ident, $Archetype:ident::$from:ident($($of:ident),*)) => {
            let batch: Vec<&Solid> = solids.iter().filter(|solid| matches!(solid.shape, $shape)).collect();
            if !batch.is_empty() {
                let archetype = $Archetype::$from($($of(&batch)),*);
                let archetype = archetype.$with_positions(batch.iter().map(|solid| solid.position));
                let archetype = archetype.with_quaternions(batch.iter().map(|solid| solid.quaternion));
                let archetype = archetype.with_colors(batch.iter().map(|solid| solid.colour));
                stream.log_static(path, &archetype.with_fill_mode(FillMode::Solid))?;
            }
        };
    }
    log!(GeomShape::Box, with_centers, Boxes3D::from_half_sizes(half_sizes));
    log!(GeomShape::Capsule, with_translations, Capsules3D::from_lengths_and_radii(lengths, radii));
    log!(GeomShape::Cylinder, with_centers, Cylinders3D::from_lengths_and_radii(lengths, radii));
    log!(GeomShape::Sphere | GeomShape::Ellipsoid, with_centers, Ellipsoids3D::from_half_sizes(half_sizes));
    Ok(())
}

/// Returns the centre of a capsule's lower cap: rerun's capsules start there, MuJoCo's position is the middle.
fn capsule_start(half_length: f32, position: [f32; 3], [w, x, y, z]: [f32; 4]) -> [f32; 3] {
    let axis = [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)];
    std::array::from_fn(|k| position[k] - half_length * axis[k])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn capsule_along_x_starts_half_its_length_behind_its_middle() {
        // A quarter turn about y takes z to x.
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let start = capsule_start(0.1, [1.0, 2.0, 3.0], [half, 0.0, half, 0.0]);
        let expected = [0.9, 2.0, 3.0];
        assert!(start.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{start:?}");
    }

    #[test]
    fn tint_colours_light_parts_and_leaves_dark_ones() {
        let dark = colour([0.1, 0.1, 0.1, 1.0], Some([230, 159, 0]));
        assert_eq!(dark, Color::from_rgb(26, 26, 26));
        let [red, _, blue, _] = colour([0.7, 0.7, 0.7, 1.0], Some([230, 159, 0])).to_array();
        assert!(red > 190 && blue < 100);
    }
}
