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
        self.over(set, &[condition], quantity)
    }

    /// For each seed, the mean over conditions of the mean over trials. A seed without a number in one of the conditions
    /// is averaged over the others.
    pub fn over(&self, set: usize, conditions: &[usize], quantity: &str) -> PerSeed {
        let index = self.index(quantity);
        let of_condition = |policy: &PolicyResult, condition: &usize| {
            mean(policy[*condition].iter().filter_map(|sample| sample.values[index]))
        };
        let of_policy = |policy: &PolicyResult| mean(conditions.iter().filter_map(|c| of_condition(policy, c)));
        self.sets[set].iter().filter_map(|(seed, policy)| Some((*seed, of_policy(policy)?))).collect()
    }

    /// Both sets in one condition.
    pub fn compare(&self, condition: usize, quantity: &str) -> Comparison {
        self.compare_over(&[condition], quantity)
    }

    /// Both sets over several conditions.
    pub fn compare_over(&self, conditions: &[usize], quantity: &str) -> Comparison {
        Comparison::new(self.over(0, conditions, quantity), self.over(1, conditions, quantity))
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
