//! E3: power and torque before and after a sideways push (Table IV).

use super::prelude::*;
use super::push;
use crate::plot::dots::Dots;
use supple::scenario::trace::Frame;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("power_before_w", "power before push", "W", 1),
    Quantity::new("power_after_w", "power after push", "W", 1),
    Quantity::new("power_increase_w", "increase of power", "W", 1),
    Quantity::new("torque_before_n_m", "torque before push", "N·m", 1),
    Quantity::new("torque_after_n_m", "torque after push", "N·m", 1),
    Quantity::new("torque_increase_n_m", "increase of torque", "N·m", 1),
    Quantity::new("torque_sum_before_n_m", "torque before push, sum over the joints", "N·m", 1),
    Quantity::new("torque_sum_after_n_m", "torque after push, sum over the joints", "N·m", 1),
    Quantity::new("torque_sum_increase_n_m", "increase of torque, sum over the joints", "N·m", 1),
    FELL,
];

/// The numbers of the paper's Table IV, compliant / baseline, and their differences. The paper does not define torque; the sum over the
/// joints is as large as its numbers.
const PAPER: [(&str, &str); 6] = [
    ("power_before_w", "78.5 ± 2.0 / 80.1 ± 1.4"),
    ("power_after_w", "140.9 ± 17.0 / 166.9 ± 25.8"),
    ("power_increase_w", "62.4 / 86.8"),
    ("torque_sum_before_n_m", "25.5 ± 0.8 / 26.9 ± 0.7"),
    ("torque_sum_after_n_m", "25.8 ± 1.0 / 27.4 ± 1.3"),
    ("torque_sum_increase_n_m", "0.3 / 0.5"),
];

/// The length of the averaging windows before and after the push \[s\].
const WINDOW_S: f64 = 1.0;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Table4 {
    pub trials: u32,
}

impl Experiment for Table4 {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            paper: "Table IV",
            method: "The push of E2. Power is Σ|τ·q̇| over the twelve joints, torque is ‖τ‖₂, both at 240 Hz with the \
                     torque actually applied, averaged over windows of equal length before and after the push; the sum \
                     over the joints is Σ|τ|, at 60 Hz. The increase is the average after minus that before. A window \
                     that a fall cuts short has no average.",
            ..ExperimentInfo::new("E3", 3, "table4", "Power and torque of a sideways push", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        push::sideways()
    }

    fn measure(&self, trial: &Trial) -> TrialValues {
        let Some(push) = trial.script.pushes().next() else { return vec![None; QUANTITIES.len()].into() };
        // The trace of a fallen robot ends with the fall.
        let window = |from_s: f64| metrics::whole_window(trial.trace, from_s, from_s + WINDOW_S);
        let [before, after] = [push.at_s - WINDOW_S, push.at_s].map(window);
        let of = |quantity: fn(&Frame) -> f64| {
            let [before, after] = [before.clone(), after.clone()].map(|frames| metrics::mean(frames?, quantity));
            [before, after, after.zip(before).map(|(after, before)| after - before)]
        };
        let sum = |frame: &Frame| frame.torques.iter().map(|torque| torque.abs()).sum();
        let [power, torque, sum] = [of(|frame| frame.power_w), of(|frame| frame.torque_n_m), of(sum)];
        [&power[..], &torque, &sum, &[trial.end.fell()]].concat().into()
    }

    fn report(&self, section: &mut SectionBuilder) {
        let table = section.table("Power and torque around a sideways push.");
        for (quantity, paper) in PAPER {
            table.set_paper(quantity, paper);
        }
        let panel = |label, unit, rows: [&str; 2]| Dots {
            quantity: Quantity::new("", label, unit, 1),
            rows: rows.map(|name| section.per_seed(0, name)).into(),
        };
        let panels = vec![
            panel("mechanical power", "W", ["power_before_w", "power_after_w"]),
            panel("torque norm", "N·m", ["torque_before_n_m", "torque_after_n_m"]),
        ];
        let labels = ["before", "after"].map(|when| format!("{} s {when}", brief(WINDOW_S)));
        let title = "Mechanical power and torque norm before and after a sideways push of 0.5 m/s";
        section.panels("", title, &panels, &labels, "");
        for (text, paper, quantity) in [
            ("After a push, compliant policies use less power", "140.9 / 166.9 W (−15 %)", "power_after_w"),
            ("After a push, compliant policies use less torque", "25.8 / 27.4 N·m (−6 %)", "torque_sum_after_n_m"),
            ("Undisturbed, compliant policies use slightly less power", "78.5 / 80.1 W (−2 %)", "power_before_w"),
            (
                "Undisturbed, compliant policies use slightly less torque",
                "25.5 / 26.9 N·m (−5 %)",
                "torque_sum_before_n_m",
            ),
            ("A push increases the power of compliant policies less", "62.4 / 86.8 W (−28 %)", "power_increase_w"),
            (
                "A push increases the torque of compliant policies less",
                "0.3 / 0.5 N·m (−40 %)",
                "torque_sum_increase_n_m",
            ),
        ] {
            section.claim(text, paper, quantity, Lower, &[0]);
        }
    }
}
