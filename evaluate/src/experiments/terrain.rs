//! E8: walking over Perlin terrain of several heights and frequencies (Fig. 7b).

use super::prelude::*;
use supple::scenario::catalog::{TerrainKind, UnevenGround};

const QUANTITIES: &[Quantity] = &[
    Quantity::new("success", "no fall in 10 s", "%", 0),
    Quantity::new("velocity_error_m_s", "velocity error", "m/s", 3),
    Quantity::new("peak_foot_force_n", "peak foot force", "N", 0),
    Quantity::new("power_w", "power", "W", 1),
];

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Terrain {
    /// The heights of the terrain, peak to peak \[m\].
    pub heights_m: Vec<f64>,
    /// The frequencies of the terrain: lattice cells per metre \[1/m\].
    pub frequencies_per_m: Vec<f64>,
    pub trials: u32,
}

impl Experiment for Terrain {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            paper: "Fig. 7b",
            method: "The robot walks at 0.5 m/s for 10 s over terrain of Perlin noise, which differs in every trial. \
                     Its height (peak to peak) and frequency (cells per metre) vary. A success is a trial without a \
                     fall. The velocity error is the length of mean velocity minus command in the horizontal plane.",
            ..ExperimentInfo::new("E8", 8, "terrain", "Uneven terrain", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: UnevenGround = defaults("terrain")?;
        Ok(conditions(pairs(&self.heights_m, &self.frequencies_per_m), |(height_m, frequency_per_m)| {
            let ground = UnevenGround { kind: TerrainKind::Perlin, height_m, frequency_per_m, ..base.clone() };
            (format!("{:.0} cm, {} /m", 100.0 * height_m, brief(frequency_per_m)), Scenario::Terrain(ground))
        }))
    }

    fn report(&self, section: &mut SectionBuilder) {
        section.table("Walking over Perlin terrain, by height (peak to peak) and frequency.");
        section.dots(
            "",
            "Success, velocity error and peak foot force by terrain",
            &["success", "velocity_error_m_s", "peak_foot_force_n"],
            "All numbers except success are of trials without a fall.",
        );
        let text = format!("On terrain of {}, compliant policies stay on their feet more often", section.first_label());
        section.claim(&text, "less often", "success", Higher, &[0]);
        let text = "Over all terrains, compliant policies stay on their feet more often";
        section.claim(text, "less often", "success", Higher, &section.all());
        let text = "Over all terrains, compliant policies have a lower peak foot force";
        section.claim(text, "lower", "peak_foot_force_n", Lower, &section.all());
    }
}
