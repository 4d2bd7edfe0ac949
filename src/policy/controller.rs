//! What turns the robot's state into joint targets, once in a policy step.

use crate::observation::{Command, Observer};
use crate::robot::{Joints, RobotState};

/// What a controller keeps of the past.
#[derive(Debug, Clone, Default)]
pub struct ControllerState {
    /// What it has seen.
    pub observer: Observer,
    /// Steps so far.
    pub step: u64,
    /// The policy's order.
    pub last_action: Joints,
    /// Our order \[rad\].
    pub last_target: Joints,
    /// State of the low-pass of an outer loop, forward and left [m/s].
    pub led: [f64; 2],
}

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

    /// A copy of what it keeps of the past; none if it can only be played from the start.
    fn memory(&self) -> Option<ControllerState> {
        None
    }

    /// Goes on from a memory of its own kind; whoever gives one has to.
    fn recall(&mut self, _memory: &ControllerState) {}
}
