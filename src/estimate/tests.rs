//! Tests of the estimator on a synthetic trot with the default sensor errors, and on faulty sensors.

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::walker::{DT_S, Truth, Walker};
use super::*;

/// Errors of an estimate, tick by tick after the start.
#[derive(Debug, Default)]
struct Errors {
    time_s: Vec<f64>,
    velocity: Vec<Vector3<f64>>,
    height: Vec<f64>,
    tilt: Vec<f64>,
    drift: Vec<f64>,
}

impl Errors {
    fn add(&mut self, time_s: f64, estimate: &Estimate, truth: &Truth) {
        self.time_s.push(time_s);
        self.velocity.push(estimate.velocity_in_base - truth.velocity_in_base);
        self.height.push(estimate.height_m - truth.position.z);
        let up = truth.world_from_base.inverse() * Vector3::new(0.0, 0.0, -1.0);
        self.tilt.push(estimate.gravity_in_base.angle(&up));
        self.drift.push((estimate.position - truth.position).xy().norm());
    }

    fn after(&self, time_s: f64) -> usize {
        self.time_s.partition_point(|time| *time < time_s)
    }

    /// Returns the root mean square error of the velocity per axis, from a time on [m/s].
    fn velocity_rmse(&self, from_s: f64) -> f64 {
        let errors = &self.velocity[self.after(from_s)..];
        (errors.iter().map(Vector3::norm_squared).sum::<f64>() / (3 * errors.len()) as f64).sqrt()
    }

    fn worst_velocity(&self, from_s: f64, to_s: f64) -> f64 {
        self.velocity[self.after(from_s)..self.after(to_s)].iter().map(Vector3::norm).fold(0.0, f64::max)
    }

    fn height_rmse(&self, from_s: f64) -> f64 {
        let errors = &self.height[self.after(from_s)..];
        (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt()
    }

    fn worst_tilt(&self) -> f64 {
        self.tilt.iter().copied().fold(0.0, f64::max)
    }
}

/// The readings of a tick, which a test can corrupt.
struct Tick {
    time_s: f64,
    imu: Option<ImuReading>,
    encoders: Option<EncoderReading>,
    contacts: [bool; 4],
}

fn walk(speed: f64, seconds: u32, seed: u64, mut spoil: impl FnMut(&mut Tick, &mut Walker)) -> Errors {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut sensors = Sensors::new(SensorNoise::default(), &mut rng);
    let mut walker = Walker::new(speed);
    let mut estimator = Estimator::new(Robot::load("go1").unwrap(), EstimatorConfig::default());
    let mut errors = Errors::default();
    for _ in 0..seconds * 240 {
        let truth = walker.step();
        let imu = Some(sensors.imu(&truth.imu, DT_S, &mut rng));
        let encoders = Some(sensors.encoders(&truth.encoders, DT_S, &mut rng));
        let mut tick = Tick { time_s: walker.time_s(), imu, encoders, contacts: truth.contacts };
        spoil(&mut tick, &mut walker);
        let estimate = estimator.update(tick.imu.as_ref(), tick.encoders.as_ref(), tick.contacts, DT_S).unwrap();
        errors.add(tick.time_s, estimate, &truth);
    }
    errors
}

fn nothing(_: &mut Tick, _: &mut Walker) {}

#[test]
fn a_robot_that_stands_stays_where_it_is() {
    for seed in 0..3 {
        let errors = walk(0.0, 20, seed, nothing);
        assert!(errors.velocity_rmse(1.0) < 0.005, "{}", errors.velocity_rmse(1.0));
        assert!(errors.height_rmse(1.0) < 0.003, "{}", errors.height_rmse(1.0));
        assert!(errors.drift.iter().all(|drift| *drift < 0.02), "{}", errors.drift.last().unwrap());
    }
}

#[test]
fn a_trot_is_followed() {
    for (speed, seed) in [(0.5, 0), (0.5, 1), (0.5, 2), (1.0, 3), (-0.5, 4)] {
        let errors = walk(speed, 12, seed, nothing);
        assert!(errors.velocity_rmse(1.0) < 0.02, "{}", errors.velocity_rmse(1.0));
        assert!(errors.height_rmse(1.0) < 0.005, "{}", errors.height_rmse(1.0));
        assert!(errors.worst_tilt() < 3.0_f64.to_radians(), "{}", errors.worst_tilt());
    }
}

#[test]
fn a_foot_that_slips_moves_the_velocity_by_a_fifth_of_its_slip() {
    // FR swings from 5.0 to 5.25 s, FL from 5.25 to 5.5 s: each slips while it is one of two feet on the ground.
    for (leg, from_s) in [(1, 5.05), (0, 5.30)] {
        for seed in 0..3 {
            let mut slipped = 0;
            let errors = walk(0.5, 8, seed, |tick, walker| {
                let slips = (from_s..from_s + 0.1).contains(&tick.time_s);
                slipped += u32::from(slips && tick.contacts[leg]);
                walker.slip = slips.then_some((leg, Vector3::new(-0.5, 0.3, 0.0)));
            });
            assert_eq!(slipped, 24);
            // 0.58 m/s: half of it would be the mean of both feet.
            let worst = errors.worst_velocity(5.0, 5.6);
            assert!(worst < 0.2 * 0.583 && worst > 0.03, "{worst}");
            assert!(errors.velocity_rmse(5.7) < 0.02);
        }
    }
}

#[test]
fn a_contact_flag_may_be_wrong_for_50_ms() {
    // FR swings from 5.0 to 5.25 s, FL from 5.25 to 5.5 s. The first is reported in contact in mid-swing or before it lands; the second is
    // reported without contact.
    for (leg, says, from_s) in [(0, true, 5.1), (0, true, 5.2), (1, false, 5.1)] {
        let errors = walk(0.5, 8, 6, |tick, _| {
            if (from_s..from_s + 0.05).contains(&tick.time_s) {
                assert_ne!(tick.contacts[leg], says);
                tick.contacts[leg] = says;
            }
        });
        assert!(errors.worst_velocity(5.0, 5.4) < 0.1, "{}", errors.worst_velocity(5.0, 5.4));
        assert!(errors.velocity_rmse(5.5) < 0.02);
        assert!(errors.height_rmse(5.0) < 0.005);
    }
}

#[test]
fn silence_of_a_sensor_is_bridged() {
    // The longest permitted silence leaves errors as large as the speed.
    for (imu, silent_s, worst_m_s) in [(true, 0.02, 0.15), (false, 0.02, 0.15), (true, 0.095, 0.5), (false, 0.095, 0.5)]
    {
        let errors = walk(0.5, 8, 7, |tick, _| {
            if (5.1..5.1 + silent_s).contains(&tick.time_s) {
                if imu { tick.imu = None } else { tick.encoders = None }
            }
        });
        let worst = errors.worst_velocity(5.0, 5.6);
        assert!(worst < worst_m_s, "{imu} {silent_s}: {worst}");
        assert!(errors.velocity_rmse(6.0) < 0.03, "{imu} {silent_s}: {}", errors.velocity_rmse(6.0));
    }
}

fn standing() -> (Estimator, Truth) {
    let mut walker = Walker::new(0.0);
    let mut estimator = Estimator::new(Robot::load("go1").unwrap(), EstimatorConfig::default());
    let mut truth = walker.step();
    for _ in 0..10 {
        truth = walker.step();
        estimator.update(Some(&truth.imu), Some(&truth.encoders), truth.contacts, DT_S).unwrap();
    }
    (estimator, truth)
}

#[test]
fn a_reading_that_is_not_a_number_is_named_and_changes_nothing() {
    let (mut estimator, truth) = standing();
    let before = estimator.clone();
    let mut imu = truth.imu;
    imu.specific_force.y = f64::NAN;
    let fault = estimator.update(Some(&imu), Some(&truth.encoders), truth.contacts, DT_S).unwrap_err();
    assert!(matches!(&fault, SensorFault::NotFinite { reading, .. } if reading == "accelerometer y"), "{fault}");
    let mut encoders = truth.encoders;
    encoders.rates[4] = f64::INFINITY;
    let fault = estimator.update(Some(&truth.imu), Some(&encoders), truth.contacts, DT_S).unwrap_err();
    assert!(matches!(&fault, SensorFault::NotFinite { reading, .. } if reading == "rate of FL_thigh"), "{fault}");
    let fault = estimator.update(Some(&truth.imu), Some(&truth.encoders), truth.contacts, 0.0).unwrap_err();
    assert_eq!(fault, SensorFault::Timestep(0.0));
    assert_eq!(estimator, before);
    assert!(estimator.update(Some(&truth.imu), Some(&truth.encoders), truth.contacts, DT_S).is_ok());
}

#[test]
fn silence_for_too_long_is_a_fault_that_stays() {
    let (mut estimator, truth) = standing();
    let mut step = |imu| estimator.update(imu, Some(&truth.encoders), truth.contacts, DT_S).copied();
    // 0.1 s · 240 Hz = 24 ticks.
    for _ in 0..24 {
        step(None).unwrap();
    }
    assert!(matches!(step(None), Err(SensorFault::Silent { sensor: "IMU", .. })));
    assert!(step(Some(&truth.imu)).is_err());
    assert!(estimator.estimate().is_some());
}

#[test]
fn too_long_a_time_between_two_good_ticks_is_a_silence_too() {
    let (mut estimator, truth) = standing();
    let mut step = |dt_s| estimator.update(Some(&truth.imu), Some(&truth.encoders), truth.contacts, dt_s).copied();
    step(0.1).unwrap();
    assert!(matches!(step(0.11), Err(SensorFault::Silent { .. })));
}

#[test]
fn nothing_can_start_without_both_sensors() {
    let (_, truth) = standing();
    let mut estimator = Estimator::new(Robot::load("go1").unwrap(), EstimatorConfig::default());
    let fault = estimator.update(Some(&truth.imu), None, truth.contacts, DT_S).unwrap_err();
    assert_eq!(fault, SensorFault::Missing("encoders"));
    assert!(estimator.estimate().is_none());
}
