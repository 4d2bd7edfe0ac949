//! E5: how far a constant pull drags the robot off its command (Fig. 5).

use serde::{Deserialize, Serialize};

use super::{directions, polar};
use crate::config::ConfigError;
use crate::evaluate::findings::{Claim, Figure, Findings, Row, Table};
use crate::evaluate::plot;
use crate::evaluate::plot::polar::Scales;
use crate::evaluate::results::Results;
use crate::evaluate::statistics::Expected;
use crate::evaluate::trial::End;
use crate::evaluate::{Condition, Experiment, FELL, Info, Measured, Quantity};
use crate::scenario::catalog::{Leash as Parameters, Scenario, Task, defaults};
use crate::scenario::{Script, metrics};
use crate::trace::Trace;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("offset_m_s", "velocity along the pull", "m/s", 3),
    FELL,
    Quantity::new("power_w", "power", "W", 1),
];

/// Its numbers in the protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Leash {
    /// Directions that divide the circle evenly.
    pub directions: u32,
    /// Runs of each policy in each direction.
    pub trials: u32,
    /// Pulling forces \[N\].
    pub forces_n: Vec<f64>,
    /// Earliest start of the pull; it comes up to 0.65 s later \[s\].
    pub at_s: f64,
    /// Length of the pull \[s\].
    pub for_s: f64,
    /// Length of the average at its end \[s\].
    pub average_s: f64,
}

impl Experiment for Leash {
    fn info(&self) -> Info {
        Info {
            id: "E5",
            number: 5,
            name: "leash",
            title: "On a leash",
            paper: "Fig. 5",
            method: "Walking at 0.5 m/s, the robot is pulled by a constant horizontal force on its trunk in directions \
                     all around; the force keeps its direction in the world. The offset is the mean velocity minus the \
                     command, along the force, over the last seconds of the pull. E0 has the undisturbed error.",
        }
    }

    fn quantities(&self) -> &'static [Quantity] {
        QUANTITIES
    }

    fn trials(&self) -> u32 {
        self.trials
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: Parameters = defaults("leash")?;
        let condition = |force_n: f64, direction_deg: f64| Condition {
            label: format!("{force_n} N, {direction_deg:.1}°"),
            scenario: Scenario::Leash(Parameters {
                force_n,
                direction_deg,
                at_s: self.at_s,
                for_s: self.for_s,
                task: Task { duration_s: self.at_s + self.for_s, ..base.task.clone() },
            }),
        };
        let forces = self.forces_n.iter();
        Ok(forces.flat_map(|force| directions(self.directions).map(|d| condition(*force, d))).collect())
    }

    fn measure(&self, _: &Scenario, script: &Script, trace: &Trace, end: End) -> Measured {
        let mut values = vec![None, end.fell(), None];
        if let (End::Upright, Some(pull)) = (end, script.pull) {
            let (from_s, until_s) = (pull.until_s - self.average_s, pull.until_s);
            values[0] = metrics::offset_along_force(trace, pull.force, from_s, until_s);
            values[2] = metrics::mean(metrics::window(trace, from_s, until_s), |frame| frame.power_w);
        }
        Measured { values, series: Vec::new() }
    }

    fn findings(&self, results: &Results) -> Findings {
        let offset = results.quantity("offset_m_s");
        let count = self.directions as usize;
        let (mut claims, mut rows, mut panels) = (Vec::new(), Vec::new(), Vec::new());
        for (index, force) in self.forces_n.iter().enumerate() {
            let conditions = index * count..(index + 1) * count;
            let all: Vec<usize> = conditions.clone().collect();
            let text = format!(
                "Pulled with {force} N, compliant policies yield more (here: in {}; the numbers are means over directions)",
                results.larger_in(&all, "offset_m_s"),
            );
            let comparison = results.compare_over(&all, "offset_m_s");
            claims.push(Claim::direction(&text, "yields more", offset, Expected::Higher, comparison));
            for quantity in QUANTITIES {
                rows.push(Row {
                    condition: format!("{force} N"),
                    quantity: *quantity,
                    paper: String::new(),
                    comparison: results.compare_over(&all, quantity.name),
                });
            }
            panels.push(polar(format!("{force} N"), results, conditions, "offset_m_s"));
        }
        let names: Vec<&str> = QUANTITIES.iter().map(|quantity| quantity.name).collect();
        let mut every =
            Table::of_conditions("leash-all", "Velocity offset along the pull by direction.", results, &names);
        every.in_page = false;
        let caption = "Velocity offset along a constant pull, mean over all directions.".to_owned();
        let table = Table { name: "leash".into(), caption, rows, in_page: true };
        let svg = plot::polar::draw(
            "Velocity offset along a pull, by direction",
            &panels,
            &results.names,
            "velocity offset along the pull [m/s]",
            Scales::Shared,
        );
        let figure = Figure::new(
            "leash",
            "Velocity offset along a constant pull, by the direction it pulls to, while walking at 0.5 m/s: mean and \
             ± standard deviation over seeds. Inside the darker circle the robot moves against the pull.",
            svg,
        );
        Findings { claims, tables: vec![table, every], figures: vec![figure], ..Findings::default() }
    }
}
