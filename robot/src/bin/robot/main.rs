//! The program `robot`: the Go2's own interface, on both sides of it.

mod check;
mod run;
mod serve;

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;
use clap::{Args, Parser, Subcommand};
use supple::util::terminal;
use supple_robot::dds::{NodeError, Place};

/// Bring policies onto a Go2, or be a simulated Go2 for any controller.
#[derive(Parser, Debug)]
#[command(name = "robot", version)]
struct Program {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand, Debug)]
enum What {
    /// Be the robot: a simulated Go2 as strict as a real one
    Serve(serve::Serve),
    /// Bring a policy onto the robot
    Run(run::Run),
    /// Play both without a network
    Rehearse(check::Rehearse),
    /// Find out from a log what does not fit between a policy and a robot
    Check(check::Check),
}

/// The place in the network.
#[derive(Args, Debug)]
#[command(next_help_heading = "Network")]
struct Network {
    /// Network interface, by name or address; nothing is sent on any other
    #[arg(long, value_name = "NAME|ADDRESS", default_value = "lo")]
    interface: String,
    /// DDS domain: 0 for a Go2; simulators use 1
    #[arg(long, value_name = "N", default_value_t = 1)]
    domain: u16,
    /// Address to announce to, for networks without multicast; may be repeated [default: itself, on a loopback interface]
    #[arg(long, value_name = "ADDRESS")]
    peer: Vec<std::net::Ipv4Addr>,
}

impl Network {
    fn place(&self) -> Result<Place, NodeError> {
        Place::new(&self.interface, self.domain, self.peer.clone())
    }
}

/// Returns a flag that Ctrl-C and termination set.
fn stop_flag() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let set = Arc::clone(&stop);
    ctrlc::set_handler(move || set.store(true, Ordering::Relaxed)).context("cannot catch Ctrl-C")?;
    Ok(stop)
}

fn main() -> ExitCode {
    supple::announce_revision!();
    let Program { what } = Program::parse();
    let mut fits = true;
    let code = terminal::conclude(match what {
        What::Serve(args) => serve::run(&args),
        What::Run(args) => run::run(&args),
        What::Rehearse(args) => check::run_rehearsal(&args),
        What::Check(args) => check::run(&args).map(|verdict| fits = verdict),
    });
    if fits { code } else { ExitCode::from(1) }
}
