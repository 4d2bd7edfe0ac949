/*! The uneven ground of training and its levels.

Each environment on it has one long field of either kind: tiles in a row along x, one for each level. The level of an
environment is the tile on whose centre its episode starts, so a level changes no model. The fields do not depend on the
run's seed.
*/

use std::array;

use rand::RngExt;
use serde::{Deserialize, Serialize};

use crate::config::{SPACING_M, TILE_M, Terrain};
use crate::observation::Command;
use crate::robot::RobotState;
use crate::sim::terrain::Perlin;
use crate::sim::{Buffers, HeightField};
use crate::util::random::{Purpose, stream};

/// Radius around each start that stays flat, and width of the transition from there \[m\].
const FLAT_M: [f64; 2] = [0.4, 0.4];

/// Number of bumps of rough ground in a metre.
const BUMPS_PER_M: f64 = 4.0;

/// Edge of a box \[m\].
const BOX_M: f64 = 0.42;

/// Distance from its lowest to its highest point of Perlin's noise, about.
const NOISE_RANGE: f64 = 1.4;

/// Part of the commanded way that raises the level, if the way is long enough.
const RAISING_PART: f64 = 0.7;

/// Shortest commanded way that raises the level \[m\].
const RAISING_WAY_M: f64 = 0.5;

/// MuJoCo's buffers for a robot on the field.
pub(super) const BUFFERS: Buffers = Buffers { contacts: 100, rows: 450, stack: 100_000 };

/// The kind of uneven ground.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum GroundKind {
    Rough,
    Boxes,
}

impl GroundKind {
    /// Both kinds, in the order of their numbers.
    pub(super) const ALL: [GroundKind; 2] = [GroundKind::Rough, GroundKind::Boxes];
}

/// Returns the kind of ground of environment `index`; `None` for a plane. Uneven ground is spread evenly over the
/// environments, whatever ranks they belong to.
pub(super) fn ground_kind(terrain: &Terrain, index: u64) -> Option<GroundKind> {
    let number = uneven(terrain, index);
    let kind = if number.is_multiple_of(2) { GroundKind::Rough } else { GroundKind::Boxes };
    (uneven(terrain, index + 1) > number).then_some(kind)
}

/// Returns how many of the first `count` environments have uneven ground.
pub(super) fn uneven(terrain: &Terrain, count: u64) -> u64 {
    (count as f64 * terrain.environments).floor() as u64
}

/// Returns the centre of a level's tile, where episodes start, world frame \[m\].
pub(super) fn start(terrain: &Terrain, level: usize) -> [f64; 2] {
    [TILE_M * (level as f64 - 0.5 * (terrain.levels - 1) as f64), 0.0]
}

/// Returns the height of the ground on a level \[m\].
fn height_m(terrain: &Terrain, kind: GroundKind, level: usize) -> f64 {
    let [first, last] = match kind {
        GroundKind::Rough => terrain.rough_m,
        GroundKind::Boxes => terrain.boxes_m,
    };
    first + (last - first) * level as f64 / (terrain.levels - 1).max(1) as f64
}

/// Builds the field of a kind, with all levels: the same one in every run. There is ground as far as `reach_m` around each
/// start, and a margin \[m\].
pub(super) fn field(terrain: &Terrain, kind: GroundKind, reach_m: f64) -> HeightField {
    let half_size = terrain.half_size_m(reach_m);
    let noise = Perlin::new(0);
    let counts = half_size.map(|half| (2.0 * half / BOX_M).ceil() as usize);
    let mut rng = stream(0, Purpose::Terrain, 1, 0);
    // Three fifths of the ground are low, a fifth is half as high, a fifth is high.
    let boxes: Vec<f64> =
        (0..counts[0] * counts[1]).map(|_| [0.0, 0.0, 0.0, 0.5, 1.0][rng.random_range(0..5_usize)]).collect();
    let shape = |x: f64, y: f64| match kind {
        GroundKind::Rough => noise.at(BUMPS_PER_M * x + 0.37, BUMPS_PER_M * y + 0.59) / NOISE_RANGE,
        GroundKind::Boxes => {
            let [column, row]: [usize; 2] = array::from_fn(|axis| {
                let place = ([x, y][axis] + half_size[axis]) / BOX_M;
                (place.max(0.0) as usize).min(counts[axis] - 1)
            });
            boxes[row * counts[0] + column]
        }
    };
    HeightField::sample(half_size, SPACING_M, |x, y| {
        let tile = (x / TILE_M + 0.5 * terrain.levels as f64).floor().clamp(0.0, (terrain.levels - 1) as f64);
        let level = tile as usize;
        let [start_x, start_y] = start(terrain, level);
        let away = ((x - start_x).hypot(y - start_y) - FLAT_M[0]) / FLAT_M[1];
        away.clamp(0.0, 1.0) * height_m(terrain, kind, level) * shape(x, y)
    })
}

/// The progress of an episode on uneven ground, and its level.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Course {
    /// Level of the episode.
    pub(super) level: usize,
    /// Way along the command \[m\].
    walked_m: f64,
    /// Way that was commanded \[m\].
    commanded_m: f64,
    /// True once the robot has fallen.
    fell: bool,
}

impl Course {
    /// Starts an episode on a level.
    pub(super) fn new(level: usize) -> Self {
        Course { level, walked_m: 0.0, commanded_m: 0.0, fell: false }
    }

    /// Counts a policy step of `period_s` \[s\].
    pub(super) fn advance(&mut self, state: &RobotState, command: &Command, period_s: f64, fell: bool) {
        let speed = command.forward.hypot(command.left);
        let velocity = state.velocity_in_base;
        if speed > 0.0 {
            self.walked_m += period_s * (velocity.x * command.forward + velocity.y * command.left) / speed;
        }
        self.commanded_m += period_s * speed;
        self.fell |= fell;
    }

    /// Returns the level of the next episode of `levels`: one less after a fall, one more if the robot has walked most of
    /// the commanded way.
    pub(super) fn next_level(&self, levels: usize) -> usize {
        if self.fell {
            self.level.saturating_sub(1)
        } else if self.commanded_m >= RAISING_WAY_M && self.walked_m >= RAISING_PART * self.commanded_m {
            (self.level + 1).min(levels - 1)
        } else {
            self.level
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::config::Config;
    use crate::sim::Ground;

    fn terrain() -> Terrain {
        Terrain { environments: 0.5, levels: 6, rough_m: [0.01, 0.06], boxes_m: [0.02, 0.08], sharpness_factor: 0.33 }
    }

    #[test]
    fn half_of_the_environments_have_either_kind_in_turn() {
        let kinds = |environments: f64| -> Vec<Option<GroundKind>> {
            let terrain = Terrain { environments, ..terrain() };
            (0..8).map(|index| ground_kind(&terrain, index)).collect()
        };
        let [rough, boxes] = [Some(GroundKind::Rough), Some(GroundKind::Boxes)];
        assert_eq!(kinds(0.5), [None, rough, None, boxes, None, rough, None, boxes]);
        assert_eq!(kinds(0.0), [None; 8]);
        assert_eq!(kinds(1.0), [rough, boxes, rough, boxes, rough, boxes, rough, boxes]);
    }

    #[test]
    fn ground_is_as_high_as_its_level_and_flat_at_the_start() {
        let terrain = terrain();
        for (kind, [first, last]) in [(GroundKind::Rough, terrain.rough_m), (GroundKind::Boxes, terrain.boxes_m)] {
            let ground = Ground::Field(field(&terrain, kind, 5.0).into());
            for level in 0..6 {
                let [x, y] = start(&terrain, level);
                let on_tile = (0..6400).map(|k| {
                    let at = |index: usize| 0.09 * index as f64 - 3.6;
                    ground.height(x + at(k % 80), y + at(k / 80))
                });
                let [low, high] = on_tile.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], z| [a.min(z), b.max(z)]);
                let expected = first + (last - first) * level as f64 / 5.0;
                assert!((0.75..=1.01).contains(&((high - low) / expected)), "{kind:?} {level}: {}", high - low);
                assert!(ground.height(x + 0.2, y - 0.2).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn ground_reaches_as_far_as_an_episode_and_a_margin() {
        // 2 + 1 + 3 s at 1 and 0.5 m/s: 6.71 m around starts at ±20 m.
        let config = Config::load("real").unwrap();
        let [x, y] = field(&terrain(), GroundKind::Rough, config.reach_m()).half_size;
        assert!((x - 27.708).abs() < 1e-3 && (y - 7.708).abs() < 1e-3, "{x} {y}");
    }

    #[test]
    fn levels_rise_with_the_way_and_fall_with_the_robot() {
        let walk = |forward: f64, fell: bool| {
            let mut course = Course::new(3);
            let state = RobotState { velocity_in_base: Vector3::new(forward, 0.3, 0.0), ..RobotState::default() };
            for step in 0..60 {
                course.advance(&state, &Command::velocity(0.8, 0.0, 0.0), 1.0 / 60.0, fell && step == 59);
            }
            course.next_level(6)
        };
        // 0.8 m are commanded in a second; 0.7 of them are 0.56 m.
        assert_eq!((walk(0.57, false), walk(0.55, false), walk(-0.5, false), walk(0.8, true)), (4, 3, 3, 2));
        assert_eq!((Course { fell: true, ..Course::new(0) }.next_level(6), Course::new(5).next_level(6)), (0, 5));
        let done = Course { walked_m: 2.0, commanded_m: 2.0, ..Course::new(5) };
        assert_eq!(done.next_level(6), 5);
    }
}
