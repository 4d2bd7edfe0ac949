//! E11: over wooden blocks and soft mats (Fig. 8c).

use super::crossing::Crossing;
use super::prelude::*;
use supple::scenario::catalog::Rubble as RubbleScenario;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("success", "no fall", "%", 0),
    Quantity::new("crossed", "got across", "%", 0),
    Quantity::new("velocity_error_m_s", "velocity error", "m/s", 3),
    Quantity::new("peak_foot_force_n", "peak foot force", "N", 0),
    Quantity::new("power_w", "power", "W", 1),
];

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rubble {
    /// The largest heights of the blocks \[m\].
    pub heights_m: Vec<f64>,
    pub trials: u32,
}

impl Experiment for Rubble {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            paper: "Fig. 8c",
            method: "The robot walks at 0.5 m/s for at most 15 s over 4 m of loose wooden blocks and soft mats, which \
                     differ in every trial; the largest height of the blocks varies. For falls, height is above the \
                     floor, and a leg that touches a block is no fall. The robot is across when its trunk has passed \
                     the far end, not a side; the trial ends a second later. The velocity error is the length of mean \
                     velocity minus command in the horizontal plane. Velocity error, peak foot force and power are \
                     those of the crossing, from the first edge to the last.",
            ..ExperimentInfo::new("E11a", 11, "rubble", "Wooden blocks and soft mats", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: RubbleScenario = defaults("rubble")?;
        Ok(conditions(&self.heights_m, |block_height_m| {
            let scenario = Scenario::Rubble(RubbleScenario { block_height_m: *block_height_m, ..base.clone() });
            (format!("blocks to {:.0} cm", 100.0 * block_height_m), scenario)
        }))
    }

    fn measure(&self, trial: &Trial) -> TrialValues {
        let Scenario::Rubble(rubble) = trial.scenario else { return TrialValues::default() };
        let crossing = Crossing::new(trial, rubble.distance_m, rubble.far_edge_m());
        vec![
            indicator(trial.is_upright()),
            indicator(crossing.is_across),
            crossing.times_s.and_then(|[from_s, to_s]| metrics::velocity_error(trial.trace, from_s, to_s)),
            crossing.peak_foot_force_n,
            crossing.power_w,
        ]
        .into()
    }

    fn report(&self, section: &mut SectionBuilder) {
        section.table("Over wooden blocks and soft mats, by the largest height of the blocks.");
        section.dots(
            "",
            "Success and velocity error among blocks and mats, by the largest height of the blocks",
            &["success", "crossed", "velocity_error_m_s"],
            "The velocity error is of trials that got across.",
        );
        for (quantity, words) in [("success", "stay on their feet more often"), ("crossed", "get across more often")] {
            let text = format!("Among wooden blocks and soft mats, compliant policies {words}");
            section.claim(&text, "superior", quantity, Higher, &section.all());
        }
    }
}
