//! Output of a scenario: a summary for people, JSON, CSV.

use std::io::{self, Write};

use anyhow::Context;
use serde_json::{Value, json};
use supple::provenance::{git_revision, mujoco_version};
use supple::scenario::Sensing;
use supple::scenario::catalog::Scenario;
use supple::scenario::metrics::{self, Metric};
use supple::scenario::trace::{Frame, Trace};
use supple::util::files::{self, Target};
use supple::util::terminal;

use crate::args::Args;

/// A finished playback.
pub struct Outcome<'a> {
    pub policy: &'a str,
    pub sha256: String,
    /// Name or file of the robot.
    pub robot: &'a str,
    pub trace: &'a Trace,
    pub metrics: Vec<Metric>,
}

/// Formats a table with a column for each policy, and the events.
pub fn summary(title: &str, outcomes: &[Outcome<'_>]) -> String {
    let mut text = format!("{title}\n");
    let header: String = outcomes.iter().map(|outcome| format!(" {:>15}", outcome.policy)).collect();
    text.push_str(&format!("{:28}{header}\n", ""));
    for index in 0..outcomes.first().map_or(0, |outcome| outcome.metrics.len()) {
        let Metric { label, unit, .. } = outcomes[0].metrics[index];
        let is_truth = outcomes[0].metrics[index].is_truth();
        let values: Vec<Option<f64>> = outcomes.iter().map(|outcome| outcome.metrics[index].value).collect();
        if values.iter().all(Option::is_none) {
            continue;
        }
        let cell = |value: &Option<f64>| match value {
            None => format!("{:>16}", "-"),
            Some(truth) if is_truth => format!("{:>16}", if *truth > 0.5 { "yes" } else { "no" }),
            Some(value) => format!("{:>16}", format!("{value:.3} {unit}")),
        };
        text.push_str(&format!("  {label:26}{}\n", values.iter().map(cell).collect::<String>()));
    }
    outcomes.iter().for_each(|outcome| text.push_str(&undefined(outcome.policy, &outcome.metrics)));
    for outcome in outcomes {
        for event in &outcome.trace.events {
            text.push_str(&format!("  {:6.2} s  {}: {}\n", event.time_s, outcome.policy, event.text));
        }
    }
    text
}

/// Checks that no more than one output goes to standard output.
pub fn check(args: &Args) -> anyhow::Result<()> {
    let both = args.json && table_to_output(args);
    anyhow::ensure!(!both, "--json and --csv would both go to standard output: name a file for one");
    Ok(())
}

fn table_to_output(args: &Args) -> bool {
    args.csv.as_ref().is_some_and(|path| Target::of(path).is_ok_and(|target| target == Target::Output))
}

/// Prints the summary or the JSON object, and writes the CSV file.
pub fn tell(args: &Args, title: &str, outcomes: &[Outcome<'_>], object: impl FnOnce() -> Value) -> anyhow::Result<()> {
    if let Some(path) = &args.csv {
        files::write_with(path, |file| write_csv(file, outcomes))
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    if table_to_output(args) {
        // Standard output holds the CSV, so the summary goes to standard error.
        terminal::note(summary(title, outcomes).trim_end());
    } else if args.json {
        terminal::print(format_args!("{}\n", object()))?;
    } else {
        terminal::print(summary(title, outcomes))?;
    }
    Ok(())
}

/// Lists undefined metrics of a policy with their reasons, one line for each reason. A missing fall needs no line.
pub fn undefined<'a>(policy: &str, metrics: impl IntoIterator<Item = &'a Metric>) -> String {
    let mut labels: Vec<(&str, Vec<&str>)> = Vec::new();
    for Metric { label, reason, .. } in metrics {
        let Some(reason) = reason.filter(|reason| *reason != metrics::NO_FALL) else { continue };
        match labels.iter_mut().find(|(known, _)| *known == reason) {
            Some((_, labels)) if labels.contains(label) => {}
            Some((_, labels)) => labels.push(label),
            None => labels.push((reason, vec![label])),
        }
    }
    let line =
        |(reason, labels): (&str, Vec<&str>)| format!("  undefined for {policy}, as {reason}: {}\n", labels.join("; "));
    labels.into_iter().map(line).collect()
}

/// Returns the result as one JSON object.
pub fn to_json(scenario: &Scenario, seed: u64, sensing: Sensing, outcomes: &[Outcome<'_>]) -> Value {
    json!({
        "scenario": scenario.name(),
        "revision": git_revision(),
        "mujoco": mujoco_version(),
        "seed": seed,
        "sensing": sensing,
        "parameters": scenario,
        "units": units(outcomes),
        "runs": outcomes.iter().map(run).collect::<Vec<_>>(),
    })
}

/// Returns a playback as JSON.
pub fn run(outcome: &Outcome<'_>) -> Value {
    let undefined: serde_json::Map<String, Value> =
        outcome.metrics.iter().filter_map(|metric| Some((metric.name.to_owned(), json!(metric.reason?)))).collect();
    json!({
        "policy": outcome.policy,
        "sha256": outcome.sha256,
        "robot": outcome.robot,
        "metrics": metrics::by_name(&outcome.metrics, Metric::to_json),
        "undefined": undefined,
        "events": outcome.trace.events,
    })
}

/// Returns the units of the metrics by name.
pub fn units(outcomes: &[Outcome<'_>]) -> Value {
    let metrics = outcomes.first().map_or(&[][..], |outcome| &outcome.metrics);
    metrics::by_name(metrics, |metric| json!(metric.unit))
}

/// A column of the CSV file: its name, and its value in a frame.
type Column = (&'static str, fn(&Frame) -> f64);

/// Columns that every frame has.
const COLUMNS: [Column; 26] = [
    ("time_s", |frame| frame.time_s),
    ("x_m", |frame| frame.position[0]),
    ("y_m", |frame| frame.position[1]),
    ("height_m", |frame| frame.height_m),
    ("roll_rad", |frame| frame.roll_pitch_yaw[0]),
    ("pitch_rad", |frame| frame.roll_pitch_yaw[1]),
    ("yaw_rad", |frame| frame.roll_pitch_yaw[2]),
    ("forward_m_s", |frame| frame.velocity_in_heading[0]),
    ("left_m_s", |frame| frame.velocity_in_heading[1]),
    ("yaw_rad_s", |frame| frame.yaw_rate),
    ("command_forward_m_s", |frame| frame.command.forward),
    ("command_left_m_s", |frame| frame.command.left),
    ("command_yaw_rad_s", |frame| frame.command.yaw),
    ("power_w", |frame| frame.power_w),
    ("torque_n_m", |frame| frame.torque_n_m),
    ("reward", |frame| frame.reward),
    ("peak_foot_force_n", |frame| frame.peak_foot_force_n),
    ("peak_obstacle_force_n", |frame| frame.peak_obstacle_force_n),
    ("rope_force_n", rope_force_n),
    ("foot_fr_up_n", |frame| frame.foot_forces[0][2]),
    ("foot_fl_up_n", |frame| frame.foot_forces[1][2]),
    ("foot_rr_up_n", |frame| frame.foot_forces[2][2]),
    ("foot_rl_up_n", |frame| frame.foot_forces[3][2]),
    ("base_x_m_s", |frame| frame.velocity[0]),
    ("base_y_m_s", |frame| frame.velocity[1]),
    ("base_z_m_s", |frame| frame.velocity[2]),
];

/// Returns the force of a rope with a load, a leash that is led, or a soft wall \[N\].
fn rope_force_n(frame: &Frame) -> f64 {
    let of_spring = frame.spring.map_or(0.0, |spring| spring.force_n);
    frame.rope.as_ref().map_or(of_spring, |rope| rope.force_n)
}

/// Columns of the state estimated from sensors; empty where the policy acts on the true state.
const ESTIMATED: [&str; 6] = [
    "estimated_x_m",
    "estimated_y_m",
    "estimated_height_m",
    "estimated_base_x_m_s",
    "estimated_base_y_m_s",
    "estimated_base_z_m_s",
];

/// Columns of the force on the trunk, felt and true, heading frame, low-passed over 0.1 s.
const FELT: [&str; 5] = ["felt_forward_n", "felt_left_n", "true_forward_n", "true_left_n", "felt_is_trusted"];

/// Writes the traces as CSV, one row for each policy step.
pub fn write_csv(file: &mut dyn Write, outcomes: &[Outcome<'_>]) -> io::Result<()> {
    let mut table = csv::Writer::from_writer(file);
    table.write_record(["policy"].into_iter().chain(COLUMNS.map(|(name, _)| name)).chain(ESTIMATED).chain(FELT))?;
    for outcome in outcomes {
        for frame in &outcome.trace.frames {
            table.write_field(outcome.policy)?;
            for (_, value) in COLUMNS {
                table.write_field(value(frame).to_string())?;
            }
            let estimated = frame.sensed.map(|sensed| {
                let ([x, y, _], [u, v, w]) = (sensed.position, sensed.velocity);
                [x, y, sensed.height_m, u, v, w].map(|value| value.to_string())
            });
            let felt = frame.felt.map(|felt| {
                let ([forward, left, _], [true_forward, true_left, _]) = (felt.force, felt.true_force);
                let [a, b, c, d] = [forward, left, true_forward, true_left].map(|force| force.to_string());
                [a, b, c, d, felt.doubt.is_none().to_string()]
            });
            table.write_record(estimated.unwrap_or_default().into_iter().chain(felt.unwrap_or_default()))?;
        }
    }
    table.flush()
}
