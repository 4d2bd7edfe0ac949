/*! Finished measurements on disk, so that none is made twice.

A file holds all trials of one policy in one experiment. Its name is a hash of everything that decides its content: the
policy, its seed, its sensing, its commanded compliance and calibration, the robot, the experiment's parameters and scenarios, and the sources of this program
(but for those that only show what was measured). A new policy or a changed protocol therefore measures only what is
new, and a report never mixes what different programs measured.

Several processes, on several machines too, may share a folder: an experiment is measured by one of them at a time, and the
others find what it has measured.
*/

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::policy_sets::SetMember;
use super::results::PolicyResult;
use super::{Condition, Experiment};
use supple::estimate::{EstimatorConfig, SensorNoise, contact};
use supple::scenario::Sensing;
use supple::util::files;
use supple::util::provenance::git_revision;

/// Larger files are not ours.
const MAX_BYTES: u64 = 1 << 30;

/// A finished measurement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StoredMeasurement {
    /// Full hash of what decides the content.
    pub key: String,
    /// Name of the experiment.
    pub experiment: String,
    /// Policy.
    pub sha256: String,
    /// The policy's seed.
    pub seed: u64,
    /// Revision of the program that measured.
    pub revision: String,
    /// How long it took \[s\].
    pub wall_s: f64,
    /// Hash of the samples.
    pub checksum: String,
    /// Shape (conditions, trials).
    pub samples: PolicyResult,
}

/// The folder of finished measurements.
#[derive(Debug, Clone)]
pub struct MeasurementStore {
    folder: PathBuf,
}

impl MeasurementStore {
    /// Results below `out`.
    pub fn new(out: &Path) -> Self {
        MeasurementStore { folder: out.join("results") }
    }

    /// Where a measurement is or will be.
    fn path(&self, experiment: &dyn Experiment, key: &str) -> PathBuf {
        self.folder.join(experiment.info().name).join(format!("{}.json", &key[..16]))
    }

    /// A finished measurement, if it is there and whole.
    pub fn read(&self, experiment: &dyn Experiment, key: &str) -> Option<StoredMeasurement> {
        let bytes = files::read_bounded(&self.path(experiment, key), MAX_BYTES).ok()?;
        let stored: StoredMeasurement = serde_json::from_slice(&bytes).ok()?;
        (stored.key == key && stored.checksum == checksum(&stored.samples)).then_some(stored)
    }

    /// Waits until no other process measures an experiment here: none does while the file is open.
    ///
    /// # Errors
    /// The system's.
    pub fn lock_experiment(&self, experiment: &dyn Experiment) -> io::Result<File> {
        lock(&self.folder.join(experiment.info().name))
    }

    /// Waits until no other process writes a report about what is here: none does while the file is open.
    ///
    /// # Errors
    /// The system's.
    pub fn lock_report(&self) -> io::Result<File> {
        lock(&self.folder)
    }

    /// Keeps a finished measurement.
    ///
    /// # Errors
    /// The system's.
    pub fn write(
        &self,
        experiment: &dyn Experiment,
        key: &str,
        member: &SetMember,
        wall_s: f64,
        samples: PolicyResult,
    ) -> io::Result<()> {
        let stored = StoredMeasurement {
            key: key.to_owned(),
            experiment: experiment.info().name.to_owned(),
            sha256: member.agent.sha256.clone(),
            seed: member.seed,
            revision: git_revision().to_owned(),
            wall_s,
            checksum: checksum(&samples),
            samples,
        };
        let path = self.path(experiment, key);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)?;
        }
        files::write_atomically(&path, &serde_json::to_vec(&stored)?)
    }
}

fn lock(folder: &Path) -> io::Result<File> {
    fs::create_dir_all(folder)?;
    let file = File::options().create(true).append(true).open(folder.join(".lock"))?;
    // Where the file system knows no locks, two may measure the same: that costs time and does no harm.
    let _ = file.lock();
    files::clear_temporaries(folder)?;
    Ok(file)
}

fn checksum(samples: &PolicyResult) -> String {
    // Plain structs of numbers: serialising them cannot fail.
    files::sha256(&[&serde_json::to_vec(samples).unwrap_or_default()])
}

/// Hash of everything that decides what an experiment measures with a policy.
pub fn key(experiment: &dyn Experiment, conditions: &[Condition], member: &SetMember, sensing: Sensing) -> String {
    let robot = &member.agent.config.robot;
    let mut parts = serde_json::json!({
        "program": env!("SUPPLE_MEASUREMENT_SOURCES"),
        // One that cannot be read fails in its first trial, with the reason.
        "robot": robot.load().map(|robot| robot.sha256().to_owned()).unwrap_or_default(),
        "losses": [robot.friction_loss_n_m, robot.damping_n_m_s_per_rad],
        "experiment": [experiment.info().name, experiment.info().number],
        "parameters": experiment,
        "trials": experiment.info().trials,
        "conditions": conditions,
        "policy": member.agent.sha256,
        "seed": member.seed,
    });
    // A calibration does not affect trials without commanded compliance.
    if member.agent.commanded_compliance > 0.0
        || conditions.iter().any(|condition| condition.scenario.task().compliance > 0.0)
    {
        parts["compliance"] = serde_json::json!([member.agent.commanded_compliance, member.agent.calibration]);
    }
    if sensing == Sensing::Estimated {
        parts["sensing"] = serde_json::json!({
            "network": contact::shipped_sha256(),
            "noise": SensorNoise::default(),
            "estimator": EstimatorConfig::default(),
        });
    }
    files::sha256(&[parts.to_string().as_bytes()])
}
