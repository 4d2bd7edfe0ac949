/*! The scenario `outdoor`: hills of varied friction (E11).

The hills are one octave of Perlin noise, wide and smooth, scaled so that the steepest triangle of the height field has
exactly the wanted slope. The ground is divided into squares, each with a friction of its own; each foot carries the
friction of the square that it is on, looked up at every physics step.
*/

use rand::RngExt;

use super::{ParameterError, Parameters, Task, in_range, metric};
use crate::scenario::Script;
use crate::scenario::metrics::{self, Metric};
use crate::scenario::trace::{Frame, Trace};
use crate::sim::terrain;
use crate::sim::{Buffers, Ground, Patches};
use crate::util::random::{Purpose, stream};

/// Smallest and largest half-length of the ground \[m\].
const HALF_SIZE_M: [f64; 2] = [6.0, 60.0];

/// Width of the ground beyond the end of the commanded way \[m\].
const MARGIN_M: f64 = 3.0;

parameters! {
    /// Outdoor: hills of varied friction.
    Outdoor {
        /// Steepest slope of the hills, rise over run
        steepest: f64 = 0.0 to 2.0, "0 to 2";
        /// Lattice cells of the hills per metre; a hill and a dale take about two cells (1/m)
        frequency_per_m: f64 = 0.01 to 1.0, "0.01 to 1 per metre";
        /// Smallest sliding friction of a square of ground
        least_friction: f64 = 0.01 to 10.0, "0.01 to 10";
        /// Largest sliding friction of a square of ground
        largest_friction: f64;
        /// Edge of the squares that differ in friction (m)
        patch_m: f64 = 0.1 to 100.0, "0.1 to 100 m";
    }
}

impl Outdoor {
    /// Returns the length of the commanded way \[m\].
    fn way_m(&self) -> f64 {
        self.task.forward_m_s.hypot(self.task.left_m_s) * self.task.duration_s
    }

    /// Returns the half-length of the ground: the commanded way and a margin, within limits \[m\].
    fn half_size_m(&self) -> f64 {
        (self.way_m() + MARGIN_M).clamp(HALF_SIZE_M[0], HALF_SIZE_M[1])
    }

    fn patches(&self, seed: u64) -> Patches {
        let columns = (2.0 * self.half_size_m() / self.patch_m).ceil() as usize;
        let mut rng = stream(seed, Purpose::Terrain, 1, 1);
        let friction = || rng.random_range(self.least_friction..=self.largest_friction);
        let friction = std::iter::repeat_with(friction).take(columns * columns).collect();
        Patches { edge_m: self.patch_m, columns, friction }
    }
}

impl Parameters for Outdoor {
    fn prepare(&self, script: &mut Script, seed: u64) -> Result<(), ParameterError> {
        self.check_ranges()?;
        let most = "the least friction to 10";
        in_range("largest-friction", self.largest_friction, self.least_friction, 10.0, most)?;
        if self.way_m() > HALF_SIZE_M[1] - MARGIN_M {
            let (found, expected) = (self.task.duration_s.to_string(), "a way of at most 57 m at the command");
            return Err(ParameterError { name: "duration-s".into(), found, expected });
        }
        let half_size = [self.half_size_m(); 2];
        let mut hills = terrain::hills(half_size, self.steepest, self.frequency_per_m, seed);
        hills.friction = Some(self.patches(seed));
        script.scene.ground = Ground::Field(hills.into());
        script.scene.buffers = Buffers { contacts: 200, rows: 900, stack: 200_000 };
        Ok(())
    }

    fn metrics(&self, script: &Script, trace: &Trace, found: &mut Vec<Metric>) {
        let ground = |frame: &Frame| script.scene.ground.height(frame.position[0], frame.position[1]);
        let frames = || trace.frames.iter();
        let climbed = metrics::largest(frames(), ground).zip(metrics::largest(frames(), |frame| -ground(frame)));
        let steepest = metrics::largest(frames(), |frame| 100.0 * slope(&script.scene.ground, frame.position));
        found.push(metric("steepest_met_percent", "steepest slope on the way", steepest, "%"));
        found.push(metric("climb_m", "highest above lowest ground", climbed.map(|(high, low)| high + low), "m"));
    }
}

/// Returns the slope of the ground at a place, rise over run, over the length of the robot.
fn slope(ground: &Ground, [x, y, _]: [f64; 3]) -> f64 {
    let half_m = 0.2;
    let along_x = ground.height(x + half_m, y) - ground.height(x - half_m, y);
    let along_y = ground.height(x, y + half_m) - ground.height(x, y - half_m);
    along_x.hypot(along_y) / (2.0 * half_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::robot::same_in_every_leg;
    use crate::scenario::catalog::{Scenario, defaults};
    use crate::sim::Sim;

    /// Returns the mean distance that the feet of a standing robot slide in half a second after a push of 0.5 m/s to
    /// the left \[m\].
    fn slide_m(friction: f64) -> f64 {
        let config = Config::load("compliant").unwrap();
        let outdoor: Outdoor = defaults("outdoor").unwrap();
        let outdoor =
            Outdoor { steepest: 0.0, least_friction: friction, largest_friction: friction, patch_m: 0.5, ..outdoor };
        let script = Scenario::Outdoor(outdoor).script(0, &config).unwrap();
        let mut sim = Sim::new(&script.scene, &config.simulation, 0.1).unwrap();
        let target = same_in_every_leg([0.0, 0.72, -1.44]);
        sim.reset(script.conditions, &target).unwrap();
        sim.push([0.0, 0.5], [0.0; 3]).unwrap();
        let middle = |sim: &Sim| {
            let feet = sim.parts().feet();
            feet.iter().map(|foot| sim.data().geom_positions()[3 * foot + 1]).sum::<f64>() / feet.len() as f64
        };
        let start = middle(&sim);
        for _ in 0..30 {
            sim.step(&target, &mut ()).unwrap();
        }
        middle(&sim) - start
    }

    #[test]
    fn feet_feel_the_friction_of_their_own_square() {
        // The ground's own friction is 0.8 in both.
        let (slippery, rough) = (slide_m(0.02), slide_m(1.0));
        assert!(slippery > 3.0 * rough.abs(), "{slippery} {rough}");
    }

    #[test]
    fn squares_cover_the_ground_with_frictions_in_range() {
        let outdoor: Outdoor = defaults("outdoor").unwrap();
        let patches = outdoor.patches(1);
        assert!(patches.columns as f64 * patches.edge_m >= 2.0 * outdoor.half_size_m());
        assert_eq!(patches.friction.len(), patches.columns * patches.columns);
        let [low, high] = [0.4, 1.0];
        assert!(patches.friction.iter().all(|friction| (low..=high).contains(friction)));
        assert!(patches.friction.iter().any(|f| *f < low + 0.1) && patches.friction.iter().any(|f| *f > high - 0.1));
    }
}
