/*! The orientation filter: the complementary filter of Bledt et al. (2018, "MIT Cheetah 3"), which estimates the tilt.

The gyro is integrated on SO(3) and corrected towards the accelerometer, which points up as long as the trunk does not
accelerate:

`R ← R exp((ω + κ ω_corr) dt)`, `ω_corr = a/|a| × Rᵀ e_z`, `κ = κ_ref max(0, min(1, 1 − ||a| − g| / g))`.

Two things differ.

- `a` is the specific force averaged over about half a period of the gait. Gain and direction are not linear in `a`, so
  that a trot's hard landings and short flights do not cancel: up was wrong by two degrees in the simulator, and is by less
  than one with the average.
- The gyro's bias is learnt from what is left to correct, `b ← b − κ_ref/4 κ ω_corr dt`, `ω = ω_read − b`, as in Mahony,
  Hamel and Pflimlin (2008, "Nonlinear Complementary Filters on the Special Orthogonal Group"). The factor makes it
  critically damped, but for the average. Without it a bias leaves a tilt of `b / κ` for good, and the robot drifts aside.

The world frame is aligned with gravity, as an IMU measures it. Yaw starts at zero and drifts with the gyro: nothing on the robot measures
it.
*/

use nalgebra::{UnitQuaternion, Vector3};

use super::sensors::ImuReading;
use crate::robot::GRAVITY_M_S2;

/// Limit of the estimated gyro bias per axis [rad/s]: 1 °/s, that of a BMI088 before any zeroing.
const MOST_BIAS_RAD_S: f64 = std::f64::consts::PI / 180.0;

/// Rotation from the base frame to the gravity-aligned world frame, tracked from the IMU.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrientationFilter {
    /// Gain `κ_ref` [1/s].
    gain: f64,
    /// Time constant of the averaged specific force \[s\].
    averaging_s: f64,
    world_from_base: UnitQuaternion<f64>,
    /// Averaged specific force, world frame [m/s²].
    average: Vector3<f64>,
    /// Estimated bias of the gyro, base frame [rad/s].
    bias: Vector3<f64>,
}

impl OrientationFilter {
    /// Starts as if the trunk were at rest: up is the direction of the specific force, and the base's x axis points
    /// along the world's.
    pub fn new(gain_per_s: f64, averaging_s: f64, specific_force: &Vector3<f64>) -> Self {
        // Turned by half a turn about x if the robot lies exactly on its back, where the shortest rotation is not unique.
        let level = UnitQuaternion::rotation_between(specific_force, &Vector3::z())
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        let (_, _, yaw) = level.euler_angles();
        let world_from_base = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -yaw) * level;
        let (average, bias) = (world_from_base * specific_force, Vector3::zeros());
        OrientationFilter { gain: gain_per_s, averaging_s, world_from_base, average, bias }
    }

    /// Returns the angular velocity, base frame [rad/s]: the gyro's reading minus its estimated bias.
    pub fn angular_velocity(&self, gyro: &Vector3<f64>) -> Vector3<f64> {
        gyro - self.bias
    }

    /// Returns the present rotation from the base frame to the gravity-aligned world.
    pub fn world_from_base(&self) -> UnitQuaternion<f64> {
        self.world_from_base
    }

    /// Advances by `dt_s` \[s\] with a reading taken at the end of that time. With `correct` false, the accelerometer
    /// is ignored, because the reading is an old one.
    pub fn update(&mut self, reading: &ImuReading, dt_s: f64, correct: bool) {
        let correction = if correct {
            let specific_force = self.world_from_base * reading.specific_force;
            self.average += (1.0 - (-dt_s / self.averaging_s).exp()) * (specific_force - self.average);
            self.correction()
        } else {
            Vector3::zeros()
        };
        let bias = self.bias - 0.25 * self.gain * dt_s * correction;
        self.bias = bias.map(|bias| bias.clamp(-MOST_BIAS_RAD_S, MOST_BIAS_RAD_S));
        let turn = UnitQuaternion::from_scaled_axis((self.angular_velocity(&reading.gyro) + correction) * dt_s);
        self.world_from_base *= turn;
        // A product of unit quaternions leaves the sphere by rounding.
        self.world_from_base.renormalize_fast();
    }

    /// Returns `κ ω_corr`, the correction towards the accelerometer, base frame [rad/s].
    fn correction(&self) -> Vector3<f64> {
        let size = self.average.norm();
        let trust = (1.0 - (size - GRAVITY_M_S2).abs() / GRAVITY_M_S2).clamp(0.0, 1.0);
        if trust == 0.0 {
            return Vector3::zeros();
        }
        self.world_from_base.inverse() * (self.gain * trust * (self.average / size).cross(&Vector3::z()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f64 = 1.0 / 240.0;

    fn at_rest(world_from_base: UnitQuaternion<f64>) -> ImuReading {
        let specific_force = world_from_base.inverse() * Vector3::new(0.0, 0.0, GRAVITY_M_S2);
        ImuReading { gyro: Vector3::zeros(), specific_force }
    }

    #[test]
    fn an_error_of_five_degrees_decays_with_the_gain() {
        let level = at_rest(UnitQuaternion::identity());
        let tilted = at_rest(UnitQuaternion::from_euler_angles(5.0_f64.to_radians(), 0.0, 0.0));
        let mut filter = OrientationFilter::new(0.5, 0.25, &tilted.specific_force);
        assert!((filter.world_from_base().angle().to_degrees() - 5.0).abs() < 1e-9);
        // e' = −κ a − b, b' = κ² / 4 a, a' = (e − a) / τ, e(0) = 5°, a(0) = b(0) = 0: with κ = 0.5 and τ = 0.25,
        // s³ + 4 s² + 2 s + 1/4 = 0, and e(t) is 1.5525° after 2 s and −0.6297° after 10 s (Runge-Kutta).
        for (seconds, expected) in [(2, 1.5525), (8, -0.6297)] {
            (0..seconds * 240).for_each(|_| filter.update(&level, DT_S, true));
            let error = filter.world_from_base().euler_angles().0.to_degrees();
            assert!((error - expected).abs() < 0.02, "{error}");
        }
    }

    #[test]
    fn a_constant_error_of_the_gyro_is_learnt_and_leaves_no_tilt() {
        let bias = Vector3::new(0.15_f64.to_radians(), -0.1_f64.to_radians(), 0.0);
        let rest = at_rest(UnitQuaternion::identity());
        let mut filter = OrientationFilter::new(0.5, 0.25, &rest.specific_force);
        let reading = ImuReading { gyro: bias, ..rest };
        (0..240 * 40).for_each(|_| filter.update(&reading, DT_S, true));
        // Without learning it would stay at 0.18°/s / 0.5 /s = 0.36°.
        assert!(filter.world_from_base().angle().to_degrees() < 0.01, "{}", filter.world_from_base().angle());
        assert!(filter.angular_velocity(&bias).norm() < 0.01 * bias.norm());
        // The estimate is limited to the largest bias of an IMU.
        let reading = ImuReading { gyro: Vector3::new(0.1, 0.0, 0.0), ..rest };
        (0..240 * 40).for_each(|_| filter.update(&reading, DT_S, true));
        assert_eq!(filter.bias.x, MOST_BIAS_RAD_S);
    }

    #[test]
    fn a_bouncing_trunk_does_not_tilt() {
        // Hit hard and backwards for a tenth of the time, in free fall for the rest: 9.81 m/s² upwards on average.
        let mut filter = OrientationFilter::new(0.5, 0.25, &Vector3::z());
        for tick in 0..240 * 20 {
            let up = if tick % 40 < 4 { 10.0 * GRAVITY_M_S2 } else { 0.0 };
            let forward = if tick % 40 < 4 { -9.0 } else { 1.0 };
            let specific_force = Vector3::new(forward, 0.0, up);
            filter.update(&ImuReading { gyro: Vector3::zeros(), specific_force }, DT_S, true);
        }
        assert!(filter.world_from_base().angle() < 1.0_f64.to_radians());
    }

    #[test]
    fn it_starts_level_with_no_yaw() {
        let truth = UnitQuaternion::from_euler_angles(0.3, -0.4, 0.0);
        let filter = OrientationFilter::new(0.5, 0.25, &at_rest(truth).specific_force);
        assert!(filter.world_from_base().angle_to(&truth) < 1e-9);
    }

    #[test]
    fn a_turn_is_integrated_exactly() {
        let mut filter = OrientationFilter::new(0.0, 0.25, &Vector3::z());
        let rate = Vector3::new(0.3, -0.5, 0.9);
        let reading = ImuReading { gyro: rate, specific_force: Vector3::z() * GRAVITY_M_S2 };
        (0..240).for_each(|_| filter.update(&reading, DT_S, true));
        assert!(filter.world_from_base().angle_to(&UnitQuaternion::from_scaled_axis(rate)) < 1e-12);
    }

    #[test]
    fn long_free_fall_does_not_correct() {
        let mut filter = OrientationFilter::new(5.0, 0.25, &Vector3::z());
        filter.average = Vector3::zeros();
        let falling = ImuReading { gyro: Vector3::zeros(), specific_force: Vector3::zeros() };
        filter.update(&falling, DT_S, true);
        assert_eq!(filter.world_from_base(), UnitQuaternion::identity());
    }
}
