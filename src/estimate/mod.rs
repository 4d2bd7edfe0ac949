/*! State estimation from the robot's own sensors (section IV-D): IMU, joint encoders, and estimated foot contacts.

[`Estimator`] turns readings into an [`Estimate`]. Read in this order: [`sensors`] models the readings and their errors,
[`orientation`] estimates the tilt, [`contact`] the feet in contact, [`kalman`] position and velocity. All of it is
pure: readings in, estimate out.

The world of an [`Estimate`] is aligned with gravity, has the ground at height zero, and its origin and heading are those
of the start. Horizontal position and heading drift, because nothing on the robot measures them.
*/

pub mod contact;
pub mod external_force;
pub mod kalman;
pub mod orientation;
pub mod sensors;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod walker;

use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};
use serde::Serialize;

use kalman::{FilterNoise, FootMeasurement, KalmanFilter};
use orientation::OrientationFilter;
pub use sensors::{EncoderReading, ImuReading, SensorNoise, Sensors};

use crate::robot::{FootState, GRAVITY_M_S2, Robot, RobotState, kinematics};

/// The reason why a reading was refused. The estimator keeps its last good state.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SensorFault {
    /// A reading is NaN or infinite.
    #[error("{reading} reads {found}, expected a finite number")]
    NotFinite {
        /// Name of the reading, such as `gyro x` or `rate of FR_thigh`.
        reading: String,
        /// The value that was read.
        found: f64,
    },
    /// The time since the last tick is not a valid time step.
    #[error("the time since the last tick is {0} s, expected a positive number")]
    Timestep(f64),
    /// A sensor, `IMU` or `encoders`, has not delivered a first reading.
    #[error("no reading of the {0} yet: an estimator needs a first reading of both IMU and encoders")]
    Missing(&'static str),
    /// A sensor has been silent for longer than can be bridged.
    #[error(
        "no reading of the {sensor} for {silent_s:.3} s, at most {limit_s:.3} s can be bridged; start a new estimator when it is back"
    )]
    Silent {
        /// Name of the sensor: `IMU` or `encoders`.
        sensor: &'static str,
        /// The length of the silence \[s\].
        silent_s: f64,
        /// The longest permitted silence \[s\].
        limit_s: f64,
    },
}

/// Settings of the [`Estimator`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct EstimatorConfig {
    /// Gain `κ_ref` of the orientation filter [1/s]. A gyro bias b causes a tilt error of b / κ until the bias is
    /// learnt, and a change of speed Δv one of κ Δv / g.
    pub orientation_gain_per_s: f64,
    /// Time constant of the average of the specific force: about half a period of a trot \[s\].
    pub orientation_averaging_s: f64,
    /// The longest silence of a sensor that the other sensor bridges \[s\].
    pub max_silence_s: f64,
    /// Noise that the Kalman filter assumes.
    pub noise: FilterNoise,
}

impl Default for EstimatorConfig {
    fn default() -> Self {
        // 0.15 °/s / 0.5 /s = 0.3°; 0.5 /s · 0.5 m/s / 9.81 m/s² = 1.5°, which fades in 2 s.
        let noise = FilterNoise::default();
        EstimatorConfig { orientation_gain_per_s: 0.5, orientation_averaging_s: 0.25, max_silence_s: 0.1, noise }
    }
}

/// The estimated state of the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Height of the trunk's origin above the ground under the feet \[m\].
    pub height_m: f64,
    /// Velocity of the trunk's origin, base frame [m/s].
    pub velocity_in_base: Vector3<f64>,
    /// Rotation from the base frame to the gravity-aligned world.
    pub world_from_base: UnitQuaternion<f64>,
    /// Gravity, base frame [m/s²].
    pub gravity_in_base: Vector3<f64>,
    /// Angular velocity of the trunk, base frame [rad/s]: the gyro's reading minus its estimated bias.
    pub angular_velocity_in_base: Vector3<f64>,
    /// Origin of the trunk, gravity-aligned world \[m\].
    pub position: Vector3<f64>,
    /// Centres of the feet, gravity-aligned world \[m\].
    pub feet: [Vector3<f64>; 4],
}

impl Estimate {
    /// Returns the state of the robot, with these readings of its encoders and contacts of its feet.
    pub fn state(&self, robot: &Robot, encoders: &EncoderReading, contacts: [bool; 4]) -> RobotState {
        let feet = kinematics::feet(&robot.legs, &encoders.angles, &encoders.rates);
        let spin = self.angular_velocity_in_base;
        let feet = std::array::from_fn(|leg| {
            let foot = &feet[leg];
            let in_base = self.velocity_in_base + spin.cross(&foot.position) + foot.velocity;
            FootState {
                height: self.feet[leg].z - robot.legs[leg].foot_radius_m,
                velocity: (self.world_from_base * in_base).into(),
                contact: contacts[leg],
            }
        });
        RobotState {
            position: self.position,
            world_from_base: self.world_from_base,
            height: self.height_m,
            velocity_in_base: self.velocity_in_base,
            angular_velocity_in_base: self.angular_velocity_in_base,
            gravity_in_base: self.gravity_in_base,
            joint_angles: encoders.angles,
            joint_rates: encoders.rates,
            feet,
            felt_force: None,
        }
    }
}

/// The state estimator of one robot.
///
/// A silent IMU is bridged by holding its last reading, with more noise and without correcting the tilt; silent
/// encoders are bridged by integrating the IMU.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimator {
    robot: Arc<Robot>,
    config: EstimatorConfig,
    filters: Option<Filters>,
}

#[derive(Debug, Clone, PartialEq)]
struct Filters {
    orientation: OrientationFilter,
    kalman: KalmanFilter,
    imu: ImuReading,
    imu_silent_s: f64,
    encoders_silent_s: f64,
    estimate: Estimate,
}

impl Estimator {
    /// Creates the estimator of a robot; it starts with the first readings.
    pub fn new(robot: Arc<Robot>, config: EstimatorConfig) -> Self {
        Estimator { robot, config, filters: None }
    }

    /// Returns the last good estimate; `None` before the first.
    pub fn estimate(&self) -> Option<&Estimate> {
        self.filters.as_ref().map(|filters| &filters.estimate)
    }

    /// Processes the readings of a tick, `dt_s` \[s\] after the last one; `None` for a silent sensor. The robot should
    /// be at rest in the first call, which takes the accelerometer's direction as up.
    ///
    /// # Errors
    /// A reading is not finite, the time step is invalid, or a sensor is missing or silent for too long. State and
    /// estimate stay as before the call. The next call may continue, except after [`SensorFault::Silent`]: then create
    /// a new estimator.
    pub fn update(
        &mut self,
        imu: Option<&ImuReading>,
        encoders: Option<&EncoderReading>,
        contacts: [bool; 4],
        dt_s: f64,
    ) -> Result<&Estimate, SensorFault> {
        check(imu, encoders, dt_s)?;
        let mut filters = match self.filters.take() {
            Some(filters) => filters,
            None => return self.start(imu, encoders, contacts),
        };
        let result = filters.update(&self.robot, &self.config, imu, encoders, contacts, dt_s);
        let filters = self.filters.insert(filters);
        result.map(|()| &filters.estimate)
    }

    fn start(
        &mut self,
        imu: Option<&ImuReading>,
        encoders: Option<&EncoderReading>,
        contacts: [bool; 4],
    ) -> Result<&Estimate, SensorFault> {
        let imu = imu.ok_or(SensorFault::Missing("IMU"))?;
        let encoders = encoders.ok_or(SensorFault::Missing("encoders"))?;
        let config = &self.config;
        let (gain, averaging) = (config.orientation_gain_per_s, config.orientation_averaging_s);
        let orientation = OrientationFilter::new(gain, averaging, &imu.specific_force);
        let world_from_base = orientation.world_from_base();
        let robot = &*self.robot;
        let feet = measure(robot, &imu.gyro, encoders, &world_from_base);
        let kalman = KalmanFilter::new(self.config.noise, &(world_from_base * robot.imu_in_base), &feet, contacts);
        let estimate = summarise(robot, &orientation, &kalman, &imu.gyro);
        let filters = Filters { orientation, kalman, imu: *imu, imu_silent_s: 0.0, encoders_silent_s: 0.0, estimate };
        Ok(&self.filters.insert(filters).estimate)
    }
}

impl Filters {
    fn update(
        &mut self,
        robot: &Robot,
        config: &EstimatorConfig,
        imu: Option<&ImuReading>,
        encoders: Option<&EncoderReading>,
        contacts: [bool; 4],
        dt_s: f64,
    ) -> Result<(), SensorFault> {
        let limit_s = config.max_silence_s;
        let [imu_silent_s, encoders_silent_s] = [&mut self.imu_silent_s, &mut self.encoders_silent_s];
        let sensors = [("IMU", imu.is_some(), imu_silent_s), ("encoders", encoders.is_some(), encoders_silent_s)];
        for (sensor, reads, silent_s) in sensors {
            // Counted up to the reading that ends it. A silence beyond the limit never ends, as the motion in it is unknown.
            *silent_s += dt_s;
            // Sums of ticks are off by rounding.
            ensure!(*silent_s <= limit_s + 1e-9, SensorFault::Silent { sensor, silent_s: *silent_s, limit_s });
            if reads {
                *silent_s = 0.0;
            }
        }
        let held = imu.is_none();
        self.imu = imu.copied().unwrap_or(self.imu);
        self.orientation.update(&self.imu, dt_s, !held);
        let world_from_base = self.orientation.world_from_base();
        let acceleration = world_from_base * self.imu.specific_force - Vector3::new(0.0, 0.0, GRAVITY_M_S2);
        let rate = self.orientation.angular_velocity(&self.imu.gyro);
        let feet = encoders.map(|encoders| measure(robot, &rate, encoders, &world_from_base));
        self.kalman.step(&[0.0; 4], &acceleration, held, feet.as_ref(), contacts, dt_s);
        self.estimate = summarise(robot, &self.orientation, &self.kalman, &rate);
        Ok(())
    }
}

/// Returns the feet relative to the IMU's site, world axes. `rate` is the trunk's angular velocity, base frame [rad/s].
fn measure(
    robot: &Robot,
    rate: &Vector3<f64>,
    encoders: &EncoderReading,
    world_from_base: &UnitQuaternion<f64>,
) -> [FootMeasurement; 4] {
    let feet = kinematics::feet(&robot.legs, &encoders.angles, &encoders.rates);
    std::array::from_fn(|leg| {
        let foot = &feet[leg];
        let offset = foot.position - robot.imu_in_base;
        let velocity = world_from_base * (foot.velocity + rate.cross(&offset));
        let spin = world_from_base * (foot.spin + rate);
        FootMeasurement { offset: world_from_base * offset, velocity, spin, radius_m: robot.legs[leg].foot_radius_m }
    })
}

/// Converts from the IMU's site to the trunk's origin. `rate` is the trunk's angular velocity, base frame [rad/s].
fn summarise(robot: &Robot, orientation: &OrientationFilter, kalman: &KalmanFilter, rate: &Vector3<f64>) -> Estimate {
    let world_from_base = orientation.world_from_base();
    let base_from_world = world_from_base.inverse();
    let position = kalman.position() - world_from_base * robot.imu_in_base;
    Estimate {
        height_m: position.z,
        velocity_in_base: base_from_world * kalman.velocity() - rate.cross(&robot.imu_in_base),
        world_from_base,
        gravity_in_base: base_from_world * Vector3::new(0.0, 0.0, -GRAVITY_M_S2),
        angular_velocity_in_base: *rate,
        position,
        feet: std::array::from_fn(|leg| kalman.foot(leg)),
    }
}

/// Checks that all inputs are finite, before any state changes.
fn check(imu: Option<&ImuReading>, encoders: Option<&EncoderReading>, dt_s: f64) -> Result<(), SensorFault> {
    ensure!(dt_s.is_finite() && dt_s > 0.0, SensorFault::Timestep(dt_s));
    imu.map_or(Ok(()), ImuReading::check)?;
    encoders.map_or(Ok(()), EncoderReading::check)
}
