/*! Compliance as a command: how a robot that somebody has hold of is to move, and how one that tracks velocities does.

On the horizontal plane it is to move like a virtual mass with a virtual damper of 1/c to its commanded velocity,

`m v̇_ref = (v* − v_ref) / c + f`

with the robot's mass m, the commanded velocity v*, the commanded compliance c [m/s/N] and the force f of the hand. A steady
force offsets its velocity by c·f, and a push decays with the time constant m·c. Gravity on a slope is no hand.

A policy that tracks velocities yields a little by itself, by `C₀`, its own compliance. An outer loop around it makes that any
c: it commands the velocity

`v* + (1 − C₀/c) · LP(v − v* − bias)`

of the measured velocity v, LP being a low-pass and the bias what the policy's velocity is off by undisturbed. Softer than C₀,
the command goes with the hand; stiffer, it goes against it.
*/

use nalgebra::{UnitQuaternion, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::observation::Command;
use crate::robot::RobotState;

/// Time constant of the low-pass, which takes out the gait \[s\].
const SMOOTHING_S: f64 = 0.1;

/// What the outer loop knows of a policy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OuterLoop {
    /// `C₀` [m/s/N].
    pub own_m_s_per_n: f64,
    /// Fastest walk that it asks for, forward and left, unless the command is faster [m/s].
    pub limits_m_s: [f64; 2],
    /// Between two policy steps \[s\].
    pub period_s: f64,
}

impl OuterLoop {
    /// What to command of a policy that is to walk at `command` and yield by `c` [m/s/N]. `led` is the state of the
    /// low-pass, zero at first, forward and left; so is the bias [m/s].
    pub fn command(
        &self,
        state: &RobotState,
        command: &Command,
        c: f64,
        bias: [f64; 2],
        led: &mut [f64; 2],
    ) -> Command {
        let step = 1.0 - (-self.period_s / SMOOTHING_S).exp();
        let gain = 1.0 - self.own_m_s_per_n / c;
        let asked = [command.forward, command.left];
        let velocity: [f64; 2] = std::array::from_fn(|axis| {
            let off = state.velocity_in_base[axis] - asked[axis] - bias[axis];
            led[axis] += step * (off - led[axis]);
            let limit = self.limits_m_s[axis].max(asked[axis].abs());
            (asked[axis] + gain * led[axis]).clamp(-limit, limit)
        });
        Command { forward: velocity[0], left: velocity[1], ..*command }
    }
}

/// A virtual mass.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct VirtualMass {
    /// `v_ref`, world frame, horizontal [m/s].
    velocity: [f64; 2],
}

/// What acts on a virtual mass for a while.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pulled {
    /// World frame, horizontal \[N\].
    pub force: [f64; 2],
    /// Of the robot \[kg\].
    pub mass_kg: f64,
    /// How long \[s\].
    pub time_s: f64,
}

impl VirtualMass {
    /// As fast as a robot is.
    pub fn of(state: &RobotState) -> Self {
        let velocity = state.velocity_in_world();
        VirtualMass { velocity: [velocity.x, velocity.y] }
    }

    /// Lets a force act on it for a while, with a damper of `1/c` to the command: the exact solution. It gets no faster than
    /// `limit_m_s`, unless the command is.
    pub fn step(&mut self, state: &RobotState, command: &Command, c: f64, pulled: Pulled, limit_m_s: f64) {
        let asked = heading(state) * Vector3::new(command.forward, command.left, 0.0);
        let kept = (-pulled.time_s / (pulled.mass_kg * c)).exp();
        let towards = asked.xy() + c * Vector2::from(pulled.force);
        let velocity = towards + kept * (Vector2::from(self.velocity) - towards);
        self.velocity = velocity.cap_magnitude(limit_m_s.max(asked.norm())).into();
    }

    /// Adds what a push has changed the robot's velocity by, world frame [m/s].
    pub fn push(&mut self, change: Vector3<f64>) {
        self.velocity = [self.velocity[0] + change.x, self.velocity[1] + change.y];
    }

    /// Its velocity in the robot's heading, in place of the commanded one.
    pub fn command(&self, state: &RobotState, command: &Command) -> Command {
        let velocity = heading(state).inverse() * Vector3::new(self.velocity[0], self.velocity[1], 0.0);
        Command { forward: velocity.x, left: velocity.y, ..*command }
    }
}

fn heading(state: &RobotState) -> UnitQuaternion<f64> {
    let (_, _, yaw) = state.roll_pitch_yaw();
    UnitQuaternion::from_euler_angles(0.0, 0.0, yaw)
}
