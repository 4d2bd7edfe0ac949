/*! The ground under a robot, drawn as a coloured mesh.

A plane is a chequered patch whose rim fades into the background and which moves with the robot in whole periods of its
pattern: it looks endless, gives a sense of motion, and costs a few kilobytes. A height field is drawn as its own
triangles, split along the same diagonal as MuJoCo's, with heights as shades; squares that differ in friction are blue
where they are slippery and brown where they are not.
*/

use re_sdk_types::archetypes::Mesh3D;
use rerun::EntityPath;

use super::Result;
use super::geometry::{child, scene_path};
use super::stream::Stream;
use super::style::{BACKGROUND, Rgb, opaque};
use supple::mujoco::{Geom, GeomShape, Model, Object};
use supple::sim::{Ground, Patches};

/// Edge of a square of the pattern \[m\].
const SQUARE_M: f32 = 0.5;
/// Number of squares along an edge of the patch; even.
const SQUARES: i32 = 48;
/// Distances from the patch's middle at which the ground begins to fade and at which it has vanished \[m\].
const FADE_M: [f32; 2] = [3.5, 11.5];
/// Maximum number of drawn grid points of a height field along an edge.
const MOST_POINTS: usize = 401;
/// Colours of the two kinds of squares of a plane.
const SQUARE_COLOURS: [Rgb; 2] = [[92, 99, 108], [104, 112, 122]];
/// Colours of the lowest and the highest point of a height field.
const HEIGHT_COLOURS: [Rgb; 2] = [[66, 74, 84], [150, 156, 150]];

/// Colours of the squares with the lowest and the highest friction, and the weight of these colours.
const SLIPPERY: Rgb = [96, 140, 170];
const GRIPPY: Rgb = [122, 104, 70];
const FRICTION_SHARE: f32 = 0.55;

/// A chequered patch of ground that follows the robot.
pub(super) struct Patch {
    path: EntityPath,
    /// Position of the patch's middle, in periods of the pattern; `None` before it has been logged.
    cell: Option<[i32; 2]>,
}

/// Logs every plane and height field of the world; returns the patches of the planes.
pub(super) fn log_grounds(stream: &Stream, root: &EntityPath, model: &Model, ground: &Ground) -> Result<Vec<Patch>> {
    let mut patches = Vec::new();
    for geom in (0..model.count(Object::Geom)).map(|id| model.geom(id)) {
        let name = if geom.name.is_empty() { "ground" } else { &geom.name };
        let path = child(&scene_path(root), name);
        match geom.shape {
            GeomShape::Plane => {
                stream.log_static(&path, &patch_mesh(geom.position[2] as f32))?;
                patches.push(Patch { path, cell: None });
            }
            GeomShape::HeightField(id) => stream.log_static(&path, &field_mesh(model, &geom, id, ground.patches()))?,
            _ => {}
        }
    }
    Ok(patches)
}

impl Patch {
    /// Moves the patch so that it stays under the robot.
    pub(super) fn follow(&mut self, stream: &Stream, [x, y, _]: [f32; 3]) -> Result<()> {
        let period = 2.0 * SQUARE_M;
        let cell = [x, y].map(|value| (value / period).round() as i32);
        if self.cell == Some(cell) {
            return Ok(());
        }
        self.cell = Some(cell);
        let [x, y] = cell.map(|cell| cell as f32 * period);
        stream.place(&self.path, [x, y, 0.0], None)
    }
}

fn patch_mesh(height: f32) -> Mesh3D {
    let (mut positions, mut colours, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
    let half = SQUARES / 2;
    for (row, column) in (-half..half).flat_map(|row| (-half..half).map(move |column| (row, column))) {
        let own = SQUARE_COLOURS[(row + column).rem_euclid(2) as usize];
        let first = positions.len() as u32;
        for (dx, dy) in [(0, 0), (1, 0), (1, 1), (0, 1)] {
            let (x, y) = ((column + dx) as f32 * SQUARE_M, (row + dy) as f32 * SQUARE_M);
            let fade = ((x.hypot(y) - FADE_M[0]) / (FADE_M[1] - FADE_M[0])).clamp(0.0, 1.0);
            positions.push([x, y, height]);
            colours.push(opaque(mix(own, BACKGROUND, fade * fade * (3.0 - 2.0 * fade))));
        }
        triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    // No normals: unshaded, so that the rim meets the background's colour.
    Mesh3D::new(positions).with_triangle_indices(triangles).with_vertex_colors(colours)
}

fn field_mesh(model: &Model, geom: &Geom, id: usize, patches: Option<&Patches>) -> Mesh3D {
    let (rows, columns, [half_x, half_y, relief, _]) = model.height_field_size(id);
    let elevations = model.height_field(id);
    let stride = rows.max(columns).div_ceil(MOST_POINTS);
    let kept = |count: usize| (0..count).filter(|k| k % stride == 0 || *k + 1 == count).collect::<Vec<_>>();
    let (kept_rows, kept_columns) = (kept(rows), kept(columns));
    let (dx, dy) = (2.0 * half_x / (columns - 1) as f64, 2.0 * half_y / (rows - 1) as f64);
    let at = |row: usize, column: usize| f64::from(elevations[row * columns + column]) * relief;
    let slope = |low: f64, high: f64, span: f64| if span > 0.0 { (high - low) / span } else { 0.0 };

    let friction_range = patches.map(|patches| range(&patches.friction));
    let friction = |x: f64, y: f64| {
        let (patches, [low, high]) = patches.zip(friction_range)?;
        Some(((patches.at(x, y) - low) / (high - low).max(1e-9)) as f32)
    };

    let (mut positions, mut normals, mut colours) = (Vec::new(), Vec::new(), Vec::new());
    for (&row, &column) in kept_rows.iter().flat_map(|row| kept_columns.iter().map(move |column| (row, column))) {
        let (left, right) = (column.saturating_sub(1), (column + 1).min(columns - 1));
        let (front, back) = (row.saturating_sub(1), (row + 1).min(rows - 1));
        let slope_x = slope(at(row, left), at(row, right), (right - left) as f64 * dx);
        let slope_y = slope(at(front, column), at(back, column), (back - front) as f64 * dy);
        let length = (slope_x * slope_x + slope_y * slope_y + 1.0).sqrt();
        let local = [column as f64 * dx - half_x, row as f64 * dy - half_y, at(row, column)];
        positions.push(std::array::from_fn::<f32, 3, _>(|k| (geom.position[k] + local[k]) as f32));
        normals.push([-slope_x, -slope_y, 1.0].map(|value| (value / length) as f32));
        let square = [local[0], local[1]].map(|value| (value / f64::from(SQUARE_M)).floor() as i64);
        let shade = mix(HEIGHT_COLOURS[0], HEIGHT_COLOURS[1], elevations[row * columns + column]);
        let grip = friction(geom.position[0] + local[0], geom.position[1] + local[1]);
        let shade = grip.map_or(shade, |grip| mix(shade, mix(SLIPPERY, GRIPPY, grip), FRICTION_SHARE));
        colours.push(opaque(if (square[0] + square[1]).rem_euclid(2) == 0 { shade } else { mix(shade, [0; 3], 0.14) }));
    }
    let width = kept_columns.len() as u32;
    let mut triangles = Vec::new();
    for row in 0..kept_rows.len() as u32 - 1 {
        for first in (0..width - 1).map(|column| row * width + column) {
            let [right, above] = [first + 1, first + width];
            triangles.extend([[first, right, above + 1], [first, above + 1, above]]);
        }
    }
    Mesh3D::new(positions).with_triangle_indices(triangles).with_vertex_normals(normals).with_vertex_colors(colours)
}

fn range(values: &[f64]) -> [f64; 2] {
    values.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(*v), high.max(*v)])
}

fn mix(from: Rgb, to: Rgb, share: f32) -> Rgb {
    std::array::from_fn(|k| (f32::from(from[k]) + share * (f32::from(to[k]) - f32::from(from[k]))).round() as u8)
}
