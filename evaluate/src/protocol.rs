//! The protocol: the parameters of all experiments (grids, directions, trials), read from YAML and checked.

use std::path::Path;

use super::Condition;
pub use super::experiments::Protocol;
use supple::config::{Config, ConfigError};
use supple::scenario::catalog::{ParameterError, ScriptError, in_range};
use supple::util::files::FileError;
use supple::util::yaml::{Text, YamlError, layered};

/// The text of the full protocol.
pub const FULL: &str = include_str!("../../configs/evaluation/full.yaml");

/// The text of the quick protocol: the values that differ from the full one.
pub const QUICK: &str = include_str!("../../configs/evaluation/quick.yaml");

/// The text of the protocol of an examination: the values that differ from the full one.
pub const EXAM: &str = include_str!("../../configs/evaluation/exam.yaml");

/// The reason why a protocol was refused.
#[derive(Debug, thiserror::Error)]
pub enum ProtocolError {
    /// The file cannot be read.
    #[error("cannot read {0}")]
    Read(#[from] FileError),
    /// The text is not YAML, a key is unknown or missing, or a value has another type.
    #[error("protocol {0}")]
    Parse(#[from] YamlError),
    /// A scenario file inside the program is invalid.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The value of a key is outside its range: the key with dots between sections, what was found and what was expected.
    #[error("protocol key {0} is {1}, expected {2}")]
    Value(String, String, &'static str),
    /// A scenario cannot be played: the section with the condition's label, and the parameter as the program `scenario` names it.
    #[error("protocol section {0}: {1}")]
    Scenario(String, #[source] ScriptError),
}

impl Protocol {
    /// Returns the full protocol.
    ///
    /// # Errors
    /// The file inside the program is invalid, which a test rules out.
    pub fn full() -> Result<Self, ProtocolError> {
        Self::differing(&[])
    }

    /// Returns the quick protocol: fewer trials, grid points and directions.
    ///
    /// # Errors
    /// A file inside the program is invalid, which a test rules out.
    pub fn quick() -> Result<Self, ProtocolError> {
        Self::differing(&[Text::new("quick", QUICK)])
    }

    /// Returns the protocol of an [examination](crate::exam), with the values of a file that differ from it.
    ///
    /// # Errors
    /// The same as those of [`Protocol::load`].
    pub fn exam(differences: Option<&Path>) -> Result<Self, ProtocolError> {
        let exam = Text::new("exam", EXAM);
        match differences {
            Some(path) => Self::differing(&[exam, Self::read(path)?])?.with_scripts(),
            None => Self::differing(&[exam]),
        }
    }

    /// Reads a protocol from a file with the values that differ from the full protocol.
    ///
    /// # Errors
    /// The file cannot be read or is not YAML, a key is unknown, or a value is outside its range; the error names the key, or the
    /// section and the parameter of its scenario.
    pub fn load(path: &Path) -> Result<Self, ProtocolError> {
        Self::differing(&[Self::read(path)?])?.with_scripts()
    }

    fn read(path: &Path) -> Result<Text, ProtocolError> {
        Ok(Text::read(path).map_err(FileError::of("protocol", path))?)
    }

    /// Reads the full protocol with differences, each layer over those before it.
    fn differing(layers: &[Text]) -> Result<Self, ProtocolError> {
        let protocol: Protocol = layered(&[&[Text::new("full", FULL)], layers].concat())?;
        for experiment in protocol.experiments() {
            let section = experiment.info().name.replace('-', "_");
            let checked = in_range("trials", f64::from(experiment.info().trials), 1.0, 10_000.0, "1 to 10000");
            if let Err(ParameterError { name, found, expected }) = checked.and_then(|()| experiment.check()) {
                return Err(ProtocolError::Value(format!("{section}.{name}"), found, expected));
            }
            // Scenarios check all other parameters when they make their scripts: see `with_scripts`.
            if experiment.conditions()?.is_empty() {
                return Err(ProtocolError::Value(section, "empty".into(), "at least one condition"));
            }
        }
        Ok(protocol)
    }

    /// Returns `self` if the scripts of all conditions can be made. It takes a moment, mostly for uneven ground, so a test does it for the
    /// protocols inside the program.
    fn with_scripts(self) -> Result<Self, ProtocolError> {
        let config = Config::load("compliant")?;
        for experiment in self.experiments() {
            let section = experiment.info().name.replace('-', "_");
            for Condition { label, scenario } in experiment.conditions()? {
                let place = if label.is_empty() { section.clone() } else { format!("{section}, condition {label}") };
                scenario.script(0, &config).map_err(|error| ProtocolError::Scenario(place, error))?;
            }
        }
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Experiment;
    use supple::scenario::catalog::Scenario;

    #[test]
    fn both_protocols_are_valid() {
        let trials = |protocol: &Protocol| -> usize {
            let count = |experiment: &&dyn Experiment| {
                experiment.conditions().unwrap().len() * experiment.info().trials as usize
            };
            protocol.experiments().iter().map(count).sum()
        };
        assert!(trials(&Protocol::quick().unwrap()) * 5 < trials(&Protocol::full().unwrap()));
        let harder = include_str!("../../configs/evaluation/harder.yaml");
        let harder = Protocol::differing(&[Text::new("harder", harder)]).unwrap();
        // The pit keeps its size with larger balls.
        let Scenario::BallPit(pit) = &harder.ball_pit.conditions().unwrap()[0].scenario else {
            panic!("another scenario")
        };
        assert_eq!((pit.balls, pit.task.forward_m_s), (14 * 14, 0.4));
        let battery = include_str!("../../configs/evaluation/battery.yaml");
        let battery = Protocol::differing(&[Text::new("battery", battery)]).unwrap();
        assert!(trials(&battery) * 3 < trials(&Protocol::full().unwrap()));
    }

    #[test]
    fn protocol_with_invalid_value_is_refused() {
        let changed = |text| Protocol::differing(&[Text::new("test", text)]);
        assert_eq!(changed("box: {trials: 3}").unwrap().r#box.trials, 3);
        for (text, expected) in [
            (
                "ball_pit: {pits: [{mass_kg: 0.5, radius_m: 0.01, forward_m_s: 0.4}]}",
                "ball_pit.pits.radius_m is 0.01, expected 0.03 to 0.5 m",
            ),
            ("box: {trials: 0}", "box.trials is 0, expected 1 to 10000"),
            ("push_grid: {points_per_side: 1}", "push_grid.points_per_side is 1, expected 2 to 101"),
            ("walk: {commands: []}", "walk is empty, expected at least one condition"),
            ("push_grid: {watch_s: -1}", "push_grid.watch_s is -1, expected 0.1 to 60 s"),
            ("leash: {for_s: 2, average_s: 5}", "leash.average_s is 5, expected 0.1 s to leash.for_s"),
            ("boxes: {trials: 0}", "unknown field `boxes`"),
            ("box: {trial: 0}", "unknown field `trial`"),
            ("box: {trials: many}", "invalid type"),
        ] {
            let error = changed(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    /// Returns why a file with this text is refused.
    fn refusal(text: &str, read: impl Fn(&Path) -> Result<Protocol, ProtocolError>) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("own.yaml");
        std::fs::write(&path, text).unwrap();
        read(&path).unwrap_err().to_string()
    }

    #[test]
    fn scenario_that_cannot_be_played_is_refused_with_its_section() {
        let high = "protocol section terrain, condition 300 cm, 0.5 /m: --height-m is 3, expected 0 to 2 m";
        assert_eq!(refusal("terrain: {heights_m: [3.0]}", Protocol::load), high);
        assert_eq!(refusal("terrain: {heights_m: [3.0]}", |path| Protocol::exam(Some(path))), high);
        let steep = "protocol section outdoor, condition slopes to 500 %: --steepest is 5, expected 0 to 2";
        let text = "terrain: {heights_m: [0.05], frequencies_per_m: [0.5]}\noutdoor: {steepest: [5]}";
        assert_eq!(refusal(text, Protocol::load), steep);
    }

    #[test]
    fn scripts_of_all_protocols_can_be_made() {
        for protocol in [Protocol::full(), Protocol::quick(), Protocol::exam(None)] {
            protocol.and_then(Protocol::with_scripts).unwrap();
        }
    }
}
