/*! Compliance as a command, for policies that track a velocity: how far they yield is measured once, and then commanded.

A policy that can be told its compliance is told. Around any other one goes an outer loop, which commands the velocity

`v* + (1 − C₀/c) · LP(v − v* − bias)`

of the measured velocity v, LP being a low-pass, C₀ the compliance that the policy has by itself, and the bias what its
velocity is off by undisturbed: a pull f moves the robot by C₀ f from what it is commanded, so that in all it yields by c f.
Either way, what a setting comes to has been measured, and the setting is chosen that gives what is commanded.
*/

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use super::controller::Controller;
use crate::observation::Command;
use crate::robot::{Joints, RobotState};

/// Time constant of the low-pass: it takes out the gait \[s\].
const SMOOTHING_S: f64 = 0.1;

/// Fastest walk that the outer loop asks for, unless the command is faster [m/s].
const SPEED_LIMIT_M_S: f64 = 1.0;

/// What a policy does when it is pulled.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Identity of the policy: SHA-256 of its files.
    pub sha256: String,
    /// Compliance by itself, `C₀` [m/s/N].
    pub own_m_s_per_n: f64,
    /// What the velocity is off by undisturbed, forward and left [m/s], as a constant and the factors of the commanded
    /// forward [m/s], left [m/s] and yaw rate [rad/s].
    pub bias: [[f64; 4]; 2],
    /// What settings come to, both rising.
    pub points: Vec<Point>,
}

/// A setting and what it comes to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Point {
    /// `c` of the outer loop, or of the policy's own input [m/s/N].
    pub setting: f64,
    /// Measured: mean over directions [m/s/N].
    pub measured: f64,
}

/// A compliance that a policy cannot give.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("a compliance of {found} m/s/N is beyond this policy: it can be told {low:.4} to {high:.4} m/s/N")]
pub struct OutOfReach {
    found: f64,
    low: f64,
    high: f64,
}

impl Calibration {
    /// The setting that gives a compliance [m/s/N].
    ///
    /// # Errors
    /// [`OutOfReach`]
    pub fn setting(&self, compliance: f64) -> Result<f64, OutOfReach> {
        let between = |pair: &[Point]| {
            let [a, b] = [pair[0], pair[1]];
            let part = (compliance - a.measured) / (b.measured - a.measured);
            (0.0..=1.0).contains(&part).then_some(a.setting + part * (b.setting - a.setting))
        };
        self.points.windows(2).find_map(between).ok_or_else(|| {
            let measured = |point: Option<&Point>| point.map_or(f64::NAN, |point| point.measured);
            OutOfReach { found: compliance, low: measured(self.points.first()), high: measured(self.points.last()) }
        })
    }

    /// What the velocity is off by undisturbed, forward and left [m/s].
    fn bias(&self, command: &Command) -> Vector2<f64> {
        let of = |[constant, forward, left, yaw]: [f64; 4]| {
            constant + forward * command.forward + left * command.left + yaw * command.yaw
        };
        Vector2::new(of(self.bias[0]), of(self.bias[1]))
    }
}

/// An outer loop around a controller that tracks velocities.
pub struct OuterLoop<'a> {
    inner: Box<dyn Controller + 'a>,
    calibration: &'a Calibration,
    /// `LP(v − v* − bias)`, forward and left [m/s].
    led: Vector2<f64>,
    /// Part of the difference that the low-pass takes over in a step.
    step: f64,
}

impl<'a> OuterLoop<'a> {
    /// Around a controller that is asked every `period_s`; the command's compliance is the setting `c`.
    pub fn new(inner: Box<dyn Controller + 'a>, calibration: &'a Calibration, period_s: f64) -> Self {
        OuterLoop { inner, calibration, led: Vector2::zeros(), step: 1.0 - (-period_s / SMOOTHING_S).exp() }
    }

    /// What the controller is commanded.
    fn yielding(&mut self, state: &RobotState, command: &Command) -> Command {
        if command.compliance <= 0.0 {
            return *command;
        }
        let asked = Vector2::new(command.forward, command.left);
        let off = state.velocity_in_base.xy() - asked - self.calibration.bias(command);
        self.led += self.step * (off - self.led);
        let gain = 1.0 - self.calibration.own_m_s_per_n / command.compliance;
        let led = (asked + gain * self.led).cap_magnitude(SPEED_LIMIT_M_S.max(asked.norm()));
        Command { forward: led.x, left: led.y, ..*command }
    }
}

impl Controller for OuterLoop<'_> {
    fn rest(&self) -> Joints {
        self.inner.rest()
    }

    fn begin(&mut self, state: &RobotState) {
        self.led = Vector2::zeros();
        self.inner.begin(state);
    }

    fn joint_targets(&mut self, state: &RobotState, command: &Command) -> Joints {
        let command = self.yielding(state, command);
        self.inner.joint_targets(state, &command)
    }
}
