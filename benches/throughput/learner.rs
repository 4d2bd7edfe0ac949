/*! The update of one Table III batch by either learner, in every arithmetic that the machine has, against the rate at which this machine multiplies matrices.

The batch is a real rollout of a fresh policy. Every repetition starts from the same parameters, so that all do the same
work. A sample that goes through one epoch once is a sample pass. The peak is measured in turn with the updates: square
f32 products of 1024 by candle, whose `gemm` uses all cores. Ratios are medians of the repetitions' own.
*/

use candle_core::{Device, Tensor};
use rand::seq::SliceRandom;
use supple::config::{Config, LearnerKind, Ppo, Precision};
use supple::network::{ActorCritic, Mlp};
use supple::ppo::{LearnerState, learner, resolved};
use supple::ranks::Alone;
use supple::robot::JOINTS;
use supple::train::Curriculum;
use supple::train::collection::{Collection, Rollout};
use supple::train::environment::LocomotionEnv;
use supple::util::random::{Purpose, stream};

use crate::{Effort, Figures, timed};

/// Edge of the matrices behind the peak.
const EDGE: usize = 1024;

/// Epochs of the candle learner in a repetition, of which the fused one does several times more.
const CANDLE_EPOCHS: usize = 4;

/// Products in one timing of the peak.
const PRODUCTS: usize = 20;

pub fn measure(config: &Config, threads: usize, effort: &Effort, figures: &mut Figures) -> anyhow::Result<()> {
    let ppo = &config.ppo;
    let mut rng = stream(0, Purpose::Weights, 0, 0);
    let log_std = ppo.initial_log_std as f32;
    let network = ActorCritic::orthogonal(config.layout()?.length(), &ppo.hidden_layers, JOINTS, log_std, &mut rng);
    let rollout = rollout(config, &network, threads, effort)?;
    let (advantages, returns) = rollout.advantages(ppo.discount, ppo.gae_lambda);
    let batch = rollout.batch(&network.log_std, &advantages, &returns);
    let permutations: Vec<Vec<u32>> = (0..effort.epochs)
        .map(|epoch| {
            let mut order: Vec<u32> = (0..rollout.len() as u32).collect();
            order.shuffle(&mut stream(0, Purpose::Shuffle, 0, epoch as u64));
            order
        })
        .collect();
    let start = LearnerState::new(network.clone(), ppo);
    let fused = |precision| Ppo { learner: LearnerKind::Fused, precision, ..ppo.clone() };
    let by_candle = Ppo { learner: LearnerKind::Candle, precision: Precision::F32, ..ppo.clone() };
    let mut contestants = vec![
        ("f32", fused(Precision::F32), threads, effort.epochs),
        ("candle", by_candle, 1, effort.epochs.min(CANDLE_EPOCHS)),
        ("mixed", fused(Precision::Mixed), threads, effort.epochs),
    ];
    contestants.retain(|(_, ppo, ..)| learner(ppo, start.clone(), 1, Alone::shared()).is_ok());
    let flop = flop_per_sample_pass(&network);
    // Sample passes of each contestant [1/s], and the peak [FLOP/s].
    let mut rounds = Vec::new();
    for _ in 0..effort.repetitions {
        let peak = product_flop_per_s()?;
        let passes_per_s = |(_, ppo, threads, epochs): &(&str, Ppo, usize, usize)| -> anyhow::Result<f64> {
            let mut learner = learner(ppo, start.clone(), *threads, Alone::shared())?;
            let (elapsed_s, _) = timed(|| Ok(learner.update(&batch, &permutations[..*epochs])?))?;
            Ok((epochs * rollout.len()) as f64 / elapsed_s)
        };
        rounds.push((contestants.iter().map(passes_per_s).collect::<anyhow::Result<Vec<_>>>()?, peak));
    }
    for (k, (name, ..)) in contestants.iter().enumerate() {
        figures.note(format!("{name}_passes_per_s"), rounds.iter().map(|(rates, _)| rates[k]));
        figures.note(format!("{name}_over_f32"), rounds.iter().map(|(rates, _)| rates[k] / rates[0]));
    }
    let used = if resolved(&fused(Precision::Auto)) == Precision::Mixed { "mixed" } else { "f32" };
    figures.note("sample_passes_per_s", [figures.get(&format!("{used}_passes_per_s"))]);
    figures.note("kflop_per_sample_pass", [1e-3 * flop]);
    figures.note("peak_gflop_per_s", rounds.iter().map(|(_, peak)| 1e-9 * peak));
    figures.note("update_over_peak", rounds.iter().map(|(rates, peak)| flop * rates[0] / peak));
    Ok(())
}

fn rollout(config: &Config, network: &ActorCritic, threads: usize, effort: &Effort) -> anyhow::Result<Rollout> {
    let (steps, curriculum) = (config.ppo.batch_size / effort.environments, Curriculum::new(&config.command));
    let collection = Collection { network, seed: 0, iteration: 0, steps, curriculum, threads };
    let environment = |index| LocomotionEnv::new(config, 0, index as u64, collection.curriculum);
    let mut environments = (0..effort.environments).map(environment).collect::<Result<Vec<_>, _>>()?;
    Ok(collection.collect(&mut environments)?)
}

/// Returns the operations per sample and pass, two for each weight and direction (the first layer has no gradient of inputs).
fn flop_per_sample_pass(network: &ActorCritic) -> f64 {
    let of_mlp = |mlp: &Mlp| {
        let weights = mlp.layers.iter().map(|layer| layer.weight.len());
        weights.enumerate().map(|(depth, count)| if depth == 0 { 4 * count } else { 6 * count }).sum::<usize>()
    };
    (of_mlp(&network.policy) + of_mlp(&network.value)) as f64
}

fn product_flop_per_s() -> anyhow::Result<f64> {
    let matrix = || Tensor::randn(0_f32, 1.0, (EDGE, EDGE), &Device::Cpu);
    let (a, b) = (matrix()?, matrix()?);
    a.matmul(&b)?;
    let (elapsed_s, ()) =
        timed(|| Ok((0..PRODUCTS).try_for_each(|_| a.matmul(&b).map(|c| drop(std::hint::black_box(c))))?))?;
    Ok(2.0 * (EDGE as f64).powi(3) * PRODUCTS as f64 / elapsed_s)
}
