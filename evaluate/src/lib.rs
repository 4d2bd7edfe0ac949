/*! Every figure and table of the paper's section IV, for any sets of policies.

An [`Experiment`] says which conditions there are, plays nothing itself, and turns a trace into numbers; [`runner`] plays
its trials in parallel, each with a seed that does not depend on the policy, and [`store`] keeps what came out, so that
a finished experiment is not run again. From the kept numbers alone comes [`section_content`] (claims with intervals, tables,
figures) and from that the [`report`]. `docs/experiments.md` has the definitions in words.

Tables and figures show every set of policies; claims and differences are about the first set and the second.
*/

pub mod experiments;
pub mod measurement_store;
pub mod plot;
pub mod policy_sets;
pub mod protocol;
pub mod report;
pub mod results;
pub mod runner;
pub mod section_builder;
pub mod section_content;
pub mod sensing;
pub mod square_grid;
pub mod statistics;
pub mod trial;

use serde::Serialize;

use results::Results;
use section_builder::SectionBuilder;
use section_content::SectionContent;
use supple::config::ConfigError;
use supple::scenario::Script;
use supple::scenario::catalog::{ParameterError, Scenario};
use trial::Trial;

/// The name, title and measured quantities of an experiment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Info {
    /// `E0` to `E14c`.
    pub id: &'static str,
    /// Tells its trials' seeds apart from other experiments'.
    pub number: u32,
    /// On the command line.
    pub name: &'static str,
    /// The title in the report.
    pub title: &'static str,
    /// Where the paper shows it.
    pub paper: &'static str,
    /// How it is measured, in words.
    pub method: &'static str,
    /// The numbers that each trial yields.
    pub quantities: &'static [Quantity],
}

/// A number that every trial of an experiment yields, if it is defined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Quantity {
    /// Snake case, with the unit where it has one.
    pub name: &'static str,
    /// The label that people read.
    pub label: &'static str,
    /// The unit; `%` for fractions, which are kept as 0 to 1.
    pub unit: &'static str,
    /// Digits after the point.
    pub digits: usize,
}

impl Quantity {
    /// A quantity.
    pub const fn new(name: &'static str, label: &'static str, unit: &'static str, digits: usize) -> Self {
        Quantity { name, label, unit, digits }
    }

    /// Returns the factor from kept to printed values.
    pub fn scale(&self) -> f64 {
        if self.unit == "%" { 100.0 } else { 1.0 }
    }

    /// Label with unit, for axes.
    pub fn axis(&self) -> String {
        if self.unit.is_empty() { self.label.to_owned() } else { format!("{} [{}]", self.label, self.unit) }
    }
}

/// Fraction of trials in which the robot fell.
pub const FELL: Quantity = Quantity::new("fell", "falls", "%", 0);

/// One setting of what an experiment varies.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Condition {
    /// The label in tables.
    pub label: String,
    /// The scenario; the trial's seed varies it.
    pub scenario: Scenario,
}

/// The numbers that an experiment takes from a trace.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TrialValues {
    /// One for each of the experiment's quantities.
    pub values: Vec<Option<f64>>,
    /// The series that the experiment's figures draw.
    pub series: Vec<Vec<f32>>,
}

impl From<Vec<Option<f64>>> for TrialValues {
    fn from(values: Vec<Option<f64>>) -> Self {
        TrialValues { values, series: Vec::new() }
    }
}

erased_serde::serialize_trait_object!(Experiment);

/// A table or figure of the paper: its section of the protocol, what is played, measured and shown. It serializes as its
/// parameters.
pub trait Experiment: erased_serde::Serialize + Sync {
    /// Returns the experiment's name, title and quantities.
    fn info(&self) -> Info;

    /// Returns the number of trials of each condition with each policy.
    fn trials(&self) -> u32;

    /// Returns the conditions, one for each variation.
    ///
    /// # Errors
    /// None with the scenario files inside the program.
    fn conditions(&self) -> Result<Vec<Condition>, ConfigError>;

    /// Checks those of its numbers that no scenario checks when its script is made.
    ///
    /// # Errors
    /// [`ParameterError`] with the key.
    fn check(&self) -> Result<(), ParameterError> {
        Ok(())
    }

    /// When there is nothing more to measure \[s\].
    fn until_s(&self, script: &Script) -> f64 {
        script.duration_s
    }

    /// Reads a trial.
    fn measure(&self, trial: &Trial) -> TrialValues;

    /// Shows claims, tables and figures.
    fn report(&self, section: &mut SectionBuilder);

    /// Returns the claims, tables and figures of the experiment's results.
    fn content(&self, results: &Results) -> SectionContent {
        let mut section = SectionBuilder::new(self.info().name, results);
        self.report(&mut section);
        section.content
    }
}
