//! The program `policy`: shows, checks and exports policy files.

mod card;
mod describe;
mod show;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::{Parser, Subcommand, ValueEnum};
use nalgebra::Vector3;
use supple::config::Config;
use supple::observation::Command;
use supple::policy::compliance::{CompliantObservations, PolicyCalibration};
use supple::policy::{Agent, Controller as _, InferenceBuffers, Policy, Provenance};
use supple::policy::{external, onnx, shipped};
use supple::robot::{GRAVITY_M_S2, JOINTS, Joints, Robot, RobotState, joint_name};
use supple::scenario::calibration::calibrate;
use supple::util::files::{self, Target};
use supple::util::terminal;

/// Show a policy, check it, export it.
#[derive(Parser)]
#[command(name = env!("CARGO_BIN_NAME"), version = supple::provenance::version())]
struct Args {
    #[command(subcommand)]
    command: PolicyCommand,
}

#[derive(Subcommand)]
enum PolicyCommand {
    /// List the policies that ship with this program
    List,
    /// Print what the policy observes, what its outputs mean and how it was trained
    Show {
        /// Policy file, run folder, YAML file of an external policy, or name of a shipped policy
        policy: String,
        /// Print the metadata as JSON
        #[arg(long)]
        json: bool,
    },
    /// Recompute the golden pairs of observation and joint targets stored in the file; of an external policy, which has none,
    /// the joint targets in its nominal pose
    Verify {
        /// Policy file, run folder, YAML file of an external policy, or name of a shipped policy
        policy: String,
        /// Configuration with which the policy must have been trained
        #[arg(long, value_name = "FILE")]
        config: Option<String>,
        /// Another value for a key of that configuration, as in ppo.epochs=4; may be repeated
        #[arg(long, value_name = "KEY=VALUE", requires = "config")]
        set: Vec<String>,
        /// Smallest number of samples with which the policy must have been trained
        #[arg(long, value_name = "N", default_value_t = 0)]
        samples: u64,
    },
    /// Print joint targets (rad) for observations given on standard input, each a JSON array on a line; with --compliance, each
    /// line is {"observation": [...], "force_n": [forward, left]} with the force on the trunk, mean over the last policy step
    Run {
        /// Policy file, run folder, YAML file of an external policy, or name of a shipped policy
        policy: String,
        /// Commanded compliance (m/s/N); observations must then be consecutive policy steps
        #[arg(long, value_name = "C")]
        compliance: Option<f64>,
    },
    /// Print a policy's card: origin, learning curve if the run's folder has it, test walks (Markdown)
    Card {
        /// Run folder, policy file, or name of a shipped policy
        policy: String,
        /// Name under which the policy ships [default: the folder's, the file's or its own]
        #[arg(long)]
        name: Option<String>,
    },
    /// Measure the policy's compliance, and write the calibration that `--compliance` needs next to it
    Calibrate {
        /// Policy file, run folder, YAML file of an external policy, or name of a shipped policy
        policy: String,
        /// Threads [default: all cores]
        #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
        threads: Option<u16>,
        /// File to write [default: NAME.calibration.json next to the policy, where programs look for it]
        #[arg(long)]
        out: Option<PathBuf>,
    },
    /// Print what is read from a robot's file, and how a configuration is fitted to it
    Robot {
        /// Shipped robot, MJCF file, or YAML description of one
        robot: String,
        /// Configuration to adapt to it
        #[arg(long, value_name = "FILE", default_value = "fast")]
        config: String,
    },
    /// Write the YAML file of an external policy from the file of its framework, and check it with the network
    Describe {
        /// deploy.yaml of unitree_rl_lab or unitree_rl_mjlab, or ONNX file with the metadata of mjlab's or an Isaac Lab project's
        /// exporter
        source: PathBuf,
        /// ONNX file of the policy [default: that one, or ../exported/policy.onnx beside deploy.yaml]
        #[arg(long, value_name = "FILE")]
        onnx: Option<PathBuf>,
        /// Robot of the policy, as the YAML file names it [default: go2]
        #[arg(long, value_name = "ROBOT")]
        robot: Option<String>,
        /// YAML file to write, `-` for standard output; one that exists is not replaced
        #[arg(long)]
        out: PathBuf,
    },
    /// Average the weights of the last policies that a run kept, which differ by chance
    Mean {
        /// Policy files of one run
        #[arg(required = true)]
        policies: Vec<PathBuf>,
        /// Policy file to write
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
    /// Write the policy in another format
    Export {
        /// Policy file, run folder, or name of a shipped policy
        policy: String,
        /// Format to write
        #[arg(long, value_enum)]
        format: ExportFormat,
        /// File to write, `-` for standard output
        #[arg(long)]
        out: PathBuf,
    },
}

/// Maximum length of a line of observations \[bytes\].
const MAX_LINE_BYTES: u64 = 1 << 20;

/// Maximum size of a description to overwrite \[bytes\].
const MAX_DESCRIPTION_BYTES: u64 = 1 << 20;

#[derive(ValueEnum, Clone, Copy)]
enum ExportFormat {
    /// One graph from raw observation to joint targets, and a YAML file that describes both
    Onnx,
}

fn main() -> ExitCode {
    supple::robot::isolate_imports();
    supple::announce_revision!();
    terminal::conclude(run(Args::parse().command))
}

fn run(command: PolicyCommand) -> anyhow::Result<()> {
    match command {
        PolicyCommand::Show { policy: name, json } => {
            let agent = shipped::find_uncalibrated(&name)?;
            terminal::print(match (agent.policy(), json) {
                (Some(policy), true) => format!("{}\n", policy.metadata_json()),
                (Some(policy), false) => show::description(policy),
                (None, true) => format!("{}\n", show::external_json(&name, &agent)),
                (None, false) => show::external_description(&name, &agent),
            })?;
        }
        PolicyCommand::Verify { policy: name, config, set, samples } => {
            // Reading a policy checks everything in it, the golden pairs included.
            let agent = shipped::find_uncalibrated(&name)?;
            let Some(policy) = agent.policy() else {
                let asked = if config.is_some() { Some("--config") } else { (samples > 0).then_some("--samples") };
                if let Some(asked) = asked {
                    anyhow::bail!("{name} is an external policy, whose training is unknown: leave out {asked}");
                }
                return verify_external(&name, &agent);
            };
            let (found, sha256) = (&policy.provenance, policy.sha256());
            if let Some(config) = config {
                let differs = |keys| anyhow::anyhow!("{name} does not come from {config}: {keys}");
                found.config.check_same(&Config::load_with(&config, &set)?.without_folder()).map_err(differs)?;
            }
            let learnt = found.samples;
            anyhow::ensure!(learnt >= samples, "{name} has learnt from {learnt} samples, expected {samples} or more");
            terminal::print(format_args!("sound: its golden joint targets are reproduced; sha256 {sha256}\n"))?;
        }
        PolicyCommand::Calibrate { policy, threads, out } => {
            let threads =
                threads.map_or_else(|| std::thread::available_parallelism().map_or(1, usize::from), usize::from);
            let mut agent = shipped::find_uncalibrated(&policy)?;
            // A wrong path fails now, not after minutes of work.
            let path = shipped::file_of(&policy).map(|file| PolicyCalibration::path(&file));
            let out = out
                .or(path)
                .context("a policy inside the program has no folder for its calibration: give --out FILE")?;
            let calibration = calibrate(&mut agent, threads).with_context(|| policy.clone())?;
            write(&out, format!("{}\n", serde_json::to_string_pretty(&calibration)?).as_bytes())?;
            terminal::print(calibration_table(&calibration))?;
        }
        PolicyCommand::Robot { robot: name, config } => {
            let (robot, config) = (Robot::load(&name)?, Config::load(&config)?);
            let fitted = config.fitted_to(&robot)?;
            terminal::print(format_args!("{}\n{}", robot.description(), config.changes(&fitted)))?;
        }
        PolicyCommand::Run { policy: name, compliance } => {
            let agent = shipped::find(&name)?;
            let compliance = agent.resolve_compliance(None, compliance).with_context(|| name.clone())?;
            let compliant = compliance
                .map(|compliance| CompliantObservations::new(&agent, compliance).with_context(|| name.clone()));
            answer(&agent, compliant.transpose()?)?;
        }
        PolicyCommand::List => list()?,
        PolicyCommand::Describe { source, onnx, robot, out } => {
            describe::describe(&source, onnx, robot.as_deref(), &out)?
        }
        PolicyCommand::Mean { policies, out } => {
            let policies = policies.iter().map(|path| Policy::load(path)).collect::<Result<Vec<_>, _>>()?;
            let mean = Policy::mean(&policies).context(
                "the policies do not come from one run: their seeds, configurations or observations differ; give those that \
                 it kept, as in runs/mine/policy-*.safetensors",
            )?;
            mean.save(&out)?;
        }
        PolicyCommand::Card { policy, name } => terminal::print(card::card(&policy, name.as_deref())?)?,
        PolicyCommand::Export { policy, format: ExportFormat::Onnx, out } => {
            let calibration = shipped::find(&policy)?.calibration;
            let (policy, name) = (shipped::find_ours(&policy)?, out.file_name().unwrap_or_default());
            // The description, with which Supple can run the network again and others learn how to use it.
            let description = out.with_extension("yaml");
            let is_file = matches!(Target::of(&out), Ok(Target::File(_)));
            if is_file {
                spare(&out, &description)?;
            }
            write(&out, &onnx::export(&policy))?;
            // A pipe or a device has no folder for other files.
            if is_file {
                write(&description, external::describe(&policy, &name.to_string_lossy()).as_bytes())?;
                // The network yields like the policy: its calibration holds for the network's files.
                if let Some(calibration) = calibration {
                    let description = description.to_str().context("the path is not UTF-8")?;
                    let sha256 = shipped::find_uncalibrated(description)?.sha256;
                    let text = serde_json::to_string_pretty(&PolicyCalibration { sha256, ..calibration })?;
                    write(&PolicyCalibration::path(description.as_ref()), format!("{text}\n").as_bytes())?;
                }
            }
        }
    }
    Ok(())
}

/// Checks that the joint targets of an external policy are finite for a robot that stands still in its nominal pose.
fn verify_external(name: &str, agent: &Agent) -> anyhow::Result<()> {
    let mut controller = agent.inference().controller();
    let (height, gravity_in_base) = (agent.config.reward.base_height_m, Vector3::new(0.0, 0.0, -GRAVITY_M_S2));
    let state = RobotState { height, gravity_in_base, joint_angles: controller.rest(), ..RobotState::default() };
    controller.begin(&state);
    check_finite(&controller.joint_targets(&state, &Command::default())).with_context(|| name.to_owned())?;
    terminal::print(format_args!(
        "it fits its description, and its joint targets for a robot that stands are finite; it has no golden ones to \
         compare with, `policy show` prints its interpretation; sha256 {}\n",
        agent.sha256
    ))?;
    Ok(())
}

/// Checks that joint targets, in Supple's order, are finite.
fn check_finite(targets: &Joints) -> anyhow::Result<()> {
    match (0..JOINTS).find(|joint| !targets[*joint].is_finite()) {
        None => Ok(()),
        Some(joint) => anyhow::bail!(
            "the joint target of {} is {}: the policy does not support these numbers",
            joint_name(joint),
            targets[joint]
        ),
    }
}

/// Prints a line for each shipped policy.
fn list() -> anyhow::Result<()> {
    let mut text = format!("{:26} {:18} {:>12}  sha256\n", "name", "configuration", "samples");
    for (name, _) in shipped::EMBEDDED {
        let policy = shipped::find_ours(name)?;
        let Provenance { config_name, samples, .. } = &policy.provenance;
        text.push_str(&format!("{name:26} {config_name:18} {samples:>12}  {:.16}\n", policy.sha256()));
    }
    terminal::print(text)?;
    Ok(())
}

/// Formats the measured compliance for each setting as a table.
fn calibration_table(calibration: &PolicyCalibration) -> String {
    let [low, high] = calibration.range();
    let [forward, left] = calibration.own_m_s_per_n;
    let mut table = format!(
        "own compliance: {forward:.4} m/s/N forward, {left:.4} left; --compliance can be {low:.4} to {high:.4}\n\n"
    );
    table += "commanded  measured forward  left [m/s/N]\n";
    for point in &calibration.points {
        let [forward, left] = point.measured;
        table += &format!("{:9.4}  {forward:16.4}  {left:.4}\n", point.commanded);
    }
    table
}

/// Refuses to overwrite files that `policy export` did not write, or the network with its description.
fn spare(network: &Path, description: &Path) -> anyhow::Result<()> {
    let out = network.display();
    anyhow::ensure!(network != description, "--out {out} is where the description goes: name it {out}.onnx or so");
    let text = files::read_text(description, MAX_DESCRIPTION_BYTES);
    let ours = text.is_ok_and(|text| external::is_described_by_us(&text));
    for path in [description, network, &PolicyCalibration::path(description)] {
        let shown = path.display();
        anyhow::ensure!(
            ours || !path.exists(),
            "{shown} was not written by `policy export`: choose another --out, or move it away"
        );
    }
    Ok(())
}

/// Prints a line of joint targets for each line of observations.
fn answer(agent: &Agent, mut compliant: Option<CompliantObservations>) -> anyhow::Result<()> {
    /// A line of input where a compliance is commanded.
    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Pulled {
        observation: Vec<f64>,
        force_n: [f64; 2],
    }
    let inference = agent.inference();
    let (mut buffers, length) = (InferenceBuffers::default(), inference.layout.length());
    for (index, line) in files::lines(std::io::stdin().lock(), MAX_LINE_BYTES).enumerate() {
        let line = line.with_context(|| format!("standard input, line {}", index + 1))?;
        let expected = match compliant {
            None => "a JSON array of numbers",
            Some(_) => r#"{"observation": [...], "force_n": [forward, left]}"#,
        };
        let fail = |error: serde_json::Error| {
            anyhow::anyhow!("line {}: expected {expected}: {}", index + 1, terminal::echo(&error.to_string()))
        };
        let (mut observation, force_n) = match compliant {
            None => (serde_json::from_str::<Vec<f64>>(&line).map_err(fail)?, [0.0; 2]),
            Some(_) => {
                let Pulled { observation, force_n } = serde_json::from_str(&line).map_err(fail)?;
                (observation, force_n)
            }
        };
        let found = observation.len();
        anyhow::ensure!(found == length, "line {}: {found} numbers, expected {length}; see `policy show`", index + 1);
        if let Some(compliant) = &mut compliant {
            compliant.apply(&mut observation, force_n);
        }
        let targets = inference.joint_targets(&observation, &mut buffers);
        check_finite(&targets).map_err(|problem| anyhow::anyhow!("line {}: {problem}", index + 1))?;
        terminal::print(format_args!("{}\n", serde_json::json!(targets)))?;
    }
    Ok(())
}

fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    files::write_atomically(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}
