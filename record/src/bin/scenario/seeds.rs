//! Results of a scenario with several seeds: mean and spread of its metrics.

use std::ops::RangeInclusive;

use serde_json::{Map, Value, json};
use supple::policy::Agent;
use supple::provenance::{git_revision, mujoco_version};
use supple::scenario::catalog::Scenario;
use supple::scenario::metrics::{Metric, by_name};

use crate::output::undefined;

/// The outcomes of one policy over all seeds.
pub struct OfSeeds<'a> {
    /// Name of the policy, and its agent.
    pub played: &'a (String, Agent),
    /// Metrics of the scenario, for each seed.
    pub metrics: Vec<Vec<Metric>>,
}

/// Mean, standard deviation over the seeds, and number of seeds that define the metric.
struct Spread {
    mean: f64,
    /// Standard deviation; `None` for a single seed.
    deviation: Option<f64>,
    count: usize,
    least: f64,
    largest: f64,
}

impl Spread {
    fn of(values: &[f64]) -> Option<Self> {
        let count = values.len();
        let (least, largest) = (values.iter().copied().reduce(f64::min)?, values.iter().copied().reduce(f64::max)?);
        let mean = values.iter().sum::<f64>() / count as f64;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        let deviation = (count > 1).then(|| (squares / (count - 1) as f64).sqrt());
        Some(Spread { mean, deviation, count, least, largest })
    }
}

impl OfSeeds<'_> {
    fn values(&self, index: usize) -> Vec<f64> {
        self.metrics.iter().filter_map(|metrics| metrics.get(index)?.value).collect()
    }
}

/// Formats a table with a column for each policy.
pub fn summary(scenario: &Scenario, seeds: &RangeInclusive<u64>, runs: &[OfSeeds<'_>]) -> String {
    let count = runs.first().map_or(0, |run| run.metrics.len());
    let (name, first_seed, last_seed) = (scenario.name(), seeds.start(), seeds.end());
    let mut text = if first_seed == last_seed {
        format!("{name}, seed {first_seed}: one trial\n")
    } else {
        format!(
            "{name}, seeds {first_seed} to {last_seed}: mean ± standard deviation (with the number of seeds, if not all {count})\n"
        )
    };
    let header: String = runs.iter().map(|run| format!("{:>30}", run.played.0)).collect();
    text.push_str(&format!("{:28}{header}\n", ""));
    for (index, Metric { label, unit, .. }) in first(runs).iter().enumerate() {
        if runs.iter().all(|run| run.values(index).is_empty()) {
            continue;
        }
        let cell = |run: &OfSeeds<'_>| {
            let values = run.values(index);
            let Some(spread) = Spread::of(&values) else { return "-".to_owned() };
            if first(runs)[index].is_truth() {
                return format!("{} of {}", values.iter().filter(|truth| **truth > 0.5).count(), spread.count);
            }
            let deviation = spread.deviation.map_or_else(String::new, |deviation| format!(" ± {deviation:.3}"));
            let of = if spread.count == count { String::new() } else { format!(" ({})", spread.count) };
            format!("{:.3}{deviation} {unit}{of}", spread.mean)
        };
        let cells: String = runs.iter().map(|run| format!("{:>30}", cell(run))).collect();
        text.push_str(&format!("  {label:26}{cells}\n"));
    }
    runs.iter().for_each(|run| text.push_str(&undefined(&run.played.0, run.metrics.iter().flatten())));
    text
}

/// Returns the results as one JSON object.
pub fn to_json(scenario: &Scenario, seeds: &RangeInclusive<u64>, sensing: Value, runs: &[OfSeeds<'_>]) -> Value {
    let metrics = |run: &OfSeeds<'_>| -> Map<String, Value> {
        let of = |(index, metric): (usize, &Metric)| {
            let of_seeds = || run.metrics.iter().filter_map(|metrics| metrics.get(index));
            let spread = Spread::of(&run.values(index));
            let told = json!({
                "mean": spread.as_ref().map(|spread| spread.mean),
                "standard_deviation": spread.as_ref().and_then(|spread| spread.deviation),
                "least": spread.as_ref().map(|spread| spread.least),
                "largest": spread.as_ref().map(|spread| spread.largest),
                "count": spread.as_ref().map_or(0, |spread| spread.count),
                "of_seeds": of_seeds().map(Metric::to_json).collect::<Vec<_>>(),
                "undefined": of_seeds().map(|metric| metric.reason).collect::<Vec<_>>(),
            });
            (metric.name.to_owned(), told)
        };
        first(runs).iter().enumerate().map(of).collect()
    };
    let run = |run: &OfSeeds<'_>| {
        let (name, agent) = run.played;
        json!({ "policy": name, "sha256": agent.sha256, "robot": agent.config.robot.model, "metrics": metrics(run) })
    };
    json!({
        "scenario": scenario.name(),
        "revision": git_revision(),
        "mujoco": mujoco_version(),
        "seeds": [seeds.start(), seeds.end()],
        "sensing": sensing,
        "parameters": scenario,
        "units": by_name(first(runs), |metric| json!(metric.unit)),
        "runs": runs.iter().map(run).collect::<Vec<_>>(),
    })
}

/// Returns the metrics of the first playback, which state the order.
fn first<'a>(runs: &'a [OfSeeds<'_>]) -> &'a [Metric] {
    runs.first().and_then(|run| run.metrics.first()).map_or(&[], Vec::as_slice)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_is_that_of_a_sample() {
        // Mean 4; squares 4 + 0 + 4 over two.
        let spread = Spread::of(&[2.0, 4.0, 6.0]).unwrap();
        assert_eq!((spread.mean, spread.deviation, spread.least, spread.largest), (4.0, Some(2.0), 2.0, 6.0));
        assert!(Spread::of(&[]).is_none() && Spread::of(&[1.0]).unwrap().deviation.is_none());
    }
}
