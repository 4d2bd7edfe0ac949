//! YAML texts, laid over one another.

use std::path::Path;

use serde_yaml::Value;

use super::{ConfigError, Difference, EMBEDDED, GO1_NAME};

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

pub(super) fn parse(name: &str, text: &str) -> Result<Value, ConfigError> {
    serde_yaml::from_str(text).map_err(|error| ConfigError::Parse { name: name.to_owned(), message: error.to_string() })
}

/// Reads a configuration and lays it over its base. `folder` is where relative paths start.
pub(super) fn merged(name_or_path: &str, folder: &Path, bases_left: usize) -> Result<Value, ConfigError> {
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
    if embedded.is_none() {
        resolve_robot(&mut value, &path);
    }
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

/// The path of a robot's file starts where the file that names it lies.
fn resolve_robot(value: &mut Value, file: &Path) {
    let model = value.get_mut("robot").and_then(|robot| robot.get_mut("model"));
    if let Some(Value::String(model)) = model.filter(|model| model.as_str() != Some(GO1_NAME)) {
        let path = file.parent().unwrap_or(Path::new("")).join(&*model);
        *model = std::path::absolute(&path).unwrap_or(path).to_string_lossy().into_owned();
    }
}

/// Where two mappings differ, below a dotted key.
pub(super) fn differences(key: &str, first: &Value, second: &Value) -> Vec<Difference> {
    let (Some(ours), Some(theirs)) = (first.as_mapping(), second.as_mapping()) else {
        let text = |value: &Value| serde_yaml::to_string(value).unwrap_or_default().trim().replace('\n', " ");
        let difference = || Difference { key: key.to_owned(), values: [text(first), text(second)] };
        return (first != second).then(difference).into_iter().collect();
    };
    let keys = ours.keys().chain(theirs.keys().filter(|key| !ours.contains_key(*key)));
    keys.flat_map(|part| {
        let [a, b] = [ours, theirs].map(|keys| keys.get(part).unwrap_or(&Value::Null));
        let dot = if key.is_empty() { "" } else { "." };
        differences(&format!("{key}{dot}{}", part.as_str().unwrap_or_default()), a, b)
    })
    .collect()
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
