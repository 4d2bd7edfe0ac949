/*! The outer loop that makes the compliance of a policy a command.

On the horizontal plane a commanded robot moves like a virtual mass with a virtual damper of 1/c to its commanded velocity,

`m v̇_ref = (v* − v_ref) / c + f`

with the robot's mass m, the commanded velocity v*, the commanded compliance c [m/s/N] and the external force f. A steady
force offsets its velocity by c·f, and a push decays with the time constant m·c. On a slope, the component of gravity is not
treated as an external force.

A policy that tracks velocities yields a little by itself, by `C₀`, its own compliance. The outer loop around it turns that
into any c: it commands the velocity

`v* + (1 − C₀/c) · LP(v − v* − bias)`

of the measured velocity v, LP being a low-pass and the bias the velocity error of the undisturbed policy. Softer than C₀,
the command moves with the pull; stiffer, it moves against it. The output of the low-pass is limited to 0.5 m/s: beyond that,
the robot yields by its own compliance.
*/

use nalgebra::Vector2;

use crate::config::Config;
use crate::observation::Command;

/// Time constant of the low-pass, which takes out the gait \[s\].
const SMOOTHING_S: f64 = 0.1;

/// The largest velocity error that the outer loop acts on [m/s]. Without a bound, pulls of 50 N bring down 22 to 29 % of the
/// robots at a commanded compliance of 0.03 and 0.05 m/s/N, with this one 9 % (docs/compliance.md).
const LARGEST_ERROR_M_S: f64 = 0.5;

/// The outer loop around one policy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OuterLoop {
    /// The policy's own compliance, `C₀` [m/s/N].
    pub own_m_s_per_n: f64,
    /// The largest velocity that the loop commands, forward and left, unless the command itself is larger [m/s].
    pub limits_m_s: [f64; 2],
    /// The time between two policy steps \[s\].
    pub period_s: f64,
}

impl OuterLoop {
    /// Creates the loop for a policy of this configuration, with the policy's own compliance [m/s/N].
    pub fn new(config: &Config, own_m_s_per_n: f64) -> Self {
        let (limits_m_s, period_s) = (config.outer_loop_limits_m_s(), config.simulation.policy_period_s());
        OuterLoop { own_m_s_per_n, limits_m_s, period_s }
    }

    /// Returns the command for the policy of a robot that walks at `velocity`, is commanded `command` and the compliance `c`
    /// [m/s/N].
    ///
    /// `low_pass` is the loop's state, zero at first. Velocity, bias and state are forward and left, base frame [m/s].
    pub fn command(
        &self,
        velocity: [f64; 2],
        command: &Command,
        c: f64,
        bias: [f64; 2],
        low_pass: &mut [f64; 2],
    ) -> Command {
        let step = 1.0 - (-self.period_s / SMOOTHING_S).exp();
        let gain = 1.0 - self.own_m_s_per_n / c;
        let target = [command.forward, command.left];
        for axis in 0..2 {
            low_pass[axis] += step * (velocity[axis] - target[axis] - bias[axis] - low_pass[axis]);
        }
        let off = Vector2::from(*low_pass).cap_magnitude(LARGEST_ERROR_M_S);
        let [forward, left]: [f64; 2] = std::array::from_fn(|axis| {
            let limit = self.limits_m_s[axis].max(target[axis].abs());
            (target[axis] + gain * off[axis]).clamp(-limit, limit)
        });
        Command { forward, left, ..*command }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MASS_KG: f64 = 12.5;
    const STEP_S: f64 = 1.0 / 60.0;

    /// Returns the final velocity to the left of a robot that follows its command with its own compliance of 0.01 m/s/N (`m v̇ =
    /// (v* − v) / C₀ + f`, solved exactly) and is pulled to the left for 10 s, with the outer loop around it.
    fn velocity_left(c: f64, force_n: f64, bias: f64, known_bias: f64) -> f64 {
        let outer_loop = OuterLoop { own_m_s_per_n: 0.01, limits_m_s: [1.0, 0.6], period_s: STEP_S };
        let (command, mut velocity, mut low_pass) = (Command::velocity(0.5, 0.0, 0.0), [0.0; 2], [0.0; 2]);
        let kept = (-STEP_S / (MASS_KG * outer_loop.own_m_s_per_n)).exp();
        for _ in 0..600 {
            let commanded = outer_loop.command(velocity, &command, c, [0.0, known_bias], &mut low_pass);
            let goals = [commanded.forward, commanded.left + bias + outer_loop.own_m_s_per_n * force_n];
            velocity = std::array::from_fn(|axis| goals[axis] + kept * (velocity[axis] - goals[axis]));
        }
        velocity[1]
    }

    #[test]
    fn outer_loop_gives_commanded_compliance() {
        for c in [0.005, 0.01, 0.02, 0.05] {
            assert!((velocity_left(c, 10.0, 0.0, 0.0) - 10.0 * c).abs() < 1e-4, "{c}");
        }
        // The loop adds 0.8 · 0.5 m/s and no more; the policy itself yields by 30 · 0.01 m/s.
        assert!((velocity_left(0.05, 30.0, 0.0, 0.0) - 0.7).abs() < 1e-4);
        // At five times its own compliance a bias of the policy counts five times, unless it is known.
        assert!((velocity_left(0.05, 0.0, 0.02, 0.0) - 0.1).abs() < 1e-4);
        assert!((velocity_left(0.05, 0.0, 0.02, 0.02) - 0.02).abs() < 1e-4);
    }
}
