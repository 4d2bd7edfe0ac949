/*! Configuration of a training run: YAML in, checked types out.

Start with [`Config::load`] and `configs/compliant.yaml`, then read the sections ([`Config`] and its fields). Every number of the paper's
section III, Table II and Table III is a key without a default in code, except Adam's two decay rates. Keys beyond the paper have defaults
that change nothing, so that policies and checkpoints, which contain their configuration, remain readable; keys at their default are not
saved, so that programs that lack them can read the rest. A file may name another one as its `base` and state only the differences: the
baseline differs in one key from the compliant policy.
*/

mod check;
mod fit;
mod merge;
mod sections;
mod terrain;

use std::path::PathBuf;

use garde::Validate;
use serde::{Deserialize, Serialize};

pub use check::ValueError;
pub use sections::{
    Action, CommandRange, Episode, HeldFeet, LearnerKind, PerJoint, Ppo, Precision, Pulls, Randomisation, Reward,
    RobotModel, Run, Simulation,
};
pub use terrain::Terrain;
pub(crate) use terrain::{SPACING_M, TILE_M};

use crate::observation::{Layout, LayoutError, NominalValues, Observed};
use crate::robot::{JOINTS, Robot};
use crate::util::files;
use crate::util::yaml::{self, Text, Value, YamlError};
use merge::Merged;

/// Name and text of the configurations inside the program.
pub const EMBEDDED: &[(&str, &str)] = &[
    ("compliant", include_str!("../../configs/compliant.yaml")),
    ("baseline", include_str!("../../configs/baseline.yaml")),
    ("fast", include_str!("../../configs/fast.yaml")),
    ("fast-baseline", include_str!("../../configs/fast-baseline.yaml")),
    ("go2", include_str!("../../configs/go2.yaml")),
    ("go2-baseline", include_str!("../../configs/go2-baseline.yaml")),
    ("go2-real", include_str!("../../configs/go2-real.yaml")),
    ("real", include_str!("../../configs/real.yaml")),
];

/// Range of `ln σ`, far beyond the values of training: below it, log-densities lose their precision, above it, actions
/// are pure noise.
pub const LOG_STD_RANGE: [f32; 2] = [-7.0, 2.0];

/// The reason why a configuration was refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The name is neither a file nor an embedded configuration.
    #[error("there is no config {}: give a file, or one of: {known}", path.display())]
    Unknown {
        /// Path of the missing file.
        path: PathBuf,
        /// Names of the embedded configurations.
        known: String,
    },
    /// The file cannot be read.
    #[error("cannot read config {}: {source}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Reason given by the operating system.
        source: std::io::Error,
    },
    /// The text is not YAML, a key is unknown or missing, or a value has another type.
    #[error("config {0}")]
    Parse(#[from] YamlError),
    /// A value is outside its range.
    #[error("config {name}: {error}")]
    Value {
        /// Name of the file or embedded configuration, with the line if it is known.
        name: String,
        /// The invalid value and its key.
        error: ValueError,
    },
}

/// The keys in which two configurations differ.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}", .0.iter().map(|(key, [a, b])| format!("{key}: {a} and {b}")).collect::<Vec<_>>().join("; "))]
pub struct DifferenceError(
    /// Dotted keys with both values as YAML.
    pub Vec<(String, [String; 2])>,
);

/// A training configuration: everything that defines a run except its seed.
///
/// ```
/// use supple::config::Config;
///
/// let config = Config::load("compliant")?; // a shipped name, or the path of a YAML file
/// assert_eq!(config.simulation.policy_rate_hz, 60);
/// let changed = config.with(&["ppo.epochs=4".to_owned()])?; // checked like the file itself
/// assert_eq!(changed.ppo.epochs, 4);
/// assert!(config.with(&["ppo.epochs=0".to_owned()]).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct Config {
    /// The robot and its joint losses.
    #[garde(dive)]
    pub robot: RobotModel,
    /// Rates, gains, latency.
    #[garde(dive)]
    pub simulation: Simulation,
    /// The map from network outputs to joint targets.
    #[garde(dive)]
    pub action: Action,
    /// The entries of the observation, in order.
    #[garde(skip)]
    pub observation: Vec<Observed>,
    /// The entries that the critic observes in addition to the policy's observation, from the true state; they may be quantities that only
    /// the simulator has. None if the list is missing.
    #[serde(default)]
    #[garde(skip)]
    pub critic_observation: Vec<Observed>,
    /// Range of velocity commands, and its curriculum.
    #[garde(dive)]
    pub command: CommandRange,
    /// Stages, pushes, slopes, termination.
    #[garde(dive)]
    pub episode: Episode,
    /// Sustained pulls on the trunk; none if the section is missing.
    #[garde(dive)]
    pub pulls: Option<Pulls>,
    /// Feet that are held in their swing; none if the section is missing.
    #[garde(dive)]
    pub held_feet: Option<HeldFeet>,
    /// Uneven ground with a curriculum; a plane if the section is missing.
    #[garde(dive)]
    pub terrain: Option<Terrain>,
    /// Weights and targets of the reward (Table II).
    #[garde(dive)]
    pub reward: Reward,
    /// Randomisation of the dynamics and of the sensors.
    #[garde(dive)]
    pub randomisation: Randomisation,
    /// Settings of PPO (Table III).
    #[garde(dive)]
    pub ppo: Ppo,
    /// Length of the run, and how often it is saved.
    #[garde(dive)]
    pub run: Run,
}

impl Config {
    /// Builds the layout of the observation.
    ///
    /// # Errors
    /// An entry of the observation is invalid, or the observation is empty or too long.
    pub fn layout(&self) -> Result<Layout, LayoutError> {
        Layout::new(&self.observation, &self.nominal())
    }

    /// Builds the layout of what the critic observes in addition; `None` if it observes what the policy does.
    ///
    /// # Errors
    /// An entry of the list is invalid, or the list is too long.
    pub fn critic_layout(&self) -> Result<Option<Layout>, LayoutError> {
        let entries = &self.critic_observation;
        (!entries.is_empty()).then(|| Layout::for_critic(entries, &self.nominal())).transpose()
    }

    /// Returns the nominal values that offsets and scales refer to by name.
    pub fn nominal(&self) -> NominalValues {
        NominalValues {
            pose: self.action.nominal_pose_rad.joints(),
            height_m: self.reward.base_height_m,
            action_scale_rad: [self.action.scale_rad; JOINTS],
        }
    }

    /// Checks that this equals another configuration except for the length of the run.
    ///
    /// # Errors
    /// The configurations differ; the error lists the keys with both values.
    pub fn check_same(&self, other: &Config) -> Result<(), DifferenceError> {
        let differences = self.differences(other);
        if differences.is_empty() { Ok(()) } else { Err(DifferenceError(differences)) }
    }

    /// Loads an embedded configuration by name, or a YAML file by path.
    ///
    /// # Errors
    /// The file is missing or invalid, a key is unknown or missing, or a value is out of range; the error names file
    /// and key.
    pub fn load(name_or_path: &str) -> Result<Self, ConfigError> {
        Self::load_with(name_or_path, &[])
    }

    /// Loads a configuration like [`Config::load`] and changes some keys, each given as `ppo.epochs=4` and checked as
    /// in the file.
    ///
    /// # Errors
    /// The file is missing or invalid, a key is unknown or missing, or a value is out of range; the error names file
    /// and key.
    pub fn load_with(name_or_path: &str, changes: &[String]) -> Result<Self, ConfigError> {
        Ok(Self::load_with_notes(name_or_path, changes)?.0)
    }

    /// Loads a configuration like [`Config::load_with`], and returns notes about possible mistakes.
    ///
    /// # Errors
    /// Those of [`Config::load_with`].
    pub fn load_with_notes(name_or_path: &str, changes: &[String]) -> Result<(Self, Vec<String>), ConfigError> {
        let mut merged = Merged::load(name_or_path)?;
        changes.iter().try_for_each(|change| merged.change(change))?;
        Ok((Self::from_value(name_or_path, merged.value, &merged.texts)?, merged.notes))
    }

    /// Returns this configuration with other values for some keys, each given as `ppo.epochs=4`.
    ///
    /// # Errors
    /// A change is not of this form, its key is unknown, or its value is out of range.
    pub fn with(&self, changes: &[String]) -> Result<Self, ConfigError> {
        let name = "fitted to the robot";
        let mut merged = Merged::new(Text::new(name, &self.to_yaml()))?;
        changes.iter().try_for_each(|change| merged.change(change))?;
        Self::from_value(name, merged.value, &merged.texts)
    }

    /// Parses a complete YAML text without a `base`, as stored with a run.
    ///
    /// # Errors
    /// The text is not YAML, a key is unknown or missing, or a value is out of range.
    pub fn from_yaml(name: &str, text: &str) -> Result<Self, ConfigError> {
        let text = Text::new(name, text);
        Self::from_value(name, text.parse()?, &[text]).map_err(|mut error| {
            if let ConfigError::Parse(YamlError { message, .. }) = &mut error
                && let Some(explained) = files::of_another_version(message)
            {
                *message = explained;
            }
            error
        })
    }

    fn from_value(name: &str, value: Value, texts: &[Text]) -> Result<Self, ConfigError> {
        let config: Config = yaml::typed(value, texts)?;
        config.check().map_err(|error| {
            let name = match &error {
                ValueError::Range { key, .. } => yaml::place(texts, key),
                ValueError::Observation(_) | ValueError::Critic(_) => name.to_owned(),
            };
            ConfigError::Value { name, error }
        })?;
        Ok(config)
    }

    /// Lists the dotted keys in which another configuration differs, with both values as YAML. The length of the run
    /// and values that are left to the machine are not compared.
    pub fn differences(&self, other: &Config) -> Vec<(String, [String; 2])> {
        let mut other = Config { run: self.run.clone(), ..other.clone() };
        if [self.ppo.precision, other.ppo.precision].contains(&Precision::Auto) {
            other.ppo.precision = self.ppo.precision;
        }
        yaml::differences(self, &other)
    }

    /// Removes the folder from the path of a robot that does not ship, because policy files are used on other machines.
    pub fn without_folder(mut self) -> Self {
        if let (false, Some(name)) = (Robot::ships(&self.robot.model), PathBuf::from(&self.robot.model).file_name()) {
            self.robot.model = name.display().to_string();
        }
        self
    }

    /// Formats the complete configuration as YAML.
    pub fn to_yaml(&self) -> String {
        yaml::to_text(&yaml::without_defaults(self))
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

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
            (
                "scale_rad: 0.3",
                "scale_rad: .nan",
                "config test: action.scale_rad is NaN, expected a positive number up to 100",
            ),
            (
                "energy: -0.015",
                "energy: 0.015",
                "config test: reward.energy is 0.015, expected a number not above zero, from -1000000: it is the weight of a cost",
            ),
        ];
        for (from, to, message) in cases {
            let key = message.split(['.', ' ']).nth(3).unwrap();
            let is_key = |line: &str| line.trim_start().starts_with(&format!("{key}:"));
            let line = EMBEDDED[0].1.lines().position(is_key).unwrap() + 1;
            let message = message.replacen("config test:", &format!("config test, line {line}:"), 1);
            assert_eq!(changed(from, to).unwrap_err().to_string(), message);
        }
    }

    #[test]
    fn the_baseline_differs_in_one_key_and_the_length_of_a_run_is_none() {
        let (mut compliant, baseline) = (Config::load("compliant").unwrap(), Config::load("baseline").unwrap());
        compliant.run.samples = 1;
        let error = compliant.check_same(&baseline).unwrap_err();
        assert_eq!(error.to_string(), "episode.recovery_stage: true and false");
    }

    #[test]
    fn unknown_and_missing_keys_are_named() {
        let unknown = changed("latency_s: 0.030", "latency_s: 0.030\n  latencyy_s: 1").unwrap_err().to_string();
        assert!(unknown.contains("unknown field `latencyy_s`"), "{unknown}");
        let missing = changed("latency_s: 0.030", "").unwrap_err().to_string();
        assert!(missing.contains("missing field `latency_s`"), "{missing}");
    }

    #[test]
    fn single_keys_are_set_and_checked_as_in_the_file() {
        let with =
            |changes: &[&str]| Config::load_with("fast", &changes.iter().map(|c| (*c).to_owned()).collect::<Vec<_>>());
        let config =
            with(&["ppo.epochs=4", "ppo.hidden_layers=[8, 8]", "robot.model=x/y.xml", "ppo.symmetry=false"]).unwrap();
        assert_eq!((config.ppo.epochs, &config.ppo.hidden_layers[..]), (4, &[8, 8][..]));
        assert!(Path::new(&config.robot.model).is_absolute() && !config.ppo.symmetry);
        assert_eq!(with(&[]).unwrap(), Config::load("fast").unwrap());
        for (change, expected) in [
            ("ppo.epochs=0", "config --set ppo.epochs=0: ppo.epochs is 0, expected 1 to 1000"),
            ("ppo.epochs=2e7", "ppo.epochs: invalid type"),
            (
                "randomisation.latency_s=[0.04, 0.02]",
                "randomisation.latency_s is [0.04, 0.02], expected [shortest, longest], 0 to 1 s",
            ),
            (
                "pulls={force_n: 50, duration_s: [1, 2], gap_s: [1, 2], fraction_step: 0, fraction_gate: 0, buckets: [0.5, 0.2]}",
                "pulls.buckets is [0.5, 0.2], expected rising fractions, the last of them 1",
            ),
            ("randomisation.trunk_offset_m=1e308", ", expected 0 to 1 m"),
            (
                "ppo.hidden_layers=[4096, 4096]",
                "ppo.hidden_layers is [4096, 4096], a policy of 65.5 MiB, expected at most 56 MiB",
            ),
            ("observation=[{quantity: friction}]", "entry 1 (friction): only the simulator has it"),
            (
                "critic_observation=[{quantity: friction, scale: 0}]",
                "critic_observation: observation, entry 1 (friction)",
            ),
            (
                "ppo={learner: candle, shards: 4}",
                "ppo.shards is 4, which ppo.learner: candle does not use: leave the key out, or set ppo.learner: fused",
            ),
            ("ppo.epoch=4", "unknown field `epoch`"),
            ("epochs=4", "unknown field `epochs`"),
            ("ppo=4", "invalid type"),
            ("ppo.epochs", "expected KEY=VALUE"),
            ("ppo.epochs=}", "config --set ppo.epochs=}: "),
        ] {
            let error = with(&[change]).unwrap_err().to_string();
            assert!(error.contains(expected), "{change}: {error}");
        }
    }

    /// A configuration that states every optional section and key.
    fn every_key() -> Config {
        let changes = [
            "ppo.shards=2",
            "robot={friction_loss_n_m: 0.1, damping_n_m_s_per_rad: 0.1}",
            "run.keep_policy_every=1",
            "observation.append=[{quantity: clock_sin, frequency_hz: 2.0, phases: [0.5], steps_ago: 1, clip: 1.0}]",
            "terrain={environments: 0.5, levels: 6, rough_m: [0.01, 0.06], boxes_m: [0.02, 0.08], sharpness_factor: 0.5}",
        ];
        Config::load_with("real", &changes.map(str::to_owned)).unwrap()
    }

    /// Sets the number at a place, counted through all of a value, and returns the key that it belongs to.
    fn set_number(value: &mut Value, key: &str, place: &mut usize, number: f64) -> Option<String> {
        match value {
            Value::Number(old) if *place == 0 => {
                *old = number.into();
                Some(key.to_owned())
            }
            Value::Number(_) => {
                *place -= 1;
                None
            }
            Value::Sequence(values) => values.iter_mut().find_map(|value| set_number(value, key, place, number)),
            Value::Mapping(keys) => {
                keys.iter_mut().find_map(|(key, value)| set_number(value, key.as_str()?, place, number))
            }
            _ => None,
        }
    }

    #[test]
    fn every_number_has_bounds_that_its_error_names() {
        let all = yaml::to_value(&every_key());
        let with = |place: usize, number: f64| {
            let mut config = all.clone();
            set_number(&mut config, "", &mut place.clone(), number).map(|key| (key, config))
        };
        let mut places = 0;
        for (place, number) in (0..).flat_map(|place| [(place, 1e308), (place, -1e308)]) {
            let Some((key, config)) = with(place, number) else { break };
            let error =
                Config::from_value("test", config, &[]).err().map(|error| error.to_string()).unwrap_or_default();
            assert!(error.contains(&key) && error.contains("expected"), "{number:e} for {key}: {error}");
            places = place + 1;
        }
        assert!(places >= 140, "only {places} numbers");
    }

    #[test]
    fn no_optional_key_is_written_at_its_default() {
        let all = yaml::without_defaults(&every_key());
        let mut optional = 0;
        for without in (0..).map_while(|key| yaml::without_entry(&all, key)) {
            // It is required if it is missed.
            let Ok(config) = yaml::typed::<Config>(without.clone(), &[]) else { continue };
            assert_eq!(Text::new("written", &config.to_yaml()).parse().unwrap(), without);
            optional += 1;
        }
        assert!(optional >= 53, "only {optional} keys are optional");
    }

    #[test]
    fn key_of_another_version_is_explained_in_saved_files() {
        let text = Config::load("fast").unwrap().to_yaml().replace("  flight:", "  warmth: 1.0\n  flight:");
        let error = Config::from_yaml("runs/a/config.yaml", &text).unwrap_err().to_string();
        assert!(error.starts_with("config runs/a/config.yaml, line ") && error.ends_with(
            "reward.warmth: unknown field `warmth`: another version of Supple wrote this file; use that version, or remove the key"), "{error}");
    }
}
