//! The program `robot`: both sides of the Go2's own interface.

mod check;
mod run;

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use supple::util::terminal;
use supple_robot::bridge;
use supple_robot::serve::{Settings, play};

/// Run policies on a Go2, or simulate a Go2 for any controller.
#[derive(Parser, Debug)]
#[command(name = env!("CARGO_BIN_NAME"), version = supple::provenance::version())]
struct Program {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand, Debug)]
enum What {
    /// Simulate a Go2 that is as strict as a real one
    ///
    /// Publishes rt/lowstate at 500 Hz and obeys rt/lowcmd, in real time. Without a scenario, the robot is on a plane until Ctrl-C. With
    /// one, a simulated operator presses START on the remote, for the client to stand up, then A, which starts its policy and the scenario.
    /// The sticks stay at the scenario's command.
    Serve(Settings),
    /// Run a policy on the robot
    ///
    /// The robot lies at first. Orders come from keys, from lines of JSON on standard input or from UDP, and from the robot's own
    /// remote: START stands up, A starts the policy, X lies down, SELECT or L2 with B damps at once.
    Run(bridge::Settings),
    /// Play `run` and `serve` together without a network
    ///
    /// Runs as fast as the machine allows, and gives the same numbers each time.
    Rehearse(check::Rehearse),
    /// Find mismatches between a policy and a robot in a log
    ///
    /// Replays the policy on the log's readings, compares its joint targets with those that were sent, and names the mismatches: order or
    /// sign of joints, degrees, frames, gains, a delay. The exit code is 1 if there is one.
    Check(check::Check),
}

/// Returns a flag that Ctrl-C and termination set.
fn stop_flag() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let set = Arc::clone(&stop);
    ctrlc::set_handler(move || set.store(true, Ordering::Relaxed)).context("cannot catch Ctrl-C")?;
    Ok(stop)
}

/// Serves until the scenario ends or Ctrl-C.
fn serve(settings: &Settings) -> Result<()> {
    let stop = stop_flag()?;
    let summary = play(settings, &stop)?;
    let told = if settings.json { format!("{}\n", summary.to_json()) } else { summary.text() };
    Ok(terminal::print(told)?)
}

fn main() -> ExitCode {
    supple::announce_revision!();
    let Program { what } = Program::parse();
    let mut fits = true;
    let code = terminal::conclude(match what {
        What::Serve(settings) => serve(&settings),
        What::Run(args) => run::run(&args),
        What::Rehearse(args) => check::run_rehearsal(&args),
        What::Check(args) => check::run(&args).map(|verdict| fits = verdict),
    });
    if fits { code } else { ExitCode::from(1) }
}
