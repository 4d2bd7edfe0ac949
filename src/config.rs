/*! Training configuration: YAML in, checked types out.

Every number of the paper's section III, Table II and Table III is a key of `configs/compliant.yaml`; nothing has a
default in code. A file may name another one as its `base` and state only what differs: the baseline is one key away
from the compliant policy, and reads so. This module is the only one that knows YAML.
*/

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_yaml::Value;

/// The configurations inside the binary: name and text.
pub const EMBEDDED: &[(&str, &str)] = &[
    ("compliant", include_str!("../configs/compliant.yaml")),
    ("baseline", include_str!("../configs/baseline.yaml")),
    ("fast", include_str!("../configs/fast.yaml")),
    ("fast-baseline", include_str!("../configs/fast-baseline.yaml")),
    ("hardware", include_str!("../configs/hardware.yaml")),
    ("hardware-baseline", include_str!("../configs/hardware-baseline.yaml")),
];

/// Physics steps per second beyond which nothing is gained and a delay would need a long queue.
const MAX_PHYSICS_RATE_HZ: u32 = 20_000;
/// Longest stage of an episode \[s\].
const MAX_STAGE_S: f64 = 3600.0;

/// How deep `base` may be nested.
const MAX_BASES: usize = 8;

/// Why a configuration was refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read config {}: {source}; the embedded ones are: {known}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
        /// Names of the embedded configurations.
        known: String,
    },
    /// Not YAML, an unknown key, a missing key or a wrong type.
    #[error("config {name}: {message}")]
    Parse {
        /// File or embedded name.
        name: String,
        /// Position and reason.
        message: String,
    },
    /// A value outside its range.
    #[error("config key {key} is {found}, expected {expected}")]
    Value {
        /// Dotted key.
        key: &'static str,
        /// What was found.
        found: String,
        /// What would be valid.
        expected: String,
    },
}

/// Everything that defines a training run but its seed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The robot.
    pub robot: Robot,
    /// Rates, gains, latency.
    pub simulation: Simulation,
    /// From network outputs to joint targets.
    pub action: Action,
    /// Scaling of the observation.
    pub observation: Observation,
    /// Velocity commands and their curriculum.
    pub command: CommandRange,
    /// Stages, pushes, slopes, termination.
    pub episode: Episode,
    /// Weights and targets of Table II.
    pub reward: Reward,
    /// Dynamics randomisation.
    pub randomisation: Randomisation,
    /// Table III.
    pub ppo: Ppo,
    /// Length of the run.
    pub run: Run,
}

/// The robot's model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Robot {
    /// Name of an embedded model or path of an MJCF file.
    pub model: String,
}

/// Section IV: physics at 240 Hz, policy at 60 Hz, PD control with delayed targets.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Simulation {
    /// Physics steps per second.
    pub physics_rate_hz: u32,
    /// Policy queries per second; divides the physics rate.
    pub policy_rate_hz: u32,
    /// `K_p` [N·m/rad].
    pub kp_n_m_per_rad: f64,
    /// `K_d` [N·m·s/rad].
    pub kd_n_m_s_per_rad: f64,
    /// Delay of the joint target \[s\].
    pub latency_s: f64,
}

impl Simulation {
    /// Physics steps per policy step.
    pub fn substeps(&self) -> usize {
        (self.physics_rate_hz / self.policy_rate_hz) as usize
    }

    /// Duration of a physics step \[s\].
    pub fn timestep_s(&self) -> f64 {
        1.0 / f64::from(self.physics_rate_hz)
    }

    /// Duration of a policy step \[s\].
    pub fn policy_period_s(&self) -> f64 {
        1.0 / f64::from(self.policy_rate_hz)
    }

    /// Policy steps in a duration.
    pub fn policy_steps(&self, duration_s: f64) -> usize {
        (duration_s * f64::from(self.policy_rate_hz)).round() as usize
    }
}

/// Joint target = nominal pose + scale · action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Action {
    /// Hip, thigh and calf of every leg \[rad\].
    pub nominal_pose_rad: [f64; 3],
    /// \[rad\] per unit of action.
    pub scale_rad: f64,
}

/// What the networks see is (raw − offset) · scale.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Observation {
    /// [1/m]
    pub height_scale: f64,
    /// [s²/m]
    pub gravity_scale: f64,
    /// [1/rad]
    pub joint_angle_scale: f64,
    /// [s/m]
    pub velocity_scale: f64,
    /// [s/rad]
    pub angular_velocity_scale: f64,
    /// [s/rad]
    pub joint_rate_scale: f64,
}

/// Commands are drawn uniformly from ± range · share.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandRange {
    /// `v_z*` of the paper [m/s].
    pub forward_m_s: f64,
    /// `v_x*` of the paper [m/s].
    pub left_m_s: f64,
    /// `ω_y*` of the paper [rad/s].
    pub yaw_rad_s: f64,
    /// Share of the range that is open at first.
    pub initial_share: f64,
    /// Widening per iteration.
    pub share_step: f64,
    /// Mean `r_lin` above which it is widened.
    pub share_gate: f64,
}

/// Section III-C and III-D.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Episode {
    /// Duration of the walking stage \[s\].
    pub walking_s: f64,
    /// Duration of the recovery stage, which starts with the push \[s\].
    pub recovery_s: f64,
    /// Duration of the post-recovery stage \[s\].
    pub post_recovery_s: f64,
    /// Whether tracking rewards are replaced in the recovery stage; false is the baseline.
    pub recovery_stage: bool,
    /// Mean `r_lin` of the walking stage below which the episode ends without a push.
    pub push_gate: f64,
    /// Largest push along forward and left [m/s].
    pub push_speed_m_s: f64,
    /// Largest rotational push about each axis [rad/s].
    pub push_rate_rad_s: f64,
    /// Largest incline (rise over run).
    pub slope: f64,
    /// Base height below which the robot has fallen \[m\].
    pub min_height_m: f64,
}

/// Table II and equations 1–3.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reward {
    /// `w_lin`.
    pub linear_velocity: f64,
    /// `w_ang`.
    pub angular_velocity: f64,
    /// `w_e`.
    pub energy: f64,
    /// `w_τ`.
    pub torque: f64,
    /// `w_pose`.
    pub pose: f64,
    /// `w_cl`.
    pub foot_clearance: f64,
    /// `w_h`.
    pub foot_height: f64,
    /// `w_f`, not in the paper: time in flight.
    // Policy files from before it keep their bytes, which are their identity.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub flight: f64,
    /// The 8 in `r_lin` and `r_ang`.
    pub tracking_sharpness: f64,
    /// The 10 in `r_pose` [1/m²].
    pub height_sharpness: f64,
    /// The 0.45 of equation 3.
    pub negative_sharpness: f64,
    /// `y_des` \[m\].
    pub base_height_m: f64,
    /// `p_des` \[m\].
    pub foot_height_m: f64,
}

/// Whether a key may be left out of a file.
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// Section IV-D.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Randomisation {
    /// Off for the simulation experiments.
    pub enabled: bool,
    /// Range of the floor's sliding friction.
    pub friction: [f64; 2],
    /// Standard deviation of the encoders' calibration offsets \[rad\].
    pub joint_offset_sd_rad: f64,
    /// Sliding friction when randomisation is off.
    pub default_friction: f64,
}

/// Table III and what Stable-Baselines3 does where the paper is silent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ppo {
    /// Samples per iteration.
    pub batch_size: usize,
    /// Samples per gradient step.
    pub minibatch_size: usize,
    /// Passes over the batch.
    pub epochs: usize,
    /// Whether half of the samples are learnt from in the [mirror](crate::mirror).
    pub mirror: bool,
    /// Clip range of the probability ratio.
    pub clip_range: f64,
    /// Weight of the entropy bonus.
    pub entropy_coefficient: f64,
    /// γ.
    pub discount: f64,
    /// λ of generalised advantage estimation.
    pub gae_lambda: f64,
    /// KL divergence at which the learning rate aims.
    pub desired_kl: f64,
    /// Logarithm of the initial standard deviation.
    pub initial_log_std: f64,
    /// Widths of the hidden layers of both networks.
    pub hidden_layers: Vec<usize>,
    /// Parallel environments; divides the batch size.
    pub environments: usize,
    /// Weight of the value loss.
    pub value_coefficient: f64,
    /// Largest norm of the joint gradient.
    pub max_gradient_norm: f64,
    /// ε of Adam.
    pub adam_epsilon: f64,
    /// Learning rate of the first gradient step.
    pub initial_learning_rate: f64,
    /// Lower bound of the adaptive rate.
    pub min_learning_rate: f64,
    /// Upper bound of the adaptive rate.
    pub max_learning_rate: f64,
}

impl Ppo {
    /// Steps of each environment in a batch.
    pub fn steps(&self) -> usize {
        self.batch_size / self.environments
    }
}

/// Length of the run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Run {
    /// Samples in all.
    pub samples: u64,
    /// Iterations between checkpoints.
    pub checkpoint_every: u64,
}

impl Config {
    /// Loads an embedded configuration by name, or a file.
    ///
    /// # Errors
    /// [`ConfigError`] that names the file or key, what was found and what was expected.
    pub fn load(name_or_path: &str) -> Result<Self, ConfigError> {
        Self::from_value(name_or_path, merged(name_or_path, Path::new(""), MAX_BASES)?)
    }

    /// Parses YAML without a `base`, as stored with a run.
    ///
    /// # Errors
    /// See [`Config::load`].
    pub fn from_yaml(name: &str, text: &str) -> Result<Self, ConfigError> {
        Self::from_value(name, parse(name, text)?)
    }

    fn from_value(name: &str, value: Value) -> Result<Self, ConfigError> {
        let config: Config = serde_yaml::from_value(value)
            .map_err(|error| ConfigError::Parse { name: name.to_owned(), message: error.to_string() })?;
        config.check()?;
        Ok(config)
    }

    /// The complete configuration as YAML.
    pub fn to_yaml(&self) -> String {
        // Plain structs of numbers and strings: serialising them cannot fail.
        serde_yaml::to_string(self).unwrap_or_default()
    }

    /// Checks every value's range: for configurations that come from elsewhere than YAML.
    ///
    /// # Errors
    /// [`ConfigError::Value`] that names the key.
    pub fn check(&self) -> Result<(), ConfigError> {
        let s = &self.simulation;
        let rate = (1..=1000).contains(&s.policy_rate_hz);
        require(rate, "simulation.policy_rate_hz", s.policy_rate_hz, "1 to 1000 Hz")?;
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
        require((0.0..=1.0).contains(&s.latency_s), "simulation.latency_s", s.latency_s, "0 to 1 s")?;
        not_negative("simulation.kp_n_m_per_rad", s.kp_n_m_per_rad)?;
        not_negative("simulation.kd_n_m_s_per_rad", s.kd_n_m_s_per_rad)?;

        let angles = self.action.nominal_pose_rad.iter().all(|angle| angle.is_finite());
        require(angles, "action.nominal_pose_rad", format!("{:?}", self.action.nominal_pose_rad), "finite angles")?;
        positive("action.scale_rad", self.action.scale_rad)?;
        let o = &self.observation;
        positive("observation.height_scale", o.height_scale)?;
        positive("observation.gravity_scale", o.gravity_scale)?;
        positive("observation.joint_angle_scale", o.joint_angle_scale)?;
        positive("observation.velocity_scale", o.velocity_scale)?;
        positive("observation.angular_velocity_scale", o.angular_velocity_scale)?;
        positive("observation.joint_rate_scale", o.joint_rate_scale)?;

        let c = &self.command;
        not_negative("command.forward_m_s", c.forward_m_s)?;
        not_negative("command.left_m_s", c.left_m_s)?;
        not_negative("command.yaw_rad_s", c.yaw_rad_s)?;
        share("command.initial_share", c.initial_share)?;
        share("command.share_step", c.share_step)?;
        share("command.share_gate", c.share_gate)?;

        let e = &self.episode;
        let period = s.policy_period_s();
        require(
            (period..=MAX_STAGE_S).contains(&e.walking_s),
            "episode.walking_s",
            e.walking_s,
            "at least one policy step and at most an hour",
        )?;
        let stage = 0.0..=MAX_STAGE_S;
        require(stage.contains(&e.recovery_s), "episode.recovery_s", e.recovery_s, "0 to 3600 s")?;
        require(stage.contains(&e.post_recovery_s), "episode.post_recovery_s", e.post_recovery_s, "0 to 3600 s")?;
        share("episode.push_gate", e.push_gate)?;
        not_negative("episode.push_speed_m_s", e.push_speed_m_s)?;
        not_negative("episode.push_rate_rad_s", e.push_rate_rad_s)?;
        share("episode.slope", e.slope)?;
        not_negative("episode.min_height_m", e.min_height_m)?;
        let weights = &self.reward;
        finite("reward.linear_velocity", weights.linear_velocity)?;
        finite("reward.angular_velocity", weights.angular_velocity)?;
        finite("reward.energy", weights.energy)?;
        finite("reward.torque", weights.torque)?;
        finite("reward.pose", weights.pose)?;
        finite("reward.foot_clearance", weights.foot_clearance)?;
        finite("reward.foot_height", weights.foot_height)?;
        finite("reward.flight", weights.flight)?;
        finite("reward.tracking_sharpness", weights.tracking_sharpness)?;
        finite("reward.height_sharpness", weights.height_sharpness)?;
        finite("reward.negative_sharpness", weights.negative_sharpness)?;
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
        not_negative("randomisation.joint_offset_sd_rad", r.joint_offset_sd_rad)?;
        positive("randomisation.default_friction", r.default_friction)?;

        let p = &self.ppo;
        require(
            p.environments > 0 && p.batch_size > 0 && p.batch_size.is_multiple_of(p.environments),
            "ppo.environments",
            p.environments,
            &format!("a divisor of ppo.batch_size ({})", p.batch_size),
        )?;
        require(
            p.minibatch_size > 1 && p.minibatch_size <= p.batch_size,
            "ppo.minibatch_size",
            p.minibatch_size,
            &format!("2 to ppo.batch_size ({})", p.batch_size),
        )?;
        require(p.epochs > 0, "ppo.epochs", p.epochs, "at least 1")?;
        let upright = self.action.nominal_pose_rad[0] == 0.0;
        require(!p.mirror || upright, "ppo.mirror", p.mirror, "false, unless the hip of action.nominal_pose_rad is 0")?;
        let widths = !p.hidden_layers.is_empty() && p.hidden_layers.iter().all(|width| (1..=4096).contains(width));
        require(widths, "ppo.hidden_layers", format!("{:?}", p.hidden_layers), "one or more widths from 1 to 4096")?;
        positive("ppo.clip_range", p.clip_range)?;
        not_negative("ppo.entropy_coefficient", p.entropy_coefficient)?;
        share("ppo.discount", p.discount)?;
        share("ppo.gae_lambda", p.gae_lambda)?;
        positive("ppo.desired_kl", p.desired_kl)?;
        finite("ppo.initial_log_std", p.initial_log_std)?;
        not_negative("ppo.value_coefficient", p.value_coefficient)?;
        positive("ppo.max_gradient_norm", p.max_gradient_norm)?;
        positive("ppo.adam_epsilon", p.adam_epsilon)?;
        positive("ppo.min_learning_rate", p.min_learning_rate)?;
        positive("ppo.max_learning_rate", p.max_learning_rate)?;
        require(
            (p.min_learning_rate..=p.max_learning_rate).contains(&p.initial_learning_rate),
            "ppo.initial_learning_rate",
            p.initial_learning_rate,
            "between min_learning_rate and max_learning_rate",
        )?;
        require(self.run.checkpoint_every > 0, "run.checkpoint_every", self.run.checkpoint_every, "at least 1")
    }
}

/// A flat YAML mapping as names and values in text, for files that stand for command-line flags.
///
/// # Errors
/// [`ConfigError::Parse`] if it is anything but a mapping of names to numbers, texts or truth values.
pub fn flat_parameters(name: &str, text: &str) -> Result<Vec<(String, String)>, ConfigError> {
    let problem = |message: String| ConfigError::Parse { name: name.to_owned(), message };
    let value = parse(name, text)?;
    let mapping = value.as_mapping().ok_or_else(|| problem("expected lines of the form `name: value`".into()))?;
    let entry = |(key, value): (&Value, &Value)| {
        let key = key.as_str().ok_or_else(|| problem(format!("{key:?} is not a name")))?;
        match value {
            Value::Number(number) => Ok((key.to_owned(), number.to_string())),
            Value::String(text) => Ok((key.to_owned(), text.clone())),
            Value::Bool(truth) => Ok((key.to_owned(), truth.to_string())),
            _ => Err(problem(format!("{key} must be a number, a text or true or false"))),
        }
    };
    mapping.iter().map(entry).collect()
}

/// YAML texts laid over one another, later ones over earlier ones, as a checked type.
///
/// # Errors
/// [`ConfigError::Parse`] with the name and the reason.
pub fn layered<T: serde::de::DeserializeOwned>(name: &str, layers: &[&str]) -> Result<T, ConfigError> {
    let mut whole = Value::Mapping(serde_yaml::Mapping::new());
    for text in layers {
        overlay(&mut whole, parse(name, text)?);
    }
    serde_yaml::from_value(whole)
        .map_err(|error| ConfigError::Parse { name: name.to_owned(), message: error.to_string() })
}

fn require(valid: bool, key: &'static str, found: impl ToString, expected: &str) -> Result<(), ConfigError> {
    if valid {
        Ok(())
    } else {
        Err(ConfigError::Value { key, found: found.to_string(), expected: expected.to_owned() })
    }
}

fn positive(key: &'static str, value: f64) -> Result<(), ConfigError> {
    require(value > 0.0 && value.is_finite(), key, value, "a positive number")
}

fn not_negative(key: &'static str, value: f64) -> Result<(), ConfigError> {
    require(value >= 0.0 && value.is_finite(), key, value, "a number not below zero")
}

fn finite(key: &'static str, value: f64) -> Result<(), ConfigError> {
    require(value.is_finite(), key, value, "a finite number")
}

fn share(key: &'static str, value: f64) -> Result<(), ConfigError> {
    require((0.0..=1.0).contains(&value), key, value, "0 to 1")
}

fn parse(name: &str, text: &str) -> Result<Value, ConfigError> {
    serde_yaml::from_str(text).map_err(|error| ConfigError::Parse { name: name.to_owned(), message: error.to_string() })
}

/// Reads a configuration and lays it over its base. `folder` is where relative paths start.
fn merged(name_or_path: &str, folder: &Path, bases_left: usize) -> Result<Value, ConfigError> {
    let embedded = EMBEDDED.iter().find(|(name, _)| *name == name_or_path);
    let path = folder.join(name_or_path);
    let text = match embedded {
        Some((_, text)) => (*text).to_owned(),
        None => std::fs::read_to_string(&path).map_err(|source| ConfigError::Read {
            path: path.clone(),
            source,
            known: EMBEDDED.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", "),
        })?,
    };
    let mut value = parse(name_or_path, &text)?;
    let base = value.as_mapping_mut().and_then(|mapping| mapping.remove("base"));
    let Some(base) = base else { return Ok(value) };
    let problem = |message: &str| ConfigError::Parse { name: name_or_path.to_owned(), message: message.to_owned() };
    let base = base.as_str().ok_or_else(|| problem("`base` must be a config's name or path"))?;
    if bases_left == 0 {
        return Err(problem("`base` is nested too deep: does a config name itself?"));
    }
    let mut whole = merged(base, path.parent().unwrap_or(folder), bases_left - 1)?;
    overlay(&mut whole, value);
    Ok(whole)
}

/// Replaces in `base` what `change` states; mappings are merged key by key.
fn overlay(base: &mut Value, change: Value) {
    match (base, change) {
        (Value::Mapping(base), Value::Mapping(change)) => {
            for (key, value) in change {
                match base.get_mut(&key) {
                    Some(slot) => overlay(slot, value),
                    None => drop(base.insert(key, value)),
                }
            }
        }
        (slot, change) => *slot = change,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn changed(from: &str, to: &str) -> Result<Config, ConfigError> {
        let text = EMBEDDED[0].1;
        assert!(text.contains(from), "{from}");
        Config::from_yaml("test", &text.replacen(from, to, 1))
    }

    #[test]
    fn every_embedded_config_loads_and_survives_a_round_trip() {
        for (name, _) in EMBEDDED {
            let config = Config::load(name).unwrap();
            assert_eq!(Config::from_yaml(name, &config.to_yaml()).unwrap(), config);
        }
    }

    #[test]
    fn baseline_is_one_key_apart_from_compliant() {
        let mut config = Config::load("baseline").unwrap();
        assert!(!config.episode.recovery_stage);
        config.episode.recovery_stage = true;
        assert_eq!(config, Config::load("compliant").unwrap());
    }

    #[test]
    fn compliant_states_table_three() {
        let ppo = Config::load("compliant").unwrap().ppo;
        assert_eq!((ppo.batch_size, ppo.minibatch_size, ppo.epochs), (8192, 512, 30));
        assert_eq!((ppo.clip_range, ppo.entropy_coefficient, ppo.discount, ppo.gae_lambda), (0.2, 0.01, 0.99, 0.95));
        assert_eq!((ppo.desired_kl, ppo.initial_log_std), (0.02, -1.0));
        assert_eq!(ppo.hidden_layers, [256, 128, 64]);
    }

    #[test]
    fn bad_values_name_the_key_and_what_was_expected() {
        let cases = [
            (
                "walking_s: 2.0",
                "walking_s: -1",
                "config key episode.walking_s is -1, expected at least one policy step and at most an hour",
            ),
            (
                "policy_rate_hz: 60",
                "policy_rate_hz: 70",
                "config key simulation.physics_rate_hz is 240, expected a multiple of policy_rate_hz (70 Hz) up to 20000, such as 280",
            ),
            (
                "environments: 64",
                "environments: 60",
                "config key ppo.environments is 60, expected a divisor of ppo.batch_size (8192)",
            ),
            ("scale_rad: 0.3", "scale_rad: .nan", "config key action.scale_rad is NaN, expected a positive number"),
        ];
        for (from, to, message) in cases {
            assert_eq!(changed(from, to).unwrap_err().to_string(), message);
        }
    }

    #[test]
    fn a_pose_that_leans_to_one_side_has_no_mirror_image() {
        let mut config = Config::load("fast").unwrap();
        config.action.nominal_pose_rad[0] = 0.1;
        let error = config.check().unwrap_err().to_string();
        let expected = "config key ppo.mirror is true, expected false, unless the hip of action.nominal_pose_rad is 0";
        assert_eq!(error, expected);
    }

    #[test]
    fn unknown_and_missing_keys_are_named() {
        let unknown = changed("latency_s: 0.030", "latency_s: 0.030\n  latencyy_s: 1").unwrap_err().to_string();
        assert!(unknown.contains("unknown field `latencyy_s`"), "{unknown}");
        let missing = changed("latency_s: 0.030", "").unwrap_err().to_string();
        assert!(missing.contains("missing field `latency_s`"), "{missing}");
    }

    #[test]
    fn a_config_that_is_its_own_base_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("loop.yaml");
        std::fs::write(&path, "base: loop.yaml\n").unwrap();
        let error = Config::load(path.to_str().unwrap()).unwrap_err().to_string();
        assert!(error.contains("nested too deep"), "{error}");
    }
}
