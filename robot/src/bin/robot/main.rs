//! The program `robot`: the Go2's own interface, on both sides of it.

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

/// Bring policies onto a Go2, or be a simulated Go2 for any controller.
#[derive(Parser, Debug)]
#[command(name = env!("CARGO_BIN_NAME"), version = supple::provenance::version())]
struct Program {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand, Debug)]
enum What {
    /// Be the robot: a simulated Go2 as strict as a real one
    ///
    /// Publishes rt/lowstate at 500 Hz and obeys rt/lowcmd, in real time. Without a scenario, the robot is on the plane until Ctrl-C.
    /// With one, a simulated person with the remote presses START for the client to stand up and A for its policy to begin, when
    /// the scenario begins too, and keeps the sticks at the scenario's command.
    Serve(Settings),
    /// Bring a policy onto the robot
    ///
    /// The robot lies at first. Orders come from keys, from lines of JSON on standard input or from UDP, and from the robot's own
    /// remote: START stands up, A starts the policy, X lies down, SELECT or L2 with B damps at once.
    Run(bridge::Settings),
    /// Play both without a network
    ///
    /// Plays what `run` and `serve` would do together, as fast as the machine, with the same numbers each time.
    Rehearse(check::Rehearse),
    /// Find out from a log what does not fit between a policy and a robot
    ///
    /// Replays the policy on the log's readings, compares its joint targets with those that were sent, and names what does not
    /// fit: order or sign of joints, degrees, frames, gains, a delay. The exit code is 1 if something does not.
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
