//! The page of `drive` for a served robot: pushes and pulls it, and its stick stands for the remote's.

use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use serde_json::json;
use supple::robot::GRAVITY_M_S2;
use supple::scenario::session::{Act, Input, RATE_HZ, RobotStep, SceneKind};
use supple::scenario::trace::{Event, EventKind, Frame};
use supple::sim::Scene;
use supple::task::Command;
use supple_drive::driver::Heard;
use supple_drive::message::Message;
use supple_drive::publisher::{Facts, Publisher, Shown};
use supple_drive::request::{MOST, Request, bounded};
use supple_drive::server;
use supple_drive::viewer_stream::Cast;

use super::body::{Body, FRAME_S};

/// Messages of pages that wait for the next tick.
const QUEUE: usize = 512;

/// The page, as the loop that plays the robot sees it.
pub struct Page {
    messages: Receiver<Message>,
    pub publisher: Publisher,
    robot: ServedRobot,
    /// The velocity that the page's stick asks for.
    pub command: Command,
    pull: Option<[f64; 2]>,
    /// Events since the last frame.
    events: Vec<Event>,
}

/// The robot as pages show it.
struct ServedRobot {
    scene: Scene,
    seed: u64,
    range: Command,
    /// Frames that were shown, which give the time, as frames before a scenario have none.
    frames: u64,
    falls: u32,
}

impl ServedRobot {
    fn time_s(&self) -> f64 {
        self.frames as f64 * FRAME_S
    }
}

impl Shown for ServedRobot {
    fn tick(&self) -> u64 {
        (self.time_s() * RATE_HZ as f64).round() as u64
    }

    fn scene(&self) -> (Option<SceneKind>, u64) {
        (None, self.seed)
    }

    fn range(&self) -> Command {
        self.range
    }

    fn cast(&self) -> Cast {
        Cast { names: vec!["go2".to_owned()], scenes: vec![self.scene.clone()] }
    }

    fn facts(&self) -> Vec<Facts> {
        let [policy, robot] = ["client", "go2"].map(ToOwned::to_owned);
        let (falls, weight_n) = (self.falls, self.scene.robot.mass_kg * GRAVITY_M_S2);
        vec![Facts { policy, robot, compliance: None, reach: None, falls, weight_n, period_s: FRAME_S }]
    }
}

impl Page {
    /// Creates the page of a robot in a scene, and where messages to it go. `range` is what full sticks mean.
    pub fn new(scene: &Scene, seed: u64, range: Command) -> (Self, SyncSender<Message>) {
        let robot = ServedRobot { scene: scene.clone(), seed, range, frames: 0, falls: 0 };
        let (to_robot, messages) = sync_channel(QUEUE);
        let (publisher, command) = (Publisher::new(&robot), Command::default());
        (Page { messages, publisher, robot, command, pull: None, events: Vec::new() }, to_robot)
    }

    /// Serves the page on this machine; port 0 takes any free one. Returns its address.
    pub fn serve(&self, to_robot: SyncSender<Message>, port: u16) -> anyhow::Result<String> {
        let hello = json!({ "policies": [], "scenes": [], "most": MOST, "viewer": true, "is_served": true });
        let here = IpAddr::V4(Ipv4Addr::LOCALHOST);
        Ok(server::start(here, port, to_robot, self.publisher.updates.clone(), hello)?.0)
    }

    /// Takes the messages that have come, and pushes and pulls the robot accordingly. The silence of a page ends its pull.
    pub fn act(&mut self, body: &mut Body) {
        while let Ok(message) = self.messages.try_recv() {
            match self.publisher.driver.take(message) {
                Heard::Request(Request::Act(act)) => match bounded(act, &self.robot.range) {
                    Act::Command(command) => self.command = command,
                    Act::Hand(force) => self.hold(force, body),
                    act @ Act::Push { size, unit } => {
                        let linear = unit.velocity(size, self.robot.scene.robot.mass_kg);
                        body.playback.push(linear);
                        self.publisher.note_input(&self.robot, &Input::Act(act));
                    }
                    // The client decides about compliance, and a robot under its control is not reset.
                    Act::Comply { .. } | Act::Reset => {}
                },
                Heard::Other(Message::Notice(text)) => self.publisher.notice(text),
                Heard::Released => self.let_go(body),
                Heard::Request(_) | Heard::Nothing | Heard::Other(_) => {}
            }
        }
        if self.publisher.driver.is_silent() {
            self.let_go(body);
        }
    }

    fn hold(&mut self, force: Option<[f64; 2]>, body: &mut Body) {
        if force != self.pull {
            self.pull = force;
            body.playback.pull(force);
            self.publisher.note_input(&self.robot, &Input::Act(Act::Hand(force)));
        }
    }

    fn let_go(&mut self, body: &mut Body) {
        self.command = Command::default();
        self.hold(None, body);
    }

    /// Shows the frame and the events of a tick.
    pub fn show(&mut self, frame: Option<&Frame>, events: &[Event]) {
        self.events.extend_from_slice(events);
        let Some(frame) = frame else { return };
        let tick = self.robot.tick();
        self.robot.frames += 1;
        let time_s = self.robot.time_s();
        let events: Vec<Event> = self.events.drain(..).map(|event| Event { time_s, ..event }).collect();
        self.robot.falls += events.iter().map(|event| u32::from(event.kind == EventKind::Fall)).sum::<u32>();
        let frame = Some(Arc::new(Frame { time_s, ..frame.clone() }));
        let step = RobotStep { robot: 0, is_beginning: false, frame, events };
        self.publisher.note_steps(&self.robot, tick, &[step]);
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use supple::config::Config;
    use supple::robot::JOINTS;
    use supple::scenario::catalog::Scenario;
    use supple::scenario::session::PushUnit;
    use supple::scenario::trace::DisturbanceMark;
    use supple_drive::driver::SILENCE;
    use supple_drive::request::MOST_PULL_N;

    use super::*;
    use crate::motor;
    use crate::serve::body::configuration;

    #[test]
    fn page_pushes_pulls_and_steers_until_it_falls_silent() {
        let config = configuration(Config::load("go2").unwrap());
        let script = Scenario::named("walk", "{}").unwrap().script(0, &config).unwrap();
        let robot = Arc::clone(&script.scene.robot);
        let (mut page, to_robot) = Page::new(&script.scene, 0, Command::velocity(1.0, 0.5, 0.5));
        let updates = page.publisher.updates.clone();
        let mut body = Body::new(script, config, None, 0).unwrap();
        body.command(&motor::holding(&robot.nominal_pose, &[60.0; JOINTS], &[5.0; JOINTS]));
        let mut play = |page: &mut Page, ticks: usize| {
            let mut last = None;
            for _ in 0..ticks {
                page.act(&mut body);
                let tick = body.tick();
                page.show(tick.frame.as_ref(), &tick.events);
                last = tick.frame.or(last);
            }
            last.unwrap()
        };
        let ask = |act| to_robot.send(Message::Request(1, Request::Act(act))).unwrap();

        to_robot.send(Message::PageOpened(1)).unwrap();
        play(&mut page, 500);
        ask(Act::Command(Command::velocity(7.0, 0.0, -0.25)));
        ask(Act::Push { size: [0.0, 0.5], unit: PushUnit::Velocity });
        ask(Act::Hand(Some([0.0, 500.0])));
        let frame = play(&mut page, 10);
        assert!(frame.velocity_in_heading[1] > 0.3, "{:?}", frame.velocity_in_heading);
        assert_eq!(page.command, Command::velocity(1.0, 0.0, -0.25));
        let Some(DisturbanceMark::Rope { force }) = frame.mark else { panic!("{:?}", frame.mark) };
        let force_n = force.iter().map(|part| part * part).sum::<f64>().sqrt();
        assert!((force_n - MOST_PULL_N).abs() < 1e-9, "{force_n}");
        let state: serde_json::Value = serde_json::from_str(&updates.state.borrow()).unwrap();
        let shown = &state["state"]["robots"][0];
        assert_eq!(shown["time_s"].as_f64().map(|time_s| (time_s * 50.0).round()), Some(51.0), "{shown}");
        assert_eq!(shown["reading"]["pull"]["force_n"].as_f64(), Some(MOST_PULL_N));
        assert_eq!(shown["reading"]["push"]["size_m_s"][1].as_f64(), Some(0.5));

        std::thread::sleep(SILENCE + Duration::from_millis(50));
        let mark = play(&mut page, 20).mark;
        assert!(!matches!(mark, Some(DisturbanceMark::Rope { .. })), "{mark:?}");
        assert_eq!(page.command, Command::default());
    }
}
