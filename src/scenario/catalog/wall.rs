//! The scenario `wall`: a soft wall across the course (E14).

use super::{ParameterError, Parameters, Task, metric};
use crate::scenario::Script;
use crate::scenario::metrics::{self, Metric};
use crate::scenario::trace::{Frame, SpringState, Trace};
use crate::world::disturbance::{Disturbance, Spring, SpringEnd};

/// Duration of the first impact \[s\].
const BLOW_S: f64 = 1.0;

parameters! {
    /// Wall: walk into a soft wall.
    Wall {
        /// Distance from the start at which the wall begins to press on the trunk's centre of mass (m)
        distance_m: f64 = 0.0 to 100.0, "0 to 100 m";
        /// Stiffness of the wall (N/m)
        stiffness_n_per_m: f64 = 1.0 to 20_000.0, "1 to 20000 N/m";
        /// Damping of the wall (N s/m)
        damping_n_s_per_m: f64 = 0.0 to 500.0, "0 to 500 N s/m";
    }
}

impl Parameters for Wall {
    fn prepare(&self, script: &mut Script, _: u64) -> Result<(), ParameterError> {
        self.check_ranges()?;
        let Wall { distance_m: gap_m, stiffness_n_per_m, damping_n_s_per_m, .. } = *self;
        let (end, from_s, direction, speed_m_s) = (SpringEnd::Wall, 0.0, [-1.0, 0.0], 0.0);
        let wall = Spring { end, from_s, direction, speed_m_s, gap_m, stiffness_n_per_m, damping_n_s_per_m };
        script.disturbances.push(Disturbance::Spring(wall));
        Ok(())
    }

    fn metrics(&self, _: &Script, trace: &Trace, found: &mut Vec<Metric>) {
        let spring = |frame: &Frame| frame.spring.unwrap_or_default();
        let met = trace.frames.iter().find(|frame| spring(frame).peak_force_n > 0.0);
        let met_s = met.map(|frame| frame.time_s - trace.period_s);
        let last_s = trace.frames.last().map_or(0.0, |frame| frame.time_s);
        // Forces on a fallen robot do not count.
        let end_s = trace.fall().map_or(last_s, |fall| fall.time_s);
        let pressed = |until_s: f64| metrics::window(trace, met_s.unwrap_or(f64::INFINITY), until_s);
        let impulse = |until_s: f64| {
            let sum: f64 = pressed(until_s).map(|frame| spring(frame).force_n * trace.period_s).sum();
            (met_s.is_some() && until_s < end_s + 1e-9).then_some(sum)
        };
        let largest = |of: fn(&SpringState) -> f64| metrics::largest(pressed(end_s), |frame| of(&spring(frame)));
        let whole = impulse(last_s).filter(|_| trace.fall().is_none());
        let blow = met_s.and_then(|met_s| impulse(met_s + BLOW_S));
        found.extend([
            metric("met_s", "meets the wall at", met_s, "s"),
            metric("peak_force_n", "peak force", largest(|spring| spring.peak_force_n), "N"),
            metric("blow_n_s", "impulse, first second", blow, "N s"),
            metric("impulse_n_s", "impulse to the end", whole, "N s"),
            metric("depth_m", "depth", largest(|spring| spring.stretch_m), "m"),
        ]);
    }

    /// Moves the wall away by the distance walked during the delay.
    fn delay(&mut self, phase_s: f64) {
        self.distance_m += phase_s * self.task.forward_m_s;
        self.task.duration_s += phase_s;
    }
}
