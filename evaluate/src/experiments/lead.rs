//! E14c: a person holding the leash walks away.

use super::prelude::*;
use supple::scenario::catalog::Lead as LeadScenario;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("mean_tension_n", "mean tension", "N", 1),
    Quantity::new("peak_tension_n", "peak tension", "N", 1),
    Quantity::new("led_m", "led beside its course by", "m", 2),
    FELL,
];

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lead {
    pub commands_m_s: Vec<f64>,
    pub directions: u32,
    pub trials: u32,
}

impl Experiment for Lead {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            method: "A person holding a leash walks beside the robot at its commanded velocity, and after 2 s walks \
                     away at 0.5 m/s, in world-fixed directions all around. Leash and arm are a spring of 200 N/m with \
                     20 N·s/m that pulls the trunk's centre of mass in that direction and never pushes. A robot of \
                     compliance c follows once the tension is 0.5/c. Tensions are those of the last 3 of 6 s. A fall \
                     leaves every quantity but the falls undefined.",
            ..ExperimentInfo::new("E14c", 17, "lead", "Led by the leash", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: LeadScenario = defaults("lead")?;
        let each = pairs(&self.commands_m_s, &evenly(self.directions));
        Ok(conditions(each, |(forward_m_s, direction_deg)| {
            let task = Task { forward_m_s, ..base.task.clone() };
            let scenario = Scenario::Lead(LeadScenario { direction_deg, task, ..base });
            (format!("{}, {direction_deg:.1}°", gait(forward_m_s)), scenario)
        }))
    }

    fn check(&self) -> Result<(), ParameterError> {
        check_directions(self.directions)
    }

    fn report(&self, section: &mut SectionBuilder) {
        let groups = section.groups(&self.commands_m_s, |command| gait(command).to_owned());
        for ConditionGroup { name, conditions } in &groups {
            for (quantity, words) in
                [("mean_tension_n", "follow with a lower tension (mean over directions)"), ("fell", "fall less often")]
            {
                let text = format!("Led by a leash while {name}, compliant policies {words}");
                section.claim(&text, "", quantity, Lower, conditions);
            }
        }
        section.table_with_rows("Led by a leash at 0.5 m/s, mean over all directions.", section.rows(&groups));
        section.table_in_file("all", "Led by a leash at 0.5 m/s, by direction.");
        section.polar(
            "",
            "Leash tension while a person walks away at 0.5 m/s, by the direction they walk to",
            ("mean_tension_n", "mean tension [N]"),
            (&groups, self.directions),
            Scales::Shared,
            "Trials with a fall have none.",
        );
    }
}
