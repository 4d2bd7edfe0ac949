//! How things are, for pages and viewers: whatever is played, live or again, is told here step by step.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use supple::scenario::session::{Input, LiveReadout, LiveSession, RobotStep};
use supple::scenario::trace::{EventKind, Frame};
use tokio::sync::watch;

use crate::clock::Clock;
use crate::live::Message;
use crate::request::{PageId, RobotStatus, State};
use crate::show::{Cast, Shown};

/// Longest wait, so that silence is noticed while time stands still.
const LONGEST_WAIT: Duration = Duration::from_millis(50);

/// Notices that are kept for pages to show.
const NOTICES: usize = 6;

/// What goes out.
#[derive(Debug, Clone)]
pub struct News {
    /// For pages, as JSON.
    pub state: watch::Sender<Arc<str>>,
    /// For viewers.
    pub shown: watch::Sender<Shown>,
}

/// How things are.
#[derive(Debug)]
pub struct Display {
    /// Simulated against real time.
    pub clock: Clock,
    /// Who drives.
    pub driver: Option<PageId>,
    /// When the driver was last heard, and how often.
    pub heard: (Instant, u64),
    meters: Vec<LiveReadout>,
    shown: Shown,
    news: News,
    notices: VecDeque<String>,
    noticed: u64,
    /// Something else is to be seen, although time stands still.
    is_stale: bool,
}

impl Display {
    /// Of a world that waits for its first step.
    pub fn new(world: &LiveSession) -> Self {
        let shown = Shown::new(Cast::of(world));
        let news = News { state: watch::Sender::new(Arc::from("{}")), shown: watch::Sender::new(shown.clone()) };
        let mut display = Display {
            clock: Clock::new(world.tick()),
            driver: None,
            heard: (Instant::now(), 0),
            meters: Vec::new(),
            shown,
            news,
            notices: VecDeque::new(),
            noticed: 0,
            is_stale: false,
        };
        display.begin(world);
        display.tell(world);
        display
    }

    /// Where news come out.
    pub fn news(&self) -> News {
        self.news.clone()
    }

    /// Who is played.
    pub fn cast(&self) -> &Arc<Cast> {
        &self.shown.cast
    }

    /// The newest frame of a robot.
    pub fn frame(&self, robot: usize) -> Option<&Arc<Frame>> {
        self.shown.frames[robot].as_ref()
    }

    /// Another set-up is played from now on.
    pub fn begin(&mut self, world: &LiveSession) {
        self.meters = world.weights_and_periods().map(LiveReadout::new).collect();
        self.shown = Shown::new(Cast::of(world));
        self.clock.restart(world.tick());
        self.is_stale = true;
    }

    /// Something else is to be seen, also while time stands still.
    pub fn refresh(&mut self) {
        self.is_stale = true;
    }

    /// Waits for the next step to be due, or for a message, whichever comes first; none if it is neither yet.
    pub fn wait(&mut self, world: &LiveSession, messages: &Receiver<Message>) -> Option<Due> {
        let due = self.clock.due(world.tick());
        let now = Instant::now();
        if self.is_stale || due.is_some_and(|due| due <= now) {
            // Everything that has come by now takes effect with this step.
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

    /// An input has taken effect.
    pub fn note_input(&mut self, world: &LiveSession, input: &Input) {
        match input {
            Input::Push { size, unit } => {
                for (meter, mass_kg) in self.meters.iter_mut().zip(world.masses_kg()) {
                    meter.push(unit.velocity(*size, mass_kg));
                }
            }
            Input::Pull(force) => self.meters.iter_mut().for_each(|meter| meter.pull(*force)),
            Input::Setup(_) => self.begin(world),
            Input::Reset | Input::Renew { .. } | Input::Comply { .. } => self.refresh(),
            Input::Command(_) => {}
        }
    }

    /// Steps that began at a tick were played.
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
                self.notice(text);
            }
        }
        self.shown.is_behind = self.clock.is_behind();
        self.news.shown.send_replace(self.shown.clone());
        self.tell(world);
    }

    /// Tells everybody something once.
    pub fn notice(&mut self, text: String) {
        self.notices.push_back(text);
        self.noticed += 1;
        if self.notices.len() > NOTICES {
            self.notices.pop_front();
        }
    }

    /// Tells pages how things are.
    pub fn tell(&self, world: &LiveSession) {
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
        // Plain numbers and strings: writing them cannot fail.
        let text = serde_json::to_string(&serde_json::json!({ "state": state })).unwrap_or_default();
        self.news.state.send_replace(text.into());
    }
}

/// What is to be done.
#[derive(Debug)]
pub enum Due {
    /// The next step.
    Step,
    /// What somebody says.
    Message(Message),
}
