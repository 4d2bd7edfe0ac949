//! E11: over hills of varied friction (Fig. 8d).

use serde::{Deserialize, Serialize};

use super::{by_condition, labels, truth, value};
use crate::config::ConfigError;
use crate::evaluate::findings::{Claim, Figure, Findings, Table};
use crate::evaluate::plot::dots;
use crate::evaluate::results::Results;
use crate::evaluate::statistics::Expected;
use crate::evaluate::trial::End;
use crate::evaluate::{Condition, Experiment, Info, Measured, Quantity};
use crate::scenario::catalog::{Outdoor as Parameters, Scenario, defaults};
use crate::scenario::{Script, metrics};
use crate::trace::Trace;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("success", "no fall in 20 s", "%", 0),
    Quantity::new("velocity_error_m_s", "velocity error", "m/s", 3),
    Quantity::new("power_w", "power", "W", 1),
    Quantity::new("steepest_met", "steepest slope on the way", "%", 0),
];

/// Its numbers in the protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outdoor {
    /// Steepest slopes, rise over run.
    pub steepest: Vec<f64>,
    /// Runs of each policy for each of them.
    pub trials: u32,
}

impl Experiment for Outdoor {
    fn info(&self) -> Info {
        Info {
            id: "E11b",
            number: 13,
            name: "outdoor",
            title: "Hills of varied friction",
            paper: "Fig. 8d",
            method: "At 0.5 m/s for 20 s over smooth hills, other ones in every trial, by their steepest slope; each square \
                     metre of ground has a friction of its own, drawn between 0.4 and 1.0, which holds for each foot on it. \
                     The velocity error is the length of mean velocity minus command in the horizontal plane; numbers but \
                     success are of trials without a fall.",
        }
    }

    fn quantities(&self) -> &'static [Quantity] {
        QUANTITIES
    }

    fn trials(&self) -> u32 {
        self.trials
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: Parameters = defaults("outdoor")?;
        let condition = |steepest: &f64| Condition {
            label: format!("to {:.0} %", 100.0 * steepest),
            scenario: Scenario::Outdoor(Parameters { steepest: *steepest, ..base.clone() }),
        };
        Ok(self.steepest.iter().map(condition).collect())
    }

    fn measure(&self, scenario: &Scenario, script: &Script, trace: &Trace, end: End) -> Measured {
        let upright = end == End::Upright;
        let found = scenario.metrics(script, trace);
        let error = metrics::velocity_error(trace, metrics::SETTLE_S, script.duration_s).filter(|_| upright);
        let of_upright = |name: &str| value(&found, name).filter(|_| upright);
        let values = vec![
            truth(upright),
            error,
            of_upright("power_w"),
            of_upright("steepest_met_percent").map(|percent| 0.01 * percent),
        ];
        Measured { values, series: Vec::new() }
    }

    fn findings(&self, results: &Results) -> Findings {
        let names: Vec<&str> = QUANTITIES.iter().map(|quantity| quantity.name).collect();
        let caption = "Over hills of varied friction, by their steepest slope.";
        let table = Table::of_conditions("outdoor", caption, results, &names);
        let panels = ["success", "velocity_error_m_s", "power_w"].map(|name| by_condition(results, name));
        let figure = Figure::new(
            "outdoor",
            "Over hills of varied friction, by their steepest slope: mean ± standard deviation over seeds, single seeds as \
             hollow marks. Velocity error and power are of trials without a fall.",
            dots::draw("Success, velocity error and power on hills", &panels, &labels(results), &results.names),
        );
        let all: Vec<usize> = (0..results.conditions.len()).collect();
        let claim = Claim::direction(
            "On hills of varied friction, compliant policies fall less often",
            "manages; no baseline shown",
            results.quantity("success"),
            Expected::Higher,
            results.compare_over(&all, "success"),
        );
        Findings { claims: vec![claim], tables: vec![table], figures: vec![figure], ..Findings::default() }
    }
}
