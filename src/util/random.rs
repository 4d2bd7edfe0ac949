/*! Random streams: one seed, and a named stream for each purpose.

Every random number comes from a generator that is derived from the run's seed, a purpose and two counters, and lives
only as long as its purpose. So there is no generator state to save, and no result depends on the order in which threads
draw.
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
    /// Choice of the samples that are mirrored. Counters: iteration, epoch.
    Mirror = 10,
    /// Encoder bias of scenarios. Counters: none.
    Offsets = 11,
    /// Noise of the inertial sensor in training. Counters: environment, episode and step.
    Imu = 12,
}

/// Creates the generator of a stream.
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
