//! What turns the robot's state into joint targets, once in a policy step.

use crate::observation::Command;
use crate::robot::{Joints, RobotState};

/// A controller under test: a trained policy, an external one, or a hand-written gait.
///
/// It can go to another thread. It sees states as a robot's sensing would give them and keeps what it needs of the past itself.
pub trait Controller: Send {
    /// Joint targets that are held until the first step \[rad\].
    fn rest(&self) -> Joints;

    /// Forgets the past: the robot stands in `state`.
    fn begin(&mut self, state: &RobotState);

    /// Joint targets \[rad\] for the state now and what is asked for.
    fn joint_targets(&mut self, state: &RobotState, command: &Command) -> Joints;
}
