//! Inference: from the robot's state through observation and network to joint targets.

use std::borrow::Borrow;
use std::fmt;

use super::controller::Controller;
use super::onnx;
use crate::config::Config;
use crate::network::{PackedMlp, Scratch};
use crate::observation::{Command, Layout, LayoutError, ObservationInput, Observer, Privileged};
use crate::robot::{JOINTS, Joints, RobotState, joint_target};

/// The meaning of a network's output.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Meaning {
    /// Joint target = nominal pose + scale · output.
    OffsetFromNominal,
    /// Joint target = scale · output.
    JointAngle,
}

/// The map from network outputs to joint targets.
#[derive(Debug, Clone, PartialEq)]
pub struct JointPositionAction {
    /// Joint targets at action zero, in Supple's order \[rad\].
    pub nominal_pose: Joints,
    /// The meaning of the network's outputs.
    pub meaning: Meaning,
    /// Scale of each output, in the policy's order \[rad\].
    pub scale_rad: Joints,
    /// Limit of every output before it is scaled, ± `clip`.
    pub clip: f64,
}

/// A function from an observation, shape (length of the layout), to one output for each joint.
pub type Function = Box<dyn Fn(&[f32]) -> [f32; JOINTS] + Send + Sync>;

/// A network of Supple, of an ONNX file, or of the calling program.
pub enum Network {
    /// The network of a policy file.
    Mlp(PackedMlp),
    /// The network of an ONNX file.
    Onnx(onnx::OnnxNetwork),
    /// A function of the calling program.
    Function(Function),
}

impl fmt::Debug for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Network::Mlp(mlp) => f.debug_tuple("Mlp").field(mlp).finish(),
            Network::Onnx(network) => f.debug_tuple("Onnx").field(network).finish(),
            Network::Function(_) => f.write_str("Function"),
        }
    }
}

/// A policy's map from states to joint targets: observation, network, action.
#[derive(Debug)]
pub struct Inference {
    /// The layout of the observation.
    pub layout: Layout,
    /// The map from outputs to joint targets.
    pub action: JointPositionAction,
    /// The network from normalised observation to outputs.
    pub network: Network,
    /// Duration of a policy step \[s\].
    pub period_s: f64,
}

/// Buffers of a network; each thread needs its own.
#[derive(Debug, Default)]
pub struct InferenceBuffers {
    output: Vec<f32>,
    mlp: Scratch,
    onnx: onnx::OnnxScratch,
}

impl Network {
    /// Evaluates rows of normalised observations, and returns one output for each joint, shape (rows, joints).
    fn forward<'a>(&self, rows: usize, seen: &[f32], buffers: &'a mut InferenceBuffers) -> &'a [f32] {
        let InferenceBuffers { output, mlp: scratch, onnx } = buffers;
        output.resize(rows * JOINTS, 0.0);
        let length = seen.len() / rows.max(1);
        let each = seen.chunks_exact(length.max(1)).zip(output.chunks_exact_mut(JOINTS));
        match self {
            Network::Mlp(mlp) => mlp.forward(rows, seen, output, scratch),
            Network::Onnx(network) => each.for_each(|(seen, out)| out.copy_from_slice(network.forward(seen, onnx))),
            Network::Function(function) => each.for_each(|(seen, out)| out.copy_from_slice(&function(seen))),
        }
        output
    }
}

impl Inference {
    /// Creates the inference of a network trained in the environment of `config`: its inputs are the normalised
    /// observations, its outputs the environment's actions.
    ///
    /// # Errors
    /// The observation of the configuration does not fit its robot.
    pub fn in_environment(config: &Config, network: Network) -> Result<Self, LayoutError> {
        let (layout, nominal_pose) = (config.layout()?, config.action.nominal_pose_rad.joints());
        let period_s = config.simulation.policy_period_s();
        Ok(Self::new(layout, nominal_pose, config.action.scale_rad, network, period_s))
    }

    /// Creates the inference of a network whose outputs are offsets from the nominal pose, over a scale \[rad\].
    pub(super) fn new(layout: Layout, nominal_pose: Joints, scale_rad: f64, network: Network, period_s: f64) -> Self {
        let (meaning, scale_rad) = (Meaning::OffsetFromNominal, [scale_rad; JOINTS]);
        let action = JointPositionAction { nominal_pose, meaning, scale_rad, clip: f64::INFINITY };
        Inference { layout, action, network, period_s }
    }

    /// Returns the clipped outputs, shape (rows, joints), in the policy's order, for normalised observations, shape
    /// (rows, length of the layout). Each row has the same bits as when it is evaluated alone.
    ///
    /// # Panics
    /// `seen` has another shape.
    pub fn actions(&self, rows: usize, seen: &[f32], buffers: &mut InferenceBuffers) -> Vec<f32> {
        let clip = self.action.clip as f32;
        self.network.forward(rows, seen, buffers).iter().map(|output| output.clamp(-clip, clip)).collect()
    }

    /// Returns the clipped outputs, in the policy's order, and their joint targets, in Supple's order \[rad\].
    pub fn act(&self, seen: &[f32], buffers: &mut InferenceBuffers) -> (Joints, Joints) {
        let output = self.network.forward(1, seen, buffers);
        let JointPositionAction { nominal_pose, meaning, scale_rad, clip } = &self.action;
        let (mut actions, mut targets) = ([0.0; JOINTS], [0.0; JOINTS]);
        for (index, joint) in self.layout.order().iter().enumerate() {
            actions[index] = f64::from(output[index]).clamp(-clip, *clip);
            let offset = match meaning {
                Meaning::OffsetFromNominal => nominal_pose[*joint],
                Meaning::JointAngle => 0.0,
            };
            targets[*joint] = joint_target(offset, scale_rad[index], actions[index]);
        }
        (actions, targets)
    }

    /// Returns the joint targets \[rad\], in Supple's order, for an observation in physical units, shape (length of the layout).
    ///
    /// # Panics
    /// The observation has another length.
    pub fn joint_targets(&self, observation: &[f64], buffers: &mut InferenceBuffers) -> Joints {
        let normalised = |(k, raw): (usize, &f64)| self.layout.normalised(k, *raw);
        let seen: Vec<f32> = observation.iter().enumerate().map(normalised).collect();
        self.act(&seen, buffers).1
    }

    /// Returns a controller of one robot.
    pub fn controller(&self) -> PolicyController<&Inference> {
        PolicyController::new(self)
    }
}

/// The past of one robot that a policy observes.
#[derive(Debug, Clone, Default)]
struct ObservedPast {
    observer: Observer,
    /// The number of policy steps so far.
    step: u64,
    /// The last outputs of the network, clipped, in the policy's order.
    last_action: Joints,
    /// The last joint targets, in Supple's order \[rad\].
    last_target: Joints,
}

/// A policy that controls one robot, with the history that its observation needs (section III-A).
#[derive(Debug)]
pub struct PolicyController<I> {
    inference: I,
    past: ObservedPast,
    seen: Vec<f32>,
    buffers: InferenceBuffers,
}

impl<I: Borrow<Inference>> PolicyController<I> {
    /// Creates a controller from a borrowed or shared inference.
    pub fn new(inference: I) -> Self {
        let Inference { layout, action, .. } = inference.borrow();
        let past = ObservedPast { last_target: action.nominal_pose, ..ObservedPast::default() };
        PolicyController { past, seen: vec![0.0; layout.length()], buffers: InferenceBuffers::default(), inference }
    }

    /// Returns the normalised observation of the last step.
    pub fn seen(&self) -> &[f32] {
        &self.seen
    }
}

impl<I: Borrow<Inference> + Send> Controller for PolicyController<I> {
    fn rest(&self) -> Joints {
        self.inference.borrow().action.nominal_pose
    }

    fn begin(&mut self, _: &RobotState) {
        self.past = ObservedPast { last_target: self.rest(), ..ObservedPast::default() };
    }

    fn joint_targets(&mut self, state: &RobotState, command: &Command) -> Joints {
        let inference: &Inference = self.inference.borrow();
        let layout = &inference.layout;
        let ObservedPast { observer, step, last_action, last_target } = &mut self.past;
        let (nominal, time_s) = (&inference.action.nominal_pose, *step as f64 * inference.period_s);
        let privileged = Privileged::default();
        let now = ObservationInput { state, command, last_action, last_target, nominal, time_s, privileged };
        observer.measure(layout, &now);
        observer.normalised(layout, &mut self.seen);
        (*last_action, *last_target) = inference.act(&self.seen, &mut self.buffers);
        *step += 1;
        *last_target
    }

    fn needs_felt_force(&self) -> bool {
        self.inference.borrow().layout.blocks().iter().any(|block| block.quantity.is_felt())
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use nalgebra::Vector3;

    use super::*;
    use crate::policy::Agent;

    fn state(time: f64) -> RobotState {
        RobotState {
            height: 0.3,
            velocity_in_base: Vector3::new(0.25 + time, 0.125, 9.0),
            gravity_in_base: Vector3::new(0.0, 0.0, -9.81),
            joint_angles: std::array::from_fn(|joint| joint as f64 + 100.0 * time),
            ..RobotState::default()
        }
    }

    /// A description of 48 numbers for the fixture's network, twice 24.
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
    fn a_function_acts_as_a_network_does_and_each_row_as_alone() {
        let config = Config::load("fast").unwrap();
        let function: Function = Box::new(|seen| std::array::from_fn(|joint| seen[0] + joint as f32));
        let inference = Inference::in_environment(&config, Network::Function(function)).unwrap();
        let length = inference.layout.length();
        let mut seen = vec![0.0; 2 * length];
        seen[length] = 100.0;
        let actions = inference.actions(2, &seen, &mut InferenceBuffers::default());
        assert_eq!((actions[1], actions[JOINTS + 2]), (1.0, 102.0));
        let (alone, targets) = inference.act(&seen[length..], &mut InferenceBuffers::default());
        assert_eq!((alone[2], targets[2]), (102.0, -1.44 + 0.3 * 102.0));
    }

    #[test]
    fn an_observation_is_in_the_order_axes_scales_and_ages_of_its_description() {
        let folder = tempfile::tempdir().unwrap();
        let network = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/onnx/rsl_rl.onnx");
        std::fs::copy(network, folder.path().join("rsl_rl.onnx")).unwrap();
        std::fs::write(folder.path().join("p.yaml"), SPEC).unwrap();
        let agent = Agent::load(&folder.path().join("p.yaml")).unwrap();
        let inference = agent.inference();
        let mut controller = inference.controller();
        controller.begin(&state(0.0));
        let command = Command::velocity(1.0, 2.0, 0.5);
        controller.joint_targets(&state(0.0), &command);
        let first = controller.seen().to_vec();
        // Before the first step, the history holds its state.
        assert_eq!(first[..24], first[24..]);
        // FL before FR; 2 · 0.125; 2 · (−0.25 − 1) = −2.5; sin 0, sin π/2; down is 1, twice.
        assert_eq!(first[..6], [3.0, 4.0, 5.0, 0.0, 1.0, 2.0]);
        assert_eq!(first[12..16], [0.25, -2.5, 0.5, 0.0]);
        assert!((first[16] - 1.0).abs() < 1e-6);
        assert_eq!(first[17..24], [1.0, 1.0, 5.0, 6.0, 7.0, 8.0, 9.0]);

        let targets = controller.joint_targets(&state(1.0), &command);
        let second = controller.seen().to_vec();
        assert_eq!(second[..24], first[24..]);
        assert_eq!(second[24..27], [103.0, 104.0, 105.0]);
        // 2 · (−1.25 − 1) = −4.5, clipped to −3; a quarter of a period at 12.5 Hz and 50 Hz: sin π/2, sin π.
        assert_eq!(second[37], -3.0);
        assert!((second[39] - 1.0).abs() < 1e-6 && second[40].abs() < 1e-6);
        // Outputs are clipped to ±1 and scaled to ±0.25 about the nominal pose, in our order.
        for (index, joint) in inference.layout.order().iter().enumerate() {
            let expected = inference.action.nominal_pose[*joint] + 0.25 * controller.past.last_action[index];
            assert_eq!(targets[*joint], expected);
            assert!(controller.past.last_action[index].abs() <= 1.0);
        }
        assert_eq!(inference.action.nominal_pose[..6], [-0.1, 0.8, -1.5, 0.1, 0.8, -1.5]);
    }
}
