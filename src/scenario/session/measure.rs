//! Metrics of a saved session: replays it and measures its pushes and pulls.

use super::{
    Act, Input, LiveReadout, LiveSession, Outcome, PullReading, PushReading, SceneKind, Seat, SessionError,
    SessionReplay,
};
use crate::scenario::metrics::{self, Metric, STRIDE_S};
use crate::scenario::trace::{EventKind, Frame, Trace};
use crate::util::numbers::mean;

/// A part of a session in which scene, policy and compliance of one robot do not change.
#[derive(Debug)]
pub struct Take {
    /// Kind of the scene.
    pub scene: SceneKind,
    /// Seed of the scene.
    pub seed: u64,
    /// The robot and its policy.
    pub seat: Seat,
    /// The trace without the poses of bodies.
    pub trace: Trace,
    /// Every push with its effect.
    pub pushes: Vec<PushReading>,
    /// Every pull that lasted a stride, with its effect at its end.
    pub pulls: Vec<PullReading>,
}

/// Replays a session and measures the part that is shown: one take for each robot, policy and compliance.
///
/// # Errors
/// The session cannot be replayed, for example because a policy has changed.
pub fn takes(playback: &mut SessionReplay) -> Result<Vec<Take>, SessionError> {
    let mut takes = Vec::new();
    let mut current = Watched::all(&playback.world);
    while let Some(step) = playback.step()? {
        // All inputs of this tick are already applied; those before its last setup concern robots that no longer exist.
        let is_setup = |input: &Input| matches!(input, Input::Setup(_));
        let first = step.inputs.iter().rposition(is_setup).map_or(0, |last| last + 1);
        if first > 0 {
            takes.extend(current.drain(..).map(Watched::end));
            current = Watched::all(&playback.world);
        }
        for input in &step.inputs[first..] {
            match input {
                Input::Act(Act::Push { size, unit }) => {
                    for (watched, mass_kg) in current.iter_mut().zip(playback.world.masses_kg()) {
                        let disturbed = watched.meter.push(unit.velocity(*size, mass_kg));
                        watched.take.pushes.extend(disturbed);
                    }
                }
                Input::Act(Act::Hand(force)) => current.iter_mut().for_each(|watched| watched.pull(*force)),
                Input::Act(Act::Comply { robot, .. }) | Input::Renew { robot, .. } => {
                    let seat = playback.world.setup().robots[*robot].clone();
                    takes.push(current[*robot].go_on_as(seat));
                }
                Input::Act(Act::Command(_) | Act::Reset) | Input::Setup(_) => {}
            }
        }
        for played in &step.played {
            let watched = &mut current[played.robot];
            watched.meter.note(played);
            watched.look();
            if playback.is_shown(step.tick) {
                let light = |frame: &Frame| Frame { bodies: Vec::new(), ..frame.clone() };
                watched.take.trace.frames.extend(played.frame.as_deref().map(light));
                watched.take.trace.events.extend(played.events.iter().cloned());
            }
        }
    }
    takes.extend(current.into_iter().map(Watched::end));
    takes.retain(|take| !take.trace.frames.is_empty());
    for take in &mut takes {
        let first_s = take.trace.frames.first().map_or(0.0, |frame| frame.time_s);
        take.pushes.retain(|push| push.at_s >= first_s - take.trace.period_s);
    }
    Ok(takes)
}

struct Watched {
    take: Take,
    meter: LiveReadout,
    /// Start of the present pull \[s\].
    pulls_since_s: Option<f64>,
}

impl Watched {
    fn all(world: &LiveSession) -> Vec<Self> {
        let setup = world.setup();
        let watched = |(seat, (weight_n, period_s)): (&Seat, (f64, f64))| {
            let trace = Trace { period_s, weight_n, ..Trace::default() };
            let (scene, seed, seat, pushes, pulls) = (setup.scene, setup.seed, seat.clone(), Vec::new(), Vec::new());
            let take = Take { scene, seed, seat, trace, pushes, pulls };
            Watched { take, meter: LiveReadout::new((weight_n, period_s)), pulls_since_s: None }
        };
        setup.robots.iter().zip(world.weights_and_periods()).map(watched).collect()
    }

    /// Stores the result of a push whose measurement has ended.
    fn look(&mut self) {
        self.take.pushes.extend(self.meter.concluded());
    }

    fn pull(&mut self, force: Option<[f64; 2]>) {
        let reading = self.meter.read().and_then(|reading| reading.pull);
        let lasted = self.pulls_since_s.is_some_and(|since_s| self.meter.time_s() - since_s >= STRIDE_S);
        self.take.pulls.extend(reading.filter(|_| lasted));
        self.pulls_since_s = force.map(|_| self.meter.time_s());
        self.meter.pull(force);
        self.look();
    }

    /// Ends the take and begins another one of the same robot, under the same pull.
    fn go_on_as(&mut self, seat: Seat) -> Take {
        let pull = self.meter.pulled();
        self.pull(None);
        let Trace { period_s, weight_n, .. } = self.take.trace;
        let trace = Trace { period_s, weight_n, ..Trace::default() };
        let (pushes, pulls) = (Vec::new(), Vec::new());
        let next = Take { scene: self.take.scene, seed: self.take.seed, seat, trace, pushes, pulls };
        let take = std::mem::replace(&mut self.take, next);
        self.pull(pull);
        take
    }

    fn end(mut self) -> Take {
        self.pull(None);
        // A push still being measured at the end of the session counts as cut short.
        self.look();
        self.take
    }
}

impl Take {
    /// Returns the metrics of the take: means over the undisturbed pushes, and over the pulls.
    pub fn metrics(&self) -> Vec<Metric> {
        let count = |kind: EventKind| self.trace.events.iter().filter(|event| event.kind == kind).count() as f64;
        let over: Vec<&PushReading> = self.pushes.iter().filter(|push| push.outcome == Outcome::Over).collect();
        let pushed = mean(over.iter().map(|push| push.size_m_s[0].hypot(push.size_m_s[1])));
        let carried = mean(over.iter().filter_map(|push| push.carried_m));
        let decay = mean(over.iter().filter_map(|push| push.decay_s));
        let pulled = mean(self.pulls.iter().map(|pull| pull.force_n));
        let gives = mean(self.pulls.iter().map(|pull| pull.gives_m_s));
        let power = metrics::mean(self.trace.frames.iter(), |frame| frame.power_w);
        let error = metrics::mean(self.trace.frames.iter(), |frame| {
            let [forward, left, _] = frame.velocity_in_heading;
            (forward - frame.command.forward).hypot(left - frame.command.left)
        });
        let duration_s = self.trace.frames.len() as f64 * self.trace.period_s;
        let metric = Metric::new;
        let (no_frame, no_push, no_pull) =
            ("nothing was driven", "no push ended undisturbed", "nothing pulled for long");
        vec![
            metric("duration_s", "driven", Some(duration_s), "s"),
            metric("falls", "falls", Some(count(EventKind::Fall)), ""),
            metric("faults", "faults of the physics", Some(count(EventKind::Fault)), ""),
            metric("velocity_error_m_s", "velocity error, each step", error, "m/s").because(no_frame),
            metric("power_w", "mechanical power", power, "W").because(no_frame),
            metric("pushes", "pushes, undisturbed", Some(over.len() as f64), ""),
            metric("push_m_s", "their size", pushed, "m/s").because(no_push),
            metric("carried_m", "carried by them", carried, "m").because(no_push),
            metric("decay_10_s", "decay to 10 %", decay, "s").because(no_push),
            metric("pulls", "pulls", Some(self.pulls.len() as f64), ""),
            metric("pull_n", "their force", pulled, "N").because(no_pull),
            metric("gives_m_s", "gives way along them", gives, "m/s").because(no_pull),
        ]
    }
}
