/*! The live readout: the numbers shown while a robot is driven.

The definitions are those of [`metrics`], applied to the frames so far. A push is measured for [`WATCHED_S`], or until a
fall, another command or another push.
*/

use serde::Serialize;

use super::RobotStep;
use crate::scenario::metrics::{self, STRIDE_S};
use crate::scenario::trace::{Event, EventKind, Frame, Trace};
use crate::task::Command;

/// Time for which a push is measured \[s\].
pub const WATCHED_S: f64 = 4.0;

/// Time over which the displacement by a push is measured \[s\].
pub const CARRIED_S: f64 = 2.0;

/// Remaining fraction at which a push counts as decayed.
const DECAYED: f64 = 0.1;

/// Time before a push for which frames are kept \[s\].
const BEFORE_S: f64 = 1.0;

/// The outcome of a push.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The push is still being measured.
    Watching,
    /// The measurement is complete.
    Over,
    /// The robot fell.
    Fell,
    /// Another command, push or pull came before the measurement was complete.
    Disturbed,
}

/// The effect of a push.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PushReading {
    /// Time of the push on the robot's clock \[s\].
    pub at_s: f64,
    /// Change of velocity, forward and left in the heading frame [m/s].
    pub size_m_s: [f64; 2],
    /// Displacement along the push, relative to the undisturbed walk, within [`CARRIED_S`] \[m\].
    pub carried_m: Option<f64>,
    /// Time until a tenth of the push was left, if it has decayed so far \[s\].
    pub decay_s: Option<f64>,
    /// Outcome of the push.
    pub outcome: Outcome,
}

/// The effect of a pull.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PullReading {
    /// Force of the pull \[N\].
    pub force_n: f64,
    /// Velocity along the pull minus the commanded one, mean over a stride [m/s].
    pub gives_m_s: f64,
}

/// The present numbers of a robot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reading {
    /// Velocity: forward [m/s], left [m/s], yaw rate [rad/s]; mean over a stride.
    pub velocity: [f64; 3],
    /// Commanded velocity, in the same order and units.
    pub command: [f64; 3],
    /// Mechanical power, mean over a second \[W\].
    pub power_w: f64,
    /// The last push and its effect.
    pub push: Option<PushReading>,
    /// The present pull and its effect.
    pub pull: Option<PullReading>,
    /// Felt force on the trunk, forward and left in the heading frame \[N\]; `None` where it cannot be trusted.
    pub felt_n: Option<[f64; 2]>,
}

/// Computes the numbers of one robot, step by step.
#[derive(Debug)]
pub struct LiveReadout {
    /// Frames of the last second, and all frames since the push being measured.
    trace: Trace,
    pushed: Option<Pushed>,
    pulled: Option<[f64; 2]>,
}

#[derive(Debug)]
struct Pushed {
    reading: PushReading,
    command: Command,
    /// True if [`LiveReadout::concluded`] has returned the last push.
    is_reported: bool,
}

impl LiveReadout {
    /// Starts a readout of a robot with this weight \[N\] and policy period \[s\].
    pub fn new((weight_n, period_s): (f64, f64)) -> Self {
        let trace = Trace { period_s, weight_n, ..Trace::default() };
        LiveReadout { trace, pushed: None, pulled: None }
    }

    /// Records a push before it is applied, forward and left in the heading frame [m/s]. Returns the push that it
    /// disturbs.
    pub fn push(&mut self, size_m_s: [f64; 2]) -> Option<PushReading> {
        self.conclude(Outcome::Disturbed);
        let disturbed = self.concluded();
        let at_s = self.time_s();
        self.forget_before(at_s);
        let command = self.trace.frames.last().map_or_else(Command::default, |frame| frame.command);
        let reading = PushReading { at_s, size_m_s, carried_m: None, decay_s: None, outcome: Outcome::Watching };
        self.pushed = Some(Pushed { reading, command, is_reported: false });
        disturbed
    }

    /// Records a pull from now on, forward and left in the heading frame \[N\]; `None` ends it.
    pub fn pull(&mut self, force_n: Option<[f64; 2]>) {
        self.conclude(Outcome::Disturbed);
        self.pulled = force_n;
    }

    /// Returns the present pull, as given to [`LiveReadout::pull`].
    pub fn pulled(&self) -> Option<[f64; 2]> {
        self.pulled
    }

    /// Adds a step of the robot.
    pub fn note(&mut self, step: &RobotStep) {
        if step.is_beginning {
            // The robot was placed somewhere else.
            self.conclude(Outcome::Disturbed);
            self.trace.frames.clear();
        }
        match &step.frame {
            Some(frame) => self.add(frame, &step.events),
            None => self.conclude(Outcome::Fell),
        }
    }

    fn add(&mut self, frame: &Frame, events: &[Event]) {
        // Poses of bodies are most of a frame, and no metric reads them.
        self.trace.frames.push(light(frame));
        let pushed = self.pushed.as_ref().filter(|pushed| pushed.reading.outcome == Outcome::Watching);
        let (at_s, command) = match pushed {
            Some(Pushed { reading, command, .. }) => (reading.at_s, *command),
            None => return self.forget_before(frame.time_s),
        };
        if events.iter().any(|event| matches!(event.kind, EventKind::Fall | EventKind::Fault)) {
            self.conclude(Outcome::Fell);
        } else if frame.command != command {
            self.trace.frames.pop();
            self.conclude(Outcome::Disturbed);
        } else if frame.time_s > at_s + WATCHED_S {
            self.conclude(Outcome::Over);
        }
    }

    /// Returns the push whose measurement has ended, once.
    pub fn concluded(&mut self) -> Option<PushReading> {
        let pushed = self.pushed.as_mut().filter(|pushed| pushed.reading.outcome != Outcome::Watching)?;
        (!std::mem::replace(&mut pushed.is_reported, true)).then_some(pushed.reading)
    }

    /// Returns the time of the robot's clock \[s\].
    pub fn time_s(&self) -> f64 {
        self.trace.frames.last().map_or(0.0, |frame| frame.time_s)
    }

    /// Ends the measurement of the push with the numbers so far.
    fn conclude(&mut self, outcome: Outcome) {
        let reading = self.push_reading();
        if let (Some(pushed), Some(reading)) = (&mut self.pushed, reading)
            && pushed.reading.outcome == Outcome::Watching
        {
            pushed.reading = PushReading { outcome, ..reading };
        }
    }

    fn push_reading(&self) -> Option<PushReading> {
        let reading = self.pushed.as_ref()?.reading;
        if reading.outcome != Outcome::Watching {
            return Some(reading);
        }
        let PushReading { at_s, size_m_s, .. } = reading;
        let since_s = self.trace.frames.last()?.time_s - at_s;
        let carried_m = metrics::carried(&self.trace, at_s, size_m_s, since_s.min(CARRIED_S));
        let decay = metrics::decay(&self.trace, at_s, size_m_s, DECAYED, STRIDE_S);
        Some(PushReading { carried_m, decay_s: decay.and_then(metrics::Decay::ended_s), ..reading })
    }

    fn forget_before(&mut self, time_s: f64) {
        let kept = |frame: &Frame| frame.time_s > time_s - BEFORE_S - self.trace.period_s;
        let first = self.trace.frames.iter().position(kept).unwrap_or(self.trace.frames.len());
        self.trace.frames.drain(..first);
    }

    /// Returns the present numbers; `None` before the first step.
    pub fn read(&self) -> Option<Reading> {
        let trace = &self.trace;
        let last = trace.frames.last()?;
        let stride = || metrics::window(trace, last.time_s - STRIDE_S, last.time_s);
        let mean = |of: fn(&Frame) -> f64| metrics::mean(stride(), of).unwrap_or_default();
        let command = last.command;
        let pull = self.pulled.map(|force| {
            let force_n = force[0].hypot(force[1]);
            let along = |frame: &Frame| {
                let [forward, left, _] = frame.velocity_in_heading;
                let (forward, left) = (forward - frame.command.forward, left - frame.command.left);
                (forward * force[0] + left * force[1]) / force_n.max(f64::MIN_POSITIVE)
            };
            PullReading { force_n, gives_m_s: metrics::mean(stride(), along).unwrap_or_default() }
        });
        Some(Reading {
            velocity: [
                mean(|it| it.velocity_in_heading[0]),
                mean(|it| it.velocity_in_heading[1]),
                mean(|it| it.yaw_rate),
            ],
            command: [command.forward, command.left, command.yaw],
            power_w: metrics::mean(metrics::window(trace, last.time_s - 1.0, last.time_s), |frame| frame.power_w)?,
            push: self.push_reading(),
            pull,
            felt_n: last.felt.filter(|felt| felt.doubt.is_none()).map(|felt| [felt.force[0], felt.force[1]]),
        })
    }
}

/// Copies the parts of a frame that the readout needs.
fn light(frame: &Frame) -> Frame {
    let (time_s, command, velocity_in_heading) = (frame.time_s, frame.command, frame.velocity_in_heading);
    let (yaw_rate, power_w) = (frame.yaw_rate, frame.power_w);
    Frame { time_s, command, felt: frame.felt, velocity_in_heading, yaw_rate, power_w, ..Frame::default() }
}
