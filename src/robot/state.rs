/*! The state of a robot at one instant.

Vectors are in MuJoCo's axes: x forward, y left, z up.
*/

use nalgebra::{UnitQuaternion, Vector3};

use super::Joints;

/// Gravitational acceleration, as in the paper's simulator and in MuJoCo [m/s²].
pub const GRAVITY_M_S2: f64 = 9.81;

/// Height and contact of a foot.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Foothold {
    /// Bottom of the foot's sphere above the ground under it \[m\].
    pub height: f64,
    /// True if the foot touches anything.
    pub contact: bool,
}

/// Height, velocity and contact of a foot at the end of a policy step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FootState {
    /// Bottom of the foot's sphere above the ground under it \[m\].
    pub height: f64,
    /// Velocity of the foot's centre, world frame [m/s].
    pub velocity: [f64; 3],
    /// True if the foot touches anything.
    pub contact: bool,
}

/// Speed below which a foot that touches something stands \[m/s\]. A foot that swings through balls touches them, too, but at about 1 m/s,
/// so the trunk's velocity does not follow from it.
const STANDS_M_S: f64 = 0.3;

impl FootState {
    /// Returns true if the foot stands: it touches something, and hardly moves.
    pub fn stands(&self) -> bool {
        self.contact && Vector3::from(self.velocity).norm() < STANDS_M_S
    }
}

/// The state of the robot at one instant.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RobotState {
    /// Origin of the trunk, world frame \[m\].
    pub position: Vector3<f64>,
    /// Rotation from the base frame to the world frame.
    pub world_from_base: UnitQuaternion<f64>,
    /// Height of the base above the ground under it \[m\].
    pub height: f64,
    /// Velocity of the trunk's origin, base frame [m/s].
    pub velocity_in_base: Vector3<f64>,
    /// Angular velocity of the trunk, base frame [rad/s].
    pub angular_velocity_in_base: Vector3<f64>,
    /// Gravity, base frame [m/s²].
    pub gravity_in_base: Vector3<f64>,
    /// Joint angles \[rad\].
    pub joint_angles: Joints,
    /// Joint rates [rad/s].
    pub joint_rates: Joints,
    /// Feet in the order of [`LEGS`](crate::robot::LEGS).
    pub feet: [FootState; 4],
    /// Felt force on the trunk, forward and left in the heading frame, mean over the last policy step \[N\]; `None` where it is not
    /// observed, or cannot be trusted.
    pub felt_force: Option<[f64; 2]>,
}

impl RobotState {
    methods! {
        /// Returns roll, pitch and yaw of the trunk relative to the world \[rad\].
        fn roll_pitch_yaw(&self) -> (f64, f64, f64) = self.world_from_base.euler_angles();
        /// Returns the velocity of the base, world frame [m/s].
        fn velocity_in_world(&self) -> Vector3<f64> = self.world_from_base * self.velocity_in_base;
        /// Returns the velocity of the base, heading frame [m/s].
        fn velocity_in_heading(&self) -> Vector3<f64> = self.heading().inverse() * self.velocity_in_world();
    }

    /// Returns the rotation from the heading frame to the world frame: the trunk's yaw alone.
    pub fn heading(&self) -> UnitQuaternion<f64> {
        let (_, _, yaw) = self.roll_pitch_yaw();
        UnitQuaternion::from_euler_angles(0.0, 0.0, yaw)
    }
}
