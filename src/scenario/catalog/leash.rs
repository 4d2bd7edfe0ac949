//! The scenario `leash`: a constant pull on the trunk (E5).

use super::{ParameterError, Parameters, Task, metric, towards};
use crate::scenario::Script;
use crate::scenario::metrics::{self, Metric};
use crate::scenario::trace::Trace;
use crate::world::{Disturbance, Pull};

parameters! {
    /// Leash: a constant pull on the trunk.
    Leash {
        /// Pulling force (N)
        force_n: f64 = 0.0 to 10_000.0, "0 to 10000 N";
        /// Direction of the pull in the world: 0 ahead, 90 left (deg)
        direction_deg: f64 = -360.0 to 360.0, "-360 to 360 degrees";
        /// Time at which the pull begins (s)
        at_s: f64 = 0.0 to 3600.0, "0 to 3600 s";
        /// Duration of the pull (s)
        for_s: f64 = 0.0 to 3600.0, "0 to 3600 s";
        /// Rate at which the robot is commanded back to where its commands alone would have led it; 0 for none (1/s)
        set_point_per_s: f64 = 0.0 to 10.0, "0 to 10 per second";
    }
}

impl Parameters for Leash {
    fn prepare(&self, script: &mut Script, _: u64) -> Result<(), ParameterError> {
        self.check_ranges()?;
        let force = towards(self.direction_deg).map(|part| self.force_n * part);
        let pull = Pull::constant([self.at_s, self.at_s + self.for_s], force);
        script.disturbances.push(Disturbance::Pull(pull));
        script.set_point_per_s = self.set_point_per_s;
        Ok(())
    }

    fn metrics(&self, script: &Script, trace: &Trace, found: &mut Vec<Metric>) {
        let Some(pull) = script.pull() else { return };
        let end_s = pull.until_s.min(script.duration_s);
        let from_s = (end_s - 5.0).max(pull.from_s);
        let pulled = trace.disturbed("pull:").is_some();
        let offset = metrics::offset_along_force(trace, pull.force, from_s, end_s).filter(|_| pulled);
        let reason = if pull.force == [0.0; 2] { "there is no force" } else { "it was not pulled" };
        let why = |metric: Metric| if pulled && pull.force != [0.0; 2] { metric } else { metric.because(reason) };
        found.push(why(metric("leash_offset_m_s", "velocity along the pull", offset, "m/s")));
        found.push(why(metric("leash_window_s", "the mean of the last", offset.map(|_| end_s - from_s), "s")));
    }

    fn delay(&mut self, phase_s: f64) {
        self.at_s += phase_s;
        self.task.duration_s += phase_s;
    }
}
