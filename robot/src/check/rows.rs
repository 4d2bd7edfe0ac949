//! Logs as `robot check` reads them: ours, bags of ROS 2, or tables of other programs whose columns are described.

use std::path::Path;

use anyhow::bail;
use serde::Deserialize;
use supple::util::files::FileError;

use crate::bridge::log::{COMPLIANCE, Row, columns};

/// Rows of the stance before the policy, in which the estimators settle.
const HELD_ROWS: usize = 100;

/// The columns of a log of another program.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Columns {
    /// The log's name of each of our columns that has another one.
    #[serde(default)]
    pub names: std::collections::BTreeMap<String, String>,
    /// Values of columns that the log lacks.
    #[serde(default)]
    pub constants: std::collections::BTreeMap<String, f64>,
    /// Time from the first row from which on the policy acted \[s\], in a log without phases.
    #[serde(default)]
    pub from_s: f64,
}

/// A log: the phase of each row, and its numbers.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LogRows(pub Vec<(String, Row)>);

impl LogRows {
    /// Reads a log, and its older half if there is one; `.mcap` is a bag. Rows without a phase count as those of the policy from
    /// [`Columns::from_s`] on, and as those of the stance before.
    ///
    /// # Errors
    /// A file cannot be read, or lacks a column.
    pub fn read(path: &Path, columns: &Columns) -> anyhow::Result<Self> {
        if path.extension().is_some_and(|extension| extension == "mcap") {
            let rows = super::bag::read(path, columns)?;
            let begin_s = rows.first().map_or(0.0, |row| row.time_s);
            let phased = |row: Row| (phase_at(row.time_s - begin_s, columns).to_owned(), row);
            return Ok(LogRows(rows.into_iter().map(phased).collect()));
        }
        let older = crate::bridge::log::older(path);
        let mut rows = if older.exists() { Self::read_one(&older, columns)? } else { Vec::new() };
        rows.extend(Self::read_one(path, columns)?);
        Ok(LogRows(rows))
    }

    fn read_one(path: &Path, names: &Columns) -> anyhow::Result<Vec<(String, Row)>> {
        let fail = FileError::of("cannot read the log", path);
        let mut table = csv::ReaderBuilder::new().flexible(true).from_path(path).map_err(fail)?;
        let headers = table.headers().map_err(fail)?;
        let found: Vec<String> = headers.iter().map(|name| name.trim().to_owned()).collect();
        let place = |ours: &str| {
            let name = names.names.get(ours).map_or(ours, String::as_str);
            found.iter().position(|known| known == name)
        };
        let phase = place("phase");
        let mut sources = Vec::new();
        for ours in columns().iter().skip(1) {
            sources.push(match (place(ours), names.constants.get(ours)) {
                (Some(place), _) => Ok(place),
                (None, Some(constant)) => Err(*constant),
                // Older logs and those of other programs have no commanded compliance.
                (None, None) if ours == COMPLIANCE => Err(0.0),
                (None, None) => bail!(
                    "the log has no column '{ours}': describe its columns in a YAML file (--columns), with the name of each of ours \
                     and that of the log's; it has: {}",
                    found.join(", ")
                ),
            });
        }
        let mut rows = Vec::new();
        for record in table.records() {
            let record = record.map_err(fail)?;
            // A program that was killed may leave an incomplete last line.
            if record.len() < found.len() {
                continue;
            }
            let number = |source: &Result<usize, f64>| match source {
                Ok(place) => record.get(*place).and_then(|text| text.trim().parse().ok()).unwrap_or(f64::NAN),
                Err(constant) => *constant,
            };
            let numbers: Vec<f64> = sources.iter().map(number).collect();
            let Some(row) = Row::from_numbers(&numbers) else { continue };
            let begin_s = rows.first().map_or(row.time_s, |(_, first): &(String, Row)| first.time_s);
            let logged = phase.and_then(|place| record.get(place));
            rows.push((logged.unwrap_or(phase_at(row.time_s - begin_s, names)).to_owned(), row));
        }
        Ok(rows)
    }

    /// Returns the rows of one run of the policy, at most `most`, with some of the stance before it: of the last run that is at least
    /// `fewest` rows long, or else of the longest.
    pub(super) fn of_policy(&self, fewest: usize, most: usize) -> &[(String, Row)] {
        let (mut runs, mut at): (Vec<&[(String, Row)]>, usize) = (Vec::new(), 0);
        for run in self.0.chunk_by(|(a, _), (b, _)| a == b) {
            at += run.len();
            if run[0].0 == "policy" {
                let first = at - run.len();
                let held =
                    self.0[..first].iter().rev().take(HELD_ROWS).take_while(|(phase, _)| phase == "hold").count();
                runs.push(&self.0[first - held..at.min(first + most)]);
            }
        }
        let is_long = |run: &&&[(String, Row)]| run.iter().filter(|(phase, _)| phase == "policy").count() >= fewest;
        let longest = || runs.iter().max_by_key(|run| run.len());
        runs.iter().rfind(is_long).or_else(longest).copied().unwrap_or_default()
    }
}

/// Returns the phase of a row in a log without phases.
fn phase_at(time_s: f64, columns: &Columns) -> &'static str {
    if time_s < columns.from_s { "hold" } else { "policy" }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reads a log with this text, and says what is wrong with it.
    fn read(text: &str, columns: &Columns) -> Result<Vec<(String, Row)>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.csv");
        std::fs::write(&path, text).unwrap();
        LogRows::read(&path, columns).map(|rows| rows.0).map_err(|error| error.to_string())
    }

    #[test]
    fn log_of_another_program_is_read_by_the_names_of_its_columns() {
        let header = columns().join(",").replace("gyro_x", "omega_x").replace(",kp,kd", "");
        let row = crate::bridge::log::tests::row(1.0);
        let numbers: Vec<String> = row.numbers().iter().map(f64::to_string).collect();
        let text = format!("{header}\npolicy,{}\n", numbers[..numbers.len() - 2].join(","));
        let error = read(&text, &Columns::default()).unwrap_err();
        assert!(error.contains("gyro_x") && error.contains("omega_x"), "{error}");
        let described = Columns {
            names: [("gyro_x".to_owned(), "omega_x".to_owned())].into(),
            constants: [("kp".to_owned(), 40.0), ("kd".to_owned(), 1.0)].into(),
            from_s: 0.0,
        };
        let expected = [("policy".to_owned(), Row { gains: [40.0, 1.0], ..row })];
        assert_eq!(read(&text, &described).unwrap(), expected);
    }

    #[test]
    fn torn_last_line_and_a_missing_compliance_leave_the_other_rows() {
        let row = Row { compliance: 0.0, ..crate::bridge::log::tests::row(1.0) };
        let place = columns().iter().position(|name| name == COMPLIANCE).unwrap();
        let mut numbers: Vec<String> = row.numbers().iter().map(f64::to_string).collect();
        numbers.remove(place - 1);
        let header = columns().join(",").replace(",command_compliance", "");
        let line = format!("policy,{}", numbers.join(","));
        let text = format!("{header}\n{line}\n{}", &line[..line.len() / 2]);
        assert_eq!(read(&text, &Columns::default()).unwrap(), [("policy".to_owned(), row)]);
    }

    #[test]
    fn last_run_of_the_policy_is_checked_unless_it_is_short() {
        let phases =
            [("hold", 3), ("policy", 5), ("damped", 2), ("hold", 200), ("policy", 9), ("hold", 4), ("policy", 2)];
        let named = phases.iter().flat_map(|(phase, count)| std::iter::repeat_n(*phase, *count));
        let rows =
            named.enumerate().map(|(index, phase)| (phase.to_owned(), crate::bridge::log::tests::row(index as f64)));
        let rows = LogRows(rows.collect());
        let of = |fewest, most| {
            let found = rows.of_policy(fewest, most);
            (found[0].1.time_s as usize, found.len())
        };
        assert_eq!(of(2, 100), (219, 4 + 2));
        assert_eq!(of(3, 100), (110, 100 + 9));
        assert_eq!(of(3, 4), (110, 100 + 4));
        assert_eq!(of(50, 100), (110, 100 + 9));
        assert!(LogRows::default().of_policy(2, 100).is_empty());
    }
}
