//! E0: walking undisturbed, at the command of the other experiments and at the corners of the command range.

use std::collections::BTreeMap;

use super::prelude::*;
use crate::results::Results;
use crate::section_content::{Claim, difference, spread};
use supple::scenario::catalog::Walk as WalkScenario;

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
    Quantity::new("flight_fraction", "time in flight", "%", 0),
    Quantity::new("swing_height_m", "foot height", "m", 3),
    Quantity::new("peak_foot_force_n", "peak foot force", "N", 0),
];

/// The fraction of time in flight from which a gait counts as hopping; a trot at this speed has almost none.
const HOPPING_FRACTION: f64 = 0.3;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Walk {
    pub trials: u32,
    /// The commands: forward \[m/s\], left \[m/s\], yaw rate \[rad/s\].
    pub commands: Vec<[f64; 3]>,
    /// The masses that the robot carries at its trunk, walking at the first command \[kg\].
    pub payloads_kg: Vec<f64>,
    /// The paper's bound on the velocity error \[m/s\].
    pub error_bound_m_s: f64,
}

impl Walk {
    /// Returns warnings about policies that do not walk as all other experiments require.
    fn warnings(&self, results: &Results) -> Vec<String> {
        let Some([forward, left, _]) = self.commands.first() else { return Vec::new() };
        let mut notes = Vec::new();
        for (set, name) in results.names.iter().enumerate() {
            let errors = results.per_seed(set, 0, "velocity_error_m_s");
            let flights = results.per_seed(set, 0, "flight_fraction");
            for (seed, part) in flights.iter().filter(|(_, part)| **part > HOPPING_FRACTION) {
                let percent = 100.0 * part;
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
            let (speed, bound) = (forward.hypot(*left), self.error_bound_m_s);
            for (seed, error) in errors.iter().filter(|(_, error)| speed > 0.0 && **error > 0.5 * speed) {
                let words = "does not follow its command: its velocity error is";
                notes.push(format!("{name}, seed {seed}, {words} {error:.2} m/s."));
            }
            for (seed, error) in errors.iter().filter(|(_, error)| **error > bound && **error <= 0.5 * speed) {
                let words = format!("has a velocity error above {bound} m/s");
                notes.push(format!("{name}, seed {seed}, {words}: {error:.3} m/s."));
            }
        }
        notes
    }
}

/// Returns a note about the velocity error over all commands, which the paper does not report.
fn mean_error_note(results: &Results, commands: usize) -> String {
    let quantity = results.quantity("velocity_error_m_s");
    let all: Vec<usize> = (0..commands).collect();
    let comparison = results.compare_over(&all, quantity.name);
    let sets = comparison.sets.iter().zip(&results.names);
    let cells: Vec<String> = sets.map(|(set, name)| format!("{} {name}", spread(set, quantity, " m/s"))).collect();
    format!(
        "Velocity error, mean over all {} commands: {}; difference {}.",
        all.len(),
        cells.join(", "),
        difference(&comparison, quantity, " m/s")
    )
}

/// Returns a command in words.
pub(super) fn label([forward, left, turn]: [f64; 3]) -> String {
    let parts = [("forward", forward), ("left", left), ("turn", turn)].into_iter().filter(|(_, value)| *value != 0.0);
    let words: Vec<String> = parts.map(|(name, value)| format!("{name} {}", brief(value))).collect();
    if words.is_empty() { "standing".to_owned() } else { words.join(", ").replace('-', "−") }
}

impl Experiment for Walk {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            paper: "Fig. 5, caption",
            method: "The policy walks on flat ground without disturbance. Errors are mean velocity minus command from \
                     2 s on, in the heading frame; the velocity error is the length of the horizontal one. Payloads \
                     are masses on the trunk. Only sensor noise is random, in trials on sensors.",
            ..ExperimentInfo::new("E0", 0, "walk", "Walking undisturbed", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: WalkScenario = defaults("walk")?;
        let walks = self.commands.iter().map(|command| (*command, 0.0));
        let carrying =
            self.commands.first().into_iter().flat_map(|first| self.payloads_kg.iter().map(|kg| (*first, *kg)));
        Ok(conditions(walks.chain(carrying), |(command, extra_mass_kg)| {
            let [forward_m_s, left_m_s, yaw_rad_s] = command;
            let carried = if extra_mass_kg == 0.0 { String::new() } else { format!(", carrying {extra_mass_kg} kg") };
            let task = Task { forward_m_s, left_m_s, yaw_rad_s, extra_mass_kg, ..base.task.clone() };
            (label(command) + &carried, Scenario::Walk(WalkScenario { task }))
        }))
    }

    fn check(&self) -> Result<(), ParameterError> {
        let payloads = self.payloads_kg.iter();
        payloads.copied().try_for_each(|kg| in_range("payloads_kg", kg, 0.1, 10.0, "0.1 to 10 kg"))
    }

    fn report(&self, section: &mut SectionBuilder) {
        let caption = "Walking undisturbed, by command: forward and left in m/s, turn (to the left) in rad/s.";
        let (results, first) = (section.results, section.first_label());
        let of_first = ConditionGroup::new(first, [0]);
        let title = format!("Walking undisturbed at the command of the other experiments ({first}).");
        section.table_with_rows(&title, section.rows(&[of_first]));
        section.table_in_file("commands", caption);
        let (quantity, bound) = ("velocity_error_m_s", self.error_bound_m_s);
        let text = format!("Walking undisturbed ({first}), both sets keep the mean velocity error below {bound} m/s");
        let (comparison, quantity) = (results.compare_over(&[0], quantity), results.quantity(quantity));
        section.content.claims.push(Claim::below(bound, text, "< 0.05 / < 0.05 m/s", quantity, comparison));
        section.dots(
            "",
            "Velocity error and mechanical power without disturbance, by command",
            &["velocity_error_m_s", "power_w"],
            "Commands forward and left are in m/s, turns to the left in rad/s.",
        );
        let notes = std::iter::once(mean_error_note(results, self.commands.len())).chain(self.warnings(results));
        section.content.notes.extend(notes);
    }
}
