//! Range checks of a configuration's values.

use std::fmt::Display;
use std::ops::RangeInclusive;

use garde::Validate;

use super::{Config, LearnerKind, PerJoint, Ppo, Precision};
use crate::observation::LayoutError;
use crate::robot::JOINTS;
use crate::util::yaml;

/// Maximum physics rate \[Hz\]: a higher one gains nothing, and the latency would need a long queue.
pub const MAX_PHYSICS_RATE_HZ: u32 = 20_000;

/// Longest stage of an episode \[s\].
pub const MAX_STAGE_S: f64 = 3600.0;

/// Maximum number of samples in an iteration; memory holds some hundred numbers for each.
pub const MAX_BATCH_SIZE: usize = 1 << 22;

/// Maximum number of hidden layers; deeper networks take hours to initialise.
const MAX_LAYERS: usize = 16;

/// Maximum size of a policy's weights \[bytes\]: its file, which also describes it, is read up to 64 MiB.
const MAX_POLICY_BYTES: u64 = 56 << 20;

/// Maximum number of epochs; each has its own order of the samples in memory.
pub const MAX_EPOCHS: usize = 1000;

/// Largest number of samples of a run, and of iterations between two checkpoints: a thousand years of training.
pub const MAX_SAMPLES: u64 = 1_000_000_000_000_000;

/// Largest weight and gain, far above sensible ones.
const MAX_WEIGHT: f64 = 1e6;

/// Largest angle of the nominal pose \[rad\].
const MAX_ANGLE_RAD: f64 = 100.0;

/// A value out of its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ValueError {
    /// A number outside its range.
    #[error("{key} {problem}")]
    Range {
        /// Dotted key, such as `ppo.epochs`.
        key: String,
        /// The value found and the valid ones, as in `is 0, expected 1 to 1000`.
        problem: String,
    },
    /// A list of quantities that cannot be observed.
    #[error(transparent)]
    Observation(#[from] LayoutError),
    /// The same for the list of the critic.
    #[error("critic_observation: {0}")]
    Critic(LayoutError),
}

impl Config {
    /// Checks the range of every value, for configurations that do not come from YAML.
    ///
    /// # Errors
    /// A value is out of range, or the observation is invalid; the error names the key, the value and the expected
    /// range.
    pub fn check(&self) -> Result<(), ValueError> {
        if let Err(report) = self.validate_with(self)
            && let Some((path, error)) = report.iter().next()
        {
            return Err(ValueError::Range { key: path.to_string(), problem: error.message().to_owned() });
        }
        self.check_learner()?;
        let layout = self.layout()?;
        self.critic_layout().map_err(ValueError::Critic)?;
        self.check_policy(layout.length())?;
        self.check_terrain()
    }

    /// Refuses optional keys of `ppo` that the learner would ignore, unless they stand at their default.
    fn check_learner(&self) -> Result<(), ValueError> {
        let (ppo, keys) = (&self.ppo, yaml::to_value(&self.ppo));
        for (key, value) in keys.as_mapping().into_iter().flatten() {
            let mut others = keys.clone();
            others.as_mapping_mut().map(|others| others.remove(key));
            let is_stated = yaml::typed(others, &[]).is_ok_and(|without: Ppo| without != *ppo);
            let key = key.as_str().unwrap_or_default();
            if is_stated && !ppo.learner.knows(key) {
                let [value, learner] = [yaml::to_text(value), yaml::to_text(&ppo.learner)];
                let (value, learner) = (value.trim_end(), learner.trim_end());
                let other = if ppo.learner == LearnerKind::Fused { "candle" } else { "fused" };
                let problem = format!(
                    "is {value}, which ppo.learner: {learner} does not use: leave the key out, or set ppo.learner: {other}"
                );
                return Err(ValueError::Range { key: format!("ppo.{key}"), problem });
            }
        }
        Ok(())
    }

    /// Refuses networks whose policy files no program would read.
    fn check_policy(&self, inputs: usize) -> Result<(), ValueError> {
        let bytes = 4 * self.ppo.parameters(inputs, JOINTS);
        if bytes <= MAX_POLICY_BYTES {
            return Ok(());
        }
        let [found, most] = [bytes, MAX_POLICY_BYTES].map(|bytes| bytes as f64 / f64::from(1 << 20));
        let widths = &self.ppo.hidden_layers;
        let problem = format!(
            "is {widths:?}, a policy of {found:.1} MiB, expected at most {most:.0} MiB: use fewer or narrower layers"
        );
        Err(ValueError::Range { key: "ppo.hidden_layers".to_owned(), problem })
    }
}

fn require(valid: bool, found: impl Display, expected: impl Display) -> garde::Result {
    if valid { Ok(()) } else { Err(garde::Error::new(format!("is {found}, expected {expected}"))) }
}

/// A value within a range, with its unit.
pub fn within<T: PartialOrd + Display>(
    range: RangeInclusive<T>,
    unit: &str,
) -> impl FnOnce(&T, &Config) -> garde::Result {
    move |value, _| require(range.contains(value), value, format!("{} to {}{unit}", range.start(), range.end()))
}

/// A value above zero and up to `most`.
pub fn positive(most: f64) -> impl FnOnce(&f64, &Config) -> garde::Result {
    move |value, _| require(*value > 0.0 && *value <= most, value, format!("a positive number up to {most}"))
}

pub fn gains_not_negative(gain: &PerJoint, _: &Config) -> garde::Result {
    let valid = gain.joints().iter().all(|gain| (0.0..=MAX_WEIGHT).contains(gain));
    require(valid, gain, format!("a number from 0 to {MAX_WEIGHT}, three (hip, thigh, calf), or twelve"))
}

/// The weight of a cost.
pub fn cost(value: &f64, _: &Config) -> garde::Result {
    let expected = format!("a number not above zero, from -{MAX_WEIGHT}: it is the weight of a cost");
    require((-MAX_WEIGHT..=0.0).contains(value), value, expected)
}

pub fn physics_rate(rate: &u32, config: &Config) -> garde::Result {
    let policy = config.simulation.policy_rate_hz.max(1);
    let such_as = policy.saturating_mul(4);
    require(
        (1..=MAX_PHYSICS_RATE_HZ).contains(rate) && rate.is_multiple_of(policy),
        rate,
        format!("a multiple of policy_rate_hz ({policy} Hz) up to {MAX_PHYSICS_RATE_HZ}, such as {such_as}"),
    )
}

pub fn finite_angles(pose: &PerJoint, _: &Config) -> garde::Result {
    let valid = !matches!(pose, PerJoint::Same(_)) && pose.joints().iter().all(|angle| angle.abs() <= MAX_ANGLE_RAD);
    require(valid, pose, format!("three angles (hip, thigh, calf) within ±{MAX_ANGLE_RAD} rad, or twelve"))
}

pub fn a_step_to_an_hour(duration_s: &f64, config: &Config) -> garde::Result {
    let valid = (config.simulation.policy_period_s()..=MAX_STAGE_S).contains(duration_s);
    require(valid, duration_s, "at least one policy step and at most an hour")
}

pub fn shortest_and_longest(durations_s: &[f64; 2], config: &Config) -> garde::Result {
    let [low, high] = *durations_s;
    let valid = config.simulation.policy_period_s() <= low && low <= high && high <= MAX_STAGE_S;
    let expected = "[shortest, longest], at least one policy step and at most an hour";
    require(valid, format!("{durations_s:?}"), expected)
}

pub fn delays(range_s: &[f64; 2], _: &Config) -> garde::Result {
    let [low, high] = *range_s;
    let valid = 0.0 <= low && low <= high && high <= 1.0;
    require(valid, format!("{range_s:?}"), "[shortest, longest], 0 to 1 s")
}

pub fn rising_to_one(fractions: &[f64], _: &Config) -> garde::Result {
    let rises = fractions.windows(2).all(|pair| pair[0] < pair[1]);
    let valid = fractions.is_empty() || rises && fractions[0] >= 0.0 && fractions.last() == Some(&1.0);
    require(valid, format!("{fractions:?}"), "rising fractions, the last of them 1, such as [0, 0.2, 0.5, 1]")
}

pub fn low_and_high(friction: &[f64; 2], _: &Config) -> garde::Result {
    let [low, high] = *friction;
    let valid = 0.0 < low && low <= high && high <= 100.0;
    require(valid, format!("{friction:?}"), "[low, high] with 0 < low <= high <= 100")
}

/// A divisor of the batch of at least `least`.
pub fn divides_batch(least: usize) -> impl FnOnce(&usize, &Config) -> garde::Result {
    move |count, config| {
        let batch = config.ppo.batch_size;
        let valid = *count >= least && batch.is_multiple_of(*count);
        let above = if least > 1 { " above 1" } else { "" };
        require(valid, count, format!("a divisor of ppo.batch_size ({batch}){above}"))
    }
}

pub fn power_of_two_that_divides(shards: &usize, config: &Config) -> garde::Result {
    let ppo = &config.ppo;
    require(shards.is_power_of_two(), shards, "a power of two")?;
    for (what, count) in [("environments", ppo.environments), ("minibatch_size", ppo.minibatch_size)] {
        require(count.is_multiple_of(*shards), shards, format!("a divisor of ppo.{what} ({count})"))?;
    }
    Ok(())
}

pub fn supported_precision(precision: &Precision, config: &Config) -> garde::Result {
    let valid = config.ppo.learner == LearnerKind::Fused || matches!(precision, Precision::Auto | Precision::F32);
    require(valid, yaml::to_text(precision).trim_end(), "auto or f32 with ppo.learner: candle")
}

pub fn layer_widths(widths: &[usize], _: &Config) -> garde::Result {
    let valid = (1..=MAX_LAYERS).contains(&widths.len()) && widths.iter().all(|width| (1..=4096).contains(width));
    require(valid, format!("{widths:?}"), format!("1 to {MAX_LAYERS} widths from 1 to 4096"))
}

pub fn between_learning_rates(rate: &f64, config: &Config) -> garde::Result {
    let ppo = &config.ppo;
    let valid = (ppo.min_learning_rate..=ppo.max_learning_rate).contains(rate);
    require(valid, rate, "between min_learning_rate and max_learning_rate")
}
