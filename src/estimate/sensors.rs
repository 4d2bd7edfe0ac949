/*! Sensor models: an IMU in the trunk and an encoder at every joint, with noise, bias and quantisation.

Unitree names no parts. The defaults of [`SensorNoise`] are those of an IMU that is common in such robots (Bosch BMI088, data sheet
BST-BMI088-DS001) and of the GO-M8010-6 motor's protocol, as each key says. A constant error of the joint angles, which calibration leaves,
is part of the simulation (`Conditions::encoder_bias`), since it affects the controller, too.
*/

use std::f64::consts::TAU;

use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng, RngExt};
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

use super::SensorFault;
use crate::robot::{Joints, joint_name, same_in_every_leg};

/// A reading of the IMU.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuReading {
    /// Angular velocity of the trunk, base frame [rad/s].
    pub gyro: Vector3<f64>,
    /// Acceleration without gravity (+9.81 m/s² upwards at rest) of the IMU's site, base frame [m/s²].
    pub specific_force: Vector3<f64>,
}

/// A reading of all joint encoders.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EncoderReading {
    /// Joint angles \[rad\].
    pub angles: Joints,
    /// Joint rates after the encoders' own low-pass filter [rad/s].
    pub rates: Joints,
}

impl EncoderReading {
    /// Returns the reading of perfect encoders that are mounted with `offsets` \[rad\].
    pub fn exact(angles: &Joints, rates: Joints, offsets: &Joints) -> Self {
        EncoderReading { angles: std::array::from_fn(|joint| angles[joint] + offsets[joint]), rates }
    }

    /// Checks that the readings are finite.
    ///
    /// # Errors
    /// A value is NaN or infinite; the error names the first one.
    pub fn check(&self) -> Result<(), SensorFault> {
        let of = |name, joints: &Joints| finite(joints, |joint| format!("{name} of {}", joint_name(joint)));
        of("angle", &self.angles)?;
        of("rate", &self.rates)
    }
}

pub(super) fn finite(values: &[f64], name: impl Fn(usize) -> String) -> Result<(), SensorFault> {
    let bad = values.iter().enumerate().find(|(_, value)| !value.is_finite());
    bad.map_or(Ok(()), |(index, found)| Err(SensorFault::NotFinite { reading: name(index), found: *found }))
}

/// The motion of the trunk, from which [`ImuReading::exact`] computes a reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrunkMotion {
    /// Rotation from the base frame to the world frame.
    pub world_from_base: UnitQuaternion<f64>,
    /// Acceleration of the trunk's origin, world frame [m/s²]: the first three of a free joint's `qacc`.
    pub acceleration: Vector3<f64>,
    /// Angular velocity, base frame [rad/s]: the last three of `qvel`.
    pub angular_velocity: Vector3<f64>,
    /// Angular acceleration, base frame [rad/s²]: the last three of `qacc`.
    pub angular_acceleration: Vector3<f64>,
}

impl ImuReading {
    /// Returns the reading of a perfect IMU at `arm` from the trunk's origin, base frame \[m\], under `gravity`, world
    /// frame [m/s²].
    pub fn exact(motion: &TrunkMotion, arm: Vector3<f64>, gravity: Vector3<f64>) -> Self {
        let rate = motion.angular_velocity;
        let of_origin = motion.world_from_base.inverse() * (motion.acceleration - gravity);
        let of_arm = motion.angular_acceleration.cross(&arm) + rate.cross(&rate.cross(&arm));
        ImuReading { gyro: rate, specific_force: of_origin + of_arm }
    }

    /// Checks that the readings are finite.
    ///
    /// # Errors
    /// A value is NaN or infinite; the error names the first one.
    pub fn check(&self) -> Result<(), SensorFault> {
        let of =
            |name, vector: &Vector3<f64>| finite(vector.as_slice(), |axis| format!("{name} {}", ["x", "y", "z"][axis]));
        of("gyro", &self.gyro)?;
        of("accelerometer", &self.specific_force)
    }
}

/// Errors of the sensors: standard deviations where they are random.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorNoise {
    /// Spectral density of the gyro's white noise [rad/s/√Hz]. BMI088: 0.014 °/s/√Hz.
    pub gyro_density_rad_s_sqrt_hz: f64,
    /// Constant error of the gyro [rad/s], drawn at switch-on: the rest of the BMI088's ±1 °/s after the zeroing at
    /// rest that such robots do at start, that is its drift of 0.015 °/s/K over 10 K.
    pub gyro_bias_rad_s: f64,
    /// Spectral density of the accelerometer's white noise [m/s²/√Hz]. BMI088: 175 µg/√Hz, mean of its axes.
    pub accelerometer_density_m_s2_sqrt_hz: f64,
    /// Constant error of the accelerometer [m/s²], drawn at switch-on: a quarter of the BMI088's ±20 mg; the rest is
    /// calibrated.
    pub accelerometer_bias_m_s2: f64,
    /// White noise of joint angles \[rad\]: the typical ±0.5° of a magnetic encoder at the rotor, behind a gear of
    /// 6.33.
    pub angle_rad: f64,
    /// Resolution of the angle at the rotor, steps per turn. Unitree's protocol has 2¹⁵ (`ris_protocol.h`, "q15").
    pub angle_steps_per_turn: f64,
    /// White noise of joint rates [rad/s]: the root mean square over the joints of a standing Go2, whose motors are of
    /// the same make (`motor_state_data_example_standup.py` in hanlinniu/unitree_sdk2_python).
    pub rate_rad_s: f64,
    /// Resolution of the rate at the rotor, steps per turn per second. The protocol has 2⁸ ("q8"); the Go2's rates
    /// confirm it.
    pub rate_steps_per_turn_s: f64,
    /// Cut-off of the first-order low-pass of the rate inside the motor \[Hz\]. Assumed: a twentieth of the servo's
    /// usual 2 kHz.
    pub rate_cutoff_hz: f64,
    /// Gear ratio of hip, thigh and calf. Unitree: 6.33, at the calf 1.5 times as much.
    pub gear: [f64; 3],
}

impl Default for SensorNoise {
    fn default() -> Self {
        SensorNoise {
            gyro_density_rad_s_sqrt_hz: 0.014_f64.to_radians(),
            gyro_bias_rad_s: 0.15_f64.to_radians(),
            accelerometer_density_m_s2_sqrt_hz: 175e-6 * 9.81,
            accelerometer_bias_m_s2: 0.005 * 9.81,
            angle_rad: 0.0014,
            angle_steps_per_turn: 32768.0,
            rate_rad_s: 0.03,
            rate_steps_per_turn_s: 256.0,
            rate_cutoff_hz: 100.0,
            gear: [6.33, 6.33, 9.495],
        }
    }
}

/// The sensors of one robot from switch-on to switch-off.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensors {
    noise: SensorNoise,
    gyro_bias: Vector3<f64>,
    accelerometer_bias: Vector3<f64>,
    /// State of the low-pass of the rates [rad/s]; `None` before the first reading.
    filtered_rates: Option<Joints>,
}

impl Sensors {
    /// Switches the sensors on and draws their constant errors. `rng` is a stream of
    /// [`crate::util::random::Purpose::Sensor`].
    pub fn new(noise: SensorNoise, rng: &mut impl Rng) -> Self {
        let gyro_bias = noise.gyro_bias_rad_s * normal(rng);
        let accelerometer_bias = noise.accelerometer_bias_m_s2 * normal(rng);
        Sensors { gyro_bias, accelerometer_bias, filtered_rates: None, noise }
    }

    /// Adds noise and bias to an exact IMU reading, `dt_s` \[s\] after the last one.
    pub fn imu(&self, exact: &ImuReading, dt_s: f64, rng: &mut impl Rng) -> ImuReading {
        // White noise of density n, seen through the band up to half the sampling rate, has variance n² / (2 dt).
        let bandwidth = (0.5 / dt_s).sqrt();
        ImuReading {
            gyro: exact.gyro + self.gyro_bias + self.noise.gyro_density_rad_s_sqrt_hz * bandwidth * normal(rng),
            specific_force: exact.specific_force
                + self.accelerometer_bias
                + self.noise.accelerometer_density_m_s2_sqrt_hz * bandwidth * normal(rng),
        }
    }

    /// Adds noise and quantisation to exact angles \[rad\] and rates [rad/s], `dt_s` \[s\] after the last reading.
    pub fn encoders(&mut self, exact: &EncoderReading, dt_s: f64, rng: &mut impl Rng) -> EncoderReading {
        let noise = &self.noise;
        let before = self.filtered_rates.unwrap_or(exact.rates);
        let keep = (-TAU * noise.rate_cutoff_hz * dt_s).exp();
        let rates: Joints = std::array::from_fn(|k| keep * before[k] + (1.0 - keep) * exact.rates[k]);
        let turn: Joints = same_in_every_leg(noise.gear).map(|gear| TAU / gear);
        let mut read = |exact: &Joints, sd: f64, steps: f64| -> Joints {
            std::array::from_fn(|k| quantised(exact[k] + sd * rng.sample::<f64, _>(StandardNormal), turn[k] / steps))
        };
        let reading = EncoderReading {
            angles: read(&exact.angles, noise.angle_rad, noise.angle_steps_per_turn),
            rates: read(&rates, noise.rate_rad_s, noise.rate_steps_per_turn_s),
        };
        self.filtered_rates = Some(rates);
        reading
    }
}

fn quantised(value: f64, step: f64) -> f64 {
    (value / step).round() * step
}

fn normal(rng: &mut impl Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| rng.sample(StandardNormal))
}

#[cfg(test)]
mod tests {
    use nalgebra::Quaternion;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::robot::{JOINTS, Robot};

    const DT_S: f64 = 1.0 / 240.0;

    fn still() -> EncoderReading {
        EncoderReading { angles: [0.7; JOINTS], rates: [0.0; JOINTS] }
    }

    #[test]
    fn the_accelerometer_reads_what_mujoco_says_at_its_site() {
        // Printed by `src/robot/golden.c`.
        let motion = TrunkMotion {
            world_from_base: UnitQuaternion::from_quaternion(Quaternion::new(0.9, 0.1, -0.3, 0.3)),
            acceleration: Vector3::new(0.428030140645, 0.437243813540, -11.537073611499),
            angular_velocity: Vector3::new(1.0, -2.0, 0.7),
            angular_acceleration: Vector3::new(-5.610478055496, 2.435249246057, 5.875792106002),
        };
        let reading =
            ImuReading::exact(&motion, Robot::load("go1").unwrap().imu_in_base, Vector3::new(0.0, 0.0, -9.81));
        let golden = Vector3::new(0.024157462103, 0.104514806515, -1.219218227870);
        assert!((reading.specific_force - golden).norm() < 1e-9, "{}", reading.specific_force);
    }

    #[test]
    fn noise_has_the_variance_that_its_density_promises() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let noise = SensorNoise { gyro_bias_rad_s: 0.0, ..SensorNoise::default() };
        let sensors = Sensors::new(noise, &mut rng);
        let exact = ImuReading { gyro: Vector3::zeros(), specific_force: Vector3::zeros() };
        let count = 10_000;
        let squares: f64 = (0..count).map(|_| sensors.imu(&exact, DT_S, &mut rng).gyro.norm_squared()).sum();
        // 0.014 °/s/√Hz · √120 Hz = 0.1534 °/s.
        let sd = (squares / f64::from(3 * count)).sqrt().to_degrees();
        assert!((sd - 0.1534).abs() < 0.003, "{sd}");
    }

    #[test]
    fn biases_are_drawn_once_and_stay_and_have_the_sizes_they_are_given() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let still = SensorNoise { gyro_density_rad_s_sqrt_hz: 0.0, ..SensorNoise::default() };
        let noise = SensorNoise { accelerometer_density_m_s2_sqrt_hz: 0.0, ..still };
        let exact = ImuReading { gyro: Vector3::zeros(), specific_force: Vector3::zeros() };
        let (mut gyro, mut accelerometer, count) = (0.0, 0.0, 4000);
        for _ in 0..count {
            let sensors = Sensors::new(noise, &mut rng);
            let first = sensors.imu(&exact, DT_S, &mut rng);
            assert_eq!(first, sensors.imu(&exact, DT_S, &mut rng));
            gyro += first.gyro.norm_squared();
            accelerometer += first.specific_force.norm_squared();
        }
        // 0.15 °/s = 0.002618 rad/s; 5 mg = 0.04905 m/s².
        let sd = |squares: f64| (squares / f64::from(3 * count)).sqrt();
        assert!((sd(gyro) / 0.002_618 - 1.0).abs() < 0.03, "{}", sd(gyro));
        assert!((sd(accelerometer) / 0.049_05 - 1.0).abs() < 0.03, "{}", sd(accelerometer));
    }

    #[test]
    fn encoders_read_whole_steps_and_the_nearest_ones() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let noise = SensorNoise { angle_rad: 0.0, rate_rad_s: 0.0, ..SensorNoise::default() };
        let moving = EncoderReading { rates: [0.33; JOINTS], ..still() };
        let reading = Sensors::new(noise, &mut rng).encoders(&moving, DT_S, &mut rng);
        for joint in 0..JOINTS {
            // One turn of the rotor is 2π / 6.33 of hip and thigh and 2π / 9.495 of the calf.
            let turn = TAU / same_in_every_leg([6.33, 6.33, 9.495])[joint];
            for (read, exact, steps) in [(reading.angles[joint], 0.7, 32768.0), (reading.rates[joint], 0.33, 256.0)] {
                let counted = read * steps / turn;
                assert!((counted - counted.round()).abs() < 1e-6, "{counted} steps");
                assert!((read - exact).abs() <= 0.5 * turn / steps + 1e-12, "{read}");
            }
        }
        // 0.7 rad is 23108.503 steps of a hip and 0.33 rad/s 85.11: the nearest are 23109 and 85.
        assert!((reading.angles[0] - 23109.0 * TAU / 6.33 / 32768.0).abs() < 1e-12, "{}", reading.angles[0]);
        assert!((reading.rates[0] - 85.0 * TAU / 6.33 / 256.0).abs() < 1e-12, "{}", reading.rates[0]);
    }

    #[test]
    fn encoder_noise_has_the_sizes_it_is_given() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let noise = SensorNoise { angle_steps_per_turn: 1e9, rate_steps_per_turn_s: 1e9, ..SensorNoise::default() };
        let mut sensors = Sensors::new(noise, &mut rng);
        let (mut angle, mut rate, count) = (0.0, 0.0, 2000);
        for _ in 0..count {
            let reading = sensors.encoders(&still(), DT_S, &mut rng);
            angle += reading.angles.iter().map(|angle| (angle - 0.7).powi(2)).sum::<f64>();
            rate += reading.rates.iter().map(|rate| rate.powi(2)).sum::<f64>();
        }
        let sd = |squares: f64| (squares / f64::from(12 * count)).sqrt();
        assert!((sd(angle) / 0.0014 - 1.0).abs() < 0.03, "{}", sd(angle));
        assert!((sd(rate) / 0.03 - 1.0).abs() < 0.03, "{}", sd(rate));
    }

    #[test]
    fn the_rate_follows_a_jump_through_its_low_pass() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let noise = SensorNoise { rate_rad_s: 0.0, rate_steps_per_turn_s: 1e9, ..SensorNoise::default() };
        let mut sensors = Sensors::new(noise, &mut rng);
        sensors.encoders(&still(), DT_S, &mut rng);
        let moving = EncoderReading { rates: [1.0; JOINTS], ..still() };
        let reading = sensors.encoders(&moving, DT_S, &mut rng);
        // 1 − exp(−2π · 100 Hz / 240 Hz) = 0.9270
        assert!((reading.rates[0] - 0.9270).abs() < 1e-4, "{}", reading.rates[0]);
    }
}
