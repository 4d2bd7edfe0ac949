//! A simulated operator with the remote, who starts a scenario when the robot is ready.

use supple::task::Command;

use crate::remote::{Button, FullSticks, Remote};

/// Time for which a button is pressed, and after which it is pressed again if nothing happens \[s\].
const PRESSED_S: f64 = 0.2;
const AGAIN_S: f64 = 2.0;

/// Time for which the robot has to stand before the policy is started \[s\].
const STANDS_S: f64 = 1.0;

/// Base height, relative to the standing robot's, and tilt \[rad\] of a robot that stands.
const HIGH: f64 = 0.8;
const LEVEL_RAD: f64 = 0.3;

/// Presses START for the robot to stand up, A for the policy to begin, then keeps the sticks at the scenario's command.
pub struct Operator {
    sticks: Remote,
    /// Base height of the standing robot \[m\].
    standing_m: f64,
    since_s: f64,
    stands_since_s: Option<f64>,
    started: bool,
}

/// The state that the operator sees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sight {
    pub now_s: f64,
    pub height_m: f64,      // base height above the ground [m]
    pub tilt_rad: f64,      // angle between the trunk's up and the world's [rad]
    pub is_commanded: bool, // true if a client commands the motors
}

impl Operator {
    /// Creates an operator for a robot that stands at this height \[m\].
    pub fn new(command: &Command, full: FullSticks, standing_m: f64) -> Self {
        Operator { sticks: full.remote(command), standing_m, since_s: 0.0, stands_since_s: None, started: false }
    }

    /// Returns the remote now, and true once, when the scenario begins.
    pub fn act(&mut self, sight: &Sight) -> (Remote, bool) {
        if self.started {
            // A stays pressed for a moment.
            let remote = if sight.now_s - self.since_s < PRESSED_S { self.sticks.with(Button::A) } else { self.sticks };
            return (remote, false);
        }
        let stands = sight.is_commanded && sight.height_m > HIGH * self.standing_m && sight.tilt_rad < LEVEL_RAD;
        let since_s = *self.stands_since_s.get_or_insert(sight.now_s);
        if !stands {
            self.stands_since_s = None;
        } else if sight.now_s - since_s >= STANDS_S {
            (self.started, self.since_s) = (true, sight.now_s);
            return (self.sticks.with(Button::A), true);
        }
        let phase_s = sight.now_s.rem_euclid(AGAIN_S);
        let presses = sight.is_commanded && !stands && phase_s < PRESSED_S;
        (if presses { Remote::default().with(Button::Start) } else { Remote::default() }, false)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FULL: FullSticks = FullSticks([1.0, 0.5, 0.5]);

    #[test]
    fn scenario_begins_when_the_robot_has_stood_for_a_second() {
        let mut operator = Operator::new(&Command::velocity(0.5, 0.0, 0.0), FULL, 0.3);
        let sight = |now_s: f64, height_m: f64| Sight { now_s, height_m, tilt_rad: 0.0, is_commanded: true };
        let idle = Sight { is_commanded: false, ..sight(4.0, 0.1) };
        assert_eq!(operator.act(&idle), (Remote::default(), false));
        assert!(operator.act(&sight(4.1, 0.1)).0.is_pressed(Button::Start));
        assert!(!operator.act(&sight(4.5, 0.1)).0.is_pressed(Button::Start));
        assert!(!operator.act(&sight(5.0, 0.29)).1);
        assert!(!operator.act(&sight(5.9, 0.29)).1);
        let (remote, begins) = operator.act(&sight(6.01, 0.29));
        assert!(begins && remote.is_pressed(Button::A) && remote.left == [0.0, 0.5]);
        let (remote, begins) = operator.act(&sight(6.5, 0.29));
        assert!(!begins && !remote.is_pressed(Button::A) && remote.left == [0.0, 0.5]);
    }
}
