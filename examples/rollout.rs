/*! Collects batches as training does, and writes them down for others to compare theirs with, bit by bit.

    cargo run --example rollout -- fast 3 2 FOLDER      configuration, seed, batches, an empty folder

`FOLDER` then has `observations`, `actions`, `rewards` (f32), `ends` (u8: 0 none, 1 fall, 2 time limit, 3 fault) and
`curriculum` (f64: fraction of the commands and whether there are pushes, before each batch), little-endian; rows are by
batch, environment and step. The robots are moved by the shipped policy with little noise, so that the curriculum goes on,
and with so much in every third batch that some fall.
*/

use std::path::Path;

use anyhow::Context;
use supple::config::Config;
use supple::network::ActorCritic;
use supple::policy::shipped;
use supple::robot::JOINTS;
use supple::train::Curriculum;
use supple::train::collection::Collection;
use supple::train::environment::{EpisodeEnd, LocomotionEnv, Shared};
use supple::train::metrics::EpisodeMeans;
use supple::util::random::{Purpose, stream};

/// `ln σ` of the noise in three batches.
const LOG_STD: [f32; 3] = [-2.0, -2.0, 0.0];

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [config, seed, batches, folder] = &arguments[..] else {
        anyhow::bail!("usage: rollout CONFIG SEED BATCHES FOLDER");
    };
    let (config, folder) = (Config::load(config)?, Path::new(folder));
    let (seed, batches): (u64, u64) = (seed.parse().context("SEED")?, batches.parse().context("BATCHES")?);

    let shared = Shared::new(&config)?;
    let mut rng = stream(seed, Purpose::Weights, 0, 0);
    let untrained = ActorCritic::asymmetric(shared.inputs(), &config.ppo.hidden_layers, JOINTS, 0.0, &mut rng);
    let mut network = ActorCritic { policy: shipped::find_ours("compliant")?.actor, ..untrained };
    let mut curriculum = Curriculum::new(&config.command);
    let mut environments = (0..config.ppo.environments as u64)
        .map(|k| LocomotionEnv::with_shared(&config, &shared, seed, k, curriculum))
        .collect::<Result<Vec<_>, _>>()?;

    let (mut observations, mut actions, mut rewards) = (Vec::new(), Vec::new(), Vec::new());
    let (mut ends, mut curricula) = (Vec::new(), Vec::new());
    for iteration in 0..batches {
        curricula.extend([curriculum.command_fraction, f64::from(u8::from(curriculum.pushes))]);
        network.log_std.fill(LOG_STD[iteration as usize % LOG_STD.len()]);
        let steps = config.ppo.steps();
        let collection = Collection { network: &network, seed, iteration, steps, curriculum, threads: 2 };
        let rollout = collection.collect(&mut environments)?;
        EpisodeMeans::new(&rollout.episodes).advance(
            &mut curriculum,
            iteration * config.ppo.batch_size as u64,
            &config,
        );
        observations.extend(rollout.observations);
        actions.extend(rollout.actions);
        rewards.extend(rollout.rewards);
        ends.extend(rollout.ends.iter().map(code));
    }
    let write = |name: &str, bytes: Vec<u8>| std::fs::write(folder.join(name), bytes).with_context(|| name.to_owned());
    let of_f32 = |numbers: Vec<f32>| numbers.into_iter().flat_map(f32::to_le_bytes).collect();
    write("observations", of_f32(observations))?;
    write("actions", of_f32(actions))?;
    write("rewards", of_f32(rewards))?;
    write("ends", ends)?;
    write("curriculum", curricula.into_iter().flat_map(f64::to_le_bytes).collect())
}

fn code(end: &Option<EpisodeEnd>) -> u8 {
    match end {
        None => 0,
        Some(EpisodeEnd::Fall) => 1,
        Some(EpisodeEnd::TimeLimit) => 2,
        Some(EpisodeEnd::Fault) => 3,
    }
}
