/*! Finished measurements on disk, so that none is repeated.

A file holds all trials of one policy in one experiment. Its name is a hash of everything that its content depends on: the
policy, its seed, sensing, commanded compliance and calibration, the robot, the experiment's parameters and scenarios, and the
sources of this program except those that only report. After a change of a policy or of the protocol, only what is new is
measured, and a report never mixes measurements of different programs.

Several processes may share a folder, also on several machines: one process at a time measures an experiment, and the others
read its results.
*/

use std::fs::{self, File, TryLockError};
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::policy_sets::SetMember;
use super::results::PolicyResult;
use super::{Condition, Experiment};
use supple::estimate::{EstimatorConfig, SensorNoise, contact};
use supple::provenance::{mujoco_version, revision_and_mujoco};
use supple::scenario::Sensing;
use supple::util::files::{self, FileError};

/// Name of the file type in error messages.
const RESULTS: &str = "results";

/// The largest description of a lock's holder that is read \[bytes\].
const MAX_HOLDER_BYTES: u64 = 1 << 10;

/// The largest measurement that is read \[bytes\].
const MAX_BYTES: u64 = 1 << 30;

/// A finished measurement: all trials of one policy in one experiment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StoredMeasurement {
    /// The full hash of everything that the content depends on.
    pub key: String,
    /// The name of the experiment.
    pub experiment: String,
    /// The hash of the policy's file.
    pub sha256: String,
    /// The policy's seed.
    pub seed: u64,
    /// Revision and MuJoCo of the program that measured.
    pub revision: String,
    /// The time that the trials took \[s\].
    pub wall_s: f64,
    /// The hash of all other fields.
    pub checksum: String,
    /// The samples, shape (conditions, trials).
    pub samples: PolicyResult,
}

/// The folder of finished measurements.
#[derive(Debug, Clone)]
pub struct MeasurementStore {
    folder: PathBuf,
}

impl MeasurementStore {
    /// Creates the store in the folder `results` of a report's folder.
    pub fn new(out: &Path) -> Self {
        MeasurementStore { folder: out.join("results") }
    }

    /// Returns the path of a measurement.
    fn path(&self, experiment: &dyn Experiment, key: &str) -> PathBuf {
        self.folder.join(experiment.info().name).join(format!("{}.json", &key[..16]))
    }

    /// Reads a finished measurement; none if it is missing or damaged.
    pub fn read(&self, experiment: &dyn Experiment, key: &str) -> Option<StoredMeasurement> {
        let bytes = files::read_bounded(&self.path(experiment, key), MAX_BYTES).ok()?;
        let stored: StoredMeasurement = serde_json::from_slice(&bytes).ok()?;
        (stored.key == key && stored.checksum == stored.computed_checksum()).then_some(stored)
    }

    /// Locks an experiment: waits until no other process measures it, and keeps others waiting while the file is open. If it has
    /// to wait, `waits` receives a description of the other process.
    pub(crate) fn lock_experiment(&self, experiment: &dyn Experiment, waits: impl Fn(&str)) -> Result<File, FileError> {
        let name = experiment.info().name;
        lock(&self.folder.join(name), |other| waits(&format!("{other}, which measures {name}")))
    }

    /// Locks an experiment unless another process measures it.
    pub(crate) fn try_lock_experiment(&self, experiment: &dyn Experiment) -> Result<Option<File>, FileError> {
        let folder = self.folder.join(experiment.info().name);
        let file = open_lock(&folder)?;
        if let Err(TryLockError::WouldBlock) = file.try_lock() { Ok(None) } else { hold(file, &folder).map(Some) }
    }

    /// Locks the report: waits until no other process writes it. `waits` receives a description of that process.
    ///
    /// # Errors
    /// The folder or its lock file cannot be created.
    pub fn lock_report(&self, waits: impl Fn(&str)) -> Result<File, FileError> {
        lock(&self.folder, |other| waits(&format!("{other}, which writes the report")))
    }

    /// Writes a finished measurement.
    pub(crate) fn write(
        &self,
        experiment: &dyn Experiment,
        key: &str,
        member: &SetMember,
        wall_s: f64,
        samples: PolicyResult,
    ) -> Result<(), FileError> {
        let path = self.path(experiment, key);
        let (key, experiment) = (key.to_owned(), experiment.info().name.to_owned());
        let (sha256, seed, revision) = (member.agent.sha256.clone(), member.seed, revision_and_mujoco());
        let checksum = String::new();
        let mut stored = StoredMeasurement { key, experiment, sha256, seed, revision, wall_s, checksum, samples };
        stored.checksum = stored.computed_checksum();
        let fail = FileError::of(RESULTS, &path);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(fail)?;
        }
        let bytes = serde_json::to_vec(&stored).map_err(FileError::of(RESULTS, &path))?;
        files::write_atomically(&path, &bytes).map_err(fail)
    }
}

impl StoredMeasurement {
    /// Returns the hash of all other fields.
    fn computed_checksum(&self) -> String {
        let StoredMeasurement { key, experiment, sha256, seed, revision, wall_s, checksum: _, samples } = self;
        let all = (key, experiment, sha256, seed, revision, wall_s, samples);
        // Serialising structs of numbers and texts cannot fail.
        files::sha256(&[&serde_json::to_vec(&all).unwrap_or_default()])
    }
}

/// Locks a folder. The lock file describes the process that holds it; `waits` receives this description if it is another process.
fn lock(folder: &Path, waits: impl Fn(&str)) -> Result<File, FileError> {
    let file = open_lock(folder)?;
    // On a file system without locks, two processes may measure the same, which only costs time.
    if let Err(TryLockError::WouldBlock) = file.try_lock() {
        let mut holder = String::new();
        let _ = (&file).take(MAX_HOLDER_BYTES).read_to_string(&mut holder);
        let holder = if holder.is_empty() { "another process" } else { holder.trim() };
        waits(holder);
        let _ = file.lock();
    }
    hold(file, folder)
}

fn open_lock(folder: &Path) -> Result<File, FileError> {
    let path = folder.join(".lock");
    fs::create_dir_all(folder).map_err(FileError::of(RESULTS, folder))?;
    File::options().create(true).read(true).append(true).open(&path).map_err(FileError::of(RESULTS, &path))
}

/// Writes a description of this process into a lock file that it holds.
fn hold(mut file: File, folder: &Path) -> Result<File, FileError> {
    // The description is only for people, so failing to write it does no harm.
    let _ = file.set_len(0);
    let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let _ = write!(file, "process {} on {}", std::process::id(), host.trim());
    files::clear_temporaries(folder).map_err(FileError::of(RESULTS, folder))?;
    Ok(file)
}

/// Returns the hash of everything that the results of an experiment with a policy depend on.
pub fn key(experiment: &dyn Experiment, conditions: &[Condition], member: &SetMember, sensing: Sensing) -> String {
    let robot = &member.agent.config.robot;
    let mut parts = serde_json::json!({
        "program": env!("SUPPLE_MEASUREMENT_SOURCES"),
        "mujoco": mujoco_version(),
        // A robot that cannot be read fails in its first trial, with the reason.
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
    if member.agent.commanded_compliance.is_some()
        || conditions.iter().any(|condition| condition.scenario.task().compliance.is_some())
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::Protocol;
    use crate::trial::{Sample, TrialEnd};

    #[test]
    fn checksum_covers_every_field() {
        let folder = tempfile::tempdir().unwrap();
        let (store, protocol) = (MeasurementStore::new(folder.path()), Protocol::quick().unwrap());
        let agent = supple::policy::shipped::find("compliant").unwrap();
        let member = SetMember { seed: 3, file: PathBuf::from("x"), agent };
        let sample = Sample::new(TrialEnd::Upright, vec![Some(0.5), None]);
        let key = "0123456789abcdef0123";
        store.write(&protocol.decay, key, &member, 1.25, vec![vec![sample]]).unwrap();
        let path = store.path(&protocol.decay, key);
        let whole = fs::read_to_string(&path).unwrap();
        assert_eq!(store.read(&protocol.decay, key).unwrap().seed, 3);
        let wrong =
            [("\"seed\":3", "\"seed\":4"), ("1.25", "1.5"), ("0.5", "0.25"), ("\"sha256\":\"", "\"sha256\":\"0")];
        for (from, to) in wrong {
            assert!(whole.contains(from), "{from} in {whole}");
            fs::write(&path, whole.replacen(from, to, 1)).unwrap();
            assert!(store.read(&protocol.decay, key).is_none(), "{to}");
        }
    }
}
