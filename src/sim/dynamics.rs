//! Dynamics that differ from the robot's description and from the configuration, as those of a real robot do.

use serde::{Deserialize, Serialize};

use super::control::{Gains, Latency};
use crate::config::Simulation;
use crate::mujoco::{Data, Inertial, Result};
use crate::robot::{JOINTS, Losses};
use crate::sim::Parts;

/// The dynamics of a robot during an episode.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Dynamics {
    /// Mass that the trunk has beyond the robot's description \[kg\].
    pub trunk_mass_kg: f64,
    /// Displacement of the trunk's centre of mass, forward, left and up, base frame \[m\].
    pub trunk_offset_m: [f64; 3],
    /// Factors of the gains `K_p` and `K_d`.
    pub gains: [f64; 2],
    /// Delay of the joint target \[s\].
    pub latency_s: f64,
    /// Dry friction of every joint in addition to the robot's [N·m].
    pub joint_friction_n_m: f64,
    /// Viscous damping of every joint in addition to the robot's [N·m·s/rad].
    pub joint_damping_n_m_s_per_rad: f64,
}

/// The dynamics that [`Dynamics`] deviate from.
#[derive(Debug, Clone)]
pub(super) struct Nominal {
    trunk: Inertial,
    gains: Gains,
    timestep_s: f64,
    losses: Losses,
}

impl Nominal {
    /// Reads the dynamics of a robot from its model, with the gains of a configuration.
    pub(super) fn new(data: &Data, parts: &Parts, config: &Simulation, losses: Losses) -> Self {
        let timestep_s = config.timestep_s();
        Nominal { trunk: data.model().inertial(parts.trunk()), gains: Gains::new(config), timestep_s, losses }
    }

    /// Gives a model deviating dynamics, and returns its gains and its latency.
    pub(super) fn deviate(&self, data: &mut Data, parts: &Parts, to: &Dynamics) -> Result<(Gains, Latency)> {
        data.set_inertial(parts.trunk(), &self.trunk, to.trunk_mass_kg, to.trunk_offset_m)?;
        let friction = self.losses.friction_n_m + to.joint_friction_n_m;
        let damping = self.losses.damping_n_m_s_per_rad + to.joint_damping_n_m_s_per_rad;
        parts.joints().into_iter().for_each(|joint| data.set_losses(joint, friction, damping));
        let gains = Gains {
            proportional: self.gains.proportional.map(|gain| to.gains[0] * gain),
            derivative: self.gains.derivative.map(|gain| to.gains[1] * gain),
        };
        Ok((gains, Latency::new(to.latency_s, self.timestep_s, [0.0; JOINTS])))
    }
}
