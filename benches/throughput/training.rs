/*! Whole iterations as training runs them, on one thread and on all.

Two trainers of the same seed take turns, so that both see the same machine; since results do not depend on the number
of threads, both also do the same work, iteration by iteration. The share of a part's time that more threads do not
shorten follows from the two (Karp and Flatt), and what Amdahl's law makes of it on more cores is a projection, not a
measurement. It stops where a part has no more work to share out.
*/

use serde::Serialize;
use supple::config::Config;
use supple::train::Trainer;
use supple::train::metrics::IterationMetrics;

use crate::stopwatch::{Effort, median, timed};

/// Cores to project to.
const CORES: [usize; 3] = [8, 16, 64];

/// Rows of a minibatch that the learner takes through one network as one task.
const ROWS_OF_A_TASK: usize = 64;

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

/// How a part of an iteration takes to more threads.
#[derive(Debug, Serialize)]
pub struct Scaling {
    /// Time on one thread over time on all, median of the iterations' own ratios.
    pub speed_up: f64,
    /// Share of the time on one thread that more threads do not shorten; none on a single core.
    pub serial_share: Option<f64>,
    /// More threads than this find nothing to do; none for a mixture of parts.
    pub tasks: Option<usize>,
}

/// Samples per second on more cores, by Amdahl's law.
#[derive(Debug, Serialize)]
pub struct Projection {
    pub cores: usize,
    pub samples_per_s: f64,
}

#[derive(Debug, Serialize)]
pub struct Training {
    pub batch_size: usize,
    pub one_thread: Iteration,
    pub all_threads: Iteration,
    /// The whole iteration.
    pub whole: Scaling,
    /// The scaling of the rollout.
    pub rollout: Scaling,
    /// The scaling of the update.
    pub update: Scaling,
    /// Projections, not measurements.
    pub projected: Vec<Projection>,
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
    let scaling = |part: fn(&Times) -> f64, tasks| {
        let speed_up = median(one_times.iter().zip(&all_times).map(|(one, all)| part(one) / part(all)));
        let n = threads as f64;
        let serial = (1.0 / speed_up - 1.0 / n) / (1.0 - 1.0 / n);
        Scaling { speed_up, serial_share: (threads > 1).then(|| serial.clamp(0.0, 1.0)), tasks }
    };
    let one_thread = summary(1, config.ppo.batch_size, &one_times);
    let whole = scaling(|times| times.whole, None);
    let rollout = scaling(|times| times.rollout, Some(config.ppo.environments));
    let update_tasks = 2 * config.ppo.minibatch_size.div_ceil(ROWS_OF_A_TASK);
    let update = scaling(|times| times.update, Some(update_tasks));
    let projected_s = |cores| {
        let parts = [(&rollout, one_thread.rollout_s), (&update, one_thread.update_s)];
        let parts_s: Option<f64> = parts.iter().map(|(scaling, one_s)| Some(one_s * scaling.share_left(cores)?)).sum();
        Some(parts_s? + one_thread.rest_s)
    };
    let project = |cores| Some(Projection { cores, samples_per_s: config.ppo.batch_size as f64 / projected_s(cores)? });
    Ok(Training {
        batch_size: config.ppo.batch_size,
        projected: CORES.into_iter().filter_map(project).collect(),
        all_threads: summary(threads, config.ppo.batch_size, &all_times),
        one_thread,
        whole,
        rollout,
        update,
    })
}

impl Scaling {
    /// Amdahl's law: time on some cores as a share of that on one.
    fn share_left(&self, cores: usize) -> Option<f64> {
        let serial = self.serial_share?;
        let useful = self.tasks.map_or(cores, |tasks| tasks.min(cores));
        Some(serial + (1.0 - serial) / useful as f64)
    }
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
