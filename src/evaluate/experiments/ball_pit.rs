//! E7: crossing a field of loose balls (Fig. 7a).

use serde::{Deserialize, Serialize};

use super::{by_condition, crossing, labels, truth, value};
use crate::config::ConfigError;
use crate::evaluate::findings::{Claim, Figure, Findings, Table};
use crate::evaluate::plot::dots;
use crate::evaluate::results::Results;
use crate::evaluate::statistics::Expected;
use crate::evaluate::trial::End;
use crate::evaluate::{Condition, Experiment, FELL, Info, Measured, Quantity};
use crate::scenario::catalog::{BallPit as Parameters, Scenario, defaults};
use crate::scenario::{Script, metrics};
use crate::trace::Trace;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("crossed", "got across", "%", 0),
    FELL,
    Quantity::new("stuck", "stuck", "%", 0),
    Quantity::new("crossing_time_s", "time to get across", "s", 1),
    Quantity::new("distance_m", "distance ahead", "m", 2),
    Quantity::new("peak_foot_force_n", "peak foot force", "N", 0),
    Quantity::new("power_w", "power among the balls", "W", 1),
];

/// Its numbers in the protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BallPit {
    /// Runs of each policy.
    pub trials: u32,
}

impl Experiment for BallPit {
    fn info(&self) -> Info {
        Info {
            id: "E7",
            number: 7,
            name: "ball-pit",
            title: "Ball pit",
            paper: "Fig. 7a",
            method: "At 0.4 m/s across 20 by 20 rigid balls of 0.5 kg and 5 cm radius, 3 cm apart. The robot is across \
                     when its trunk passes the last row, and stuck if it neither gets there nor falls in the time it \
                     has. Time, peak foot force and power are from the first row to past the last; a trial that does not get \
                     across has none, nor has one that leaves the balls at their side. \
                     Each trial starts at another distance, so that the gait meets the balls at another phase.",
        }
    }

    fn quantities(&self) -> &'static [Quantity] {
        QUANTITIES
    }

    fn trials(&self) -> u32 {
        self.trials
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let pit: Parameters = defaults("ball-pit")?;
        Ok(vec![Condition { label: String::new(), scenario: Scenario::BallPit(pit) }])
    }

    fn measure(&self, scenario: &Scenario, script: &Script, trace: &Trace, end: End) -> Measured {
        let Scenario::BallPit(pit) = scenario else { return Measured::default() };
        let found = scenario.metrics(script, trace);
        let crossed = value(&found, "crossed") == Some(1.0);
        let crossing = crossing(trace, pit.distance_m, pit.far_edge_m()).filter(|_| crossed);
        let among_balls = crossing.into_iter().flat_map(|[first_s, last_s]| metrics::window(trace, first_s, last_s));
        let of_upright = |name: &str| value(&found, name).filter(|_| end == End::Upright);
        let values = vec![
            truth(crossed),
            end.fell(),
            truth(!crossed && end == End::Upright),
            crossing.map(|[first_s, last_s]| last_s - first_s),
            of_upright("distance_m"),
            metrics::largest(among_balls.clone(), |frame| frame.peak_foot_force_n),
            metrics::mean(among_balls, |frame| frame.power_w),
        ];
        Measured { values, series: Vec::new() }
    }

    fn findings(&self, results: &Results) -> Findings {
        let names: Vec<&str> = QUANTITIES.iter().map(|quantity| quantity.name).collect();
        let table = Table::of_conditions("ball-pit", "Crossing 400 loose balls.", results, &names);
        let panels = ["crossed", "fell", "stuck", "peak_foot_force_n"].map(|name| by_condition(results, name));
        let figure = Figure::new(
            "ball-pit",
            "Crossing a pit of 400 balls: mean ± standard deviation over seeds, single seeds as hollow marks.",
            dots::draw("Crossing a ball pit", &panels, &labels(results), &results.names),
        );
        let claim = |text: &str, paper: &str, name: &str, expected| {
            Claim::direction(text, paper, results.quantity(name), expected, results.compare(0, name))
        };
        let claims = vec![
            claim("Compliant policies get across the ball pit", "more often", "crossed", Expected::Higher),
            claim("The largest force on a foot is lower", "lower", "peak_foot_force_n", Expected::Lower),
        ];
        Findings { claims, tables: vec![table], figures: vec![figure], ..Findings::default() }
    }
}
