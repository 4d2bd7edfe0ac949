/*! Where a foot is and how it moves, from joint angles and rates: the Go1's leg in closed form.

A leg is a hip that turns about x, then thigh and calf that turn about y, each 0.213 m long; at zero angles it hangs
straight down. The lengths are those of `models/go1.xml`; `golden.c` prints what MuJoCo makes of them, and a test
compares.
*/

use nalgebra::{Matrix3, Vector3};

use crate::go1::Joints;

/// Hip joint from the trunk's origin: forward, and to the side \[m\].
const HIP: [f64; 2] = [0.1881, 0.04675];
/// Thigh joint from the hip joint, to the side \[m\].
const THIGH: f64 = 0.08;
/// Length of thigh and of calf \[m\].
const LINK: f64 = 0.213;

/// Radius of a foot's sphere \[m\].
pub const FOOT_RADIUS_M: f64 = 0.02;

/// The IMU from the trunk's origin, base frame \[m\]: site `imu` of `models/go1.xml`.
pub const IMU_IN_BASE: Vector3<f64> = Vector3::new(-0.01592, -0.06659, -0.00617);

/// A foot as the trunk sees it: what changes if the trunk is held still.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Foot {
    /// Centre of the foot's sphere, base frame \[m\].
    pub position: Vector3<f64>,
    /// Rate of change of `position`, base frame [m/s].
    pub velocity: Vector3<f64>,
    /// Angular velocity of the calf, and with it of the sphere, relative to the trunk, base frame [rad/s].
    pub spin: Vector3<f64>,
}

/// The four feet, in the order of [`crate::go1::LEGS`].
pub fn feet(angles: &Joints, rates: &Joints) -> [Foot; 4] {
    std::array::from_fn(|leg| {
        let of_leg = |joints: &Joints| Vector3::from_column_slice(&joints[3 * leg..3 * leg + 3]);
        let (angles, rates) = (of_leg(angles), of_leg(rates));
        let (sin, cos) = angles.x.sin_cos();
        Foot {
            position: foot_position(leg, &angles),
            velocity: foot_jacobian(leg, &angles) * rates,
            spin: Vector3::new(rates.x, cos * (rates.y + rates.z), sin * (rates.y + rates.z)),
        }
    })
}

/// Centre of a foot, base frame \[m\], from the leg's hip, thigh and calf angle \[rad\].
pub fn foot_position(leg: usize, angles: &Vector3<f64>) -> Vector3<f64> {
    let (forward, left) = signs(leg);
    let (thigh, calf) = (link(angles.y), link(angles.y + angles.z));
    let in_hip = Vector3::new(thigh.x + calf.x, left * THIGH, thigh.z + calf.z);
    Vector3::new(forward * HIP[0], left * HIP[1], 0.0) + about_x(angles.x, &in_hip)
}

/// Derivative of [`foot_position`] by the three angles, a column each [m/rad].
pub fn foot_jacobian(leg: usize, angles: &Vector3<f64>) -> Matrix3<f64> {
    let (_, left) = signs(leg);
    let (thigh, calf) = (link(angles.y), link(angles.y + angles.z));
    let in_hip = Vector3::new(thigh.x + calf.x, left * THIGH, thigh.z + calf.z);
    // Turning about an axis moves a point by axis × arm; the arms are those from hip, thigh and knee to the foot.
    let columns = [Vector3::x().cross(&in_hip), Vector3::y().cross(&(thigh + calf)), Vector3::y().cross(&calf)];
    Matrix3::from_columns(&columns.map(|column| about_x(angles.x, &column)))
}

/// Whether a leg is in front (+1) or behind (−1), and left (+1) or right (−1).
fn signs(leg: usize) -> (f64, f64) {
    (if leg < 2 { 1.0 } else { -1.0 }, if leg % 2 == 1 { 1.0 } else { -1.0 })
}

/// A link that hangs down, turned about y.
fn link(angle: f64) -> Vector3<f64> {
    Vector3::new(-LINK * angle.sin(), 0.0, -LINK * angle.cos())
}

fn about_x(angle: f64, vector: &Vector3<f64>) -> Vector3<f64> {
    let (sin, cos) = angle.sin_cos();
    Vector3::new(vector.x, cos * vector.y - sin * vector.z, sin * vector.y + cos * vector.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ANGLES: Joints = [0.2, 0.7, -1.5, -0.3, 0.9, -1.8, -0.1, 0.5, -1.2, 0.4, 1.1, -2.1];
    const RATES: Joints = [1.5, -2.0, 3.0, -0.5, 4.0, -1.0, 2.0, 0.5, 0.7, -1.0, -3.0, 2.5];

    /// Position, velocity, spin of each foot as `golden.c` prints them.
    const GOLDEN: [[[f64; 3]; 3]; 4] = [
        [
            [0.203678479980, -0.063307593748, -0.320997989489],
            [0.177424242692, 0.566375194087, -0.443553745394],
            [1.500000000000, 0.980066577841, 0.198669330795],
        ],
        [
            [0.188100000000, 0.044921440652, -0.276620304212],
            [-0.926820462692, -0.089003009970, 0.160310865746],
            [-0.500000000000, 2.866009467377, -0.886560619984],
        ],
        [
            [-0.152999272341, -0.161275703447, -0.340102073051],
            [-0.288956205911, 0.668862748407, -0.342087084975],
            [2.000000000000, 1.194004998334, -0.119800099976],
        ],
        [
            [-0.198693847929, 0.202874884730, -0.163835481245],
            [0.347390117166, 0.023032690525, -0.598109674192],
            [-1.000000000000, -0.460530497001, -0.194709171154],
        ],
    ];

    #[test]
    fn feet_are_where_mujoco_has_them() {
        for (foot, golden) in feet(&ANGLES, &RATES).iter().zip(GOLDEN) {
            for (ours, theirs) in [foot.position, foot.velocity, foot.spin].iter().zip(golden) {
                assert!((ours - Vector3::from(theirs)).norm() < 1e-11, "{ours} {theirs:?}");
            }
        }
    }

    #[test]
    fn the_jacobian_is_the_derivative_of_the_position() {
        for leg in 0..4 {
            let angles = Vector3::from_column_slice(&ANGLES[3 * leg..3 * leg + 3]);
            let jacobian = foot_jacobian(leg, &angles);
            for joint in 0..3 {
                let mut step = Vector3::zeros();
                step[joint] = 1e-6;
                let difference = (foot_position(leg, &(angles + step)) - foot_position(leg, &(angles - step))) / 2e-6;
                assert!((difference - jacobian.column(joint)).norm() < 1e-9, "leg {leg}, joint {joint}");
            }
        }
    }

    #[test]
    fn a_straight_leg_hangs_down_from_its_thigh_joint() {
        // Left, front: 0.04675 + 0.08 = 0.12675 to the side, 2 · 0.213 = 0.426 below.
        let foot = foot_position(1, &Vector3::zeros());
        assert!((foot - Vector3::new(0.1881, 0.12675, -0.426)).norm() < 1e-12);
    }
}
