//! The interface of controllers, which turn the robot's state into joint targets once per policy step.

use crate::observation::Command;
use crate::robot::{Joints, RobotState};

/// A controller under test: a trained policy, an external one, or a hand-written gait.
///
/// A controller can be sent to another thread. It receives states as a robot's sensors would give them, and stores
/// what it needs of the past.
pub trait Controller: Send {
    /// Returns the joint targets that are held until the first step \[rad\].
    fn rest(&self) -> Joints;

    /// Resets the controller for a robot that stands in `state`.
    fn begin(&mut self, state: &RobotState);

    /// Returns the joint targets \[rad\] for the present state and command.
    fn joint_targets(&mut self, state: &RobotState, command: &Command) -> Joints;

    /// Returns true if the controller reads [`RobotState::felt_force`]: a playback then observes that force.
    fn needs_felt_force(&self) -> bool {
        false
    }
}
