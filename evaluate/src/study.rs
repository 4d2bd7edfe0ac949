//! A study: sets of policies, the experiments that they play, and the report of what is measured.

use std::path::Path;

use supple::scenario::Sensing;

use crate::measurement_store::MeasurementStore;
use crate::policy_sets::PolicySet;
use crate::protocol::Protocol;
use crate::report::{Report, Section};
use crate::runner::{self, Measurement, ON_SENSORS, RunError, Settings};

/// Sets of policies and the experiments that they play.
pub struct Study<'a> {
    protocol: &'a Protocol,
    policies: &'a [PolicySet],
    compared: &'a [PolicySet],
    on_state: Settings,
    on_sensors: Settings,
}

impl<'a> Study<'a> {
    /// Creates a study that keeps its numbers in the folder `out`; `again` repeats finished measurements.
    pub fn new(protocol: &'a Protocol, policies: &'a [PolicySet], out: &Path, again: bool) -> Self {
        let settings = |sensing| Settings { again, sensing, store: MeasurementStore::new(out) };
        let [on_state, on_sensors] = [Sensing::True, Sensing::Estimated].map(settings);
        Study { protocol, policies, compared: &policies[..policies.len().min(2)], on_state, on_sensors }
    }

    /// Plays the named experiments, or all if none is named. With estimated sensing, the two compared sets also play them on
    /// their sensors, since E12 compares estimates with the true state.
    ///
    /// # Errors
    /// A trial cannot be played, or its numbers cannot be written.
    pub fn measure(
        &self,
        experiments: &[String],
        sensing: Sensing,
        progress: impl FnOnce(&[runner::Job]) -> Result<(), RunError>,
    ) -> Result<(), RunError> {
        let wanted = |name: &str| experiments.is_empty() || experiments.iter().any(|chosen| chosen == name);
        let mut jobs = Vec::new();
        for experiment in self.protocol.experiments().into_iter().filter(|experiment| wanted(experiment.info().name)) {
            jobs.extend(runner::jobs(experiment, self.policies, &self.on_state, "")?);
            if sensing == Sensing::Estimated {
                jobs.extend(runner::jobs(experiment, self.compared, &self.on_sensors, ON_SENSORS)?);
            }
        }
        progress(&jobs)
    }

    /// Adds all finished experiments to a report, and returns the faults of trials. It includes experiments that other processes have
    /// measured meanwhile, so the last process reports everything.
    ///
    /// # Errors
    /// A scenario file inside the program is invalid, which a test rules out.
    pub fn add_to(&self, report: &mut Report) -> Result<Vec<String>, RunError> {
        let mut faults = Vec::new();
        for experiment in self.protocol.experiments() {
            let finished = |policies, on: &Settings| runner::finished(experiment, policies, &on.store, on.sensing);
            let truth = finished(self.policies, &self.on_state)?;
            let estimated = finished(self.compared, &self.on_sensors)?;
            for (measured, on) in [(&truth, ""), (&estimated, ON_SENSORS)] {
                let Some(Measurement { results, .. }) = measured else { continue };
                let name = experiment.info().name;
                let of_set = |set| Some(format!("experiment {name}{on}: {}", results.faults(set)?));
                faults.extend((0..results.sets.len()).filter_map(of_set));
            }
            if let (Some(truth), Some(estimated)) = (&truth, &estimated) {
                report.sensing.add(experiment, truth, estimated);
            }
            match truth {
                Some(measurement) => report.add(Section::new(experiment, &measurement)),
                None => report.missing.push(experiment.info()),
            }
        }
        Ok(faults)
    }
}
