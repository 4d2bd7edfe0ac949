/*! A run's folder: its configuration, its logs, and the files needed to resume it.

| file | content |
|---|---|
| `run.json` | seed, config name, git revision, MuJoCo version, command line |
| `config.yaml` | the whole configuration |
| `metrics.jsonl` | one JSON object for each iteration |
| `events.out.tfevents.*` | the same for TensorBoard, one file for each session |
| `checkpoint.safetensors` | the newest checkpoint; the one before is `checkpoint.previous.safetensors` |
| `policy.safetensors` | the policy of the newest checkpoint |
| `policy-SAMPLES.safetensors` | policies along the way, if `run.keep_policy_every` is set |
| `checkpoint.damaged.safetensors` | a newest checkpoint that could not be read, set aside |
| `faults` | CSV files: the last second before each physics fault, of at most 20 |
| `fault-minibatch.csv`, `fault.json` | the minibatch on which the learner failed, if it did, and a report |
| `lock` | locked by the process that trains in the folder |

A folder that exists is never overwritten: a new run needs a new folder, and [`RunFolder::resume`] continues a run.
It appears with its first checkpoint in it, that of iteration 0, so that a run can be resumed as soon as it
exists, however early it is killed.
*/

use std::ffi::{OsStr, OsString};
use std::fmt::Display;
use std::fs::{self, File, OpenOptions, Permissions, TryLockError};
use std::io::{self, BufReader, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::Deserialize;

use crate::config::{Config, DifferenceError};
use crate::provenance;
use crate::train::Trainer;
use crate::train::checkpoint::{Checkpoint, DAMAGED, NEWEST, PREVIOUS};
use crate::train::environment::EpisodeFault;
use crate::train::metrics::IterationMetrics;
use crate::train::tensorboard::EventWriter;
use crate::util::files::{self, FileError};
use crate::util::{terminal, yaml};

/// Maximum number of physics faults whose last second is stored; a faulty scene has thousands.
const MAX_FAULTS: usize = 20;

/// File of the policy of the newest checkpoint.
const POLICY: &str = "policy.safetensors";

/// File of the configuration.
const CONFIG: &str = "config.yaml";

/// File with the run's provenance and command line.
const ABOUT: &str = "run.json";

/// File of the metrics, with one line for each iteration.
pub const METRICS: &str = "metrics.jsonl";

/// Maximum size of text files and lines \[bytes\].
const MAX_BYTES: u64 = 1 << 20;

/// File that the training process keeps locked.
const LOCK: &str = "lock";

/// The reason why a run's folder could not be used.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The path is a run already.
    #[error("{path} exists already: continue it with --resume {path}, or choose another folder with --out", path = .0.display())]
    Exists(PathBuf),
    /// The path exists and is not a run.
    #[error("{} exists already and is not a training run; choose another folder with --out", .0.display())]
    Taken(PathBuf),
    /// The path is not a run that could be resumed.
    #[error("{} is not a run's folder: it has no checkpoint to resume from", .0.display())]
    NotARun(PathBuf),
    /// The folder mixes files of different runs.
    #[error("{}: two runs are mixed: {problem}", path.display())]
    Mixed {
        /// Path of the folder.
        path: PathBuf,
        /// The files that differ, and their values.
        problem: String,
    },
    /// The configuration was changed after the run began.
    #[error(
        "{path}/config.yaml was changed after the run began: {keys} in the checkpoint; undo that, or start another run with \
         --config {path}/config.yaml", path = path.display()
    )]
    Changed {
        /// Path of the folder.
        path: PathBuf,
        /// The changed keys, with both values.
        keys: DifferenceError,
    },
    /// The configuration is invalid, perhaps after an edit.
    #[error("{0}; correct it, or remove the file: it is written again from the checkpoint")]
    Unreadable(String),
    /// Another process is training in the folder.
    #[error("another process is training in {}: wait for it, or choose another folder", .0.display())]
    Busy(PathBuf),
    /// Reading or writing failed, or the checkpoint is damaged.
    #[error(transparent)]
    File(#[from] FileError),
}

/// The folder of a run on disk.
#[derive(Debug)]
pub struct RunFolder {
    path: PathBuf,
    metrics: File,
    events: EventWriter,
    /// The lock file. The operating system unlocks it when the process ends, however it ends.
    _lock: File,
}

impl RunFolder {
    /// Creates the folder of a new run, with its first checkpoint.
    ///
    /// # Errors
    /// The path exists already, or a file cannot be written.
    pub fn create(path: &Path, trainer: &Trainer, checkpoint: &Checkpoint) -> Result<Self, RunError> {
        ensure!(!is_run(path), RunError::Exists(path.to_owned()));
        ensure!(path.symlink_metadata().is_err(), RunError::Taken(path.to_owned()));
        let (staged, lock) = stage(path)?;
        let about = serde_json::json!({
            "config_name": trainer.run().config_name,
            "seed": trainer.run().seed,
            "git_revision": provenance::git_revision(),
            "mujoco_version": provenance::mujoco_version(),
            "command": std::env::args_os().map(terminal::shell_word).collect::<Vec<_>>().join(" "),
        });
        let fill = || -> Result<(), RunError> {
            let (run, config) = (staged.join(ABOUT), staged.join(CONFIG));
            files::write_atomically(&run, format!("{about:#}\n").as_bytes()).map_err(at(&run))?;
            files::write_atomically(&config, trainer.run().config.to_yaml().as_bytes()).map_err(at(&config))?;
            checkpoint.save(&staged)?;
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

    /// Opens the folder of a run to resume it: reads its checkpoint, checks that the other files belong to the same
    /// run, and drops the metrics of later iterations. The length of the run and the place of the robot's file are taken
    /// from `config.yaml`, everything else from the checkpoint. Also returns notes for the user, for example that the newest checkpoint
    /// is damaged or that metrics are missing.
    ///
    /// # Errors
    /// The path is not a run, its files belong to different runs, no checkpoint can be read, or another process trains
    /// there.
    pub fn resume(path: &Path) -> Result<(Self, Checkpoint, Vec<String>), RunError> {
        ensure!(is_run(path), RunError::NotARun(path.to_owned()));
        let lock = lock(path)?;
        files::clear_temporaries(path).map_err(at(path))?;
        let (mut checkpoint, passed_over) = Checkpoint::load(path)?;
        let mut notes = Vec::new();
        check_identity(path, &checkpoint, &mut notes)?;
        check_config(path, &mut checkpoint, &mut notes)?;
        let metrics = path.join(METRICS);
        let (kept, lost) = metrics_up_to(path, &checkpoint)?;
        notes.extend(lost);
        if let Some(reason) = &passed_over {
            notes.push(format!("{reason}; continuing from the checkpoint before it"));
        }
        // Nothing is changed before all checks have passed.
        if passed_over.is_some() && path.join(NEWEST).exists() {
            // Otherwise, the next checkpoint would make the damaged one the fallback.
            let damaged = path.join(DAMAGED);
            fs::rename(path.join(NEWEST), &damaged).map_err(at(&damaged))?;
        }
        files::write_atomically(&metrics, &kept).map_err(at(&metrics))?;
        Ok((Self::open(path, lock)?, checkpoint, notes))
    }

    fn open(path: &Path, lock: File) -> Result<Self, RunError> {
        let metrics_path = path.join(METRICS);
        let metrics = OpenOptions::new().create(true).append(true).open(&metrics_path);
        let metrics = metrics.map_err(at(&metrics_path))?;
        let events = EventWriter::create(path).map_err(at(path))?;
        Ok(RunFolder { _lock: lock, path: path.to_owned(), metrics, events })
    }

    /// Returns the path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Appends an iteration's metrics to the logs.
    ///
    /// # Errors
    /// A log cannot be written, for example because the disk is full.
    pub fn log(&mut self, metrics: &IterationMetrics) -> Result<(), RunError> {
        let path = self.path.join(METRICS);
        // Plain numbers: serialising them cannot fail.
        let mut line = serde_json::to_vec(metrics).unwrap_or_default();
        line.push(b'\n');
        self.metrics.write_all(&line).map_err(at(&path))?;
        let scalars = metrics.scalars();
        let scalars: Vec<(&str, f64)> = scalars.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        let now_s = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64();
        Ok(self.events.scalars(metrics.samples, now_s, &scalars).map_err(at(&path))?)
    }

    /// Stores the minibatch on which the learner failed, if there is one, and the report; returns the report's path.
    ///
    /// # Errors
    /// A file cannot be written, for example because the disk is full.
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

    /// Stores the last second before a physics fault of an iteration; returns the file, or `None` if there are enough.
    ///
    /// # Errors
    /// The file cannot be written, for example because the disk is full.
    pub fn keep_physics_fault(&self, iteration: u64, fault: &EpisodeFault) -> Result<Option<PathBuf>, RunError> {
        let folder = self.path.join("faults");
        let EpisodeFault { environment, episode, step, .. } = fault;
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

    /// Writes a trainer's checkpoint and policy, after syncing the metrics up to it.
    ///
    /// # Errors
    /// A file cannot be written, for example because the disk is full; older files stay untouched.
    pub fn save(&self, trainer: &Trainer, checkpoint: &Checkpoint) -> Result<(), RunError> {
        self.metrics.sync_data().map_err(at(&self.path.join(METRICS)))?;
        checkpoint.save(&self.path)?;
        self.save_policy(trainer)
    }

    /// Writes the configuration, whose number of samples a resumption may have changed.
    ///
    /// # Errors
    /// The file cannot be written, for example because the disk is full; the older file stays untouched.
    pub fn save_config(&self, trainer: &Trainer) -> Result<(), RunError> {
        let path = self.path.join(CONFIG);
        Ok(files::write_atomically(&path, trainer.run().config.to_yaml().as_bytes()).map_err(at(&path))?)
    }

    /// Writes the policy alone. After a kill between the two files of [`RunFolder::save`], the folder has an old
    /// policy.
    ///
    /// # Errors
    /// The file cannot be written, for example because the disk is full; the older file stays untouched.
    pub fn save_policy(&self, trainer: &Trainer) -> Result<(), RunError> {
        Ok(trainer.policy().save(&self.path.join(POLICY))?)
    }

    /// Stores a copy of the policy if the last iteration passed a multiple of `run.keep_policy_every`, under that
    /// number.
    ///
    /// # Errors
    /// The file cannot be written, for example because the disk is full.
    pub fn keep_policy(&self, trainer: &Trainer) -> Result<(), RunError> {
        let run = trainer.run();
        let Some(every) = run.config.run.keep_policy_every else { return Ok(()) };
        let before = run.samples - run.config.ppo.batch_size as u64;
        if run.samples / every > before / every {
            let name = format!("policy-{}.safetensors", run.samples / every * every);
            trainer.policy().save(&self.path.join(name))?;
        }
        Ok(())
    }
}

/// Reads the metrics of the run in a folder. A line that is not a metrics record is left out.
///
/// # Errors
/// The file cannot be read.
pub fn metrics(path: &Path) -> Result<Vec<IterationMetrics>, FileError> {
    Ok(lines_of(&path.join(METRICS))?.iter().filter_map(|line| serde_json::from_str(line).ok()).collect())
}

/// Returns the lines of a file; one that is not text counts as missing.
fn lines_of(file: &Path) -> Result<Vec<String>, FileError> {
    let lines = files::lines(BufReader::new(File::open(file).map_err(at(file))?), MAX_BYTES);
    let is_text = |line: &io::Result<String>| !matches!(line, Err(error) if error.kind() == io::ErrorKind::InvalidData);
    lines.filter(is_text).collect::<io::Result<_>>().map_err(at(file))
}

fn at(path: &Path) -> impl Fn(io::Error) -> FileError + Copy {
    FileError::of("file", path)
}

/// Creates and locks a temporary folder with a random name next to the run's, and removes those of interrupted starts.
fn stage(path: &Path) -> Result<(PathBuf, File), RunError> {
    let name = path.file_name().ok_or_else(|| at(path)(io::Error::other("it names no folder")))?;
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    fs::create_dir_all(parent).map_err(at(parent))?;
    let mut prefix = OsString::from(".");
    prefix.push(name);
    prefix.push(".starting-");
    clear_cut_off_starts(parent, &prefix).map_err(at(parent))?;
    // The usual permissions of a new folder, not its owner's alone.
    let permissions = Permissions::from_mode(0o777);
    let staged = tempfile::Builder::new().prefix(&prefix).rand_bytes(16).permissions(permissions).tempdir_in(parent);
    let staged = staged.map_err(at(parent))?.keep();
    let lock = lock(&staged)?;
    Ok((staged, lock))
}

/// Removes unlocked folders (no links) whose names begin with `prefix`.
fn clear_cut_off_starts(parent: &Path, prefix: &OsStr) -> io::Result<()> {
    for entry in fs::read_dir(parent)? {
        let entry = entry?;
        let is_ours = entry.file_name().as_encoded_bytes().starts_with(prefix.as_encoded_bytes());
        if is_ours
            && entry.file_type()?.is_dir()
            && File::open(entry.path().join(LOCK)).is_ok_and(|lock| lock.try_lock().is_ok())
        {
            fs::remove_dir_all(entry.path())?;
        }
    }
    Ok(())
}

/// Locks a run's folder for this process.
fn lock(folder: &Path) -> Result<File, RunError> {
    let path = folder.join(LOCK);
    let file = OpenOptions::new().create(true).append(true).open(&path).map_err(at(&path))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(RunError::Busy(folder.to_owned())),
        Err(TryLockError::Error(error)) => Err(at(&path)(error).into()),
    }
}

/// Returns true if there is a checkpoint, valid or damaged.
fn is_run(path: &Path) -> bool {
    [NEWEST, PREVIOUS].iter().any(|name| path.join(name).exists())
}

/// Checks that a checkpoint belongs to the run of this folder.
fn check_identity(path: &Path, checkpoint: &Checkpoint, notes: &mut Vec<String>) -> Result<(), RunError> {
    #[derive(Deserialize)]
    struct About {
        config_name: String,
        seed: u64,
    }
    let read = files::read_text(&path.join(ABOUT), MAX_BYTES).map_err(|error| error.to_string());
    let about = match read.and_then(|text| serde_json::from_str::<About>(&text).map_err(|error| error.to_string())) {
        Ok(about) => about,
        Err(error) => {
            notes.push(format!("{}: {error}; only the checkpoint identifies the run", path.join(ABOUT).display()));
            return Ok(());
        }
    };
    let run = &checkpoint.run;
    let mixed = |what: &str, ours: &dyn Display, theirs: &dyn Display| {
        let problem = format!("its checkpoint is of {what} {theirs}, {ABOUT} of {what} {ours}");
        Err(RunError::Mixed { path: path.to_owned(), problem })
    };
    if about.seed != run.seed {
        return mixed("seed", &about.seed, &run.seed);
    }
    if about.config_name != run.config_name {
        return mixed("configuration", &about.config_name, &run.config_name);
    }
    Ok(())
}

/// Checks that the configuration in the folder is that of the checkpoint, and takes over its length of the run and its name of the robot:
/// the robot's file may be in another place on another machine.
fn check_config(path: &Path, checkpoint: &mut Checkpoint, notes: &mut Vec<String>) -> Result<(), RunError> {
    let file = path.join(CONFIG);
    let name = file.display().to_string();
    let config = match files::read_text(&file, MAX_BYTES) {
        Ok(text) => Config::from_yaml(&name, &text).map_err(|error| RunError::Unreadable(error.to_string()))?,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            notes.push(format!("there is no {name}: it is written again from the checkpoint"));
            return Ok(());
        }
        Err(error) => return Err(at(&file)(error).into()),
    };
    let ours = &mut checkpoint.run.config;
    let (theirs, model) = (&config.robot.model, &mut ours.robot.model);
    if theirs != model {
        notes.push(format!("robot.model is {theirs} in {name} and {model} in the checkpoint: the former counts"));
        model.clone_from(theirs);
    }
    config.check_same(ours).map_err(|keys| RunError::Changed { path: path.to_owned(), keys })?;
    for (key, [theirs, ours]) in yaml::differences(&config.run, &ours.run) {
        notes.push(format!("run.{key} is {theirs} in {name} and {ours} in the checkpoint: the former counts"));
    }
    ours.run = config.run;
    Ok(())
}

/// Returns the lines of the metrics up to a checkpoint's iteration, and a note about missing ones. Later lines are
/// dropped, a half-written line included.
fn metrics_up_to(path: &Path, checkpoint: &Checkpoint) -> Result<(Vec<u8>, Option<String>), RunError> {
    #[derive(Deserialize)]
    struct Time {
        elapsed_s: f64,
    }
    #[derive(Deserialize)]
    struct Line {
        iteration: u64,
        time: Option<Time>,
    }
    let file = path.join(METRICS);
    let lines = if file.try_exists().map_err(at(&file))? { lines_of(&file)? } else { Vec::new() };
    let run = &checkpoint.run;
    let (mut kept, mut next, mut missing) = (Vec::new(), 1, Vec::new());
    for text in &lines {
        let Ok(line) = serde_json::from_str::<Line>(text) else { continue };
        if !(next..=run.iteration).contains(&line.iteration) {
            continue;
        }
        // No two runs have the same training time.
        if let (true, Some(time)) = (line.iteration == run.iteration, line.time)
            && time.elapsed_s != run.elapsed_s
        {
            let (at, ours, theirs) = (run.iteration, run.elapsed_s, time.elapsed_s);
            let problem =
                format!("after iteration {at} the checkpoint has trained for {ours} s, {METRICS} for {theirs} s");
            return Err(RunError::Mixed { path: path.to_owned(), problem });
        }
        if line.iteration > next {
            missing.push((next, line.iteration - 1));
        }
        next = line.iteration + 1;
        kept.extend_from_slice(text.as_bytes());
        kept.push(b'\n');
    }
    if next <= run.iteration {
        missing.push((next, run.iteration));
    }
    let ranges: Vec<String> = missing
        .iter()
        .map(|(from, to)| if from == to { from.to_string() } else { format!("{from} to {to}") })
        .collect();
    let lost = format!("{} lacks iterations {} of {}: they are lost", file.display(), ranges.join(", "), run.iteration);
    Ok((kept, (!missing.is_empty()).then_some(lost)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Creates a folder with metrics and a checkpoint of iteration 3 after 1.5 s.
    fn folder(metrics: &str) -> (tempfile::TempDir, Checkpoint) {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(METRICS), metrics).unwrap();
        let mut config = Config::load("fast").unwrap();
        (config.ppo.batch_size, config.ppo.minibatch_size, config.ppo.environments) = (4, 4, 1);
        config.ppo.hidden_layers = vec![2];
        let mut checkpoint = Trainer::new("test", config, 0, 1).unwrap().checkpoint().unwrap();
        (checkpoint.run.iteration, checkpoint.run.elapsed_s) = (3, 1.5);
        (folder, checkpoint)
    }

    fn lines(iterations: &[u64]) -> String {
        let line = |k: &u64| format!("{{\"iteration\":{k},\"time\":{{\"elapsed_s\":{}}}}}\n", 0.5 * *k as f64);
        iterations.iter().map(line).collect()
    }

    #[test]
    fn metrics_end_at_checkpoint_and_losses_are_reported() {
        for (found, kept, lost) in [
            (lines(&[1, 2, 3, 4]) + "{\"iter", &[1, 2, 3][..], None),
            (lines(&[1, 3]), &[1, 3], Some("lacks iterations 2 of 3")),
            (lines(&[1]) + "cut\n", &[1], Some("lacks iterations 2 to 3 of 3")),
            (String::new(), &[], Some("lacks iterations 1 to 3 of 3")),
            (lines(&[1, 2, 3, 1, 2, 3]), &[1, 2, 3], None),
        ] {
            let (folder, checkpoint) = folder(&found);
            let (text, note) = metrics_up_to(folder.path(), &checkpoint).unwrap();
            assert_eq!(String::from_utf8(text).unwrap(), lines(kept));
            assert_eq!(note.is_some(), lost.is_some(), "{note:?}");
            assert!(note.as_deref().unwrap_or("").contains(lost.unwrap_or("")), "{note:?}");
        }
    }
}
