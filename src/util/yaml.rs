//! YAML texts as checked types. Nothing else knows YAML.

use serde::de::DeserializeOwned;
pub use serde_yaml::Value;

/// A text that is not what it should be.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{name}: {message}")]
pub struct YamlError {
    /// The file, or the name of an embedded text.
    pub name: String,
    /// Position and reason.
    pub message: String,
}

impl YamlError {
    /// Of a text with this name.
    pub fn new(name: &str, message: impl ToString) -> Self {
        YamlError { name: name.to_owned(), message: message.to_string() }
    }
}

/// Any text.
///
/// # Errors
/// If it is not YAML.
pub fn parse(name: &str, text: &str) -> Result<Value, YamlError> {
    serde_yaml::from_str(text).map_err(|error| YamlError::new(name, error))
}

/// A value as a checked type.
///
/// # Errors
/// An unknown key, a missing key or a wrong type.
pub fn typed<T: DeserializeOwned>(name: &str, value: Value) -> Result<T, YamlError> {
    serde_yaml::from_value(value).map_err(|error| YamlError::new(name, error))
}

/// Texts laid over one another, later ones over earlier ones, as a checked type.
///
/// # Errors
/// As [`parse`] and [`typed`].
pub fn layered<T: DeserializeOwned>(name: &str, layers: &[&str]) -> Result<T, YamlError> {
    let mut whole = Value::Mapping(serde_yaml::Mapping::new());
    for text in layers {
        overlay(&mut whole, parse(name, text)?);
    }
    typed(name, whole)
}

/// A type of numbers, texts and lists as YAML.
pub fn to_text(value: &impl serde::Serialize) -> String {
    // Plain structs of numbers and strings: serialising them cannot fail.
    serde_yaml::to_string(value).unwrap_or_default()
}

/// A flat mapping as names and values in text, for files that stand for command-line flags.
///
/// # Errors
/// If it is anything but a mapping of names to numbers, texts or truth values.
pub fn flat_parameters(name: &str, text: &str) -> Result<Vec<(String, String)>, YamlError> {
    let value = parse(name, text)?;
    let mapping = value.as_mapping().ok_or_else(|| YamlError::new(name, "expected lines of the form `name: value`"))?;
    let entry = |(key, value): (&Value, &Value)| {
        let key = key.as_str().ok_or_else(|| YamlError::new(name, format!("{key:?} is not a name")))?;
        match value {
            Value::Number(number) => Ok((key.to_owned(), number.to_string())),
            Value::String(text) => Ok((key.to_owned(), text.clone())),
            Value::Bool(truth) => Ok((key.to_owned(), truth.to_string())),
            _ => Err(YamlError::new(name, format!("{key} must be a number, a text or true or false"))),
        }
    };
    mapping.iter().map(entry).collect()
}

/// Replaces in `base` what `change` states; mappings are merged key by key.
pub fn overlay(base: &mut Value, change: Value) {
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

/// Dotted keys in which two types differ, each with both values as YAML.
pub fn differences(first: &impl serde::Serialize, second: &impl serde::Serialize) -> Vec<(String, [String; 2])> {
    let value = |of: Result<Value, _>| of.unwrap_or_default();
    let mut found = Vec::new();
    compare("", &value(serde_yaml::to_value(first)), &value(serde_yaml::to_value(second)), &mut found);
    found
}

fn compare(key: &str, first: &Value, second: &Value, found: &mut Vec<(String, [String; 2])>) {
    let (Some(ours), Some(theirs)) = (first.as_mapping(), second.as_mapping()) else {
        let text = |value: &Value| to_text(value).trim().replace('\n', " ");
        if first != second {
            found.push((key.to_owned(), [text(first), text(second)]));
        }
        return;
    };
    for part in ours.keys().chain(theirs.keys().filter(|key| !ours.contains_key(*key))) {
        let [a, b] = [ours, theirs].map(|keys| keys.get(part).unwrap_or(&Value::Null));
        let dot = if key.is_empty() { "" } else { "." };
        compare(&format!("{key}{dot}{}", part.as_str().unwrap_or_default()), a, b, found);
    }
}
