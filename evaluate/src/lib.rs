/*! Every figure and table of the paper's section IV, for any sets of policies.

An [`Experiment`] defines conditions, takes numbers from the trace of a trial, and reports them. [`runner`] plays the trials in
parallel, each with a seed that does not depend on the policy, and [`measurement_store`] keeps their numbers, so that a finished
experiment is not run again. `section_content` (claims with intervals, tables, figures) comes from the kept numbers alone,
and the [`report`] from it. `docs/experiments.md` defines every number in words.

Tables and figures show every set of policies; claims and differences compare the first set with the second.
*/

pub mod exam;
mod experiments;
pub mod learning_curves;
pub mod measurement_store;
mod plot;
pub mod policy_sets;
pub mod protocol;
pub mod report;
mod results;
pub mod runner;
mod section_builder;
mod section_content;
mod sensing;
mod square_grid;
mod statistics;
pub mod study;
pub mod trial;

use serde::Serialize;

use results::Results;
use section_builder::SectionBuilder;
use section_content::SectionContent;
use supple::config::ConfigError;
use supple::scenario::Script;
use supple::scenario::catalog::{ParameterError, Scenario};
use trial::Trial;

/// The name, title, measured quantities and number of trials of an experiment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ExperimentInfo {
    /// The number in the report: `E0` to `E17`.
    pub id: &'static str,
    /// A number that no other experiment has; it makes the seeds of the trials differ from those of other experiments.
    pub number: u32,
    /// The name on the command line, in file names and in `summary.json`.
    pub name: &'static str,
    /// The title in the report.
    pub title: &'static str,
    /// The paper's figure, table or section that shows it; empty if none does.
    pub paper: &'static str,
    /// A description of how it is measured.
    pub method: &'static str,
    /// The numbers that each trial yields.
    pub quantities: &'static [Quantity],
    /// The number of trials of each condition with each policy.
    pub trials: u32,
}

impl ExperimentInfo {
    /// Creates the description of an experiment that the paper does not have, without its method.
    pub const fn new(
        id: &'static str,
        number: u32,
        name: &'static str,
        title: &'static str,
        quantities: &'static [Quantity],
        trials: u32,
    ) -> Self {
        ExperimentInfo { id, number, name, title, paper: "", method: "", quantities, trials }
    }
}

/// A quantity that an experiment measures in each trial; a trial may leave it undefined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Quantity {
    /// The name in snake case, which ends with the unit if there is one.
    pub name: &'static str,
    /// The label that people read.
    pub label: &'static str,
    /// The printed unit; `%` for fractions, whose kept values are 0 to 1.
    pub unit: &'static str,
    /// The number of printed digits after the decimal point.
    pub digits: usize,
}

impl Quantity {
    /// Creates a quantity.
    pub const fn new(name: &'static str, label: &'static str, unit: &'static str, digits: usize) -> Self {
        Quantity { name, label, unit, digits }
    }

    /// Returns the factor from kept to printed values: 100 for `%`, else 1.
    pub fn scale(&self) -> f64 {
        if self.unit == "%" { 100.0 } else { 1.0 }
    }

    /// Returns the label with the unit, for axes and table rows.
    pub fn axis(&self) -> String {
        if self.unit.is_empty() { self.label.to_owned() } else { format!("{} [{}]", self.label, self.unit) }
    }
}

/// The fraction of trials in which the robot fell.
pub const FELL: Quantity = Quantity::new("fell", "falls", "%", 0);

/// One setting of the parameters that an experiment varies.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Condition {
    /// The label in tables and figures.
    pub label: String,
    /// The scenario; the trial's seed varies it.
    pub scenario: Scenario,
}

/// The numbers that an experiment takes from the trace of one trial.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TrialValues {
    /// The value of each of the experiment's quantities, in their order; none if the trial leaves it undefined.
    pub values: Vec<Option<f64>>,
    /// The time series that the experiment's figures draw; each experiment defines its own.
    pub series: Vec<Vec<f32>>,
}

impl From<Vec<Option<f64>>> for TrialValues {
    fn from(values: Vec<Option<f64>>) -> Self {
        TrialValues { values, series: Vec::new() }
    }
}

erased_serde::serialize_trait_object!(Experiment);

/// An experiment of the paper with its parameters, which are a section of the protocol and its serialized form.
pub trait Experiment: erased_serde::Serialize + Sync {
    /// Returns the experiment's name, title, quantities and number of trials.
    fn info(&self) -> ExperimentInfo;

    /// Returns the conditions, one for each variation.
    ///
    /// # Errors
    /// A scenario file inside the program is invalid, which a test rules out.
    fn conditions(&self) -> Result<Vec<Condition>, ConfigError>;

    /// Checks the parameters that no scenario checks when it makes its script.
    ///
    /// # Errors
    /// A parameter is outside its range; the error names its key.
    fn check(&self) -> Result<(), ParameterError> {
        Ok(())
    }

    /// Returns true if the frames of a trial are to hold the felt forces.
    fn observes_forces(&self) -> bool {
        false
    }

    /// Returns the time at which a trial may end, because nothing later is measured \[s\].
    fn until_s(&self, script: &Script) -> f64 {
        script.duration_s
    }

    /// Takes the experiment's numbers from a trial; by default, those of [`Trial::upright_metrics`].
    fn measure(&self, trial: &Trial) -> TrialValues {
        trial.upright_metrics(self.info().quantities)
    }

    /// Adds claims, tables and figures to the experiment's section of the report.
    fn report(&self, section: &mut SectionBuilder);

    /// Returns the claims, tables and figures of results of this experiment.
    fn content(&self, results: &Results) -> SectionContent {
        let mut section = SectionBuilder::new(self.info().name, results);
        self.report(&mut section);
        section.content
    }
}
