//! What turns the robot's state into joint targets, once in a policy step.

use crate::go1::{Joints, RobotState};
use crate::policy::Policy;
use crate::ppo::Scratch;
use crate::task::Command;
use crate::task::observation::{self, Reduced};

/// A controller under test: a trained policy, one from elsewhere, or a hand-written gait.
///
/// It sees states as a robot's sensing would give them and keeps what it needs of the past itself.
pub trait Controller {
    /// Joint targets that are held until the first step \[rad\].
    fn rest(&self) -> Joints;

    /// Forgets the past: the robot stands in `state`.
    fn begin(&mut self, state: &RobotState);

    /// Joint targets \[rad\] for the state now and what is asked for.
    fn joint_targets(&mut self, state: &RobotState, command: &Command) -> Joints;
}

/// A policy of ours with the history that its observation needs (section III-A).
#[derive(Debug)]
pub struct PolicyController<'a> {
    policy: &'a Policy,
    previous: Reduced,
    last_target: Joints,
    scratch: Scratch,
}

impl Policy {
    /// The policy as a controller of one robot.
    pub fn controller(&self) -> PolicyController<'_> {
        PolicyController {
            policy: self,
            previous: [0.0; observation::REDUCED_LENGTH],
            last_target: self.nominal_pose,
            scratch: Scratch::default(),
        }
    }
}

impl Controller for PolicyController<'_> {
    fn rest(&self) -> Joints {
        self.policy.nominal_pose
    }

    fn begin(&mut self, state: &RobotState) {
        self.previous = observation::reduced(state);
        self.last_target = self.rest();
    }

    fn joint_targets(&mut self, state: &RobotState, command: &Command) -> Joints {
        let current = observation::reduced(state);
        let seen = observation::pack(&self.previous, &self.last_target, &current, command);
        self.previous = current;
        self.last_target = self.policy.joint_targets(&seen, &mut self.scratch);
        self.last_target
    }
}
