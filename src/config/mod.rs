/*! Training configuration: YAML in, checked types out.

Every number of the paper's section III, Table II and Table III is a key of `configs/compliant.yaml`; but for Adam's two
decay rates, nothing has a default in code. A file may name another one as its `base` and state only what differs: the
baseline is one key away from the compliant policy, and reads so. This module is the only one that knows YAML.
*/

mod check;
mod yaml;

use std::fmt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_yaml::Value;

pub use check::ValueError;
pub use yaml::{flat_parameters, layered};
use yaml::{merged, parse};

/// The configurations inside the binary: name and text.
pub const EMBEDDED: &[(&str, &str)] = &[
    ("compliant", include_str!("../../configs/compliant.yaml")),
    ("baseline", include_str!("../../configs/baseline.yaml")),
    ("fast", include_str!("../../configs/fast.yaml")),
    ("fast-baseline", include_str!("../../configs/fast-baseline.yaml")),
    ("hardware", include_str!("../../configs/hardware.yaml")),
    ("hardware-baseline", include_str!("../../configs/hardware-baseline.yaml")),
];

/// Name of the robot inside the binary.
pub const GO1_NAME: &str = "go1";

/// `ln σ` is kept within this range, far from where training goes: below it, log-densities lose their precision, above
/// it, actions are nothing but noise.
pub const LOG_STD_RANGE: [f32; 2] = [-7.0, 2.0];

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
    #[error("config {name}: {error}")]
    Value {
        /// File or embedded name.
        name: String,
        /// Which one.
        error: ValueError,
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
    /// Mean `r_lin` of an iteration's walking stages above which episodes go on to the push, from then on.
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

/// A key in which two configurations differ.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// Dotted key.
    pub key: String,
    /// Its value in the one and in the other, as YAML.
    pub values: [String; 2],
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [ours, theirs] = &self.values;
        write!(f, "{}: {ours} and {theirs}", self.key)
    }
}

impl Config {
    /// Checks that this is the same as another configuration but for the length of the run.
    ///
    /// # Errors
    /// In words: the keys in which they differ, with both values.
    pub fn check_same(&self, other: &Config) -> Result<(), String> {
        let differences: Vec<String> = self.differences(other).iter().map(Difference::to_string).collect();
        if differences.is_empty() { Ok(()) } else { Err(differences.join("; ")) }
    }

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
        config.check().map_err(|error| ConfigError::Value { name: name.to_owned(), error })?;
        Ok(config)
    }

    /// Where this configuration and another one differ. The length of the run is not looked at.
    pub fn differences(&self, other: &Config) -> Vec<Difference> {
        let other = Config { run: self.run.clone(), ..other.clone() };
        // Plain structs of numbers and strings: serialising them cannot fail.
        let [ours, theirs] = [self, &other].map(|config| serde_yaml::to_value(config).unwrap_or_default());
        yaml::differences("", &ours, &theirs)
    }

    /// The complete configuration as YAML.
    pub fn to_yaml(&self) -> String {
        // Plain structs of numbers and strings: serialising them cannot fail.
        serde_yaml::to_string(self).unwrap_or_default()
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
                "config test: episode.walking_s is -1, expected at least one policy step and at most an hour",
            ),
            (
                "policy_rate_hz: 60",
                "policy_rate_hz: 70",
                "config test: simulation.physics_rate_hz is 240, expected a multiple of policy_rate_hz (70 Hz) up to 20000, such as 280",
            ),
            (
                "environments: 64",
                "environments: 60",
                "config test: ppo.environments is 60, expected a divisor of ppo.batch_size (8192)",
            ),
            ("scale_rad: 0.3", "scale_rad: .nan", "config test: action.scale_rad is NaN, expected a positive number"),
            (
                "energy: -0.015",
                "energy: 0.015",
                "config test: reward.energy is 0.015, expected a number not above zero: what is weighted is a cost",
            ),
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
        let expected = "ppo.mirror is true, expected false, unless the hip of action.nominal_pose_rad is 0";
        assert_eq!(error, expected);
    }

    #[test]
    fn the_baseline_differs_in_one_key_and_the_length_of_a_run_is_none() {
        let (mut compliant, baseline) = (Config::load("compliant").unwrap(), Config::load("baseline").unwrap());
        compliant.run.samples = 1;
        assert_eq!(compliant.check_same(&baseline).unwrap_err(), "episode.recovery_stage: true and false");
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
