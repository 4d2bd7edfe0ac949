//! The checked YAML file of an external policy.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Deserialize;

use super::POLICY;
use crate::config::{Config, ConfigError, RobotModel, Simulation};
use crate::observation::{Layout, LayoutError, NominalValues, Numbers, Observed, Quantity, limit, numbers};
use crate::policy::AgentError;
use crate::policy::inference::{JointPositionAction, Meaning};
use crate::policy::onnx::OnnxNetwork;
use crate::robot::{JOINTS, Joints, Robot, joint_name, joint_names, recognise};
use crate::util::files::FileError;
use crate::util::yaml::{self, Text};

/// Largest excess of a nominal angle over its range that is taken for a rounding \[rad\].
const ROUNDING_RAD: f64 = 0.01;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawAction {
    meaning: Meaning,
    scale_rad: Numbers,
    clip: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawSpec {
    onnx: PathBuf,
    robot: Option<RobotModel>,
    simulation: Simulation,
    joints: Vec<String>,
    nominal_pose_rad: Vec<f64>,
    observation: Vec<Observed>,
    history: Option<Vec<u32>>,
    observation_clip: Option<f64>,
    /// The range of compliances that the network was trained to be commanded, if it observes them \[m/s/N\].
    compliance_m_s_per_n: Option<[f64; 2]>,
    action: RawAction,
}

/// A checked description, without the network.
#[derive(Debug)]
pub(super) struct Spec {
    pub(super) onnx: PathBuf,
    pub(super) layout: Layout,
    pub(super) action: JointPositionAction,
    /// Configuration with the robot, rates, gains and latency to run it with; the rest is that of the paper's
    /// configuration.
    pub(super) config: Config,
}

/// A fault in a description, or in the network that does not fit it.
#[derive(Debug, thiserror::Error)]
pub(super) enum SpecFault {
    #[error(transparent)]
    Observation(#[from] LayoutError),
    #[error(
        "compliance_m_s_per_n is {0:?}, expected the range trained if a commanded compliance is observed, else none"
    )]
    Compliance(Option<[f64; 2]>),
    #[error("nominal_pose_rad has {0} angles, expected {JOINTS}, in the order of `joints`")]
    Angles(usize),
    #[error("nominal_pose_rad is {0:?}, expected finite angles")]
    PoseNotFinite(Joints),
    #[error("nominal_pose_rad is {0:?}, expected angles of at most one turn")]
    Pose(Joints),
    #[error(
        "nominal_pose_rad has {joint} at {found} rad, expected {low:.3} to {high:.3} rad, the range of that joint of {robot}: \
         give the angles in the order of `joints`"
    )]
    PoseBeyondRange { joint: String, found: f64, low: f64, high: f64, robot: String },
    #[error("`joints` has '{found}', which is no joint of the robot; they are: {known}")]
    Joint { found: String, known: String },
    #[error("`joints` must name each of these once, in the policy's order: {}", joint_names().join(", "))]
    Joints,
    #[error(
        "its observation has {length} numbers ({parts}), but the input '{input}' of {onnx} takes {expected}",
        onnx = onnx.display()
    )]
    Inputs { length: usize, parts: String, input: String, onnx: PathBuf, expected: usize },
    #[error("{} has {found} outputs, expected one for each of {JOINTS} joints", onnx.display())]
    Outputs { onnx: PathBuf, found: usize },
}

impl Spec {
    /// Parses and checks the text of the file at `path`.
    pub(super) fn parse(path: &Path, text: &str) -> Result<Self, AgentError> {
        let name = path.display().to_string();
        let raw: RawSpec = yaml::layered(&[Text::new(&name, text)])
            .map_err(|error| FileError::of(POLICY, path)(error.without_name()))?;
        let mut config = Config::load("compliant")?;
        config.simulation = raw.simulation.clone();
        config.robot = raw.robot.clone().unwrap_or(config.robot);
        config.check().map_err(|error| ConfigError::Value { name, error })?;
        Ok(Self::new(raw, config, path.parent().unwrap_or(Path::new(""))).map_err(FileError::of(POLICY, path))?)
    }

    /// Checks a description in a folder, in which its robot may lie.
    fn new(raw: RawSpec, mut config: Config, folder: &Path) -> Result<Self, SpecFault> {
        let commanded = [Quantity::CommandedCompliance, Quantity::CommandedYield];
        let observes = raw.observation.iter().any(|observed| commanded.contains(&observed.quantity));
        let range = raw.compliance_m_s_per_n;
        let fits = range.map_or(!observes, |[low, high]| observes && 0.0 < low && low <= high && high <= 100.0);
        ensure!(fits, SpecFault::Compliance(range));
        config.reward.reference_m_s_per_n = range;
        let order = joint_order(&raw.joints, &config.robot, folder)?;
        let pose: Joints = raw.nominal_pose_rad.try_into().map_err(|pose: Vec<f64>| SpecFault::Angles(pose.len()))?;
        ensure!(pose.iter().all(|angle| angle.is_finite()), SpecFault::PoseNotFinite(pose));
        ensure!(pose.iter().all(|angle| angle.abs() <= std::f64::consts::TAU), SpecFault::Pose(pose));
        let mut nominal_pose = [0.0; JOINTS];
        for (place, angle) in order.iter().zip(pose) {
            nominal_pose[*place] = angle;
        }
        let scale = numbers("action.scale_rad", Some(&raw.action.scale_rad), JOINTS, 1.0)?;
        let action_scale_rad = std::array::from_fn(|joint| scale[joint]);
        let nominal = NominalValues { pose: nominal_pose, height_m: config.reward.base_height_m, action_scale_rad };
        let history = raw.history.unwrap_or_else(|| vec![0]);
        Ok(Spec {
            onnx: raw.onnx,
            layout: Layout::repeated(&raw.observation, &history, raw.observation_clip, order, &nominal)?,
            action: JointPositionAction {
                nominal_pose,
                meaning: raw.action.meaning,
                scale_rad: action_scale_rad,
                clip: limit("action.clip", raw.action.clip)?,
            },
            config,
        })
    }

    /// Checks that the network has as many inputs and outputs as the description states, and that the nominal pose is within the robot's
    /// joint ranges. A robot that cannot be read is not checked: the policy can still be inspected, or run on another one.
    pub(super) fn check(&self, network: &OnnxNetwork, folder: &Path) -> Result<(), SpecFault> {
        if let Ok(robot) = load_robot(&self.config.robot, folder) {
            self.check_pose(&robot)?;
        }
        let (length, onnx) = (self.layout.length(), self.onnx.clone());
        if length != network.inputs() {
            let blocks = self.layout.blocks().iter();
            let lengths: Vec<String> = blocks.map(|block| format!("{} {}", block.quantity, block.length())).collect();
            let times = self.layout.history().len();
            let times = if times == 1 { String::new() } else { format!(", {times} times") };
            let (parts, input) = (lengths.join(", ") + &times, network.input_name().to_owned());
            return Err(SpecFault::Inputs { length, parts, input, onnx, expected: network.inputs() });
        }
        ensure!(network.outputs() == JOINTS, SpecFault::Outputs { onnx, found: network.outputs() });
        Ok(())
    }

    /// Checks that each angle of the nominal pose is within the range of its joint.
    fn check_pose(&self, robot: &Robot) -> Result<(), SpecFault> {
        for joint in *self.layout.order() {
            let (found, [low, high]) = (self.action.nominal_pose[joint], robot.joint_limits[joint]);
            if !(low - ROUNDING_RAD..=high + ROUNDING_RAD).contains(&found) {
                let (joint, robot) = (joint_name(joint), robot.name.clone());
                return Err(SpecFault::PoseBeyondRange { joint, found, low, high, robot });
            }
        }
        Ok(())
    }
}

/// Loads the robot of a description in a folder, in which it may lie.
fn load_robot(robot: &RobotModel, folder: &Path) -> Result<Arc<Robot>, FileError> {
    let beside = folder.join(PathBuf::from(&robot.model));
    if Robot::ships(&robot.model) { robot.load() } else { Robot::load(&beside.display().to_string()) }
}

/// Returns the index in Supple's order of each of the policy's joints. Their names are Supple's, with or without `_joint`, usual ones of
/// other projects (`LF_HAA`, `fl_hx`), or those in the robot's file.
fn joint_order(names: &[String], robot: &RobotModel, folder: &Path) -> Result<[usize; JOINTS], SpecFault> {
    let known = joint_names();
    let place = |name: &String| {
        let short = name.strip_suffix("_joint").unwrap_or(name);
        known.iter().position(|known| known == short)
    };
    let words = || names.iter().map(String::as_str).collect::<Vec<_>>();
    let usual = || (names.len() == JOINTS).then(|| recognise(&words()).map(inverted)).flatten();
    let in_file = || {
        let robot = load_robot(robot, folder).ok()?;
        names.iter().map(|name| robot.joints_in_file.iter().position(|own| own == name)).collect::<Option<Vec<_>>>()
    };
    let ours = names.iter().map(place).collect::<Option<Vec<_>>>();
    let Some(order) = ours.or_else(|| usual().map(Vec::from)).or_else(in_file) else {
        let found = names.iter().find(|name| place(name).is_none()).map_or("", String::as_str);
        let own = load_robot(robot, folder)
            .map_or_else(|_| String::new(), |robot| format!("; {}", robot.joints_in_file.join(", ")));
        return Err(SpecFault::Joint { found: found.to_owned(), known: known.join(", ") + &own });
    };
    match <[usize; JOINTS]>::try_from(order) {
        Ok(order) if (0..JOINTS).all(|joint| order.contains(&joint)) => Ok(order),
        _ => Err(SpecFault::Joints),
    }
}

/// Returns the inverse of a permutation of the joints.
fn inverted(places: [usize; JOINTS]) -> [usize; JOINTS] {
    let mut order = [0; JOINTS];
    for (joint, place) in places.into_iter().enumerate() {
        order[place] = joint;
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::external::describe_network;
    use proptest::prelude::*;

    const EXAMPLE: &str = include_str!("../../../examples/policies/rsl_rl.yaml");

    #[test]
    fn a_network_of_the_training_environment_is_described_as_it_sees_and_acts() {
        let mut config = Config::load("go2").unwrap();
        config.robot.damping_n_m_s_per_rad = 0.5;
        config.reward.base_height_m = 0.29;
        config.action.scale_rad = 0.25;
        let text = describe_network("mine", &config, "net.onnx");
        let spec = Spec::parse(Path::new("net.yaml"), &text).unwrap();
        assert_eq!(spec.layout, config.layout().unwrap());
        assert_eq!((&spec.config.simulation, &spec.config.robot), (&config.simulation, &config.robot));
        let JointPositionAction { nominal_pose, meaning, scale_rad, clip } = spec.action;
        assert_eq!((nominal_pose[..3].to_vec(), meaning), (vec![0.0, 0.72, -1.44], Meaning::OffsetFromNominal));
        assert_eq!((scale_rad, clip), ([0.25; JOINTS], f64::INFINITY));
    }

    #[test]
    fn a_commanded_network_states_the_range_that_was_trained() {
        let text = describe_network("mine", &Config::load("configs/reference.yaml").unwrap(), "net.onnx");
        let parse = |text: &str| Spec::parse(Path::new("p.yaml"), text);
        assert_eq!(parse(&text).unwrap().config.reward.reference_m_s_per_n, Some([0.01, 0.1]));
        let unobserved = format!("{EXAMPLE}\ncompliance_m_s_per_n: [0.01, 0.1]\n");
        let [reversed, missing] = ["[0.1, 0.01]", "null"].map(|range| text.replace("[0.01, 0.1]", range));
        for text in [unobserved, reversed, missing] {
            let error = parse(&text).unwrap_err().to_string();
            assert!(error.contains("compliance_m_s_per_n is "), "{error}");
        }
    }

    #[test]
    fn a_file_names_its_robot_which_is_the_go1_without() {
        const PLAYGROUND: &str = include_str!("../../../examples/policies/playground.yaml");
        let robot = |line: &str| {
            let text = format!("{line}\n{PLAYGROUND}");
            Spec::parse(Path::new("test"), &text).map(|spec| spec.config.robot)
        };
        assert_eq!(robot("").unwrap(), Config::load("compliant").unwrap().robot);
        assert_eq!(robot("robot: {model: go2}").unwrap().model, "go2");
        let error = robot("robot: {model: go2, damping_n_m_s_per_rad: -1.0}").unwrap_err();
        assert!(error.to_string().contains("damping_n_m_s_per_rad"), "{error}");
    }

    #[test]
    fn joints_may_be_named_as_elsewhere() {
        let (before, rest) = EXAMPLE.split_once("\njoints:").unwrap();
        let (_, after) = rest.split_once(']').unwrap();
        let order = |names: &str| {
            let text = format!("{before}\njoints: [{names}]{after}");
            Spec::parse(Path::new("test"), &text).map(|spec| spec.action.nominal_pose)
        };
        let legs = |legs: [&str; 4], parts: [&str; 3]| {
            legs.iter().flat_map(|leg| parts.map(|part| format!("{leg}_{part}"))).collect::<Vec<_>>().join(", ")
        };
        let ours = order(&legs(["FL", "FR", "RL", "RR"], ["hip", "thigh", "calf"])).unwrap();
        assert_eq!(order(&legs(["LF", "RF", "LH", "RH"], ["HAA", "HFE", "KFE"])).unwrap(), ours);
        assert_eq!(order(&legs(["fl", "fr", "hl", "hr"], ["hx", "hy", "kn"])).unwrap(), ours);
        let error = order(&legs(["LF", "RF", "LH", "tail"], ["HAA", "HFE", "KFE"])).unwrap_err().to_string();
        assert!(error.contains("'LF_HAA'") && error.contains("FR_hip"), "{error}");
    }

    #[test]
    fn a_byte_order_mark_is_no_part_of_a_description() {
        assert!(Spec::parse(Path::new("p.yaml"), &format!("\u{feff}{EXAMPLE}")).is_ok());
    }

    #[test]
    fn a_pose_in_another_order_than_the_joints_is_refused() {
        let go1 = Robot::load("go1").unwrap();
        let fault = |pose: &str| {
            let (before, rest) = EXAMPLE.split_once("nominal_pose_rad:").unwrap();
            let (_, after) = rest.split_once('\n').unwrap();
            let text = format!("{before}nominal_pose_rad: {pose}\n{after}");
            Spec::parse(Path::new("test"), &text).unwrap().check_pose(&go1)
        };
        assert!(fault("[0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 1.0, -1.5, -0.1, 1.0, -1.5]").is_ok());
        // Hips, thighs, calves, as Isaac Lab has them, where the example lists leg by leg.
        let error =
            fault("[0.1, -0.1, 0.1, -0.1, 0.8, 0.8, 1.0, 1.0, -1.5, -1.5, -1.5, -1.5]").unwrap_err().to_string();
        assert!(error.contains("FL_calf at 0.1 rad, expected -2.818 to -0.888 rad"), "{error}");
        assert!(error.contains("in the order of `joints`"), "{error}");
    }

    #[test]
    fn a_description_is_yaml_whatever_the_names_in_it() {
        let text = describe_network("a\nb", &Config::load("fast").unwrap(), "x\ny.onnx");
        let spec = Spec::parse(Path::new("net.yaml"), &text).unwrap();
        assert_eq!(spec.onnx, Path::new("x\ny.onnx"));
    }

    #[test]
    fn last_targets_are_seen_in_the_scale_of_each_joints_action() {
        let text = EXAMPLE.replace("quantity: last_action", "quantity: last_target, scale: action");
        let (before, after) = text.split_once("scale_rad:").unwrap();
        let rest = after.split_once('\n').unwrap().1;
        let text = format!("{before}scale_rad: [0.5{}]\n{rest}", ", 0.25".repeat(11));
        let spec = Spec::parse(Path::new("test"), &text).unwrap();
        assert_eq!(spec.layout.scale()[36..39], [2.0, 4.0, 4.0]);
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn descriptions_changed_at_random_never_panic(
            changes in prop::collection::vec((any::<prop::sample::Index>(), "[ -~\n]{0,3}"), 1..6),
        ) {
            // Comments are most of the example.
            let bare: Vec<&str> =
                EXAMPLE.lines().filter_map(|line| line.split('#').next()).filter(|line| !line.trim().is_empty()).collect();
            let mut text = bare.join("\n");
            for (place, new) in changes {
                let at = place.index(text.len());
                text.replace_range(at..at + 1, &new);
            }
            // Whatever is accepted is bounded.
            if let Ok(spec) = Spec::parse(Path::new("changed"), &text) {
                prop_assert!(spec.layout.length() <= 1 << 16);
            }
        }
    }
}
