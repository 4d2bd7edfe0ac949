//! (f) A tick of the sensing path: contact network, orientation and Kalman filter; and the observer of external forces.

use nalgebra::{UnitQuaternion, Vector3};
use serde::Serialize;
use supple::config::Config;
use supple::estimate::contact::{ContactEstimator, ContactNetwork, RATE_HZ};
use supple::estimate::external_force::{ForceObserver, ForceReading};
use supple::estimate::{EncoderReading, Estimator, EstimatorConfig, ImuReading};
use supple::robot::{JOINTS, PARTS, Robot};

use crate::stopwatch::{Effort, median, timed};

#[derive(Debug, Serialize)]
pub struct Sensing {
    pub network_us: f64,
    pub tick_us: f64,
    /// The observer of external forces, one physics step [µs].
    pub observer_us: f64,
}

/// Readings of a robot that bends its knees once a second.
fn reading(config: &Config, tick: usize) -> (ImuReading, EncoderReading) {
    let phase = std::f64::consts::TAU * tick as f64 / RATE_HZ;
    let mut angles = config.action.nominal_pose_rad.joints();
    angles.iter_mut().skip(2).step_by(PARTS.len()).for_each(|calf| *calf += 0.1 * phase.sin());
    let mut rates = [0.0; JOINTS];
    rates.iter_mut().skip(2).step_by(PARTS.len()).for_each(|calf| *calf = 0.1 * std::f64::consts::TAU * phase.cos());
    let imu = ImuReading { gyro: Vector3::zeros(), specific_force: Vector3::new(0.0, 0.0, 9.81) };
    (imu, EncoderReading { angles, rates })
}

/// Measures with the shipped network.
pub fn measure(config: &Config, effort: &Effort) -> anyhow::Result<Sensing> {
    let ticks = if effort.quick { 240 } else { 20_000 };
    let readings: Vec<_> = (0..ticks).map(|tick| reading(config, tick)).collect();
    let target = config.action.nominal_pose_rad.joints();
    let per_tick_us = |seconds: f64| 1e6 * seconds / ticks as f64;
    let (mut network_s, mut whole_s, mut observer_s) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..effort.repetitions {
        let mut contacts = ContactEstimator::new(ContactNetwork::shipped()?);
        let touched = || readings.iter().filter(|(_, encoders)| contacts.update(encoders, &target)[0]).count();
        let (elapsed_s, touched) = timed(touched);
        std::hint::black_box(touched);
        network_s.push(elapsed_s);

        let mut contacts = ContactEstimator::new(ContactNetwork::shipped()?);
        let mut estimator = Estimator::new(Robot::load("go1")?, EstimatorConfig::default());
        let (elapsed_s, result) = timed(|| {
            readings.iter().try_for_each(|(imu, encoders)| {
                let touching = contacts.update(encoders, &target);
                estimator.update(Some(imu), Some(encoders), touching, 1.0 / RATE_HZ).map(drop)
            })
        });
        result?;
        whole_s.push(elapsed_s);

        let mut observer = ForceObserver::new(&*Robot::load("go1")?)?;
        let (elapsed_s, result) = timed(|| {
            readings.iter().try_for_each(|&(imu, encoders)| {
                let world_from_base = UnitQuaternion::identity();
                let reading = ForceReading { imu, encoders, torques: [1.0; JOINTS], world_from_base };
                observer.update(&reading, 1.0 / RATE_HZ).map(drop)
            })
        });
        result?;
        observer_s.push(elapsed_s);
    }
    Ok(Sensing {
        network_us: per_tick_us(median(network_s)),
        tick_us: per_tick_us(median(whole_s)),
        observer_us: per_tick_us(median(observer_s)),
    })
}
