//! A policy from elsewhere at work: observation in, joint targets out, with the history that it needs.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use super::{Block, ForeignPolicy, Meaning, Quantity};
use crate::go1::{JOINT_COUNT, Joints, RobotState};
use crate::onnx::Scratch;
use crate::scenario::Controller;
use crate::task::Command;

/// The controller of one robot.
#[derive(Debug)]
pub struct ForeignController<'a> {
    policy: &'a ForeignPolicy,
    /// For each block, its scaled values: now first, then one step ago, and so on.
    past: Vec<VecDeque<Vec<f32>>>,
    step: u64,
    /// The policy's order.
    last_action: Joints,
    /// Our order.
    last_target: Joints,
    scratch: Scratch,
}

impl ForeignPolicy {
    /// The policy as a controller of one robot.
    pub fn controller(&self) -> ForeignController<'_> {
        ForeignController {
            policy: self,
            past: vec![VecDeque::new(); self.observation.len()],
            step: 0,
            last_action: [0.0; JOINT_COUNT],
            last_target: self.nominal_pose,
            scratch: Scratch::default(),
        }
    }

    /// Longest age that any block needs.
    fn oldest(&self) -> usize {
        let largest = |ages: &[u32]| ages.iter().copied().max().unwrap_or(0) as usize;
        let of_blocks = self.observation.iter().map(|block| largest(&block.steps_ago)).max().unwrap_or(0);
        of_blocks + largest(&self.history)
    }
}

impl ForeignController<'_> {
    /// A block's numbers now, scaled and clipped.
    fn measure(&self, block: &Block, state: &RobotState, command: &Command) -> Vec<f32> {
        let policy = self.policy;
        let in_order = |joints: &Joints| policy.order.map(|joint| joints[joint]).to_vec();
        let vector = |xyz: [f64; 3]| block.axes.iter().map(|(axis, sign)| sign * xyz[*axis]).collect();
        let time_s = self.step as f64 * policy.period_s;
        let clock = |wave: fn(f64) -> f64| {
            block.values.iter().map(|phase| wave(TAU * (block.frequency_hz * time_s + phase).fract())).collect()
        };
        let raw: Vec<f64> = match block.quantity {
            Quantity::BaseHeight => vec![state.height],
            Quantity::Gravity => vector(state.gravity_in_base.into()),
            Quantity::ProjectedGravity => vector(state.gravity_in_base.normalize().into()),
            Quantity::JointAngles => in_order(&state.joint_angles),
            Quantity::JointOffsets => {
                in_order(&std::array::from_fn(|joint| state.joint_angles[joint] - policy.nominal_pose[joint]))
            }
            Quantity::JointRates => in_order(&state.joint_rates),
            Quantity::BaseVelocity => vector(state.velocity_in_base.into()),
            Quantity::AngularVelocity => vector(state.angular_velocity_in_base.into()),
            Quantity::LastAction => self.last_action.to_vec(),
            Quantity::LastTarget => in_order(&self.last_target),
            Quantity::Command => vector([command.forward, command.left, command.yaw]),
            Quantity::ClockSin => clock(f64::sin),
            Quantity::ClockCos => clock(f64::cos),
            Quantity::Constant => block.values.clone(),
        };
        let clip = block.clip.min(policy.observation_clip);
        let scaled = raw.iter().zip(&block.offset).zip(&block.scale);
        scaled.map(|((value, offset), scale)| ((value - offset) * scale).clamp(-clip, clip) as f32).collect()
    }

    /// Takes note of now. Before the first step, everything was as it is in it.
    fn remember(&mut self, state: &RobotState, command: &Command) {
        let length = self.policy.oldest() + 1;
        for index in 0..self.past.len() {
            let now = self.measure(&self.policy.observation[index], state, command);
            let past = &mut self.past[index];
            past.push_front(now.clone());
            past.truncate(length);
            past.resize(length, now);
        }
    }

    fn observation(&self) -> Vec<f32> {
        let mut observation = Vec::with_capacity(self.policy.network.inputs());
        for frame in &self.policy.history {
            for (block, past) in self.policy.observation.iter().zip(&self.past) {
                for age in &block.steps_ago {
                    observation.extend(&past[(frame + age) as usize]);
                }
            }
        }
        observation
    }
}

impl Controller for ForeignController<'_> {
    fn rest(&self) -> Joints {
        self.policy.nominal_pose
    }

    fn begin(&mut self, _: &RobotState) {
        self.past.iter_mut().for_each(VecDeque::clear);
        self.step = 0;
        self.last_action = [0.0; JOINT_COUNT];
        self.last_target = self.policy.nominal_pose;
    }

    fn joint_targets(&mut self, state: &RobotState, command: &Command) -> Joints {
        self.remember(state, command);
        let observation = self.observation();
        let output = self.policy.network.forward(&observation, &mut self.scratch);
        let clip = self.policy.action_clip;
        for (action, value) in self.last_action.iter_mut().zip(output) {
            *action = f64::from(*value).clamp(-clip, clip);
        }
        for (index, joint) in self.policy.order.iter().enumerate() {
            let scaled = self.policy.action_scale[index] * self.last_action[index];
            self.last_target[*joint] = match self.policy.meaning {
                Meaning::OffsetFromNominal => self.policy.nominal_pose[*joint] + scaled,
                Meaning::JointAngle => scaled,
            };
        }
        self.step += 1;
        self.last_target
    }
}
