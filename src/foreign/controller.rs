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
            past: vec![VecDeque::new(); self.parts.observation.len()],
            step: 0,
            last_action: [0.0; JOINT_COUNT],
            last_target: self.parts.nominal_pose,
            scratch: Scratch::default(),
        }
    }

    /// Longest age that any block needs.
    fn oldest(&self) -> usize {
        let largest = |ages: &[u32]| ages.iter().copied().max().unwrap_or(0) as usize;
        let of_blocks = self.parts.observation.iter().map(|block| largest(&block.steps_ago)).max().unwrap_or(0);
        of_blocks + largest(&self.parts.history)
    }
}

impl ForeignController<'_> {
    /// A block's numbers now, scaled and clipped.
    fn measure(&self, block: &Block, state: &RobotState, command: &Command) -> Vec<f32> {
        let policy = self.policy;
        let in_order = |joints: &Joints| policy.parts.order.map(|joint| joints[joint]).to_vec();
        let vector = |xyz: [f64; 3]| block.axes.iter().map(|(axis, sign)| sign * xyz[*axis]).collect();
        let time_s = self.step as f64 * policy.parts.config.simulation.policy_period_s();
        let clock = |wave: fn(f64) -> f64| {
            block.values.iter().map(|phase| wave(TAU * (block.frequency_hz * time_s + phase).fract())).collect()
        };
        let raw: Vec<f64> = match block.quantity {
            Quantity::BaseHeight => vec![state.height],
            Quantity::Gravity => vector(state.gravity_in_base.into()),
            Quantity::ProjectedGravity => vector(state.gravity_in_base.normalize().into()),
            Quantity::JointAngles => in_order(&state.joint_angles),
            Quantity::JointOffsets => {
                in_order(&std::array::from_fn(|joint| state.joint_angles[joint] - policy.parts.nominal_pose[joint]))
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
        let clip = block.clip.min(policy.parts.observation_clip);
        let scaled = raw.iter().zip(&block.offset).zip(&block.scale);
        scaled.map(|((value, offset), scale)| ((value - offset) * scale).clamp(-clip, clip) as f32).collect()
    }

    /// Takes note of now. Before the first step, everything was as it is in it.
    fn remember(&mut self, state: &RobotState, command: &Command) {
        let length = self.policy.oldest() + 1;
        for index in 0..self.past.len() {
            let now = self.measure(&self.policy.parts.observation[index], state, command);
            let past = &mut self.past[index];
            past.push_front(now.clone());
            past.truncate(length);
            past.resize(length, now);
        }
    }

    fn observation(&self) -> Vec<f32> {
        let mut observation = Vec::with_capacity(self.policy.network.inputs());
        for frame in &self.policy.parts.history {
            for (block, past) in self.policy.parts.observation.iter().zip(&self.past) {
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
        self.policy.parts.nominal_pose
    }

    fn begin(&mut self, _: &RobotState) {
        self.past.iter_mut().for_each(VecDeque::clear);
        self.step = 0;
        self.last_action = [0.0; JOINT_COUNT];
        self.last_target = self.policy.parts.nominal_pose;
    }

    fn joint_targets(&mut self, state: &RobotState, command: &Command) -> Joints {
        self.remember(state, command);
        let observation = self.observation();
        let output = self.policy.network.forward(&observation, &mut self.scratch);
        let clip = self.policy.parts.action_clip;
        for (action, value) in self.last_action.iter_mut().zip(output) {
            *action = f64::from(*value).clamp(-clip, clip);
        }
        for (index, joint) in self.policy.parts.order.iter().enumerate() {
            let scaled = self.policy.parts.action_scale[index] * self.last_action[index];
            self.last_target[*joint] = match self.policy.parts.meaning {
                Meaning::OffsetFromNominal => self.policy.parts.nominal_pose[*joint] + scaled,
                Meaning::JointAngle => scaled,
            };
        }
        self.step += 1;
        self.last_target
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::go1::FootState;
    use nalgebra::{UnitQuaternion, Vector3};
    use std::path::Path;

    fn state(time: f64) -> RobotState {
        RobotState {
            position: Vector3::zeros(),
            world_from_base: UnitQuaternion::identity(),
            height: 0.3,
            velocity_in_base: Vector3::new(0.25 + time, 0.125, 9.0),
            angular_velocity_in_base: Vector3::zeros(),
            gravity_in_base: Vector3::new(0.0, 0.0, -9.81),
            joint_angles: std::array::from_fn(|joint| joint as f64 + 100.0 * time),
            joint_rates: [0.0; JOINT_COUNT],
            feet: [FootState::default(); 4],
        }
    }

    /// 48 numbers for the fixture's network, twice 24.
    const SPEC: &str = "
onnx: rsl_rl.onnx
simulation: {physics_rate_hz: 200, policy_rate_hz: 50, kp_n_m_per_rad: 20.0, kd_n_m_s_per_rad: 0.5, latency_s: 0.0}
joints: [FL_hip, FL_thigh, FL_calf, FR_hip, FR_thigh, FR_calf, RL_hip, RL_thigh, RL_calf, RR_hip, RR_thigh, RR_calf]
nominal_pose_rad: [0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 1.0, -1.5, -0.1, 1.0, -1.5]
observation:
  - {quantity: joint_angles}
  - {quantity: base_velocity, elements: [left, backward], offset: [0.0, 1.0], scale: 2.0, clip: 3.0}
  - {quantity: command, elements: [yaw]}
  - {quantity: clock_sin, frequency_hz: 12.5, phases: [0.0, 0.25]}
  - {quantity: projected_gravity, elements: [down], steps_ago: [1, 0]}
  - {quantity: constant, values: [5, 6, 7, 8, 9]}
history: [1, 0]
action: {meaning: offset_from_nominal, scale_rad: 0.25, clip: 1.0}
";

    #[test]
    fn an_observation_is_in_the_order_axes_scales_and_ages_of_its_description() {
        let folder = tempfile::tempdir().unwrap();
        let network = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/onnx/rsl_rl.onnx");
        std::fs::copy(network, folder.path().join("rsl_rl.onnx")).unwrap();
        std::fs::write(folder.path().join("p.yaml"), SPEC).unwrap();
        let policy = ForeignPolicy::load(&folder.path().join("p.yaml")).unwrap();
        let mut controller = policy.controller();
        controller.begin(&state(0.0));
        let command = Command { forward: 1.0, left: 2.0, yaw: 0.5 };
        controller.joint_targets(&state(0.0), &command);
        let first = controller.observation();
        // Before the first step all was as it was then.
        assert_eq!(first[..24], first[24..]);
        // FL before FR; 2 · 0.125; 2 · (−0.25 − 1) = −2.5; sin 0, sin π/2; down is 1, twice.
        assert_eq!(first[..6], [3.0, 4.0, 5.0, 0.0, 1.0, 2.0]);
        assert_eq!(first[12..16], [0.25, -2.5, 0.5, 0.0]);
        assert!((first[16] - 1.0).abs() < 1e-6);
        assert_eq!(first[17..24], [1.0, 1.0, 5.0, 6.0, 7.0, 8.0, 9.0]);

        let targets = controller.joint_targets(&state(1.0), &command);
        let second = controller.observation();
        assert_eq!(second[..24], first[24..]);
        assert_eq!(second[24..27], [103.0, 104.0, 105.0]);
        // 2 · (−1.25 − 1) = −4.5, clipped to −3; a quarter of a period at 12.5 Hz and 50 Hz: sin π/2, sin π.
        assert_eq!(second[37], -3.0);
        assert!((second[39] - 1.0).abs() < 1e-6 && second[40].abs() < 1e-6);
        // Outputs are clipped to ±1 and scaled to ±0.25 about the nominal pose, in our order.
        for (index, joint) in policy.parts.order.iter().enumerate() {
            let expected = policy.nominal_pose()[*joint] + 0.25 * controller.last_action[index];
            assert_eq!(targets[*joint], expected);
            assert!(controller.last_action[index].abs() <= 1.0);
        }
        assert_eq!(policy.nominal_pose()[..6], [-0.1, 0.8, -1.5, 0.1, 0.8, -1.5]);
    }
}
