//! The claims of this report beside those of other reports: on another robot, with other joints, after more samples.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::Value;

use super::markdown::Rows;
use super::{Report, summary};
use crate::Quantity;
use crate::section_content::{NOTHING, difference, number, percent};
use crate::statistics::{Comparison, IntervalEstimate, Numbers, PerSeed, Spread};
use supple::util::files;

/// The title of the table.
pub const TITLE: &str = "Beside other reports";

/// The text above the table.
pub const CAPTION: &str = "Means of both sets, and the difference of the first from the second: relative, in points \
                           for fractions, or absolute where a mean is not above zero, with the 95 % interval; with \
                           fewer than five pairs, the number of pairs that differ that way. –: not measured there, or \
                           with another protocol.";

/// The largest summary that is read \[bytes\].
const MAX_BYTES: u64 = 1 << 28;

/// The reason why another report cannot be shown.
#[derive(Debug, thiserror::Error)]
pub enum OtherReportError {
    /// The summary cannot be read.
    #[error("cannot read {}: {source}; expected the folder of a finished report", path.display())]
    Read {
        /// The expected path of the summary.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The file is not a summary, or one of another version of this program.
    #[error("{} is not the summary of a report: {source}; make the report again with this program", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// The position in the file and what is wrong there.
        source: serde_json::Error,
    },
    /// The report does not compare two sets of policies.
    #[error("{} has {found} sets of policies, expected two or more; make the report again with this program", path.display())]
    Sets {
        /// The file.
        path: PathBuf,
        /// The number of sets found.
        found: usize,
    },
}

/// The claims of another report.
#[derive(Debug, Clone)]
pub struct OtherReport {
    /// The name of the other report in this one.
    pub name: String,
    sets: [String; 2],
    experiments: Vec<ExperimentRecord>,
}

#[derive(Deserialize)]
struct SummaryRecord {
    sets: Vec<String>,
    experiments: Vec<ExperimentRecord>,
}

#[derive(Debug, Clone, Deserialize)]
struct ExperimentRecord {
    name: String,
    parameters: Value,
    claims: Vec<ClaimRecord>,
}

#[derive(Debug, Clone, Deserialize)]
struct ClaimRecord {
    quantity: String,
    ours: NumbersRecord,
}

#[derive(Debug, Clone, Deserialize)]
struct NumbersRecord {
    sets: BTreeMap<String, SetRecord>,
    difference: Option<IntervalEstimate>,
    relative: Option<IntervalEstimate>,
}

#[derive(Debug, Clone, Deserialize)]
struct SetRecord {
    mean: Option<f64>,
    sd: Option<f64>,
    by_seed: PerSeed,
}

impl NumbersRecord {
    /// Returns the numbers of two sets in the quantity's printed unit.
    fn comparison(&self, sets: &[String; 2]) -> Comparison {
        let numbers = |name: &String| {
            let SetRecord { mean, sd, by_seed } = self.sets.get(name)?.clone();
            let members = by_seed.len();
            Some(Numbers { by_seed, spread: mean.map(|mean| Spread { mean, sd, seeds: members }), members })
        };
        let sets = sets.iter().filter_map(numbers).collect();
        Comparison { sets, difference: self.difference, relative: self.relative, trials: None }
    }
}

impl OtherReport {
    /// Reads the summary in the folder of a report.
    ///
    /// # Errors
    /// The summary cannot be read, has another form, or has fewer than two sets.
    pub fn read(name: &str, folder: &Path) -> Result<Self, OtherReportError> {
        let path = folder.join("summary.json");
        let bytes = files::read_bounded(&path, MAX_BYTES)
            .map_err(|source| OtherReportError::Read { path: path.clone(), source })?;
        let summary: SummaryRecord =
            serde_json::from_slice(&bytes).map_err(|source| OtherReportError::Parse { path: path.clone(), source })?;
        let [first, second, ..] = &summary.sets[..] else {
            return Err(OtherReportError::Sets { path, found: summary.sets.len() });
        };
        let sets = [first, second].map(ToOwned::to_owned);
        Ok(OtherReport { name: name.to_owned(), sets, experiments: summary.experiments })
    }

    /// Returns the cell of a claim, or a dash if the other report measured it with other parameters or not at all.
    fn cell(&self, experiment: &str, parameters: &Value, index: usize, quantity: Quantity) -> String {
        let is_it = |there: &&ExperimentRecord| there.name == experiment && there.parameters == *parameters;
        let claim = self.experiments.iter().find(is_it).and_then(|there| there.claims.get(index));
        let numbers = claim.filter(|claim| claim.quantity == quantity.name).map(|it| it.ours.comparison(&self.sets));
        numbers.map_or(NOTHING.to_owned(), |there| cell(&there.scaled(1.0 / quantity.scale()), quantity))
    }
}

/// Returns the column titles and rows of the table: each claim, here and in the other reports.
pub fn table(report: &Report) -> Rows {
    let columns =
        ["experiment", "claim", "here"].into_iter().chain(report.other_reports.iter().map(|other| &*other.name));
    let of_section = |section: &super::Section| {
        let (info, parameters) = (section.info, summary::rounded(section.parameters.clone()));
        let row = move |(index, claim): (usize, &crate::section_content::Claim)| {
            let there =
                report.other_reports.iter().map(|other| other.cell(info.name, &parameters, index, claim.quantity));
            let here = [info.id.to_owned(), claim.text.clone(), cell(&claim.comparison, claim.quantity)];
            here.into_iter().chain(there).collect()
        };
        section.content.claims.iter().enumerate().map(row).collect::<Vec<_>>()
    };
    (columns.map(ToOwned::to_owned).collect(), report.sections.iter().flat_map(of_section).collect())
}

/// Returns means of both sets, the difference first − second, and, with too few pairs for an interval, how many agree with it.
fn cell(comparison: &Comparison, quantity: Quantity) -> String {
    let mean = |set: &Numbers| set.spread.map_or(NOTHING.to_owned(), |spread| number(spread.mean, quantity));
    let means = comparison.pair().iter().map(mean).collect::<Vec<_>>().join(" / ");
    let unit = if quantity.unit.is_empty() { String::new() } else { format!(" {}", quantity.unit) };
    let apart = match comparison.relative {
        Some(_) if quantity.unit != "%" => percent(comparison.relative, " %"),
        _ => difference(comparison, quantity, &unit.replace('%', "points")),
    };
    let few = comparison.difference.filter(|estimate| estimate.interval.is_none() && estimate.value != 0.0);
    let agree = few.and_then(|estimate| {
        let [a, b] = comparison.pair() else { return None };
        let pairs: Vec<f64> = a.by_seed.iter().filter_map(|(seed, value)| Some(value - b.by_seed.get(seed)?)).collect();
        let same = pairs.iter().filter(|apart| *apart * estimate.value > 0.0).count();
        (pairs.len() > 1).then(|| format!(" ({same} of {} pairs)", pairs.len()))
    });
    format!("{means}{unit}: {apart}{}", agree.unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::Trials;
    use serde_json::json;

    const TIME: Quantity = Quantity::new("decay_10_s", "decay", "s", 2);

    fn numbers(values: &[f64]) -> Numbers {
        Numbers::new((0..).zip(values.iter().copied()).collect(), values.len())
    }

    #[test]
    fn cell_has_means_and_relative_difference() {
        let few = Comparison::new(vec![numbers(&[0.6, 0.5, 0.4]), numbers(&[0.4, 0.4, 0.5])]);
        // (1.5 − 1.3) / 1.3 = 15 %; the third pair differs the other way.
        assert_eq!(cell(&few, TIME), "0.50 / 0.43 s: +15 % (2 of 3 pairs)");
        let share = Quantity::new("held", "held", "%", 0);
        let shares = Comparison::new(vec![numbers(&[0.9]), numbers(&[0.8])]);
        assert_eq!(
            cell(&shares.with_trials(Trials { used: 4, of: 5 }), share),
            "90 / 80 %: +10.0 points (4 of 5 trials)"
        );
    }

    #[test]
    fn summaries_match_by_experiment_and_protocol() {
        let folder = tempfile::tempdir().unwrap();
        let summary = r#"{"sets": ["soft", "stiff"], "experiments": [{"name": "decay", "parameters": {"trials": 20}, "claims": [
            {"quantity": "decay_10_s", "ours": {"sets": {"soft": {"mean": 0.6, "sd": null, "by_seed": {"0": 0.6}},
             "stiff": {"mean": 0.4, "sd": null, "by_seed": {"0": 0.4}}},
             "difference": {"value": 0.2, "interval": null, "pairs": 1},
             "relative": {"value": 0.5, "interval": [0.4, 0.6], "pairs": 1}}}]}]}"#;
        std::fs::write(folder.path().join("summary.json"), summary).unwrap();
        let other = OtherReport::read("go2", folder.path()).unwrap();
        let cell = |trials: u32, index, quantity| other.cell("decay", &json!({ "trials": trials }), index, quantity);
        assert_eq!(cell(20, 0, TIME), "0.60 / 0.40 s: +50 [+40, +60] %");
        assert_eq!(cell(20, 1, TIME), NOTHING);
        assert_eq!(cell(20, 0, Quantity { name: "decay_20_s", ..TIME }), NOTHING);
        assert_eq!(cell(5, 0, TIME), NOTHING, "another protocol");
        assert!(matches!(OtherReport::read("x", &folder.path().join("none")), Err(OtherReportError::Read { .. })));
        std::fs::write(folder.path().join("summary.json"), "{}").unwrap();
        assert!(matches!(OtherReport::read("x", folder.path()), Err(OtherReportError::Parse { .. })));
    }
}
