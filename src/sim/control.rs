/*! The joint controller (section IV): a PD law at the physics rate on targets that arrive late.

The latency delays the joint target, not the measured angle and rate. A delay that is not a whole number of physics
steps is kept exactly: within a step the PD law sees the delayed target averaged over that step. For 30 ms at 240 Hz,
7.2 steps, that is 0.2 of the target issued 8 steps ago and 0.8 of the one issued 7 steps ago.
*/

use serde::{Deserialize, Serialize};

use crate::config::Simulation;
use crate::robot::{JOINTS, Joints};

/// Gains of the PD controller.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Gains {
    /// Proportional gain `K_p` of each joint [N·m/rad].
    pub proportional: Joints,
    /// Derivative gain `K_d` of each joint [N·m·s/rad].
    pub derivative: Joints,
}

impl Gains {
    /// Returns the gains of a configuration.
    pub fn new(config: &Simulation) -> Self {
        Gains { proportional: config.kp_n_m_per_rad.joints(), derivative: config.kd_n_m_s_per_rad.joints() }
    }

    /// Computes `τ = K_p (target − q) − K_d q̇`, limited to ± `limits` [N·m].
    pub fn torques(&self, target: &Joints, angles: &Joints, rates: &Joints, limits: &Joints) -> Joints {
        std::array::from_fn(|joint| {
            let torque =
                self.proportional[joint] * (target[joint] - angles[joint]) - self.derivative[joint] * rates[joint];
            torque.clamp(-limits[joint], limits[joint])
        })
    }
}

/// A fixed delay of joint targets.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Latency {
    /// Weight of the older of the two targets in the average.
    fraction: f64,
    /// Targets of the last steps in a ring buffer; the oldest is at `next`.
    targets: Vec<Joints>,
    next: usize,
}

impl Latency {
    /// Creates a delay of `latency_s` \[s\] in steps of `timestep_s` \[s\], filled with `target`.
    pub fn new(latency_s: f64, timestep_s: f64, target: Joints) -> Self {
        // 0.03 · 240 must be 7.2 and not 7.199…: snap to a millionth of a step.
        let steps = (latency_s / timestep_s * 1e6).round() / 1e6;
        let whole = steps.floor();
        Latency { fraction: steps - whole, targets: vec![target; whole as usize + 2], next: 0 }
    }

    /// Returns true if `other` is a state of the same delay.
    pub fn fits(&self, other: &Self) -> bool {
        let length = self.targets.len();
        other.targets.len() == length && other.next < length && other.fraction == self.fraction
    }

    /// Replaces all stored targets by this one.
    pub fn reset(&mut self, target: Joints) {
        self.targets.fill(target);
        self.next = 0;
    }

    /// Takes the target issued for this physics step and returns the target that acts in it.
    pub fn delay(&mut self, target: &Joints) -> Joints {
        let length = self.targets.len();
        self.targets[self.next] = *target;
        self.next = (self.next + 1) % length;
        // `next` is now the oldest: whole + 1 steps ago. The one after it: whole steps ago.
        let (older, newer) = (self.targets[self.next], self.targets[(self.next + 1) % length]);
        std::array::from_fn(|joint| self.fraction * older[joint] + (1.0 - self.fraction) * newer[joint])
    }
}

/// Computes the mechanical power `Σ |τ·q̇|` \[W\].
pub fn mechanical_power(torques: &Joints, rates: &Joints) -> f64 {
    (0..JOINTS).map(|joint| (torques[joint] * rates[joint]).abs()).sum()
}

/// Computes the squared torque `‖τ‖₂²` [N²·m²].
pub fn squared_torque(torques: &Joints) -> f64 {
    torques.iter().map(|torque| torque * torque).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::same_in_every_leg;

    fn filled(value: f64) -> Joints {
        [value; JOINTS]
    }

    #[test]
    fn torque_is_kp_times_error_minus_kd_times_rate_within_limits() {
        let gains = Gains { proportional: filled(40.0), derivative: filled(1.0) };
        // 40 · (0.5 − 0.2) − 1 · 3 = 9
        assert!((gains.torques(&filled(0.5), &filled(0.2), &filled(3.0), &filled(23.7))[0] - 9.0).abs() < 1e-12);
        let knees = Gains { proportional: same_in_every_leg([20.0, 20.0, 40.0]), ..gains };
        // 40 · 0.3 − 1 · 3 at a calf, 20 · 0.3 − 1 · 3 at a thigh.
        let torques = knees.torques(&filled(0.5), &filled(0.2), &filled(3.0), &filled(23.7));
        assert!((torques[5] - 9.0).abs() < 1e-12 && (torques[4] - 3.0).abs() < 1e-12);
        assert_eq!(gains.torques(&filled(2.0), &filled(0.0), &filled(0.0), &filled(23.7))[0], 23.7);
        assert_eq!(gains.torques(&filled(-2.0), &filled(0.0), &filled(0.0), &filled(23.7))[0], -23.7);
    }

    #[test]
    fn thirty_milliseconds_at_240_hz_act_from_the_eighth_step_with_weight_0_8() {
        let mut latency = Latency::new(0.030, 1.0 / 240.0, filled(0.0));
        let acting: Vec<f64> = (0..10).map(|_| latency.delay(&filled(1.0))[0]).collect();
        assert_eq!(acting[..7], [0.0; 7]);
        assert!((acting[7] - 0.8).abs() < 1e-12);
        assert_eq!(acting[8..], [1.0; 2]);
    }

    #[test]
    fn whole_delays_do_not_blend_and_no_delay_passes_through() {
        let mut two = Latency::new(2.0 / 240.0, 1.0 / 240.0, filled(0.0));
        let acting: Vec<f64> = (1..=4).map(|k| two.delay(&filled(f64::from(k)))[0]).collect();
        assert_eq!(acting, [0.0, 0.0, 1.0, 2.0]);
        let mut none = Latency::new(0.0, 1.0 / 240.0, filled(0.0));
        assert_eq!(none.delay(&filled(3.0)), filled(3.0));
    }

    #[test]
    fn power_counts_braking_and_driving_alike() {
        let (mut torques, mut rates) = (filled(0.0), filled(0.0));
        (torques[0], rates[0]) = (2.0, 3.0);
        (torques[5], rates[5]) = (-4.0, 0.5);
        assert_eq!(mechanical_power(&torques, &rates), 8.0);
        assert_eq!(squared_torque(&torques), 20.0);
    }
}
