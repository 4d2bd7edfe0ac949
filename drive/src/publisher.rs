//! Publishes the state of the robots to pages and viewers after every step: live, replayed or served.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use serde_json::json;
use supple::robot::GRAVITY_M_S2;
use supple::scenario::session::{Act, Input, LiveReadout, LiveSession, RobotStep, SceneKind, Seat};
use supple::scenario::trace::EventKind;
use supple::task::Command;
use supple::util::numbers::short;
use tokio::sync::watch;

use crate::clock::Clock;
use crate::driver::Driver;
use crate::message::Message;
use crate::viewer_stream::{Cast, Snapshot};

/// Longest wait for a message, so that silence of the driving page is also noticed while paused.
const LONGEST_WAIT: Duration = Duration::from_millis(50);

/// Number of notices that pages show.
const NOTICES: usize = 6;

/// The channels to pages and viewers.
#[derive(Debug, Clone)]
pub struct Updates {
    /// State of the session for pages, as JSON.
    pub state: watch::Sender<Arc<str>>,
    /// Newest frames of the robots for viewers.
    pub shown: watch::Sender<Snapshot>,
}

/// Robots that pages and viewers show.
pub trait Shown {
    /// Returns the tick at which the next step begins.
    fn tick(&self) -> u64;
    /// Returns the scene, if it is one of those that can be chosen, and its seed.
    fn scene(&self) -> (Option<SceneKind>, u64);
    /// Returns the largest commands.
    fn range(&self) -> Command;
    /// Returns names and scenes of the robots.
    fn cast(&self) -> Cast;
    /// Returns the facts about each robot.
    fn facts(&self) -> Vec<Facts>;
}

/// The facts about a robot that pages show beside its measurements.
#[derive(Debug, Clone)]
pub struct Facts {
    /// Policy as it was requested: name, file or run folder.
    pub policy: String,
    /// Robot as it was requested: name or file.
    pub robot: String,
    /// Commanded compliance [m/s/N]; `None` for the policy's own.
    pub compliance: Option<f64>,
    /// Range of commanded compliance, and own compliance forward and left [m/s/N]; `None` if the policy is not calibrated.
    pub reach: Option<([f64; 2], [f64; 2])>,
    /// Number of falls since the last set-up.
    pub falls: u32,
    /// Weight \[N\].
    pub weight_n: f64,
    /// Time between two frames \[s\].
    pub period_s: f64,
}

impl Facts {
    /// Returns the title of a robot of this name, with the compliance that is commanded now.
    fn title(&self, name: &str) -> String {
        self.compliance.map_or_else(|| name.to_owned(), |compliance| format!("{name}@{}", short(compliance)))
    }
}

impl Shown for LiveSession {
    fn tick(&self) -> u64 {
        LiveSession::tick(self)
    }

    fn scene(&self) -> (Option<SceneKind>, u64) {
        (Some(self.setup().scene), self.setup().seed)
    }

    fn range(&self) -> Command {
        LiveSession::range(self)
    }

    fn cast(&self) -> Cast {
        Cast::new(self)
    }

    fn facts(&self) -> Vec<Facts> {
        let seats = self.setup().robots.iter().zip(self.reaches()).zip(self.falls()).zip(self.weights_and_periods());
        let facts = |(((seat, reach), falls), (weight_n, period_s)): (((&Seat, _), _), _)| {
            let Seat { policy, robot, compliance, .. } = seat.clone();
            Facts { policy, robot, compliance, reach, falls, weight_n, period_s }
        };
        seats.map(facts).collect()
    }
}

/// The published state: clock, driver, measurements and notices.
pub struct Publisher {
    /// Clock that ties simulated to real time.
    pub clock: Clock,
    /// The driving page.
    pub driver: Driver,
    meters: Vec<LiveReadout>,
    shown: Snapshot,
    /// The channels to pages and viewers.
    pub updates: Updates,
    notices: VecDeque<String>,
    noticed: u64,
    /// True if pages and viewers must be redrawn, also while paused.
    is_stale: bool,
}

impl Publisher {
    /// Creates the published state of robots before their first step.
    pub fn new(world: &impl Shown) -> Self {
        let shown = Snapshot::new(world.cast());
        let updates = Updates { state: watch::Sender::new(Arc::from("{}")), shown: watch::Sender::new(shown.clone()) };
        let (clock, driver, notices) = (Clock::new(world.tick()), Driver::default(), VecDeque::new());
        let mut publisher =
            Publisher { clock, driver, meters: Vec::new(), shown, updates, notices, noticed: 0, is_stale: false };
        publisher.begin(world);
        publisher.publish(world);
        publisher
    }

    /// Returns the robots and scenes that are played.
    pub fn cast(&self) -> &Arc<Cast> {
        &self.shown.cast
    }

    /// Starts over for another set-up.
    pub fn begin(&mut self, world: &impl Shown) {
        self.meters = world.facts().iter().map(|facts| LiveReadout::new((facts.weight_n, facts.period_s))).collect();
        self.shown = Snapshot::new(world.cast());
        self.clock.restart(world.tick());
        self.is_stale = true;
    }

    /// Waits for the next step or a message, whichever comes first; returns `None` after a short wait without either.
    pub fn wait(&mut self, world: &impl Shown, messages: &Receiver<Message>) -> Option<Due> {
        let due = self.clock.due(world.tick());
        let now = Instant::now();
        if self.is_stale || due.is_some_and(|due| due <= now) {
            // All messages that have arrived take effect with this step.
            let message = messages.try_recv();
            self.is_stale &= message.is_ok();
            return Some(message.map_or(Due::Step, Due::Message));
        }
        let wait = due.map_or(LONGEST_WAIT, |due| due.duration_since(now).min(LONGEST_WAIT));
        match messages.recv_timeout(wait) {
            Ok(message) => Some(Due::Message(message)),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => Some(Due::Message(Message::Stop)),
        }
    }

    /// Updates the measurements after an input.
    pub fn note_input(&mut self, world: &impl Shown, input: &Input) {
        match input {
            Input::Act(Act::Push { size, unit }) => {
                for (meter, facts) in self.meters.iter_mut().zip(world.facts()) {
                    meter.push(unit.velocity(*size, facts.weight_n / GRAVITY_M_S2));
                }
            }
            Input::Act(Act::Hand(force)) => self.meters.iter_mut().for_each(|meter| meter.pull(*force)),
            Input::Setup(_) => self.begin(world),
            Input::Renew { .. } | Input::Act(Act::Reset | Act::Comply { .. }) => self.is_stale = true,
            Input::Act(Act::Command(_)) => {}
        }
    }

    /// Publishes the steps that began at a tick.
    pub fn note_steps(&mut self, world: &impl Shown, tick: u64, steps: &[RobotStep]) {
        self.clock.stepped(tick);
        for played in steps {
            let robot = played.robot;
            self.meters[robot].note(played);
            if let Some(frame) = &played.frame {
                self.shown.frames[robot] = Some(Arc::clone(frame));
            }
            self.shown.beginnings[robot] += u64::from(played.is_beginning);
            if let Some(event) = played.events.last() {
                self.shown.events[robot] = (self.shown.events[robot].0 + 1, Some(event.clone()));
            }
            for event in played.events.iter().filter(|event| event.kind != EventKind::Disturbance) {
                let title = world.facts()[robot].title(&self.shown.cast.names[robot]);
                let text = format!("{title}: {}", event.text);
                // A policy that fails does so in every step.
                if event.kind != EventKind::Fault || !self.notices.contains(&text) {
                    self.notice(text);
                }
            }
        }
        self.shown.is_behind = self.clock.is_behind();
        self.updates.shown.send_replace(self.shown.clone());
        self.publish(world);
    }

    /// Shows a text on all pages.
    pub fn notice(&mut self, text: String) {
        self.notices.push_back(text);
        self.noticed += 1;
        if self.notices.len() > NOTICES {
            self.notices.pop_front();
        }
    }

    /// Publishes the state to pages.
    pub fn publish(&self, world: &impl Shown) {
        let (scene, seed) = world.scene();
        let range = world.range();
        let robot = |(index, facts): (usize, Facts)| {
            let (name, frame) = (&self.shown.cast.names[index], self.shown.frames[index].as_deref());
            let [forward, left, _] = frame.map_or([0.0; 3], |frame| frame.velocity_in_heading);
            json!({
                "name": name, // unique, in the viewer
                "title": facts.title(name), // with the commanded compliance, such as baseline@0.03
                "policy": facts.policy,
                "robot": facts.robot,
                "time_s": frame.map_or(0.0, |frame| frame.time_s),
                "position": frame.map_or([0.0; 3], |frame| frame.position), // world frame [m]
                // Heading frame: forward [m/s], left [m/s], yaw rate [rad/s].
                "velocity": [forward, left, frame.map_or(0.0, |frame| frame.yaw_rate)],
                "compliance": facts.compliance,
                "reach": facts.reach,
                "falls": facts.falls,
                "reading": self.meters[index].read(), // velocity, power, push and pull; null before the first step
            })
        };
        let robots: Vec<_> = world.facts().into_iter().enumerate().map(robot).collect();
        let state = json!({
            "tick": world.tick(), // at which the next step begins
            "heard": self.driver.count, // messages of the driving page that have taken effect
            "rate": self.clock.rate(), // measured ratio of simulated to real time
            "speed": self.clock.speed, // requested ratio
            "behind": self.clock.is_behind(), // the machine is too slow for it
            "paused": self.clock.is_paused,
            "driver": self.driver.page,
            "scene": scene,
            "seed": seed,
            "range": [range.forward, range.left, range.yaw], // largest commands [m/s], [m/s], [rad/s]
            "robots": robots,
            "notices": (self.noticed, &self.notices), // number of the newest one, and the last few
        });
        let text = json!({ "state": state }).to_string();
        self.updates.state.send_replace(text.into());
    }
}

/// The next thing to do.
#[derive(Debug)]
pub enum Due {
    /// Play the next step.
    Step,
    /// Handle a message.
    Message(Message),
}
