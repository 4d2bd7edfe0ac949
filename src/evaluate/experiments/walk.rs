//! E0: walking undisturbed, at the other experiments' command and at the corners of the commands.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{by_condition, labels, value};
use crate::config::ConfigError;
use crate::evaluate::findings::{Claim, Figure, Findings, Table, difference, spread};
use crate::evaluate::plot::dots;
use crate::evaluate::results::Results;
use crate::evaluate::trial::End;
use crate::evaluate::{Condition, Experiment, FELL, Info, Measured, Quantity};
use crate::scenario::catalog::{Scenario, Task, Walk as Parameters, defaults};
use crate::scenario::{Script, metrics};
use crate::trace::Trace;

const QUANTITIES: &[Quantity] = &[
    FELL,
    Quantity::new("velocity_error_m_s", "velocity error", "m/s", 3),
    Quantity::new("forward_error_m_s", "forward error", "m/s", 3),
    Quantity::new("left_error_m_s", "sideways error", "m/s", 3),
    Quantity::new("yaw_error_rad_s", "yaw rate error", "rad/s", 3),
    Quantity::new("power_w", "power", "W", 1),
    Quantity::new("torque_n_m", "torque norm", "N·m", 1),
    Quantity::new("cost_of_transport", "cost of transport", "", 2),
    Quantity::new("stride_frequency_hz", "stride frequency", "Hz", 2),
    Quantity::new("flight_share", "time in flight", "%", 0),
    Quantity::new("swing_height_m", "foot height", "m", 3),
    Quantity::new("peak_foot_force_n", "peak foot force", "N", 0),
];

/// Time in flight from which on a gait is called hopping; a trot at this speed has next to none.
const HOPPING_SHARE: f64 = 0.3;

/// Its numbers in the protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Walk {
    /// Runs of each policy at each command.
    pub trials: u32,
    /// Forward \[m/s\], left \[m/s\], yaw rate \[rad/s\].
    pub commands: Vec<[f64; 3]>,
    /// The paper's bound on the velocity error \[m/s\].
    pub error_bound_m_s: f64,
}

impl Walk {
    /// Policies that do not do what all the other experiments ask of them.
    fn strangers(&self, results: &Results) -> Vec<String> {
        let Some([forward, left, _]) = self.commands.first() else { return Vec::new() };
        let mut notes = Vec::new();
        for (set, name) in results.names.iter().enumerate() {
            let errors = results.per_seed(set, 0, "velocity_error_m_s");
            let flights = results.per_seed(set, 0, "flight_share");
            for (seed, share) in flights.iter().filter(|(_, share)| **share > HOPPING_SHARE) {
                let percent = 100.0 * share;
                notes.push(format!("{name}, seed {seed}, hops: {percent:.0} % of the time no foot is on the ground."));
            }
            let mut fell_at: BTreeMap<u64, Vec<&str>> = BTreeMap::new();
            for (index, condition) in results.conditions.iter().enumerate() {
                let falls = results.per_seed(set, index, "fell");
                for (seed, _) in falls.into_iter().filter(|(_, fell)| *fell > 0.0) {
                    fell_at.entry(seed).or_default().push(&condition.label);
                }
            }
            for (seed, commands) in fell_at {
                let commands = commands.join("; ");
                notes.push(format!("{name}, seed {seed}, falls without any disturbance at {commands}."));
            }
            let speed = forward.hypot(*left);
            for (seed, error) in errors.iter().filter(|(_, error)| speed > 0.0 && **error > 0.5 * speed) {
                notes.push(format!(
                    "{name}, seed {seed}, does not walk at its command: its velocity error is {error:.2} m/s."
                ));
            }
            let bound = self.error_bound_m_s;
            for (seed, error) in errors.iter().filter(|(_, error)| **error > bound && **error <= 0.5 * speed) {
                notes.push(format!(
                    "{name}, seed {seed}, by itself does not keep its velocity error below {bound} m/s: {error:.3} m/s."
                ));
            }
        }
        notes
    }
}

/// How well all commands are followed, which the paper does not say.
fn over_all(results: &Results) -> String {
    let quantity = results.quantity("velocity_error_m_s");
    let all: Vec<usize> = (0..results.conditions.len()).collect();
    let comparison = results.compare_over(&all, quantity.name);
    let spreads = [comparison.a_spread, comparison.b_spread];
    let cells: Vec<String> = (0..2)
        .map(|set| {
            format!("{} {}", spread(spreads[set], quantity, comparison.members[set], " m/s"), results.names[set])
        })
        .collect();
    format!(
        "Velocity error, mean over all {} commands: {}; difference {}.",
        all.len(),
        cells.join(", "),
        difference(&comparison, quantity, " m/s")
    )
}

/// A command in words.
fn label([forward, left, turn]: [f64; 3]) -> String {
    let parts = [("forward", forward), ("left", left), ("turn", turn)];
    let words: Vec<String> =
        parts.iter().filter(|(_, value)| *value != 0.0).map(|(name, value)| format!("{name} {value}")).collect();
    if words.is_empty() { "standing".to_owned() } else { words.join(", ").replace('-', "−") }
}

impl Experiment for Walk {
    fn info(&self) -> Info {
        Info {
            id: "E0",
            number: 0,
            name: "walk",
            title: "Walking undisturbed",
            paper: "Fig. 5, caption",
            method: "The policy walks on flat ground without disturbance. Errors are mean velocity minus command from \
                     2 s on, in the heading frame; the velocity error is the length of the horizontal one. Nothing is \
                     drawn at random but the sensors' noise, where there are sensors.",
        }
    }

    fn quantities(&self) -> &'static [Quantity] {
        QUANTITIES
    }

    fn trials(&self) -> u32 {
        self.trials
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: Parameters = defaults("walk")?;
        let condition = |[forward_m_s, left_m_s, yaw_rad_s]: &[f64; 3]| Condition {
            label: label([*forward_m_s, *left_m_s, *yaw_rad_s]),
            scenario: Scenario::Walk(Parameters {
                task: Task {
                    forward_m_s: *forward_m_s,
                    left_m_s: *left_m_s,
                    yaw_rad_s: *yaw_rad_s,
                    ..base.task.clone()
                },
            }),
        };
        Ok(self.commands.iter().map(condition).collect())
    }

    fn measure(&self, scenario: &Scenario, script: &Script, trace: &Trace, end: End) -> Measured {
        let mut values = vec![None; QUANTITIES.len()];
        values[0] = end.fell();
        if end == End::Upright {
            let errors = metrics::velocity_errors(trace, metrics::SETTLE_S, script.duration_s);
            values[1] = metrics::velocity_error(trace, metrics::SETTLE_S, script.duration_s);
            (0..3).for_each(|axis| values[2 + axis] = errors.map(|errors| errors[axis]));
            let found = scenario.metrics(script, trace);
            for (index, quantity) in QUANTITIES.iter().enumerate().skip(5) {
                values[index] = value(&found, quantity.name);
            }
            values[9] = metrics::flight_share(trace, metrics::SETTLE_S, script.duration_s);
        }
        Measured { values, series: Vec::new() }
    }

    fn findings(&self, results: &Results) -> Findings {
        let all: Vec<&str> = QUANTITIES.iter().map(|quantity| quantity.name).collect();
        let caption = "Walking undisturbed, by command: forward and left in m/s, turn (to the left) in rad/s.";
        let mut every = Table::of_conditions("walk-commands", caption, results, &all);
        every.in_page = false;
        let of_first = every.rows.iter().take(all.len()).cloned().collect();
        let first = results.conditions.first().map_or(String::new(), |condition| condition.label.clone());
        let caption = format!("Walking undisturbed at the command of the other experiments ({first}).");
        let table = Table { name: "walk".into(), caption, rows: of_first, in_page: true };
        let panels = ["velocity_error_m_s", "power_w"].map(|name| by_condition(results, name));
        let claim = Claim::bound(
            &format!(
                "Walking undisturbed ({first}), both keep the velocity error below {} m/s in the mean",
                self.error_bound_m_s
            ),
            "< 0.05 / < 0.05 m/s",
            results.quantity("velocity_error_m_s"),
            self.error_bound_m_s,
            results.compare(0, "velocity_error_m_s"),
        );
        Findings {
            claims: vec![claim],
            tables: vec![table, every],
            figures: vec![Figure::new(
                "walk",
                "Velocity error and mechanical power without disturbance, by command (forward and left in m/s, turn to \
                 the left in rad/s): mean ± standard deviation over seeds, single seeds as hollow marks.",
                dots::draw("Velocity error and power by command", &panels, &labels(results), &results.names),
            )],
            notes: std::iter::once(over_all(results)).chain(self.strangers(results)).collect(),
            ..Findings::default()
        }
    }
}
