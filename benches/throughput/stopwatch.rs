//! How much to measure, and the few sums that measuring needs.

use std::sync::Barrier;
use std::time::Instant;

/// How much work the figures rest on.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    pub quick: bool,
    /// Repetitions behind a median.
    pub repetitions: usize,
    pub environments: usize,
    /// Policy steps before those that are measured, so that environments are in different stages.
    pub warm_up_steps: usize,
    /// Policy steps of each environment in a repetition.
    pub steps: usize,
    pub epochs: usize,
    /// Length of the ball pit rollout [s].
    pub pit_s: f64,
}

impl Effort {
    /// The sizes of Table III: one batch for each repetition.
    pub fn full() -> Self {
        Effort {
            quick: false,
            repetitions: 5,
            environments: 64,
            warm_up_steps: 240,
            steps: 128,
            epochs: 30,
            pit_s: 15.0,
        }
    }

    /// A few seconds in all.
    pub fn quick() -> Self {
        Effort { quick: true, repetitions: 1, environments: 8, warm_up_steps: 0, steps: 64, epochs: 1, pit_s: 0.2 }
    }
}

/// The middle value; the upper one of two.
pub fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Time that `work` takes [s], and what it gives.
pub fn timed<T>(work: impl FnOnce() -> T) -> (f64, T) {
    let started = Instant::now();
    let result = work();
    (started.elapsed().as_secs_f64(), result)
}

/// Time from the moment when every thread has started to the moment when the last is done [s]. Each thread has its own
/// stretch of `items`.
pub fn timed_on_threads<T: Send>(
    threads: usize,
    items: &mut [T],
    work: impl Fn(&mut [T]) -> anyhow::Result<()> + Sync,
) -> anyhow::Result<f64> {
    let share = items.len().div_ceil(threads.max(1)).max(1);
    let chunks: Vec<_> = items.chunks_mut(share).collect();
    let start = Barrier::new(chunks.len() + 1);
    std::thread::scope(|scope| {
        let (start, work) = (&start, &work);
        let workers: Vec<_> = chunks
            .into_iter()
            .map(|chunk| {
                scope.spawn(move || {
                    start.wait();
                    work(chunk)
                })
            })
            .collect();
        start.wait();
        let (elapsed_s, results) = timed(|| {
            let join = |worker: std::thread::ScopedJoinHandle<'_, _>| {
                worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            };
            workers.into_iter().map(join).collect::<anyhow::Result<Vec<()>>>()
        });
        results.map(|_| elapsed_s)
    })
}
