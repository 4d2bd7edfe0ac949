//! E11: over wooden blocks and soft mats (Fig. 8c).

use serde::{Deserialize, Serialize};

use super::{by_condition, crossing, labels, truth, value};
use crate::config::ConfigError;
use crate::evaluate::findings::{Claim, Figure, Findings, Table};
use crate::evaluate::plot::dots;
use crate::evaluate::results::Results;
use crate::evaluate::statistics::Expected;
use crate::evaluate::trial::End;
use crate::evaluate::{Condition, Experiment, Info, Measured, Quantity};
use crate::scenario::catalog::{Rubble as Parameters, Scenario, defaults};
use crate::scenario::{Script, metrics};
use crate::trace::Trace;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("success", "no fall", "%", 0),
    Quantity::new("crossed", "got across", "%", 0),
    Quantity::new("velocity_error_m_s", "velocity error", "m/s", 3),
    Quantity::new("peak_foot_force_n", "peak foot force", "N", 0),
    Quantity::new("power_w", "power", "W", 1),
];

/// Its numbers in the protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rubble {
    /// Largest heights of the blocks \[m\].
    pub heights_m: Vec<f64>,
    /// Runs of each policy for each height.
    pub trials: u32,
}

impl Experiment for Rubble {
    fn info(&self) -> Info {
        Info {
            id: "E11a",
            number: 11,
            name: "rubble",
            title: "Wooden blocks and soft mats",
            paper: "Fig. 8c",
            method: "At 0.5 m/s for 15 s over 4 m of loose wooden blocks and soft mats, other ones in every trial, by the \
                     largest height of the blocks. Height counts from the floor, and only the floor is ground: a leg that \
                     brushes a block has not fallen. The robot is across when its trunk has passed the end, and not the side. The velocity \
                     error is the length of mean velocity minus command in the horizontal plane; it, the peak foot force and the power are those \
                     of the crossing, from the first edge to the last.",
        }
    }

    fn quantities(&self) -> &'static [Quantity] {
        QUANTITIES
    }

    fn trials(&self) -> u32 {
        self.trials
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: Parameters = defaults("rubble")?;
        let condition = |block_height_m: &f64| Condition {
            label: format!("blocks to {:.0} cm", 100.0 * block_height_m),
            scenario: Scenario::Rubble(Parameters { block_height_m: *block_height_m, ..base.clone() }),
        };
        Ok(self.heights_m.iter().map(condition).collect())
    }

    fn measure(&self, scenario: &Scenario, script: &Script, trace: &Trace, end: End) -> Measured {
        let Scenario::Rubble(rubble) = scenario else { return Measured::default() };
        let upright = end == End::Upright;
        let found = scenario.metrics(script, trace);
        let crossed = value(&found, "crossed");
        let crossing = crossing(trace, rubble.distance_m, rubble.far_edge_m()).filter(|_| crossed == Some(1.0));
        let on_rubble = crossing.into_iter().flat_map(|[first_s, last_s]| metrics::window(trace, first_s, last_s));
        let values = vec![
            truth(upright),
            crossed,
            crossing.and_then(|[first_s, last_s]| metrics::velocity_error(trace, first_s, last_s)),
            metrics::largest(on_rubble.clone(), |frame| frame.peak_foot_force_n),
            metrics::mean(on_rubble, |frame| frame.power_w),
        ];
        Measured { values, series: Vec::new() }
    }

    fn findings(&self, results: &Results) -> Findings {
        let names: Vec<&str> = QUANTITIES.iter().map(|quantity| quantity.name).collect();
        let caption = "Over wooden blocks and soft mats, by the largest height of the blocks.";
        let table = Table::of_conditions("rubble", caption, results, &names);
        let panels = ["success", "crossed", "velocity_error_m_s"].map(|name| by_condition(results, name));
        let figure = Figure::new(
            "rubble",
            "Over wooden blocks and soft mats, by the largest height of the blocks: mean ± standard deviation over seeds, \
             single seeds as hollow marks. The velocity error is of trials that got across.",
            dots::draw("Success and velocity error among blocks and mats", &panels, &labels(results), &results.names),
        );
        let all: Vec<usize> = (0..results.conditions.len()).collect();
        let claim = |text: &str, name: &str| {
            let comparison = results.compare_over(&all, name);
            Claim::direction(text, "superior", results.quantity(name), Expected::Higher, comparison)
        };
        let claims = vec![
            claim("Among wooden blocks and soft mats, compliant policies fall less often", "success"),
            claim("… and get across more often", "crossed"),
        ];
        Findings { claims, tables: vec![table], figures: vec![figure], ..Findings::default() }
    }
}
