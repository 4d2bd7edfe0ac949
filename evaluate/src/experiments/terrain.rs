//! E8: walking over Perlin terrain of several heights and frequencies (Fig. 7b).

use super::prelude::*;
use supple::scenario::catalog::{TerrainKind, UnevenGround};

const QUANTITIES: &[Quantity] = &[
    Quantity::new("success", "no fall in 10 s", "%", 0),
    Quantity::new("velocity_error_m_s", "velocity error", "m/s", 3),
    Quantity::new("peak_foot_force_n", "peak foot force", "N", 0),
    Quantity::new("power_w", "power", "W", 1),
];

/// The experiment's section of the protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Terrain {
    /// The heights of the terrain, peak to peak \[m\].
    pub heights_m: Vec<f64>,
    /// The frequencies of the terrain: lattice cells per metre \[1/m\].
    pub frequencies_per_m: Vec<f64>,
    /// The number of trials of each policy on each terrain.
    pub trials: u32,
}

impl Experiment for Terrain {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            id: "E8",
            number: 8,
            name: "terrain",
            title: "Uneven terrain",
            paper: "Fig. 7b",
            method: "At 0.5 m/s for 10 s over terrain of Perlin noise, another one in every trial, by its height from \
                     peak to peak and its frequency (cells per metre). A success is a trial without a fall. The \
                     velocity error is the length of mean velocity minus command in the horizontal plane.",
            quantities: QUANTITIES,
            trials: self.trials,
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: UnevenGround = defaults("terrain")?;
        let condition = |height_m: f64, frequency_per_m: f64| Condition {
            label: format!("{:.0} cm, {} /m", 100.0 * height_m, brief(frequency_per_m)),
            scenario: Scenario::Terrain(UnevenGround {
                kind: TerrainKind::Perlin,
                height_m,
                frequency_per_m,
                ..base.clone()
            }),
        };
        let frequencies = &self.frequencies_per_m;
        let heights = self.heights_m.iter();
        Ok(heights.flat_map(|height| frequencies.iter().map(|frequency| condition(*height, *frequency))).collect())
    }

    fn measure(&self, trial: &Trial) -> TrialValues {
        vec![
            indicator(trial.is_upright()),
            trial.velocity_error(),
            trial.upright_metric("peak_foot_force_n"),
            trial.upright_metric("power_w"),
        ]
        .into()
    }

    fn report(&self, section: &mut SectionBuilder) {
        section.table("Walking over Perlin terrain, by height (peak to peak) and frequency.");
        section.dots(
            "",
            "Success, velocity error and peak foot force by terrain",
            &["success", "velocity_error_m_s", "peak_foot_force_n"],
            "Numbers but success are of trials without a fall.",
        );
        let (all, first) = (section.all(), section.first_label());
        for (text, over) in [
            (format!("On terrain of {first}, compliant policies fall less often"), &[0][..]),
            ("Over all terrains, compliant policies fall less often".to_owned(), &all),
        ] {
            section.claim(&text, "less often", "success", Expected::Higher, over);
        }
        let text = "Over all terrains, compliant policies have a lower peak foot force";
        section.claim(text, "lower", "peak_foot_force_n", Expected::Lower, &all);
    }
}
