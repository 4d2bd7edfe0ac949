/*! Configuration of a training run: YAML in, checked types out.

Start with [`Config::load`] and `configs/compliant.yaml`, then read the sections ([`Config`] and its fields). Every
number of the paper's section III, Table II and Table III is a key without a default in code, except Adam's two decay rates.
Keys beyond the paper have defaults that change nothing, so that policies and checkpoints, which contain their configuration,
remain readable. A file may name another one as its `base` and state only the differences: the baseline differs in one key from
the compliant policy.
*/

mod check;
mod fit;
mod sections;
mod terrain;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

pub use check::ValueError;
pub use sections::{
    Action, CommandRange, Config, Episode, Gain, HeldFeet, LearnerKind, LegPose, Ppo, Precision, Pulls, Randomisation,
    Reward, RobotModel, Run, Simulation, Terrain,
};
pub(crate) use terrain::{SPACING_M, TILE_M};

use crate::robot::Robot;
use crate::util::files;
use crate::util::yaml::{self, Text, Value, YamlError};

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

/// Maximum depth of nested `base` keys.
const MAX_BASES: usize = 8;

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

impl Config {
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

    /// Loads a configuration like [`Config::load_with`], and returns notes about what its author may not have meant.
    ///
    /// # Errors
    /// Those of [`Config::load_with`].
    pub fn load_with_notes(name_or_path: &str, changes: &[String]) -> Result<(Self, Vec<String>), ConfigError> {
        let (mut texts, mut notes) = (Vec::new(), Vec::new());
        let value = merged(name_or_path, Path::new(""), MAX_BASES, &mut texts, &mut notes)?;
        Ok((Self::changed(name_or_path, value, texts, changes, &mut notes)?, notes))
    }

    /// Returns this configuration with other values for some keys, each given as `ppo.epochs=4`.
    ///
    /// # Errors
    /// A change is not of this form, its key is unknown, or its value is out of range.
    pub fn with(&self, changes: &[String]) -> Result<Self, ConfigError> {
        let text = Text::new("fitted to the robot", &self.to_yaml());
        Self::changed("fitted to the robot", text.parse()?, vec![text], changes, &mut Vec::new())
    }

    fn changed(
        name: &str,
        mut value: Value,
        mut texts: Vec<Text>,
        changes: &[String],
        notes: &mut Vec<String>,
    ) -> Result<Self, ConfigError> {
        for change in changes {
            let text = changing(change)?;
            let mut change = text.parse()?;
            resolve_robot(&mut change, Path::new(""));
            notes.extend(resolve_lists(Some(&value), &mut change, &text)?);
            yaml::overlay(&mut value, change);
            texts.insert(0, text);
        }
        Self::from_value(name, value, &texts)
    }

    /// Parses a complete YAML text without a `base`, as stored with a run.
    ///
    /// # Errors
    /// The text is not YAML, a key is unknown or missing, or a value is out of range.
    pub fn from_yaml(name: &str, text: &str) -> Result<Self, ConfigError> {
        let text = Text::new(name, text);
        Self::from_value(name, text.parse()?, &[text]).map_err(|error| match error {
            ConfigError::Parse(YamlError { name, line, message }) => {
                let message = files::of_another_version(&message).unwrap_or(message);
                ConfigError::Parse(YamlError { name, line, message })
            }
            other => other,
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
        yaml::differences(&self.all_keys(), &other.all_keys())
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
        yaml::to_text(self)
    }
}

/// Reads a configuration and merges it into its base. Relative paths start at `folder`; the texts read are added to
/// `texts`, and notes about them to `notes`.
fn merged(
    name_or_path: &str,
    folder: &Path,
    bases_left: usize,
    texts: &mut Vec<Text>,
    notes: &mut Vec<String>,
) -> Result<Value, ConfigError> {
    let embedded = EMBEDDED.iter().find(|(name, _)| *name == name_or_path);
    let path = folder.join(PathBuf::from(name_or_path));
    let text = match embedded {
        Some((name, text)) => Text::new(name, text),
        None => Text::read(&path).map_err(|source| {
            let path = path.clone();
            if source.kind() != std::io::ErrorKind::NotFound {
                return ConfigError::Read { path, source };
            }
            let known: Vec<&str> = EMBEDDED.iter().map(|(name, _)| *name).collect();
            ConfigError::Unknown { path, known: known.join(", ") }
        })?,
    };
    let mut value = text.parse()?;
    texts.push(text.clone());
    if embedded.is_none() {
        resolve_robot(&mut value, &path);
    }
    let base = value.as_mapping_mut().and_then(|mapping| mapping.remove("base"));
    let Some(base) = base else {
        resolve_lists(None, &mut value, &text)?;
        return Ok(value);
    };
    let problem = |message: &str| YamlError::new(name_or_path, message);
    let base = base.as_str().ok_or_else(|| problem("`base` must be a config's name or path"))?;
    if bases_left == 0 {
        return Err(problem("`base` is nested too deep: does a config name itself?").into());
    }
    let mut whole = merged(base, path.parent().unwrap_or(folder), bases_left - 1, texts, notes)?;
    let found = resolve_lists(Some(&whole), &mut value, &text)?;
    // The shipped ones mean it.
    notes.extend(found.into_iter().filter(|_| embedded.is_none()));
    yaml::overlay(&mut whole, value);
    Ok(whole)
}

/// Keys of the lists of quantities, which a configuration may state as `{append: [...]}`.
const LISTS: [&str; 2] = ["observation", "critic_observation"];

/// Replaces `{append: [...]}` by the list of the base with these entries at its end. Returns a note for each list that lacks
/// quantities of the base's.
fn resolve_lists(base: Option<&Value>, value: &mut Value, text: &Text) -> Result<Vec<String>, YamlError> {
    let mut notes = Vec::new();
    for key in LISTS {
        let of_base = base.and_then(|base| base.get(key)).and_then(Value::as_sequence).cloned().unwrap_or_default();
        match value.get_mut(key) {
            Some(Value::Sequence(list)) => {
                let is_dropped = |entry: &&Value| !list.iter().any(|own| own.get("quantity") == entry.get("quantity"));
                let dropped = of_base.iter().filter(is_dropped).filter_map(|entry| entry.get("quantity")?.as_str());
                let dropped: Vec<&str> = dropped.collect::<BTreeSet<_>>().into_iter().collect();
                if !dropped.is_empty() {
                    let (place, dropped) = (yaml::place(std::slice::from_ref(text), key), dropped.join(", "));
                    notes.push(format!(
                        "{place}: {key} replaces the list of its base and drops {dropped}; to add to that list, write \
                         {key}: {{append: [...]}}"
                    ));
                }
            }
            Some(Value::Mapping(mapping)) => {
                let problem = |problem: &str| text.error(key, problem);
                if let Some(other) = mapping.keys().find(|key| key.as_str() != Some("append")) {
                    let other = yaml::to_text(other);
                    return Err(problem(&format!("unknown key `{}`, expected a list, or `append`", other.trim_end())));
                }
                if base.is_none() {
                    return Err(problem(
                        "`append` adds to the list of a `base`, which is missing: name one, or state the list",
                    ));
                }
                let Some(Value::Sequence(added)) = mapping.get("append") else {
                    return Err(problem("expected a list after `append`"));
                };
                let list = of_base.into_iter().chain(added.iter().cloned()).collect();
                value[key] = Value::Sequence(list);
            }
            _ => (),
        }
    }
    Ok(notes)
}

/// Turns a change such as `ppo.epochs=4` into the YAML text that states it.
fn changing(change: &str) -> Result<Text, YamlError> {
    let name = format!("--set {change}");
    let Some((key, value)) = change.split_once('=').filter(|(key, _)| !key.is_empty()) else {
        return Err(YamlError::new(&name, "expected KEY=VALUE, as in ppo.epochs=4"));
    };
    let depth = key.split('.').count();
    let opened: String = key.split('.').map(|part| format!("{{{part}: ")).collect();
    Ok(Text::of_flag(&name, &format!("{opened}{value}{}", "}".repeat(depth))))
}

/// Makes the path of a robot's file relative to the folder of the configuration that names it.
fn resolve_robot(value: &mut Value, file: &Path) {
    let model = value.get_mut("robot").and_then(|robot| robot.get_mut("model"));
    if let Some(Value::String(model)) = model {
        *model = robot_in(file.parent().unwrap_or(Path::new("")), model);
    }
}

/// Returns the name of a shipped robot, or the absolute path of a robot's file, which is relative to `folder`.
fn robot_in(folder: &Path, model: &str) -> String {
    if Robot::ships(model) {
        return model.to_owned();
    }
    let path = folder.join(PathBuf::from(model));
    std::path::absolute(&path).unwrap_or(path).display().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation::{Observed, Quantity};

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
            ("observation=[{quantity: friction}]", "entry 1 (friction): only the simulator knows it"),
            (
                "critic_observation=[{quantity: friction, scale: 0}]",
                "critic_observation: observation, entry 1 (friction)",
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

    /// Writes a YAML file and loads it as a configuration.
    fn written(text: &str) -> Result<(Config, Vec<String>), ConfigError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("own.yaml");
        std::fs::write(&path, text).unwrap();
        Config::load_with_notes(path.to_str().unwrap(), &[])
    }

    #[test]
    fn appended_entries_follow_those_of_the_base() {
        let added = "[{quantity: friction, scale: 2.0}, {quantity: latency}]";
        let (own, notes) = written(&format!(
            "base: real\nobservation: {{append: [{{quantity: base_height}}]}}\ncritic_observation: {{append: {added}}}"
        ))
        .unwrap();
        let base = Config::load("real").unwrap();
        assert!(notes.is_empty());
        assert_eq!(own.observation[..7], base.observation);
        assert_eq!(own.observation[7..], [Observed::now(Quantity::BaseHeight)]);
        assert_eq!((own.critic_observation.len(), &own.critic_observation[..11]), (13, &base.critic_observation[..]));
        assert!(own.to_yaml().matches("quantity: base_height").count() == 2 && !own.to_yaml().contains("append"));
        // A base without a list has an empty one; --set adds to what the file states.
        let set = ["critic_observation.append=[{quantity: friction}]".to_owned()];
        assert_eq!(Config::load_with("fast", &set).unwrap().critic_observation, [Observed::now(Quantity::Friction)]);
    }

    #[test]
    fn list_that_drops_quantities_of_its_base_is_noted() {
        let observation = "observation: [{quantity: gravity}, {quantity: joint_angles}, {quantity: command}]";
        let (own, notes) = written(&format!("base: fast\n{observation}")).unwrap();
        assert_eq!(own.observation.len(), 3);
        let [note] = &notes[..] else { panic!("{notes:?}") };
        assert!(note.contains("own.yaml, line 2: observation replaces the list of its base and drops angular_velocity, base_height, base_velocity, joint_rates, last_target; "), "{note}");
        assert!(written("base: real\nreward: {flight: -1.0}").unwrap().1.is_empty());
    }

    #[test]
    fn append_of_another_form_is_refused() {
        for (text, expected) in [
            ("base: fast\nobservation: {append: 3}", "own.yaml, line 2: observation: expected a list after `append`"),
            ("base: fast\nobservation: {}", "observation: expected a list after `append`"),
            (
                "base: fast\nobservation:\n  append: []\n  prepend: []",
                "observation: unknown key `prepend`, expected a list",
            ),
            (
                "base: fast\nobservation: {append: [{quantity: warmth}]}",
                "line 2: observation[14].quantity: unknown variant `warmth`",
            ),
            (
                "robot: {model: go1}\nobservation: {append: []}",
                "line 2: observation: `append` adds to the list of a `base`",
            ),
        ] {
            let error = written(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    /// Returns the paths of all keys of a value, at any depth.
    fn paths(value: &Value, path: &[Value]) -> Vec<Vec<Value>> {
        let step = |key: &Value, value: &Value| {
            let path = [path, std::slice::from_ref(key)].concat();
            [vec![path.clone()], paths(value, &path)].concat()
        };
        match value {
            Value::Mapping(entries) => entries.iter().flat_map(|(key, value)| step(key, value)).collect(),
            Value::Sequence(list) => (0..list.len()).flat_map(|k| step(&k.into(), &list[k])).collect(),
            _ => Vec::new(),
        }
    }

    /// Returns the mapping that holds the key at the end of a path.
    fn holder<'a>(value: &'a mut Value, path: &[Value]) -> Option<&'a mut Value> {
        let [at @ .., _] = path else { return None };
        at.iter().try_fold(value, |value, key| match key.as_u64() {
            Some(k) => value.get_mut(k as usize),
            None => value.get_mut(key),
        })
    }

    #[test]
    fn no_optional_key_is_written_at_its_default() {
        let terrain = "terrain={environments: 0.5, levels: 6, rough_m: [0.01, 0.06], boxes_m: [0.02, 0.08], sharpness_factor: 0.5}";
        let changes = [
            "observation.append=[{quantity: clock_sin, frequency_hz: 2.0, phases: [0.5], steps_ago: 1, clip: 1.0}]",
            terrain,
        ];
        let all = Config::load_with("real", &changes.map(str::to_owned)).unwrap().all_keys();
        let mut optional = Vec::new();
        for path in paths(&all, &[]) {
            let mut without = all.clone();
            let Some(Value::Mapping(entries)) = holder(&mut without, &path) else { continue };
            let key = path.last().unwrap();
            entries.remove(key);
            // A required key is missed.
            let Ok(config) = yaml::typed::<Config>(without, &[]) else { continue };
            let yaml = config.to_yaml();
            let mut written = Text::new("written", &yaml).parse().unwrap();
            assert!(holder(&mut written, &path).is_some_and(|entries| entries.get(key).is_none()), "{path:?}: {yaml}");
            assert_eq!(yaml::typed::<Config>(written, &[]).unwrap(), config, "{path:?}");
            optional.extend(key.as_str().map(str::to_owned));
        }
        for key in
            ["damping_n_m_s_per_rad", "shards", "learner", "precision", "buckets", "trunk_mass_kg", "clip", "terrain"]
        {
            assert!(optional.iter().any(|found| found == key), "{key} is no longer optional: {optional:?}");
        }
    }

    #[test]
    fn key_of_another_version_is_explained_in_saved_files() {
        let text = Config::load("fast").unwrap().to_yaml().replace("  flight:", "  warmth: 1.0\n  flight:");
        let error = Config::from_yaml("runs/a/config.yaml", &text).unwrap_err().to_string();
        assert!(error.starts_with("config runs/a/config.yaml, line ") && error.ends_with(
            "reward.warmth: unknown field `warmth`: another version of Supple wrote this file; use that version, or remove the key"), "{error}");
        let error = written("base: fast\nreward: {warmth: 1.0}").unwrap_err().to_string();
        assert!(
            error
                .contains("own.yaml, line 2: reward.warmth: unknown field `warmth`, expected one of `linear_velocity`"),
            "{error}"
        );
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
