//! The YAML file of a policy from elsewhere, checked.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::{ForeignError, ForeignPolicy, Meaning};
use crate::config::{Config, Simulation, layered};
use crate::go1::{JOINT_COUNT, Joints, joint_name};
use crate::onnx::Network;

/// Longest history \[policy steps\].
const MAX_STEPS_AGO: u32 = 200;

/// Longest observation.
const MAX_LENGTH: usize = 1 << 16;

/// What an observation can be made of. Vectors are in the base frame, (forward, left, up).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// Height of the base above the ground \[m\].
    BaseHeight,
    /// Gravity [m/s²].
    Gravity,
    /// Direction of gravity, a unit vector.
    ProjectedGravity,
    /// Joint angles \[rad\].
    JointAngles,
    /// Joint angles minus the nominal pose \[rad\].
    JointOffsets,
    /// Joint rates [rad/s].
    JointRates,
    /// Velocity of the base [m/s].
    BaseVelocity,
    /// Angular velocity of the base [rad/s].
    AngularVelocity,
    /// The network's last outputs, clipped, not scaled; zero at first.
    LastAction,
    /// The last joint targets \[rad\]; the nominal pose at first.
    LastTarget,
    /// Commanded velocity: forward [m/s], left [m/s], yaw rate [rad/s].
    Command,
    /// sin 2π(f·t + phase) for each of `phases`.
    ClockSin,
    /// cos 2π(f·t + phase) for each of `phases`.
    ClockCos,
    /// `values`, always.
    Constant,
}

/// A number, or one for each element.
#[derive(Debug, Clone, Deserialize)]
#[serde(untagged, expecting = "expected a number or a list of numbers")]
enum Numbers {
    All(f64),
    Each(Vec<f64>),
}

/// An age, or several.
#[derive(Debug, Clone, Deserialize)]
#[serde(untagged, expecting = "expected a number of steps or a list of them")]
enum Ages {
    One(u32),
    Several(Vec<u32>),
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawBlock {
    quantity: Quantity,
    elements: Option<Vec<String>>,
    offset: Option<Numbers>,
    scale: Option<Numbers>,
    clip: Option<f64>,
    steps_ago: Option<Ages>,
    frequency_hz: Option<f64>,
    phases: Option<Vec<f64>>,
    values: Option<Vec<f64>>,
}

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
    simulation: Simulation,
    joints: Vec<String>,
    nominal_pose_rad: Vec<f64>,
    observation: Vec<RawBlock>,
    history: Option<Vec<u32>>,
    observation_clip: Option<f64>,
    action: RawAction,
}

/// A stretch of the observation.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    /// What it is.
    pub quantity: Quantity,
    /// For vectors, which of (forward, left, up or yaw) each element is, and its sign.
    pub axes: Vec<(usize, f64)>,
    /// Subtracted from each element.
    pub offset: Vec<f64>,
    /// Multiplied with each element after that.
    pub scale: Vec<f64>,
    /// Limit of each element after that.
    pub clip: f64,
    /// Policy steps ago, in order.
    pub steps_ago: Vec<u32>,
    /// Of clocks \[Hz\].
    pub frequency_hz: f64,
    /// Of clocks, as a share of a period; of constants, their values.
    pub values: Vec<f64>,
}

impl Block {
    /// Numbers at one age.
    pub fn width(&self) -> usize {
        self.scale.len()
    }

    /// Numbers in all.
    pub fn length(&self) -> usize {
        self.width() * self.steps_ago.len()
    }
}

/// A checked file.
pub(super) struct Spec {
    pub(super) onnx: PathBuf,
    policy: Parts,
}

/// Everything but the network.
#[derive(Debug)]
pub(super) struct Parts {
    /// The observation, in order.
    pub(super) observation: Vec<Block>,
    /// Steps ago of each repetition of the observation, in order; `[0]` is no history.
    pub(super) history: Vec<u32>,
    /// Limit of every number that the network sees.
    pub(super) observation_clip: f64,
    /// For each of the policy's joints, its place in our order.
    pub(super) order: [usize; JOINT_COUNT],
    /// Our order \[rad\].
    pub(super) nominal_pose: Joints,
    pub(super) meaning: Meaning,
    /// The policy's order \[rad\].
    pub(super) action_scale: Joints,
    /// Limit of every output, before it is scaled.
    pub(super) action_clip: f64,
    /// Rates, gains and latency to run it with; all else is that of the paper's configuration.
    pub(super) config: Config,
}

impl Spec {
    /// Checks the text of the file at `path`.
    pub(super) fn parse(path: &Path, text: &str) -> Result<Self, ForeignError> {
        let name = path.display().to_string();
        let raw: RawSpec = layered(&name, &[text])?;
        let mut config = Config::load("compliant")?;
        config.simulation = raw.simulation.clone();
        let config = Config::from_yaml(&name, &config.to_yaml())?;
        let onnx = raw.onnx.clone();
        let policy =
            Parts::check(raw, config).map_err(|problem| ForeignError::Invalid { path: path.to_owned(), problem })?;
        Ok(Spec { onnx, policy })
    }

    /// The policy, if the network takes and gives as many numbers as the file says.
    pub(super) fn with_network(
        self,
        path: &Path,
        network: Network,
        sha256: String,
    ) -> Result<ForeignPolicy, ForeignError> {
        let parts = self.policy;
        let fail = |problem: String| Err(ForeignError::Invalid { path: path.to_owned(), problem });
        let one: usize = parts.observation.iter().map(Block::length).sum();
        let length = one * parts.history.len();
        if length != network.inputs() {
            let lengths: Vec<String> =
                parts.observation.iter().map(|block| format!("{:?} {}", block.quantity, block.length())).collect();
            let times =
                if parts.history.len() == 1 { String::new() } else { format!(", {} times", parts.history.len()) };
            return fail(format!(
                "its observation has {length} numbers ({}{times}), but the input '{}' of {} takes {}",
                lengths.join(", "),
                network.input_name(),
                self.onnx.display(),
                network.inputs()
            ));
        }
        if network.outputs() != JOINT_COUNT {
            let onnx = self.onnx.display();
            return fail(format!(
                "{onnx} has {} outputs, expected one for each of {JOINT_COUNT} joints",
                network.outputs()
            ));
        }
        Ok(ForeignPolicy { network, parts, sha256 })
    }
}

impl Parts {
    fn check(raw: RawSpec, config: Config) -> Result<Self, String> {
        let order = joint_order(&raw.joints)?;
        let pose: [f64; JOINT_COUNT] = raw.nominal_pose_rad.try_into().map_err(|pose: Vec<f64>| {
            format!("nominal_pose_rad has {} angles, expected {JOINT_COUNT}, in the order of `joints`", pose.len())
        })?;
        if !pose.iter().all(|angle| angle.abs() <= std::f64::consts::TAU) {
            return Err(format!("nominal_pose_rad is {pose:?}, expected angles of at most one turn"));
        }
        let mut nominal_pose = [0.0; JOINT_COUNT];
        for (place, angle) in order.iter().zip(pose) {
            nominal_pose[*place] = angle;
        }
        let observation = raw.observation.into_iter().enumerate().map(|(index, block)| {
            let quantity = block.quantity;
            block.check().map_err(|problem| format!("observation, entry {} ({quantity:?}): {problem}", index + 1))
        });
        let observation = observation.collect::<Result<Vec<Block>, String>>()?;
        let history = raw.history.unwrap_or_else(|| vec![0]);
        ages("history", &history)?;
        let length = history.len() * observation.iter().map(Block::length).sum::<usize>();
        if length > MAX_LENGTH {
            return Err(format!("its observation has {length} numbers, at most {MAX_LENGTH} are possible"));
        }
        let scale = numbers("action.scale_rad", Some(raw.action.scale_rad), JOINT_COUNT, 1.0)?;
        Ok(Parts {
            observation,
            history,
            observation_clip: limit("observation_clip", raw.observation_clip)?,
            order,
            nominal_pose,
            meaning: raw.action.meaning,
            action_scale: std::array::from_fn(|joint| scale[joint]),
            action_clip: limit("action.clip", raw.action.clip)?,
            config,
        })
    }
}

impl RawBlock {
    fn check(self) -> Result<Block, String> {
        let clock = matches!(self.quantity, Quantity::ClockSin | Quantity::ClockCos);
        let (names, third): (&[&str], _) = match self.quantity {
            Quantity::Command => (&["forward", "left", "yaw"], "yaw"),
            Quantity::Gravity | Quantity::ProjectedGravity | Quantity::BaseVelocity | Quantity::AngularVelocity => {
                (&["forward", "left", "up"], "up")
            }
            _ => (&[], ""),
        };
        let axes = match self.elements {
            Some(_) if names.is_empty() => return Err("it has no axes: leave out `elements`".into()),
            Some(elements) => elements.iter().map(|name| axis(name, third)).collect::<Result<Vec<_>, _>>()?,
            None => (0..names.len()).map(|axis| (axis, 1.0)).collect(),
        };
        let values = match (self.quantity, self.values, self.phases) {
            (Quantity::Constant, Some(values), None) => values,
            (Quantity::Constant, ..) => return Err("a constant needs `values`, and no `phases`".into()),
            (_, None, Some(phases)) if clock => phases,
            (_, None, None) if clock => vec![0.0],
            (_, None, None) => Vec::new(),
            _ => return Err("only constants have `values`, only clocks have `phases`".into()),
        };
        let frequency_hz = match self.frequency_hz {
            Some(frequency) if clock && (0.0..=1e3).contains(&frequency) => frequency,
            None if !clock => 0.0,
            _ => return Err("clocks, and they alone, need a `frequency_hz` of 0 to 1000 Hz".into()),
        };
        let width = match self.quantity {
            Quantity::BaseHeight => 1,
            Quantity::JointAngles
            | Quantity::JointOffsets
            | Quantity::JointRates
            | Quantity::LastAction
            | Quantity::LastTarget => JOINT_COUNT,
            Quantity::ClockSin | Quantity::ClockCos | Quantity::Constant => values.len(),
            _ => axes.len(),
        };
        if !values.iter().all(|value| value.is_finite()) || width > MAX_LENGTH {
            return Err("its `values` or `phases` are not finite, or too many".into());
        }
        let steps_ago = match self.steps_ago {
            None => vec![0],
            Some(Ages::One(age)) => vec![age],
            Some(Ages::Several(ages)) => ages,
        };
        ages("steps_ago", &steps_ago)?;
        Ok(Block {
            quantity: self.quantity,
            axes,
            offset: numbers("offset", self.offset, width, 0.0)?,
            scale: numbers("scale", self.scale, width, 1.0)?,
            clip: limit("clip", self.clip)?,
            steps_ago,
            frequency_hz,
            values,
        })
    }
}

/// Where each of the policy's joints is in our order. Names are ours, with or without `_joint`.
fn joint_order(names: &[String]) -> Result<[usize; JOINT_COUNT], String> {
    let known: Vec<String> = (0..JOINT_COUNT).map(joint_name).collect();
    let place = |name: &String| {
        let short = name.strip_suffix("_joint").unwrap_or(name);
        known.iter().position(|known| known == short).ok_or_else(|| {
            format!("`joints` has '{name}', which is no joint of the robot; they are: {}", known.join(", "))
        })
    };
    let order = names.iter().map(place).collect::<Result<Vec<_>, _>>()?;
    match <[usize; JOINT_COUNT]>::try_from(order) {
        Ok(order) if (0..JOINT_COUNT).all(|joint| order.contains(&joint)) => Ok(order),
        _ => Err(format!("`joints` must name each of these once, in the policy's order: {}", known.join(", "))),
    }
}

fn axis(name: &str, third: &str) -> Result<(usize, f64), String> {
    match name {
        "forward" => Ok((0, 1.0)),
        "backward" => Ok((0, -1.0)),
        "left" => Ok((1, 1.0)),
        "right" => Ok((1, -1.0)),
        "down" if third == "up" => Ok((2, -1.0)),
        other if other == third => Ok((2, 1.0)),
        other => Err(format!("`elements` has '{other}', expected forward, backward, left, right or {third}")),
    }
}

fn numbers(key: &str, found: Option<Numbers>, width: usize, default: f64) -> Result<Vec<f64>, String> {
    let numbers = match found {
        None => vec![default; width],
        Some(Numbers::All(number)) => vec![number; width],
        Some(Numbers::Each(numbers)) => numbers,
    };
    if numbers.len() != width {
        return Err(format!("`{key}` has {} numbers, expected one, or {width}", numbers.len()));
    }
    if !numbers.iter().all(|number| number.is_finite()) {
        return Err(format!("`{key}` is {numbers:?}, expected finite numbers"));
    }
    Ok(numbers)
}

fn limit(key: &str, found: Option<f64>) -> Result<f64, String> {
    match found {
        None => Ok(f64::INFINITY),
        Some(limit) if limit > 0.0 => Ok(limit),
        Some(other) => Err(format!("`{key}` is {other}, expected a positive number")),
    }
}

fn ages(key: &str, ages: &[u32]) -> Result<(), String> {
    if !ages.is_empty() && ages.len() <= 1 + MAX_STEPS_AGO as usize && ages.iter().all(|age| *age <= MAX_STEPS_AGO) {
        Ok(())
    } else {
        Err(format!("`{key}` must be one or more ages from 0 to {MAX_STEPS_AGO} policy steps"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const EXAMPLE: &str = include_str!("../../examples/policies/rsl_rl.yaml");

    #[test]
    fn the_example_parses() {
        let spec = Spec::parse(Path::new("rsl_rl.yaml"), EXAMPLE).unwrap();
        assert_eq!(spec.policy.observation.iter().map(Block::length).sum::<usize>(), 48);
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
                let length: usize = spec.policy.observation.iter().map(Block::length).sum();
                prop_assert!(length * spec.policy.history.len() <= MAX_LENGTH);
            }
        }
    }
}
