/*! Estimate of a run's memory before it is allocated.

Sizes in a configuration multiply: a typing error asks for a million simulations of a megabyte each, and the operating
system kills the process some time later. The memory of one environment is measured, that of networks and samples is
calculated.
*/

use std::fmt;

use super::TrainError;
use super::environment::{LocomotionEnv, Shared};
use super::terrain::uneven;
use crate::config::{Config, LearnerKind};
use crate::robot::JOINTS;
use crate::train::Curriculum;
use crate::util::memory::{FreeMemory, gibibytes};

/// Bytes per parameter of the fused learner, including a checkpoint being written; 54 to 56 were measured.
const FUSED_BYTES: u64 = 60;

/// Bytes per parameter of candle's learner, which keeps a graph; 68 were measured with small minibatches.
const CANDLE_BYTES: u64 = 100;

/// Bytes of an environment in addition to its simulation of 900 KiB: last second, observations, its state in a
/// checkpoint.
const ENVIRONMENT_BYTES: u64 = 100 << 10;

/// Estimated memory of a run \[bytes\].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MemoryEstimate {
    /// Memory of all simulations \[bytes\].
    pub environments: u64,
    /// Memory of the samples of an iteration \[bytes\].
    pub samples: u64,
    /// Memory of networks, moments and gradients \[bytes\].
    pub networks: u64,
}

/// The run needs more memory than the machine has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "this configuration takes {memory}, and the machine has {} left: lower ppo.environments, ppo.batch_size or ppo.hidden_layers",
    gibibytes(*.left)
)]
pub struct MemoryError {
    /// Estimated memory of the run.
    pub memory: MemoryEstimate,
    /// Memory that is available \[bytes\].
    pub left: u64,
}

impl MemoryEstimate {
    /// Estimates the memory of a configuration by creating one of its environments, or one of each kind.
    ///
    /// # Errors
    /// The robot and the observation do not fit together, or the scene does not compile.
    pub fn new(config: &Config) -> Result<Self, TrainError> {
        let shared = Shared::new(config)?;
        let environments = environments_bytes(config, &shared, config.ppo.environments as u64)?;
        let ppo = &config.ppo;
        let [of_policy, of_value] = shared.inputs();
        let [inputs, critic_inputs] = [of_policy, of_value].map(|inputs| inputs as u64);
        let [samples, epochs] = [ppo.batch_size, ppo.epochs].map(|count| count as u64);
        let joints = JOINTS as u64;
        // Observations, action and its mean, and some numbers more; once more in the mirror, of both.
        let of_critic = if critic_inputs == inputs { 0 } else { critic_inputs };
        let numbers = inputs + of_critic + 2 * joints + 8;
        let copies = if ppo.symmetry { 3 } else { 1 };
        let bytes = if ppo.learner == LearnerKind::Candle { CANDLE_BYTES } else { FUSED_BYTES };
        Ok(MemoryEstimate {
            environments,
            samples: samples.saturating_mul(4 * (copies * numbers + epochs)),
            networks: (ppo.parameters(of_policy, JOINTS) + ppo.parameters(of_value, 1)).saturating_mul(bytes),
        })
    }

    /// Returns the part for one machine with `here` of all `ranks`: their environments and samples, and networks for
    /// each of them.
    pub fn for_ranks(self, here: usize, ranks: usize) -> Self {
        let (here, ranks) = (here as u64, ranks as u64);
        let share = |whole: u64| whole.div_ceil(ranks).saturating_mul(here);
        let networks = self.networks.saturating_mul(here);
        MemoryEstimate { environments: share(self.environments), samples: share(self.samples), networks }
    }

    /// Returns the total memory \[bytes\].
    pub fn total(&self) -> u64 {
        self.environments.saturating_add(self.samples).saturating_add(self.networks)
    }

    /// Checks that the machine has enough memory. If it may have too little, depending on the caches that the system frees, returns the
    /// error as a warning.
    ///
    /// # Errors
    /// The run needs more memory than is available; the error names both and the keys to lower.
    pub fn check(self) -> Result<Option<MemoryError>, MemoryError> {
        let Some(FreeMemory { surely, at_most }) = FreeMemory::now() else { return Ok(None) };
        let total = self.total();
        ensure!(total <= at_most, MemoryError { memory: self, left: at_most });
        Ok((total > surely).then_some(MemoryError { memory: self, left: surely }))
    }
}

impl fmt::Display for MemoryEstimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [total, environments, samples, networks] =
            [self.total(), self.environments, self.samples, self.networks].map(gibibytes);
        write!(f, "{total} of memory (environments {environments}, samples {samples}, networks {networks})")
    }
}

/// Returns the memory of the first `count` environments of a configuration \[bytes\], by creating one on a plane and one on uneven
/// ground, where there are both.
///
/// # Errors
/// The scene does not compile.
pub fn environments_bytes(config: &Config, shared: &Shared, count: u64) -> Result<u64, TrainError> {
    let uneven = config.terrain.as_ref().map_or(0, |terrain| uneven(terrain, count));
    let mut bytes = 0_u64;
    for (fraction, count) in [(0.0, count.saturating_sub(uneven)), (1.0, uneven)] {
        if count > 0 {
            let mut config = config.clone();
            config.terrain.iter_mut().for_each(|terrain| terrain.environments = fraction);
            let first = LocomotionEnv::with_shared(&config, shared, 0, 0, Curriculum::new(&config.command))?;
            let each = first.simulation_bytes() as u64 + ENVIRONMENT_BYTES;
            bytes = bytes.saturating_add(each.saturating_mul(count));
        }
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn environments_on_uneven_ground_take_memory_of_their_own() {
        let heights = "rough_m: [0.01, 0.06], boxes_m: [0.02, 0.08]";
        let terrain = format!("terrain={{environments: 0.5, levels: 2, {heights}, sharpness_factor: 0.5}}");
        let config = Config::load_with("fast", &[terrain]).unwrap();
        let shared = Shared::new(&config).unwrap();
        let [one, two, four] = [1, 2, 4].map(|count| environments_bytes(&config, &shared, count).unwrap());
        // The first one has a plane, every second one does not.
        assert!(two > 2 * one && four == 2 * two, "{one} {two} {four}");
    }

    #[test]
    fn memory_estimate_grows_and_excess_is_refused() {
        let mut config = Config::load("fast").unwrap();
        let usual = MemoryEstimate::new(&config).unwrap();
        assert!(usual.check() == Ok(None) && usual.total() < 1 << 30, "{usual}");
        (config.ppo.environments, config.ppo.batch_size) = (1 << 20, 1 << 20);
        let many = MemoryEstimate::new(&config).unwrap();
        let each = usual.environments / Config::load("fast").unwrap().ppo.environments as u64;
        assert_eq!(many.environments, each << 20);
        // Of four ranks, one is on this machine, or all are.
        let (one, all) = (many.for_ranks(1, 4), many.for_ranks(4, 4));
        assert_eq!((one.environments, one.samples, one.networks), (each << 18, many.samples / 4, many.networks));
        assert_eq!((all.environments, all.samples, all.networks), (each << 20, many.samples, 4 * many.networks));
        let error = many.check().unwrap_err();
        assert!(error.left < error.memory.total() && error.to_string().contains("lower ppo.environments"), "{error}");
        // 83 · 4096 and 14 times 4096 · 4096 weights, biases, and a row for each output; 12 of the policy, 1 of the value.
        config.ppo.hidden_layers = vec![4096; 15];
        let weights = |outputs: u64| 4096 * (83 + 14 * 4096) + 15 * 4096 + (4096 + 1) * outputs;
        assert_eq!(MemoryEstimate::new(&config).unwrap().networks, FUSED_BYTES * (weights(12) + weights(1)));
    }
}
