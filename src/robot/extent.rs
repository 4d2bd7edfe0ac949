//! Dimensions of a trunk, from its collision shapes.

use nalgebra::Vector3;

use crate::mujoco::{Geom, GeomShape, Model, Object, unit};
use crate::util::numbers::maximum;

/// Distances from the trunk's origin to its ends, base frame \[m\].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Extent {
    /// Distance to the front end, over all shapes \[m\].
    pub ahead: f64,
    /// Distance to the rear end, over all shapes \[m\].
    pub behind: f64,
    /// Distance to the sides of the largest shape, the body between head and tail \[m\].
    pub side: f64,
}

impl Extent {
    /// Measures a body; the distances are zero if none of its geometries collides.
    pub(super) fn of(model: &Model, body: usize) -> Self {
        let is_shape = |geom: &usize| model.geom_body(*geom) == body && model.geom_contact(*geom).collides();
        let shapes: Vec<Geom> = (0..model.count(Object::Geom)).filter(is_shape).map(|geom| model.geom(geom)).collect();
        let reach = |shape: &Geom, direction: Vector3<f64>| {
            Vector3::from(shape.position).dot(&direction) + half_width(shape, direction)
        };
        let farthest = |direction| shapes.iter().map(|shape| reach(shape, direction)).fold(0.0, maximum);
        let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()];
        let volume = |shape: &&Geom| [x, y, z].map(|axis| half_width(shape, axis)).iter().product::<f64>();
        let largest = shapes.iter().max_by(|a, b| volume(a).total_cmp(&volume(b)));
        let side = largest.map_or(0.0, |shape| reach(shape, y).max(reach(shape, -y)));
        Extent { ahead: farthest(x), behind: farthest(-x), side }
    }
}

/// Returns half of a shape's width along a unit vector of its body's frame \[m\].
fn half_width(shape: &Geom, direction: Vector3<f64>) -> f64 {
    let along = unit(shape.quaternion).inverse() * direction;
    let size = Vector3::from(shape.size);
    match shape.shape {
        GeomShape::Sphere => size.x,
        GeomShape::Capsule => size.x + size.y * along.z.abs(),
        GeomShape::Cylinder => size.x * along.xy().norm() + size.y * along.z.abs(),
        GeomShape::Ellipsoid => along.component_mul(&size).norm(),
        // The sizes of a mesh are those of the box around it.
        GeomShape::Box | GeomShape::Mesh(_) => along.abs().dot(&size),
        GeomShape::Plane | GeomShape::HeightField(_) => 0.0,
    }
}
