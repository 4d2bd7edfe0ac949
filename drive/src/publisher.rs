//! Publishes the state of the robots to pages and viewers after every step, for live play and replays alike.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use supple::scenario::session::{Act, Input, LiveReadout, LiveSession, RobotStep};
use supple::scenario::trace::EventKind;
use tokio::sync::watch;

use crate::clock::Clock;
use crate::message::Message;
use crate::request::{PageId, RobotStatus, State};
use crate::viewer_stream::{Cast, Snapshot};

/// Longest wait for a message: silence of the driving page is noticed while paused, too.
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

/// The published state: clock, driver, measurements and notices.
#[derive(Debug)]
pub struct Publisher {
    /// Clock that ties simulated to real time.
    pub clock: Clock,
    /// Id of the driving page, if there is one.
    pub driver: Option<PageId>,
    /// Time and number of the driving page's last message.
    pub heard: (Instant, u64),
    meters: Vec<LiveReadout>,
    shown: Snapshot,
    updates: Updates,
    notices: VecDeque<String>,
    noticed: u64,
    /// True if pages and viewers must be redrawn, also while paused.
    is_stale: bool,
}

impl Publisher {
    /// Creates the published state of a live session before its first step.
    pub fn new(world: &LiveSession) -> Self {
        let shown = Snapshot::new(Cast::new(world));
        let updates = Updates { state: watch::Sender::new(Arc::from("{}")), shown: watch::Sender::new(shown.clone()) };
        let mut publisher = Publisher {
            clock: Clock::new(world.tick()),
            driver: None,
            heard: (Instant::now(), 0),
            meters: Vec::new(),
            shown,
            updates,
            notices: VecDeque::new(),
            noticed: 0,
            is_stale: false,
        };
        publisher.begin(world);
        publisher.publish(world);
        publisher
    }

    /// Returns the channels to pages and viewers.
    pub fn updates(&self) -> Updates {
        self.updates.clone()
    }

    /// Returns the robots and scenes that are played.
    pub fn cast(&self) -> &Arc<Cast> {
        &self.shown.cast
    }

    /// Starts over for another set-up.
    pub fn begin(&mut self, world: &LiveSession) {
        self.meters = world.weights_and_periods().map(LiveReadout::new).collect();
        self.shown = Snapshot::new(Cast::new(world));
        self.clock.restart(world.tick());
        self.is_stale = true;
    }

    /// Waits for the next step or a message, whichever comes first; returns `None` after a short wait without either.
    pub fn wait(&mut self, world: &LiveSession, messages: &Receiver<Message>) -> Option<Due> {
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
    pub fn note_input(&mut self, world: &LiveSession, input: &Input) {
        match input {
            Input::Act(Act::Push { size, unit }) => {
                for (meter, mass_kg) in self.meters.iter_mut().zip(world.masses_kg()) {
                    meter.push(unit.velocity(*size, mass_kg));
                }
            }
            Input::Act(Act::Pull(force)) => self.meters.iter_mut().for_each(|meter| meter.pull(*force)),
            Input::Setup(_) => self.begin(world),
            Input::Renew { .. } | Input::Act(Act::Reset | Act::Comply { .. }) => self.is_stale = true,
            Input::Act(Act::Command(_)) => {}
        }
    }

    /// Publishes the steps that began at a tick.
    pub fn note_steps(&mut self, world: &LiveSession, tick: u64, steps: &[RobotStep]) {
        self.clock.stepped(tick);
        for played in steps {
            let robot = played.robot;
            self.meters[robot].note(played);
            if let Some(frame) = &played.frame {
                self.shown.frames[robot] = Some(Arc::clone(frame));
            }
            self.shown.beginnings[robot] += u64::from(played.is_beginning);
            if let Some(event) = played.events.last() {
                let (count, last) = &mut self.shown.events[robot];
                *count += 1;
                *last = Some(event.clone());
            }
            for event in played.events.iter().filter(|event| event.kind != EventKind::Disturbance) {
                let text = format!("{}: {}", self.shown.cast.names[robot], event.text);
                // A policy that fails does so in every step.
                let is_known = event.kind == EventKind::Fault && self.notices.contains(&text);
                if !is_known {
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
    pub fn publish(&self, world: &LiveSession) {
        let setup = world.setup();
        let range = world.range();
        let robots = setup.robots.iter().zip(world.reaches()).zip(world.falls()).enumerate();
        let robots = robots.map(|(index, ((seat, reach), falls))| {
            let frame = self.shown.frames[index].as_deref();
            let [forward, left, _] = frame.map_or([0.0; 3], |frame| frame.velocity_in_heading);
            RobotStatus {
                name: self.shown.cast.names[index].clone(),
                policy: seat.policy.clone(),
                robot: seat.robot.clone(),
                time_s: frame.map_or(0.0, |frame| frame.time_s),
                position: frame.map_or([0.0; 3], |frame| frame.position),
                velocity: [forward, left, frame.map_or(0.0, |frame| frame.yaw_rate)],
                compliance: seat.compliance,
                reach,
                falls,
                reading: self.meters[index].read(),
            }
        });
        let state = State {
            tick: world.tick(),
            heard: self.heard.1,
            rate: self.clock.rate(),
            speed: self.clock.speed(),
            behind: self.clock.is_behind(),
            paused: self.clock.is_paused(),
            driver: self.driver,
            scene: setup.scene,
            seed: setup.seed,
            range: [range.forward, range.left, range.yaw],
            robots: robots.collect(),
            notices: (self.noticed, self.notices.iter().cloned().collect()),
        };
        // Numbers and strings always serialise.
        let text = serde_json::to_string(&serde_json::json!({ "state": state })).unwrap_or_default();
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
