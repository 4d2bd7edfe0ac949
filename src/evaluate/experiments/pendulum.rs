//! E10: a ball on a string swings into the robot (Fig. 8b).

use serde::{Deserialize, Serialize};

use super::decay::{CARRIED_S, lasting};
use super::{by_condition, gait, labels, truth, undecayed, value, velocity};
use crate::config::ConfigError;
use crate::evaluate::findings::{Claim, Figure, Findings, Table};
use crate::evaluate::plot::{curves, dots};
use crate::evaluate::results::Results;
use crate::evaluate::statistics::Expected;
use crate::evaluate::trial::End;
use crate::evaluate::{Condition, Experiment, FELL, Info, Measured, Quantity, UNDECAYED};
use crate::scenario::catalog::{Pendulum as Parameters, Scenario, Task, defaults};
use crate::scenario::{Script, metrics};
use crate::trace::Trace;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("decay_10_s", "decay to 10 %", "s", 2),
    Quantity::new("decay_20_s", "decay to 20 %", "s", 2),
    Quantity::new("carried_m", "carried by the blow within 2 s", "m", 3),
    Quantity::new("push_m_s", "velocity change", "m/s", 2),
    Quantity::new("peak_contact_force_n", "peak contact force", "N", 0),
    Quantity::new("contact_impulse_n_s", "impulse in the first second", "N·s", 1),
    Quantity::new("hit", "hit by the ball", "%", 0),
    UNDECAYED,
    FELL,
];

/// Its numbers in the protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pendulum {
    /// Forward commands \[m/s\]; 0 is standing.
    pub commands_m_s: Vec<f64>,
    /// Heights of the release above the lowest point \[m\].
    pub heights_m: Vec<f64>,
    /// Runs of each policy from each height at each command.
    pub trials: u32,
}

impl Experiment for Pendulum {
    fn info(&self) -> Info {
        Info {
            id: "E10",
            number: 10,
            name: "pendulum",
            title: "A swinging ball",
            paper: "Fig. 8b",
            method: "A ball of 3 kg on a string of 1 m is let go at a height above its lowest point, where it meets the \
                     right side of the trunk. The push is the largest change of the trunk's velocity along the blow within \
                     0.2 s; it decays as in E2. The peak force is that of all contacts with the ball, \
                     which hardly rebounds and may touch again; the impulse is that of the first second.",
        }
    }

    fn quantities(&self) -> &'static [Quantity] {
        QUANTITIES
    }

    fn trials(&self) -> u32 {
        self.trials
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: Parameters = defaults("pendulum")?;
        let condition = |command: f64, release_height_m: f64| Condition {
            label: format!("{}, {:.0} cm", gait(command), 100.0 * release_height_m),
            scenario: Scenario::Pendulum(Parameters {
                release_height_m,
                task: Task { forward_m_s: command, ..base.task.clone() },
                ..base.clone()
            }),
        };
        let commands = self.commands_m_s.iter();
        Ok(commands.flat_map(|command| self.heights_m.iter().map(|height| condition(*command, *height))).collect())
    }

    fn measure(&self, scenario: &Scenario, script: &Script, trace: &Trace, end: End) -> Measured {
        let Scenario::Pendulum(pendulum) = scenario else { return Measured::default() };
        let mut values = vec![None; QUANTITIES.len()];
        let impact = pendulum.impact(trace);
        if end != End::Fault {
            // Fallen or not, the ball has hit as hard as it has; decay times know of falls themselves.
            let found = scenario.metrics(script, trace);
            (3..6).for_each(|index| values[index] = value(&found, QUANTITIES[index].name));
            let [to_10, to_20] = [0.1, 0.2].map(|to| pendulum.decay(trace, impact.as_ref()?, to));
            values[0] = to_10.map(|decay| decay.time_s);
            values[1] = to_20.map(|decay| decay.time_s);
            values[2] = impact.and_then(|impact| metrics::carried(trace, impact.time_s, impact.push, CARRIED_S));
            values[7] = to_10.and_then(|decay| truth(!decay.is_over));
        }
        values[6] = truth(impact.is_some());
        values[8] = end.fell();
        let series = impact.map(|impact| velocity::around(trace, impact.time_s));
        Measured { values, series: series.unwrap_or_default() }
    }

    fn findings(&self, results: &Results) -> Findings {
        let names: Vec<&str> = QUANTITIES.iter().map(|quantity| quantity.name).collect();
        let caption = "Hit by a ball of 3 kg on a string of 1 m, by command and release height.";
        let table = Table::of_conditions("pendulum", caption, results, &names);
        let panels = ["decay_20_s", "carried_m", "peak_contact_force_n"].map(|name| by_condition(results, name));
        let figure = Figure::new(
            "pendulum",
            "Hit by a ball of 3 kg on a string of 1 m, by command and release height: decay time, distance carried, peak \
             force. Mean ± standard deviation over seeds, single seeds as hollow marks; trials with a fall have no decay \
             time and no distance.",
            dots::draw("What a swinging ball does, by release height", &panels, &labels(results), &results.names),
        );
        let last = results.conditions.len() - 1;
        let velocities = Figure::new(
            "pendulum-velocity",
            format!(
                "Sideways velocity around the blow of the ball ({}): mean and min–max band over the runs of one policy, each \
                 until it falls.",
                results.conditions[last].label
            ),
            curves::draw(
                "Sideways velocity after the blow of a ball, one policy of each set",
                [0, 1].map(|set| velocity::curve(results, set, last)),
                "time since the blow [s]",
                "sideways velocity [m/s]",
            ),
        );
        let (mut claims, mut notes) = (Vec::new(), Vec::new());
        let count = self.heights_m.len();
        for (index, command) in self.commands_m_s.iter().enumerate() {
            let of_command: Vec<usize> = (index * count..(index + 1) * count).collect();
            notes.extend(undecayed(results, &of_command).map(|note| format!("{}: {note}", gait(*command))));
            for (quantity, words) in lasting(*command) {
                let gait = gait(*command);
                claims.push(Claim::direction(
                    &format!("Hit by a swinging ball while {gait}, compliant policies {words}; mean over heights"),
                    "more gradual",
                    results.quantity(quantity),
                    Expected::Higher,
                    results.compare_over(&of_command, quantity),
                ));
            }
        }
        Findings {
            claims,
            tables: vec![table],
            figures: vec![figure, velocities],
            lines: vec![velocity::lines("pendulum-velocities", results)],
            notes,
        }
    }
}
