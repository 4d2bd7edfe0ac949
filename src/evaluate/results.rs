//! What an experiment measured for both sets of policies, and how it is read: always by seed.

use std::collections::BTreeMap;

use super::statistics::{Comparison, PerSeed, mean};
use super::trial::{End, Sample};
use super::{Condition, Quantity};

/// All trials of one policy, shape (conditions, trials).
pub type PolicyResult = Vec<Vec<Sample>>;

/// All trials of an experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Results {
    /// Names of the two sets.
    pub names: [String; 2],
    /// What was varied.
    pub conditions: Vec<Condition>,
    /// What was measured.
    pub quantities: &'static [Quantity],
    /// By set, by seed.
    pub sets: [BTreeMap<u64, PolicyResult>; 2],
}

/// How the trials of a set ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct Ends {
    /// All.
    pub trials: usize,
    /// With a fall.
    pub falls: usize,
    /// With a failure of the physics.
    pub faults: usize,
}

impl Results {
    /// Index of a quantity by name; a name that the experiment lacks is a mistake of the caller.
    ///
    /// # Panics
    /// If there is no such quantity.
    pub fn index(&self, quantity: &str) -> usize {
        let found = self.quantities.iter().position(|known| known.name == quantity);
        // The experiments ask for what they themselves list; a test asks every one of them.
        found.unwrap_or_else(|| panic!("no quantity {quantity}"))
    }

    /// The quantity of that name.
    pub fn quantity(&self, name: &str) -> Quantity {
        self.quantities[self.index(name)]
    }

    /// For each seed, the mean over the trials of a condition that define the quantity.
    pub fn per_seed(&self, set: usize, condition: usize, quantity: &str) -> PerSeed {
        let index = self.index(quantity);
        let of_seed = |(seed, policy): (&u64, &PolicyResult)| Some((*seed, mean_of(policy, condition, index)?));
        self.sets[set].iter().filter_map(of_seed).collect()
    }

    /// Both sets in one condition.
    pub fn compare(&self, condition: usize, quantity: &str) -> Comparison {
        Comparison::new(self.per_seed(0, condition, quantity), self.per_seed(1, condition, quantity))
    }

    /// Both sets, each policy by the mean over conditions of its mean over trials. A condition in which one of a pair
    /// has no number is left out for both: else the one that falls where it is hard would be spared the hard part.
    pub fn compare_over(&self, conditions: &[usize], quantity: &str) -> Comparison {
        let index = self.index(quantity);
        let of_set = |set: usize| -> PerSeed {
            let of_seed = |(seed, policy): (&u64, &PolicyResult)| {
                let partner = self.sets[1 - set].get(seed);
                let shared: Vec<usize> = match partner {
                    Some(partner) => self.shared([policy, partner], conditions, index),
                    None => Vec::new(),
                };
                let used = if shared.is_empty() { conditions } else { &shared };
                Some((*seed, mean(used.iter().filter_map(|condition| mean_of(policy, *condition, index)))?))
            };
            self.sets[set].iter().filter_map(of_seed).collect()
        };
        Comparison::new(of_set(0), of_set(1))
    }

    /// What [`Results::compare_over`] leaves out, in words; none if it is nothing.
    pub fn left_out(&self, conditions: &[usize], quantity: &str) -> Option<String> {
        let (index, seeds) = (self.index(quantity), self.common_seeds());
        let shared = |seed: &u64| {
            let pair = [&self.sets[0][seed], &self.sets[1][seed]];
            self.shared(pair, conditions, index).len()
        };
        let (all, used) = (seeds.len() * conditions.len(), seeds.iter().map(shared).sum::<usize>());
        (used < all).then(|| {
            format!(
                "{} of {all} pairs of policies and directions are left out of the means, for one of the pair has no number \
                 there (it fell in every trial).",
                all - used
            )
        })
    }

    /// Conditions in which both policies have a number.
    fn shared(&self, pair: [&PolicyResult; 2], conditions: &[usize], quantity: usize) -> Vec<usize> {
        let both = |condition: &usize| pair.iter().all(|policy| mean_of(policy, *condition, quantity).is_some());
        conditions.iter().copied().filter(both).collect()
    }

    /// Seeds that both sets have.
    pub fn common_seeds(&self) -> Vec<u64> {
        self.sets[0].keys().filter(|seed| self.sets[1].contains_key(seed)).copied().collect()
    }

    /// The seed that figures of single policies show: the least common one, else the set's least.
    pub fn shown_seed(&self, set: usize) -> Option<u64> {
        self.common_seeds().first().or(self.sets[set].keys().next()).copied()
    }

    /// How a set's trials ended.
    pub fn ends(&self, set: usize) -> Ends {
        let mut ends = Ends::default();
        for sample in self.sets[set].values().flatten().flatten() {
            ends.trials += 1;
            ends.falls += usize::from(sample.end == End::Fell);
            ends.faults += usize::from(sample.end == End::Fault);
        }
        ends
    }
}

/// Mean over the trials of a condition that define a quantity.
fn mean_of(policy: &PolicyResult, condition: usize, quantity: usize) -> Option<f64> {
    mean(policy.get(condition)?.iter().filter_map(|sample| sample.values[quantity]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::Experiment;
    use crate::evaluate::protocol::Protocol;

    /// Results of the decay experiment with one trial for each condition, by set and condition; none is a fall.
    fn results(sets: [Vec<[Option<f64>; 2]>; 2]) -> Results {
        let protocol = Protocol::quick().unwrap();
        let condition = protocol.decay.conditions().unwrap().remove(0);
        let sample = |value: &Option<f64>| {
            let (fell, end) = value.map_or((1.0, End::Fell), |_| (0.0, End::Upright));
            Sample { end, values: vec![Some(fell), *value, None, None], series: Vec::new(), estimation: None }
        };
        let policy = |values: &[Option<f64>; 2]| values.iter().map(|value| vec![sample(value)]).collect();
        Results {
            names: ["a".into(), "b".into()],
            conditions: vec![condition.clone(), condition],
            quantities: protocol.decay.quantities(),
            sets: sets.map(|set| (0..).zip(set.iter().map(policy)).collect()),
        }
    }

    #[test]
    fn a_condition_that_one_of_a_pair_lacks_is_left_out_for_both() {
        // Seed 0: b fell in condition 1, so that only condition 0 counts: 1 against 2, not (1 + 9) / 2 against 2.
        let results = results([
            vec![[Some(1.0), Some(9.0)], [Some(3.0), Some(5.0)]],
            vec![[Some(2.0), None], [Some(3.0), Some(5.0)]],
        ]);
        let comparison = results.compare_over(&[0, 1], "decay_10_s");
        assert_eq!((comparison.a[&0], comparison.b[&0]), (1.0, 2.0));
        assert_eq!((comparison.a[&1], comparison.b[&1]), (4.0, 4.0));
        assert!(results.left_out(&[0, 1], "decay_10_s").unwrap().starts_with("1 of 4 pairs"));
        assert_eq!(results.left_out(&[0], "decay_10_s"), None);
    }

    #[test]
    fn a_policy_keeps_its_mean_if_its_partner_has_none_at_all() {
        let results = results([vec![[Some(1.0), Some(3.0)]], vec![[None, None]]]);
        let comparison = results.compare_over(&[0, 1], "decay_10_s");
        assert_eq!((comparison.a.get(&0), comparison.b.get(&0)), (Some(&2.0), None));
        assert_eq!((results.ends(1).falls, results.ends(1).trials), (2, 2));
    }
}
