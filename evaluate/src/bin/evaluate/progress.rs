//! One progress bar over all experiments, in simulated time.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use supple::util::progress::{ProgressBar, progress};
use supple::util::terminal;
use supple_evaluate::report::duration;
use supple_evaluate::runner::{self, Job, RunError, Update};

/// The number of steps of the bar per second of simulated time.
const STEPS: f64 = 1000.0;

/// Runs all jobs with a progress bar, and prints a line with the remaining work after each job.
pub fn run(jobs: &[Job]) -> Result<(), RunError> {
    let steps = |cost_s: f64| (STEPS * cost_s) as u64;
    let bar = progress(jobs.iter().map(|job| steps(job.work.cost_s)).sum());
    let left = AtomicU64::new(jobs.iter().map(|job| job.work.trials).sum());
    let start = Instant::now();
    let show = |update: Update| {
        match update {
            Update::Begins => {}
            Update::Played(job, work) => {
                let left = left.fetch_sub(work.trials, Ordering::Relaxed) - work.trials;
                bar.set_message(format!("{left} trials left: {}", job.name));
                bar.inc(steps(work.cost_s));
            }
            Update::Finished(job, took_s) => {
                let ahead = ahead(&bar, left.load(Ordering::Relaxed), start);
                let line = format!("{}: {} trials in {took_s:.1} s{ahead}", job.name, job.work.trials);
                bar.suspend(|| terminal::note(line));
            }
            Update::Waits(other) => bar.suspend(|| waits(other)),
        }
        Ok(())
    };
    let done = runner::run(jobs, &show);
    bar.finish_and_clear();
    done
}

/// Returns a text with the remaining trials and time, extrapolated from the work so far; empty if no trials remain.
fn ahead(bar: &ProgressBar, trials: u64, start: Instant) -> String {
    let (done, all) = (bar.position(), bar.length().unwrap_or(0));
    if trials == 0 || done == 0 {
        return String::new();
    }
    let left_s = start.elapsed().as_secs_f64() * all.saturating_sub(done) as f64 / done as f64;
    format!("; {trials} trials left, about {}", duration(left_s))
}

/// Prints which other process this one waits for.
pub fn waits(other: &str) {
    terminal::note(format_args!("waiting for {other}"));
}
