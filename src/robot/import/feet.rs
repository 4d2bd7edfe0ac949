/*! The feet of an imported robot: which geometries they are, and the points they stand on.

A foot may be a sphere, capsule, cylinder, ellipsoid, box or mesh, and collides as such. Heights, odometry and forces need one
point of it: the lowest one in the nominal pose, world frame. What rolls there (the end of a capsule, a lying cylinder, a round
mesh) is a sphere of that radius above the point, so that the point moves as the foot rolls; an edge or a flat face is nearly a
point, and stays on the foot.
*/

use nalgebra::{Matrix3, Vector3};

use super::names::Description;
use crate::mujoco::{Data, GeomShape, Model, Object};
use crate::robot::error::RobotError;
use crate::robot::{LEGS, joint_name};

/// Radius for feet that do not roll \[m\].
const EDGE_M: f64 = 1e-3;

/// Difference of heights below which points count as equally low \[m\].
const LEVEL_M: f64 = 1e-4;

/// Largest sine of the angle between the ground and the axis of a cylinder that rolls on its side.
const LYING: f64 = 0.1;

/// Largest part by which the lower end of a mesh may differ from a sphere and yet roll like one.
const ROUND: f64 = 0.15;

/// The lower end of a geometry in some pose, world frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct LowerEnd {
    /// The lowest point \[m\].
    pub(super) point: Vector3<f64>,
    /// Radius of the sphere above the point that rolls as the geometry does \[m\].
    pub(super) radius: f64,
}

/// The sphere that stands for a foot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sole {
    /// Centre in the frame of the foot's body \[m\].
    pub(super) centre: [f64; 3],
    /// Radius \[m\].
    pub(super) radius: f64,
}

/// Finds the geometries that are the feet, in the order of the legs: those of the given names, or the lowest that collides
/// below each calf. `data` is the robot in its nominal pose.
pub(super) fn find(data: &Data, description: &Description, joints: &[usize]) -> Result<[usize; 4], RobotError> {
    let mut feet = [0; 4];
    for leg in 0..LEGS.len() {
        let Some(names) = &description.feet else {
            feet[leg] = lowest(data, leg, joints)?;
            continue;
        };
        if let Some(first) = (0..leg).find(|first| names[*first] == names[leg]) {
            return Err(RobotError::FootTwice { name: names[leg].clone(), first: LEGS[first], second: LEGS[leg] });
        }
        feet[leg] = named(data.model(), &names[leg], leg, joints)?;
    }
    Ok(feet)
}

fn named(model: &Model, name: &str, leg: usize, joints: &[usize]) -> Result<usize, RobotError> {
    let Ok(foot) = model.id(Object::Geom, name) else {
        let names = (0..model.count(Object::Geom)).map(|geom| model.name(Object::Geom, geom));
        let known = names.filter(|name| !name.is_empty()).collect::<Vec<_>>().join(", ");
        return Err(RobotError::NoGeometry { name: name.to_owned(), leg: LEGS[leg], known });
    };
    let found = match model.geom(foot).shape {
        GeomShape::Plane => "is a plane",
        GeomShape::HeightField(_) => "is a height field",
        _ if !model.geom_contact(foot).collides() => "does not collide (its contype and conaffinity are 0)",
        _ => "",
    };
    ensure!(found.is_empty(), RobotError::FootShape { name: name.to_owned(), leg: LEGS[leg], found });
    let body = model.geom_body(foot);
    if !model.is_below(body, model.joint_body(joints[3 * leg + 2])) {
        let part = (0..joints.len()).rev().find(|joint| model.is_below(body, model.joint_body(joints[*joint])));
        let found = part.map_or_else(|| "the trunk".to_owned(), joint_name);
        return Err(RobotError::ForeignFoot { name: name.to_owned(), leg: LEGS[leg], found });
    }
    Ok(foot)
}

fn lowest(data: &Data, leg: usize, joints: &[usize]) -> Result<usize, RobotError> {
    let model = data.model();
    // A foot may be a body of its own, fixed to the calf.
    let calf = model.joint_body(joints[3 * leg + 2]);
    let candidates: Vec<(usize, f64)> = (0..model.count(Object::Geom))
        .filter(|geom| model.geom_contact(*geom).collides() && model.is_below(model.geom_body(*geom), calf))
        .filter_map(|geom| Some((geom, lower_end(data, geom)?.point.z)))
        .collect();
    let least = |geoms: &mut dyn Iterator<Item = &(usize, f64)>| geoms.min_by(|a, b| a.1.total_cmp(&b.1)).copied();
    let all = least(&mut candidates.iter()).ok_or(RobotError::NoFoot { leg: LEGS[leg] })?;
    let is_sphere = |candidate: &&(usize, f64)| model.geom(candidate.0).shape == GeomShape::Sphere;
    // A calf's shape may reach down into the sphere that is its foot, and even below it, as the A1's does.
    match least(&mut candidates.iter().filter(is_sphere)) {
        Some((sphere, height)) if height - all.1 <= model.geom(sphere).size[0] => Ok(sphere),
        _ => Ok(all.0),
    }
}

/// Returns the lower end of a geometry; `None` if it is ground.
pub(super) fn lower_end(data: &Data, geom: usize) -> Option<LowerEnd> {
    let shape = data.model().geom(geom);
    let [r, h, _] = shape.size;
    let centre = Vector3::from_column_slice(&data.geom_positions()[3 * geom..][..3]);
    let turn = Matrix3::from_row_slice(&data.geom_rotations()[9 * geom..][..9]);
    let axis: Vector3<f64> = turn.column(2).into();
    // How far down an end of the axis is; 0 if it is level.
    let end = |half: f64| if half * axis.z.abs() < LEVEL_M { 0.0 } else { -axis.z.signum() * half };
    let down = -Vector3::z();
    Some(match shape.shape {
        GeomShape::Plane | GeomShape::HeightField(_) => return None,
        GeomShape::Sphere => LowerEnd { point: centre + down * r, radius: r },
        GeomShape::Capsule => LowerEnd { point: centre + axis * end(h) + down * r, radius: r },
        GeomShape::Cylinder => {
            let across = down - axis * axis.dot(&down);
            let rim = across.try_normalize(1e-3).unwrap_or_default();
            let lies = axis.z.abs() < LYING;
            LowerEnd { point: centre + axis * end(h) + rim * r, radius: if lies { r } else { EDGE_M } }
        }
        GeomShape::Ellipsoid => {
            let size = Vector3::from(shape.size);
            let scaled = size.component_mul(&(turn.transpose() * down));
            let point = centre + turn * size.component_mul(&scaled) / scaled.norm();
            LowerEnd { point, radius: size.min() }
        }
        GeomShape::Box => {
            let corner = Vector3::from_fn(|k, _| {
                let (half, rise) = (shape.size[k], turn[(2, k)]);
                if half * rise.abs() < LEVEL_M { 0.0 } else { -rise.signum() * half }
            });
            LowerEnd { point: centre + turn * corner, radius: EDGE_M }
        }
        GeomShape::Mesh(mesh) => {
            let corners = data.model().mesh_vertices(mesh).chunks_exact(3);
            let corner = |corner: &[f32]| {
                centre + turn * Vector3::new(f64::from(corner[0]), f64::from(corner[1]), f64::from(corner[2]))
            };
            lower_end_of_mesh(&corners.map(corner).collect::<Vec<_>>())?
        }
    })
}

fn lower_end_of_mesh(corners: &[Vector3<f64>]) -> Option<LowerEnd> {
    let first = *corners.first()?;
    let (low, high) = corners.iter().fold((first, first), |(low, high), corner| (low.inf(corner), high.sup(corner)));
    let lowest: Vec<_> = corners.iter().filter(|corner| corner.z - low.z < LEVEL_M).collect();
    let point = lowest.iter().copied().sum::<Vector3<f64>>() / lowest.len() as f64;
    let point = Vector3::new(point.x, point.y, low.z);
    // A mesh is round if it is equally far from the middle in all directions over which a foot rolls.
    let middle = (low + high) / 2.0;
    let radius = ((high.x - low.x).min(high.y - low.y) / 2.0).min(middle.z - low.z);
    let centre = Vector3::new(middle.x, middle.y, low.z + radius);
    let mut below = corners.iter().map(|corner| corner - centre).filter(|arm| -arm.z > 0.7 * arm.norm());
    let is_round = below.all(|arm| (arm.norm() - radius).abs() < ROUND * radius);
    let is_flat = lowest.iter().any(|corner| (*corner - centre).xy().norm() > 0.5 * radius);
    Some(if is_round && !is_flat && radius > EDGE_M {
        LowerEnd { point: Vector3::new(middle.x, middle.y, low.z), radius }
    } else {
        LowerEnd { point, radius: EDGE_M }
    })
}

/// Returns the sphere that stands for a foot in the pose of `data`.
pub(super) fn sole(data: &Data, geom: usize) -> Option<Sole> {
    let LowerEnd { point, radius } = lower_end(data, geom)?;
    let body = data.body_pose(data.model().geom_body(geom));
    let centre = body.rotation.inverse() * (point + Vector3::z() * radius - body.translation.vector);
    Some(Sole { centre: centre.into(), radius })
}
