//! The program `train_contact`: gathers data from trained policies, trains the contact network, and reports its
//! accuracy.

mod gather;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::Parser;
use supple::estimate::SensorNoise;
use supple::estimate::contact::learn::{ContactSamples, Learning, learn};
use supple::estimate::contact::score::Confusion;
use supple::estimate::contact::{ContactNetwork, ContactProvenance, HeldOut, INPUTS, PolicySource, RATE_HZ};
use supple::network::Scratch;
use supple::policy::Agent;
use supple::policy::shipped;
use supple::provenance::{git_revision, mujoco_version};
use supple::robot::LEGS;
use supple::util::files::Target;
use supple::util::progress::progress;
use supple::util::terminal;

/// One in this number of episodes is held out.
const HELD_OUT: u32 = 5;

/// Train the network that detects which feet stand.
///
/// Policies walk or stand at random commands, on slopes, among balls and over blocks and mats, with random friction, and are pushed;
/// the network learns from joint angles, rates and targets with sensor noise which feet touch something and hardly move. Scores are of episodes that it was not trained on.
#[derive(Parser)]
#[command(name = env!("CARGO_BIN_NAME"), version = supple::provenance::version())]
struct Args {
    /// Policy to gather data from: file, run folder or name of a shipped one; may be given several times [default: all
    /// that ship]
    #[arg(long = "policy", value_name = "FILE|NAME")]
    policies: Vec<String>,
    /// Episodes of each policy, a fifth of them held out
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = clap::value_parser!(u32).range(5..=1000))]
    episodes: u32,
    /// Seed of episodes, noise and learning
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// File to write
    #[arg(long, value_name = "FILE", default_value = "models/contact.safetensors")]
    out: PathBuf,
}

fn main() -> ExitCode {
    supple::robot::isolate_imports();
    supple::announce_revision!();
    terminal::conclude(run(&Args::parse()))
}

fn run(args: &Args) -> anyhow::Result<()> {
    let names = match &args.policies[..] {
        [] => shipped::EMBEDDED.iter().map(|(name, _)| (*name).to_owned()).collect(),
        named => named.to_vec(),
    };
    anyhow::ensure!(!names.is_empty(), "no policy ships with this build: give one with --policy");
    let found: Vec<Agent> = names
        .iter()
        .map(|name| {
            let agent = shipped::find(name)?;
            let rate_hz = 1.0 / agent.config.simulation.timestep_s();
            anyhow::ensure!((rate_hz - RATE_HZ).abs() < 1e-6, "{name} runs at {rate_hz} Hz, expected {RATE_HZ} Hz");
            Ok(agent)
        })
        .collect::<anyhow::Result<_>>()?;
    // A wrong path fails now, not after minutes of work.
    Target::of(&args.out).with_context(|| format!("--out {}", args.out.display()))?;
    let folder = args.out.parent().filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
        anyhow::bail!("--out {}: there is no folder {}; create it", args.out.display(), folder.display());
    }
    let noise = SensorNoise::default();
    let (training, held_out) = gather(args, &names, &found, noise)?;
    let all = join(&training);
    terminal::note(format_args!("{} ticks of {} episodes to learn from", all.labels.len() / 4, training.len()));

    let learning = Learning { seed: args.seed, ..Learning::default() };
    let bar = progress(learning.epochs as u64);
    let learnt = learn(&all, [INPUTS, 4], &learning, |_, loss| {
        bar.set_message(format!("learning, loss {loss:.4}"));
        bar.inc(1);
    })?;
    bar.finish_and_clear();

    let source = |(name, policy): (&String, &Agent)| PolicySource { name: name.clone(), sha256: policy.sha256.clone() };
    let mut network = ContactNetwork::new(
        learnt.mlp,
        learnt.offset,
        learnt.scale,
        ContactProvenance {
            policies: names.iter().zip(&found).map(source).collect(),
            seed: args.seed,
            training_episodes: training.len(),
            training_samples: all.labels.len() / 4,
            held_out_episodes: held_out.len(),
            held_out: Vec::new(),
            noise,
            git_revision: git_revision().to_owned(),
            mujoco_version: mujoco_version().to_owned(),
        },
    );
    network.provenance.held_out = scores(&network, &held_out)?;
    terminal::print(format_args!(
        "held out: {} episodes, {} ticks\n",
        held_out.len(),
        held_out.iter().map(|samples| samples.labels.len() / 4).sum::<usize>()
    ))?;
    terminal::print(format_args!("foot  precision  recall      F1\n"))?;
    for (leg, score) in LEGS.iter().zip(&network.provenance.held_out) {
        terminal::print(format_args!("{leg:4}  {:9.4}  {:6.4}  {:6.4}\n", score.precision, score.recall, score.f1))?;
    }
    network.save(&args.out)?;
    terminal::print(format_args!("{}\n", args.out.display()))?;
    Ok(())
}

/// Gathers the episodes of all policies: those to train on, and those held out.
fn gather(
    args: &Args,
    names: &[String],
    policies: &[Agent],
    noise: SensorNoise,
) -> anyhow::Result<(Vec<ContactSamples>, Vec<ContactSamples>)> {
    let bar = progress(policies.len() as u64 * u64::from(args.episodes));
    bar.set_message("walking");
    let (mut training, mut held_out) = (Vec::new(), Vec::new());
    for (index, (policy, name)) in policies.iter().zip(names).enumerate() {
        for episode in 0..args.episodes {
            let samples = gather::episode(policy, noise, args.seed, [u64::from(episode), index as u64])
                .with_context(|| format!("episode {episode} of {name}"))?;
            let to = if episode % HELD_OUT == 0 { &mut held_out } else { &mut training };
            to.push(samples);
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    Ok((training, held_out))
}

fn join(episodes: &[ContactSamples]) -> ContactSamples {
    let mut all = ContactSamples::default();
    for episode in episodes {
        all.inputs.extend(&episode.inputs);
        all.labels.extend(&episode.labels);
    }
    all
}

/// Computes the scores of each foot in held-out episodes, with the network used as in deployment.
fn scores(network: &ContactNetwork, episodes: &[ContactSamples]) -> anyhow::Result<Vec<HeldOut>> {
    let mut confusions = [Confusion::default(); 4];
    let (all, mut scratch) = (join(episodes), Scratch::default());
    for (inputs, labels) in all.inputs.as_chunks::<INPUTS>().0.iter().zip(all.labels.as_chunks::<4>().0) {
        let logits = network.logits(inputs, &mut scratch);
        for leg in 0..4 {
            confusions[leg].add(logits[leg] > 0.0, labels[leg] > 0.5);
        }
    }
    let score = |(confusion, leg): (&Confusion, &str)| {
        let scores = (confusion.precision(), confusion.recall(), confusion.f1());
        let (Some(precision), Some(recall), Some(f1)) = scores else {
            anyhow::bail!("the held-out episodes do not have a contact of {leg}; are the policies trained?");
        };
        Ok(HeldOut { precision, recall, f1 })
    };
    confusions.iter().zip(LEGS).map(score).collect()
}
