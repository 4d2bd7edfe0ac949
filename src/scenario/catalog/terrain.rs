//! The scenario `terrain`: Perlin noise, steps or a slope (E8).

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

use super::{ParameterError, Parameters, Task};
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

parameters! {
    /// Terrain: uneven ground.
    UnevenGround {
        /// Shape of the ground
        kind: TerrainKind;
        /// Perlin: peak to peak; steps: rise of each (m)
        height_m: f64 = 0.0 to 2.0, "0 to 2 m";
        /// Perlin: lattice cells per metre (1/m)
        frequency_per_m: f64 = 0.01 to 10.0, "0.01 to 10 per metre";
        /// Steps: length of each step (m)
        step_length_m: f64 = 0.1 to 10.0, "0.1 to 10 m";
        /// Steps: number of steps up, followed by as many down
        steps: u32 = 1.0 to 100.0, "1 to 100";
        /// Slope: incline, rise over run
        incline: f64 = -1.0 to 1.0, "-1 to 1";
    }
}

impl Parameters for UnevenGround {
    fn prepare(&self, script: &mut Script, seed: u64) -> Result<(), ParameterError> {
        self.check_ranges()?;
        let way = [self.task.forward_m_s, self.task.left_m_s].map(|speed| speed.abs() * self.task.duration_s);
        // A robot that turns may walk in any direction.
        let way = if self.task.yaw_rad_s == 0.0 { way } else { [way[0].hypot(way[1]); 2] };
        if way[0].max(way[1]) > LONGEST_WAY_M {
            let (found, expected) = (self.task.duration_s.to_string(), "a way of at most 30 m at the command");
            return Err(ParameterError { name: "duration-s".into(), found, expected });
        }
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
}
