//! E16: the strongest shove that the robot takes, by direction and duration.

use super::prelude::*;
use super::push;
use supple::robot::GRAVITY_M_S2;
use supple::scenario::catalog::PushTrunk;
use supple::scenario::trace::Frame;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("survived_n_s", "impulse survived", "N·s", 1),
    Quantity::new("peak_power_w", "peak power, 1 s from the first shove", "W", 0),
    Quantity::new("peak_torque_n_m", "peak torque of a joint, 1 s from the first shove", "N·m", 1),
    push::TO_20,
];

/// The time over which the peaks are taken \[s\].
const PEAK_S: f64 = 1.0;

/// The time from one shove to the next \[s\]; the first one and the growth, as changes of velocity \[m/s\].
const EVERY_S: f64 = 3.0;
const GROWTH_M_S: [f64; 2] = [0.5, 0.25];

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shove {
    pub directions: u32,
    pub trials: u32,
    pub durations_s: Vec<f64>,
    pub shoves: u32,
}

impl Experiment for Shove {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            method: "Walking at 0.5 m/s, the robot is shoved again and again in one direction (of its heading) by a \
                     horizontal force on its trunk for a short time, every few seconds and each time harder, until it \
                     falls. An impulse is the robot's mass times the change of velocity that it would cause alone. \
                     Survived is the last one before the fall, or the largest. Peaks and decay are of the first \
                     shove, from its beginning; none if the robot falls before the second.",
            ..ExperimentInfo::new("E16", 19, "shove", "Shoves that grow", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: PushTrunk = defaults("push")?;
        Ok(conditions(pairs(&self.durations_s, &evenly(self.directions)), |(for_s, direction_deg)| {
            let task = Task { duration_s: base.at_s + 1.0 + EVERY_S * f64::from(self.shoves), ..base.task.clone() };
            let [push_m_s, growth_m_s] = GROWTH_M_S;
            let push = PushTrunk { task, push_m_s, direction_deg, for_s, growth_m_s, every_s: EVERY_S, ..base };
            (format!("{for_s} s, {direction_deg:.1}°"), Scenario::Push(push))
        }))
    }

    fn check(&self) -> Result<(), ParameterError> {
        in_range("shoves", f64::from(self.shoves), 1.0, 100.0, "1 to 100")?;
        let shorter = |for_s: f64| in_range("durations_s", for_s, 0.01, 0.5 * EVERY_S, "0.01 to 1.5 s");
        self.durations_s.iter().copied().try_for_each(shorter)?;
        check_directions(self.directions)
    }

    fn measure(&self, trial: &Trial) -> TrialValues {
        let pushes: Vec<_> = trial.script.pushes().take(self.shoves as usize).collect();
        let (None, Some(first)) = (trial.trace.fault(), pushes.first()) else {
            return vec![None; QUANTITIES.len()].into();
        };
        let mass_kg = trial.trace.weight_n / GRAVITY_M_S2;
        let end_s = trial.trace.fall().map_or(f64::INFINITY, |fall| fall.time_s);
        let taken = pushes.iter().take_while(|push| push.at_s + EVERY_S <= end_s);
        let survived = taken.last().map_or(0.0, |push| mass_kg * push.linear[0].hypot(push.linear[1]));
        let alone = (survived > 0.0).then(|| trial.trace.until(first.at_s + EVERY_S));
        let peak = |of: fn(&Frame) -> f64| {
            metrics::largest(metrics::window(alone.as_ref()?, first.at_s, first.at_s + PEAK_S), of)
        };
        let torque = |frame: &Frame| frame.torques.iter().fold(0.0, |most: f64, torque| most.max(torque.abs()));
        let back = alone.as_ref().and_then(|alone| push::decay(alone, first.at_s, first.linear)[1]);
        vec![Some(survived), peak(|frame| frame.power_w), peak(torque), back].into()
    }

    fn report(&self, section: &mut SectionBuilder) {
        let groups = section.groups(&self.durations_s, |duration| format!("{duration} s"));
        for ConditionGroup { name, conditions } in &groups {
            let text = format!("Shoved for {name} from any side, compliant policies survive a larger impulse");
            section.claim(&text, "", "survived_n_s", Higher, conditions);
        }
        section
            .table_with_rows("Shoves that grow, by their duration: mean over all directions.", section.rows(&groups));
        section.table_in_file("all", "Shoves that grow, by duration and direction.");
        section.polar(
            "",
            "Impulse survived while walking at 0.5 m/s, by the direction of the shoves",
            ("survived_n_s", "impulse survived [N·s]"),
            (&groups, self.directions),
            Scales::Shared,
            "",
        );
    }
}
