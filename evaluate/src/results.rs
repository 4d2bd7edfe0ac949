//! The results of an experiment for all sets of policies, and their means by seed.

use std::collections::BTreeMap;

use super::statistics::{Comparison, Numbers, PerSeed, Trials, mean};
use super::trial::{Sample, TrialEnd};
use super::{Condition, Quantity};

/// The samples of one policy, shape (conditions, trials).
pub type PolicyResult = Vec<Vec<Sample>>;

/// The samples of an experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Results {
    /// The names of the sets, two or more; the first two are compared.
    pub names: Vec<String>,
    pub conditions: Vec<Condition>,
    pub quantities: &'static [Quantity],
    /// The samples by set, then by seed.
    pub sets: Vec<BTreeMap<u64, PolicyResult>>,
}

/// The number of trials of a set by how they ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct EndCounts {
    /// The number of trials that were played.
    pub trials: usize,
    /// The number of trials that ended in a fall.
    pub falls: usize,
    /// The number of trials in which the policy, the physics or the sensors failed.
    pub faults: usize,
    /// The number of trials that were not played, because the policy does not support their commanded compliance.
    #[serde(skip_serializing_if = "is_zero")]
    pub out_of_reach: usize,
}

#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_zero(count: &usize) -> bool {
    *count == 0
}

impl Results {
    /// Returns the index of a quantity by name.
    pub fn index(&self, quantity: &str) -> usize {
        let found = self.quantities.iter().position(|known| known.name == quantity);
        // Experiments use the names in their own lists; a test covers every experiment.
        found.unwrap_or_else(|| panic!("no quantity {quantity}"))
    }

    /// Returns a quantity by name.
    pub fn quantity(&self, name: &str) -> Quantity {
        self.quantities[self.index(name)]
    }

    /// Returns the mean over a condition's trials for each seed of a set.
    pub fn per_seed(&self, set: usize, condition: usize, quantity: &str) -> PerSeed {
        self.per_seed_over(set, &[condition], quantity)
    }

    /// Returns the mean over conditions of the mean over trials for each seed of a set. A trial that leaves the quantity
    /// undefined for one policy of a pair is left out for both: otherwise a policy that falls in hard trials would be
    /// averaged over easy ones. A policy whose partner has no number at all keeps its own. The first two sets are each
    /// other's partners; the partner of every further set is the first.
    pub fn per_seed_over(&self, set: usize, conditions: &[usize], quantity: &str) -> PerSeed {
        let quantity = self.index(quantity);
        let partners = self.sets.get(usize::from(set == 0));
        let of_seed = |(seed, policy): (&u64, &PolicyResult)| {
            let partner = partners.and_then(|set| set.get(seed));
            let partner =
                partner.filter(|other| conditions.iter().any(|c| mean_of(other, None, *c, quantity).is_some()));
            Some((*seed, mean(conditions.iter().filter_map(|c| mean_of(policy, partner, *c, quantity)))?))
        };
        self.sets[set].iter().filter_map(of_seed).collect()
    }

    /// Compares the sets by each policy's mean over conditions of the mean over trials.
    pub fn compare_over(&self, conditions: &[usize], quantity: &str) -> Comparison {
        let sets = (0..self.sets.len()).map(|set| self.numbers(set, self.per_seed_over(set, conditions, quantity)));
        Comparison::new(sets.collect()).with_trials(self.trials(conditions, self.index(quantity)))
    }

    /// Returns "N of M directions": the first set's number is larger in N of the M directions that have pairs of seeds.
    pub fn larger_in(&self, directions: &[usize], quantity: &str) -> String {
        let differences: Vec<f64> =
            directions.iter().filter_map(|c| Some(self.compare_over(&[*c], quantity).difference?.value)).collect();
        let larger = differences.iter().filter(|difference| **difference > 0.0).count();
        format!("{larger} of {} directions", differences.len())
    }

    /// Creates the numbers of a set from values by seed.
    pub fn numbers(&self, set: usize, by_seed: PerSeed) -> Numbers {
        Numbers::new(by_seed, self.sets[set].len())
    }

    /// Counts the pairs of trials of the first two sets, and those in which both policies have a number.
    fn trials(&self, conditions: &[usize], quantity: usize) -> Trials {
        let mut trials = Trials { used: 0, of: 0 };
        for seed in self.common_seeds() {
            for condition in conditions {
                let [a, b] = [0, 1].map(|set| self.sets[set][&seed].get(*condition).into_iter().flatten());
                for (a, b) in a.zip(b) {
                    trials.of += 1;
                    trials.used += usize::from(a.values[quantity].is_some() && b.values[quantity].is_some());
                }
            }
        }
        trials
    }

    /// Returns the seeds that both of the first two sets have.
    pub fn common_seeds(&self) -> Vec<u64> {
        self.sets[0].keys().filter(|seed| self.sets[1].contains_key(seed)).copied().collect()
    }

    /// Returns the seed that figures of single policies show: the least common seed of the first two sets, else the set's least.
    pub fn shown_seed(&self, set: usize) -> Option<u64> {
        let common = self.common_seeds();
        common.first().filter(|seed| self.sets[set].contains_key(seed)).or(self.sets[set].keys().next()).copied()
    }

    /// Returns the title of figures that show the policy of the shown seed of a set, and its samples.
    pub fn shown(&self, set: usize) -> (String, Option<&PolicyResult>) {
        let seed = self.shown_seed(set);
        let words = seed.map_or("–".into(), |seed| seed.to_string());
        (format!("{}, seed {words}", self.names[set]), seed.and_then(|seed| self.sets[set].get(&seed)))
    }

    /// Describes the faults in the trials of a set: their number and the first of them; `None` if there were none.
    pub fn faults(&self, set: usize) -> Option<String> {
        let (name, EndCounts { trials, faults, .. }) = (&self.names[set], self.ends(set));
        for (seed, policy) in &self.sets[set] {
            for (samples, Condition { label, .. }) in policy.iter().zip(&self.conditions) {
                let Some(trial) = samples.iter().position(|sample| sample.end == TrialEnd::Fault) else { continue };
                let label = if label.is_empty() { String::new() } else { format!("condition {label}, ") };
                let reason = samples[trial].fault.as_deref().unwrap_or("its reason was not kept");
                return Some(format!(
                    "{faults} of {trials} trials of {name} ended in a fault; they count as no success and have no other \
                     numbers. The first, policy of seed {seed}, {label}trial {}: {reason}",
                    trial + 1
                ));
            }
        }
        None
    }

    /// Counts how the trials of a set ended.
    pub fn ends(&self, set: usize) -> EndCounts {
        let mut ends = EndCounts::default();
        for sample in self.sets[set].values().flatten().flatten() {
            ends.trials += usize::from(sample.end != TrialEnd::OutOfReach);
            ends.out_of_reach += usize::from(sample.end == TrialEnd::OutOfReach);
            ends.falls += usize::from(sample.end == TrialEnd::Fell);
            ends.faults += usize::from(sample.end == TrialEnd::Fault);
        }
        ends
    }
}

/// Returns the mean over the trials of a condition that define a quantity for the policy and for its partner, if it has one.
fn mean_of(policy: &PolicyResult, partner: Option<&PolicyResult>, condition: usize, quantity: usize) -> Option<f64> {
    let others = partner.and_then(|partner| partner.get(condition));
    let counts = |trial: usize| {
        others.is_none_or(|others| others.get(trial).is_some_and(|other| other.values[quantity].is_some()))
    };
    let trials = policy.get(condition)?.iter().enumerate();
    mean(trials.filter(|(trial, _)| counts(*trial)).filter_map(|(_, sample)| sample.values[quantity]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Experiment;
    use crate::protocol::Protocol;

    /// Returns results of the decay experiment with one trial for each condition; a missing value is a fall.
    fn results(sets: &[Vec<[Option<f64>; 2]>]) -> Results {
        let protocol = Protocol::quick().unwrap();
        let condition = protocol.decay.conditions().unwrap().remove(0);
        let sample = |value: &Option<f64>| {
            let (fell, end) = value.map_or((1.0, TrialEnd::Fell), |_| (0.0, TrialEnd::Upright));
            Sample::new(end, vec![*value, None, None, None, None, Some(fell)])
        };
        let policy = |values: &[Option<f64>; 2]| values.iter().map(|value| vec![sample(value)]).collect();
        Results {
            names: ["a", "b", "c"][..sets.len()].iter().map(ToString::to_string).collect(),
            conditions: vec![condition.clone(), condition],
            quantities: protocol.decay.info().quantities,
            sets: sets.iter().map(|set| (0..).zip(set.iter().map(policy)).collect()).collect(),
        }
    }

    #[test]
    fn condition_without_a_partner_is_left_out_for_both() {
        // Seed 0: b fell in condition 1, so that only condition 0 counts: 1 against 2, not (1 + 9) / 2 against 2.
        let results = results(&[
            vec![[Some(1.0), Some(9.0)], [Some(3.0), Some(5.0)]],
            vec![[Some(2.0), None], [Some(3.0), Some(5.0)]],
        ]);
        let comparison = results.compare_over(&[0, 1], "decay_10_s");
        assert_eq!((comparison.sets[0].by_seed[&0], comparison.sets[1].by_seed[&0]), (1.0, 2.0));
        assert_eq!((comparison.sets[0].by_seed[&1], comparison.sets[1].by_seed[&1]), (4.0, 4.0));
        assert_eq!(comparison.trials, Some(Trials { used: 3, of: 4 }));
        assert_eq!(results.larger_in(&[0, 1], "decay_10_s"), "0 of 2 directions");
    }

    #[test]
    fn policies_that_share_no_trial_are_not_compared() {
        // One has a number where the other has none, and the other way round.
        let results = results(&[vec![[Some(1.0), None]], vec![[None, Some(2.0)]]]);
        let comparison = results.compare_over(&[0, 1], "decay_10_s");
        assert!(comparison.sets.iter().all(|set| set.by_seed.is_empty()) && comparison.difference.is_none());
    }

    #[test]
    fn trial_without_a_partner_is_left_out_for_both() {
        // Two trials of one condition: the first is easy, and a falls in the second.
        let mut results = results(&[vec![[Some(1.0), None]], vec![[Some(2.0), Some(8.0)]]]);
        for set in &mut results.sets {
            let policy = set.get_mut(&0).unwrap();
            let second = policy.remove(1);
            policy[0].extend(second);
        }
        assert_eq!(results.compare_over(&[0], "decay_10_s").sets[1].by_seed[&0], 2.0);
        assert_eq!(results.compare_over(&[0], "fell").sets[0].by_seed[&0], 0.5);
    }

    #[test]
    fn policy_keeps_its_mean_if_its_partner_has_none() {
        let results = results(&[vec![[Some(1.0), Some(3.0)]], vec![[None, None]]]);
        let comparison = results.compare_over(&[0, 1], "decay_10_s");
        assert_eq!((comparison.sets[0].by_seed.get(&0), comparison.sets[1].by_seed.get(&0)), (Some(&2.0), None));
        assert_eq!((results.ends(1).falls, results.ends(1).trials), (2, 2));
    }

    #[test]
    fn third_set_is_paired_with_the_first() {
        let both = [vec![[Some(1.0), Some(3.0)]], vec![[Some(2.0), None]]];
        let third = vec![[Some(5.0), Some(7.0)]];
        let (two, three) = (results(&both), results(&[&both[..], &[third]].concat()));
        let [two, three] = [two, three].map(|results| results.compare_over(&[0, 1], "decay_10_s"));
        assert_eq!(three.sets[..2], two.sets);
        assert_eq!((three.difference, three.relative, three.trials), (two.difference, two.relative, two.trials));
        // b fell in condition 1, which is left out for a; a did not, so that c keeps both.
        assert_eq!((three.sets[0].by_seed[&0], three.sets[2].by_seed[&0]), (1.0, 6.0));
    }
}
