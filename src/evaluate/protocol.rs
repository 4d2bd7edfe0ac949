//! How much of everything is measured: grids, directions, trials. YAML in, checked experiments out.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::Experiment;
use super::experiments::{
    BallPit, Decay, Directions, FreeBox, Leash, Outdoor, Pendulum, Pulley, PushGrid, Rubble, Table4, Terrain, Walk,
};
use crate::config::{ConfigError, layered};
use crate::scenario::catalog::{PushAway, defaults};

/// The protocol of the whole report.
pub const FULL: &str = include_str!("../../configs/evaluation/full.yaml");

/// What the coarse one has instead.
pub const QUICK: &str = include_str!("../../configs/evaluation/quick.yaml");

/// Every experiment with its numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct Protocol {
    pub walk: Walk,
    pub push_grid: PushGrid,
    pub decay: Decay,
    pub table4: Table4,
    pub directions: Directions,
    pub leash: Leash,
    pub r#box: FreeBox,
    pub ball_pit: BallPit,
    pub terrain: Terrain,
    pub pulley: Pulley,
    pub pendulum: Pendulum,
    pub rubble: Rubble,
    pub outdoor: Outdoor,
}

/// Why a protocol was refused.
#[derive(Debug, thiserror::Error)]
pub enum ProtocolError {
    /// Reading failed.
    #[error("cannot read protocol {path}: {source}")]
    Read {
        /// The file.
        path: String,
        /// The system's reason.
        source: std::io::Error,
    },
    /// Not YAML, an unknown or missing key, a wrong type.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A number outside its range.
    #[error("protocol key {key} is {found}, expected {expected}")]
    Value {
        /// Dotted key.
        key: String,
        /// What was found.
        found: String,
        /// What would be valid.
        expected: &'static str,
    },
}

impl Protocol {
    /// The protocol of the whole report.
    ///
    /// # Errors
    /// None with the file inside the program.
    pub fn full() -> Result<Self, ProtocolError> {
        Self::parse("full", &[FULL])
    }

    /// A coarse version of everything.
    ///
    /// # Errors
    /// None with the file inside the program.
    pub fn quick() -> Result<Self, ProtocolError> {
        Self::parse("quick", &[FULL, QUICK])
    }

    /// A file that states what differs from the full protocol.
    ///
    /// # Errors
    /// [`ProtocolError`] that names the key.
    pub fn load(path: &Path) -> Result<Self, ProtocolError> {
        let name = path.display().to_string();
        let text =
            std::fs::read_to_string(path).map_err(|source| ProtocolError::Read { path: name.clone(), source })?;
        Self::parse(&name, &[FULL, &text])
    }

    fn parse(name: &str, layers: &[&str]) -> Result<Self, ProtocolError> {
        let protocol: Protocol = layered(name, layers)?;
        protocol.check()?;
        Ok(protocol)
    }

    /// The experiments in the order of the report.
    pub fn experiments(&self) -> [&dyn Experiment; 13] {
        [
            &self.walk,
            &self.push_grid,
            &self.decay,
            &self.table4,
            &self.directions,
            &self.leash,
            &self.r#box,
            &self.ball_pit,
            &self.terrain,
            &self.pulley,
            &self.pendulum,
            &self.rubble,
            &self.outdoor,
        ]
    }

    fn check(&self) -> Result<(), ProtocolError> {
        for experiment in self.experiments() {
            let key = experiment.info().name.replace('-', "_");
            require((1..=10_000).contains(&experiment.trials()), &key, "trials", experiment.trials(), "1 to 10000")?;
            // What is left is checked by the scenarios themselves, when their scripts are made.
            require(!experiment.conditions()?.is_empty(), &key, "", "empty", "at least one condition")?;
        }
        let grid = &self.push_grid;
        let points = grid.points_per_side;
        require((2..=101).contains(&points), "push_grid", "points_per_side", points, "2 to 101")?;
        require((0.0..=1.0).contains(&grid.level), "push_grid", "level", grid.level, "0 to 1")?;
        require((0.1..=20.0).contains(&grid.limit_m_s), "push_grid", "limit_m_s", grid.limit_m_s, "0.1 to 20 m/s")?;
        // What is averaged or shown has to be there.
        let until_push_s = defaults::<PushAway>("push")?.at_s;
        let (some, before_push, of_pull) = ("0.1 to 60 s", "0.1 s to the time before the push", "0.1 s to leash.for_s");
        for (section, key, seconds, most_s, expected) in [
            ("push_grid", "watch_s", grid.watch_s, 60.0, some),
            ("table4", "window_s", self.table4.window_s, until_push_s, before_push),
            ("leash", "for_s", self.leash.for_s, 60.0, some),
            ("leash", "average_s", self.leash.average_s, self.leash.for_s, of_pull),
            ("box", "resumed_s", self.r#box.resumed_s, 60.0, some),
        ] {
            require((0.1..=most_s).contains(&seconds), section, key, seconds, expected)?;
        }
        for (key, directions) in [("directions", self.directions.directions), ("leash", self.leash.directions)] {
            require((3..=360).contains(&directions), key, "directions", directions, "3 to 360")?;
        }
        Ok(())
    }
}

fn require(
    valid: bool,
    section: &str,
    key: &str,
    found: impl ToString,
    expected: &'static str,
) -> Result<(), ProtocolError> {
    let key = if key.is_empty() { section.to_owned() } else { format!("{section}.{key}") };
    if valid { Ok(()) } else { Err(ProtocolError::Value { key, found: found.to_string(), expected }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_protocols_are_valid_and_the_quick_one_is_smaller() {
        let trials = |protocol: &Protocol| -> usize {
            let count =
                |experiment: &&dyn Experiment| experiment.conditions().unwrap().len() * experiment.trials() as usize;
            protocol.experiments().iter().map(count).sum()
        };
        assert!(trials(&Protocol::quick().unwrap()) * 5 < trials(&Protocol::full().unwrap()));
    }

    #[test]
    fn a_protocol_states_what_differs_and_is_checked() {
        let changed = |text| Protocol::parse("test", &[FULL, text]);
        assert_eq!(changed("box: {trials: 3}").unwrap().r#box.trials, 3);
        for (text, expected) in [
            ("box: {trials: 0}", "box.trials is 0, expected 1 to 10000"),
            ("push_grid: {points_per_side: 1}", "push_grid.points_per_side is 1, expected 2 to 101"),
            ("walk: {commands: []}", "walk is empty, expected at least one condition"),
            ("push_grid: {watch_s: -1}", "push_grid.watch_s is -1, expected 0.1 to 60 s"),
            ("leash: {for_s: 2, average_s: 5}", "leash.average_s is 5, expected 0.1 s to leash.for_s"),
            ("table4: {window_s: 5}", "table4.window_s is 5, expected 0.1 s to the time before the push"),
            ("boxes: {trials: 0}", "unknown field `boxes`"),
            ("box: {trial: 0}", "unknown field `trial`"),
            ("box: {trials: many}", "invalid type"),
        ] {
            let error = changed(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
