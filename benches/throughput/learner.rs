/*! The update of one Table III batch by either learner, in every arithmetic that the machine has, against the rate at which this machine multiplies matrices.

The batch is a real rollout of a fresh policy. Every repetition starts from the same parameters, so that all do the same
work. A sample that goes through one epoch once is a sample pass. The peak is measured in turn with the updates: square
f32 products of 1024 by candle, whose `gemm` uses all cores.
*/

use candle_core::{Device, Tensor};
use rand::seq::SliceRandom;
use serde::Serialize;
use supple::config::{Config, LearnerKind, Ppo, Precision};
use supple::network::{ActorCritic, Mlp};
use supple::ppo::{LearnerState, learner, resolved};
use supple::ranks::Alone;
use supple::robot::JOINTS;
use supple::train::Curriculum;
use supple::train::collection::{Collection, Rollout};
use supple::train::environment::LocomotionEnv;
use supple::util::random::{Purpose, stream};

use crate::stopwatch::{Effort, median, timed};

/// Edge of the matrices behind the peak.
const EDGE: usize = 1024;

/// Epochs of the candle learner in a repetition, of which the fused one does several times more.
const CANDLE_EPOCHS: usize = 4;

/// Products in one timing of the peak.
const PRODUCTS: usize = 20;

/// The update on some threads.
#[derive(Debug, Serialize)]
pub struct Rates {
    pub threads: usize,
    /// Sample passes through both networks and back [1/s].
    pub sample_passes_per_s: f64,
    /// Floating-point work of the networks' products [GFLOP/s].
    pub gflop_per_s: f64,
}

#[derive(Debug, Serialize)]
pub struct Update {
    pub batch_size: usize,
    pub minibatch_size: usize,
    pub epochs: usize,
    /// Floating-point work of a sample pass [kFLOP].
    pub kflop_per_sample_pass: f64,
    /// What `ppo.precision: auto` comes to.
    pub precision: Precision,
    /// The rates in that precision, on one thread.
    pub one_thread: Rates,
    /// The rates in that precision, on all threads.
    pub all_threads: Rates,
    /// The rates of each precision that the machine supports, on all threads.
    pub precisions: Vec<(Precision, Rates)>,
    /// Median of the repetitions' own ratios: each of these over f32.
    pub over_f32: Vec<f64>,
    pub candle: Rates,
    /// Median of the repetitions' own ratios: f32 on all threads over candle.
    pub f32_over_candle: f64,
    /// Square f32 products on all threads [GFLOP/s].
    pub peak_gflop_per_s: f64,
    /// Median of the repetitions' own ratios, of f32 on all threads.
    pub update_over_peak: f64,
}

pub fn measure(config: &Config, threads: usize, effort: &Effort) -> anyhow::Result<Update> {
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
    let sample_passes_per_s = |ppo: &Ppo, threads, permutations: &[Vec<u32>]| -> anyhow::Result<f64> {
        let mut learner = learner(ppo, start.clone(), threads, Alone::shared())?;
        let (elapsed_s, statistics) = timed(|| learner.update(&batch, permutations));
        statistics?;
        Ok((permutations.len() * rollout.len()) as f64 / elapsed_s)
    };
    let few = &permutations[..effort.epochs.min(CANDLE_EPOCHS)];
    let with = |precision| Ppo { learner: LearnerKind::Fused, precision, ..ppo.clone() };
    let by_candle = Ppo { learner: LearnerKind::Candle, precision: Precision::F32, ..ppo.clone() };
    let precision = resolved(&with(Precision::Auto));
    let mut precisions = vec![Precision::F32, Precision::Mixed];
    precisions.retain(|precision| learner(&with(*precision), start.clone(), 1, Alone::shared()).is_ok());

    let flop = flop_per_sample_pass(&network);
    let (mut one, mut all, mut candle, mut peaks) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for _ in 0..effort.repetitions {
        peaks.push(product_gflop_per_s()?);
        let rates = precisions.iter().map(|precision| sample_passes_per_s(&with(*precision), threads, &permutations));
        all.push(rates.collect::<anyhow::Result<Vec<f64>>>()?);
        one.push(sample_passes_per_s(&with(precision), 1, &permutations)?);
        candle.push(sample_passes_per_s(&by_candle, 1, few)?);
    }
    let gflop = |rate: f64| 1e-9 * flop * rate;
    let rates = |threads, rates: Vec<f64>| {
        let sample_passes_per_s = median(rates);
        Rates { threads, sample_passes_per_s, gflop_per_s: gflop(sample_passes_per_s) }
    };
    let of = |index: usize| all.iter().map(move |rates| rates[index]).collect::<Vec<f64>>();
    let used = precisions.iter().position(|of| *of == precision).unwrap_or(0);
    Ok(Update {
        batch_size: rollout.len(),
        minibatch_size: ppo.minibatch_size,
        epochs: effort.epochs,
        kflop_per_sample_pass: 1e-3 * flop,
        precision,
        one_thread: rates(1, one),
        all_threads: rates(threads, of(used)),
        over_f32: (0..precisions.len()).map(|index| median(all.iter().map(|rates| rates[index] / rates[0]))).collect(),
        precisions: precisions.iter().enumerate().map(|(index, of_it)| (*of_it, rates(threads, of(index)))).collect(),
        f32_over_candle: median(all.iter().zip(&candle).map(|(rates, candle)| rates[0] / candle)),
        candle: rates(1, candle),
        update_over_peak: median(all.iter().zip(&peaks).map(|(rates, peak)| gflop(rates[0]) / peak)),
        peak_gflop_per_s: median(peaks),
    })
}

fn rollout(config: &Config, network: &ActorCritic, threads: usize, effort: &Effort) -> anyhow::Result<Rollout> {
    let collection = Collection {
        network,
        seed: 0,
        iteration: 0,
        steps: config.ppo.batch_size / effort.environments,
        curriculum: Curriculum::new(&config.command),
        threads,
    };
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

fn product_gflop_per_s() -> candle_core::Result<f64> {
    let matrix = || Tensor::randn(0_f32, 1.0, (EDGE, EDGE), &Device::Cpu);
    let (a, b) = (matrix()?, matrix()?);
    a.matmul(&b)?;
    let (elapsed_s, result) =
        timed(|| (0..PRODUCTS).try_for_each(|_| a.matmul(&b).map(|c| drop(std::hint::black_box(c)))));
    result?;
    Ok(1e-9 * 2.0 * (EDGE as f64).powi(3) * PRODUCTS as f64 / elapsed_s)
}
