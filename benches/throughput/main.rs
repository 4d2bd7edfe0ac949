/*! How fast everything is, measured in one run on one machine, so that ratios can be trusted where times cannot.

`cargo bench --bench throughput` prints a table, `-- --json` the same figures as one JSON object, `-- --quick` only shows
that everything runs. Physics, learner, whole iterations, the ball pit and the sensing path are always measured; PyTorch and
Stable-Baselines3 as well once `benches/peers/setup` has installed them. docs/performance.md says what the figures mean.
*/

mod estimator;
mod learner;
mod machine;
mod peers;
mod physics;
mod pit;
mod replay;
mod report;
mod stopwatch;
mod training;

use std::process::ExitCode;

use anyhow::Context;
use clap::Parser;
use supple::config::Config;
use supple::policy::shipped;

use machine::{Machine, Ticks};
use report::Report;
use stopwatch::Effort;

/// Measure how fast physics, learner, training and the ball pit are.
#[derive(Parser)]
struct Args {
    /// Print one JSON object and nothing else
    #[arg(long)]
    json: bool,
    /// Little work and one repetition: shows that everything runs, measures nothing
    #[arg(long)]
    quick: bool,
    /// Policy that moves the robot: a file, a run's folder, or a shipped one
    #[arg(long, value_name = "NAME", default_value = "compliant")]
    policy: String,
    /// Leave the peers out even if they are installed
    #[arg(long)]
    no_peers: bool,
    /// Given by `cargo bench`; without it, as under `cargo test --benches`, everything is quick
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> ExitCode {
    supple::announce_revision!();
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(args: &Args) -> anyhow::Result<()> {
    let effort = if args.quick || !args.bench { Effort::quick() } else { Effort::full() };
    let config = Config::load("compliant")?;
    let policy = shipped::find_ours(&args.policy)?;
    let threads = std::thread::available_parallelism().map_or(1, |cores| cores.get());

    let start = Ticks::now();
    eprintln!("physics and environment …");
    let physics = physics::measure(&config, &policy, threads, &effort).context("physics")?;
    eprintln!("learner …");
    let learner = learner::measure(&config, threads, &effort).context("learner")?;
    eprintln!("whole iterations …");
    let training = training::measure(&config, threads, &effort).context("training")?;
    eprintln!("ball pit …");
    let pit = pit::measure(&policy, &config, &effort).context("ball pit")?;
    eprintln!("sensing …");
    let sensing = estimator::measure(&config, &effort).context("sensing")?;
    let peers = if args.no_peers { None } else { peers::measure(&config, threads, &effort).context("peers")? };

    let machine = Machine::new(threads, &effort, start);
    let report = Report::new(machine, physics, learner, training, pit, sensing, peers);
    if args.json {
        println!("{}", serde_json::to_string(&report)?);
    } else {
        println!("{report}");
    }
    Ok(())
}
