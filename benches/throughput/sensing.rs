//! A tick of the sensing path (contact network, orientation and Kalman filter), and the observer of external forces.

use nalgebra::{UnitQuaternion, Vector3};
use supple::config::Config;
use supple::estimate::contact::{ContactEstimator, ContactNetwork, RATE_HZ};
use supple::estimate::external_force::{ForceObserver, ForceReading};
use supple::estimate::{EncoderReading, Estimator, EstimatorConfig, ImuReading};
use supple::robot::{JOINTS, Robot};

use crate::{Figures, timed};

const TICKS: usize = 20_000;

pub fn measure(config: &Config, repetitions: usize, figures: &mut Figures) -> anyhow::Result<()> {
    // A robot that stands: the time does not depend on more.
    let imu = ImuReading { gyro: Vector3::zeros(), specific_force: Vector3::new(0.0, 0.0, 9.81) };
    let target = config.action.nominal_pose_rad.joints();
    let encoders = EncoderReading { angles: target, rates: [0.0; JOINTS] };
    let (torques, world_from_base) = ([1.0; JOINTS], UnitQuaternion::identity());
    let reading = ForceReading { imu, encoders, torques, world_from_base };
    let robot = Robot::load("go1")?;
    let per_tick_us = |tick: &mut dyn FnMut() -> anyhow::Result<()>| {
        timed(|| (0..TICKS).try_for_each(|_| tick())).map(|(elapsed_s, ())| 1e6 * elapsed_s / TICKS as f64)
    };
    let (mut tick_us, mut observer_us) = (Vec::new(), Vec::new());
    for _ in 0..repetitions {
        let mut contacts = ContactEstimator::new(ContactNetwork::shipped()?);
        let mut estimator = Estimator::new(robot.clone(), EstimatorConfig::default());
        tick_us.push(per_tick_us(&mut || {
            let touching = contacts.update(&encoders, &target);
            Ok(estimator.update(Some(&imu), Some(&encoders), touching, 1.0 / RATE_HZ).map(drop)?)
        })?);
        let mut observer = ForceObserver::new(&robot)?;
        observer_us.push(per_tick_us(&mut || Ok(observer.update(&reading, 1.0 / RATE_HZ).map(drop)?))?);
    }
    figures.note("sensing_tick_us", tick_us);
    figures.note("force_observer_step_us", observer_us);
    Ok(())
}
