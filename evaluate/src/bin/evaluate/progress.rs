//! One bar over all experiments, by the work that their trials are.

use std::time::Instant;

use supple::scenario::Sensing;
use supple::util::progress::{ProgressBar, progress};
use supple::util::terminal;
use supple_evaluate::Info;

/// Steps of the bar per second of simulated work.
const STEPS: f64 = 10.0;

/// A progress bar, and a line for each finished experiment.
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
    /// Adds work that is to be done.
    pub fn expect(&mut self, work: f64) {
        self.bar.inc_length((STEPS * work) as u64);
    }

    /// Names the experiment under way.
    pub fn begin(&mut self, info: &Info) {
        self.bar.set_message(format!("{} {}", info.id, info.name));
        self.begun = Instant::now();
    }

    /// Some work is done.
    pub fn advance(&self, work: f64) {
        self.bar.inc((STEPS * work) as u64);
    }

    /// A line that stays.
    pub fn end(&mut self, info: &Info, sensing: Sensing) {
        let on = if sensing == Sensing::Estimated { " on sensors" } else { "" };
        let line = format!("{} {}{on}: {:.1} s", info.id, info.name, self.begun.elapsed().as_secs_f64());
        self.bar.suspend(|| terminal::note(line));
    }

    /// Takes the bar away.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}
