/*! The thread that owns the robots.

It waits for the next step to be due and listens meanwhile; what it hears takes effect with that step, and is written down as an
input of the session. Who drives must give signs of life: without one for [`SILENCE`], robots are asked to stand, and a hand
at them lets go.
*/

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use supple::policy::Agent;
use supple::scenario::session::{AgentCache, Input, LiveSession, PushUnit, RATE_HZ, Seat, Setup, Writer};
use supple::task::Command;

use crate::display::{Display, Due, News};
use crate::keep::{self, Minute};
use crate::request::{Kept, MOST_PULL_N, MOST_PUSH_M_S, MOST_PUSH_N_S, PageId, Request, limited};
use crate::watch as policies;

/// How long robots go on without a sign of life of who drives.
pub const SILENCE: Duration = Duration::from_millis(350);

/// A minute \[ticks\].
const MINUTE: u64 = 60 * RATE_HZ;

/// What the thread is told.
#[derive(Debug)]
pub enum Message {
    /// A page came.
    Came(PageId),
    /// A page went.
    Went(PageId),
    /// A page asks for something.
    Asked(PageId, Request),
    /// A policy was read that a run saved.
    Read {
        /// From here.
        path: PathBuf,
        /// The policy.
        agent: Box<Agent>,
        /// Its file.
        file: Option<Vec<u8>>,
    },
    /// Something to tell everybody.
    Notice(String),
    /// The end.
    Stop,
}

/// What the thread owns.
#[derive(Debug)]
pub struct Live {
    world: LiveSession,
    shelf: AgentCache,
    display: Display,
    writer: Writer,
    folder: PathBuf,
    minute: Minute,
    command: Command,
    pull: Option<[f64; 2]>,
    watched: Arc<Mutex<Vec<PathBuf>>>,
    to_self: SyncSender<Message>,
}

impl Live {
    /// A world that waits for its first step. The session is written into a file of its own; what is kept goes into a folder.
    ///
    /// # Errors
    /// A [`LiveSessionError`](supple::scenario::session::WorldError), or that there is no room for the session.
    pub fn new(
        setup: Setup,
        mut shelf: AgentCache,
        folder: PathBuf,
        session: File,
        to_self: SyncSender<Message>,
    ) -> anyhow::Result<Self> {
        let world = LiveSession::new(setup, &mut shelf)?;
        let mut writer = Writer::new(session);
        writer.input(0, &Input::Setup(world.setup().clone()), &shelf)?;
        let watched = Arc::default();
        policies::start(Arc::clone(&watched), to_self.clone())?;
        let display = Display::new(&world);
        let live = Live {
            world,
            shelf,
            writer,
            folder,
            minute: Minute::of(display.cast()),
            display,
            command: Command::default(),
            pull: None,
            watched,
            to_self,
        };
        live.watch_policies();
        Ok(live)
    }

    /// Where news come out.
    pub fn news(&self) -> News {
        self.display.news()
    }

    /// Plays until it is told to stop.
    ///
    /// # Errors
    /// A fault of the physics that nothing mends, or a session that cannot be written down any more.
    pub fn run(mut self, messages: &Receiver<Message>) -> anyhow::Result<()> {
        self.display.clock.restart(self.world.tick());
        loop {
            if self.display.heard.0.elapsed() > SILENCE {
                self.let_go()?;
            }
            match self.display.wait(&self.world, messages) {
                Some(Due::Step) => self.step()?,
                Some(Due::Message(Message::Stop)) => return Ok(()),
                Some(Due::Message(message)) => self.take(message)?,
                None => {}
            }
        }
    }

    fn step(&mut self) -> anyhow::Result<()> {
        let tick = self.world.tick();
        // Frames of another world do not belong to the same recording.
        if !self.minute.is_of(self.display.cast()) {
            self.minute = Minute::of(self.display.cast());
        }
        let played = self.world.step()?;
        self.display.note_steps(&self.world, tick, &played);
        self.minute.add(tick, played);
        self.minute.forget(tick.saturating_sub(MINUTE));
        self.writer.tidy(tick.saturating_sub(MINUTE));
        Ok(())
    }

    fn take(&mut self, message: Message) -> anyhow::Result<()> {
        let display = &mut self.display;
        match message {
            Message::Came(page) if display.driver.is_none() => {
                display.driver = Some(page);
                display.heard.0 = Instant::now();
            }
            Message::Went(page) if display.driver == Some(page) => {
                display.driver = None;
                self.let_go()?;
            }
            Message::Asked(page, Request::Drive) if display.driver != Some(page) => {
                display.driver = Some(page);
                display.heard.0 = Instant::now();
                self.let_go()?;
            }
            Message::Asked(page, request) if display.driver == Some(page) => {
                display.heard = (Instant::now(), display.heard.1 + 1);
                self.answer(request)?;
            }
            Message::Read { path, agent, file } => self.renew(&path, *agent, file)?,
            Message::Notice(text) => display.notice(text),
            // Who does not drive is not heard.
            _ => {}
        }
        if self.display.clock.is_paused() {
            self.display.tell(&self.world);
        }
        Ok(())
    }

    fn answer(&mut self, request: Request) -> anyhow::Result<()> {
        let tick = self.world.tick();
        match request {
            Request::Drive => {}
            Request::Command([forward, left, yaw]) => {
                let range = self.world.range();
                let within = |value: f64, most: f64| value.clamp(-most, most);
                let [forward, left, yaw] =
                    [within(forward, range.forward), within(left, range.left), within(yaw, range.yaw)];
                self.ask(Command::velocity(forward, left, yaw))?;
            }
            Request::Push { size, unit } => {
                let most = match unit {
                    PushUnit::Velocity => MOST_PUSH_M_S,
                    PushUnit::Momentum => MOST_PUSH_N_S,
                };
                self.input(Input::Push { size: limited(size, most), unit })?;
            }
            Request::Pull(force) => self.hold(force.map(|force| limited(force, MOST_PULL_N)))?,
            Request::Comply { robot, compliance } => self.input(Input::Comply { robot, compliance })?,
            Request::Reset => self.input(Input::Reset)?,
            Request::Seed(seed) => {
                let setup = self.world.setup();
                let seed = seed.unwrap_or(setup.seed.wrapping_add(1));
                self.set_up(Input::Setup(Setup { seed, ..setup.clone() }))?;
            }
            Request::Scene(scene) => self.set_up(Input::Setup(Setup { scene, ..self.world.setup().clone() }))?,
            Request::Robot { index, policy, robot } => self.change_robot(index, policy, robot)?,
            Request::Pause(is_paused) => self.display.clock.pause(is_paused, tick),
            Request::Speed(speed) => self.display.clock.set_speed(speed, tick),
            Request::Keep(what) => self.keep(what),
        }
        Ok(())
    }

    fn ask(&mut self, command: Command) -> anyhow::Result<()> {
        if command == self.command {
            return Ok(());
        }
        self.command = command;
        self.input(Input::Command(command))
    }

    fn hold(&mut self, force: Option<[f64; 2]>) -> anyhow::Result<()> {
        if force == self.pull {
            return Ok(());
        }
        self.pull = force;
        self.input(Input::Pull(force))
    }

    fn let_go(&mut self) -> anyhow::Result<()> {
        self.ask(Command::default())?;
        self.hold(None)
    }

    /// Does something to the world, and writes it down if it could be done.
    fn input(&mut self, input: Input) -> anyhow::Result<()> {
        let tick = self.world.tick();
        if let Err(error) = self.world.apply(&input, &mut self.shelf) {
            self.display.notice(error.to_string());
            return Ok(());
        }
        self.writer.input(tick, &input, &self.shelf)?;
        self.display.note_input(&self.world, &input);
        Ok(())
    }

    /// Another world, or other policies in it: what is asked and held goes on.
    fn set_up(&mut self, input: Input) -> anyhow::Result<()> {
        self.input(input)?;
        self.shelf.tidy(&self.world.setup().robots);
        let (command, pull) = (std::mem::take(&mut self.command), self.pull.take());
        self.ask(command)?;
        self.hold(pull)?;
        self.watch_policies();
        Ok(())
    }

    /// Who walks with a policy that was read from here goes on with this one.
    fn renew(&mut self, path: &Path, agent: Agent, file: Option<Vec<u8>>) -> anyhow::Result<()> {
        let sha256 = agent.sha256.clone();
        let is_older =
            |seat: &Seat| seat.sha256 != sha256 && policies::file_of(&seat.policy).is_some_and(|file| file == path);
        let robots: Vec<usize> = self
            .world
            .setup()
            .robots
            .iter()
            .enumerate()
            .filter(|(_, seat)| is_older(seat))
            .map(|(robot, _)| robot)
            .collect();
        if robots.is_empty() {
            return Ok(());
        }
        let simulation = agent.config.simulation.clone();
        self.shelf.put(agent, file);
        for robot in robots {
            let input = if self.world.simulation(robot) == Some(&simulation) {
                Input::Renew { robot, sha256: sha256.clone() }
            } else {
                // Other rates, gains or latency: another body, in another world.
                let mut setup = self.world.setup().clone();
                let seat = &mut setup.robots[robot];
                (seat.sha256, seat.compliance) = (sha256.clone(), 0.0);
                Input::Setup(setup)
            };
            self.set_up(input)?;
            // Else it has been told why not.
            if self.world.setup().robots[robot].sha256 == sha256 {
                let name = self.display.cast().names.get(robot).cloned().unwrap_or_default();
                self.display.notice(format!("{name}: its run has saved a newer policy, which now walks"));
            }
        }
        Ok(())
    }

    fn change_robot(&mut self, index: usize, policy: Option<String>, robot: Option<String>) -> anyhow::Result<()> {
        let mut setup = self.world.setup().clone();
        match policy {
            Some(policy) => match self.shelf.find(&policy, robot.as_deref()) {
                Ok(seat) if index < setup.robots.len() => setup.robots[index] = seat,
                Ok(seat) => setup.robots.push(seat),
                Err(error) => {
                    self.display.notice(error.to_string());
                    return Ok(());
                }
            },
            None if setup.robots.len() > 1 && index < setup.robots.len() => drop(setup.robots.remove(index)),
            None => {
                self.display.notice("one robot has to stay".to_owned());
                return Ok(());
            }
        }
        self.set_up(Input::Setup(setup))
    }

    fn keep(&mut self, what: Kept) {
        let tick = self.world.tick();
        let (session, recording) = keep::names(&self.folder);
        let from = (what == Kept::Minute).then(|| tick.saturating_sub(MINUTE));
        let kept = self.writer.keep(&session, from, tick, self.world.fingerprint());
        if let Err(error) = kept {
            self.display.notice(format!("cannot write {}: {error}", session.display()));
            return;
        }
        self.display.notice(format!("kept the session {}; its recording is being written", session.display()));
        let to_self = self.to_self.clone();
        let shown = self.display.news().shown;
        let started = match what {
            Kept::Minute => {
                let minute = self.minute.clone();
                keep::in_background(move || minute.record(&recording), to_self)
            }
            Kept::All => {
                keep::in_background(move || keep::all(&session, &recording, || shown.borrow().is_behind), to_self)
            }
        };
        if let Err(error) = started {
            self.display.notice(format!("cannot write the recording: {error}"));
        }
    }

    fn watch_policies(&self) {
        let files = self.world.setup().robots.iter().filter_map(|seat| policies::file_of(&seat.policy));
        if let Ok(mut watched) = self.watched.lock() {
            *watched = files.collect();
        }
    }
}
