/*! Metrics of traces: the definitions behind every table and figure, as pure functions.

Times are simulation times. A *window* is half-open, `(from, until]`, because a frame stands for the step that ends at
its time. Velocities are in the heading frame (forward, left).
*/

use crate::scenario::trace::{Frame, Trace};
use crate::task::Command;
use crate::util::numbers::{self, maximum};

/// Length of the moving average in decay times, about a stride \[s\].
pub const STRIDE_S: f64 = 0.4;

/// Length of a shorter moving average, for robots that stand \[s\].
pub const BRIEF_S: f64 = 0.1;

/// Largest delay of a disturbance, drawn from the seed so that it meets the gait at any phase \[s\]: about a
/// stride at 0.5 m/s of the slowest shipped policies, which take up to 0.69 s.
pub const PHASE_S: f64 = 0.65;

/// Time after which a robot that started at rest walks steadily \[s\].
pub const SETTLE_S: f64 = 2.0;

/// Smallest contact force of a foot that counts as touching \[N\].
const CONTACT_N: f64 = 1.0;

/// Unit of truth values: 1 for yes, 0 for no.
pub const TRUTH: &str = "yes/no";

/// A named number with its unit, or the reason why the trace does not define it.
#[derive(Debug, Clone, PartialEq)]
pub struct Metric {
    /// Name in snake case, which ends in the unit.
    pub name: &'static str,
    /// Label in tables and figures.
    pub label: &'static str,
    /// The value, if the trace defines it.
    pub value: Option<f64>,
    /// Unit of the number.
    pub unit: &'static str,
    /// Reason why there is no value.
    pub reason: Option<&'static str>,
}

/// Reason for a missing time of the fall.
pub const NO_FALL: &str = "it did not fall";

impl Metric {
    /// Creates a metric without a reason for a missing value.
    pub fn new(name: &'static str, label: &'static str, value: Option<f64>, unit: &'static str) -> Self {
        Metric { name, label, value, unit, reason: None }
    }

    /// Sets the reason for a missing value, unless one is set.
    pub fn because(mut self, reason: &'static str) -> Self {
        if self.value.is_none() {
            self.reason.get_or_insert(reason);
        }
        self
    }

    /// Returns true if the metric is a truth value.
    pub fn is_truth(&self) -> bool {
        self.unit == TRUTH
    }

    /// Converts the value to JSON: a number, `true` or `false`, or null.
    pub fn to_json(&self) -> serde_json::Value {
        match self.value {
            Some(truth) if self.is_truth() => (truth > 0.5).into(),
            value => value.into(),
        }
    }
}

/// Returns a JSON object with something of each metric by its name, such as [`Metric::to_json`].
pub fn by_name(metrics: &[Metric], of: impl Fn(&Metric) -> serde_json::Value) -> serde_json::Value {
    metrics.iter().map(|metric| (metric.name.to_owned(), of(metric))).collect()
}

/// Iterates over the frames of a window.
pub fn window(trace: &Trace, from_s: f64, until_s: f64) -> impl Iterator<Item = &Frame> + Clone {
    let half_s = 0.5 * trace.period_s;
    trace.frames.iter().filter(move |frame| frame.time_s > from_s + half_s && frame.time_s < until_s + half_s)
}

/// Iterates over the frames of a window, if the trace covers all of it.
pub fn whole_window(trace: &Trace, from_s: f64, until_s: f64) -> Option<impl Iterator<Item = &Frame> + Clone> {
    let half_s = 0.5 * trace.period_s;
    let end_s = trace.frames.last()?.time_s;
    (from_s > -half_s && end_s + half_s > until_s).then(|| window(trace, from_s, until_s))
}

/// Returns the mean of a quantity over frames, if there are any.
pub fn mean<'a>(frames: impl Iterator<Item = &'a Frame>, of: impl Fn(&Frame) -> f64) -> Option<f64> {
    numbers::mean(frames.map(of))
}

/// Returns the mean velocity minus the command: forward [m/s], left [m/s], yaw rate [rad/s].
pub fn velocity_errors(trace: &Trace, from_s: f64, until_s: f64) -> Option<[f64; 3]> {
    let frames = window(trace, from_s, until_s);
    Some([
        mean(frames.clone(), |frame| frame.velocity_in_heading[0] - frame.command.forward)?,
        mean(frames.clone(), |frame| frame.velocity_in_heading[1] - frame.command.left)?,
        mean(frames, |frame| frame.yaw_rate - frame.command.yaw)?,
    ])
}

/// Returns the length of the horizontal part of [`velocity_errors`] [m/s].
pub fn velocity_error(trace: &Trace, from_s: f64, until_s: f64) -> Option<f64> {
    velocity_errors(trace, from_s, until_s).map(|[forward, left, _]| forward.hypot(left))
}

/// Returns mechanical power divided by weight and horizontal speed; `None` if the robot stands or is commanded to
/// stand.
pub fn cost_of_transport(trace: &Trace, from_s: f64, until_s: f64) -> Option<f64> {
    let frames = window(trace, from_s, until_s);
    if frames.clone().all(|frame| Command { compliance: None, ..frame.command } == Command::default()) {
        return None;
    }
    let power_w = mean(frames.clone(), |frame| frame.power_w)?;
    let forward = mean(frames.clone(), |frame| frame.velocity_in_heading[0])?;
    let left = mean(frames, |frame| frame.velocity_in_heading[1])?;
    let speed = forward.hypot(left);
    (speed > 0.05).then(|| power_w / (trace.weight_n * speed))
}

/// Returns true if a foot touches the ground.
fn touching(frame: &Frame, leg: usize) -> bool {
    frame.foot_forces[leg].iter().map(|force| force * force).sum::<f64>().sqrt() > CONTACT_N
}

/// Returns the fraction of the time in which no foot touches the ground: near 0 in a trot, near 1 in hopping.
pub fn flight_fraction(trace: &Trace, from_s: f64, until_s: f64) -> Option<f64> {
    mean(window(trace, from_s, until_s), |frame| f64::from(!(0..4).any(|leg| touching(frame, leg))))
}

/// Returns the number of touchdowns of a foot per second, mean over the feet \[Hz\].
pub fn stride_frequency(trace: &Trace, from_s: f64, until_s: f64) -> Option<f64> {
    let mut touchdowns = 0_u32;
    for leg in 0..4 {
        let mut airborne_since: Option<f64> = None;
        for frame in window(trace, from_s, until_s) {
            match (touching(frame, leg), airborne_since) {
                // Chatter of a standing foot is not a step.
                (true, Some(since_s)) => {
                    touchdowns += u32::from(frame.time_s - since_s > 0.05);
                    airborne_since = None;
                }
                (false, None) => airborne_since = Some(frame.time_s),
                _ => {}
            }
        }
    }
    (until_s > from_s).then(|| f64::from(touchdowns) / 4.0 / (until_s - from_s))
}

/// Returns the mean peak height of feet between touchdowns \[m\].
pub fn swing_height(trace: &Trace, from_s: f64, until_s: f64) -> Option<f64> {
    let mut peaks = Vec::new();
    for leg in 0..4 {
        let mut peak: Option<f64> = None;
        for frame in window(trace, from_s, until_s) {
            if touching(frame, leg) {
                // Chatter of a standing foot is not a swing.
                peaks.extend(peak.take().filter(|peak| *peak > 0.005));
            } else {
                peak = Some(peak.unwrap_or(0.0).max(frame.foot_heights[leg]));
            }
        }
    }
    (!peaks.is_empty()).then(|| peaks.iter().sum::<f64>() / peaks.len() as f64)
}

/// Duration of a velocity disturbance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decay {
    /// Time from the push to the last time at which the disturbance exceeds the threshold \[s\].
    pub time_s: f64,
    /// False if the threshold is still exceeded at the end of the trace; `time_s` is then a lower bound.
    pub is_over: bool,
}

impl Decay {
    /// Returns the duration of the disturbance, if it is over \[s\].
    pub fn ended_s(self) -> Option<f64> {
        self.is_over.then_some(self.time_s)
    }
}

/// Measures how long a velocity disturbance lasts.
///
/// `e(t)` is the velocity along the push minus its mean over the last second before the push, smoothed by a centred
/// moving average of `average_s`. It lasts until the last time after the push at which `|e|` exceeds `threshold`
/// times the push's size. Returns `None` after a fall, or if the trace does not cover the time around the push.
pub fn decay(trace: &Trace, push_s: f64, push: [f64; 2], threshold: f64, average_s: f64) -> Option<Decay> {
    let (error, size) = push_error(trace, push_s, push)?;
    let half = (0.5 * average_s / trace.period_s).round() as usize;
    let smoothed = |index: usize| {
        let span = &error[index.saturating_sub(half)..(index + half + 1).min(error.len())];
        span.iter().map(|(_, value)| value).sum::<f64>() / span.len() as f64
    };
    // The average reaches half its length beyond the last frame it can be formed for.
    let last = error.len().checked_sub(half + 1)?;
    let first = error.iter().position(|(time_s, _)| *time_s > 0.0).filter(|first| *first <= last)?;
    Some(match (first..=last).rev().find(|index| smoothed(*index).abs() > threshold * size) {
        Some(index) => Decay { time_s: error[index].0, is_over: index < last },
        None => Decay { time_s: 0.0, is_over: true },
    })
}

/// Returns the displacement by a push along its direction, relative to the undisturbed walk: the integral of `e(t)`
/// over `for_s` after the push \[m\]. It needs no threshold and no average; divided by the push's size it is the time
/// constant of an exponential decay. `None` after a fall, or if the trace ends before.
pub fn carried(trace: &Trace, push_s: f64, push: [f64; 2], for_s: f64) -> Option<f64> {
    let (error, _) = push_error(trace, push_s, push)?;
    let half_s = 0.5 * trace.period_s;
    if error.last()?.0 < for_s - half_s {
        return None;
    }
    let after = error.iter().filter(|(time_s, _)| *time_s > half_s && *time_s < for_s + half_s);
    Some(after.map(|(_, value)| value * trace.period_s).sum())
}

/// Returns, for each frame, the time since a push and the velocity along it minus its mean over the second before, and
/// the size of the push.
fn push_error(trace: &Trace, push_s: f64, push: [f64; 2]) -> Option<(Vec<(f64, f64)>, f64)> {
    let size = push[0].hypot(push[1]);
    if trace.fall().is_some() || size <= 0.0 {
        return None;
    }
    let along =
        |frame: &Frame| (frame.velocity_in_heading[0] * push[0] + frame.velocity_in_heading[1] * push[1]) / size;
    let before = mean(window(trace, push_s - 1.0, push_s), along)?;
    Some((trace.frames.iter().map(|frame| (frame.time_s - push_s, along(frame) - before)).collect(), size))
}

/// Returns the mean velocity offset from the command along a force that is constant in the world frame [m/s].
pub fn offset_along_force(trace: &Trace, force: [f64; 2], from_s: f64, until_s: f64) -> Option<f64> {
    let size = force[0].hypot(force[1]);
    let along = |frame: &Frame| {
        let yaw = frame.roll_pitch_yaw[2];
        let (forward, left) = (
            (force[0] * yaw.cos() + force[1] * yaw.sin()) / size,
            (force[1] * yaw.cos() - force[0] * yaw.sin()) / size,
        );
        (frame.velocity_in_heading[0] - frame.command.forward) * forward
            + (frame.velocity_in_heading[1] - frame.command.left) * left
    };
    if trace.fall().is_some() || size <= 0.0 { None } else { mean(window(trace, from_s, until_s), along) }
}

/// Returns the yaw at a time, that of the last frame up to then \[rad\].
pub fn yaw_at(trace: &Trace, time_s: f64) -> Option<f64> {
    let half_s = 0.5 * trace.period_s;
    trace.frames.iter().rfind(|frame| frame.time_s < time_s + half_s).map(|frame| frame.roll_pitch_yaw[2])
}

/// Rotates a direction from the heading frame at a yaw to the world frame.
pub fn in_world([forward, left]: [f64; 2], yaw: f64) -> [f64; 2] {
    let (sin, cos) = yaw.sin_cos();
    [forward * cos - left * sin, forward * sin + left * cos]
}

/// Returns the displacement along a direction beyond the commanded one \[m\]. The direction and the commanded course
/// are those of the heading at the start. `None` after a fall, or if the trace ends before.
pub fn displacement_off_course(trace: &Trace, direction: [f64; 2], from_s: f64, until_s: f64) -> Option<f64> {
    let yaw = yaw_at(trace, from_s)?;
    let frames = || window(trace, from_s, until_s);
    let (first, last) = (frames().next()?, frames().last()?);
    if trace.fall().is_some() || last.time_s + trace.period_s < until_s {
        return None;
    }
    let along = in_world(direction, yaw);
    let moved = [0, 1].map(|axis| last.position[axis] - first.position[axis]);
    let commanded = first.command.forward * direction[0] + first.command.left * direction[1];
    Some(moved[0] * along[0] + moved[1] * along[1] - commanded * (last.time_s - first.time_s))
}

/// Returns the largest value of a quantity.
pub fn largest<'a>(frames: impl Iterator<Item = &'a Frame>, of: impl Fn(&Frame) -> f64) -> Option<f64> {
    frames.map(of).reduce(maximum)
}

/// Returns the times at which the trunk passes two lines across the course (world frame, x), if it passes both \[s\].
pub fn crossing(trace: &Trace, first_m: f64, last_m: f64) -> Option<[f64; 2]> {
    let when = |line_m: f64| Some(trace.frames.iter().find(|frame| frame.position[0] > line_m)?.time_s);
    Some([when(first_m)?, when(last_m)?])
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::scenario::trace::{Event, EventKind};

    /// Creates a trace at 60 Hz whose velocity in the heading frame is a function of time.
    pub(crate) fn synthetic(duration_s: f64, velocity: impl Fn(f64) -> [f64; 3]) -> Trace {
        let period_s = 1.0 / 60.0;
        let frames = (1..=(duration_s / period_s).round() as usize)
            .map(|step| {
                let time_s = step as f64 * period_s;
                Frame { time_s, velocity_in_heading: velocity(time_s), ..Frame::default() }
            })
            .collect();
        Trace { period_s, weight_n: 128.5, frames, events: Vec::new() }
    }

    #[test]
    fn a_decaying_exponential_has_its_analytic_decay_time() {
        // e(t) = 0.5 exp(−t / 0.2) falls to 10 % at t = 0.2 ln 10 = 0.4605 s.
        let trace = synthetic(5.0, |t| [0.5, if t > 2.0 { 0.5 * (-(t - 2.0) / 0.2).exp() } else { 0.0 }, 0.0]);
        let found = decay(&trace, 2.0, [0.0, 0.5], 0.1, 0.0).unwrap();
        assert!((found.time_s - 0.4605).abs() <= 1.0 / 60.0 && found.is_over, "{found:?}");
        // The mean of 25 samples around one of an exponential is the sample times sinh(25/24) / (25 sinh(1/24)) = 1.1908,
        // 1/24 being half a period over the time constant: 0.2 ln 11.908 = 0.4955 s.
        let found = decay(&trace, 2.0, [0.0, 0.5], 0.1, STRIDE_S).unwrap();
        assert!((found.time_s - 0.4955).abs() <= 1.0 / 60.0 && found.is_over, "{found:?}");
    }

    #[test]
    fn a_decaying_exponential_carries_the_robot_by_its_time_constant() {
        // ∫ 0.5 exp(−t / 0.2) dt = 0.1 m, half a period of 0.5 m/s less or more for the sum.
        let trace = synthetic(5.0, |t| [0.5, if t > 2.0 { 0.5 * (-(t - 2.0) / 0.2).exp() } else { 0.0 }, 0.0]);
        let found = carried(&trace, 2.0, [0.0, 0.5], 2.0).unwrap();
        assert!((found - 0.1).abs() <= 0.5 * 0.5 / 60.0 + 1e-3, "{found}");
        assert_eq!(carried(&trace, 2.0, [0.0, 0.5], 3.5), None);
    }

    #[test]
    fn an_oscillating_gait_without_a_push_effect_has_decay_time_zero() {
        let trace = synthetic(5.0, |t| [0.5, 0.1 * (std::f64::consts::TAU * t / STRIDE_S).sin(), 0.0]);
        assert_eq!(decay(&trace, 2.0, [0.0, 0.5], 0.1, STRIDE_S), Some(Decay { time_s: 0.0, is_over: true }));
    }

    #[test]
    fn what_has_not_decayed_at_the_end_lasts_until_there_at_least() {
        let trace = synthetic(5.0, |t| [0.5, if t > 2.0 { 0.2 } else { 0.0 }, 0.0]);
        // The average of 0.4 s can be formed up to 4.8 s: 2.8 s after the push.
        let found = decay(&trace, 2.0, [0.0, 0.5], 0.1, STRIDE_S).unwrap();
        assert!((found.time_s - 2.8).abs() < 1e-9 && !found.is_over, "{found:?}");
        assert!(decay(&trace, 2.0, [0.0, 0.5], 0.5, STRIDE_S).unwrap().is_over);
        // A push so late that no average can be formed after it.
        assert_eq!(decay(&trace, 4.9, [0.0, 0.5], 0.1, STRIDE_S), None);
    }

    #[test]
    fn a_fall_has_no_decay_time() {
        let mut trace = synthetic(5.0, |_| [0.0; 3]);
        trace.events.push(Event { time_s: 2.5, kind: EventKind::Fall, text: String::new() });
        assert_eq!(decay(&trace, 2.0, [0.0, 0.5], 0.1, 0.0), None);
    }

    #[test]
    fn a_constant_offset_is_the_leash_offset_also_when_the_robot_has_turned() {
        // Pulled to the world's left with 10 N; the robot has turned left by 90°, so that left of the world is forward.
        let mut trace = synthetic(4.0, |_| [0.2, 0.0, 0.0]);
        trace.frames.iter_mut().for_each(|frame| frame.roll_pitch_yaw[2] = std::f64::consts::FRAC_PI_2);
        let found = offset_along_force(&trace, [0.0, 10.0], 1.0, 4.0).unwrap();
        assert!((found - 0.2).abs() < 1e-12);
    }

    #[test]
    fn displacement_counts_from_the_commanded_course() {
        // Commanded 0.5 m/s ahead, heading along the world's y. The robot goes 0.5 m/s along y and 0.1 m/s along −x,
        // which is to its left: 0.2 m to the left of its course in 2 s, nothing along it.
        let mut trace = synthetic(4.0, |_| [0.5, 0.1, 0.0]);
        for frame in &mut trace.frames {
            frame.command.forward = 0.5;
            frame.roll_pitch_yaw[2] = std::f64::consts::FRAC_PI_2;
            frame.position = [-0.1 * frame.time_s, 0.5 * frame.time_s, 0.3];
        }
        let off = |direction| displacement_off_course(&trace, direction, 1.0, 3.0).unwrap();
        // From the first frame of the window to its last there is a frame less than 2 s.
        assert!((off([0.0, 1.0]) - 0.1 * (2.0 - 1.0 / 60.0)).abs() < 1e-9 && off([1.0, 0.0]).abs() < 1e-9);
        assert_eq!(displacement_off_course(&trace, [0.0, 1.0], 3.0, 5.0), None);
    }

    #[test]
    fn windows_hold_the_frames_of_the_steps_that_end_in_them() {
        let trace = synthetic(3.0, |_| [0.0; 3]);
        assert_eq!(window(&trace, 1.0, 2.0).count(), 60);
        assert!((window(&trace, 1.0, 2.0).next().unwrap().time_s - 61.0 / 60.0).abs() < 1e-9);
    }

    #[test]
    fn steps_and_swings_are_counted_from_foot_forces() {
        // Every foot: 0.25 s on the ground, 0.25 s in the air with a peak of 6 cm: 2 strides per second.
        let mut trace = synthetic(4.0, |_| [0.5, 0.0, 0.0]);
        for frame in &mut trace.frames {
            let phase = (frame.time_s * 2.0).fract();
            let height = if phase > 0.5 { 0.06 * (std::f64::consts::TAU * (phase - 0.5)).sin() } else { 0.0 };
            frame.foot_heights = [height; 4];
            frame.foot_forces = [[0.0, 0.0, if phase > 0.5 { 0.0 } else { 30.0 }]; 4];
        }
        let frequency = stride_frequency(&trace, 0.0, 4.0).unwrap();
        assert!((frequency - 2.0).abs() <= 0.25, "{frequency}");
        assert!((swing_height(&trace, 0.0, 4.0).unwrap() - 0.06).abs() < 0.001);
        assert!((flight_fraction(&trace, 0.0, 4.0).unwrap() - 0.5).abs() < 0.04);
        // One foot that stays down is enough.
        trace.frames.iter_mut().for_each(|frame| frame.foot_forces[2] = [0.0, 0.0, 2.0]);
        assert_eq!(flight_fraction(&trace, 0.0, 4.0), Some(0.0));
    }
}
