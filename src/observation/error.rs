//! The reasons why an observation is refused.

use super::Quantity;
use super::entry::MAX_LENGTH;

/// The reason why a list of entries is no valid observation, or one without a mirror image.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LayoutError {
    /// An entry of the list is invalid.
    #[error("observation, entry {number} ({quantity}): {problem}")]
    Entry {
        /// Number of the entry, from 1.
        number: usize,
        /// The quantity that it observes.
        quantity: Quantity,
        /// The fault of the entry.
        problem: Box<LayoutError>,
    },
    /// A key is missing, superfluous or of another form; the text says what is expected.
    #[error("{0}")]
    Form(String),
    /// A key has a value that it does not take.
    #[error("`{key}` {found}, expected {expected}")]
    Value {
        /// Name of the key.
        key: &'static str,
        /// The value that was found, such as `is -1` or `has 2 numbers`.
        found: String,
        /// The values that it takes.
        expected: String,
    },
    /// A scale is zero.
    #[error("its `scale` is {0:?}, expected no zero: leave out numbers that are not observed")]
    Zero(Vec<f64>),
    /// The observation is empty or too long.
    #[error("its observation has {0} numbers, expected 1 to {MAX_LENGTH}")]
    Length(usize),
    /// The normaliser is of another observation.
    #[error("its normaliser has {} and {} numbers, expected {expected}", found[0], found[1])]
    Normaliser {
        /// Numbers of offsets and scales.
        found: [usize; 2],
        /// Length of the observation.
        expected: usize,
    },
    /// A number cannot be normalised in single precision, which networks use.
    #[error("the offset {offset:e} or the scale {scale:e} of '{name}' is not finite in single precision")]
    Overflow {
        /// Name of the number.
        name: String,
        /// The offset of the number, in its unit.
        offset: f64,
        /// The scale of the number.
        scale: f64,
    },
    /// A quantity of a policy's observation is known to the simulator alone.
    #[error("only the simulator has it, so no policy can observe it: move it to critic_observation")]
    Privileged,
    /// A quantity has no mirror image.
    #[error("{0} has no mirror image")]
    NoImage(Quantity),
    /// A number, which is named, is normalised otherwise than its mirror image.
    #[error("'{0}' and its mirror image have offsets and scales that are no images of one another")]
    Lopsided(String),
}
