//! Plays the robot in real time: states out at 500 Hz, commands in, a scenario with metrics and a recording.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::{Value, json};
use supple::config::Config;
use supple::estimate::SensorNoise;
use supple::provenance::git_revision;
use supple::robot::GRAVITY_M_S2;
use supple::scenario::Script;
use supple::scenario::catalog::Scenario;
use supple::scenario::metrics::{Metric, by_name};
use supple::scenario::trace::{Event, EventKind, Frame, Trace};
use supple::task::Command;
use supple::util::random::{Purpose, stream};
use supple::util::terminal;
use supple_record::{RecordError, Recorder, RobotView, Sink};

use super::body::{Body, FRAME_S, STATE_HZ, configuration};
use super::judge::{Complaint, Judge, Kind};
use super::link::{Faults, Link};
use super::operator::Operator;
use super::page::Page;
use super::settings::Settings;
use crate::dds::switcher::{self, Mode};
use crate::dds::{Arrival, Delivery, Node, Place};
use crate::message::{LowCmd, LowState};
use crate::remote::{FullSticks, Remote};

/// Topics of the low-level interface.
pub const COMMANDS: &str = "rt/lowcmd";
/// Topic of the robot's state.
pub const STATES: &str = "rt/lowstate";

/// A tick that begins this much later than due is counted \[s\].
const LATE_S: f64 = 0.002;

/// A loop that is this far behind gives up catching up \[s\].
const GIVE_UP_S: f64 = 0.05;

/// Repeated complaints of one kind are printed no more often than this \[s\].
const REPEAT_S: f64 = 2.0;

/// Timing: the numbers of ticks, of late ones (by more than 2 ms), and of those skipped because the machine is too slow; and the largest
/// delay of a tick \[s\].
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
struct Pace {
    ticks: u64,
    late: u64,
    skipped: u64,
    worst_s: f64,
}

/// The outcome of serving.
pub struct Summary {
    /// The scenario; `None` for the plane without end.
    scenario: Option<Scenario>,
    seed: u64,
    metrics: Vec<Metric>,
    events: Vec<Event>,
    complaints: BTreeMap<Kind, u64>,
    /// Number of commands that were obeyed.
    accepted: u64,
    pace: Pace,
}

impl Summary {
    /// Returns the summary as one JSON object, like that of the program `scenario`.
    pub fn to_json(&self) -> Value {
        let metrics = by_name(&self.metrics, Metric::to_json);
        json!({
            "scenario": self.scenario.as_ref().map(Scenario::name),
            "revision": git_revision(),
            "seed": self.seed,
            "parameters": self.scenario,
            "units": by_name(&self.metrics, |metric| json!(metric.unit)),
            "runs": [{"policy": "client", "robot": "go2", "metrics": metrics, "events": self.events}],
            "client": {"accepted": self.accepted, "complaints": self.complaints},
            "pace": self.pace,
        })
    }

    /// Returns the summary for people.
    pub fn text(&self) -> String {
        let complaint = |(kind, count): (&Kind, &u64)| {
            let verb = if kind.is_refused() { "refused" } else { "noted" };
            format!("  {verb}, {}: {count}\n", json!(kind).as_str().unwrap_or_default())
        };
        let complaints: String = self.complaints.iter().map(complaint).collect();
        let (Pace { ticks, late, skipped, .. }, worst_ms) = (self.pace, 1e3 * self.pace.worst_s);
        format!(
            "commands obeyed: {}\n{complaints}ticks: {ticks}; more than 2 ms late: {late}; left out: {skipped}; latest: {worst_ms:.1} \
             ms\n{}",
            self.accepted,
            told(&self.metrics, &self.events)
        )
    }
}

/// Returns metrics and events for people.
pub fn told(metrics: &[Metric], events: &[Event]) -> String {
    let metric = |Metric { label, value, unit, .. }: &Metric| Some(format!("  {label:26} {:.3} {unit}\n", (*value)?));
    let event = |event: &Event| format!("  {:6.2} s  {}\n", event.time_s, event.text);
    metrics.iter().filter_map(metric).chain(events.iter().map(event)).collect()
}

/// Serves the robot until the scenario ends, the time is over, or `stop` is set.
///
/// # Errors
/// The network, the scene or the recording fails.
pub fn play(settings: &Settings, stop: &AtomicBool) -> anyhow::Result<Summary> {
    Served::new(settings)?.play(stop)
}

/// A robot being served.
struct Served<'a> {
    settings: &'a Settings,
    place: Place,
    faults: Faults,
    full_sticks: FullSticks,
    scenario: Option<Scenario>,
    script: Script,
    body: Body,
    judge: Judge,
    operator: Option<Operator>,
    remote: Remote,
    recording: Option<Recording>,
    page: Option<Page>,
    trace: Trace,
    has_begun: bool,
    /// Time of the last printed complaint of each kind \[s\].
    printed: BTreeMap<Kind, f64>,
    begin: Instant,
}

/// Duration of the plane without end \[s\].
const ENDLESS_S: f64 = 1e8;

impl<'a> Served<'a> {
    /// Builds the robot in its scene.
    fn new(settings: &'a Settings) -> anyhow::Result<Self> {
        let (faults, full_sticks) = (settings.faults()?, settings.full_sticks()?);
        let (place, scenario) = (settings.network.place()?, settings.scenario()?);
        let mut config = configuration(Config::load("go2")?);
        config.robot.set_losses(settings.joints.into());
        let plane = Scenario::named("walk", "{}")?;
        let mut script = scenario.as_ref().unwrap_or(&plane).script(settings.seed, &config)?;
        if scenario.is_none() {
            (script.duration_s, script.after_fall_s) = (ENDLESS_S, ENDLESS_S);
        }
        let robot = Arc::clone(&script.scene.robot);
        let standing_m = robot.standing_height_m(&robot.nominal_pose);
        let operator = Operator::new(&script.command, full_sticks, standing_m);
        let recording = settings.record.as_ref().map(|path| Recording::start(path.clone(), &script)).transpose()?;
        let page = settings.page.then(|| open_page(settings, full_sticks, &script)).transpose()?;
        let body = Body::new(script.clone(), config, Some(SensorNoise::default()), settings.seed)?;
        let trace = Trace { period_s: FRAME_S, weight_n: robot.mass_kg * GRAVITY_M_S2, ..Trace::default() };
        Ok(Served {
            settings,
            place,
            faults,
            full_sticks,
            judge: Judge::new(robot.joint_limits, settings.any_head),
            script,
            body,
            operator: scenario.as_ref().map(|_| operator),
            scenario,
            remote: Remote::default(),
            recording,
            page,
            trace,
            has_begun: false,
            printed: BTreeMap::new(),
            begin: Instant::now(),
        })
    }

    fn now_s(&self) -> f64 {
        self.begin.elapsed().as_secs_f64()
    }

    fn play(mut self, stop: &AtomicBool) -> anyhow::Result<Summary> {
        let node = Node::open(&self.place)?;
        let released = Arc::new(AtomicBool::new(self.settings.released));
        let switched = Arc::clone(&released);
        let always = self.settings.released;
        let changed = move |mode: &Mode| switched.store(always || mode.is_released(), Ordering::Relaxed);
        let _switcher = switcher::serve(&node, changed)?;
        let (sender, arrivals) = sync_channel::<Arrival<LowCmd>>(64);
        // If the queue is full, this loop is too slow, and the message is lost.
        let take = move |arrival| drop(sender.try_send(arrival));
        let _commands = node.listen(COMMANDS, LowCmd::TYPE, Delivery::BestEffort, take)?;
        let states = node.publish::<LowState>(STATES, LowState::TYPE, Delivery::BestEffort)?;
        let mut rng = stream(self.settings.seed, Purpose::Sensor, 1, 0);
        let (mut outward, mut inward) = (Link::new(self.faults), Link::new(self.faults));
        let (mut pace, mut due_s) = (Pace::default(), 0.0);
        self.begin = Instant::now();
        loop {
            let now_s = self.now_s();
            let late_s: f64 = now_s - due_s;
            pace.ticks += 1;
            pace.late += u64::from(late_s > LATE_S);
            pace.worst_s = pace.worst_s.max(late_s);
            if late_s > GIVE_UP_S {
                let ticks = (late_s * f64::from(STATE_HZ)).floor();
                pace.skipped += ticks as u64;
                due_s += ticks / f64::from(STATE_HZ);
            }
            let is_over = self.tick(now_s)?;
            outward.send(self.body.state(self.remote), now_s, &mut rng);
            if is_over || stop.load(Ordering::Relaxed) || self.settings.seconds.is_some_and(|limit_s| now_s > limit_s) {
                break;
            }
            due_s += 1.0 / f64::from(STATE_HZ);
            // Takes messages until the next tick.
            loop {
                let now_s = self.now_s();
                // A client that is gone gets no state.
                std::iter::from_fn(|| outward.take(now_s)).for_each(|state| drop(states.send(state)));
                while let Some(arrival) = inward.take(now_s) {
                    self.take(&arrival, released.load(Ordering::Relaxed));
                }
                let until_s = [outward.next_s(), inward.next_s()].into_iter().flatten().fold(due_s, f64::min);
                let wait = Duration::from_secs_f64((until_s - self.now_s()).max(0.0));
                match arrivals.recv_timeout(wait) {
                    Ok(arrival) => inward.send(arrival, self.now_s(), &mut rng),
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => std::thread::sleep(wait),
                }
                if self.now_s() >= due_s {
                    break;
                }
            }
        }
        self.finish(pace)
    }

    fn take(&mut self, arrival: &Arrival<LowCmd>, released: bool) {
        let now_s = self.now_s();
        let was_silent = self.judge.is_silent;
        let complaints = self.judge.take(&arrival.message, arrival.writer, now_s, released);
        complaints.iter().for_each(|complaint| self.complain(complaint, now_s));
        if was_silent && !self.judge.is_silent {
            self.say(now_s, "commands come");
        }
    }

    /// Plays a tick; returns true if the script is over.
    fn tick(&mut self, now_s: f64) -> anyhow::Result<bool> {
        if let Some(complaint) = self.judge.wait(now_s) {
            self.complain(&complaint, now_s);
        }
        self.body.command(&self.judge.motors);
        if let Some(page) = &mut self.page {
            page.act(&mut self.body);
            if self.operator.is_none() {
                self.remote = self.full_sticks.remote(&page.command);
                self.body.playback.ask(page.command);
            }
        }
        if let Some(operator) = &mut self.operator {
            let (remote, begins) = operator.act(&self.body.sight(now_s, !self.judge.is_silent));
            self.remote = remote;
            if begins {
                self.body.begin();
                self.has_begun = true;
                self.say(now_s, "the robot stands: the scenario begins");
            }
        }
        let tick = self.body.tick();
        if let Some((joint, torque, limit)) = tick.saturated {
            let complaint = self.judge.saturated(joint, torque, limit);
            self.complain(&complaint, now_s);
        }
        tick.events.iter().for_each(|event| terminal::note(format_args!("{now_s:8.3} s: {}", event.text)));
        let (frame, events) = (tick.frame.as_ref(), &tick.events);
        self.recording.iter_mut().for_each(|recording| recording.add(frame, events));
        self.page.iter_mut().for_each(|page| page.show(frame, events));
        if self.has_begun && self.scenario.is_some() {
            self.trace.frames.extend(tick.frame.map(|frame| Frame { bodies: Vec::new(), ..frame }));
            self.trace.events.extend(tick.events);
        }
        Ok(tick.is_over)
    }

    /// Prints a complaint, unless one of its kind has been printed a moment ago.
    fn complain(&mut self, complaint: &Complaint, now_s: f64) {
        if self.printed.get(&complaint.kind).is_some_and(|last_s| now_s - last_s < REPEAT_S) {
            return;
        }
        self.printed.insert(complaint.kind, now_s);
        let verb = if complaint.kind.is_refused() { "refused: " } else { "" };
        self.say(now_s, &format!("{verb}{}", complaint.text));
    }

    /// Shows a text on the terminal and the page.
    fn say(&mut self, now_s: f64, text: &str) {
        terminal::note(format_args!("{now_s:8.3} s: {text}"));
        self.page.iter_mut().for_each(|page| page.publisher.notice(text.to_owned()));
    }

    fn finish(self, pace: Pace) -> anyhow::Result<Summary> {
        if let Some(recording) = self.recording {
            recording.finish()?;
        }
        let scenario = self.scenario.as_ref().filter(|_| self.has_begun);
        let metrics = scenario.map_or_else(Vec::new, |scenario| scenario.metrics(&self.script, &self.trace));
        if let Some(fault) = self.trace.events.iter().find(|event| event.kind == EventKind::Fault) {
            terminal::note(format_args!("the simulation stopped: {}", fault.text));
        }
        let (seed, events, accepted) = (self.settings.seed, self.trace.events, self.judge.accepted);
        Ok(Summary { scenario: self.scenario, seed, metrics, events, complaints: self.judge.counts, accepted, pace })
    }
}

/// Opens the page on a port of this machine.
fn open_page(settings: &Settings, full: FullSticks, script: &Script) -> anyhow::Result<Page> {
    let [forward, left, yaw] = full.0;
    let (page, to_robot) = Page::new(&script.scene, settings.seed, Command::velocity(forward, left, yaw));
    let url = page.serve(to_robot, settings.port)?;
    terminal::note(format_args!("push and pull the robot at {url}"));
    Ok(page)
}

/// A recording that is written by a thread of its own, so that a slow disk does not delay the robot.
struct Recording {
    sender: SyncSender<(Option<Frame>, Vec<Event>)>,
    thread: JoinHandle<Result<(), RecordError>>,
    /// Recorded time \[s\]; frames before the scenario have no time.
    time_s: f64,
    lost: u64,
}

/// Frames that wait for the disk: four seconds of them.
const WAITING_FRAMES: usize = 200;

impl Recording {
    fn start(path: PathBuf, script: &Script) -> anyhow::Result<Self> {
        let model = script.scene.compile_visual()?;
        let view = RobotView::new("client", &model, &script.scene);
        let mut recorder = Recorder::new(Sink::File(path), "Go2", &[view])?;
        let (sender, steps) = sync_channel::<(Option<Frame>, Vec<Event>)>(WAITING_FRAMES);
        let thread = std::thread::spawn(move || {
            for (frame, events) in steps {
                recorder.step(0, frame.as_ref(), &events)?;
            }
            recorder.finish()
        });
        Ok(Recording { sender, thread, time_s: 0.0, lost: 0 })
    }

    fn add(&mut self, frame: Option<&Frame>, events: &[Event]) {
        if frame.is_none() && events.is_empty() {
            return;
        }
        self.time_s += if frame.is_some() { FRAME_S } else { 0.0 };
        let time_s = self.time_s;
        let frame = frame.map(|frame| Frame { time_s, ..frame.clone() });
        let events = events.iter().map(|event| Event { time_s, ..event.clone() }).collect();
        self.lost += u64::from(matches!(self.sender.try_send((frame, events)), Err(TrySendError::Full(_))));
    }

    fn finish(self) -> Result<(), RecordError> {
        drop(self.sender);
        if self.lost > 0 {
            terminal::note(format_args!("the recording lacks {} frames: the disk is too slow", self.lost));
        }
        self.thread.join().unwrap_or(Ok(()))
    }
}
