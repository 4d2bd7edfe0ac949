/*! The virtual mass that makes the compliance of a policy a command.

On the horizontal plane a commanded robot moves like a virtual mass with a virtual damper of 1/c to its commanded velocity,

`m v̇_ref = (v* − v_ref) / c + F`

with the robot's mass m, the commanded velocity v*, the commanded compliance c [m/s/N] and the external force F on its trunk,
which it feels ([`crate::estimate::external_force`]). A steady force offsets its velocity by c·F, and a push decays with the
time constant m·c. Gravity on a slope and obstacles under the feet are no force on the trunk.

A policy that tracks velocities yields a little by itself, by `C₀`, its own compliance, and follows a change of its command by a
part `k` of it; both differ forward and left. [`VirtualMass`] commands it the rest: on each axis, the velocity `v* + u` with

`m |c − C₀| u̇ = (c − C₀) F / k − u`

Softer than C₀, the command moves with the pull; stiffer, it moves against it.
*/

use nalgebra::Vector2;

use crate::observation::Command;

/// Shortest time constant of `u`, which keeps the gait out of it \[s\].
const SHORTEST_S: f64 = 0.05;

/// Velocity [m/s] up to which a pull moves a robot as commanded, the policy's own part included: that of a person who walks along.
pub const LARGEST_VELOCITY_M_S: f64 = 1.0;

/// Change of the commanded velocity [m/s] that is left where the policy's own part takes more than the rest of
/// [`LARGEST_VELOCITY_M_S`]. Under such pulls the policy's own compliance acts, so that they do not bring the robot down.
pub const LEAST_LIMIT_M_S: f64 = 0.5;

/// The virtual mass of one robot with one policy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VirtualMass {
    /// Mass of the robot \[kg\].
    pub mass_kg: f64,
    /// The policy's own compliance `C₀`, forward and left [m/s/N].
    pub own_m_s_per_n: [f64; 2],
    /// Change of velocity per change of the commanded velocity `k`, forward and left.
    pub tracking: [f64; 2],
    /// Largest velocity that it commands, forward and left, unless the command itself is larger [m/s].
    pub limits_m_s: [f64; 2],
    /// Duration of a policy step \[s\].
    pub period_s: f64,
}

impl VirtualMass {
    /// Returns the command for the policy of a robot that feels `force` on its trunk \[N\], is commanded `command`, and is to
    /// have the compliance `c` [m/s/N].
    ///
    /// `change` is the state `u`, zero at first. Force and state are forward and left, heading frame.
    pub fn command(&self, force: [f64; 2], command: &Command, c: f64, change: &mut [f64; 2]) -> Command {
        for axis in 0..2 {
            let gain = c - self.own_m_s_per_n[axis];
            let time_constant_s = (self.mass_kg * gain.abs()).max(SHORTEST_S);
            let goal = gain * force[axis] / self.tracking[axis];
            change[axis] += (1.0 - (-self.period_s / time_constant_s).exp()) * (goal - change[axis]);
        }
        let own_part_m_s = Vector2::from_fn(|axis, _| self.own_m_s_per_n[axis] * force[axis]).norm();
        *change =
            Vector2::from(*change).cap_magnitude((LARGEST_VELOCITY_M_S - own_part_m_s).max(LEAST_LIMIT_M_S)).into();
        let target = [command.forward, command.left];
        let [forward, left]: [f64; 2] = std::array::from_fn(|axis| {
            let limit = self.limits_m_s[axis].max(target[axis].abs());
            (target[axis] + change[axis]).clamp(-limit, limit)
        });
        Command { forward, left, ..*command }
    }
}

/// Largest velocity of a reference \[m/s\].
const MOST_REFERENCE_M_S: f64 = 1.5;

/// Moves the reference of a robot of `mass_kg` for a policy step: `m v̇_ref = (v* − v_ref) / c + F`, forward and left, heading frame.
/// Without a commanded compliance c it is the command.
pub fn follow(reference: &mut [f64; 2], command: &Command, force: [f64; 2], mass_kg: f64, period_s: f64) {
    let c = command.compliance.unwrap_or_default();
    for (axis, goal) in [command.forward, command.left].into_iter().enumerate() {
        let end = goal + c * force[axis];
        reference[axis] = end + (reference[axis] - end) * (-period_s / (mass_kg * c)).exp();
    }
    *reference = Vector2::from(*reference).cap_magnitude(MOST_REFERENCE_M_S).into();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reference_decays_with_m_c_and_ends_at_c_f() {
        let soft = Command { compliance: Some(0.03), ..Command::velocity(0.5, 0.0, 0.0) };
        let mut reference = [0.5, 0.0];
        (0..600).for_each(|_| follow(&mut reference, &soft, [0.0, 10.0], MASS_KG, STEP_S));
        assert!((reference[0] - 0.5).abs() < 1e-9 && (reference[1] - 0.3).abs() < 1e-9, "{reference:?}");
        // 12.5 kg · 0.03 m/s/N = 0.375 s, which the push takes to fall to 1/e.
        (0..22).for_each(|_| follow(&mut reference, &soft, [0.0; 2], MASS_KG, 0.375 / 22.0));
        assert!((reference[1] - 0.3 * (-1.0_f64).exp()).abs() < 1e-9, "{reference:?}");
        follow(&mut reference, &Command::velocity(0.2, 0.1, 0.0), [50.0; 2], MASS_KG, STEP_S);
        assert_eq!(reference, [0.2, 0.1]);
    }

    const MASS_KG: f64 = 12.5;
    const STEP_S: f64 = 1.0 / 60.0;
    const OWN: [f64; 2] = [0.01, 0.02];
    const TRACKING: [f64; 2] = [0.9, 0.8];

    fn mass(limits_m_s: [f64; 2]) -> VirtualMass {
        VirtualMass { mass_kg: MASS_KG, own_m_s_per_n: OWN, tracking: TRACKING, limits_m_s, period_s: STEP_S }
    }

    /// Returns velocity and path of a robot that follows its command with the compliance `own` (v = k v_command + C₀ F) while
    /// `force` acts for `acting_s`, and for 10 s in all.
    fn led(own: [f64; 2], c: f64, force: [f64; 2], acting_s: f64) -> ([f64; 2], [f64; 2]) {
        let mass = VirtualMass { own_m_s_per_n: own, ..mass([1.0, 1.0]) };
        let (mut change, mut velocity, mut path) = ([0.0; 2], [0.0; 2], [0.0; 2]);
        for step in 0..600 {
            let force = if f64::from(step) * STEP_S < acting_s { force } else { [0.0; 2] };
            let commanded = mass.command(force, &Command::default(), c, &mut change);
            let commanded = [TRACKING[0] * commanded.forward, TRACKING[1] * commanded.left];
            velocity = [commanded[0] + own[0] * force[0], commanded[1] + own[1] * force[1]];
            (0..2).for_each(|axis| path[axis] += STEP_S * velocity[axis]);
        }
        (velocity, path)
    }

    #[test]
    fn steady_pull_gives_commanded_compliance_on_both_axes() {
        for (own, c) in [(OWN, 0.005), (OWN, 0.015), (OWN, 0.03), (OWN, 0.05), ([-0.002, -0.003], 0.02)] {
            let ([forward, left], _) = led(own, c, [8.0, -8.0], 10.0);
            assert!((forward - 8.0 * c).abs() < 1e-3 && (left + 8.0 * c).abs() < 1e-3, "{c}: {forward} {left}");
        }
    }

    #[test]
    fn push_carries_by_compliance_times_momentum() {
        // 3 N s in one policy step: all in all c · 3 N s, whatever the policy's own part.
        let (velocity, [forward, left]) = led(OWN, 0.03, [3.0 / STEP_S, 3.0 / STEP_S], 0.9 * STEP_S);
        assert!((forward - 0.09).abs() < 2e-3 && (left - 0.09).abs() < 2e-3, "{forward} {left}");
        assert!(velocity[0].abs() < 1e-6);
    }

    #[test]
    fn strong_pull_changes_command_by_its_limit() {
        let walk = Command::velocity(0.8, 0.0, 0.2);
        // 0.01 m/s/N of its own: 40 N leave 1 - 0.4 m/s, 500 N the least.
        for (force, limit) in [(40.0, 0.6), (500.0, 0.5)] {
            let (mass, mut change) = (mass([1.0, 0.6]), [0.0; 2]);
            let commanded = (0..600).map(|_| mass.command([force, 0.0], &walk, 0.05, &mut change)).last().unwrap();
            assert_eq!((commanded.forward, commanded.left, commanded.yaw), (1.0, 0.0, 0.2));
            assert!((change[0] - limit).abs() < 1e-12, "{force} N: {}", change[0]);
        }
    }

    #[test]
    fn policy_that_does_not_yield_by_itself_goes_along_with_a_person() {
        let ([forward, left], _) = led([-0.001, 0.0], 0.05, [12.0, 0.0], 10.0);
        assert!((forward - 0.6).abs() < 1e-3 && left.abs() < 1e-9, "{forward} {left}");
    }
}
