/*! A run's folder: what was asked for, what happened, and what is needed to go on.

| file | content |
|---|---|
| `run.json` | seed, config name, git revision, MuJoCo version, command line |
| `config.yaml` | the whole configuration |
| `metrics.jsonl` | one JSON object for each iteration |
| `events.out.tfevents.*` | the same for TensorBoard, one file for each session |
| `checkpoint.safetensors` | the newest checkpoint; the one before is `checkpoint.previous.safetensors` |
| `policy.safetensors` | the policy of the newest checkpoint |
| `checkpoint.damaged.safetensors` | a newest checkpoint that could not be read, set aside |
| `faults` | CSV files: the last second before each physics fault, of at most 20 |
| `fault-minibatch.csv`, `fault.json` | the minibatch on which the learner failed, if it did, and what led there |
| `lock` | held by the process that trains here |

A folder that exists is never written over: a new run needs a new folder, and going on needs [`RunFolder::resume`].
It appears with its first checkpoint in it, that of iteration 0, so that a run can be resumed from the moment that it is
there, however early it is killed.
*/

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::train::Trainer;
use crate::train::checkpoint::Checkpoint;
use crate::train::environment::Fault;
use crate::train::metrics::IterationMetrics;
use crate::train::tensorboard::EventWriter;
use crate::util::files::{self, FileError};
use crate::util::provenance;

/// Physics faults of which the last second is kept; a scene that is wrong has thousands.
const MAX_FAULTS: usize = 20;

/// File of the policy of the newest checkpoint.
const POLICY: &str = "policy.safetensors";

/// File of the configuration.
const CONFIG: &str = "config.yaml";

/// File that the process which trains in a folder holds locked.
const LOCK: &str = "lock";

/// Why a run's folder could not be used.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// There is something at that path already.
    #[error("{path} exists already: go on with --resume {path}, or choose another folder with --out", path = .0.display())]
    Exists(PathBuf),
    /// There is no run to go on with.
    #[error("{} is not a run's folder: it has no checkpoint; start one with --out", .0.display())]
    NotARun(PathBuf),
    /// Another process trains there.
    #[error("another process is training in {}: wait for it, or choose another folder", .0.display())]
    Busy(PathBuf),
    /// Reading or writing failed, or the checkpoint is no good.
    #[error(transparent)]
    File(#[from] FileError),
}

/// The place of a run on disk.
#[derive(Debug)]
pub struct RunFolder {
    path: PathBuf,
    metrics: File,
    events: EventWriter,
    /// Locked as long as it is open; the system unlocks it when the process ends, however it ends.
    _lock: File,
}

impl RunFolder {
    /// Creates the folder of a new run.
    ///
    /// # Errors
    /// [`RunError::Exists`] if there is something at that path, or the system's reason.
    pub fn create(path: &Path, trainer: &Trainer) -> Result<Self, RunError> {
        if path.exists() {
            return Err(RunError::Exists(path.to_owned()));
        }
        let staged = staging_place(path);
        fs::create_dir_all(&staged).map_err(at(&staged))?;
        let lock = lock(&staged)?;
        remove_all_but_the_lock(&staged).map_err(at(&staged))?;
        let about = serde_json::json!({
            "config_name": trainer.run().config_name,
            "seed": trainer.run().seed,
            "git_revision": provenance::GIT_REVISION,
            "mujoco_version": provenance::MUJOCO_VERSION,
            "command": std::env::args().collect::<Vec<_>>().join(" "),
        });
        let fill = || -> Result<(), RunError> {
            let (run, config) = (staged.join("run.json"), staged.join(CONFIG));
            files::write_atomically(&run, format!("{about:#}\n").as_bytes()).map_err(at(&run))?;
            files::write_atomically(&config, trainer.run().config.to_yaml().as_bytes()).map_err(at(&config))?;
            trainer.checkpoint().save(&staged)?;
            trainer.policy().save(&staged.join(POLICY))?;
            fs::rename(&staged, path).map_err(at(path))?;
            Ok(files::sync_folder(path).map_err(at(path))?)
        };
        if let Err(error) = fill() {
            // Best effort: the first error is the one to report.
            let _ = fs::remove_dir_all(&staged);
            return Err(error);
        }
        Self::open(path, lock)
    }

    /// Opens the folder of a run to go on with it: reads its checkpoint and drops the metrics of iterations that came
    /// after it. The third value says why the newest checkpoint was passed over, if it was.
    ///
    /// # Errors
    /// [`RunError::NotARun`], or what is wrong with the checkpoint.
    pub fn resume(path: &Path) -> Result<(Self, Checkpoint, Option<FileError>), RunError> {
        use crate::train::checkpoint::{DAMAGED, NEWEST, PREVIOUS};
        if !path.join(NEWEST).exists() && !path.join(PREVIOUS).exists() {
            return Err(RunError::NotARun(path.to_owned()));
        }
        let lock = lock(path)?;
        let (checkpoint, passed_over) = Checkpoint::load(path)?;
        if passed_over.is_some() && path.join(NEWEST).exists() {
            // Else the next checkpoint would make the damaged one the one to fall back to.
            let damaged = path.join(DAMAGED);
            fs::rename(path.join(NEWEST), &damaged).map_err(at(&damaged))?;
        }
        let metrics = path.join("metrics.jsonl");
        cut_metrics(&metrics, checkpoint.run.iteration).map_err(at(&metrics))?;
        Ok((Self::open(path, lock)?, checkpoint, passed_over))
    }

    fn open(path: &Path, lock: File) -> Result<Self, RunError> {
        let metrics_path = path.join("metrics.jsonl");
        let metrics = OpenOptions::new().create(true).append(true).open(&metrics_path);
        Ok(RunFolder {
            _lock: lock,
            path: path.to_owned(),
            metrics: metrics.map_err(at(&metrics_path))?,
            events: EventWriter::create(path).map_err(at(path))?,
        })
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Appends an iteration to the logs.
    ///
    /// # Errors
    /// The system's reason, such as a full disk.
    pub fn log(&mut self, metrics: &IterationMetrics) -> Result<(), RunError> {
        let path = self.path.join("metrics.jsonl");
        // Plain numbers: serialising them cannot fail.
        let mut line = serde_json::to_vec(metrics).unwrap_or_default();
        line.push(b'\n');
        self.metrics.write_all(&line).map_err(at(&path))?;
        let scalars = metrics.scalars();
        let scalars: Vec<(&str, f64)> = scalars.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        let now_s = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64();
        Ok(self.events.scalars(metrics.samples, now_s, &scalars).map_err(at(&path))?)
    }

    /// Keeps the minibatch on which the learner failed, if there is one, and what led there; returns the latter's file.
    ///
    /// # Errors
    /// The system's reason, such as a full disk.
    pub fn keep_learner_fault(&self, minibatch: &str, circumstances: &str) -> Result<PathBuf, RunError> {
        let write = |name: &str, text: &str| -> Result<PathBuf, RunError> {
            let path = self.path.join(name);
            files::write_atomically(&path, text.as_bytes()).map_err(at(&path))?;
            Ok(path)
        };
        if !minibatch.is_empty() {
            write("fault-minibatch.csv", minibatch)?;
        }
        write("fault.json", circumstances)
    }

    /// Keeps the last second before a physics fault of an iteration; returns the file, or none if there are enough.
    ///
    /// # Errors
    /// The system's reason, such as a full disk.
    pub fn keep_physics_fault(&self, iteration: u64, fault: &Fault) -> Result<Option<PathBuf>, RunError> {
        let folder = self.path.join("faults");
        let Fault { environment, episode, step, .. } = fault;
        let path =
            folder.join(format!("iteration-{iteration}-environment-{environment}-episode-{episode}-step-{step}.csv"));
        let keep = || {
            fs::create_dir_all(&folder)?;
            if fs::read_dir(&folder)?.count() >= MAX_FAULTS {
                return Ok(false);
            }
            let text = format!("# {}\n{}", fault.error, fault.last_second);
            files::write_atomically(&path, text.as_bytes()).map(|()| true)
        };
        let kept = keep().map_err(at(&path))?;
        Ok(kept.then_some(path))
    }

    /// Writes checkpoint and policy, after making sure that the metrics which the checkpoint stands behind are on disk.
    ///
    /// # Errors
    /// The system's reason, such as a full disk; older files are untouched then.
    pub fn save(&self, trainer: &Trainer) -> Result<(), RunError> {
        self.metrics.sync_data().map_err(at(&self.path.join("metrics.jsonl")))?;
        trainer.checkpoint().save(&self.path)?;
        self.save_policy(trainer)
    }

    /// Writes the configuration, of which a resumption may have changed the number of samples.
    ///
    /// # Errors
    /// The system's reason, such as a full disk; the older file is untouched then.
    pub fn save_config(&self, trainer: &Trainer) -> Result<(), RunError> {
        let path = self.path.join(CONFIG);
        Ok(files::write_atomically(&path, trainer.run().config.to_yaml().as_bytes()).map_err(at(&path))?)
    }

    /// Writes the policy alone. A run that was killed between the two files of [`RunFolder::save`] has an old one.
    ///
    /// # Errors
    /// The system's reason, such as a full disk; the older file is untouched then.
    pub fn save_policy(&self, trainer: &Trainer) -> Result<(), RunError> {
        Ok(trainer.policy().save(&self.path.join(POLICY))?)
    }
}

fn at(path: &Path) -> impl Fn(io::Error) -> FileError + Copy {
    FileError::of("file", path)
}

/// Where the folder of a new run is put together: beside its place, under a name that a start which was cut off leaves
/// for the next one to find.
fn staging_place(path: &Path) -> PathBuf {
    let name = path.file_name().map(|name| name.to_string_lossy()).unwrap_or_default();
    path.with_file_name(format!(".{name}.starting"))
}

/// Clears what a start that was cut off has left.
fn remove_all_but_the_lock(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.file_name().is_none_or(|name| name != LOCK) {
            fs::remove_file(path)?;
        }
    }
    Ok(())
}

/// Claims a run's folder for this process.
fn lock(folder: &Path) -> Result<File, RunError> {
    let path = folder.join(LOCK);
    let file = OpenOptions::new().create(true).append(true).open(&path).map_err(at(&path))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(RunError::Busy(folder.to_owned())),
        Err(TryLockError::Error(error)) => Err(at(&path)(error).into()),
    }
}

/// Keeps the first `iterations` lines, which a checkpoint stands behind, and drops what came after it, a half-written
/// line included.
fn cut_metrics(path: &Path, iterations: u64) -> io::Result<()> {
    let mut kept = Vec::new();
    if path.exists() {
        let mut reader = BufReader::new(File::open(path)?);
        for _ in 0..iterations {
            if reader.read_until(b'\n', &mut kept)? == 0 {
                break;
            }
        }
    }
    files::write_atomically(path, &kept)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metrics_after_the_checkpoint_are_dropped_with_a_half_written_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        fs::write(&path, "1\n2\n3\n4").unwrap();
        cut_metrics(&path, 2).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "1\n2\n");
    }
}
