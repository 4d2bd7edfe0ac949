//! E4: how long a push from any side lasts, standing and walking (Fig. 4).

use serde::{Deserialize, Serialize};

use super::decay::{CARRIED_S, lasting};
use super::{directions, gait, polar, truth, undecayed};
use crate::config::ConfigError;
use crate::evaluate::findings::{Claim, Figure, Findings, Row, Table};
use crate::evaluate::plot;
use crate::evaluate::plot::polar::Scales;
use crate::evaluate::results::Results;
use crate::evaluate::statistics::Expected;
use crate::evaluate::trial::End;
use crate::evaluate::{BRIEFLY_AVERAGED, Condition, Experiment, FELL, Info, Measured, Quantity, UNDECAYED};
use crate::scenario::catalog::{PushAway, Scenario, Task, defaults};
use crate::scenario::metrics::{BRIEF_S, STRIDE_S};
use crate::scenario::{Script, metrics};
use crate::task::Command;
use crate::trace::Trace;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("decay_10_s", "decay to 10 %", "s", 2),
    Quantity::new("decay_20_s", "decay to 20 %", "s", 2),
    Quantity::new("carried_m", "carried by the push within 2 s", "m", 3),
    UNDECAYED,
    FELL,
    BRIEFLY_AVERAGED,
];

/// Its numbers in the protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Directions {
    /// Directions that divide the circle evenly.
    pub directions: u32,
    /// Runs of each policy in each direction.
    pub trials: u32,
    /// Forward commands \[m/s\]; 0 is standing.
    pub commands_m_s: Vec<f64>,
}

impl Directions {
    /// Conditions of a command, and its name.
    fn command(&self, index: usize) -> (std::ops::Range<usize>, String) {
        let count = self.directions as usize;
        let command = self.commands_m_s[index];
        let name =
            if command == 0.0 { gait(command).to_owned() } else { format!("{} at {command} m/s", gait(command)) };
        (index * count..(index + 1) * count, name)
    }
}

impl Experiment for Directions {
    fn info(&self) -> Info {
        Info {
            id: "E4",
            number: 4,
            name: "directions",
            title: "Decay of pushes from all sides",
            paper: "Fig. 4",
            method: "A push of 0.5 m/s in directions all around, standing and walking at 0.5 m/s. Decay time as in E2.",
        }
    }

    fn quantities(&self) -> &'static [Quantity] {
        QUANTITIES
    }

    fn trials(&self) -> u32 {
        self.trials
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: PushAway = defaults("push")?;
        let condition = |command: f64, direction_deg: f64| Condition {
            label: format!("{}, {direction_deg:.1}°", gait(command)),
            scenario: Scenario::Push(PushAway {
                direction_deg,
                task: Task { forward_m_s: command, ..base.task.clone() },
                ..base
            }),
        };
        let commands = self.commands_m_s.iter();
        Ok(commands.flat_map(|command| directions(self.directions).map(|d| condition(*command, d))).collect())
    }

    fn measure(&self, _: &Scenario, script: &Script, trace: &Trace, end: End) -> Measured {
        let push = script.pushes.first().filter(|_| end == End::Upright);
        let decay = |threshold| metrics::decay(trace, push?.time_s, push?.push.linear, threshold, STRIDE_S);
        let [to_10, to_20] = [0.1, 0.2].map(decay);
        let carried = push.and_then(|push| metrics::carried(trace, push.time_s, push.push.linear, CARRIED_S));
        let values = vec![
            to_10.map(|decay| decay.time_s),
            to_20.map(|decay| decay.time_s),
            carried,
            to_10.and_then(|decay| truth(!decay.is_over)),
            end.fell(),
            push.filter(|_| script.command == Command::default())
                .and_then(|push| metrics::decay(trace, push.time_s, push.push.linear, 0.1, BRIEF_S))
                .map(|decay| decay.time_s),
        ];
        Measured { values, series: Vec::new() }
    }

    fn findings(&self, results: &Results) -> Findings {
        let (mut claims, mut rows, mut notes) = (Vec::new(), Vec::new(), Vec::new());
        let mut panels = [Vec::new(), Vec::new()];
        for index in 0..self.commands_m_s.len() {
            let (conditions, name) = self.command(index);
            let all: Vec<usize> = conditions.clone().collect();
            let is_standing = self.commands_m_s[index] == 0.0;
            let briefly = (BRIEFLY_AVERAGED.name, "take longer to stabilise (to 10 %, averaged over 0.1 s)");
            let lasting = is_standing.then_some(briefly).into_iter().chain(lasting(self.commands_m_s[index]));
            for (quantity, words) in lasting {
                let text = format!(
                    "Pushed from any side while {name}, compliant policies {words}; the numbers are means over directions, \
                     and it is so in {}",
                    results.larger_in(&all, quantity)
                );
                let comparison = results.compare_over(&all, quantity);
                let quantity = results.quantity(quantity);
                claims.push(Claim::direction(&text, "longer", quantity, Expected::Higher, comparison));
            }
            notes.extend(undecayed(results, &all).map(|note| format!("{name}: {note}")));
            for quantity in QUANTITIES.iter().filter(|quantity| is_standing || **quantity != BRIEFLY_AVERAGED) {
                rows.push(Row {
                    condition: name.clone(),
                    quantity: *quantity,
                    paper: String::new(),
                    comparison: results.compare_over(&all, quantity.name),
                });
            }
            for (panels, quantity) in panels.iter_mut().zip(["decay_20_s", "carried_m"]) {
                panels.push(polar(name.clone(), results, conditions.clone(), quantity));
            }
        }
        let names: Vec<&str> = QUANTITIES.iter().map(|quantity| quantity.name).collect();
        let mut every = Table::of_conditions("directions-all", "Decay time of a push by direction.", results, &names);
        every.in_page = false;
        let caption = "Decay time of a push of 0.5 m/s, mean over all directions.".to_owned();
        let table = Table { name: "directions".into(), caption, rows, in_page: true };
        let figure = |name: &str, title: &str, axis: &str, caption: &str, panels: &[_]| {
            let caption = format!(
                "{caption} a push of 0.5 m/s, by the direction it pushes to: mean and ± standard deviation over seeds. Trials \
                 with a fall have none. The two plots differ in scale."
            );
            Figure::new(name, caption, plot::polar::draw(title, panels, &results.names, axis, Scales::Own))
        };
        let [decays, distances] = panels;
        let figures = vec![
            figure(
                "directions",
                "Decay time of a push by direction",
                "decay time to 20 % [s]",
                "Decay time (to 20 %) of",
                &decays,
            ),
            figure(
                "directions-carried",
                "How far a push carries by direction",
                "carried within 2 s [m]",
                "How far the robot is carried by",
                &distances,
            ),
        ];
        Findings { claims, tables: vec![table, every], figures, notes, ..Findings::default() }
    }
}
