//! The sideways velocity around a push in each run, for the figures of E2 and E10.

use crate::plot::curves::{self, Curve};
use crate::results::Results;
use crate::section_builder::SectionBuilder;
use crate::section_content::{Line, Lines};
use supple::scenario::trace::Trace;

/// The time shown before and after the push \[s\].
const SHOWN_S: [f64; 2] = [1.0, 3.0];

/// The columns of [`lines`].
const COLUMNS: [&str; 4] = ["time_s", "mean_m_s", "least_m_s", "largest_m_s"];

/// Returns the series of a trial: time since the push \[s\] and velocity to the left \[m/s\]. Times are whole steps from the
/// first step after the push, so that runs can be averaged step by step.
pub(super) fn around(trace: &Trace, push_s: f64) -> Vec<Vec<f32>> {
    let half_s = 0.5 * trace.period_s;
    let Some(pushed) = trace.frames.iter().position(|frame| frame.time_s > push_s + half_s) else { return Vec::new() };
    let steps = |seconds: f64| (seconds / trace.period_s).round() as usize;
    let first = pushed.saturating_sub(steps(SHOWN_S[0]));
    let frames = &trace.frames[first..(pushed + steps(SHOWN_S[1])).min(trace.frames.len())];
    let time = |index: usize| ((first + index) as f64 - pushed as f64 + 1.0) * trace.period_s;
    let times = (0..frames.len()).map(|index| time(index) as f32).collect();
    vec![times, frames.iter().map(|frame| frame.velocity_in_heading[1] as f32).collect()]
}

/// Adds a figure of a condition with a curve for each set, and a file with the points of all conditions' curves. `marked`
/// completes the curve of a set.
pub(super) fn figure(
    section: &mut SectionBuilder,
    [part, lines]: [&str; 2],
    [title, x_label]: [&str; 2],
    condition: usize,
    marked: impl Fn(Curve, usize) -> Curve,
    caption: String,
) {
    let curves = section.by_set(|set| marked(curve(section.results, set, condition), set));
    section.figure(part, caption, curves::draw(title, &curves, x_label, "sideways velocity [m/s]"));
    section.content.lines.extend([self::lines(lines, section.results)]);
}

/// Returns mean and extremes over the runs of the shown policy in a condition.
fn curve(results: &Results, set: usize, condition: usize) -> Curve {
    let (title, policy) = results.shown(set);
    let runs = policy.and_then(|policy| policy.get(condition)).into_iter().flatten();
    let runs: Vec<_> = runs.filter(|run| run.series.len() == 2).collect();
    let title = format!("{title}, {} runs", runs.len());
    let mut curve = Curve { title, set, if_empty: "no run reached its disturbance", ..Curve::default() };
    let longest = runs.iter().max_by_key(|run| run.series[0].len());
    for (step, time) in longest.map_or(&[][..], |run| &run.series[0]).iter().enumerate() {
        let values: Vec<f64> = runs.iter().filter_map(|run| run.series[1].get(step)).copied().map(f64::from).collect();
        curve.points.extend(curves::point(f64::from(*time), &values));
    }
    curve
}

/// Returns the points of all conditions' curves.
fn lines(name: &str, results: &Results) -> Lines {
    let line = |(condition, set): (usize, usize)| {
        let curve = curve(results, set, condition);
        let label = format!("{}: {}", results.conditions[condition].label, curve.title);
        Line { label, rows: curve.points.iter().map(|point| point.to_vec()).collect() }
    };
    let sets = |condition| (0..results.sets.len()).map(move |set| (condition, set));
    let lines = (0..results.conditions.len()).flat_map(sets).map(line);
    Lines { name: name.to_owned(), columns: COLUMNS.to_vec(), lines: lines.collect() }
}
