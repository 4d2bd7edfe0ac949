//! Where and when a run took place, and how alone it was.

use serde::Serialize;
use supple::provenance::{git_revision, mujoco_version};

use crate::stopwatch::Effort;

/// The machine during the run.
#[derive(Debug, Serialize)]
pub struct Machine {
    /// The model of the first processor.
    pub processor: String,
    pub threads: usize,
    /// Share of the cores' time that went to anything but this run: above a few hundredths, only ratios mean anything,
    /// and above a tenth not even they.
    pub taken_by_others: f64,
    pub git_revision: &'static str,
    pub mujoco_version: &'static str,
    /// Figures of a quick run mean nothing.
    pub quick: bool,
    /// Behind every median.
    pub repetitions: usize,
}

impl Machine {
    /// This one, after a run that began at `start`.
    pub fn new(threads: usize, effort: &Effort, start: Ticks) -> Self {
        let info = read("/proc/cpuinfo");
        let model = info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
        let now = Ticks::now();
        let others = (now.busy - start.busy) - (now.own - start.own);
        Machine {
            processor: model.map_or("unknown".into(), |(_, name)| name.to_owned()),
            threads,
            taken_by_others: others / (now.all - start.all),
            git_revision: git_revision(),
            mujoco_version: mujoco_version(),
            quick: effort.quick,
            repetitions: effort.repetitions,
        }
    }
}

/// The ticks that Linux has counted since it started; not a number on other systems.
#[derive(Debug, Clone, Copy)]
pub struct Ticks {
    all: f64,
    busy: f64,
    /// The ticks of this process and of those of its children that have ended.
    own: f64,
}

impl Ticks {
    pub fn now() -> Self {
        // cpu user nice system idle iowait irq softirq steal …
        let whole = read("/proc/stat");
        let cores = numbers(whole.lines().next().unwrap_or_default().strip_prefix("cpu").unwrap_or_default());
        let all = sum(&cores, 0..8);
        // After the name in parentheses: the 12th to 15th number are user and system, own and of children.
        let process = read("/proc/self/stat");
        let own = numbers(
            process.rsplit_once(')').map_or("", |(_, rest)| rest.trim_start().trim_start_matches(char::is_alphabetic)),
        );
        Ticks { all, busy: all - sum(&cores, 3..5), own: sum(&own, 10..14) }
    }
}

fn sum(values: &[f64], range: std::ops::Range<usize>) -> f64 {
    values.get(range).map_or(f64::NAN, |values| values.iter().sum())
}

fn numbers(text: &str) -> Vec<f64> {
    text.split_whitespace().filter_map(|number| number.parse().ok()).collect()
}

fn read(path: &str) -> String {
    std::fs::read_to_string(path).unwrap_or_default()
}
