/*! One seed, named streams.

Every random number comes from a generator that is derived anew from the run's seed, a purpose and two counters. No
generator lives longer than what it is for, so that there is no generator state to save, and no result depends on which
thread asks first.
*/

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// The purpose of a random stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u64)]
pub enum Purpose {
    /// Initial network weights.
    Weights = 1,
    /// Conditions of an episode: command, slope, friction, push. Counters: environment, episode.
    Episode = 2,
    /// Exploration noise. Counters: environment, iteration.
    Action = 3,
    /// Order of samples. Counters: iteration, epoch.
    Shuffle = 4,
    /// Lengths of the first episodes. Counter: environment.
    Stagger = 5,
    /// Timing and size of a scenario's disturbance. Counters: trial, free.
    Scenario = 6,
    /// Shape of terrain and place of obstacles. Counters: scenario's own.
    Terrain = 7,
    /// Sensor noise. Counters: trial, sensor.
    Sensor = 8,
    /// Resampling for confidence intervals. Counters: quantity, free.
    Bootstrap = 9,
    /// Samples that are learnt from in the mirror. Counters: iteration, epoch.
    Mirror = 10,
    /// The encoder bias of scenarios.
    Offsets = 11,
}

/// The generator of a stream.
pub fn stream(seed: u64, purpose: Purpose, first: u64, second: u64) -> ChaCha8Rng {
    let mut key = [0; 32];
    for (chunk, word) in key.chunks_exact_mut(8).zip([seed, purpose as u64, first, second]) {
        chunk.copy_from_slice(&word.to_le_bytes());
    }
    ChaCha8Rng::from_seed(key)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;

    #[test]
    fn streams_differ_in_every_coordinate_and_repeat_exactly() {
        let draw = |seed, purpose, a, b| stream(seed, purpose, a, b).random::<u64>();
        let first = draw(1, Purpose::Action, 2, 3);
        assert_eq!(first, draw(1, Purpose::Action, 2, 3));
        for other in [
            draw(0, Purpose::Action, 2, 3),
            draw(1, Purpose::Episode, 2, 3),
            draw(1, Purpose::Action, 0, 3),
            draw(1, Purpose::Action, 2, 0),
        ] {
            assert_ne!(first, other);
        }
    }
}
