//! One progress bar over all experiments, in simulated time.

use std::time::Instant;

use supple::scenario::Sensing;
use supple::util::progress::{ProgressBar, progress};
use supple::util::terminal;
use supple_evaluate::ExperimentInfo;
use supple_evaluate::runner::Update;

/// The number of steps of the bar per second of simulated time.
const STEPS: f64 = 10.0;

/// A progress bar that prints a line for each finished experiment.
pub struct Progress {
    bar: ProgressBar,
    begun: Instant,
}

impl Default for Progress {
    fn default() -> Self {
        Progress { bar: progress(0), begun: Instant::now() }
    }
}

impl Progress {
    /// Adds remaining work \[s\].
    pub fn expect(&mut self, work: f64) {
        self.bar.inc_length((STEPS * work) as u64);
    }

    /// Shows the name of the experiment that starts.
    pub fn begin(&mut self, info: &ExperimentInfo) {
        self.bar.set_message(format!("{} {}", info.id, info.name));
        self.begun = Instant::now();
    }

    /// Advances the bar by finished work, or says for whom the program waits.
    pub fn update(&self, update: Update) {
        match update {
            Update::Played(work) => self.bar.inc((STEPS * work) as u64),
            Update::Waits(other) => self.bar.suspend(|| waits(&other)),
        }
    }

    /// Prints the time of the finished experiment.
    pub fn end(&mut self, info: &ExperimentInfo, sensing: Sensing) {
        let on = if sensing == Sensing::Estimated { " on sensors" } else { "" };
        let line = format!("{} {}{on}: {:.1} s", info.id, info.name, self.begun.elapsed().as_secs_f64());
        self.bar.suspend(|| terminal::note(line));
    }

    /// Removes the bar.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

/// Says for which other process this one waits.
pub fn waits(other: &str) {
    terminal::note(format_args!("waiting for {other}"));
}
