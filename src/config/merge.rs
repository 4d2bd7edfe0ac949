//! A configuration over its base, and single keys over both.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::{ConfigError, EMBEDDED};
use crate::robot::Robot;
use crate::util::yaml::{self, Text, Value, YamlError};

/// Maximum depth of nested `base` keys.
const MAX_BASES: usize = 8;

/// Keys of the lists of quantities, which a configuration may state as `{append: [...]}`.
const LISTS: [&str; 2] = ["observation", "critic_observation"];

/// The keys of a configuration, those of its bases and single changes, merged but not yet checked.
#[derive(Default)]
pub struct Merged {
    pub value: Value,
    /// Texts that the keys come from, the overriding one first.
    pub texts: Vec<Text>,
    /// Notes about possible mistakes in a text.
    pub notes: Vec<String>,
}

impl Merged {
    /// Reads a configuration and its bases.
    pub fn load(name_or_path: &str) -> Result<Self, ConfigError> {
        let mut merged = Merged::default();
        merged.value = merged.read(name_or_path, Path::new(""), MAX_BASES)?;
        Ok(merged)
    }

    /// Parses a complete text.
    pub fn new(text: Text) -> Result<Self, YamlError> {
        Ok(Merged { value: text.parse()?, texts: vec![text], notes: Vec::new() })
    }

    /// Reads a configuration and its bases; relative paths start at `folder`.
    fn read(&mut self, name_or_path: &str, folder: &Path, bases_left: usize) -> Result<Value, ConfigError> {
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
        self.texts.push(text.clone());
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
        ensure!(bases_left > 0, problem("`base` is nested too deep: does a config name itself?"));
        let mut whole = self.read(base, path.parent().unwrap_or(folder), bases_left - 1)?;
        let notes = resolve_lists(Some(&whole), &mut value, &text)?;
        // Shipped configurations drop quantities on purpose.
        self.notes.extend(notes.into_iter().filter(|_| embedded.is_none()));
        yaml::overlay(&mut whole, value);
        Ok(whole)
    }

    /// Changes a key, given as `ppo.epochs=4`.
    pub fn change(&mut self, change: &str) -> Result<(), YamlError> {
        let name = format!("--set {change}");
        let Some((key, value)) = change.split_once('=').filter(|(key, _)| !key.is_empty()) else {
            return Err(YamlError::new(&name, "expected KEY=VALUE, as in ppo.epochs=4"));
        };
        let depth = key.split('.').count();
        let opened: String = key.split('.').map(|part| format!("{{{part}: ")).collect();
        let text = Text::of_flag(&name, &format!("{opened}{value}{}", "}".repeat(depth)));
        let mut value = text.parse()?;
        resolve_robot(&mut value, Path::new(""));
        self.notes.extend(resolve_lists(Some(&self.value), &mut value, &text)?);
        yaml::overlay(&mut self.value, value);
        self.texts.insert(0, text);
        Ok(())
    }
}

/// Replaces `{append: [...]}` by the list of the base with these entries at its end. Returns a note for each list that lacks
/// quantities of the base's.
fn resolve_lists(base: Option<&Value>, value: &mut Value, text: &Text) -> Result<Vec<String>, YamlError> {
    let mut notes = Vec::new();
    for key in LISTS {
        let problem = |problem: &str| Err(text.error(key, problem));
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
                if let Some(other) = mapping.keys().filter_map(Value::as_str).find(|key| *key != "append") {
                    return problem(&format!("unknown key `{other}`, expected a list, or `append`"));
                }
                if base.is_none() {
                    return problem(
                        "`append` adds to the list of a `base`, which is missing: name one, or state the list",
                    );
                }
                let Some(Value::Sequence(added)) = mapping.remove("append") else {
                    return problem("expected a list after `append`");
                };
                value[key] = Value::Sequence([of_base, added].concat());
            }
            _ => (),
        }
    }
    Ok(notes)
}

/// Makes the path of a robot's file relative to the folder of the configuration that names it.
fn resolve_robot(value: &mut Value, file: &Path) {
    let model = value.get_mut("robot").and_then(|robot| robot.get_mut("model"));
    if let Some(Value::String(model)) = model {
        *model = robot_in(file.parent().unwrap_or(Path::new("")), model);
    }
}

/// Returns the name of a shipped robot, or the absolute path of a robot's file, which is relative to `folder`.
pub fn robot_in(folder: &Path, model: &str) -> String {
    if Robot::ships(model) {
        return model.to_owned();
    }
    let path = folder.join(PathBuf::from(model));
    std::path::absolute(&path).unwrap_or(path).display().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::observation::{Observed, Quantity};

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
    fn wrong_keys_are_refused_with_their_line() {
        for (text, expected) in [
            ("base: fast\nobservation: {append: 3}", "own.yaml, line 2: observation: expected a list after `append`"),
            ("base: fast\nobservation: {}", "observation: expected a list after `append`"),
            ("base: fast\nobservation: {append: [],prepend: 0}", "observation: unknown key `prepend`, expected a list"),
            (
                "base: fast\nreward: {warmth: 1.0}",
                "line 2: reward.warmth: unknown field `warmth`, expected one of `linear_velocity`",
            ),
            (
                "base: fast\nobservation: {append: [{quantity: warmth}]}",
                "line 2: observation[14].quantity: unknown variant `warmth`",
            ),
            ("ppo: {}\nobservation: {append: []}", "line 2: observation: `append` adds to the list of a `base`"),
        ] {
            let error = written(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
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
