/*! Hills of varied friction (E11).

The hills are one octave of Perlin noise, wide and smooth, scaled so that the steepest triangle of the height field has
exactly the wanted slope. The ground is divided into squares, each with a friction of its own; each foot carries the
friction of the square that it is on, looked up at every physics step.
*/

use clap::Args;
use rand::RngExt;
use serde::{Deserialize, Serialize};

use super::{ParameterError, Parameters, Task, in_range, metric};
use crate::random::{Purpose, stream};
use crate::scenario::metrics::{self, Metric};
use crate::scenario::{Script, terrain};
use crate::scene::{Buffers, Ground, Patches};
use crate::trace::{Frame, Trace};

/// Least and largest half-length of the ground \[m\].
const HALF_SIZE_M: [f64; 2] = [6.0, 60.0];

/// Ground beyond where the command leads to \[m\].
const MARGIN_M: f64 = 3.0;

/// Outdoor: hills of varied friction.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Outdoor {
    #[command(flatten)]
    #[serde(flatten)]
    #[allow(missing_docs)]
    pub task: Task,
    /// Steepest slope of the hills, rise over run
    #[arg(long)]
    pub steepest: f64,
    /// Lattice cells of the hills per metre; a hill and a dale take about two cells (1/m)
    #[arg(long)]
    pub frequency_per_m: f64,
    /// Least sliding friction of a square of ground
    #[arg(long)]
    pub least_friction: f64,
    /// Largest sliding friction of a square of ground
    #[arg(long)]
    pub largest_friction: f64,
    /// Edge of the squares that differ in friction (m)
    #[arg(long)]
    pub patch_m: f64,
}

impl Outdoor {
    /// As far as the command leads, and a margin.
    fn half_size_m(&self) -> f64 {
        let way_m = self.task.forward_m_s.hypot(self.task.left_m_s) * self.task.duration_s;
        (way_m + MARGIN_M).clamp(HALF_SIZE_M[0], HALF_SIZE_M[1])
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
    fn task(&self) -> &Task {
        &self.task
    }

    fn prepare(&self, script: &mut Script, seed: u64) -> Result<(), ParameterError> {
        in_range("steepest", self.steepest, 0.0, 2.0, "0 to 2")?;
        in_range("frequency-per-m", self.frequency_per_m, 0.01, 1.0, "0.01 to 1 per metre")?;
        in_range("least-friction", self.least_friction, 0.01, 10.0, "0.01 to 10")?;
        let most = "the least friction to 10";
        in_range("largest-friction", self.largest_friction, self.least_friction, 10.0, most)?;
        in_range("patch-m", self.patch_m, 0.1, 100.0, "0.1 to 100 m")?;
        let half_size = [self.half_size_m(); 2];
        let mut hills = terrain::hills(half_size, self.steepest, self.frequency_per_m, seed);
        hills.friction = Some(self.patches(seed));
        script.scene.ground = Ground::Field(hills);
        script.scene.buffers = Buffers { contacts: 200, rows: 900, stack: 200_000 };
        Ok(())
    }

    fn metrics(&self, script: &Script, trace: &Trace, found: &mut Vec<Metric>) {
        let ground = |frame: &Frame| script.scene.ground.height(frame.position[0], frame.position[1]);
        let frames = || trace.frames.iter();
        let climbed = metrics::largest(frames(), ground).zip(metrics::largest(frames(), |frame| -ground(frame)));
        found.push(metric("climb_m", "highest above lowest ground", climbed.map(|(high, low)| high + low), "m"));
    }
}
