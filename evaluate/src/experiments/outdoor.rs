//! E11: over hills of varied friction (Fig. 8d).

use super::prelude::*;
use supple::scenario::catalog::Outdoor as OutdoorScenario;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("success", "no fall in 20 s", "%", 0),
    Quantity::new("velocity_error_m_s", "velocity error", "m/s", 3),
    Quantity::new("power_w", "power", "W", 1),
    Quantity::new("steepest_met", "steepest slope on the way", "%", 0),
];

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outdoor {
    /// The steepest slopes of the hills, rise over run.
    pub steepest: Vec<f64>,
    pub trials: u32,
}

impl Experiment for Outdoor {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            paper: "Fig. 8d",
            method: "The robot walks at 0.5 m/s for 20 s over smooth hills, which differ in every trial; their \
                     steepest slope varies. Each square metre of ground has its own friction, drawn between 0.4 and \
                     1.0, which applies to each foot on it. The velocity error is the length of mean velocity minus \
                     command in the horizontal plane. All numbers except success are of trials without a fall.",
            ..ExperimentInfo::new("E11b", 13, "outdoor", "Hills of varied friction", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: OutdoorScenario = defaults("outdoor")?;
        Ok(conditions(&self.steepest, |steepest| {
            let scenario = Scenario::Outdoor(OutdoorScenario { steepest: *steepest, ..base.clone() });
            (format!("slopes to {:.0} %", 100.0 * steepest), scenario)
        }))
    }

    fn measure(&self, trial: &Trial) -> TrialValues {
        let mut found = trial.upright_metrics(QUANTITIES);
        found.values[3] = trial.upright_metric("steepest_met_percent").map(|percent| 0.01 * percent);
        found
    }

    fn report(&self, section: &mut SectionBuilder) {
        section.table("Over hills of varied friction, by their steepest slope.");
        section.dots(
            "",
            "Success, velocity error and power on hills of varied friction, by their steepest slope",
            &["success", "velocity_error_m_s", "power_w"],
            "Velocity error and power are of trials without a fall.",
        );
        let text = "On hills of varied friction, compliant policies stay on their feet more often";
        section.claim(text, "manages; no baseline shown", "success", Higher, &section.all());
    }
}
