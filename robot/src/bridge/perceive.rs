/*! Estimates the state that a policy acts on from the robot's readings: contact network, Kalman filter, felt force. */

use std::sync::Arc;

use supple::estimate::contact::{ContactEstimator, ContactNetwork, RATE_HZ};
use supple::estimate::external_force::{ForceObserver, ForceReading};
use supple::estimate::{EncoderReading, Estimator, EstimatorConfig};
use supple::robot::{Joints, Robot, RobotState};
use supple::util::files::FileError;

use super::reading::Reading;
use super::safety::Fault;

/// The estimators of one robot.
pub struct Perception {
    robot: Arc<Robot>,
    contacts: ContactEstimator,
    estimator: Estimator,
    forces: ForceObserver,
    touching: [bool; 4],
    /// Time since the last tick of the contact network \[s\].
    since_contact_s: f64,
    before: Option<EncoderReading>,
}

impl Perception {
    /// Creates the estimators; they start with the first reading, in which the robot should be at rest.
    pub fn new(robot: Arc<Robot>) -> anyhow::Result<Self> {
        let contacts = ContactEstimator::new(ContactNetwork::shipped()?);
        let estimator = Estimator::new(Arc::clone(&robot), EstimatorConfig::default());
        let forces = ForceObserver::new(&robot)?;
        Ok(Perception { contacts, estimator, forces, touching: [true; 4], since_contact_s: 0.0, before: None, robot })
    }

    /// Discards all readings; the next one counts as the first.
    pub fn restart(&mut self) -> Result<(), FileError> {
        self.contacts = ContactEstimator::new(ContactNetwork::shipped()?);
        self.estimator = Estimator::new(Arc::clone(&self.robot), EstimatorConfig::default());
        self.forces.reset();
        (self.touching, self.since_contact_s, self.before) = ([true; 4], 0.0, None);
        Ok(())
    }

    /// Takes a reading, `dt_s` \[s\] after the last one; `targets` are the joint targets that the policy gave last \[rad\].
    pub fn take(&mut self, reading: &Reading, targets: &Joints, dt_s: f64) -> Result<(), Fault> {
        let fault = |error: &dyn std::fmt::Display| Fault::Estimate { reason: error.to_string() };
        self.touch(&reading.encoders, targets, dt_s);
        self.before = Some(reading.encoders);
        let Reading { imu, encoders, torques, .. } = *reading;
        let estimate = self.estimator.update(Some(&imu), Some(&encoders), self.touching, dt_s);
        let world_from_base = estimate.map_err(|error| fault(&error))?.world_from_base;
        let felt = ForceReading { imu, encoders, torques, world_from_base };
        self.forces.update(&felt, dt_s).map_err(|error| fault(&error))?;
        Ok(())
    }

    /// Runs the contact network at its own rate, on readings interpolated to its ticks.
    fn touch(&mut self, now: &EncoderReading, targets: &Joints, dt_s: f64) {
        let before = self.before.unwrap_or(*now);
        let tick_s = 1.0 / RATE_HZ;
        // The first tick is the first reading.
        let mut at_s = if self.before.is_some() { tick_s - self.since_contact_s } else { dt_s };
        while at_s <= dt_s + 1e-12 {
            let part = at_s / dt_s;
            let [angles, rates] = [(&before.angles, &now.angles), (&before.rates, &now.rates)]
                .map(|(a, b)| std::array::from_fn(|joint| a[joint] + part * (b[joint] - a[joint])));
            let reading = EncoderReading { angles, rates };
            self.touching = self.contacts.update(&reading, targets);
            at_s += tick_s;
        }
        self.since_contact_s = dt_s - (at_s - tick_s);
    }

    /// Returns the state for a policy step, with the mean of the felt force since the last one; `None` before the first
    /// reading.
    pub fn state(&mut self) -> Option<RobotState> {
        let (estimate, encoders) = (self.estimator.estimate()?, self.before?);
        let felt = self.forces.take_mean();
        let felt_force = felt.doubt.is_none().then_some([felt.force.x, felt.force.y]);
        Some(RobotState { felt_force, ..estimate.state(&self.robot, &encoders, self.touching) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bridge::reading::tests::state_at;

    #[test]
    fn robot_at_rest_is_perceived_at_rest_at_its_height() {
        let robot = Robot::load("go2").unwrap();
        let mut perception = Perception::new(Arc::clone(&robot)).unwrap();
        let reading = Reading::new(&state_at(&robot.nominal_pose, 2)).unwrap();
        assert!(perception.state().is_none());
        (0..500).for_each(|_| perception.take(&reading, &robot.nominal_pose, 0.002).unwrap());
        let state = perception.state().unwrap();
        assert!((state.height - robot.standing_height_m(&robot.nominal_pose)).abs() < 0.005, "{}", state.height);
        // Without motor torque, the robot hangs or lies, and there is no felt force.
        assert!(state.velocity_in_base.norm() < 0.01 && state.felt_force.is_none());
    }

    #[test]
    fn contact_network_ticks_at_its_own_rate_whatever_the_readings_do() {
        let robot = Robot::load("go2").unwrap();
        let reading = Reading::new(&state_at(&robot.nominal_pose, 2)).unwrap();
        for (count, dt_s) in [(500, 0.002), (100, 0.010), (1000, 0.001)] {
            let mut perception = Perception::new(Arc::clone(&robot)).unwrap();
            for _ in 0..=count {
                perception.take(&reading, &robot.nominal_pose, dt_s).unwrap();
                assert!((-1e-9..1.0 / RATE_HZ + 1e-9).contains(&perception.since_contact_s));
            }
            // A second has passed since the first tick: 240 ticks.
            let left_s: f64 = f64::from(count) * dt_s - perception.since_contact_s;
            assert!(((left_s * RATE_HZ).round() - left_s * RATE_HZ).abs() < 1e-6, "{dt_s}: {left_s}");
        }
    }
}
