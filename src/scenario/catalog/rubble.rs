/*! The scenario `rubble`: wooden blocks and soft mats on the way (E11).

Blocks are free bodies: a foot can stand on one, tip it or push it away. So are mats, which give under a foot by a soft
contact. (Fixed to the floor they would hold a foot that runs into their edge and sinks into it.)

The floor alone is the ground. Height is measured from the floor, so that a robot on a block is higher, and one that
lies on a mat or on blocks is below 0.2 m and has fallen. A leg that brushes a block or the edge of a mat is no fall, as
with the box and the balls.
*/

use rand::RngExt;

use super::{ParameterError, Parameters, Task, metric, truth};
use crate::scenario::metrics::{self, Metric};
use crate::scenario::trace::Trace;
use crate::scenario::{Goal, Script};
use crate::sim::Buffers;
use crate::util::random::{Purpose, stream};

/// Material of the blocks. Density of dry beech, spruce is lighter and oak heavier [kg/m³].
const WOOD: &str = r#"density="650" priority="1" friction="0.5 0.005 0.0001""#;

/// Edge of a mat \[m\].
const MAT_EDGE_M: f64 = 0.7;

/// Material of the mats. Density of the composite foam of gymnastics mats, 1.5 kg each [kg/m³]. Softness: a standing Go1 carries some 21 N
/// on each front foot and 42 N on each rear foot, and they sink in by 9 and 13 mm (into the floor by 1 mm). A small hard ball sinks about
/// as far into a gymnastics mat of foam under the same forces. The impedance grows over 2 cm as foam hardens; a damping ratio of 1 keeps
/// the mat from throwing the foot back. Found by trying: MuJoCo's softness depends on the masses that meet.
const FOAM: &str = r#"density="100" priority="2" friction="0.8 0.005 0.0001" solref="0.03 1" solimp="0.8 0.95 0.02" rgba="0.16 0.42 0.60 1""#;

/// Gap between neighbours, so that none are in contact at the start \[m\].
const GAP_M: f64 = 0.01;

/// Maximum number of draws for a piece before the layout is discarded.
const MOST_DRAWS: u32 = 200;

/// Maximum number of layouts before an error is returned.
const MOST_LAYOUTS: u32 = 100;

parameters! {
    /// Rubble: wooden blocks and soft mats on the way.
    Rubble {
        /// Number of wooden blocks
        blocks: u32 = 0.0 to 100.0, "0 to 100";
        /// Largest edge of a block seen from above; the smallest is half of it (m)
        block_edge_m: f64 = 0.02 to 0.5, "0.02 to 0.5 m";
        /// Largest height of a block; the smallest is half of it (m)
        block_height_m: f64 = 0.01 to 0.5, "0.01 to 0.5 m";
        /// Number of soft mats, squares of 0.7 m
        mats: u32 = 0.0 to 50.0, "0 to 50";
        /// Thickness of a mat (m)
        mat_height_m: f64 = 0.01 to 0.5, "0.01 to 0.5 m";
        /// Distance from the robot's centre to where the rubble begins (m)
        distance_m: f64 = 0.4 to 100.0, "0.4 to 100 m, clear of the robot";
        /// Length of the rubble along the way (m)
        length_m: f64 = 1.0 to 100.0, "1 to 100 m";
        /// Width of the rubble across the way (m)
        width_m: f64 = 1.0 to 100.0, "1 to 100 m";
    }
}

/// A block or a mat.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Piece {
    /// Centre, seen from above, world frame \[m\].
    centre: [f64; 2],
    /// Half-lengths along the piece's axes \[m\].
    half: [f64; 3],
    /// Rotation about the vertical \[rad\].
    yaw: f64,
}

impl Piece {
    /// Returns the radius of the circle around the piece, seen from above \[m\].
    fn radius(&self) -> f64 {
        self.half[0].hypot(self.half[1])
    }

    /// Returns the MJCF of the piece as a free body.
    fn body(&self, name: &str, material: &str) -> String {
        let Piece { centre: [x, y], half: [a, b, c], yaw } = self;
        let turned = about_up(*yaw);
        format!(
            r#"    <body name="{name}" pos="{x:.4} {y:.4} {c:.5}" quat="{turned}"><freejoint name="{name}"/><geom name="{name}" type="box" size="{a:.5} {b:.5} {c:.5}" {material}/></body>
"#
        )
    }

    fn is_clear_of(&self, other: &Piece) -> bool {
        let apart = (self.centre[0] - other.centre[0]).hypot(self.centre[1] - other.centre[1]);
        apart > self.radius() + other.radius() + GAP_M
    }
}

impl Rubble {
    /// Returns the x coordinate of the rubble's end, world frame \[m\].
    pub fn far_edge_m(&self) -> f64 {
        self.distance_m + self.length_m
    }

    /// Draws mats and blocks that do not touch each other.
    fn pieces(&self, seed: u64) -> Result<(Vec<Piece>, Vec<Piece>), ParameterError> {
        let mut rng = stream(seed, Purpose::Terrain, 1, 0);
        // The first pieces may leave no place for the others: then all are laid out anew.
        let laid_out = (0..MOST_LAYOUTS).find_map(|_| self.lay_out(&mut rng));
        let mut mats = laid_out.ok_or(ParameterError {
            name: "blocks".into(),
            found: format!("{} with {} mats", self.blocks, self.mats),
            expected: "fewer of them, or a larger --length-m or --width-m: they do not fit side by side",
        })?;
        let blocks = mats.split_off(self.mats as usize);
        Ok((mats, blocks))
    }

    /// Draws one layout; `None` if a piece finds no place.
    fn lay_out(&self, rng: &mut impl RngExt) -> Option<Vec<Piece>> {
        let mut all: Vec<Piece> = Vec::new();
        for index in 0..self.mats + self.blocks {
            let mut draws = (0..MOST_DRAWS).map(|_| self.draw(index < self.mats, rng));
            let piece = draws.find(|piece| all.iter().all(|other| piece.is_clear_of(other)))?;
            all.push(piece);
        }
        Some(all)
    }

    /// Draws the size and the place of a mat or a block.
    fn draw(&self, is_mat: bool, rng: &mut impl RngExt) -> Piece {
        let mut between = |low: f64, high: f64| if low < high { rng.random_range(low..high) } else { low };
        let half = if is_mat {
            [0.5 * MAT_EDGE_M, 0.5 * MAT_EDGE_M, 0.5 * self.mat_height_m]
        } else {
            let mut edge = |largest: f64| 0.5 * between(0.5 * largest, largest);
            [edge(self.block_edge_m), edge(self.block_edge_m), edge(self.block_height_m)]
        };
        let margin = f64::hypot(half[0], half[1]);
        let (near, far) = (self.distance_m + margin, self.far_edge_m() - margin);
        let side = 0.5 * self.width_m - margin;
        let centre = [between(near, far), between(-side, side)];
        Piece { centre, half, yaw: between(0.0, std::f64::consts::PI) }
    }
}

impl Parameters for Rubble {
    fn prepare(&self, script: &mut Script, seed: u64) -> Result<(), ParameterError> {
        self.check_ranges()?;
        let (mats, blocks) = self.pieces(seed)?;
        let mut obstacles = String::new();
        for (index, mat) in mats.iter().enumerate() {
            obstacles += &mat.body(&format!("mat_{index}"), FOAM);
        }
        for (index, block) in blocks.iter().enumerate() {
            let rgba = ["0.76 0.57 0.36 1", "0.66 0.47 0.28 1", "0.82 0.66 0.46 1"][index % 3];
            obstacles += &block.body(&format!("block_{index}"), &format!("{WOOD} rgba=\"{rgba}\""));
        }
        script.scene.obstacles = obstacles;
        // Up to eight points of a block on the floor and its neighbours.
        let contacts = 100 + 12 * self.blocks as usize;
        script.scene.solver = r#"solver="CG" iterations="30""#;
        script.scene.buffers =
            Buffers { contacts, rows: 4 * contacts, stack: 2_000_000 + 100_000 * self.blocks as usize };
        let (ahead_m, half_width_m) = (self.far_edge_m(), 0.5 * self.width_m);
        script.goal = Some(Goal { from: None, ahead_m, half_width_m, text: "got across the rubble", is_end: true });
        Ok(())
    }

    fn metrics(&self, _: &Script, trace: &Trace, found: &mut Vec<Metric>) {
        found.push(truth("crossed", "got across", Some(trace.reached_goal())));
        let peak = metrics::largest(trace.frames.iter(), |frame| frame.peak_obstacle_force_n);
        found.push(metric("peak_contact_force_n", "peak force on blocks and mats", peak, "N"));
    }

    /// Moves the rubble away by the distance walked during the delay.
    fn delay(&mut self, phase_s: f64) {
        self.distance_m += phase_s * self.task.forward_m_s;
    }
}

/// Formats a rotation about the up axis as MJCF's `quat`, because the unit of MJCF's angles depends on the robot's
/// file.
fn about_up(yaw: f64) -> String {
    let (sin, cos) = (0.5 * yaw).sin_cos();
    format!("{cos:.6} 0 0 {sin:.6}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::catalog::defaults;

    #[test]
    fn no_piece_touches_another_or_lies_under_the_robot_and_the_seed_decides() {
        let rubble: Rubble = defaults("rubble").unwrap();
        let (mats, blocks) = rubble.pieces(5).unwrap();
        assert_eq!((mats.len(), blocks.len()), (rubble.mats as usize, rubble.blocks as usize));
        let all: Vec<Piece> = mats.iter().chain(&blocks).copied().collect();
        for (index, piece) in all.iter().enumerate() {
            assert!(all[..index].iter().all(|other| piece.is_clear_of(other)), "{index}");
            // The head of a standing robot reaches 0.29 m ahead, its feet about 0.25 m.
            assert!(piece.centre[0] - piece.radius() >= rubble.distance_m && rubble.distance_m > 0.35);
        }
        assert_eq!(rubble.pieces(5).unwrap(), (mats, blocks));
        assert_ne!(rubble.pieces(5).unwrap(), rubble.pieces(6).unwrap());
        // No seed leaves the rubble of the experiments without a place.
        assert!((0..300).all(|seed| rubble.pieces(seed).is_ok()));
    }

    #[test]
    fn more_than_fits_is_refused() {
        let rubble = Rubble { blocks: 200, width_m: 1.0, length_m: 1.0, mats: 0, ..defaults("rubble").unwrap() };
        let error = rubble.pieces(0).unwrap_err().to_string();
        assert!(error.starts_with("--blocks is 200 with 0 mats, expected fewer"), "{error}");
    }

    #[test]
    fn feet_sink_into_a_mat_by_about_a_centimetre_and_hardly_into_the_floor() {
        use crate::config::Config;
        use crate::robot::Robot;
        use crate::robot::same_in_every_leg;
        use crate::sim::{Conditions, Scene, Sim};
        let config = Config::load("compliant").unwrap();
        let sunk_m = |obstacle: String, top_m: f64| {
            let buffers = Buffers { contacts: 64, rows: 400, stack: 100_000 };
            let timestep_s = config.simulation.timestep_s();
            let scene = Scene { obstacles: obstacle, buffers, ..Scene::flat(Robot::load("go1").unwrap(), timestep_s) };
            let mut sim = Sim::new(&scene, &config.simulation, 0.1).unwrap();
            let target = same_in_every_leg([0.0, 0.72, -1.44]);
            let conditions = Conditions { gravity: [0.0, 0.0, -9.81], friction: 0.8, encoder_bias: [0.0; 12] };
            sim.reset(conditions, &target).unwrap();
            sim.data_mut().positions_mut()[2] += top_m;
            sim.refresh().unwrap();
            for _ in 0..120 {
                sim.step(&target, &mut ()).unwrap();
            }
            sim.state().feet.map(|foot| top_m - foot.height)
        };
        let mat = Piece { centre: [0.0; 2], half: [0.35, 0.35, 0.015], yaw: 0.0 };
        let (floor, mat) = (sunk_m(String::new(), 0.0), sunk_m(mat.body("mat", FOAM), 0.03));
        assert!(floor.iter().all(|sunk| *sunk < 0.002), "{floor:?}");
        assert!(mat.iter().all(|sunk| *sunk > 0.006 && *sunk < 0.018), "{mat:?}");
    }
}
