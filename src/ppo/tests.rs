//! Tests of all learners against the textbook and against each other, and of their reproducibility.

use candle_core::{DType, Tensor};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::candle::{CandleNetworks, Loss};
#[cfg(tiles)]
use super::fused::Tiles;
use super::fused::team::Team;
use super::fused::{Arithmetic, Panels, tiles_available};
use super::loss::Minibatch;
use super::loss::tests::settings as paper;
use super::update::ADAM_BETAS;
use super::*;
use crate::config::{Config, LOG_STD_RANGE, LearnerKind, Ppo, Precision};
use crate::network::{ActorCritic, Layer, PackedMlp, Scratch};
use crate::ranks::Alone;

/// Samples a batch from a policy that differs somewhat from the one to be trained.
fn samples(network: &ActorCritic, samples: usize, seed: u64) -> Samples {
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    let (inputs, actions) = (network.policy.inputs(), network.policy.outputs());
    let critic = network.value.inputs();
    let critic = if critic == inputs { 0 } else { critic };
    let observations = normal(samples * inputs, 1.0, rng);
    let mut means = vec![0.0; samples * actions];
    PackedMlp::new(&network.policy).forward(samples, &observations, &mut means, &mut Scratch::default());
    means.iter_mut().zip(normal(samples * actions, 0.05, rng)).for_each(|(mean, x)| *mean += x);
    let log_std: Vec<f32> = network.log_std.iter().map(|x| x + rng.random_range(-0.1..0.1)).collect();
    let policy = DiagonalGaussian::new(&log_std);
    let noise = normal(samples * actions, 1.0, rng);
    let std = log_std.iter().map(|x| x.exp()).cycle();
    let taken: Vec<f32> = means.iter().zip(noise).zip(std).map(|((mean, x), std)| mean + std * x).collect();
    let log_probs = means.chunks(actions).zip(taken.chunks(actions)).map(|(m, a)| policy.log_prob(m, a) as f32);
    let (log_probs, critic_observations) = (log_probs.collect(), normal(samples * critic, 1.0, rng));
    let (advantages, returns) = (normal(samples, 3.0, rng), normal(samples, 2.0, rng));
    Samples { log_probs, observations, critic_observations, actions: taken, means, log_std, advantages, returns }
}

fn normal(count: usize, scale: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
    (0..count).map(|_| scale * Distribution::<f32>::sample(&StandardNormal, rng)).collect()
}

fn permutations(samples: usize, epochs: usize, seed: u64) -> Vec<Vec<u32>> {
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    let mut permutation = || {
        let mut rows: Vec<u32> = (0..samples as u32).collect();
        (1..samples).rev().for_each(|i| rows.swap(i, rng.random_range(0..=i)));
        rows
    };
    (0..epochs).map(|_| permutation()).collect()
}

/// Creates a network of awkward sizes, whose policy has a large last layer.
fn network() -> ActorCritic {
    network_with_critic(19)
}

/// Creates a network like [`network`] whose critic observes `inputs` numbers.
fn network_with_critic(inputs: usize) -> ActorCritic {
    let rng = &mut ChaCha8Rng::seed_from_u64(7);
    let mut network = ActorCritic::asymmetric([19, inputs], &[50, 37, 23], 5, -0.5, rng);
    for layer in network.policy.layers.iter_mut().chain(&mut network.value.layers) {
        layer.bias = normal(layer.outputs(), 0.1, rng);
    }
    network.policy.layers[3] = Layer::orthogonal(23, 5, 0.5, rng);
    network
}

fn settings(minibatch_size: usize) -> Ppo {
    Ppo { minibatch_size, ..paper() }
}

fn fused<A: Arithmetic>(network: &ActorCritic, settings: Ppo, threads: usize) -> FusedLearner<A> {
    FusedLearner::new(&LearnerState::new(network.clone(), &settings), settings, threads, Alone::shared())
}

/// Returns every learner that this machine supports, continuing from `state`, with the tolerance of an update.
fn resumed(state: &LearnerState, settings: &Ppo) -> Vec<(Box<dyn Learner>, f64)> {
    let mut learners: Vec<(Box<dyn Learner>, f64)> = vec![
        (Box::new(FusedLearner::<Panels>::new(state, settings.clone(), 2, Alone::shared())), 1e-4),
        (Box::new(CandleLearner::new(state.clone(), settings.clone())), 1e-4),
    ];
    #[cfg(tiles)]
    if tiles_available() {
        learners.push((Box::new(FusedLearner::<Tiles>::new(state, settings.clone(), 2, Alone::shared())), 0.1));
    }
    if !tiles_available() {
        eprintln!("this processor has no tile units: their arithmetic is not tested");
    }
    learners
}

/// Returns every learner in its initial state.
fn learners(network: &ActorCritic, settings: &Ppo) -> Vec<(Box<dyn Learner>, f64)> {
    resumed(&LearnerState::new(network.clone(), settings), settings)
}

/// Returns the gradient of the loss over one minibatch by automatic differentiation, in the order of
/// [`ActorCritic::tensors`].
fn candle_gradient(networks: &CandleNetworks, loss: &Loss) -> Vec<Vec<f64>> {
    let gradients = loss.total.backward().unwrap();
    networks.variables.iter().map(|variable| numbers(gradients.get(variable).unwrap())).collect()
}

fn numbers(tensor: &Tensor) -> Vec<f64> {
    tensor.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

fn norm(x: impl Iterator<Item = f64>) -> f64 {
    x.map(|x| x * x).sum::<f64>().sqrt()
}

/// Checks gradients over networks and minibatches of several sizes. The errors are tolerances by tensor: of its norm,
/// of its elements and, because much cancels there, of the norm of the gradient by `ln σ`.
fn check_gradients<A: Arithmetic>(norm_error: f64, element_error: f64, log_std_error: f64) {
    let of_paper = ActorCritic::orthogonal(83, &[256, 128, 64], 12, -1.0, &mut ChaCha8Rng::seed_from_u64(3));
    // Critics that observe as much as the policy, more (another number of 32 inputs), and less.
    let critics = [(network(), 150), (network(), 64), (network_with_critic(45), 150), (network_with_critic(7), 3)];
    for (network, rows) in critics.into_iter().chain([(network(), 3), (of_paper, 512)]) {
        let samples = samples(&network, rows + 10, 1);
        let order = &permutations(rows + 10, 1, 2)[0][..rows];
        let settings = settings(rows);

        let networks = CandleNetworks::new(&network, DType::F64).unwrap();
        let orders = [order.to_vec()];
        let loss = Loss::new(&networks, &Minibatch::all(&samples.batch(), &settings, &orders, &Alone)[0]).unwrap();
        let expected = candle_gradient(&networks, &loss);

        let fused = gradient(&fused::<A>(&network, settings.clone(), 1), &samples.batch(), &settings, order);
        for ((name, _, fused), expected) in fused.tensors().into_iter().zip(&expected) {
            let scale = norm(expected.iter().copied());
            let error = norm(fused.iter().zip(expected).map(|(&fused, expected)| f64::from(fused) - expected));
            assert!(scale > 1e-6, "{name} has no gradient");
            let (norm_error, element_error) =
                if name == "log_std" { (log_std_error, 10.0 * log_std_error) } else { (norm_error, element_error) };
            assert!(error < norm_error * scale, "{name} with {rows} rows: error {error:e} of {scale:e}");
            let largest = expected.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
            for (i, (&fused, expected)) in fused.iter().zip(expected).enumerate() {
                let error = (f64::from(fused) - expected).abs();
                let limit = element_error * (expected.abs() + 0.1 * largest);
                assert!(error < limit, "{name}[{i}]: {fused:e}, not {expected:e}");
            }
        }
    }
}

#[test]
fn fused_gradients_equal_those_of_automatic_differentiation() {
    check_gradients::<Panels>(1e-5, 1e-4, 1e-5);
    #[cfg(tiles)]
    if tiles_available() {
        check_gradients::<Tiles>(2e-2, 0.2, 1e-3);
    }
}

/// Runs Stable-Baselines3's loop with the learning-rate rule of rsl_rl, on candle's f64 gradients.
fn reference_update(
    network: &ActorCritic,
    batch: &Batch<'_>,
    permutations: &[Vec<u32>],
    settings: &Ppo,
) -> (Vec<Vec<f64>>, UpdateStatistics) {
    let networks = CandleNetworks::new(network, DType::F64).unwrap();
    let mut moments: Vec<(Vec<f64>, Vec<f64>)> =
        network.tensors().iter().map(|(.., x)| (vec![0.0; x.len()], vec![0.0; x.len()])).collect();
    let scalar = |x: &Tensor| x.to_scalar::<f64>().unwrap();
    let (mut rate, mut count, mut statistics) = (settings.initial_learning_rate, 0, UpdateStatistics::default());
    for minibatch in Minibatch::all(batch, settings, permutations, &Alone) {
        let loss = Loss::new(&networks, &minibatch).unwrap();
        let gradients = candle_gradient(&networks, &loss);

        let kl = scalar(&loss.kl);
        let desired = settings.desired_kl;
        if kl > 2.0 * desired {
            rate = settings.min_learning_rate.max(rate / 1.5);
        } else if kl > 0.0 && kl < desired / 2.0 {
            rate = settings.max_learning_rate.min(rate * 1.5);
        }
        let total_norm = norm(gradients.iter().flatten().copied());
        let clip = (settings.max_gradient_norm / (total_norm + 1e-6)).min(1.0);

        count += 1;
        let [b1, b2] = ADAM_BETAS;
        for ((variable, gradient), (m, v)) in networks.variables.iter().zip(&gradients).zip(&mut moments) {
            let mut values = numbers(variable.as_tensor());
            for (i, value) in values.iter_mut().enumerate() {
                let g = gradient[i] * clip;
                m[i] = b1 * m[i] + (1.0 - b1) * g;
                v[i] = b2 * v[i] + (1.0 - b2) * g * g;
                let (m, v) = (m[i] / (1.0 - b1.powi(count)), v[i] / (1.0 - b2.powi(count)));
                *value -= rate * m / (v.sqrt() + settings.adam_epsilon);
            }
            let values = Tensor::from_vec(values, variable.shape(), variable.device()).unwrap();
            variable.set(&values).unwrap();
        }
        statistics.policy_loss += scalar(&loss.policy);
        statistics.value_loss += scalar(&loss.value);
        statistics.entropy += scalar(&loss.entropy);
        statistics.kl += kl;
        statistics.gradient_norm += total_norm;
        statistics.max_gradient_norm = statistics.max_gradient_norm.max(total_norm);
        statistics.learning_rate += rate;
    }
    let n = f64::from(count);
    let s = &mut statistics;
    let sums =
        [&mut s.policy_loss, &mut s.value_loss, &mut s.entropy, &mut s.kl, &mut s.gradient_norm, &mut s.learning_rate];
    sums.into_iter().for_each(|sum| *sum /= n);
    (networks.variables.iter().map(|variable| numbers(variable)).collect(), statistics)
}

#[test]
fn an_update_equals_the_textbook_loop() {
    let network = network();
    let samples = samples(&network, 300, 1);
    let order = permutations(300, 3, 2);
    let settings = settings(128); // leaves a last minibatch of 44

    let (expected, expected_statistics) = reference_update(&network, &samples.batch(), &order, &settings);
    let statistics = |(mut learner, tolerance): (Box<dyn Learner>, f64)| {
        learner.set_entropy_coefficient(settings.entropy_coefficient);
        let statistics = learner.update(&samples.batch(), &order).unwrap();
        let before = network.tensors();
        let after = learner.parameters();
        for ((before, (name, _, after)), expected) in before.iter().zip(after.tensors()).zip(&expected) {
            let way = norm(before.2.iter().zip(expected).map(|(&before, expected)| f64::from(before) - expected));
            let error = norm(after.iter().zip(expected).map(|(&after, expected)| f64::from(after) - expected));
            assert!(way > 1e-3, "{name} has not moved");
            assert!(error < tolerance * way, "{name}: off by {error:e} after {way:e}: {learner:?}");
        }
        for (name, actual, expected) in [
            ("policy loss", statistics.policy_loss, expected_statistics.policy_loss),
            ("value loss", statistics.value_loss, expected_statistics.value_loss),
            ("entropy", statistics.entropy, expected_statistics.entropy),
            ("KL", statistics.kl, expected_statistics.kl),
            ("gradient norm", statistics.gradient_norm, expected_statistics.gradient_norm),
            ("largest gradient norm", statistics.max_gradient_norm, expected_statistics.max_gradient_norm),
            ("learning rate", statistics.learning_rate, expected_statistics.learning_rate),
        ] {
            assert!((actual - expected).abs() < tolerance * expected.abs(), "{name}: {actual}, not {expected}");
        }
        statistics
    };
    let others = Ppo { entropy_coefficient: 0.5, ..settings.clone() };
    let statistics: Vec<_> = learners(&network, &others).into_iter().map(statistics).collect();
    let (fused, candle) = (&statistics[0], &statistics[1]);
    assert!(fused.clip_fraction > 0.0 && fused.clip_fraction < 1.0);
    assert_eq!(fused.clip_fraction, candle.clip_fraction);
    assert!((fused.max_ratio - candle.max_ratio).abs() < 1e-4 * fused.max_ratio);
}

#[test]
fn any_number_of_threads_gives_the_same_bits_in_one_shard_and_in_eight() {
    check_threads::<Panels>();
    #[cfg(tiles)]
    if tiles_available() {
        check_threads::<Tiles>();
    }
}

fn check_threads<A: Arithmetic>() {
    let network = network();
    // Eight shards of 88 rows, which are a block and a part of one.
    for (count, minibatch, shards) in [(900, 700, 1), (1408, 704, 8)] {
        let (samples, order) = (samples(&network, count, 1), permutations(count, 2, 2));
        let state = |shards, threads| {
            let mut learner = fused::<A>(&network, Ppo { shards, ..settings(minibatch) }, threads);
            let statistics = learner.update(&samples.batch(), &order).unwrap();
            (learner.state(), statistics)
        };
        let one = state(shards, 1);
        for threads in [2, 3, 64] {
            assert!(state(shards, threads) == one, "{shards} shards, {threads} threads");
        }
        if shards == 1 {
            continue;
        }
        let (whole, parts) = (state(1, 1).0.parameters, one.0.parameters);
        assert!(whole != parts, "sums in another order are rounded otherwise");
        let distance = |a: &ActorCritic, b: &ActorCritic| {
            let pairs = a.tensors().into_iter().zip(b.tensors()).flat_map(|(a, b)| a.2.iter().zip(b.2));
            norm(pairs.map(|(a, b)| f64::from(*a) - f64::from(*b)))
        };
        let (way, apart) = (distance(&whole, &network), distance(&whole, &parts));
        assert!(way > 1e-2 && apart < 1e-4 * way, "{apart:e} apart after {way:e}");
    }
}

#[test]
fn a_minibatch_that_the_shards_do_not_divide_is_refused() {
    let network = network();
    let samples = samples(&network, 64, 1);
    let mut learner = fused::<Panels>(&network, Ppo { shards: 4, ..settings(32) }, 1);
    let fault = learner.update(&samples.batch(), &permutations(42, 1, 1)).unwrap_err();
    let expected = "the permutation of epoch 0 leaves 10 samples for 4 shards, which do not divide them";
    assert_eq!(fault.to_string(), expected);
}

#[test]
fn any_instruction_set_gives_the_same_bits() {
    let network = network();
    let samples = samples(&network, 70, 1);
    let order = permutations(70, 2, 2);
    let state = |change: fn(&mut Panels)| {
        let mut learner = fused::<Panels>(&network, settings(70), 1);
        change(&mut learner.arithmetic);
        learner.update(&samples.batch(), &order).unwrap();
        learner.state()
    };
    let best = state(|_| ());
    assert!(state(|panels| panels.arch = pulp::Arch::Scalar) == best);
    #[cfg(target_arch = "x86_64")]
    if pulp::x86::V3::try_new().is_some() {
        let avx2 = |panels: &mut Panels| panels.arch = pulp::x86::V3::try_new().map_or(panels.arch, pulp::Arch::V3);
        assert!(state(avx2) == best);
    }
}

#[test]
fn a_restored_learner_continues_with_the_same_bits() {
    let network = network();
    let samples = samples(&network, 300, 1);
    let order = permutations(300, 4, 2);
    let settings = settings(100);

    for (i, (mut whole, _)) in learners(&network, &settings).into_iter().enumerate() {
        whole.update(&samples.batch(), &order[..2]).unwrap();
        let saved = whole.state();
        whole.update(&samples.batch(), &order[2..]).unwrap();

        let (resumed, _) = &mut resumed(&saved, &settings)[i];
        assert!(resumed.state() == saved);
        resumed.update(&samples.batch(), &order[2..]).unwrap();
        assert!(resumed.state() == whole.state());
        assert_eq!(whole.state().steps, 12);
    }
}

#[test]
fn a_row_has_the_same_bits_in_any_batch() {
    let network = network();
    let packed = PackedMlp::new(&network.policy);
    let scratch = &mut Scratch::default();
    let (rows, inputs, outputs) = (131, network.policy.inputs(), network.policy.outputs());
    let x = normal(rows * inputs, 1.0, &mut ChaCha8Rng::seed_from_u64(5));
    let mut whole = vec![0.0; rows * outputs];
    packed.forward(rows, &x, &mut whole, scratch);
    for size in [1, 2, 5, 6, 7, 8, 9, 13, 64, 65] {
        let mut parts = vec![0.0; rows * outputs];
        for (x, y) in x.chunks(size * inputs).zip(parts.chunks_mut(size * outputs)) {
            packed.forward(y.len() / outputs, x, y, scratch);
        }
        assert!(parts == whole, "batches of {size}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn inference_equals_the_plain_sum_at_any_size(
        rows in 1_usize..70, inputs in 1_usize..40, hidden in 1_usize..70, outputs in 1_usize..40, seed: u64,
    ) {
        let rng = &mut ChaCha8Rng::seed_from_u64(seed);
        let network = ActorCritic::orthogonal(inputs, &[hidden], outputs, 0.0, rng).policy;
        let x = normal(rows * inputs, 1.0, rng);
        let mut y = vec![0.0; rows * outputs];
        PackedMlp::new(&network).forward(rows, &x, &mut y, &mut Scratch::default());
        for (x, y) in x.chunks(inputs).zip(y.chunks(outputs)) {
            let x: Vec<f64> = x.iter().map(|&x| f64::from(x)).collect();
            let hidden: Vec<f64> = linear(&network.layers[0], &x).map(|x| if x > 0.0 { x } else { x.exp_m1() }).collect();
            for (&y, expected) in y.iter().zip(linear(&network.layers[1], &hidden)) {
                prop_assert!((f64::from(y) - expected).abs() < 1e-6, "{y} is not {expected}");
            }
        }
    }
}

fn linear(layer: &Layer, x: &[f64]) -> impl Iterator<Item = f64> {
    layer.weight.chunks(layer.inputs()).zip(&layer.bias).map(move |(weights, &bias)| {
        f64::from(bias) + weights.iter().zip(x).map(|(&weight, x)| f64::from(weight) * x).sum::<f64>()
    })
}

#[test]
fn first_minibatch_has_zero_divergence() {
    let network = network();
    let mut samples = samples(&network, 64, 1);
    PackedMlp::new(&network.policy).forward(64, &samples.observations, &mut samples.means, &mut Scratch::default());
    samples.log_std.clone_from(&network.log_std);
    for (mut learner, _) in learners(&network, &settings(64)) {
        let statistics = learner.update(&samples.batch(), &permutations(64, 1, 1)).unwrap();
        assert_eq!(statistics.kl, 0.0);
        assert_eq!(statistics.learning_rate, 1e-3);
    }
}

#[test]
fn a_nan_stops_the_update_before_its_step() {
    let network = network();
    let mut samples = samples(&network, 200, 1);
    samples.advantages[123] = f32::NAN;
    let order = permutations(200, 1, 2);
    let faulty = order[0].iter().position(|&row| row == 123).unwrap() / 100;
    let settings = settings(100);

    for ((mut learner, _), (mut healthy, _)) in
        learners(&network, &settings).into_iter().zip(learners(&network, &settings))
    {
        let fault = learner.update(&samples.batch(), &order).unwrap_err();
        let UpdateFault::NotFinite { epoch: 0, minibatch, samples: rows, summary } = fault else {
            panic!("{fault}");
        };
        assert_eq!(minibatch, faulty);
        assert_eq!(rows, order[0][faulty * 100..][..100]);
        assert!(summary.policy_loss.is_nan() && summary.value_loss.is_finite());

        let before = vec![order[0][..faulty * 100].to_vec()];
        healthy.update(&samples.batch(), &before).unwrap();
        assert!(learner.state() == healthy.state());
    }
}

#[test]
fn numbers_that_are_not_finite_or_too_large_stop_the_update() {
    let network = network();
    let samples = samples(&network, 64, 1);
    let broken: [fn(&mut Samples); 3] = [
        |samples| samples.returns[7] = f32::INFINITY,
        |samples| samples.returns[7] = f32::MAX,
        |samples| samples.observations[20] = f32::NAN,
    ];
    for (i, change) in broken.into_iter().enumerate() {
        let mut samples = samples.clone();
        change(&mut samples);
        for (mut learner, _) in learners(&network, &settings(64)) {
            let result = learner.update(&samples.batch(), &permutations(64, 1, 1));
            assert!(matches!(result, Err(UpdateFault::NotFinite { .. })), "{i}: {result:?}");
            assert!(learner.parameters() == network);
        }
    }
}

#[test]
fn deviation_stays_in_range_and_largest_ratio_is_reported() {
    let mut network = network();
    network.log_std[0] = LOG_STD_RANGE[1] + 1.0;
    network.log_std[1] = LOG_STD_RANGE[0] - 1.0;
    let mut samples = samples(&network, 64, 1);
    samples.log_std.clone_from(&network.log_std);
    for (mut learner, _) in learners(&network, &settings(64)) {
        let statistics = learner.update(&samples.batch(), &permutations(64, 1, 1)).unwrap();
        let log_std = learner.parameters().log_std;
        assert_eq!((log_std[0], log_std[1]), (LOG_STD_RANGE[1], LOG_STD_RANGE[0]));
        assert!(statistics.max_ratio.is_finite() && statistics.max_ratio > 0.0);
    }
}

#[test]
fn a_batch_that_does_not_fit_is_refused() {
    let network = network();
    let samples = samples(&network, 64, 1);
    let short = Batch { means: &samples.means[1..], ..samples.batch() };
    for (mut learner, _) in learners(&network, &settings(64)) {
        let fault = learner.update(&short, &permutations(64, 1, 1)).unwrap_err().to_string();
        assert_eq!(fault, "means of the batch should have 320 elements, but has 319");
        let fault = learner.update(&samples.batch(), &[vec![64]]).unwrap_err().to_string();
        assert_eq!(fault, "the permutation of epoch 0 names sample 64 of only 64");
    }
}

/// Returns the gradient over one minibatch, without a step.
fn gradient<A: Arithmetic>(learner: &FusedLearner<A>, batch: &Batch<'_>, settings: &Ppo, rows: &[u32]) -> ActorCritic {
    let orders = [rows.to_vec()];
    let minibatch = &Minibatch::all(batch, settings, &orders, &Alone)[0];
    Team::run(1, |team| {
        learner.differentiate(team, &mut learner.arithmetic.workspace(), minibatch, |_| ());
    });
    learner.unpacked(|parameters| &parameters.gradient)
}

#[test]
fn unsupported_precision_is_refused_by_name() {
    let mixed = Ppo { precision: Precision::Mixed, ..Config::load("fast").unwrap().ppo };
    assert_eq!(resolved(&mixed), Precision::Mixed);
    match learner(&mixed, LearnerState::new(network(), &mixed), 1, Alone::shared()) {
        Ok(_) => assert!(tiles_available()),
        Err(error) => assert!(!tiles_available() && error.to_string().contains("mixed"), "{error}"),
    }
    let auto = Ppo { precision: Precision::Auto, ..Config::load("fast").unwrap().ppo };
    assert_eq!(resolved(&auto), if tiles_available() { Precision::Mixed } else { Precision::F32 });
    assert_eq!(resolved(&Ppo { learner: LearnerKind::Candle, ..auto }), Precision::F32);
}
