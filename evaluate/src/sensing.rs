/*! E12: every experiment with the robot acting on its sensors, each number beside the one with the true state.

For each of the two sets that are compared, an experiment's tables are made again with the trials on estimates as the first set
and the trials on the true state as the second. Trials are paired as everywhere: trial *k* of a seed differs only in what the policy
sees. A further table has the errors of the estimates.
*/

use std::collections::BTreeMap;

use super::policy_sets::PolicySets;
use super::results::{EndCounts, PolicyResult, Results};
use super::runner::Measurement;
use super::section_content::{Row, Table};
use super::statistics::{Comparison, Numbers, PerSeed, mean};
use super::{Experiment, FELL, Quantity};
use supple::estimate::contact::ContactNetwork;
use supple::scenario::estimation::Estimation;

/// The names of the two sets that are compared.
pub const NAMES: [&str; 2] = ["estimated", "true state"];

/// An error of the estimates of a trial: its quantity and how to read it.
type EstimateError = (Quantity, fn(&Estimation) -> Option<f64>);

/// The errors of the estimates that are reported.
const ERRORS: [EstimateError; 4] = [
    (Quantity::new("estimate_velocity_rmse_m_s", "velocity, RMSE", "m/s", 3), |e| Some(e.velocity_rmse_m_s)),
    (Quantity::new("estimate_height_rmse_m", "height, RMSE", "m", 4), |e| Some(e.height_rmse_m)),
    (Quantity::new("estimate_drift_m", "drift at the end", "m", 3), |e| Some(e.drift_m)),
    (Quantity::new("contact_f1", "contacts, F1", "", 3), |e| e.contact_f1),
];

/// The effect of acting on sensors, over all experiments that were run with estimated sensing.
#[derive(Debug, Clone, PartialEq)]
pub struct SensingComparison {
    /// The names of the two sets of policies that are compared.
    set_names: Vec<String>,
    /// The table of the claims' quantities and of falls; the estimated set comes first.
    pub main: Table,
    /// The table of all quantities, which is written to files only.
    pub all: Table,
    /// The table of the errors of the estimates, by set of policies.
    pub errors: Table,
    pub notes: Vec<String>,
    pub experiments: Vec<&'static str>,
    pub network: String,
    /// The time that the trials on estimates took \[s\].
    pub wall_s: f64,
}

impl SensingComparison {
    /// Creates a comparison without experiments, of the first two sets.
    pub fn new(policies: &PolicySets) -> Self {
        let compared = || policies.sets.iter().take(2);
        let table = |name: &str, caption: &str, in_page| Table::new(name, caption, Vec::new(), in_page);
        let members = compared().flat_map(|set| set.members.iter().map(move |member| (set, member)));
        let labelled =
            members.map(|(set, member)| (format!("{}-seed{}", set.name, member.seed), member.agent.sha256.as_str()));
        // Without a network no trial on estimates can have been played.
        let network = ContactNetwork::shipped().ok();
        SensingComparison {
            set_names: compared().map(|set| set.name.clone()).collect(),
            main: table(
                "sensing",
                "The effect of acting on sensors: falls, and the quantities of the paper's claims.",
                true,
            ),
            all: table("sensing-all", "The effect of acting on sensors: all quantities.", false),
            errors: table(
                "sensing-errors",
                "Errors of the estimates until the first fall, mean over all conditions and trials: velocity as a \
                 vector in the base frame, height of the base, horizontal position at the end, contacts of all feet.",
                true,
            ),
            notes: network.as_ref().and_then(|network| network.unfamiliar(labelled)).into_iter().collect(),
            experiments: Vec::new(),
            network: network.as_ref().map_or(String::new(), ContactNetwork::checksum),
            wall_s: 0.0,
        }
    }

    /// Adds an experiment that was run on the true state and on estimates; both begin with the two sets that are compared.
    pub fn add(&mut self, experiment: &dyn Experiment, truth: &Measurement, estimated: &Measurement) {
        let info = experiment.info();
        self.experiments.push(info.name);
        self.wall_s += estimated.wall_s;
        for (set, name) in self.set_names.iter().enumerate() {
            let sets = [estimated, truth].map(|measured| measured.results.sets[set].clone()).into();
            let (conditions, quantities) = (truth.results.conditions.clone(), truth.results.quantities);
            let results = Results { names: NAMES.map(ToOwned::to_owned).into(), conditions, quantities, sets };
            let content = experiment.content(&results);
            let of = format!("{} {}, {name}", info.id, info.name);
            let EndCounts { faults, trials, .. } = results.ends(0);
            if faults > 0 {
                let failed = format!("sensors or physics failed in {faults} of {trials} trials on estimates");
                self.notes.push(format!("{of}: {failed}; they have no numbers."));
            }
            self.notes.extend(content.notes.iter().map(|note| format!("{of}: {note}")));
            let is_claimed = |name: &str| content.claims.iter().any(|claim| claim.quantity.name == name);
            for table in &content.tables {
                for row in &table.rows {
                    let place = if row.condition.is_empty() { String::new() } else { format!(", {}", row.condition) };
                    let condition = format!("{} {}{place}, {name}", info.id, info.name);
                    let row = Row::new(condition, row.quantity, row.comparison.clone());
                    if table.in_page && (row.quantity == FELL || is_claimed(row.quantity.name)) {
                        self.main.rows.push(row.clone());
                    }
                    // Some experiments have a part of a table in the page and all of it in a file.
                    if !self.all.rows.contains(&row) {
                        self.all.rows.push(row);
                    }
                }
            }
        }
        for (quantity, of) in ERRORS {
            let sets = estimated.results.sets.iter().map(|set| Numbers::new(errors(set, of), set.len()));
            let condition = format!("{} {}", info.id, info.name);
            self.errors.rows.push(Row::new(condition, quantity, Comparison::new(sets.collect())));
        }
    }

    /// Returns the tables, each with the names of its sets; none if no experiment was run.
    pub fn tables(&self) -> Vec<(&Table, Vec<String>)> {
        let ways = || NAMES.map(ToOwned::to_owned).to_vec();
        let tables = vec![(&self.main, ways()), (&self.errors, self.set_names.clone()), (&self.all, ways())];
        if self.experiments.is_empty() { Vec::new() } else { tables }
    }
}

/// Returns the mean of an error over all trials of each policy.
fn errors(set: &BTreeMap<u64, PolicyResult>, of: fn(&Estimation) -> Option<f64>) -> PerSeed {
    let of_policy = |policy: &PolicyResult| mean(policy.iter().flatten().filter_map(|s| of(s.estimation.as_ref()?)));
    set.iter().filter_map(|(seed, policy)| Some((*seed, of_policy(policy)?))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy_sets::PolicySet;
    use crate::protocol::Protocol;
    use crate::trial::{Sample, TrialEnd};

    fn policy_sets() -> PolicySets {
        let set = |name: &str| PolicySet { name: name.into(), members: Vec::new() };
        PolicySets { sets: vec![set("compliant"), set("baseline")], notes: Vec::new() }
    }

    /// Returns results in which each trial of set s and seed k has the value `value + s + k`, and an estimate with an error of a
    /// hundredth of it.
    fn measurement(experiment: &dyn Experiment, value: f64, is_estimated: bool) -> Measurement {
        let conditions = experiment.conditions().unwrap();
        let sample = |value: f64| {
            let (velocity_rmse_m_s, height_rmse_m, drift_m, contact_f1) = (0.01 * value, 0.0, 0.0, None);
            let estimation = Estimation { velocity_rmse_m_s, height_rmse_m, drift_m, contact_f1 };
            let sample = Sample::new(TrialEnd::Upright, vec![Some(value); experiment.info().quantities.len()]);
            Sample { estimation: is_estimated.then_some(estimation), ..sample }
        };
        let policy = |value| vec![vec![sample(value); experiment.info().trials as usize]; conditions.len()];
        let set = |set: f64| BTreeMap::from([(0, policy(value + set)), (1, policy(value + set + 1.0))]);
        let (names, quantities, sets) =
            (policy_sets().names(), experiment.info().quantities, vec![set(0.0), set(10.0)]);
        let results = Results { names, quantities, sets, conditions };
        Measurement { results, wall_s: 1.0, revisions: Default::default() }
    }

    #[test]
    fn estimated_numbers_are_paired_with_true_ones() {
        let protocol = Protocol::quick().unwrap();
        let mut found = SensingComparison::new(&policy_sets());
        found.add(&protocol.walk, &measurement(&protocol.walk, 2.0, false), &measurement(&protocol.walk, 3.0, true));
        let row = |condition: &str| {
            let is_row = |row: &&Row| row.condition == condition && row.quantity.name == "velocity_error_m_s";
            found.main.rows.iter().find(is_row).unwrap_or_else(|| panic!("{:#?}", found.main.rows))
        };
        // Seeds 0 and 1: 3 and 4 estimated against 2 and 3 true; ten more of the second set.
        for (set, more) in [("compliant", 0.0), ("baseline", 10.0)] {
            let comparison = &row(&format!("E0 walk, forward 0.5, {set}")).comparison;
            assert_eq!(comparison.sets[0].spread.unwrap().mean, 3.5 + more);
            assert_eq!(comparison.sets[1].spread.unwrap().mean, 2.5 + more);
            assert_eq!(comparison.difference.unwrap().value, 1.0);
        }
        let velocity = &found.errors.rows[0].comparison;
        assert!((velocity.sets[0].spread.unwrap().mean - 0.035).abs() < 1e-12);
        assert!((velocity.sets[1].spread.unwrap().mean - 0.135).abs() < 1e-12);
        assert_eq!(found.errors.rows[3].comparison.sets[0].spread, None, "no contacts, no score");
    }

    #[test]
    fn every_experiment_has_falls_or_claims_in_the_table() {
        let protocol = Protocol::quick().unwrap();
        for experiment in protocol.experiments() {
            let mut found = SensingComparison::new(&policy_sets());
            found.add(experiment, &measurement(experiment, 0.5, false), &measurement(experiment, 0.5, true));
            assert!(!found.main.rows.is_empty(), "{}", experiment.info().name);
            assert!(found.main.rows.len() <= found.all.rows.len());
            for (index, row) in found.all.rows.iter().enumerate() {
                assert!(!found.all.rows[..index].contains(row), "{row:?} stands there twice");
            }
        }
    }
}
