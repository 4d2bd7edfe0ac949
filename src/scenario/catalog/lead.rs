//! The scenario `lead`: a walker leads the robot by the leash (E14).

use super::{ParameterError, Parameters, Task, metric, towards};
use crate::scenario::Script;
use crate::scenario::metrics::{self, Metric};
use crate::scenario::trace::{Frame, Trace};
use crate::world::disturbance::{Disturbance, Spring, SpringEnd};

/// Length of the averages at the end of the playback \[s\].
const LAST_S: f64 = 3.0;

parameters! {
    /// Lead: a walker leads the robot by the leash.
    Lead {
        /// Speed of the walker relative to the commanded walk (m/s)
        speed_m_s: f64 = 0.0 to 5.0, "0 to 5 m/s";
        /// Direction of the walker in the world: 0 ahead, 90 left (deg)
        direction_deg: f64 = -360.0 to 360.0, "-360 to 360 degrees";
        /// Stiffness of the leash, including the walker's hand and arm (N/m)
        stiffness_n_per_m: f64 = 1.0 to 20_000.0, "1 to 20000 N/m";
        /// Damping of the leash (N s/m)
        damping_n_s_per_m: f64 = 0.0 to 500.0, "0 to 500 N s/m";
        /// Distance the walker walks until the leash is taut (m)
        slack_m: f64 = 0.0 to 10.0, "0 to 10 m";
        /// Time at which the walker sets off (s)
        at_s: f64 = 0.0 to 3600.0, "0 to 3600 s";
    }
}

impl Parameters for Lead {
    fn prepare(&self, script: &mut Script, _: u64) -> Result<(), ParameterError> {
        self.check_ranges()?;
        let direction = towards(self.direction_deg);
        // The hand goes along with the commanded walk.
        let walk_m_s = self.task.forward_m_s * direction[0] + self.task.left_m_s * direction[1];
        let (from_s, speed_m_s, gap_m) = (self.at_s, walk_m_s + self.speed_m_s, self.slack_m);
        let Lead { stiffness_n_per_m, damping_n_s_per_m, .. } = *self;
        let end = SpringEnd::Hand;
        let leash = Spring { end, from_s, direction, speed_m_s, gap_m, stiffness_n_per_m, damping_n_s_per_m };
        script.disturbances.push(Disturbance::Spring(leash));
        Ok(())
    }

    fn metrics(&self, script: &Script, trace: &Trace, found: &mut Vec<Metric>) {
        let end_s = script.duration_s;
        let last = metrics::window(trace, self.at_s.max(end_s - LAST_S), end_s).filter(|_| trace.fall().is_none());
        let tension = |frame: &Frame| frame.spring.map_or(0.0, |spring| spring.force_n);
        let peak = |frame: &Frame| frame.spring.map_or(0.0, |spring| spring.peak_force_n);
        let led = last.clone().last().and_then(|frame| {
            let hand_m = self.speed_m_s * (frame.time_s - self.at_s);
            Some(hand_m - self.slack_m - frame.spring?.stretch_m)
        });
        found.extend([
            metric("mean_tension_n", "mean tension, last 3 s", metrics::mean(last.clone(), tension), "N"),
            metric("peak_tension_n", "peak tension, last 3 s", metrics::largest(last, peak), "N"),
            metric("led_m", "led beside its course by", led, "m"),
        ]);
    }

    fn delay(&mut self, phase_s: f64) {
        self.at_s += phase_s;
        self.task.duration_s += phase_s;
    }
}
