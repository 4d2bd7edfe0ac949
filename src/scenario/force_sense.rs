//! The force observer in play: fed after every physics step with the true state, or with what the sensors read.

use crate::estimate::external_force::{ExternalForces, ForceFault, ForceObserver, ForceReading};
use crate::mujoco::Data;
use crate::robot::Joints;
use crate::scenario::senses::{ExactSensors, Senses};
use crate::sim::{Conditions, Parts, Sim, StepObserver};

/// A [`ForceObserver`] and the exact sensors that feed it if there are no others. As a [`StepObserver`] it takes the true
/// state.
#[derive(Debug)]
pub struct ForceSense {
    observer: ForceObserver,
    exact: ExactSensors,
}

impl ForceSense {
    /// Starts in the present state. `time_constant_s` as in [`ForceObserver::new`].
    ///
    /// # Errors
    /// As [`ForceObserver::new`].
    pub fn new(sim: &Sim, conditions: &Conditions, time_constant_s: f64) -> Result<Self, ForceFault> {
        let observer = ForceObserver::new(sim.robot(), time_constant_s)?;
        Ok(ForceSense { observer, exact: ExactSensors::new(sim, conditions) })
    }

    /// Takes a physics step, between its two halves as [`StepObserver::forces`], with the torques of the motors in it
    /// [N·m]. With `senses`, it takes what they have read, so they are to be read first; without, the true state.
    ///
    /// # Errors
    /// As [`ForceObserver::update`].
    pub fn read(
        &mut self,
        data: &Data,
        parts: &Parts,
        torques: &Joints,
        senses: Option<&Senses>,
    ) -> Result<&ExternalForces, ForceFault> {
        let (imu, encoders) = self.exact.read(data, parts);
        let truth = || ForceReading { imu, encoders, torques: *torques, world_from_base: parts.world_from_base(data) };
        let reading = senses.map_or_else(truth, |senses| senses.force_reading(torques));
        self.observer.update(&reading, data.model().timestep_s())
    }

    /// The forces after the last physics step.
    pub fn forces(&self) -> &ExternalForces {
        self.observer.forces()
    }

    /// Starts anew in the present state, as after the robot has been put elsewhere.
    pub fn reset(&mut self, sim: &Sim, conditions: &Conditions) {
        self.exact = ExactSensors::new(sim, conditions);
        self.observer.reset();
    }
}

impl StepObserver for ForceSense {
    fn forces(&mut self, data: &Data, parts: &Parts, torques: &Joints) {
        // A fault is kept as a doubt beside the forces.
        let _ = self.read(data, parts, torques, None);
    }
}
