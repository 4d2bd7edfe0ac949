//! `policy`: look at a policy file, check it, and hand it to other runtimes.

mod card;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::{Parser, Subcommand, ValueEnum};
use supple::policies;
use supple::policy::Policy;
use supple::{files, onnx, terminal};

/// Look at a policy, check it, export it.
#[derive(Parser)]
#[command(version)]
struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Print what the policy sees, what its outputs mean and where it came from
    Show {
        /// Policy file, run folder, or name of a shipped policy
        policy: String,
        /// Print the metadata as JSON
        #[arg(long)]
        json: bool,
    },
    /// Recompute the golden pairs of observation and joint targets stored in the file
    Verify {
        /// Policy file, run folder, or name of a shipped policy
        policy: String,
    },
    /// Print the card that ships with a policy: where it came from, how it learned, how it walks (Markdown)
    Card {
        /// Folder of the run
        run: PathBuf,
        /// Name that it ships under
        #[arg(long)]
        name: String,
    },
    /// Write the policy in another format
    Export {
        /// Policy file, run folder, or name of a shipped policy
        policy: String,
        /// Format to write
        #[arg(long, value_enum)]
        format: Format,
        /// File to write
        #[arg(long)]
        out: PathBuf,
    },
}

#[derive(ValueEnum, Clone, Copy)]
enum Format {
    /// One graph from raw observation to joint targets
    Onnx,
}

fn main() -> ExitCode {
    match run(Args::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            terminal::note(format_args!("error: {}", terminal::complaint(error.as_ref())));
            ExitCode::from(2)
        }
    }
}

fn run(command: Command) -> anyhow::Result<()> {
    match command {
        Command::Show { policy, json: true } => {
            terminal::print(format_args!("{}\n", policies::find(&policy)?.metadata_json()))?
        }
        Command::Show { policy, json: false } => terminal::print(description(&policies::find(&policy)?))?,
        Command::Verify { policy } => {
            // Reading a policy checks everything in it, the golden pairs included.
            let policy = policies::find(&policy)?;
            let sha256 = policy.sha256();
            terminal::print(format_args!("sound: its golden joint targets are reproduced; sha256 {sha256}\n"))?;
        }
        Command::Card { run, name } => terminal::print(card::card(&run, &name)?)?,
        Command::Export { policy, format: Format::Onnx, out } => {
            let bytes = onnx::export(&policies::find(&policy)?);
            files::write_atomically(&out, &bytes).with_context(|| format!("cannot write {}", out.display()))?;
        }
    }
    Ok(())
}

fn description(policy: &Policy) -> String {
    let provenance = &policy.provenance;
    let widths: Vec<String> = std::iter::once(policy.actor.inputs())
        .chain(policy.actor.layers.iter().map(|layer| layer.outputs()))
        .map(|width| width.to_string())
        .collect();
    let simulation = &policy.simulation;
    let mut text = format!(
        "trained   {} samples, config {}, seed {}, git {}, MuJoCo {}\n\
         sha256    {}\n\
         network   {}, ELU\n\
         rates     policy {} Hz, PD law {} Hz with Kp {} N m/rad, Kd {} N m s/rad, target delayed by {} s\n\
         action    joint target [rad] = nominal pose + {} * output\n\
         \nobservation ({} numbers)\n",
        provenance.samples,
        provenance.config_name,
        provenance.seed,
        provenance.git_revision,
        provenance.mujoco_version,
        policy.sha256(),
        widths.join(" > "),
        simulation.policy_rate_hz,
        simulation.physics_rate_hz,
        simulation.kp_n_m_per_rad,
        simulation.kd_n_m_s_per_rad,
        simulation.latency_s,
        policy.scale_rad,
        policy.actor.inputs(),
    );
    let mut start = 0;
    for block in supple::policy::layout_info() {
        let when = if block.age == 0 { "now" } else { "one step ago" };
        let name = format!("{:?}", block.quantity);
        text.push_str(&format!("  {start:3} {:3}  {name:22} {:16} {when}\n", block.length, block.unit));
        start += block.length;
    }
    text.push_str("\njoints, nominal pose [rad]\n");
    for (joint, angle) in policy.nominal_pose.iter().enumerate() {
        text.push_str(&format!("  {:2}  {:10} {angle:+.4}\n", joint, supple::go1::joint_name(joint)));
    }
    text
}
