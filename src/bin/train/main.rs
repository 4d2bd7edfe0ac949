//! The program `train`: trains a policy from scratch or from a checkpoint, by the method of section III.

mod several;
mod start;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, ensure};
use clap::Parser;
use several::Seeds;
use start::{is_common, join, resume, start, together};
use supple::ranks::{Ranks, any};
use supple::train::environment::EpisodeFault;
use supple::train::metrics::IterationMetrics;
use supple::train::run::RunFolder;
use supple::train::{TrainError, Trainer};
use supple::util::progress::{ProgressBar, pace, progress};
use supple::util::terminal::{self, shell_word};

/// Train a policy to walk, to yield when pushed, and to get up to speed again.
///
/// Metrics go to DIR/metrics.jsonl and to TensorBoard event files in DIR, the policy to DIR/policy.safetensors. Ctrl-C finishes the
/// iteration, writes a checkpoint and prints how to resume; a second one stops at once.
#[derive(Parser, Clone)]
#[command(name = env!("CARGO_BIN_NAME"), version = supple::provenance::version())]
struct Args {
    /// Configuration: fast, fast-baseline, compliant, baseline, real, go2, go2-baseline, go2-real, or a YAML file; with --resume, refuse to
    /// continue a run of another one [default: fast]
    #[arg(long, value_name = "NAME|FILE")]
    config: Option<String>,
    /// Robot to train on, to which the configuration is fitted: an MJCF file, or a YAML file that describes one
    #[arg(long, value_name = "FILE", conflicts_with = "resume")]
    robot: Option<String>,
    /// Another value for a key of the configuration, as in ppo.epochs=4; may be repeated
    #[arg(long, value_name = "KEY=VALUE", conflicts_with = "resume")]
    set: Vec<String>,
    /// Seed of everything random in the run [default: 0]
    #[arg(long, value_name = "N", conflicts_with = "resume")]
    seed: Option<u64>,
    /// Train several seeds beside one another, as 0-4 or 0,3,7; the same command resumes those that are not complete
    #[arg(long, value_name = "LIST", conflicts_with_all = ["resume", "seed"], value_parser = Seeds::parse)]
    seeds: Option<Seeds>,
    /// Train a variant for each value of a key, as in reward.energy=-0.01,-0.02, or for each name in a YAML file
    #[arg(long, value_name = "KEY=VALUES|FILE", conflicts_with = "resume")]
    vary: Option<String>,
    /// With --seeds or --vary: the number of runs that are trained at once [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    at_once: Option<u16>,
    #[arg(skip)]
    is_one_of_several: bool,
    /// Samples of the whole run; a resumed run keeps its own by default [default: the configuration's]
    #[arg(long, value_name = "N")]
    samples: Option<u64>,
    /// Folder of the new run, must not exist [default: runs/CONFIG-seedN]; for several runs, the part before -seedN
    #[arg(long, value_name = "DIR", conflicts_with = "resume")]
    out: Option<PathBuf>,
    /// Resume the run in this folder, exactly from its checkpoint
    #[arg(long, value_name = "DIR")]
    resume: Option<PathBuf>,
    /// Worker threads of each run; the result does not depend on them [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Under mpirun: end all ranks when one has waited for another for this time (s)
    #[cfg(feature = "mpi")]
    #[arg(long, value_name = "S", default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..))]
    rank_timeout: u64,
}

fn main() -> ExitCode {
    supple::robot::isolate_imports();
    supple::announce_revision!();
    let args = Args::parse();
    let ranks = match join(&args) {
        Ok(ranks) => ranks,
        Err(error) => return terminal::conclude(Err::<(), _>(error)),
    };
    match run(args, &ranks) {
        Err(error) if ranks.count() > 1 && !is_common(&error) => {
            // The other ranks have no error yet; the end of this process ends them.
            terminal::conclude(Err::<(), _>(error.context(ranks.name(ranks.index()))));
            std::process::exit(2)
        }
        Err(_) if ranks.index() > 0 => ExitCode::from(2),
        outcome => terminal::conclude(outcome),
    }
}

fn run(args: Args, ranks: &Arc<dyn Ranks>) -> anyhow::Result<()> {
    let (stop, training) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
    stop_on_signals(Arc::clone(&stop), Arc::clone(&training), ranks.index() == 0)?;

    let cores = std::thread::available_parallelism().map_or(1, |cores| cores.get());
    if args.seeds.is_some() || args.vary.is_some() {
        ensure!(ranks.is_alone(), "--seeds and --vary train on one machine: under mpirun, give each run a command");
        return several::train_all(&args, cores, &stop, &training);
    }
    let threads = args.threads.map_or(cores, usize::from);
    let (mut trainer, mut folder) = match &args.resume {
        Some(path) => resume(path, &args, threads, ranks)?,
        None => start(&args, threads, &training, ranks)?,
    };
    training.store(true, Ordering::Relaxed);
    let bar = if folder.is_some() { progress(trainer.run().config.run.samples) } else { ProgressBar::hidden() };
    let outcome = train(&mut trainer, &mut folder, &stop, &bar)?;
    if folder.is_some() {
        terminal::note(outcome);
    }
    Ok(())
}

/// Trains a run until it is complete or `stop` is set. Returns how far it has come.
fn train(
    trainer: &mut Trainer,
    folder: &mut Option<RunFolder>,
    stop: &AtomicBool,
    bar: &ProgressBar,
) -> anyhow::Result<String> {
    let total = trainer.run().config.run.samples;
    let mut saved = trainer.run().iteration;
    let outcome = iterate(trainer, folder, total, (stop, bar), &mut saved);
    let Some(folder) = folder else { return outcome.map(|()| String::new()) };
    let path = folder.path().display();
    if let Err(error) = outcome {
        let way_on = if !folder.path().exists() {
            format!("{path} was removed while training, and the run with it")
        } else if matches!(error.downcast_ref(), Some(TrainError::Learner { .. })) {
            "resuming would fail the same way; start a new run with another --seed or a lower learning rate \
             (ppo.max_learning_rate, ppo.desired_kl)"
                .to_owned()
        } else {
            format!("the checkpoint of iteration {saved} is complete, resume from it with: {}", resuming(folder.path()))
        };
        return Err(error.context(format!("stopped; {way_on}")));
    }
    let samples = trainer.run().samples;
    Ok(if samples < total {
        format!("stopped after {samples} samples; resume with: {}", resuming(folder.path()))
    } else {
        format!("done: {samples} samples; the policy is {path}/policy.safetensors")
    })
}

/// Returns the shell command that resumes a run.
fn resuming(folder: &Path) -> String {
    let program = std::env::args_os().next().unwrap_or_else(|| "train".into());
    format!("{} --resume {}", shell_word(program), shell_word(folder))
}

/// Iterates until `total` samples are collected or `stop` is set; `saved` is the iteration of the newest checkpoint.
fn iterate(
    trainer: &mut Trainer,
    folder: &mut Option<RunFolder>,
    total: u64,
    (stop, bar): (&AtomicBool, &ProgressBar),
    saved: &mut u64,
) -> anyhow::Result<()> {
    let every = trainer.run().config.run.checkpoint_every;
    bar.set_position(trainer.run().samples);
    bar.reset_eta();
    let (begun, first) = (Instant::now(), trainer.run().samples);
    while trainer.run().samples < total && !any(trainer.ranks(), stop.load(Ordering::Relaxed)) {
        let metrics = trainer.iterate().map_err(|error| explain(error, folder.as_ref()))?;
        let logged =
            folder.as_mut().map_or(Ok(()), |folder| folder.log(&metrics).and_then(|()| folder.keep_policy(trainer)));
        together(trainer.ranks(), logged.map_err(anyhow::Error::from))?;
        if let Some(folder) = folder {
            keep_physics_faults(trainer, folder, bar);
        }
        bar.set_position(metrics.samples);
        bar.set_message(format!("{}{}", bar.prefix(), summary(&metrics)));
        if metrics.iteration % every == 0 {
            save(trainer, folder.as_ref())?;
            *saved = metrics.iteration;
            if bar.is_hidden() && folder.is_some() {
                // There is no terminal, as in the log of a batch job.
                let (samples, summary) = (metrics.samples, summary(&metrics));
                let left = total.saturating_sub(samples);
                let pace = pace(samples - first, begun.elapsed().as_secs_f64(), left, "samples");
                terminal::note(format_args!("{}{samples} of {total} samples: {summary}, {pace}", bar.prefix()));
            }
        }
    }
    bar.abandon();
    if *saved != trainer.run().iteration {
        save(trainer, folder.as_ref())?;
        *saved = trainer.run().iteration;
    }
    Ok(())
}

/// Writes checkpoint and policy on the rank that has the run's folder.
fn save(trainer: &Trainer, folder: Option<&RunFolder>) -> anyhow::Result<()> {
    let checkpoint = trainer.checkpoint()?;
    let saved = folder.map_or(Ok(()), |folder| folder.save(trainer, &checkpoint));
    together(trainer.ranks(), saved.map_err(anyhow::Error::from))
}

/// Handles signals: the first Ctrl-C (or SIGTERM, or SIGHUP) asks to stop. The second one, or one before training has begun, ends the
/// program at once; that is safe because the checkpoint on disk is always complete.
fn stop_on_signals(stop: Arc<AtomicBool>, training: Arc<AtomicBool>, speaks: bool) -> anyhow::Result<()> {
    let ask = move || {
        if !training.load(Ordering::Relaxed) {
            terminal::note("stopped before training began");
            std::process::exit(130);
        }
        stop.store(true, Ordering::Relaxed);
        if speaks {
            terminal::note("stopping after this iteration; once more to stop at once");
        }
    };
    let last_words = "stopped at once; the training after the last checkpoint is lost";
    terminal::on_signals(ask, last_words).context("cannot catch Ctrl-C")
}

/// Stores and reports the physics faults of an iteration. They never end the run.
fn keep_physics_faults(trainer: &Trainer, folder: &RunFolder, bar: &ProgressBar) {
    for fault in trainer.faults() {
        let EpisodeFault { error, environment, step, .. } = fault;
        let kept = match folder.keep_physics_fault(trainer.run().iteration, fault) {
            Ok(Some(file)) => format!("; its last second is in {}", file.display()),
            // Enough faults are stored, and enough were shown.
            Ok(None) => continue,
            Err(problem) => format!("; its last second could not be kept: {problem}"),
        };
        bar.suspend(|| {
            terminal::note(format_args!(
                "physics fault in environment {environment} after {step} steps: {error}{kept}"
            ));
        });
    }
}

/// Stores the report of a failed update next to the last good checkpoint, and adds its path to the error.
fn explain(error: TrainError, folder: Option<&RunFolder>) -> anyhow::Error {
    let (TrainError::Learner { minibatch, circumstances, .. }, Some(folder)) = (&error, folder) else {
        return error.into();
    };
    let kept = match folder.keep_learner_fault(minibatch, circumstances) {
        Ok(file) => format!("the diagnosis is in {} and fault-minibatch.csv beside it", file.display()),
        Err(problem) => format!("the diagnosis could not be saved: {problem}"),
    };
    anyhow::Error::from(error).context(format!("training failed; {kept}"))
}

fn summary(metrics: &IterationMetrics) -> String {
    let percent = |fraction: Option<f64>| fraction.map_or("-".into(), |fraction| format!("{:.0} %", 100.0 * fraction));
    let faults =
        if metrics.means.faults > 0 { format!(", {} PHYSICS FAULTS", metrics.means.faults) } else { String::new() };
    format!(
        "reward {:.2}, r_lin {}, falls {}, in flight {}, commands open {}, pushes {}{faults}",
        metrics.step_reward,
        percent(metrics.means.walking_linear),
        percent(metrics.means.fall_rate),
        percent(metrics.means.terms.map(|terms| terms.flight())),
        percent(Some(metrics.command_fraction)),
        percent(metrics.means.push_fraction),
    )
}
