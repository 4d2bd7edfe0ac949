//! Range checks of a configuration's values.

use std::ops::RangeInclusive;

use super::{Config, LOG_STD_RANGE, LearnerKind, Precision};
use crate::util::yaml;

/// Maximum physics rate \[Hz\]: a higher one gains nothing, and the latency would need a long queue.
const MAX_PHYSICS_RATE_HZ: u32 = 20_000;

/// Longest stage of an episode \[s\].
const MAX_STAGE_S: f64 = 3600.0;

/// Maximum number of samples in an iteration; memory holds some hundred numbers for each.
const MAX_BATCH_SIZE: usize = 1 << 22;

/// Maximum number of hidden layers; deeper networks take hours to initialise.
const MAX_LAYERS: usize = 16;

/// Maximum number of epochs; each has its own order of the samples in memory.
const MAX_EPOCHS: usize = 1000;

/// An invalid value of a configuration.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ValueError {
    /// A number outside its range.
    #[error("{key} is {found}, expected {expected}")]
    Range {
        /// Dotted key, such as `ppo.epochs`.
        key: &'static str,
        /// The value that was found.
        found: String,
        /// Description of the valid values.
        expected: String,
    },
    /// A list of quantities that cannot be observed; the text says why.
    #[error("{0}")]
    Observation(String),
}

impl Config {
    /// Checks the range of every value, for configurations that do not come from YAML.
    ///
    /// # Errors
    /// A value is out of range, or the observation is invalid; the error names the key, the value and the expected
    /// range.
    pub fn check(&self) -> Result<(), ValueError> {
        let s = &self.simulation;
        within("simulation.policy_rate_hz", s.policy_rate_hz, 1..=1000, "1 to 1000 Hz")?;
        require(
            (1..=MAX_PHYSICS_RATE_HZ).contains(&s.physics_rate_hz)
                && s.physics_rate_hz.is_multiple_of(s.policy_rate_hz),
            "simulation.physics_rate_hz",
            s.physics_rate_hz,
            &format!(
                "a multiple of policy_rate_hz ({} Hz) up to {MAX_PHYSICS_RATE_HZ}, such as {}",
                s.policy_rate_hz,
                4 * s.policy_rate_hz
            ),
        )?;
        within("simulation.latency_s", s.latency_s, 0.0..=1.0, "0 to 1 s")?;
        not_negative("simulation.kp_n_m_per_rad", s.kp_n_m_per_rad)?;
        not_negative("simulation.kd_n_m_s_per_rad", s.kd_n_m_s_per_rad)?;

        not_negative("robot.friction_loss_n_m", self.robot.friction_loss_n_m)?;
        not_negative("robot.damping_n_m_s_per_rad", self.robot.damping_n_m_s_per_rad)?;

        let pose = self.action.nominal_pose_rad.joints();
        let sound = pose.iter().all(|angle| angle.is_finite());
        require(sound, "action.nominal_pose_rad", format!("{pose:?}"), "finite angles")?;
        positive("action.scale_rad", self.action.scale_rad)?;
        self.layout().map_err(ValueError::Observation)?;

        let c = &self.command;
        not_negative("command.forward_m_s", c.forward_m_s)?;
        not_negative("command.left_m_s", c.left_m_s)?;
        not_negative("command.yaw_rad_s", c.yaw_rad_s)?;
        fraction("command.initial_fraction", c.initial_fraction)?;
        fraction("command.fraction_step", c.fraction_step)?;
        fraction("command.fraction_gate", c.fraction_gate)?;

        let e = &self.episode;
        let period = s.policy_period_s();
        let walking = "at least one policy step and at most an hour";
        within("episode.walking_s", e.walking_s, period..=MAX_STAGE_S, walking)?;
        within("episode.recovery_s", e.recovery_s, 0.0..=MAX_STAGE_S, "0 to 3600 s")?;
        within("episode.post_recovery_s", e.post_recovery_s, 0.0..=MAX_STAGE_S, "0 to 3600 s")?;
        fraction("episode.push_gate", e.push_gate)?;
        not_negative("episode.push_speed_m_s", e.push_speed_m_s)?;
        not_negative("episode.push_rate_rad_s", e.push_rate_rad_s)?;
        fraction("episode.slope", e.slope)?;
        not_negative("episode.min_height_m", e.min_height_m)?;
        if let Some(pulls) = &self.pulls {
            not_negative("pulls.force_n", pulls.force_n)?;
            for (key, [low, high]) in [("pulls.duration_s", pulls.duration_s), ("pulls.gap_s", pulls.gap_s)] {
                let sound = period <= low && low <= high && high <= MAX_STAGE_S;
                let expected = "[shortest, longest], at least one policy step and at most an hour";
                require(sound, key, format!("{:?}", [low, high]), expected)?;
            }
            fraction("pulls.fraction_step", pulls.fraction_step)?;
            fraction("pulls.fraction_gate", pulls.fraction_gate)?;
        }
        let weights = &self.reward;
        not_negative("reward.linear_velocity", weights.linear_velocity)?;
        not_negative("reward.angular_velocity", weights.angular_velocity)?;
        not_positive("reward.energy", weights.energy)?;
        not_positive("reward.torque", weights.torque)?;
        not_positive("reward.pose", weights.pose)?;
        not_positive("reward.foot_clearance", weights.foot_clearance)?;
        not_positive("reward.foot_height", weights.foot_height)?;
        not_positive("reward.flight", weights.flight)?;
        not_negative("reward.tracking_sharpness", weights.tracking_sharpness)?;
        not_negative("reward.height_sharpness", weights.height_sharpness)?;
        not_negative("reward.negative_sharpness", weights.negative_sharpness)?;
        positive("reward.base_height_m", self.reward.base_height_m)?;
        positive("reward.foot_height_m", self.reward.foot_height_m)?;

        let r = &self.randomisation;
        let [low, high] = r.friction;
        require(
            0.0 < low && low <= high && high.is_finite(),
            "randomisation.friction",
            format!("{:?}", r.friction),
            "[low, high] with 0 < low <= high",
        )?;
        not_negative("randomisation.encoder_bias_sd_rad", r.encoder_bias_sd_rad)?;
        positive("randomisation.default_friction", r.default_friction)?;

        let p = &self.ppo;
        within("ppo.batch_size", p.batch_size, 1..=MAX_BATCH_SIZE, &format!("1 to {MAX_BATCH_SIZE}"))?;
        require(
            p.environments > 0 && p.batch_size.is_multiple_of(p.environments),
            "ppo.environments",
            p.environments,
            &format!("a divisor of ppo.batch_size ({})", p.batch_size),
        )?;
        require(
            p.minibatch_size > 1 && p.batch_size.is_multiple_of(p.minibatch_size),
            "ppo.minibatch_size",
            p.minibatch_size,
            &format!("a divisor of ppo.batch_size ({}) above 1", p.batch_size),
        )?;
        require(p.shards.is_power_of_two(), "ppo.shards", p.shards, "a power of two")?;
        for (what, count) in [("environments", p.environments), ("minibatch_size", p.minibatch_size)] {
            let expected = format!("a divisor of ppo.{what} ({count})");
            require(count.is_multiple_of(p.shards), "ppo.shards", p.shards, &expected)?;
        }
        require(
            p.learner == LearnerKind::Fused || p.shards == 1,
            "ppo.shards",
            p.shards,
            "1 with ppo.learner: candle",
        )?;
        let has = p.learner == LearnerKind::Fused || matches!(p.precision, Precision::Auto | Precision::F32);
        require(has, "ppo.precision", yaml::to_text(&p.precision).trim_end(), "auto or f32 with ppo.learner: candle")?;
        within("ppo.epochs", p.epochs, 1..=MAX_EPOCHS, &format!("1 to {MAX_EPOCHS}"))?;
        let widths = (1..=MAX_LAYERS).contains(&p.hidden_layers.len());
        let widths = widths && p.hidden_layers.iter().all(|width| (1..=4096).contains(width));
        let expected = format!("1 to {MAX_LAYERS} widths from 1 to 4096");
        require(widths, "ppo.hidden_layers", format!("{:?}", p.hidden_layers), &expected)?;
        positive("ppo.clip_range", p.clip_range)?;
        not_negative("ppo.entropy_coefficient", p.entropy_coefficient)?;
        fraction("ppo.discount", p.discount)?;
        fraction("ppo.gae_lambda", p.gae_lambda)?;
        positive("ppo.desired_kl", p.desired_kl)?;
        let [low, high] = LOG_STD_RANGE.map(f64::from);
        within("ppo.initial_log_std", p.initial_log_std, low..=high, &format!("{low} to {high}"))?;
        not_negative("ppo.value_coefficient", p.value_coefficient)?;
        positive("ppo.max_gradient_norm", p.max_gradient_norm)?;
        positive("ppo.adam_epsilon", p.adam_epsilon)?;
        positive("ppo.min_learning_rate", p.min_learning_rate)?;
        positive("ppo.max_learning_rate", p.max_learning_rate)?;
        let rates = p.min_learning_rate..=p.max_learning_rate;
        let expected = "between min_learning_rate and max_learning_rate";
        within("ppo.initial_learning_rate", p.initial_learning_rate, rates, expected)?;
        require(self.run.checkpoint_every > 0, "run.checkpoint_every", self.run.checkpoint_every, "at least 1")?;
        require(self.run.keep_policy_every != Some(0), "run.keep_policy_every", 0, "at least 1")
    }
}

fn require(valid: bool, key: &'static str, found: impl ToString, expected: &str) -> Result<(), ValueError> {
    if valid { Ok(()) } else { Err(ValueError::Range { key, found: found.to_string(), expected: expected.to_owned() }) }
}

fn within<T: PartialOrd + ToString>(
    key: &'static str,
    value: T,
    range: RangeInclusive<T>,
    expected: &str,
) -> Result<(), ValueError> {
    require(range.contains(&value), key, value, expected)
}

fn positive(key: &'static str, value: f64) -> Result<(), ValueError> {
    require(value > 0.0 && value.is_finite(), key, value, "a positive number")
}

fn not_negative(key: &'static str, value: f64) -> Result<(), ValueError> {
    require(value >= 0.0 && value.is_finite(), key, value, "a number not below zero")
}

fn not_positive(key: &'static str, value: f64) -> Result<(), ValueError> {
    require(value <= 0.0 && value.is_finite(), key, value, "a number not above zero: what is weighted is a cost")
}

fn fraction(key: &'static str, value: f64) -> Result<(), ValueError> {
    within(key, value, 0.0..=1.0, "0 to 1")
}
