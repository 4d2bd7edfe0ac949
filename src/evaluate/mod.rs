/*! Every figure and table of the paper's section IV, for any two sets of policies.

An [`Experiment`] says which conditions there are, plays nothing itself, and turns a trace into numbers; [`runner`] plays
its trials in parallel, each with a seed that does not depend on the policy, and [`store`] keeps what came out, so that
a finished experiment is not run again. From the kept numbers alone come [`findings`] (claims with intervals, tables,
figures) and from those the [`report`]. `docs/experiments.md` has the definitions in words.
*/

pub mod contestants;
pub mod experiments;
pub mod findings;
pub mod grid;
pub mod plot;
pub mod protocol;
pub mod report;
pub mod results;
pub mod runner;
pub mod sensing;
pub mod statistics;
pub mod store;
pub mod trial;

use serde::Serialize;

use crate::config::ConfigError;
use crate::scenario::Script;
use crate::scenario::catalog::Scenario;
use crate::trace::Trace;
use findings::Findings;
use results::Results;
use trial::End;

/// What an experiment is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Info {
    /// `E0` to `E11b`.
    pub id: &'static str,
    /// Tells its trials' seeds apart from other experiments'.
    pub number: u32,
    /// On the command line.
    pub name: &'static str,
    /// In the report.
    pub title: &'static str,
    /// Where the paper shows it.
    pub paper: &'static str,
    /// How it is measured, in words.
    pub method: &'static str,
}

/// A number that every trial of an experiment yields, if it is defined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Quantity {
    /// Snake case, with the unit where it has one.
    pub name: &'static str,
    /// For people.
    pub label: &'static str,
    /// Its unit; `%` for shares, which are kept as 0 to 1.
    pub unit: &'static str,
    /// Digits after the point.
    pub digits: usize,
}

impl Quantity {
    /// A quantity.
    pub const fn new(name: &'static str, label: &'static str, unit: &'static str, digits: usize) -> Self {
        Quantity { name, label, unit, digits }
    }

    /// From what is kept to what is printed in the unit.
    pub fn scale(&self) -> f64 {
        if self.unit == "%" { 100.0 } else { 1.0 }
    }

    /// Label with unit, for axes.
    pub fn axis(&self) -> String {
        if self.unit.is_empty() { self.label.to_owned() } else { format!("{} [{}]", self.label, self.unit) }
    }
}

/// Share of trials in which the robot fell.
pub const FELL: Quantity = Quantity::new("fell", "falls", "%", 0);

/// Share of trials without a fall in which the push had not decayed to 10 % at the end: their decay time is that end.
pub const UNDECAYED: Quantity = Quantity::new("undecayed", "not decayed at the end", "%", 0);

/// Decay time of a push at a robot that stands, with a shorter average than elsewhere.
pub const BRIEFLY_AVERAGED: Quantity =
    Quantity::new("decay_10_averaged_0_1_s", "decay to 10 %, averaged over 0.1 s", "s", 2);

/// One setting of what an experiment varies.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Condition {
    /// For tables.
    pub label: String,
    /// What is played; the trial's seed varies it.
    pub scenario: Scenario,
}

/// What an experiment takes from a trace.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Measured {
    /// One for each of the experiment's quantities.
    pub values: Vec<Option<f64>>,
    /// What its figures draw.
    pub series: Vec<Vec<f32>>,
}

/// The numbers of an experiment in the protocol, as JSON.
pub trait Parameters {
    /// By key.
    fn parameters(&self) -> serde_json::Value;
}

impl<T: Serialize> Parameters for T {
    fn parameters(&self) -> serde_json::Value {
        // Plain structs of numbers and lists.
        serde_json::to_value(self).unwrap_or_default()
    }
}

/// A table or figure of the paper: what is played, what is measured, what is shown.
pub trait Experiment: Parameters + Sync {
    /// What it is.
    fn info(&self) -> Info;

    /// The numbers each trial yields.
    fn quantities(&self) -> &'static [Quantity];

    /// Trials of each condition with each policy.
    fn trials(&self) -> u32;

    /// What is varied.
    ///
    /// # Errors
    /// None with the scenario files inside the program.
    fn conditions(&self) -> Result<Vec<Condition>, ConfigError>;

    /// Reads a trace of a trial's scenario.
    fn measure(&self, scenario: &Scenario, script: &Script, trace: &Trace, end: End) -> Measured;

    /// Claims, tables and figures.
    fn findings(&self, results: &Results) -> Findings;
}
