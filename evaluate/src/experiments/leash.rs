//! E5: how far a constant pull drags the robot off its command (Fig. 5).

use super::prelude::*;
use supple::scenario::catalog::Leash as LeashScenario;

const OFFSET: Quantity = Quantity::new("offset_m_s", "velocity along the pull", "m/s", 3);
const QUANTITIES: &[Quantity] = &[OFFSET, FELL, Quantity::new("power_w", "power", "W", 1)];

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Leash {
    pub directions: u32,
    pub trials: u32,
    pub forces_n: Vec<f64>,
    pub at_s: f64,
    pub for_s: f64,
    pub average_s: f64,
}

/// Returns constant pulls with each force \[N\] in each direction, which start at `at_s` and last `for_s` \[s\].
pub(super) fn pulls(forces_n: &[f64], directions: u32, [at_s, for_s]: [f64; 2]) -> Result<Vec<Condition>, ConfigError> {
    let base: LeashScenario = defaults("leash")?;
    Ok(conditions(pairs(forces_n, &evenly(directions)), |(force_n, direction_deg)| {
        let task = Task { duration_s: at_s + for_s, ..base.task.clone() };
        let scenario = Scenario::Leash(LeashScenario { force_n, direction_deg, at_s, for_s, task, ..base });
        (format!("{} N, {direction_deg:.1}°", brief(force_n)), scenario)
    }))
}

impl Experiment for Leash {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            paper: "Fig. 5",
            method: "Walking at 0.5 m/s, the robot is pulled by a constant horizontal force on its trunk in \
                     directions all around; the force keeps its direction in the world. The offset is the mean \
                     velocity minus the command, along the force, over the last seconds of the pull. E0 has the \
                     undisturbed error.",
            ..ExperimentInfo::new("E5", 5, "leash", "On a leash", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        pulls(&self.forces_n, self.directions, [self.at_s, self.for_s])
    }

    fn check(&self) -> Result<(), ParameterError> {
        in_range("for_s", self.for_s, 0.1, 60.0, "0.1 to 60 s")?;
        in_range("average_s", self.average_s, 0.1, self.for_s, "0.1 s to leash.for_s")?;
        check_directions(self.directions)
    }

    fn measure(&self, trial: &Trial) -> TrialValues {
        let mut values = vec![None, trial.end.fell(), None];
        if let (true, Some(pull)) = (trial.is_upright(), trial.script.pull()) {
            let (from_s, until_s) = (pull.until_s - self.average_s, pull.until_s);
            values[0] = metrics::offset_along_force(trial.trace, pull.force, from_s, until_s);
            values[2] = metrics::mean(metrics::window(trial.trace, from_s, until_s), |frame| frame.power_w);
        }
        values.into()
    }

    fn report(&self, section: &mut SectionBuilder) {
        let groups = section.groups(&self.forces_n, |force| format!("{force} N"));
        for ConditionGroup { name, conditions } in &groups {
            let text = format!(
                "Pulled with {name}, compliant policies yield more (mean over directions; larger in {})",
                section.results.larger_in(conditions, "offset_m_s"),
            );
            section.claim(&text, "yields more", "offset_m_s", Higher, conditions);
        }
        section
            .table_with_rows("Velocity offset along a constant pull, mean over all directions.", section.rows(&groups));
        section.table_in_file("all", "Velocity offset along the pull by direction.");
        section.polar(
            "",
            "Velocity offset along a constant pull while walking at 0.5 m/s, by the direction it pulls to",
            ("offset_m_s", "velocity offset along the pull [m/s]"),
            (&groups, self.directions),
            Scales::Shared,
            "Inside the darker circle the robot moves against the pull.",
        );
    }
}
