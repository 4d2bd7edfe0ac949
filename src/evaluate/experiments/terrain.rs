//! E8: walking over Perlin terrain of several heights and frequencies (Fig. 7b).

use serde::{Deserialize, Serialize};

use super::{by_condition, labels, truth, value};
use crate::config::ConfigError;
use crate::evaluate::findings::{Claim, Figure, Findings, Table};
use crate::evaluate::plot::dots;
use crate::evaluate::results::Results;
use crate::evaluate::statistics::Expected;
use crate::evaluate::trial::End;
use crate::evaluate::{Condition, Experiment, Info, Measured, Quantity};
use crate::scenario::catalog::{Scenario, Terrain as Parameters, TerrainKind, defaults};
use crate::scenario::{Script, metrics};
use crate::trace::Trace;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("success", "no fall in 10 s", "%", 0),
    Quantity::new("velocity_error_m_s", "velocity error", "m/s", 3),
    Quantity::new("peak_foot_force_n", "peak foot force", "N", 0),
    Quantity::new("power_w", "power", "W", 1),
];

/// Its numbers in the protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Terrain {
    /// Heights, peak to peak \[m\].
    pub heights_m: Vec<f64>,
    /// Lattice cells per metre \[1/m\].
    pub frequencies_per_m: Vec<f64>,
    /// Runs of each policy on each terrain.
    pub trials: u32,
}

impl Experiment for Terrain {
    fn info(&self) -> Info {
        Info {
            id: "E8",
            number: 8,
            name: "terrain",
            title: "Uneven terrain",
            paper: "Fig. 7b",
            method: "At 0.5 m/s for 10 s over terrain of Perlin noise, another one in every trial, by its height from \
                     peak to peak and its frequency (cells per metre). A success is a trial without a fall. The velocity \
                     error is the length of mean velocity minus command in the horizontal plane.",
        }
    }

    fn quantities(&self) -> &'static [Quantity] {
        QUANTITIES
    }

    fn trials(&self) -> u32 {
        self.trials
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: Parameters = defaults("terrain")?;
        let condition = |height_m: f64, frequency_per_m: f64| Condition {
            label: format!("{:.0} cm, {frequency_per_m} /m", 100.0 * height_m),
            scenario: Scenario::Terrain(Parameters {
                kind: TerrainKind::Perlin,
                height_m,
                frequency_per_m,
                ..base.clone()
            }),
        };
        let frequencies = &self.frequencies_per_m;
        let heights = self.heights_m.iter();
        Ok(heights.flat_map(|height| frequencies.iter().map(|frequency| condition(*height, *frequency))).collect())
    }

    fn measure(&self, scenario: &Scenario, script: &Script, trace: &Trace, end: End) -> Measured {
        let upright = end == End::Upright;
        let found = scenario.metrics(script, trace);
        let error = metrics::velocity_error(trace, metrics::SETTLE_S, script.duration_s).filter(|_| upright);
        let of_upright = |name: &str| value(&found, name).filter(|_| upright);
        let values = vec![truth(upright), error, of_upright("peak_foot_force_n"), of_upright("power_w")];
        Measured { values, series: Vec::new() }
    }

    fn findings(&self, results: &Results) -> Findings {
        let names: Vec<&str> = QUANTITIES.iter().map(|quantity| quantity.name).collect();
        let caption = "Walking over Perlin terrain, by height (peak to peak) and frequency.";
        let table = Table::of_conditions("terrain", caption, results, &names);
        let conditions = results.conditions.len();
        let panels = ["success", "velocity_error_m_s", "peak_foot_force_n"].map(|name| by_condition(results, name));
        let figure = Figure::new(
            "terrain",
            "Walking over Perlin terrain by height and frequency: mean ± standard deviation over seeds, single seeds as \
             hollow marks. Numbers but success are of trials without a fall.",
            dots::draw(
                "Success, velocity error and peak foot force by terrain",
                &panels,
                &labels(results),
                &results.names,
            ),
        );
        let all: Vec<usize> = (0..conditions).collect();
        let first = results.conditions.first().map_or("", |condition| &condition.label);
        let claim = |text: &str, paper: &str, name: &str, expected, over: &[usize]| {
            Claim::direction(text, paper, results.quantity(name), expected, results.compare_over(over, name))
        };
        let claims = vec![
            claim(
                &format!("On terrain of {first}, compliant policies fall less often"),
                "less often",
                "success",
                Expected::Higher,
                &[0],
            ),
            claim(
                "Over all terrains, compliant policies fall less often",
                "less often",
                "success",
                Expected::Higher,
                &all,
            ),
            claim("The largest force on a foot is lower", "lower", "peak_foot_force_n", Expected::Lower, &all),
        ];
        Findings { claims, tables: vec![table], figures: vec![figure], ..Findings::default() }
    }
}
