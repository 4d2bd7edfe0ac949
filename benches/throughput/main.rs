/*! How fast this machine simulates, learns and senses, measured in one run, so that ratios can be trusted where times cannot.

`cargo bench --bench throughput` prints a table, `-- --json` the same figures as one JSON object, `-- --quick` only shows
that everything runs. PyTorch and Stable-Baselines3 are measured as well once `benches/peers/setup` has installed them.
docs/performance.md says what the figures mean; `scripts/scaling` measures other numbers of threads, seeds and evaluation.
*/

mod learner;
mod peers;
mod physics;
mod sensing;

use std::time::Instant;

use anyhow::Context;
use clap::Parser;
use supple::config::Config;
use supple::policy::shipped;
use supple::scenario::Playback;
use supple::scenario::catalog::Scenario;
use supple::train::Trainer;

/// Measures how fast physics, learner, training, ball pit and sensing are.
#[derive(Parser)]
struct Args {
    /// Print one JSON object and nothing else
    #[arg(long)]
    json: bool,
    /// Little work and one repetition: shows that everything runs, measures nothing
    #[arg(long)]
    quick: bool,
    /// Given by `cargo bench`; without it, as under `cargo test --benches`, everything is quick
    #[arg(long, hide = true)]
    bench: bool,
}

/// The amount of work behind the figures.
struct Effort {
    /// Repetitions behind a median.
    repetitions: usize,
    environments: usize,
    /// Policy steps of each environment in a repetition.
    steps: usize,
    /// Policy steps before those, so that environments are in different stages.
    warm_up_steps: usize,
    epochs: usize,
    pit_s: f64,
}

/// One batch of Table III for each repetition.
const FULL: Effort =
    Effort { repetitions: 5, environments: 64, steps: 128, warm_up_steps: 240, epochs: 30, pit_s: 15.0 };

const QUICK: Effort = Effort { repetitions: 1, environments: 8, steps: 64, warm_up_steps: 0, epochs: 1, pit_s: 0.2 };

/// Names and values, in the order of measurement.
#[derive(Default)]
struct Figures(Vec<(String, f64)>);

impl Figures {
    /// Notes the median of the repetitions' values: the upper one of two.
    fn note(&mut self, name: impl Into<String>, values: impl IntoIterator<Item = f64>) {
        let mut values: Vec<f64> = values.into_iter().collect();
        values.sort_by(f64::total_cmp);
        self.0.push((name.into(), values.get(values.len() / 2).copied().unwrap_or(f64::NAN)));
    }

    fn get(&self, name: &str) -> f64 {
        self.0.iter().find(|(known, _)| known == name).map_or(f64::NAN, |(_, value)| *value)
    }
}

/// Returns the time that `work` takes [s], and its result.
fn timed<T>(work: impl FnOnce() -> anyhow::Result<T>) -> anyhow::Result<(f64, T)> {
    let started = Instant::now();
    let result = work()?;
    Ok((started.elapsed().as_secs_f64(), result))
}

fn main() -> anyhow::Result<()> {
    supple::announce_revision!();
    let args = Args::parse();
    let is_quick = args.quick || !args.bench;
    let effort = if is_quick { QUICK } else { FULL };
    let config = Config::load("compliant")?;
    let threads = std::thread::available_parallelism()?.get();
    let (program, mut figures) = (supple::provenance::revision_and_mujoco(), Figures::default());
    figures.note("threads", [threads as f64]);
    // Above a few hundredths of the threads, only ratios mean anything.
    let load = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    figures.note("load_before", load.split(' ').next().and_then(|load| load.parse().ok()));
    physics::measure(&config, threads, &effort, &mut figures).context("physics")?;
    learner::measure(&config, threads, &effort, &mut figures).context("learner")?;
    iterations(&config, threads, &effort, &mut figures).context("iterations")?;
    ball_pit(&effort, &mut figures).context("ball pit")?;
    sensing::measure(&config, effort.repetitions, &mut figures).context("sensing")?;
    if !is_quick {
        peers::measure(&config, threads, &effort, &mut figures).context("peers")?;
    }
    if args.json {
        let mut object: serde_json::Map<_, _> =
            figures.0.into_iter().map(|(name, value)| (name, value.into())).collect();
        object.extend([("program".to_owned(), program.into()), ("is_quick".to_owned(), is_quick.into())]);
        println!("{}", serde_json::Value::Object(object));
        return Ok(());
    }
    println!("{program}: {}", if is_quick { "a quick run: figures mean nothing" } else { "medians of 5 repetitions" });
    for (name, value) in figures.0 {
        let digits = if value.abs() < 1000.0 { 3 } else { 0 };
        println!("{name:<36}{value:>14.digits$}");
    }
    Ok(())
}

/// Measures whole iterations, as training runs them. The first fills caches and is not counted.
fn iterations(config: &Config, threads: usize, effort: &Effort, figures: &mut Figures) -> anyhow::Result<()> {
    let mut config = config.clone();
    config.ppo.epochs = effort.epochs;
    let batch_size = config.ppo.batch_size as f64;
    let mut trainer = Trainer::new("throughput", config, 0, threads)?;
    trainer.iterate()?;
    let iterate = |_| timed(|| Ok(trainer.iterate()?.time));
    let times = (0..effort.repetitions).map(iterate).collect::<anyhow::Result<Vec<_>>>()?;
    figures.note("samples_per_s", times.iter().map(|(whole_s, _)| batch_size / whole_s));
    figures.note("rollout_s", times.iter().map(|(_, time)| time.rollout_s));
    figures.note("update_s", times.iter().map(|(_, time)| time.update_s));
    Ok(())
}

/// Measures the ball pit against the clock: physics and policy, as the program `scenario` plays it.
fn ball_pit(effort: &Effort, figures: &mut Figures) -> anyhow::Result<()> {
    let agent = shipped::find("compliant")?;
    let scenario = Scenario::named("ball-pit", &format!("duration_s: {}", effort.pit_s))?;
    let script = scenario.script(0, &agent.config)?;
    let play = |_| -> anyhow::Result<f64> {
        let playback = Playback::new(&script, &agent.config, agent.controller())?;
        let (elapsed_s, trace) = timed(|| Ok(playback.trace()))?;
        anyhow::ensure!(trace.fault().is_none(), "{:?}", trace.fault());
        Ok(trace.frames.len() as f64 * trace.period_s / elapsed_s)
    };
    figures.note("ball_pit_real_time", (0..effort.repetitions).map(play).collect::<anyhow::Result<Vec<_>>>()?);
    Ok(())
}
