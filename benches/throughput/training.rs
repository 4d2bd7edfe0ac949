/*! Whole iterations as training runs them, on one thread and on all.

Two trainers of the same seed take turns, so that both see the same machine; since results do not depend on the number
of threads, both also do the same work, iteration by iteration. `scripts/scaling` measures other numbers of threads.
*/

use serde::Serialize;
use supple::config::Config;
use supple::train::Trainer;
use supple::train::metrics::IterationMetrics;

use crate::stopwatch::{Effort, median, timed};

/// Times of an iteration on some threads, medians.
#[derive(Debug, Serialize)]
pub struct Iteration {
    pub threads: usize,
    /// Samples collected and learnt from [1/s].
    pub samples_per_s: f64,
    /// Collecting and advantages [s].
    pub rollout_s: f64,
    /// Shuffling and learning [s].
    pub update_s: f64,
    /// What is left: metrics and copies [s].
    pub rest_s: f64,
}

#[derive(Debug, Serialize)]
pub struct Training {
    pub batch_size: usize,
    pub one_thread: Iteration,
    pub all_threads: Iteration,
    /// Time of the whole iteration on one thread over that on all, median of the iterations' own ratios.
    pub speed_up: f64,
}

/// Wall-clock times of one iteration [s].
struct Times {
    whole: f64,
    rollout: f64,
    update: f64,
}

/// Trains for a while.
pub fn measure(config: &Config, threads: usize, effort: &Effort) -> anyhow::Result<Training> {
    let mut config = config.clone();
    config.ppo.epochs = effort.epochs;
    let mut one = Trainer::new("throughput", config.clone(), 0, 1)?;
    let mut all = Trainer::new("throughput", config.clone(), 0, threads)?;
    let (mut one_times, mut all_times) = (Vec::new(), Vec::new());
    // The first iteration fills caches and is not counted.
    for iteration in 0..=effort.repetitions {
        let (one_time, all_time) = (times(&mut one)?, times(&mut all)?);
        if iteration > 0 {
            one_times.push(one_time);
            all_times.push(all_time);
        }
    }
    Ok(Training {
        batch_size: config.ppo.batch_size,
        speed_up: median(one_times.iter().zip(&all_times).map(|(one, all)| one.whole / all.whole)),
        one_thread: summary(1, config.ppo.batch_size, &one_times),
        all_threads: summary(threads, config.ppo.batch_size, &all_times),
    })
}

fn times(trainer: &mut Trainer) -> anyhow::Result<Times> {
    let (whole, metrics) = timed(|| trainer.iterate());
    let IterationMetrics { time, .. } = metrics?;
    Ok(Times { whole, rollout: time.rollout_s, update: time.update_s })
}

fn summary(threads: usize, batch_size: usize, times: &[Times]) -> Iteration {
    let middle = |part: fn(&Times) -> f64| median(times.iter().map(part));
    Iteration {
        threads,
        samples_per_s: batch_size as f64 / middle(|times| times.whole),
        rollout_s: middle(|times| times.rollout),
        update_s: middle(|times| times.update),
        rest_s: middle(|times| times.whole - times.rollout - times.update),
    }
}
