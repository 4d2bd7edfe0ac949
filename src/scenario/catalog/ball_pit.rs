//! The scenario `ball-pit`: a field of loose balls (E7).

use std::fmt::Write as _;

use super::{ParameterError, Parameters, Task, truth};
use crate::scenario::metrics::Metric;
use crate::scenario::trace::Trace;
use crate::scenario::{Goal, Script};
use crate::sim::Buffers;

parameters! {
    /// Ball pit: cross a field of loose balls.
    BallPit {
        /// Number of balls, laid out in a square
        balls: u32 = 0.0 to 1000.0, "0 to 1000";
        /// Mass of a ball (kg)
        mass_kg: f64 = 1e-3 to 1e3, "0.001 to 1000 kg";
        /// Radius of a ball (m)
        radius_m: f64 = 0.01 to 0.5, "0.01 to 0.5 m";
        /// Gap between neighbours (m)
        gap_m: f64 = 0.0 to 10.0, "0 to 10 m";
        /// Distance from the robot's centre to the first row (m)
        distance_m: f64 = 0.4 to 100.0, "0.4 to 100 m, clear of the robot";
    }
}

impl BallPit {
    fn side(&self) -> u32 {
        f64::from(self.balls).sqrt().ceil() as u32
    }

    /// Returns the x coordinate of the last row's end, world frame \[m\].
    pub fn far_edge_m(&self) -> f64 {
        let pitch = 2.0 * self.radius_m + self.gap_m;
        self.distance_m + f64::from(self.side()) * pitch
    }
}

impl Parameters for BallPit {
    fn prepare(&self, script: &mut Script, _: u64) -> Result<(), ParameterError> {
        self.check_ranges()?;
        // MuJoCo 2.2.2 counts its memory in 32 bits: rows times degrees of freedom, 24 bytes each, must stay below 2 GiB.
        let (side, pitch) = (self.side(), 2.0 * self.radius_m + self.gap_m);
        let mut balls = String::new();
        for ball in 0..self.balls {
            let (row, column) = (ball / side, ball % side);
            let x = self.distance_m + (f64::from(row) + 0.5) * pitch;
            let y = (f64::from(column) - 0.5 * (f64::from(side) - 1.0)) * pitch;
            // A little damping stands for what keeps a real ball from rolling for ever: it halves a ball's speed in about a second, and is
            // far too small to affect a foot.
            let _ = writeln!(
                balls,
                r#"    <body name="ball_{ball}" pos="{x:.4} {y:.4} {radius}"><joint name="ball_{ball}" type="free" damping="0.001"/><geom name="ball_{ball}" type="sphere" size="{radius}" mass="{mass}" priority="1" friction="0.6 0.005 0.0001" rgba="{rgba}"/></body>"#,
                radius = self.radius_m,
                mass = self.mass_kg,
                rgba = ["0.90 0.62 0.00 1", "0.34 0.71 0.91 1", "0.00 0.62 0.45 1", "0.80 0.47 0.65 1"]
                    [(row + 2 * column) as usize % 4],
            );
        }
        script.goal = Some(Goal {
            from: None,
            ahead_m: self.far_edge_m(),
            // At least 0.5 m for a single ball.
            half_width_m: (0.5 * f64::from(side) * pitch).max(0.5),
            text: "got across the balls",
            is_end: true,
        });
        script.scene.obstacles = balls;
        // Conjugate gradients: Newton's method would need a stack of half a gigabyte.
        script.scene.solver = r#"solver="CG" iterations="20""#;
        // Every ball lies on the floor; half as many again touch one another in front of the robot. A full buffer is an error.
        let contacts = 300 + 3 * self.balls as usize / 2;
        script.scene.buffers = Buffers { contacts, rows: 4 * contacts, stack: 2_000_000 + 40_000 * side as usize };
        Ok(())
    }

    fn metrics(&self, _: &Script, trace: &Trace, found: &mut Vec<Metric>) {
        found.push(truth("crossed", "got across", Some(trace.reached_goal())));
    }

    /// Moves the balls away by the distance walked during the delay.
    fn delay(&mut self, phase_s: f64) {
        self.distance_m += phase_s * self.task.forward_m_s;
    }
}
