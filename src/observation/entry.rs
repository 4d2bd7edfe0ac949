//! An entry of an observation, as written in a file and checked.

use serde::{Deserialize, Deserializer, Serialize};

use super::quantity::Kind;
use super::{LayoutError, Quantity};
use crate::robot::{JOINTS, Joints, LEGS};

type Result<T> = std::result::Result<T, LayoutError>;

/// Maximum age of a quantity \[policy steps\].
const MAX_STEPS_AGO: u32 = 200;

/// Maximum length of an observation.
pub(super) const MAX_LENGTH: usize = 1 << 16;

/// An entry of an observation, as written in a file. A missing key has the value in brackets.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Observed {
    /// The observed quantity.
    pub quantity: Quantity,
    /// Elements of a vector, in order: forward, left, up, or backward, right, down; yaw of a command [forward, left,
    /// up].
    pub elements: Option<Vec<String>>,
    /// Age in policy steps, or several ages in order \[0\].
    pub steps_ago: Option<StepsAgo>,
    /// Offset, subtracted first \[0\].
    pub offset: Option<Numbers>,
    /// Scale, applied after the offset; not zero \[1\].
    pub scale: Option<Numbers>,
    /// Limit of the scaled value, ± `clip`; unlimited if missing or `.inf`.
    #[serde(default, deserialize_with = "finite")]
    pub clip: Option<f64>,
    /// Frequency of the clocks \[Hz\].
    pub frequency_hz: Option<f64>,
    /// Phases of the clocks, as fractions of a period \[0\].
    pub phases: Option<Vec<f64>>,
    /// Values of the quantity [`Quantity::Constant`].
    pub values: Option<Vec<f64>>,
}

impl Observed {
    /// Creates an entry of a quantity at the present step, with offset 0 and scale 1.
    pub fn now(quantity: Quantity) -> Self {
        let (elements, steps_ago, phases, values) = (None, None, None, None);
        let (offset, scale, clip, frequency_hz) = (None, None, None, None);
        Observed { quantity, elements, steps_ago, offset, scale, clip, frequency_hz, phases, values }
    }
}

/// An offset or a scale: one number, one for each element, or a name for a number of the robot or the action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected a number, a list of numbers, `nominal` (an offset) or `action` (a scale)")]
pub enum Numbers {
    /// One number for all elements.
    All(f64),
    /// One number for each element, in the order of the observation.
    Each(Vec<f64>),
    /// A name that stands for numbers.
    Named(NamedNumbers),
}

/// A name that stands for numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NamedNumbers {
    /// The offset that equals the value in the nominal pose, for base height, joint angles and joint targets.
    Nominal,
    /// The scale of joint values that is the inverse scale of the action, which turns joint targets back into network
    /// outputs.
    Action,
}

/// One age or several ages \[policy steps\].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected a number of steps or a list of them")]
pub enum StepsAgo {
    /// One age.
    One(u32),
    /// Several ages, in order.
    Several(Vec<u32>),
}

/// Values behind the named offsets and scales.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NominalValues {
    /// Joint angles of the nominal pose \[rad\].
    pub pose: Joints,
    /// Base height in the nominal pose \[m\].
    pub height_m: f64,
    /// Change of the joint target per unit of action, in the policy's order of joints \[rad\].
    pub action_scale_rad: Joints,
}

/// A checked entry of the observation: one quantity at one age or several.
#[derive(Debug, Clone, PartialEq)]
pub struct ObservationBlock {
    /// The observed quantity.
    pub quantity: Quantity,
    /// Axis (forward, left, up or yaw) and sign of each element of a vector.
    pub axes: Vec<(usize, f64)>,
    /// Ages in order \[policy steps\].
    pub steps_ago: Vec<u32>,
    /// Frequency of the clocks \[Hz\].
    pub frequency_hz: f64,
    /// Phases of clocks (fractions of a period), or values of constants.
    pub values: Vec<f64>,
    pub(super) width: usize,
    /// Index of the block's first number in a frame.
    pub(super) start: usize,
}

impl ObservationBlock {
    /// Returns the number of values, over all ages.
    pub fn length(&self) -> usize {
        self.width * self.steps_ago.len()
    }

    /// Returns the unit of the values; three units for a command.
    pub fn unit(&self) -> &'static str {
        self.quantity.about().unit
    }

    /// Returns the names of the elements, such as left, up, forward; empty if the quantity is no vector.
    pub fn elements(&self) -> Vec<&'static str> {
        let command = self.quantity.about().kind == Kind::Command;
        self.axes.iter().map(|(axis, sign)| part(*axis, *sign, command)).collect()
    }
}

pub(super) fn block(entry: &Observed) -> Result<ObservationBlock> {
    let kind = entry.quantity.about().kind;
    let is_vector = matches!(kind, Kind::Polar | Kind::Axial | Kind::Command | Kind::FootVectors);
    let third = if kind == Kind::Command { "yaw" } else { "up" };
    let axes = match &entry.elements {
        Some(_) if !is_vector => return Err(LayoutError::Form("it has no axes: leave out `elements`".into())),
        Some(elements) => elements.iter().map(|name| axis(name, third)).collect::<Result<Vec<_>>>()?,
        None if is_vector => (0..3).map(|axis| (axis, 1.0)).collect(),
        None => Vec::new(),
    };
    let values = match (kind, entry.values.clone(), entry.phases.clone()) {
        (Kind::Constant, Some(values), None) => values,
        (Kind::Constant, ..) => return Err(LayoutError::Form("a constant needs `values`, and no `phases`".into())),
        (Kind::Clock, None, phases) => phases.unwrap_or_else(|| vec![0.0]),
        (_, None, None) => Vec::new(),
        _ => return Err(LayoutError::Form("only constants have `values`, only clocks have `phases`".into())),
    };
    let frequency_hz = match entry.frequency_hz {
        Some(frequency) if kind == Kind::Clock && (0.0..=1e3).contains(&frequency) => frequency,
        None if kind != Kind::Clock => 0.0,
        found => {
            let found = found.map_or_else(|| "is missing".to_owned(), |found| format!("is {found}"));
            let expected = "0 to 1000 Hz for a clock, and none for others".into();
            return Err(LayoutError::Value { key: "frequency_hz", found, expected });
        }
    };
    let width = match kind {
        Kind::Scalar => 1,
        Kind::Polar | Kind::Axial | Kind::Command => axes.len(),
        Kind::Joints => JOINTS,
        Kind::Feet => LEGS.len(),
        Kind::FootVectors => LEGS.len() * axes.len(),
        Kind::Clock | Kind::Constant => values.len(),
    };
    if !values.iter().all(|value| value.abs() <= MOST) || width > MAX_LENGTH {
        let expected =
            format!("its `values` or `phases` are {values:?}, expected up to {MAX_LENGTH} numbers within ±{MOST:e}");
        return Err(LayoutError::Form(expected));
    }
    let steps_ago = match &entry.steps_ago {
        None => vec![0],
        Some(StepsAgo::One(age)) => vec![*age],
        Some(StepsAgo::Several(ages)) => ages.clone(),
    };
    ages("steps_ago", &steps_ago)?;
    Ok(ObservationBlock { quantity: entry.quantity, axes, steps_ago, frequency_hz, values, width, start: 0 })
}

pub(super) fn offset(
    entry: &Observed,
    block: &ObservationBlock,
    order: &[usize; JOINTS],
    nominal: &NominalValues,
) -> Result<Vec<f64>> {
    match (&entry.offset, entry.quantity) {
        (Some(Numbers::Named(NamedNumbers::Nominal)), Quantity::BaseHeight) => Ok(vec![nominal.height_m]),
        (Some(Numbers::Named(NamedNumbers::Nominal)), Quantity::JointAngles | Quantity::LastTarget) => {
            Ok(order.iter().map(|joint| nominal.pose[*joint]).collect())
        }
        (Some(Numbers::Named(_)), _) => Err(LayoutError::Form(
            "its `offset` must be a number: only base_height, joint_angles and last_target have a `nominal` one".into(),
        )),
        (found, _) => numbers("offset", found.as_ref(), block.width, 0.0),
    }
}

pub(super) fn scale(entry: &Observed, block: &ObservationBlock, nominal: &NominalValues) -> Result<Vec<f64>> {
    let scale = match &entry.scale {
        Some(Numbers::Named(NamedNumbers::Action)) if entry.quantity.about().kind == Kind::Joints => {
            nominal.action_scale_rad.map(f64::recip).to_vec()
        }
        Some(Numbers::Named(_)) => {
            return Err(LayoutError::Form("its `scale` must be a number, or `action` if it is of joints".into()));
        }
        found => numbers("scale", found.as_ref(), block.width, 1.0)?,
    };
    // Scales are also divided by: an observation is the network's input over its scale.
    if scale.iter().all(|scale| *scale != 0.0 && scale.is_finite()) { Ok(scale) } else { Err(LayoutError::Zero(scale)) }
}

/// Returns the name of a vector's element, such as `left`.
fn part(axis: usize, sign: f64, command: bool) -> &'static str {
    match (axis, sign > 0.0) {
        (0, true) => "forward",
        (0, false) => "backward",
        (1, true) => "left",
        (1, false) => "right",
        (_, _) if command => "yaw rate",
        (_, true) => "up",
        (_, false) => "down",
    }
}

fn axis(name: &str, third: &str) -> Result<(usize, f64)> {
    match name {
        "forward" => Ok((0, 1.0)),
        "backward" => Ok((0, -1.0)),
        "left" => Ok((1, 1.0)),
        "right" => Ok((1, -1.0)),
        "down" if third == "up" => Ok((2, -1.0)),
        other if other == third => Ok((2, 1.0)),
        other => Err(LayoutError::Value {
            key: "elements",
            found: format!("has '{other}'"),
            expected: format!("forward, backward, left, right or {third}"),
        }),
    }
}

/// Largest number of an entry: single precision and its squares stay finite.
const MOST: f64 = 1e9;

/// Checks an offset or a scale, and returns one finite number for each element.
pub(crate) fn numbers(key: &'static str, found: Option<&Numbers>, width: usize, default: f64) -> Result<Vec<f64>> {
    let numbers = match found {
        None => vec![default; width],
        Some(Numbers::All(number)) => vec![*number; width],
        Some(Numbers::Each(numbers)) => numbers.clone(),
        Some(Numbers::Named(_)) => {
            return Err(LayoutError::Form(format!("`{key}` must be a number, or a list of {width}")));
        }
    };
    if numbers.len() != width {
        let (found, expected) = (format!("has {} numbers", numbers.len()), format!("one, or {width}"));
        return Err(LayoutError::Value { key, found, expected });
    }
    if !numbers.iter().all(|number| number.abs() <= MOST) {
        let expected = format!("finite numbers within ±{MOST:e}");
        return Err(LayoutError::Value { key, found: format!("is {numbers:?}"), expected });
    }
    Ok(numbers)
}

/// Reads a limit. JSON has no infinity, so it is none.
fn finite<'de, D: Deserializer<'de>>(from: D) -> std::result::Result<Option<f64>, D::Error> {
    Ok(Option::deserialize(from)?.filter(|limit| *limit != f64::INFINITY))
}

/// Checks a limit; infinite if there is none.
pub(crate) fn limit(key: &'static str, found: Option<f64>) -> Result<f64> {
    match found {
        None => Ok(f64::INFINITY),
        Some(limit) if limit > 0.0 && limit <= MOST || limit == f64::INFINITY => Ok(limit),
        Some(other) => Err(LayoutError::Value {
            key,
            found: format!("is {other}"),
            expected: format!("a positive number up to {MOST:e}, or .inf"),
        }),
    }
}

pub(super) fn ages(key: &'static str, ages: &[u32]) -> Result<()> {
    if !ages.is_empty() && ages.len() <= 1 + MAX_STEPS_AGO as usize && ages.iter().all(|age| *age <= MAX_STEPS_AGO) {
        Ok(())
    } else {
        Err(LayoutError::Form(format!("`{key}` must be one or more ages from 0 to {MAX_STEPS_AGO} policy steps")))
    }
}
