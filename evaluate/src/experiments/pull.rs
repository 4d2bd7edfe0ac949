//! E14a: the sustained pulls under which the robot does not fall.

use super::leash::pulls;
use super::prelude::*;

const QUANTITIES: &[Quantity] = &[Quantity::new("survived", "survived", "%", 0)];

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PullSurvival {
    pub directions: u32,
    pub trials: u32,
    pub forces_n: Vec<f64>,
    pub at_s: f64,
    pub for_s: f64,
}

impl Experiment for PullSurvival {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            method: "Walking at 0.5 m/s, the robot is pulled by a constant horizontal force on its trunk for some \
                     seconds, in directions all around; the force keeps its direction in the world. It survives if it \
                     has not fallen by the end of the pull.",
            ..ExperimentInfo::new("E14a", 15, "pull", "Sustained pulls", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        pulls(&self.forces_n, self.directions, [self.at_s, self.for_s])
    }

    fn check(&self) -> Result<(), ParameterError> {
        in_range("for_s", self.for_s, 0.1, 60.0, "0.1 to 60 s")?;
        check_directions(self.directions)
    }

    fn measure(&self, trial: &Trial) -> TrialValues {
        vec![indicator(trial.is_upright())].into()
    }

    fn report(&self, section: &mut SectionBuilder) {
        let forces = section.groups(&self.forces_n, |force| format!("{force} N"));
        let text =
            format!("Pulled from any side for {} s, compliant policies stay on their feet more often", self.for_s);
        section.claim(&text, "", "survived", Higher, &section.all());
        section.table_with_rows("Sustained pulls survived, by force: mean over all directions.", section.rows(&forces));
        section.table_in_file("all", "Sustained pulls survived, by force and direction.");
        let title = "Sustained pulls survived while walking at 0.5 m/s, by force, over all directions";
        section.grouped_dots("", title, &forces, &["survived"], "");
        let all = ConditionGroup::new("", section.all());
        section.polar(
            "directions",
            "Sustained pulls survived while walking at 0.5 m/s, by the direction they pull to",
            ("survived", "survived [%], mean over all forces"),
            (&[all], self.directions),
            Scales::Percent,
            "The band is cut off at 0 and 100 %.",
        );
    }
}
