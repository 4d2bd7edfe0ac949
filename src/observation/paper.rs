//! The paper's observation, built from six scales as old configurations state them.

use serde::Deserialize;

use super::quantity::Kind;
use super::{Ages, Numbers, Observed, Quantity, Word};

/// The scales of the paper's observation, as old configurations state them.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct Scales {
    pub height_scale: f64,
    pub gravity_scale: f64,
    pub joint_angle_scale: f64,
    pub velocity_scale: f64,
    pub angular_velocity_scale: f64,
    pub joint_rate_scale: f64,
}

/// Returns the entries of `o_t = {ô_{t−1}, a_{t−1}, ô_t, v_x*, v_z*, ω_y*}` (section III-A) with Table I's `ô` and
/// these scales.
pub fn paper_layout(scales: &Scales) -> Vec<Observed> {
    let words = |words: [&str; 3]| Some(words.map(ToOwned::to_owned).to_vec());
    let nominal = || Some(Numbers::Word(Word::Nominal));
    let reduced = |age: Option<u32>| {
        [
            (Quantity::BaseHeight, nominal(), scales.height_scale),
            (Quantity::Gravity, None, scales.gravity_scale),
            (Quantity::JointAngles, nominal(), scales.joint_angle_scale),
            (Quantity::BaseVelocity, None, scales.velocity_scale),
            (Quantity::AngularVelocity, None, scales.angular_velocity_scale),
            (Quantity::JointRates, None, scales.joint_rate_scale),
        ]
        .map(|(quantity, offset, scale)| Observed {
            elements: if matches!(quantity.about().0, Kind::Polar | Kind::Axial) {
                words(["left", "up", "forward"])
            } else {
                None
            },
            steps_ago: age.map(Ages::One),
            offset,
            scale: (scale != 1.0).then_some(Numbers::All(scale)),
            ..Observed::now(quantity)
        })
    };
    let target =
        Observed { offset: nominal(), scale: Some(Numbers::Word(Word::Action)), ..Observed::now(Quantity::LastTarget) };
    let command = Observed { elements: words(["left", "forward", "yaw"]), ..Observed::now(Quantity::Command) };
    reduced(Some(1)).into_iter().chain([target]).chain(reduced(None)).chain([command]).collect()
}
