//! E9: a weight over a pulley pulls the robot (Fig. 8a).

use serde::{Deserialize, Serialize};

use super::{by_condition, gait, labels, value};
use crate::config::ConfigError;
use crate::evaluate::findings::{Claim, Figure, Findings, Table};
use crate::evaluate::plot::dots;
use crate::evaluate::results::Results;
use crate::evaluate::statistics::Expected;
use crate::evaluate::trial::End;
use crate::evaluate::{Condition, Experiment, FELL, Info, Measured, Quantity};
use crate::scenario::Script;
use crate::scenario::catalog::{Pulley as Parameters, Scenario, Task, defaults};
use crate::trace::Trace;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("displacement_m", "moved along the pull", "m", 2),
    Quantity::new("offset_m_s", "velocity along the pull", "m/s", 3),
    Quantity::new("mean_rope_force_n", "mean rope force", "N", 1),
    Quantity::new("peak_rope_force_n", "peak rope force", "N", 1),
    Quantity::new("power_pulled_w", "power while pulled", "W", 1),
    FELL,
];

/// Its numbers in the protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pulley {
    /// Forward commands \[m/s\]; 0 is standing.
    pub commands_m_s: Vec<f64>,
    /// Where the pull goes, from the heading: 0 ahead, 90 left, 180 back, 270 right \[deg\].
    pub directions_deg: Vec<f64>,
    /// Runs of each policy in each direction at each command.
    pub trials: u32,
}

impl Experiment for Pulley {
    fn info(&self) -> Info {
        Info {
            id: "E9",
            number: 9,
            name: "pulley",
            title: "A weight over a pulley",
            paper: "Fig. 8a",
            method: "A weight of 1 kg hangs on a rope that leads over pulleys to the trunk; it is let go with the rope just \
                     taut, pulls for 4 s, and is taken off. The displacement is that along the pull at its end beyond \
                     what the command asks for, the offset the mean velocity along it minus the command from 1 s after \
                     the start to the end. The rope's force is the weight's m (g + a), from 1 s after the start. A fall \
                     leaves all but the falls undefined.",
        }
    }

    fn quantities(&self) -> &'static [Quantity] {
        QUANTITIES
    }

    fn trials(&self) -> u32 {
        self.trials
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: Parameters = defaults("pulley")?;
        let condition = |command: f64, direction_deg: f64| Condition {
            label: format!("{}, {direction_deg:.0}°", gait(command)),
            scenario: Scenario::Pulley(Parameters {
                direction_deg,
                task: Task { forward_m_s: command, ..base.task.clone() },
                ..base.clone()
            }),
        };
        let commands = self.commands_m_s.iter();
        Ok(commands.flat_map(|command| self.directions_deg.iter().map(|d| condition(*command, *d))).collect())
    }

    fn measure(&self, scenario: &Scenario, script: &Script, trace: &Trace, end: End) -> Measured {
        let found = scenario.metrics(script, trace);
        let of_upright = |quantity: &Quantity| value(&found, quantity.name).filter(|_| end == End::Upright);
        let mut values: Vec<Option<f64>> = QUANTITIES.iter().map(of_upright).collect();
        values[QUANTITIES.len() - 1] = end.fell();
        Measured { values, series: Vec::new() }
    }

    fn findings(&self, results: &Results) -> Findings {
        let names: Vec<&str> = QUANTITIES.iter().map(|quantity| quantity.name).collect();
        let caption =
            "Pulled by 1 kg over a pulley, by command and direction (0° ahead, 90° left, 180° back, 270° right).";
        let table = Table::of_conditions("pulley", caption, results, &names);
        let panels = ["displacement_m", "offset_m_s", "fell"].map(|name| by_condition(results, name));
        let figure = Figure::new(
            "pulley",
            "Pulled by a weight of 1 kg over a pulley for 4 s: displacement along the pull, velocity along it, falls, by \
             direction of the pull (0° ahead, 90° left, 180° back, 270° right). Mean ± standard deviation over seeds, single \
             seeds as hollow marks; trials with a fall count as falls only.",
            dots::draw("Displacement, velocity and falls under a pull", &panels, &labels(results), &results.names),
        );
        let mut claims = Vec::new();
        let count = self.directions_deg.len();
        for (index, command) in self.commands_m_s.iter().enumerate() {
            let of_command: Vec<usize> = (index * count..(index + 1) * count).collect();
            claims.push(Claim::direction(
                &format!(
                    "Pulled by a weight while {}, compliant policies go with it (mean over directions)",
                    gait(*command)
                ),
                "goes with it",
                results.quantity("displacement_m"),
                Expected::Higher,
                results.compare_over(&of_command, "displacement_m"),
            ));
        }
        let all: Vec<usize> = (0..results.conditions.len()).collect();
        claims.push(Claim::direction(
            "Pulled by a weight, compliant policies topple less often",
            "less prone",
            FELL,
            Expected::Lower,
            results.compare_over(&all, "fell"),
        ));
        Findings { claims, tables: vec![table], figures: vec![figure], ..Findings::default() }
    }
}
