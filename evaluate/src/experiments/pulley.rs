//! E9: a weight over a pulley pulls the robot (Fig. 8a).

use super::prelude::*;
use supple::scenario::catalog::Pulley as PulleyScenario;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("displacement_m", "moved along the pull", "m", 2),
    Quantity::new("offset_m_s", "velocity along the pull", "m/s", 3),
    Quantity::new("mean_rope_force_n", "mean rope force", "N", 1),
    Quantity::new("peak_rope_force_n", "peak rope force", "N", 1),
    Quantity::new("power_pulled_w", "power while pulled", "W", 1),
    FELL,
];

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pulley {
    pub commands_m_s: Vec<f64>,
    /// The directions of the pull in the heading frame: 0 ahead, 90 left, 180 back, 270 right \[deg\].
    pub directions_deg: Vec<f64>,
    pub trials: u32,
}

impl Experiment for Pulley {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            paper: "Fig. 8a",
            method: "A weight of 1 kg hangs on a rope that leads over pulleys to the trunk; it is let go with the rope \
                     just taut, pulls for 4 s, and is taken off. The displacement is the distance moved along the pull \
                     by its end, minus that of the command. The offset is the mean velocity along the pull minus the \
                     command, from 1 s after the start to the end. The rope force, from 1 s after the start, is m (g + \
                     a) of the weight. A fall leaves every quantity but the falls undefined.",
            ..ExperimentInfo::new("E9", 9, "pulley", "A weight over a pulley", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: PulleyScenario = defaults("pulley")?;
        Ok(conditions(pairs(&self.commands_m_s, &self.directions_deg), |(forward_m_s, direction_deg)| {
            let task = Task { forward_m_s, ..base.task.clone() };
            let scenario = Scenario::Pulley(PulleyScenario { direction_deg, task, ..base.clone() });
            (format!("{}, {direction_deg:.0}°", gait(forward_m_s)), scenario)
        }))
    }

    fn report(&self, section: &mut SectionBuilder) {
        section.table(
            "Pulled by 1 kg over a pulley, by command and direction (0° ahead, 90° left, 180° back, 270° right).",
        );
        section.dots(
            "",
            "Displacement and velocity along the pull of a weight, and falls, by direction of the pull",
            &["displacement_m", "offset_m_s", "fell"],
            "0° is ahead, 90° left, 180° back, 270° right. Trials with a fall count as falls only.",
        );
        for ConditionGroup { name, conditions } in
            section.groups(&self.commands_m_s, |command| gait(command).to_owned())
        {
            let text = format!(
                "Pulled by a weight while {name}, compliant policies move farther along the pull (mean over directions)"
            );
            section.claim(&text, "moves with the pull", "displacement_m", Higher, &conditions);
        }
        let text = "Pulled by a weight, compliant policies fall less often";
        section.claim(text, "less prone", "fell", Lower, &section.all());
    }
}
