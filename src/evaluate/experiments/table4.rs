//! E3: power and torque before and after a sideways push (Table IV).

use serde::{Deserialize, Serialize};

use crate::config::ConfigError;
use crate::evaluate::findings::{Claim, Figure, Findings, Table};
use crate::evaluate::plot::dots::{self, Dots};
use crate::evaluate::results::Results;
use crate::evaluate::statistics::Expected;
use crate::evaluate::trial::End;
use crate::evaluate::{Condition, Experiment, FELL, Info, Measured, Quantity};
use crate::scenario::catalog::{PushAway, Scenario, defaults};
use crate::scenario::{Script, metrics};
use crate::trace::{Frame, Trace};

const QUANTITIES: &[Quantity] = &[
    Quantity::new("power_before_w", "power before push", "W", 1),
    Quantity::new("power_after_w", "power after push", "W", 1),
    Quantity::new("power_increase_w", "increase of power", "W", 1),
    Quantity::new("torque_before_n_m", "torque before push", "N·m", 1),
    Quantity::new("torque_after_n_m", "torque after push", "N·m", 1),
    Quantity::new("torque_increase_n_m", "increase of torque", "N·m", 1),
    FELL,
];

/// The paper's Table IV, compliant / baseline, and its differences.
const PAPER: [&str; 6] = [
    "78.5 ± 2.0 / 80.1 ± 1.4",
    "140.9 ± 17.0 / 166.9 ± 25.8",
    "62.4 / 86.8",
    "25.5 ± 0.8 / 26.9 ± 0.7",
    "25.8 ± 1.0 / 27.4 ± 1.3",
    "0.3 / 0.5",
];

/// Its numbers in the protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Table4 {
    /// Runs of each policy.
    pub trials: u32,
    /// Length of the averages before and after the push \[s\].
    pub window_s: f64,
}

impl Experiment for Table4 {
    fn info(&self) -> Info {
        Info {
            id: "E3",
            number: 3,
            name: "table4",
            title: "Power and torque of a sideways push",
            paper: "Table IV",
            method: "The push of E2. Power is Σ|τ·q̇| over the twelve joints, torque is ‖τ‖₂, both at 240 Hz with the \
                     torque actually applied, averaged over as long before and after the push. The increase is the \
                     second minus the first: what the push adds to the walk. A time that a fall cuts short has no \
                     average.",
        }
    }

    fn quantities(&self) -> &'static [Quantity] {
        QUANTITIES
    }

    fn trials(&self) -> u32 {
        self.trials
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let push: PushAway = defaults("push")?;
        Ok(vec![Condition { label: "0.5 m/s to the left".into(), scenario: Scenario::Push(push) }])
    }

    fn measure(&self, _: &Scenario, script: &Script, trace: &Trace, end: End) -> Measured {
        let mut values = vec![None; QUANTITIES.len()];
        values[6] = end.fell();
        if let Some(push) = script.pushes.first() {
            // A trace ends with a fall.
            let reaches = |time_s: f64| trace.frames.last().is_some_and(|f| f.time_s + 0.5 * trace.period_s > time_s);
            let window = |from_s: f64| {
                let until_s = from_s + self.window_s;
                reaches(until_s).then(|| metrics::window(trace, from_s, until_s))
            };
            let [before, after] = [push.time_s - self.window_s, push.time_s].map(window);
            let of = |quantity: fn(&Frame) -> f64| {
                let [before, after] = [before.clone(), after.clone()].map(|frames| metrics::mean(frames?, quantity));
                [before, after, after.zip(before).map(|(after, before)| after - before)]
            };
            [values[0], values[1], values[2]] = of(|frame| frame.power_w);
            [values[3], values[4], values[5]] = of(|frame| frame.torque_n_m);
        }
        Measured { values, series: Vec::new() }
    }

    fn findings(&self, results: &Results) -> Findings {
        let names: Vec<&str> = QUANTITIES.iter().map(|quantity| quantity.name).collect();
        let mut table = Table::of_conditions("table4", "Power and torque around a sideways push.", results, &names);
        for (quantity, paper) in QUANTITIES.iter().zip(PAPER) {
            table = table.with_paper(quantity.name, paper);
        }
        let panel = |label, unit, rows: [&str; 2]| Dots {
            quantity: Quantity::new("", label, unit, 1),
            rows: rows.map(|name| [0, 1].map(|set| results.per_seed(set, 0, name))).into(),
        };
        let panels = [
            panel("mechanical power", "W", ["power_before_w", "power_after_w"]),
            panel("torque norm", "N·m", ["torque_before_n_m", "torque_after_n_m"]),
        ];
        let labels = ["before", "after"].map(|when| format!("{} s {when}", self.window_s));
        let figure = Figure::new(
            "table4",
            "Mechanical power and torque norm before and after a sideways push of 0.5 m/s: mean ± standard \
             deviation over seeds, single seeds as hollow marks.",
            dots::draw("Power and torque before and after a push", &panels, &labels, &results.names),
        );
        let claim = |text: &str, paper: &str, name: &str| {
            Claim::direction(text, paper, results.quantity(name), Expected::Lower, results.compare(0, name))
        };
        let claims = vec![
            claim("After a push, compliant policies use less power", "140.9 / 166.9 W (−15 %)", "power_after_w"),
            claim("After a push, compliant policies use less torque", "25.8 / 27.4 N·m (−6 %)", "torque_after_n_m"),
            claim("Undisturbed, compliant policies use slightly less power", "78.5 / 80.1 W (−2 %)", "power_before_w"),
            claim(
                "Undisturbed, compliant policies use slightly less torque",
                "25.5 / 26.9 N·m (−5 %)",
                "torque_before_n_m",
            ),
            claim("A push adds less power to the walk", "62.4 / 86.8 W (−28 %)", "power_increase_w"),
            claim("… and less torque", "0.3 / 0.5 N·m (−40 %)", "torque_increase_n_m"),
        ];
        Findings { claims, tables: vec![table], figures: vec![figure], ..Findings::default() }
    }
}
