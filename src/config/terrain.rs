//! The size of uneven ground, which follows from its levels and from how far episodes lead.

use garde::Validate;
use serde::{Deserialize, Serialize};

use super::check::{low_and_high, within};
use super::{Config, ValueError};
use crate::util::numbers::maximum;

/// Edge of a tile, of which each level has one \[m\].
pub(crate) const TILE_M: f64 = 8.0;

/// Distance between the points of the field \[m\]: finer ones cost more contacts to look for.
pub(crate) const SPACING_M: f64 = 0.08;

/// Ground beyond the farthest place that an episode reaches as commanded \[m\], for pushes and pulls.
const MARGIN_M: f64 = 1.0;

/// Longest ground \[m\]: 4000 points, of the 4096 that MuJoCo may be asked for.
const LONGEST_M: f64 = 4000.0 * SPACING_M;

/// Uneven ground in training, whose levels rise with what a robot walks and fall when it falls; not in the paper.
///
/// Every second environment on it has rough ground, every other one boxes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct Terrain {
    /// Fraction of the environments with uneven ground; the others have a plane.
    #[garde(custom(within(0.0..=1.0, "")))]
    pub environments: f64,
    /// Number of levels.
    #[garde(custom(within(1..=20, "")))]
    pub levels: usize,
    /// Height of rough ground from its lowest to its highest point on the first and on the last level \[m\].
    #[garde(custom(low_and_high))]
    pub rough_m: [f64; 2],
    /// Height of the highest boxes on the first and on the last level \[m\].
    #[garde(custom(low_and_high))]
    pub boxes_m: [f64; 2],
    /// Factor of `reward.tracking_sharpness` on uneven ground: below 1, tracking errors cost less there.
    #[garde(custom(within(0.0..=1.0, "")))]
    pub sharpness_factor: f64,
}

impl Terrain {
    /// Returns half of the ground's length along x and y \[m\]: there is ground as far as `reach_m` \[m\] around each start, and a
    /// margin.
    pub(crate) fn half_size_m(&self, reach_m: f64) -> [f64; 2] {
        let half_m = MARGIN_M + maximum(reach_m, 0.5 * TILE_M);
        [0.5 * TILE_M * (self.levels - 1) as f64 + half_m, half_m]
    }
}

impl Config {
    /// Returns how far from its start an episode leads a robot that walks as commanded \[m\].
    pub(crate) fn reach_m(&self) -> f64 {
        let (episode, command) = (&self.episode, &self.command);
        command.forward_m_s.hypot(command.left_m_s) * (episode.walking_s + episode.recovery_s + episode.post_recovery_s)
    }

    /// Refuses episodes that lead farther than there can be uneven ground.
    pub(super) fn check_terrain(&self) -> Result<(), ValueError> {
        let Some(terrain) = &self.terrain else { return Ok(()) };
        let length_m = 2.0 * terrain.half_size_m(self.reach_m())[0];
        if length_m <= LONGEST_M {
            return Ok(());
        }
        let problem = format!(
            "would be {length_m:.1e} m long to reach as far as episodes lead, expected at most {LONGEST_M:.0} m: lower \
             episode.walking_s, episode.recovery_s, episode.post_recovery_s, command.forward_m_s or command.left_m_s"
        );
        Err(ValueError::Range { key: "terrain".to_owned(), problem })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn episodes_that_lead_beyond_any_ground_are_refused_by_their_keys() {
        let heights = "rough_m: [0.01, 0.06], boxes_m: [0.02, 0.08]";
        let terrain = format!("terrain={{environments: 0.5, levels: 6, {heights}, sharpness_factor: 0.5}}");
        let with = |change: &str| Config::load_with("real", &[terrain.clone(), change.to_owned()]);
        // (120 + 1 + 3) s at 1 and 0.5 m/s: 138.6 m around starts at ±20 m, and a margin of 1 m.
        assert!(with("episode.walking_s=120").is_ok());
        for (change, length) in [
            ("episode.walking_s=121", "3.2e2"),
            ("episode.walking_s=3600", "8.1e3"),
            // (10 + 1 + 3) s at 100 m/s, twice, and ±20 m.
            ("command.forward_m_s=100", "1.2e3"),
            ("command.left_m_s=99", "1.2e3"),
        ] {
            let error = with(change).unwrap_err().to_string();
            assert!(error.contains(&format!("terrain would be {length} m long")), "{error}");
            assert!(error.contains("lower episode.walking_s") && error.contains("command.forward_m_s"), "{error}");
        }
    }
}
