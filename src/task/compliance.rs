/*! Compliance as a command: the desired motion of a pulled robot, and an outer loop that achieves it.

On the horizontal plane it is to move like a virtual mass with a virtual damper of 1/c to its commanded velocity,

`m v̇_ref = (v* − v_ref) / c + f`

with the robot's mass m, the commanded velocity v*, the commanded compliance c [m/s/N] and the force f of the pull. A steady
force offsets its velocity by c·f, and a push decays with the time constant m·c. On a slope, the component of gravity is not treated as an external pull.

A policy that tracks velocities yields a little by itself, by `C₀`, its own compliance. An outer loop around it makes that any
c: it commands the velocity

`v* + (1 − C₀/c) · LP(v − v* − bias)`

of the measured velocity v, LP being a low-pass and the bias what the policy's velocity is off by undisturbed. Softer than C₀,
the command goes with the hand; stiffer, it goes against it. Of what the low-pass gives, 0.5 m/s count and no more: whoever
pulls harder than that meets the policy itself.
*/

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::config::Config;
use crate::observation::Command;
use crate::robot::RobotState;

/// Time constant of the low-pass, which takes out the gait \[s\].
const SMOOTHING_S: f64 = 0.1;

/// Largest bias of the velocity command [m/s]. Without a bound, pulls of 50 N bring down 22 to 29 % of the robots
/// at commanded 0.03 and 0.05 m/s/N, with this one 9 % (docs/compliance.md).
const LED_M_S: f64 = 0.5;

/// The outer loop around a policy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OuterLoop {
    /// Own compliance `C₀` [m/s/N].
    pub own_m_s_per_n: f64,
    /// Fastest walk that it asks for, forward and left, unless the command is faster [m/s].
    pub limits_m_s: [f64; 2],
    /// Time between two policy steps \[s\].
    pub period_s: f64,
}

impl OuterLoop {
    /// Creates the loop around a policy of this configuration whose own compliance is `own_m_s_per_n`.
    pub fn new(config: &Config, own_m_s_per_n: f64) -> Self {
        let (limits_m_s, period_s) = (config.led_limits_m_s(), config.simulation.policy_period_s());
        OuterLoop { own_m_s_per_n, limits_m_s, period_s }
    }

    /// What to command of a policy that walks at `velocity`, is to walk at `command` and to yield by `c` [m/s/N]. `led` is the
    /// state of the low-pass, zero at first. All of them are forward and left, base frame, and so is the bias [m/s].
    pub fn command(
        &self,
        velocity: [f64; 2],
        command: &Command,
        c: f64,
        bias: [f64; 2],
        led: &mut [f64; 2],
    ) -> Command {
        let step = 1.0 - (-self.period_s / SMOOTHING_S).exp();
        let gain = 1.0 - self.own_m_s_per_n / c;
        let asked = [command.forward, command.left];
        for axis in 0..2 {
            led[axis] += step * (velocity[axis] - asked[axis] - bias[axis] - led[axis]);
        }
        let off = Vector2::from(*led).cap_magnitude(LED_M_S);
        let [forward, left]: [f64; 2] = std::array::from_fn(|axis| {
            let limit = self.limits_m_s[axis].max(asked[axis].abs());
            (asked[axis] + gain * off[axis]).clamp(-limit, limit)
        });
        Command { forward, left, ..*command }
    }
}

/// A virtual mass.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct VirtualMass {
    /// `v_ref`, world frame, horizontal [m/s].
    velocity: [f64; 2],
}

/// Parameters of a virtual mass over one time step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pulled {
    /// Horizontal force, world frame \[N\].
    pub force: [f64; 2],
    /// Mass of the robot \[kg\].
    pub mass_kg: f64,
    /// Duration \[s\].
    pub time_s: f64,
}

impl VirtualMass {
    /// Creates a virtual mass at the robot's velocity.
    pub fn new(state: &RobotState) -> Self {
        let velocity = state.velocity_in_world();
        VirtualMass { velocity: [velocity.x, velocity.y] }
    }

    /// Lets a force act on it for a while, with a damper of `1/c` to the command: the exact solution. It gets no faster than
    /// `limit_m_s`, unless the command is.
    pub fn step(&mut self, state: &RobotState, command: &Command, c: f64, pulled: Pulled, limit_m_s: f64) {
        let asked = state.heading() * Vector3::new(command.forward, command.left, 0.0);
        let kept = (-pulled.time_s / (pulled.mass_kg * c)).exp();
        let towards = asked.xy() + c * Vector2::from(pulled.force);
        let velocity = towards + kept * (Vector2::from(self.velocity) - towards);
        self.velocity = velocity.cap_magnitude(limit_m_s.max(asked.norm())).into();
    }

    /// Adds what a push has changed the robot's velocity by, world frame [m/s].
    pub fn push(&mut self, change: Vector3<f64>) {
        self.velocity = [self.velocity[0] + change.x, self.velocity[1] + change.y];
    }

    /// Returns the command with the virtual mass's velocity, in the robot's heading, in place of the commanded one.
    pub fn command(&self, state: &RobotState, command: &Command) -> Command {
        let velocity = state.heading().inverse() * Vector3::new(self.velocity[0], self.velocity[1], 0.0);
        Command { forward: velocity.x, left: velocity.y, ..*command }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    const MASS_KG: f64 = 12.5;
    const STEP_S: f64 = 1.0 / 60.0;

    /// Upright, with this yaw.
    fn turned(yaw: f64) -> RobotState {
        RobotState { world_from_base: UnitQuaternion::from_euler_angles(0.0, 0.0, yaw), ..RobotState::default() }
    }

    fn pulled(force: [f64; 2]) -> Pulled {
        Pulled { force, mass_kg: MASS_KG, time_s: STEP_S }
    }

    #[test]
    fn steady_pull_offsets_mass_by_force_times_compliance() {
        let command = Command::velocity(0.5, 0.0, 0.0);
        // It heads along the world's y, and is pulled along x: to its right.
        let state = turned(std::f64::consts::FRAC_PI_2);
        let mut mass = VirtualMass::default();
        (0..600).for_each(|_| mass.step(&state, &command, 0.02, pulled([10.0, 0.0]), 2.0));
        let reached = mass.command(&state, &command);
        assert!((reached.forward - 0.5).abs() < 1e-9 && (reached.left + 0.2).abs() < 1e-9, "{reached:?}");
        // The bound limits the speed: 0.5 and 10 · 0.1 m/s would be 1.118 m/s.
        (0..600).for_each(|_| mass.step(&state, &command, 0.1, pulled([10.0, 0.0]), 1.0));
        let reached = mass.command(&state, &command);
        assert!((reached.forward.hypot(reached.left) - 1.0).abs() < 1e-9, "{reached:?}");
    }

    #[test]
    fn a_push_decays_with_the_time_constant_mass_times_compliance() {
        let (state, command) = (turned(0.0), Command::default());
        let mut mass = VirtualMass::new(&state);
        mass.push(Vector3::new(0.0, 1.0, 0.0));
        // 12.5 kg · 0.04 m/s/N = 0.5 s = 30 steps, whatever the steps' length.
        (0..30).for_each(|_| mass.step(&state, &command, 0.04, pulled([0.0; 2]), 2.0));
        assert!((mass.command(&state, &command).left - (-1.0_f64).exp()).abs() < 1e-12);
    }

    /// A robot that follows its command with its own compliance, pulled to the left for 10 s: its velocity at the end.
    fn led(c: f64, force_n: f64, bias: [f64; 2]) -> f64 {
        let outer_loop = OuterLoop { own_m_s_per_n: 0.01, limits_m_s: [1.0, 0.6], period_s: STEP_S };
        let (command, mut mass, mut low_pass) = (Command::velocity(0.5, 0.0, 0.0), VirtualMass::default(), [0.0; 2]);
        let mut state = turned(0.0);
        for _ in 0..600 {
            let mut asked = outer_loop.command(
                [state.velocity_in_base.x, state.velocity_in_base.y],
                &command,
                c,
                [0.0, bias[1]],
                &mut low_pass,
            );
            asked.left += bias[0];
            mass.step(&state, &asked, outer_loop.own_m_s_per_n, pulled([0.0, force_n]), 2.0);
            state.velocity_in_base = Vector3::new(mass.velocity[0], mass.velocity[1], 0.0);
        }
        state.velocity_in_base.y
    }

    #[test]
    fn an_outer_loop_makes_a_policys_own_compliance_any_other() {
        for c in [0.005, 0.01, 0.02, 0.05] {
            assert!((led(c, 10.0, [0.0; 2]) - 10.0 * c).abs() < 1e-4, "{c}");
        }
        // It leads by 0.8 · 0.5 m/s and no more; the policy itself yields by 30 · 0.01 m/s.
        assert!((led(0.05, 30.0, [0.0; 2]) - 0.7).abs() < 1e-4);
        // What the policy is off by is five times as much at five times its own compliance, unless it is known.
        assert!((led(0.05, 0.0, [0.02, 0.0]) - 0.1).abs() < 1e-4);
        assert!((led(0.05, 0.0, [0.02, 0.02]) - 0.02).abs() < 1e-4);
    }
}
