/*! The contact network: which feet stand, from joint states and joint targets alone (section IV-D). Start with
[`ContactEstimator`] (one robot), then [`ContactNetwork`]; [`learn`] trains it and [`score`] measures it.

A small network reads encoders and joint targets of the last four ticks of 240 Hz, 144 numbers, and returns a logit for each foot:
that it [stands](crate::robot::FootState::stands), which is what an estimator of the trunk's velocity builds on. It is trained once, by supervised learning on data of a trained policy ([`learn`],
`train_contact`), and kept in one file ([`ContactNetwork::load`]). The paper gives neither size nor loss: two hidden
layers, and cross-entropy on the logit of each foot.
*/

pub mod learn;
mod network;
pub mod score;

use crate::network::Scratch;
use crate::robot::{JOINTS, Joints};

use super::EncoderReading;
pub use network::{ContactNetwork, ContactProvenance, HeldOut, PolicySource, shipped_sha256};

/// Number of ticks in the input, the present one included.
pub const TICKS: usize = 4;

/// Numbers in a tick: joint angles \[rad\], joint rates [rad/s], joint targets \[rad\].
const PER_TICK: usize = 3 * JOINTS;

/// Numbers in the input, the oldest tick first.
pub const INPUTS: usize = TICKS * PER_TICK;

/// Rate of the ticks \[Hz\].
pub const RATE_HZ: f64 = 240.0;

const _: () = assert!(INPUTS == 144);

/// The last [`TICKS`] ticks, the input of the network in physical units.
#[derive(Debug, Clone, PartialEq)]
pub struct ContactHistory {
    inputs: [f32; INPUTS],
    begun: bool,
}

impl Default for ContactHistory {
    fn default() -> Self {
        ContactHistory { inputs: [0.0; INPUTS], begun: false }
    }
}

impl ContactHistory {
    /// Adds the encoder reading of a tick and the joint targets \[rad\] that were given last. The first tick also fills
    /// the past. A reading that is not finite is ignored.
    pub fn push(&mut self, encoders: &EncoderReading, targets: &Joints) {
        let all = || encoders.angles.iter().chain(&encoders.rates).chain(targets);
        if !all().all(|value| value.is_finite()) {
            return;
        }
        let ticks = if self.begun { 1 } else { TICKS };
        for _ in 0..ticks {
            self.inputs.copy_within(PER_TICK.., 0);
            let newest = &mut self.inputs[INPUTS - PER_TICK..];
            newest.iter_mut().zip(all()).for_each(|(input, value)| *input = *value as f32);
        }
        self.begun = true;
    }

    /// Returns the input: the oldest tick first, in each angles, rates and targets.
    pub fn inputs(&self) -> &[f32; INPUTS] {
        &self.inputs
    }
}

/// The contact network with the history of one robot.
#[derive(Debug)]
pub struct ContactEstimator {
    network: ContactNetwork,
    history: ContactHistory,
    scratch: Scratch,
}

impl ContactEstimator {
    /// Creates an estimator without history.
    pub fn new(network: ContactNetwork) -> Self {
        ContactEstimator { network, history: ContactHistory::default(), scratch: Scratch::default() }
    }

    /// Returns the contact of each foot after a tick with this reading and the joint targets \[rad\] that were given
    /// last.
    pub fn update(&mut self, encoders: &EncoderReading, targets: &Joints) -> [bool; 4] {
        self.history.push(encoders, targets);
        self.network.logits(self.history.inputs(), &mut self.scratch).map(|logit| logit > 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading(value: f64) -> EncoderReading {
        EncoderReading { angles: [value; JOINTS], rates: [10.0 * value; JOINTS] }
    }

    #[test]
    fn the_history_holds_four_ticks_the_oldest_first() {
        let mut history = ContactHistory::default();
        history.push(&reading(1.0), &[100.0; JOINTS]);
        assert!(history.inputs().chunks(PER_TICK).all(|tick| (tick[0], tick[12], tick[24]) == (1.0, 10.0, 100.0)));
        for tick in 2..=5 {
            history.push(&reading(f64::from(tick)), &[100.0 * f64::from(tick); JOINTS]);
        }
        let firsts: Vec<f32> = history.inputs().chunks(PER_TICK).map(|tick| tick[0]).collect();
        assert_eq!(firsts, [2.0, 3.0, 4.0, 5.0]);
        assert_eq!(history.inputs()[INPUTS - 1], 500.0);
    }

    #[test]
    fn a_reading_that_is_not_a_number_stays_out_of_the_history() {
        let mut history = ContactHistory::default();
        history.push(&reading(1.0), &[0.0; JOINTS]);
        let before = history.clone();
        history.push(&reading(f64::NAN), &[0.0; JOINTS]);
        assert_eq!(history, before);
    }
}
