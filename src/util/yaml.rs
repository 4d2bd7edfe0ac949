//! YAML texts as checked types; the only module that parses YAML.

use std::io;
use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;
pub use serde_yaml::Value;

use super::files;

/// An error in a YAML text.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}: {message}", at(name, *line))]
pub struct YamlError {
    /// Path of the file, or name of an embedded text.
    pub name: String,
    /// The line of the error, if it is known.
    pub line: Option<usize>,
    /// Description of the error.
    pub message: String,
}

impl YamlError {
    /// Creates the error of the text with this name.
    pub fn new(name: &str, message: impl ToString) -> Self {
        YamlError { name: name.to_owned(), line: None, message: message.to_string() }
    }

    /// Formats line and reason, for callers that name the file themselves.
    pub(crate) fn without_name(&self) -> String {
        self.line.map_or_else(|| self.message.clone(), |line| format!("line {line}: {}", self.message))
    }
}

/// A YAML text and its name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Text {
    /// Path of the file, or name of an embedded text.
    pub name: String,
    /// Content of the text.
    pub content: String,
    /// True if errors should name the line; false for the text of a flag, which has only one.
    has_lines: bool,
}

impl Text {
    /// Creates a text from its name and content, whose byte-order mark is left out.
    pub fn new(name: &str, content: &str) -> Self {
        let content = content.strip_prefix('\u{feff}').unwrap_or(content);
        Text { name: name.to_owned(), content: content.to_owned(), has_lines: true }
    }

    /// Creates the text of a flag that the user gave as `name` on the command line, and that `content` expresses in
    /// YAML.
    pub(crate) fn of_flag(name: &str, content: &str) -> Self {
        Text { has_lines: false, ..Text::new(name, content) }
    }

    /// Reads a file of at most one megabyte.
    ///
    /// # Errors
    /// The file cannot be read, is too large, or is not UTF-8.
    pub fn read(path: &Path) -> io::Result<Self> {
        Ok(Text::new(&path.display().to_string(), &files::read_text(path, MAX_BYTES)?))
    }

    /// Parses the text to keys and values.
    ///
    /// # Errors
    /// The text is not YAML, or not a mapping.
    pub fn parse(&self) -> Result<Value, YamlError> {
        let fail = |line, message: String| Err(YamlError { name: self.name.clone(), line, message });
        if self.content.matches(['[', '{']).count() > MAX_BRACKETS {
            return fail(None, format!("it has more than {MAX_BRACKETS} brackets"));
        }
        let value: Value = match serde_yaml::from_str(&self.content) {
            Ok(value) => value,
            Err(error) => {
                let line = error.location().map_or(0, |at| at.line());
                // A tab is where it is, or ends what is above.
                let indented = (line.saturating_sub(1)..=line).find(|line| {
                    let text = self.content.lines().nth(line.wrapping_sub(1)).unwrap_or_default();
                    text.chars().take_while(|c| c.is_whitespace()).any(|c| c == '\t')
                });
                return match indented {
                    Some(line) => fail(Some(line), "it begins with a tab: YAML is indented with spaces".into()),
                    None => Err(YamlError::new(&self.name, error)),
                };
            }
        };
        match value {
            Value::Mapping(_) => Ok(value),
            Value::Null => fail(None, "it is empty, expected lines of the form `key: value`".into()),
            _ => fail(None, "expected lines of the form `key: value`".into()),
        }
    }

    /// Creates the error of a dotted key of this text.
    pub fn error(&self, key: &str, message: &str) -> YamlError {
        let (name, line) = find(std::slice::from_ref(self), key);
        YamlError { name, line, message: format!("{key}: {message}") }
    }

    /// Returns the line of a key, if the text has it.
    fn line(&self, key: &[&str]) -> Option<usize> {
        let value = self.parse().ok()?;
        key.iter().try_fold(&value, |value, part| value.get(part))?;
        let mut start = 0;
        for part in key {
            let is_key = |at: usize| {
                let (before, after) = (&self.content[..at], &self.content[at + part.len()..]);
                let line = before.rfind('\n').map_or(before, |end| &before[end + 1..]);
                let begins = line.chars().next_back().is_none_or(|c| c.is_whitespace() || "{,'\"-".contains(c));
                begins && !line.contains('#') && after.trim_start_matches(['\'', '"', ' ']).starts_with(':')
            };
            let at = self.content[start..].match_indices(part).map(|(at, _)| start + at).find(|at| is_key(*at))?;
            start = at + part.len();
        }
        Some(1 + self.content[..start].matches('\n').count())
    }
}

/// Maximum size of a YAML file \[bytes\].
const MAX_BYTES: u64 = 1 << 20;

/// Maximum number of brackets in a text: if they are nested, the parser's time grows with the square of their number.
const MAX_BRACKETS: usize = 10_000;

/// Converts a value to a checked type; `texts` are its sources, the overriding one first.
pub(crate) fn typed<T: DeserializeOwned>(value: Value, texts: &[Text]) -> Result<T, YamlError> {
    serde_path_to_error::deserialize(value).map_err(|error| {
        let key = error.path().to_string();
        let key = if key == "." { String::new() } else { key };
        let mut reason = error.inner().to_string();
        for whole in ["usize", "u64", "u32", "u16", "i64", "i32"] {
            reason = reason.replace(&format!("expected {whole}"), "expected a whole number");
        }
        reason = reason.replace("expected f64", "expected a number").replace("type: unit value", "type: nothing");
        if let Some((found, _)) = reason.split_once("expected struct ") {
            reason = format!("{found}expected keys with values");
        }
        let message = if key.is_empty() { reason } else { format!("{key}: {reason}") };
        let (name, line) = find(texts, &key);
        YamlError { name, line, message }
    })
}

/// Describes the position of a dotted key: name of the first text that has it, and the line.
pub fn place(texts: &[Text], key: &str) -> String {
    let (name, line) = find(texts, key);
    at(&name, line)
}

fn find(texts: &[Text], key: &str) -> (String, Option<usize>) {
    // Elements of lists have no lines of their own.
    let parts: Vec<&str> = key.split_once('[').map_or(key, |(list, _)| list).split('.').collect();
    let place = |text: &Text| text.line(&parts).map(|line| (text.name.clone(), text.has_lines.then_some(line)));
    let found = texts.iter().find_map(place);
    found.unwrap_or_else(|| (texts.first().map_or_else(String::new, |text| text.name.clone()), None))
}

fn at(name: &str, line: Option<usize>) -> String {
    line.map_or_else(|| name.to_owned(), |line| format!("{name}, line {line}"))
}

/// Merges texts, later ones over earlier ones, into a checked type.
///
/// # Errors
/// A text is not YAML, a key is unknown or missing, or a value has the wrong type.
pub fn layered<T: DeserializeOwned>(texts: &[Text]) -> Result<T, YamlError> {
    let mut whole = Value::Mapping(serde_yaml::Mapping::new());
    for text in texts {
        overlay(&mut whole, text.parse()?);
    }
    let newest_first: Vec<Text> = texts.iter().rev().cloned().collect();
    typed(whole, &newest_first)
}

/// Formats a value of numbers, texts and lists as YAML.
pub(crate) fn to_text(value: &impl Serialize) -> String {
    // Plain structs of numbers and strings: serialising them cannot fail.
    serde_yaml::to_string(value).unwrap_or_default()
}

/// Returns a struct of numbers, texts, lists and structs as keys and values, without the keys that are `None`.
pub fn to_value(value: &impl Serialize) -> Value {
    // Serialising it cannot fail.
    filtered(&serde_yaml::to_value(value).unwrap_or_default(), &mut |value| !value.is_null())
}

/// Returns a struct as [`to_value`] does, but without the keys that stand at their default: those without which it reads back
/// as the same. A program that does not know such a key can read the rest.
pub(crate) fn without_defaults<T: Serialize + DeserializeOwned + PartialEq>(value: &T) -> Value {
    let (mut keys, mut needed) = (to_value(value), 0);
    while let Some(shorter) = without_entry(&keys, needed) {
        if serde_yaml::from_value(shorter.clone()).is_ok_and(|read: T| read == *value) {
            keys = shorter;
        } else {
            needed += 1;
        }
    }
    keys
}

/// Returns a value without the entry of its mappings, at any depth, that comes after `before` others; `None` if there is none.
pub(crate) fn without_entry(value: &Value, before: usize) -> Option<Value> {
    let mut visited = 0;
    let shorter = filtered(value, &mut |_| {
        visited += 1;
        visited != before + 1
    });
    (visited > before).then_some(shorter)
}

/// Serialises a struct without the keys that stand at their default, for `#[serde(serialize_with)]`.
pub(crate) fn serialize_without_defaults<T, S>(value: &T, serializer: S) -> Result<S::Ok, S::Error>
where
    T: Serialize + DeserializeOwned + PartialEq,
    S: serde::Serializer,
{
    without_defaults(value).serialize(serializer)
}

/// Copies a value with only those entries of its mappings, at any depth, whose values are to be kept.
fn filtered(value: &Value, keep: &mut dyn FnMut(&Value) -> bool) -> Value {
    match value {
        Value::Mapping(entries) => {
            let kept: Vec<_> = entries.iter().filter(|(_, value)| keep(value)).collect();
            Value::Mapping(kept.into_iter().map(|(key, value)| (key.clone(), filtered(value, keep))).collect())
        }
        Value::Sequence(values) => Value::Sequence(values.iter().map(|value| filtered(value, keep)).collect()),
        other => other.clone(),
    }
}

/// Returns a flat mapping as names and values in text, for files that stand for command-line flags; `None` for null.
///
/// # Errors
/// The text is anything but a mapping of names to numbers, texts, truth values or null.
pub fn flat_parameters(text: &Text) -> Result<Vec<(String, Option<String>)>, YamlError> {
    let (name, value) = (text.name.as_str(), text.parse()?);
    let Some(mapping) = value.as_mapping() else { return Ok(Vec::new()) };
    let entry = |(key, value): (&Value, &Value)| {
        let key = key.as_str().ok_or_else(|| YamlError::new(name, format!("{key:?} is not a name")))?;
        match value {
            Value::Number(number) => Ok((key.to_owned(), Some(number.to_string()))),
            Value::String(text) => Ok((key.to_owned(), Some(text.clone()))),
            Value::Bool(truth) => Ok((key.to_owned(), Some(truth.to_string()))),
            Value::Null => Ok((key.to_owned(), None)),
            _ => Err(YamlError::new(name, format!("{key} must be a number, a text, true, false or null"))),
        }
    };
    mapping.iter().map(entry).collect()
}

/// Overwrites in `base` what `change` states; mappings are merged key by key.
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

/// Lists the dotted keys in which two values differ, with both values as YAML.
pub fn differences(first: &impl Serialize, second: &impl Serialize) -> Vec<(String, [String; 2])> {
    let mut found = Vec::new();
    compare("", &to_value(first), &to_value(second), &mut found);
    found
}

fn compare(key: &str, first: &Value, second: &Value, found: &mut Vec<(String, [String; 2])>) {
    let (Some(ours), Some(theirs)) = (first.as_mapping(), second.as_mapping()) else {
        let text = |value: &Value| match value {
            // On one line, which is YAML, too.
            Value::Sequence(_) => serde_json::to_string(value).unwrap_or_default(),
            value => to_text(value).trim().replace('\n', " "),
        };
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

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Outer {
        name: String,
        inner: Inner,
    }

    #[derive(Debug, PartialEq, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Inner {
        count: u64,
        sizes: Vec<f64>,
    }

    fn read(texts: &[&str]) -> Result<Outer, YamlError> {
        let texts: Vec<Text> = texts.iter().zip(["a", "b"]).map(|(text, name)| Text::new(name, text)).collect();
        layered(&texts)
    }

    fn complaint(texts: &[&str]) -> String {
        read(texts).unwrap_err().to_string()
    }

    #[test]
    fn a_later_text_changes_what_it_names_and_leaves_the_rest() {
        let found = read(&["name: x\ninner:\n  count: 1\n  sizes: [1.0]\n", "inner: {count: 2}"]).unwrap();
        assert_eq!(found, Outer { name: "x".into(), inner: Inner { count: 2, sizes: vec![1.0] } });
    }

    #[test]
    fn errors_name_the_text_the_line_and_the_key() {
        let whole = "name: x # count: 1\ninner:\n  count: 1\n  sizes: [1.0]\n";
        let number = "inner.count: invalid type: floating point `2e7`, expected a whole number";
        let words = number.replace("2e7", "20000000.0");
        assert_eq!(complaint(&[whole, "inner:\n\n  count: 2e7\n"]), format!("b, line 3: {words}"));
        assert!(complaint(&[whole, "inner: {sizes: [1.0,no]}"]).starts_with("b, line 1: inner.sizes[1]: invalid type"));
        let negative = whole.replace("count: 1\n  s", "count: -1\n  s");
        assert!(complaint(&[&negative, "name: y"]).starts_with("a, line 3: inner.count: "));
        assert!(complaint(&[whole, "inner: {counts: 1}"]).contains("unknown field `counts`"));
        assert!(complaint(&["inner: {count: 1, sizes: []}"]).contains("missing field `name`"));
    }

    #[test]
    fn a_text_that_is_no_settings_gets_a_sentence() {
        for (text, expected) in [
            ("", "x: it is empty, expected lines of the form `key: value`"),
            ("# nothing", "x: it is empty, expected lines of the form `key: value`"),
            ("- 1", "x: expected lines of the form `key: value`"),
            ("a:\n\tb: 1", "x, line 2: it begins with a tab: YAML is indented with spaces"),
            ("a:\n  b: 1\n\tc: 1", "x, line 3: it begins with a tab: YAML is indented with spaces"),
        ] {
            assert_eq!(Text::new("x", text).parse().unwrap_err().to_string(), expected, "{text:?}");
        }
    }

    #[test]
    fn brackets_are_limited_whatever_they_hide_behind() {
        let quoted = format!("a: |\n  \"\nb: {}", "[".repeat(MAX_BRACKETS + 1));
        let closed = format!("a: {}", "[ #]\n".repeat(MAX_BRACKETS + 1));
        for text in [quoted, closed] {
            assert!(Text::new("x", &text).parse().unwrap_err().to_string().contains("brackets"));
        }
        let list = format!("a: [{}]", "[], ".repeat(MAX_BRACKETS / 2));
        assert!(Text::new("x", &list).parse().is_ok());
    }
}
