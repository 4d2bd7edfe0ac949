//! The scenario `terrain`: Perlin noise, steps or a slope (E8).

use clap::{Args, ValueEnum};
use serde::{Deserialize, Serialize};

use super::{ParameterError, Parameters, Task, in_range};
use crate::scenario::Script;
use crate::sim::terrain;
use crate::sim::{Buffers, Ground};

/// Smallest half-length of height fields along x and y \[m\].
const LEAST_HALF_SIZE_M: [f64; 2] = [8.0, 4.0];
/// Longest way that the ground is made for, in either direction \[m\].
const LONGEST_WAY_M: f64 = 30.0;
/// Length of the ground beyond the end of the way \[m\].
const MARGIN_M: f64 = 3.0;

/// Kind of the terrain.
#[derive(ValueEnum, Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TerrainKind {
    /// Smooth hills of Perlin's gradient noise.
    Perlin,
    /// Steps up and down again.
    Steps,
    /// An incline that begins 1 m ahead.
    Slope,
}

/// Terrain: uneven ground.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct UnevenGround {
    /// The parameters that every scenario has.
    #[command(flatten)]
    #[serde(flatten)]
    pub task: Task,
    /// Shape of the ground
    #[arg(long, value_enum)]
    pub kind: TerrainKind,
    /// Perlin: peak to peak; steps: rise of each (m)
    #[arg(long)]
    pub height_m: f64,
    /// Perlin: lattice cells per metre (1/m)
    #[arg(long)]
    pub frequency_per_m: f64,
    /// Steps: length of each step (m)
    #[arg(long)]
    pub step_length_m: f64,
    /// Steps: number of steps up, followed by as many down
    #[arg(long)]
    pub steps: u32,
    /// Slope: incline, rise over run
    #[arg(long)]
    pub incline: f64,
}

impl Parameters for UnevenGround {
    fn prepare(&self, script: &mut Script, seed: u64) -> Result<(), ParameterError> {
        in_range("height-m", self.height_m, 0.0, 2.0, "0 to 2 m")?;
        in_range("frequency-per-m", self.frequency_per_m, 0.01, 10.0, "0.01 to 10 per metre")?;
        in_range("step-length-m", self.step_length_m, 0.1, 10.0, "0.1 to 10 m")?;
        in_range("steps", f64::from(self.steps), 1.0, 100.0, "1 to 100")?;
        in_range("incline", self.incline, -1.0, 1.0, "-1 to 1")?;
        let way = [self.task.forward_m_s, self.task.left_m_s].map(|speed| speed.abs() * self.task.duration_s);
        if way[0].max(way[1]) > LONGEST_WAY_M {
            let found = self.task.duration_s.to_string();
            return Err(ParameterError { name: "duration-s", found, expected: "a way of at most 30 m at the command" });
        }
        // A robot that turns may walk in any direction.
        let way = if self.task.yaw_rad_s == 0.0 { way } else { [way[0].hypot(way[1]); 2] };
        let half = [0, 1].map(|axis| LEAST_HALF_SIZE_M[axis].max(way[axis] + MARGIN_M));
        let field = match self.kind {
            TerrainKind::Perlin => terrain::perlin(half, self.height_m, self.frequency_per_m, seed),
            TerrainKind::Steps => terrain::steps(half, self.height_m, self.step_length_m, self.steps),
            TerrainKind::Slope => terrain::slope(half, self.incline),
        };
        script.scene.ground = Ground::Field(field.into());
        script.scene.buffers = Buffers { contacts: 200, rows: 900, stack: 200_000 };
        Ok(())
    }

    fn cost(&self) -> f64 {
        4.0
    }
}
