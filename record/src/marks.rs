//! Positions of the arrows and ropes that stand for forces, in recordings and videos; world frame \[m\].

use super::style::{METRES_PER_NEWTON, METRES_PER_PUSH, ROPE_LENGTH_M};
use supple::scenario::trace::Frame;

/// Distance from the trunk's origin to its side \[m\].
const TRUNK_RADIUS_M: f64 = 0.13;
/// Distance from the trunk's origin to its front \[m\].
const TRUNK_FRONT_M: f64 = 0.3;
/// Height of the arrow of the felt force above the trunk \[m\].
const FELT_HEIGHT_M: f64 = 0.14;

/// The origin and the vector of an arrow.
pub(super) type Arrow = ([f64; 3], [f64; 3]);

/// Returns the arrow of a push, whose tip is at the trunk's side; the velocity is the change [m/s].
pub(super) fn push(trunk: [f64; 3], velocity: [f64; 3]) -> Arrow {
    towards(trunk, velocity, METRES_PER_PUSH, TRUNK_RADIUS_M)
}

/// Returns the arrow of an obstacle's force \[N\], whose tip is at the trunk's front.
pub(super) fn press(trunk: [f64; 3], force: [f64; 3]) -> Arrow {
    towards(trunk, force, METRES_PER_NEWTON, TRUNK_FRONT_M)
}

/// Returns the arrow of a pulling force \[N\] at the far end of a rope that begins at the trunk; `scale` is its length [m/N].
pub(super) fn pull(trunk: [f64; 3], force: [f64; 3], scale: f64) -> Arrow {
    let size = size(force);
    let end = std::array::from_fn(|k| trunk[k] + force[k] / size * ROPE_LENGTH_M);
    (end, force.map(|part| part * scale))
}

/// Returns the arrow of the felt force on the trunk, above it, and those of the felt forces on the feet; `scale` is their length
/// [m/N].
pub(super) fn felt(frame: &Frame, [x, y, z]: [f64; 3], scale: f64) -> Option<(Arrow, [Arrow; 4])> {
    let felt = frame.felt.as_ref()?;
    let (sin, cos) = frame.roll_pitch_yaw[2].sin_cos();
    let in_world = |[forward, left, up]: [f64; 3]| {
        [forward * cos - left * sin, forward * sin + left * cos, up].map(|force| force * scale)
    };
    let feet = std::array::from_fn(|leg| (frame.foot_positions[leg], in_world(felt.feet[leg])));
    Some((([x, y, z + FELT_HEIGHT_M], in_world(felt.force)), feet))
}

/// Returns the size of a vector, above zero.
pub(super) fn size(vector: [f64; 3]) -> f64 {
    vector.iter().map(|part| part * part).sum::<f64>().sqrt().max(1e-9)
}

/// Returns the arrow that ends at a distance from the trunk \[m\].
fn towards(trunk: [f64; 3], vector: [f64; 3], scale: f64, distance: f64) -> Arrow {
    let reach = scale + distance / size(vector);
    (std::array::from_fn(|k| trunk[k] - vector[k] * reach), vector.map(|part| part * scale))
}
