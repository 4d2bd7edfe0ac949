//! Start and resumption of a run, alone or as one of several ranks.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use supple::config::Config;
use supple::provenance::{git_revision, mujoco_version};
use supple::ranks::{Alone, RankError, Ranks, agree};
use supple::robot::Robot;
use supple::train::checkpoint::Checkpoint;
use supple::train::run::RunFolder;
use supple::train::{MemoryEstimate, TrainError, Trainer};
use supple::util::{files, terminal};

use super::Args;

/// Environment variables of a process started as a rank: by Open MPI, MPICH and Intel MPI, and Slurm with PMIx.
#[cfg(feature = "mpi")]
const STARTED_BY_MPI: [&str; 3] = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK"];

/// Environment variables with the number of processes that were started together.
#[cfg(not(feature = "mpi"))]
const PROCESSES: [&str; 3] = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS"];

/// Default configuration.
const DEFAULT: &str = "fast";

/// Default number of shards, enough for as many ranks.
const SHARDS: usize = 8;

/// Estimated memory above which it is printed \[bytes\].
const WORTH_TELLING_BYTES: u64 = 1 << 30;

/// Returns the ranks of the run: those started by mpirun, or this process alone.
#[cfg(feature = "mpi")]
pub fn join(args: &Args) -> anyhow::Result<Arc<dyn Ranks>> {
    if !STARTED_BY_MPI.iter().any(|name| std::env::var_os(name).is_some()) {
        return Ok(Alone::shared());
    }
    Ok(Arc::new(supple::ranks::Mpi::join(std::time::Duration::from_secs(args.rank_timeout))?))
}

/// Returns this process alone: the program was built without MPI.
#[cfg(not(feature = "mpi"))]
pub fn join(_: &Args) -> anyhow::Result<Arc<dyn Ranks>> {
    let is_several = |name: &str| std::env::var(name).ok().and_then(|count| count.parse::<u32>().ok()) > Some(1);
    if let Some(name) = PROCESSES.into_iter().find(|name| is_several(name)) {
        anyhow::bail!(
            "this program was started as one of several ({name}), but cannot take part: build it with scripts/setup mpi && \
             cargo build --release --features mpi --bin train"
        );
    }
    Ok(Alone::shared())
}

/// Returns true for an error that all ranks have in common, so that one of them reports it.
pub fn is_common(error: &anyhow::Error) -> bool {
    error.is::<RankError>() || matches!(error.downcast_ref(), Some(TrainError::Rank(_) | TrainError::Learner { .. }))
}

/// Returns this rank's result if all ranks succeeded, else an error.
pub fn together<T>(ranks: &dyn Ranks, own: anyhow::Result<T>) -> anyhow::Result<T> {
    if ranks.count() > 1 {
        let told = own.as_ref().map(|_| ()).map_err(|error| anyhow::anyhow!(terminal::complaint(error.as_ref())));
        agree(ranks, told)?;
    }
    own
}

/// Starts a new run, and creates its folder on the first rank. `training` becomes true as soon as the run can be
/// stopped and resumed.
pub fn start(
    args: &Args,
    threads: usize,
    training: &AtomicBool,
    ranks: &Arc<dyn Ranks>,
) -> anyhow::Result<(Trainer, Option<RunFolder>)> {
    let (trainer, out) = together(&**ranks, new_trainer(args, threads, ranks))?;
    check_alike(&trainer)?;
    training.store(true, Ordering::Relaxed);
    let checkpoint = trainer.checkpoint()?;
    let folder = (ranks.index() == 0).then(|| RunFolder::create(&out, &trainer, &checkpoint)).transpose();
    let folder = together(&**ranks, folder.map_err(anyhow::Error::from))?;
    Ok((trainer, folder))
}

/// Checks that all ranks have the same program, configuration and seed.
fn check_alike(trainer: &Trainer) -> anyhow::Result<()> {
    if trainer.ranks().count() == 1 {
        return Ok(());
    }
    let program = std::env::current_exe().and_then(std::fs::read);
    let program = program.map_or_else(|error| error.to_string(), |bytes| files::sha256(&[&bytes]));
    let run = trainer.run();
    let mut facts = serde_json::to_value(&run.config)?;
    facts["seed"] = run.seed.into();
    facts["robot's checksum"] = run.robot_sha256.clone().into();
    facts["program"] = format!("revision {} with the checksum {program}", git_revision()).into();
    Ok(supple::ranks::check_alike(trainer.ranks(), facts)?)
}

/// Returns the name and the configuration that the arguments ask for; with `speaks`, prints how it is fitted to a robot.
pub fn configured(args: &Args, speaks: bool) -> anyhow::Result<(String, Config)> {
    let name = args.config.as_deref().unwrap_or(DEFAULT);
    // With --robot, --set applies after the configuration has been fitted.
    let set = if args.robot.is_some() { &[] } else { &args.set[..] };
    let (mut config, notes) = Config::load_with_notes(name, set)?;
    if speaks {
        notes.iter().for_each(|note| terminal::note(format_args!("note: {note}")));
    }
    let stem = |name: &str| {
        PathBuf::from(name).file_stem().map_or(name.to_owned(), |stem| stem.to_string_lossy().into_owned())
    };
    let mut name = stem(name);
    if let Some(model) = &args.robot {
        let robot = Robot::load(model)?;
        let fitted = config.fitted_to(&robot)?;
        if speaks {
            terminal::note(format_args!("{}\n{}", robot.description(), config.changes(&fitted)));
        }
        (config, name) = (fitted.with(&args.set)?, format!("{name}-{}", stem(model)));
    }
    config.run.samples = args.samples.unwrap_or(config.run.samples);
    Ok((name, config))
}

/// Creates the trainer of a new run, and returns the path for its folder.
fn new_trainer(args: &Args, threads: usize, ranks: &Arc<dyn Ranks>) -> anyhow::Result<(Trainer, PathBuf)> {
    let (name, mut config) = configured(args, ranks.index() == 0 && !args.is_one_of_several)?;
    let seed = args.seed.unwrap_or(0);
    let out = args.out.clone().unwrap_or_else(|| PathBuf::from(&format!("runs/{name}-seed{seed}")));
    if !ranks.is_alone() {
        config.ppo.shards = shards(config.ppo.shards, &args.set, ranks.count());
    }
    let memory = check_memory(&config, &**ranks)?;
    if memory.total() > WORTH_TELLING_BYTES && ranks.index() == 0 {
        terminal::note(format_args!("note: this run takes {memory}"));
    }
    Ok((Trainer::with_ranks(Arc::clone(ranks), &name, config, seed, threads)?, out))
}

/// Returns the number of shards of a new run on several ranks: that of the configuration, or enough for all ranks if it is 1, as in shipped
/// ones, and not set on the command line.
fn shards(configured: usize, changes: &[String], ranks: usize) -> usize {
    if may_be_raised(configured, changes) { ranks.max(SHARDS).next_power_of_two() } else { configured }
}

fn may_be_raised(shards: usize, changes: &[String]) -> bool {
    shards == 1 && !changes.iter().any(|change| change.starts_with("ppo.shards="))
}

/// Checks that the machine has enough memory for a run, and warns if it may have too little.
fn check_memory(config: &Config, ranks: &dyn Ranks) -> anyhow::Result<MemoryEstimate> {
    let memory = MemoryEstimate::new(config)?.for_ranks(ranks.here(), ranks.count());
    if let Some(shortage) = memory.check()? {
        terminal::note(format_args!("warning: {shortage}; continuing, as the system may free memory of its caches"));
    }
    Ok(memory)
}

/// Resumes the run in a folder, which the first rank opens.
pub fn resume(
    path: &Path,
    args: &Args,
    threads: usize,
    ranks: &Arc<dyn Ranks>,
) -> anyhow::Result<(Trainer, Option<RunFolder>)> {
    let opened = (ranks.index() == 0).then(|| read(path, args)).transpose();
    let opened = together(&**ranks, opened)?;
    // The first rank has read it and sends it to the others.
    let bytes = opened.as_ref().filter(|_| ranks.count() > 1).map(|(_, checkpoint)| checkpoint.to_bytes());
    let bytes = bytes.transpose().map_err(Into::into);
    let bytes = ranks.gather(together(&**ranks, bytes)?.unwrap_or_default()).concat();
    let (folder, checkpoint) = match opened {
        Some((folder, checkpoint)) => (Some(folder), Ok(checkpoint)),
        None => (None, Checkpoint::from_bytes(&bytes).map_err(Into::into)),
    };
    let checkpoint = together(&**ranks, checkpoint)?;
    let begun_with = checkpoint.run.robot_sha256.clone();
    together(&**ranks, check_memory(&checkpoint.run.config, &**ranks).map(drop))?;
    let trainer =
        together(&**ranks, Trainer::resume_with_ranks(Arc::clone(ranks), checkpoint, threads).map_err(Into::into))?;
    check_alike(&trainer)?;
    let (robot, model) = (&trainer.run().robot_sha256, &trainer.run().config.robot.model);
    if *robot != begun_with && ranks.index() == 0 {
        terminal::note(format_args!(
            "warning: the robot {model} has changed since the checkpoint, or this program reads it differently than \
             the one that wrote it: its SHA-256 was {begun_with:.12} and is {robot:.12}; the run continues with the \
             present robot; restore the old file to avoid that"
        ));
    }
    let written = folder.as_ref().map_or(Ok(()), |folder| {
        folder.save_config(&trainer)?;
        folder.save_policy(&trainer)
    });
    together(&**ranks, written.map_err(anyhow::Error::from))?;
    Ok((trainer, folder))
}

/// Opens the folder of a run and reads its checkpoint, on one rank.
fn read(path: &Path, args: &Args) -> anyhow::Result<(RunFolder, Checkpoint)> {
    let (folder, mut checkpoint, notes) = RunFolder::resume(path)?;
    notes.iter().for_each(|note| terminal::note(format_args!("warning: {note}")));
    if args.config.is_some() || args.is_one_of_several {
        let name = args.config.as_deref().unwrap_or(DEFAULT);
        let (_, mut config) = configured(args, false)?;
        if may_be_raised(config.ppo.shards, &args.set) {
            config.ppo.shards = checkpoint.run.config.ppo.shards;
        }
        let differs =
            |keys| anyhow::anyhow!("{} was not begun with {name}: {keys}; start anew with --out", path.display());
        checkpoint.run.config.check_same(&config).map_err(differs)?;
    }
    let planned = &mut checkpoint.run.config.run.samples;
    *planned = args.samples.unwrap_or(*planned);
    checkpoint.run.config.check()?;
    let begun_by = checkpoint.run.git_revision.clone();
    let revision = git_revision();
    if begun_by != revision {
        terminal::note(format_args!(
            "note: the checkpoint was written by revision {begun_by}, this program is {revision}: results may differ \
             from those of that revision"
        ));
    }
    let (begun_with, mujoco) = (&checkpoint.run.mujoco_version, mujoco_version());
    if !begun_with.is_empty() && begun_with != mujoco {
        terminal::note(format_args!(
            "note: the checkpoint was written with MuJoCo {begun_with}, this program runs with {mujoco}: results \
             differ from those with that version"
        ));
    }
    Ok((folder, checkpoint))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_share_as_many_shards_as_they_are_told_to() {
        let asked = |change: &str| [change.to_owned()];
        assert_eq!((shards(1, &[], 1), shards(1, &[], 3), shards(1, &[], 16)), (8, 8, 16));
        assert_eq!((shards(4, &[], 2), shards(1, &asked("ppo.epochs=4"), 2)), (4, 8));
        assert_eq!(shards(1, &asked("ppo.shards=1"), 1), 1);
    }
}
