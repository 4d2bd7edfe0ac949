//! The scenario `push`: changes of the trunk's velocity (E1 to E4, E16).

use rand::RngExt;

use super::{ParameterError, Parameters, Task, in_range, lasting, metric, towards};
use crate::scenario::Script;
use crate::scenario::metrics::{self, Metric, PHASE_S, STRIDE_S};
use crate::scenario::trace::Trace;
use crate::util::random::{Purpose, stream};
use crate::world::{Disturbance, Push};

parameters! {
    /// Push: a change of the trunk's velocity.
    PushTrunk {
        /// Size of the velocity change (m/s)
        push_m_s: f64 = 0.0 to 20.0, "0 to 20 m/s";
        /// Direction of the push: 0 forward, 90 left (deg)
        direction_deg: f64 = -360.0 to 360.0, "-360 to 360 degrees";
        /// Earliest time of the push; the seed delays it by up to 0.65 s (s)
        at_s: f64 = 0.0 to 3600.0, "0 to 3600 s";
        /// Push again at this interval; 0 pushes once (s)
        every_s: f64;
        /// Time over which a force gives the robot the push's momentum; 0 for an instant (s)
        for_s: f64 = 0.0 to 10.0, "0 to 10 s";
        /// Change of the size from each push to the next (m/s)
        growth_m_s: f64 = 0.0 to 20.0, "0 to 20 m/s";
    }
}

impl Parameters for PushTrunk {
    fn prepare(&self, script: &mut Script, seed: u64) -> Result<(), ParameterError> {
        self.check_ranges()?;
        if self.every_s != 0.0 {
            in_range("every-s", self.every_s, 0.1, 3600.0, "0.1 to 3600 s, or 0 for a single push")?;
        }
        let linear = towards(self.direction_deg).map(|part| self.push_m_s * part);
        let mut push = Push { linear, for_s: self.for_s, ..Push::default() };
        let growth = towards(self.direction_deg).map(|part| self.growth_m_s * part);
        // A push may come at any phase of the gait.
        let phase_s = PHASE_S * stream(seed, Purpose::Scenario, 0, 0).random_range(0.0..1.0);
        push.at_s = self.at_s + phase_s;
        // The first push is added even if it would come too late, for `Script::too_late`.
        script.disturbances.push(Disturbance::Push(push));
        while self.every_s > 0.0 && push.at_s + self.every_s < script.duration_s {
            push.at_s += self.every_s;
            (0..2).for_each(|axis| push.linear[axis] += growth[axis]);
            script.disturbances.push(Disturbance::Push(push));
        }
        Ok(())
    }

    fn metrics(&self, script: &Script, trace: &Trace, found: &mut Vec<Metric>) {
        let mut pushes = script.pushes();
        let Some(first) = pushes.next() else { return };
        // The numbers are those of the first push, as long as it is the only one.
        let alone = pushes.next().map(|second| trace.until(second.at_s));
        let trace = alone.as_ref().unwrap_or(trace);
        let at_s = first.at_s;
        let pushed_s = trace.disturbed(if self.for_s > 0.0 { "pull:" } else { "push" });
        let decay = |threshold| metrics::decay(trace, at_s, first.linear, threshold, STRIDE_S);
        let [to_10, to_20] = [0.1, 0.2].map(|threshold| decay(threshold).filter(|_| pushed_s.is_some()));
        // Over a whole second or not at all: means over different times cannot be compared.
        let second = |from_s: f64| metrics::whole_window(trace, from_s, from_s + 1.0).filter(|_| pushed_s.is_some());
        let power = |from_s: f64| metrics::mean(second(from_s)?, |frame| frame.power_w);
        let torque = |from_s: f64| metrics::mean(second(from_s)?, |frame| frame.torque_n_m);
        let numbers = [
            metric("push_time_s", "pushed at", pushed_s, "s"),
            lasting("decay_10_s", "decay to 10 %", to_10),
            lasting("decay_20_s", "decay to 20 %", to_20),
            metric("power_before_w", "power, 1 s before", power(at_s - 1.0), "W"),
            metric("power_after_w", "power, 1 s after", power(at_s), "W"),
            metric("torque_before_n_m", "torque, 1 s before", torque(at_s - 1.0), "N m"),
            metric("torque_after_n_m", "torque, 1 s after", torque(at_s), "N m"),
        ];
        let reason = |metric: Metric| match () {
            () if pushed_s.is_none() => metric.because("it was not pushed"),
            () if alone.is_some() && trace.fall().is_none() => metric.because("the next push comes too early"),
            () => metric,
        };
        found.extend(numbers.map(reason));
    }
}
