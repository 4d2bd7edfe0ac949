//! E6: walking into a free box (Fig. 6).

use super::prelude::*;
use crate::plot::top_view::{self, Run, View};
use crate::results::Results;
use crate::section_content::{Line, Lines};
use crate::trial::{Sample, TrialEnd};
use supple::scenario::Script;
use supple::scenario::catalog::FreeBox as BoxScenario;
use supple::scenario::trace::{Frame, Pose, Trace};

const QUANTITIES: &[Quantity] = &[
    Quantity::new("box_displacement_m", "box moved by", "m", 2),
    Quantity::new("peak_contact_force_n", "peak contact force", "N", 0),
    Quantity::new("mean_contact_force_n", "mean contact force", "N", 1),
    Quantity::new("contact_impulse_n_s", "impulse", "N·s", 1),
    Quantity::new("contact_time_s", "time in contact", "s", 2),
    Quantity::new("passed", "got past the box", "%", 0),
    Quantity::new("resumed", "resumed its course", "%", 0),
    Quantity::new("sideways_m", "sideways distance from its line at the end", "m", 2),
    FELL,
];

/// The number of policy steps between the kept points of a path.
const PATH_STEPS: usize = 6;

/// A robot is back on its course if its mean velocity over this time at the end \[s\] is this close to the command \[m/s\].
const RESUMED_S: f64 = 1.0;
const RESUMED_M_S: f64 = 0.1;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FreeBox {
    pub trials: u32,
    /// The sliding friction coefficients of the box.
    pub frictions: Vec<f64>,
}

impl FreeBox {
    /// Returns true if the robot ends up walking at its command in the direction in which it started.
    fn has_resumed(script: &Script, trace: &Trace) -> bool {
        let frames = metrics::window(trace, script.duration_s - RESUMED_S, script.duration_s);
        let velocity = |frame: &Frame| {
            let [forward, left, _] = frame.velocity_in_heading;
            metrics::in_world([forward, left], frame.roll_pitch_yaw[2])
        };
        let mean = |axis: usize| metrics::mean(frames.clone(), |frame| velocity(frame)[axis]);
        let command = script.command;
        let is_near = |(ahead, left)| f64::hypot(ahead - command.forward, left - command.left) < RESUMED_M_S;
        mean(0).zip(mean(1)).is_some_and(is_near)
    }

    /// Returns the runs of a set at the first friction, for the figure.
    fn view(&self, results: &Results, set: usize) -> View {
        let (title, policy) = results.shown(set);
        let samples = policy.and_then(|policy| policy.first()).into_iter().flatten();
        View { title, runs: samples.filter_map(run).collect() }
    }
}

/// Reads a run from the series of a trial: the path's x and y, the box's first and last pose.
fn run(sample: &Sample) -> Option<Run> {
    let [x, y, first, last] = sample.series.as_slice() else { return None };
    let pose = |series: &[f32]| <[f32; 3]>::try_from(series).ok().map(|pose| pose.map(f64::from));
    let path = x.iter().zip(y).map(|(x, y)| [f64::from(*x), f64::from(*y)]).collect();
    Some(Run { path, first: pose(first)?, last: pose(last)?, fell: sample.end == TrialEnd::Fell })
}

/// Returns x \[m\], y \[m\] and yaw \[rad\] of a pose.
fn flat_pose(pose: &Pose) -> Vec<f32> {
    let [w, x, y, z] = pose.quaternion;
    let yaw = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
    vec![pose.position[0], pose.position[1], yaw]
}

/// Returns the points of the figure: the robot's paths, and the poses of the box before and after.
fn paths_and_boxes(views: &[View]) -> [Lines; 2] {
    let lines = |of: fn(&Run) -> Vec<Vec<f64>>| {
        let runs = |View { title, runs }: &View| {
            let line = |(trial, run)| Line { label: format!("{title}, trial {trial}"), rows: of(run) };
            runs.iter().enumerate().map(line).collect::<Vec<_>>()
        };
        views.iter().flat_map(runs).collect()
    };
    let paths = lines(|run| run.path.iter().map(|point| point.to_vec()).collect());
    let boxes = lines(|run| vec![run.first.to_vec(), run.last.to_vec()]);
    [
        Lines { name: "box-paths".into(), columns: vec!["x_m", "y_m"], lines: paths },
        Lines { name: "box-before-and-after".into(), columns: vec!["x_m", "y_m", "yaw_rad"], lines: boxes },
    ]
}

impl Experiment for FreeBox {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            paper: "Fig. 6",
            method: "At 0.4 m/s the robot walks into a free cube of 2 kg and 0.5 m edge length. Its friction varies, \
                     as the paper does not state it. The cube is offset sideways by an amount drawn for each trial. \
                     Contact forces are the sum over all contacts between robot and box at 240 Hz; the mean is over \
                     the time in contact. The robot has got past when it ends beyond the box's far side, and has \
                     resumed its course when it then walks at its command in the direction in which it started. \
                     Displacement and forces are of trials in which it touched the box.",
            ..ExperimentInfo::new("E6", 6, "box", "Collision with a box", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: BoxScenario = defaults("box")?;
        Ok(conditions(&self.frictions, |friction| {
            let scenario = Scenario::Box(BoxScenario { friction: *friction, ..base.clone() });
            (format!("friction {}", brief(*friction)), scenario)
        }))
    }

    fn measure(&self, trial: &Trial) -> TrialValues {
        let trace = trial.trace;
        let passed = trial.upright_metric("passed") == Some(1.0);
        // Zero force would look gentle if the robot missed the box.
        let was_met = trial.metric("contact_time_s").is_some_and(|time_s| time_s > 0.0);
        let of_met = |quantity: &Quantity| trial.upright_metric(quantity.name).filter(|_| was_met);
        let sideways = trace.frames.last().map(|frame| frame.position[1].abs()).filter(|_| trial.is_upright());
        let mut values: Vec<Option<f64>> = QUANTITIES[..5].iter().map(of_met).collect();
        let resumed = passed && Self::has_resumed(trial.script, trace);
        values.extend([indicator(passed), indicator(resumed), sideways, trial.end.fell()]);

        let path = |axis: usize| trace.frames.iter().step_by(PATH_STEPS).map(|f| f.position[axis] as f32).collect();
        let poses: Vec<Pose> = trace.frames.iter().filter_map(|frame| frame.goal).collect();
        let series = match (poses.first(), poses.last()) {
            (Some(first), Some(last)) => vec![path(0), path(1), flat_pose(first), flat_pose(last)],
            _ => Vec::new(),
        };
        TrialValues { values, series }
    }

    fn report(&self, section: &mut SectionBuilder) {
        section.table("Collision with a free box of 2 kg, by its friction.");
        let size_m = match &section.results.conditions[0].scenario {
            Scenario::Box(free_box) => free_box.size_m,
            _ => 0.0,
        };
        let views = section.by_set(|set| self.view(section.results, set));
        section.content.lines.extend(paths_and_boxes(&views));
        let caption = format!(
            "Walking into a free box ({}), seen from above; the robot starts at (0, 0) and walks to the right. In \
             full: one trial with the robot's path, the box before (dashed) and after (filled). Faint: the other \
             trials of the same policy with the box after. A cross is a fall.",
            section.first_label()
        );
        let title = "Paths of the robot and the box, seen from above";
        section.figure("", caption, top_view::draw(title, &views, size_m));
        section.dots(
            "forces",
            "Displacement of the box and forces on it, by its friction",
            &["box_displacement_m", "peak_contact_force_n", "mean_contact_force_n", "passed"],
            "",
        );
        for (text, paper, quantity, expected) in [
            ("Compliant policies displace a box in their way less", "less", "box_displacement_m", Lower),
            ("Compliant policies push the box with a lower mean force", "milder", "mean_contact_force_n", Lower),
            ("Compliant policies hit the box with a lower peak force", "milder", "peak_contact_force_n", Lower),
            ("Compliant policies get past the box more often", "past", "passed", Higher),
            ("Compliant policies resume their course past the box more often", "resume", "resumed", Higher),
        ] {
            for ConditionGroup { name, conditions } in section.each() {
                section.claim(&format!("{text} ({name})"), paper, quantity, expected, &conditions);
            }
        }
    }
}
