//! E10: a ball on a string swings into the robot (Fig. 8b).

use super::prelude::*;
use super::{push, velocity};
use crate::trial::TrialEnd;
use supple::scenario::catalog::Pendulum as PendulumScenario;

const QUANTITIES: &[Quantity] = &[
    push::TO_10,
    push::TO_20,
    Quantity { label: "carried by the blow within 2 s", ..push::CARRIED },
    Quantity::new("push_m_s", "velocity change", "m/s", 2),
    Quantity::new("peak_contact_force_n", "peak contact force", "N", 0),
    Quantity::new("contact_impulse_n_s", "impulse in the first second", "N·s", 1),
    Quantity::new("hit", "hit by the ball", "%", 0),
    push::UNDECAYED,
    FELL,
];

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pendulum {
    pub commands_m_s: Vec<f64>,
    /// The release heights of the ball above its lowest point \[m\].
    pub heights_m: Vec<f64>,
    pub trials: u32,
}

impl Experiment for Pendulum {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            paper: "Fig. 8b",
            method: "A ball of 3 kg on a string of 1 m is released at a height above its lowest point, where it hits \
                     the right side of the trunk. The push is the largest change of the trunk's velocity along the \
                     blow within 0.2 s; it decays as in E2. The peak force is that of all contacts with the ball, \
                     which hardly rebounds and may touch again; the impulse is that of the first second.",
            ..ExperimentInfo::new("E10", 10, "pendulum", "A swinging ball", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: PendulumScenario = defaults("pendulum")?;
        Ok(conditions(pairs(&self.commands_m_s, &self.heights_m), |(forward_m_s, release_height_m)| {
            let task = Task { forward_m_s, ..base.task.clone() };
            let scenario = Scenario::Pendulum(PendulumScenario { release_height_m, task, ..base.clone() });
            (format!("{}, {:.0} cm", gait(forward_m_s), 100.0 * release_height_m), scenario)
        }))
    }

    fn measure(&self, trial: &Trial) -> TrialValues {
        let Scenario::Pendulum(pendulum) = trial.scenario else { return TrialValues::default() };
        let impact = pendulum.impact(trial.trace);
        // The numbers of the blow also count if the robot falls; decay times exclude falls themselves.
        let is_valid = trial.end != TrialEnd::Fault;
        let [to_10, to_20, carried, undecayed] = impact
            .filter(|_| is_valid)
            .map_or([None; 4], |impact| push::decay(trial.trace, impact.time_s, impact.push));
        let of_blow = |quantity: &Quantity| trial.metric(quantity.name).filter(|_| is_valid);
        let mut values = vec![to_10, to_20, carried];
        values.extend(QUANTITIES[3..6].iter().map(of_blow));
        values.extend([indicator(impact.is_some()).filter(|_| is_valid), undecayed, trial.end.fell()]);
        let series = impact.map(|impact| velocity::around(trial.trace, impact.time_s));
        TrialValues { values, series: series.unwrap_or_default() }
    }

    fn report(&self, section: &mut SectionBuilder) {
        section.table("Hit by a ball of 3 kg on a string of 1 m, by command and release height.");
        section.dots(
            "",
            "Effect of a swinging ball, by command and release height",
            &["decay_20_s", "carried_m", "peak_contact_force_n"],
            "Trials with a fall have no decay time and no distance.",
        );
        let last = section.results.conditions.len() - 1;
        let caption = format!(
            "Sideways velocity around the blow of the ball ({}): mean and min–max band over the runs of one policy, \
             each until it falls.",
            section.results.conditions[last].label
        );
        let words = ["Sideways velocity after the blow of a ball, one policy of each set", "time since the blow [s]"];
        velocity::figure(section, ["velocity", "pendulum-velocities"], words, last, |curve, _| curve, caption);
        let groups = section.groups(&self.commands_m_s, |command| gait(command).to_owned());
        for (ConditionGroup { name, conditions }, command) in groups.iter().zip(&self.commands_m_s) {
            section
                .content
                .notes
                .extend(push::undecayed(section.results, conditions).map(|note| format!("{name}: {note}")));
            for (quantity, words) in push::lasting(*command) {
                let text =
                    format!("Hit by a swinging ball while {name}, compliant policies {words} (mean over heights)");
                section.claim(&text, "more gradual", quantity, Higher, conditions);
            }
        }
    }
}
