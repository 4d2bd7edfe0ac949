//! A constant pull on the trunk (E5).

use super::{ParameterError, Parameters, in_range, metric, towards};
use crate::scenario::Script;
use crate::scenario::metrics::{self, Metric};
use crate::scenario::trace::Trace;
use crate::sim::Pull;

parameters! {
    /// Leash: a constant pull on the trunk.
    pub struct Leash {
        /// Pulling force (N)
        pub force_n: f64,
        /// Direction of the pull in the world: 0 ahead, 90 left (deg)
        pub direction_deg: f64,
        /// When the pull begins (s)
        pub at_s: f64,
        /// How long it lasts (s)
        pub for_s: f64,
    }
}

impl Parameters for Leash {
    fn prepare(&self, script: &mut Script, _: u64) -> Result<(), ParameterError> {
        in_range("force-n", self.force_n, 0.0, 10_000.0, "0 to 10000 N")?;
        in_range("direction-deg", self.direction_deg, -360.0, 360.0, "-360 to 360 degrees")?;
        in_range("at-s", self.at_s, 0.0, 3600.0, "0 to 3600 s")?;
        in_range("for-s", self.for_s, 0.0, 3600.0, "0 to 3600 s")?;
        let force = towards(self.direction_deg).map(|part| self.force_n * part);
        script.pull = Some(Pull { from_s: self.at_s, until_s: self.at_s + self.for_s, force });
        Ok(())
    }

    fn metrics(&self, script: &Script, trace: &Trace, found: &mut Vec<Metric>) {
        let Some(pull) = script.pull else { return };
        let end_s = pull.until_s.min(script.duration_s);
        let offset = metrics::offset_along_force(trace, pull.force, (end_s - 5.0).max(pull.from_s), end_s);
        found.push(metric("leash_offset_m_s", "velocity along the pull", offset, "m/s"));
    }

    fn delay(&mut self, phase_s: f64) {
        self.at_s += phase_s;
        self.task.duration_s += phase_s;
    }
}
