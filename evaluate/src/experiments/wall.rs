//! E14b: walking into a wall that gives.

use super::prelude::*;
use supple::scenario::catalog::Wall as WallScenario;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("peak_force_n", "peak force", "N", 0),
    Quantity::new("blow_n_s", "impulse in the first second", "N·s", 1),
    Quantity::new("impulse_n_s", "impulse to the end", "N·s", 0),
    Quantity::new("depth_m", "depth", "m", 2),
    FELL,
];

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wall {
    pub commands_m_s: Vec<f64>,
    pub trials: u32,
}

impl Experiment for Wall {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            method: "The robot walks into a soft wall of 700 N/m and 4 N·s/m, which pushes back its trunk's centre of \
                     mass. It keeps pressing until the end, some 5 s. Peak force and depth are the largest ones. A \
                     fall leaves every quantity but the falls undefined.",
            ..ExperimentInfo::new("E14b", 16, "wall", "A wall that gives", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: WallScenario = defaults("wall")?;
        Ok(conditions(&self.commands_m_s, |command| {
            let task = Task { forward_m_s: *command, ..base.task.clone() };
            (format!("{} m/s", brief(*command)), Scenario::Wall(WallScenario { task, ..base }))
        }))
    }

    fn report(&self, section: &mut SectionBuilder) {
        section.table("Walking into a wall of 700 N/m and 4 N·s/m, by command.");
        section.dots(
            "",
            "Force, impulse and depth at a wall that gives",
            &["peak_force_n", "blow_n_s", "depth_m"],
            "The impulse is that of the first second. Trials with a fall have none.",
        );
        for (quantity, words) in [
            ("peak_force_n", "have a lower peak force"),
            ("blow_n_s", "have a smaller impulse in the first second"),
            ("impulse_n_s", "have a smaller impulse until the end"),
            ("fell", "fall less often"),
        ] {
            let text = format!("Walking into a wall that gives, compliant policies {words}");
            section.claim(&text, "", quantity, Lower, &section.all());
        }
    }
}
