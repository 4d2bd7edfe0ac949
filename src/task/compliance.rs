/*! Compliance as a command: the motion that is asked of a robot that somebody has hold of.

On the horizontal plane it is to move like a virtual mass with a virtual damper of 1/c to its commanded velocity:

`m v̇_ref = (v* − v_ref) / c + f`

with the robot's mass m, the commanded velocity v*, the commanded compliance c [m/s/N] and the force f of the hand. A steady
force offsets its velocity by c·f, a push decays with the time constant m·c, and with c = 0 there is no yielding. Gravity on
a slope is no hand.
*/

use std::collections::VecDeque;

use nalgebra::{UnitQuaternion, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::observation::Command;
use crate::robot::RobotState;

/// `v_ref − v*` of a virtual mass, world frame, horizontal [m/s].
type Offset = [f64; 2];

/// What a robot is to track: a virtual mass that began with the episode, and others that began with the robot's own velocity
/// some steps ago. The first says where to be in the long run, but a robot that does not yield yet is far from it; the others
/// stay near, and say which way to go.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct VirtualMasses {
    free: Offset,
    /// Newest first: the one at `k` began `k + 1` steps ago.
    begun: VecDeque<Offset>,
}

impl VirtualMasses {
    /// The free one begins with the robot as it is.
    pub fn new(state: &RobotState, command: &Command) -> Self {
        let off = state.velocity_in_world() - asked(state, command);
        VirtualMasses { free: [off.x, off.y], begun: VecDeque::new() }
    }

    /// Another one begins with the velocity of the robot as it is before a step; those older than `longest` steps end.
    pub fn begin(&mut self, state: &RobotState, command: &Command, longest: usize) {
        let off = state.velocity_in_world() - asked(state, command);
        self.begun.push_front([off.x, off.y]);
        self.begun.truncate(longest);
    }

    /// Lets a force act on all of them for a while, the exact solution; they get no faster than `limit_m_s`.
    pub fn step(&mut self, state: &RobotState, command: &Command, pull: Pulled, limit_m_s: f64) {
        let c = command.compliance;
        let kept = if c > 0.0 { (-pull.time_s / (pull.mass_kg * c)).exp() } else { 0.0 };
        let asked = asked(state, command);
        for offset in std::iter::once(&mut self.free).chain(&mut self.begun) {
            let led = |axis: usize| asked[axis] + kept * offset[axis] + (1.0 - kept) * c * pull.force[axis];
            let velocity = Vector2::new(led(0), led(1)).cap_magnitude(limit_m_s.max(asked.norm()));
            *offset = (velocity - asked.xy()).into();
        }
    }

    /// Adds what a push has changed the robot's velocity by, world frame [m/s].
    pub fn push(&mut self, change: Vector3<f64>) {
        for offset in std::iter::once(&mut self.free).chain(&mut self.begun) {
            *offset = [offset[0] + change.x, offset[1] + change.y];
        }
    }

    /// The velocities of the free one and of those that began so many steps ago, or with the episode, in place of the
    /// commanded one; in the robot's heading.
    pub fn commands(&self, state: &RobotState, command: &Command, steps_ago: &[usize]) -> Vec<Command> {
        let begun = steps_ago.iter().filter_map(|steps| self.begun.get(steps - 1).or(self.begun.back()));
        let of = |offset: &Offset| {
            let offset = heading(state).inverse() * Vector3::new(offset[0], offset[1], 0.0);
            Command { forward: command.forward + offset.x, left: command.left + offset.y, ..*command }
        };
        std::iter::once(&self.free).chain(begun).map(of).collect()
    }
}

/// The commanded velocity in the world [m/s].
fn asked(state: &RobotState, command: &Command) -> Vector3<f64> {
    heading(state) * Vector3::new(command.forward, command.left, 0.0)
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

fn heading(state: &RobotState) -> UnitQuaternion<f64> {
    let (_, _, yaw) = state.roll_pitch_yaw();
    UnitQuaternion::from_euler_angles(0.0, 0.0, yaw)
}
