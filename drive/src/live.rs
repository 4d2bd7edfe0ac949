/*! The thread that owns the robots.

It waits until the next step is due and reads messages meanwhile; they take effect with that step and are written into the
session as inputs. The driving page must keep sending messages: after [`SILENCE`] without one, the command becomes zero and
a pull ends.
*/

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use supple::policy::Agent;
use supple::scenario::session::{AgentCache, Input, LiveSession, PushUnit, RATE_HZ, Seat, Setup, Writer};
use supple::task::Command;

use crate::message::Message;
use crate::publisher::{Due, Publisher, Updates};
use crate::request::{Kept, MOST_PULL_N, MOST_PUSH_M_S, MOST_PUSH_N_S, Request, limited};
use crate::save::{self, Minute};
use crate::watch_run;

/// Longest silence of the driving page before the robots stop.
pub const SILENCE: Duration = Duration::from_millis(350);

/// Length of a minute \[ticks\].
const MINUTE: u64 = 60 * RATE_HZ;

/// The state of the thread that owns the robots.
#[derive(Debug)]
pub struct Live {
    world: LiveSession,
    cache: AgentCache,
    publisher: Publisher,
    writer: Writer,
    folder: PathBuf,
    minute: Minute,
    command: Command,
    pull: Option<[f64; 2]>,
    watched: Arc<Mutex<Vec<PathBuf>>>,
    to_self: SyncSender<Message>,
}

impl Live {
    /// Builds the robots and their scene. Inputs are written into the file `session`; saved sessions go into `folder`.
    ///
    /// # Errors
    /// The scene cannot be built, or the session cannot be written.
    pub fn new(
        setup: Setup,
        mut cache: AgentCache,
        folder: PathBuf,
        session: File,
        to_self: SyncSender<Message>,
    ) -> anyhow::Result<Self> {
        let world = LiveSession::new(setup, &mut cache)?;
        let mut writer = Writer::new(session);
        writer.input(0, &Input::Setup(world.setup().clone()), &cache)?;
        let watched = Arc::default();
        watch_run::start(Arc::clone(&watched), to_self.clone())?;
        let publisher = Publisher::new(&world);
        let live = Live {
            world,
            cache,
            writer,
            folder,
            minute: Minute::new(publisher.cast()),
            publisher,
            command: Command::default(),
            pull: None,
            watched,
            to_self,
        };
        live.watch_policies();
        Ok(live)
    }

    /// Returns the channels to pages and viewers.
    pub fn updates(&self) -> Updates {
        self.publisher.updates()
    }

    /// Plays until a [`Message::Stop`] arrives.
    ///
    /// # Errors
    /// The physics fails for good, or the session can no longer be written.
    pub fn run(mut self, messages: &Receiver<Message>) -> anyhow::Result<()> {
        self.publisher.clock.restart(self.world.tick());
        loop {
            if self.publisher.heard.0.elapsed() > SILENCE {
                self.let_go()?;
            }
            match self.publisher.wait(&self.world, messages) {
                Some(Due::Step) => self.step()?,
                Some(Due::Message(Message::Stop)) => return Ok(()),
                Some(Due::Message(message)) => self.take(message)?,
                None => {}
            }
        }
    }

    fn step(&mut self) -> anyhow::Result<()> {
        let tick = self.world.tick();
        // A recording holds the frames of one set-up.
        if !self.minute.belongs_to(self.publisher.cast()) {
            self.minute = Minute::new(self.publisher.cast());
        }
        let played = self.world.step()?;
        self.publisher.note_steps(&self.world, tick, &played);
        self.minute.add(tick, played);
        self.minute.forget(tick.saturating_sub(MINUTE));
        self.writer.tidy(tick.saturating_sub(MINUTE));
        Ok(())
    }

    fn take(&mut self, message: Message) -> anyhow::Result<()> {
        let publisher = &mut self.publisher;
        match message {
            Message::PageOpened(page) if publisher.driver.is_none() => {
                publisher.driver = Some(page);
                publisher.heard.0 = Instant::now();
            }
            Message::PageClosed(page) if publisher.driver == Some(page) => {
                publisher.driver = None;
                self.let_go()?;
            }
            Message::Request(page, Request::Drive) if publisher.driver != Some(page) => {
                publisher.driver = Some(page);
                publisher.heard.0 = Instant::now();
                self.let_go()?;
            }
            Message::Request(page, request) if publisher.driver == Some(page) => {
                publisher.heard = (Instant::now(), publisher.heard.1 + 1);
                self.answer(request)?;
            }
            Message::PolicySaved { path, agent, file } => self.renew(&path, *agent, file)?,
            Message::Notice(text) => publisher.notice(text),
            // Requests of pages that do not drive are ignored.
            _ => {}
        }
        if self.publisher.clock.is_paused() {
            self.publisher.publish(&self.world);
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
                self.command(Command::velocity(forward, left, yaw))?;
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
            Request::Pause(is_paused) => self.publisher.clock.pause(is_paused, tick),
            Request::Speed(speed) => self.publisher.clock.set_speed(speed, tick),
            Request::Keep(what) => self.keep(what),
        }
        Ok(())
    }

    fn command(&mut self, command: Command) -> anyhow::Result<()> {
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
        self.command(Command::default())?;
        self.hold(None)
    }

    /// Applies an input and writes it into the session; an input that fails becomes a notice.
    fn input(&mut self, input: Input) -> anyhow::Result<()> {
        let tick = self.world.tick();
        if let Err(error) = self.world.apply(&input, &mut self.cache) {
            self.publisher.notice(error.to_string());
            return Ok(());
        }
        self.writer.input(tick, &input, &self.cache)?;
        self.publisher.note_input(&self.world, &input);
        Ok(())
    }

    /// Applies a change of scene or policies, and keeps the command and the pull.
    fn set_up(&mut self, input: Input) -> anyhow::Result<()> {
        self.input(input)?;
        self.cache.tidy(&self.world.setup().robots);
        let (command, pull) = (std::mem::take(&mut self.command), self.pull.take());
        self.command(command)?;
        self.hold(pull)?;
        self.watch_policies();
        Ok(())
    }

    /// Replaces the policy of every robot whose policy comes from `path`.
    fn renew(&mut self, path: &Path, agent: Agent, file: Option<Vec<u8>>) -> anyhow::Result<()> {
        let sha256 = agent.sha256.clone();
        let is_older =
            |seat: &Seat| seat.sha256 != sha256 && watch_run::file_of(&seat.policy).is_some_and(|file| file == path);
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
        self.cache.put(agent, file);
        for robot in robots {
            let input = if self.world.simulation(robot) == Some(&simulation) {
                Input::Renew { robot, sha256: sha256.clone() }
            } else {
                // Other rates, gains or latency need a new scene.
                let mut setup = self.world.setup().clone();
                let seat = &mut setup.robots[robot];
                (seat.sha256, seat.compliance) = (sha256.clone(), None);
                Input::Setup(setup)
            };
            self.set_up(input)?;
            // If it failed, `set_up` has shown why.
            if self.world.setup().robots[robot].sha256 == sha256 {
                let name = self.publisher.cast().names.get(robot).cloned().unwrap_or_default();
                self.publisher.notice(format!("{name}: now walks with the newer policy of its run"));
            }
        }
        Ok(())
    }

    fn change_robot(&mut self, index: usize, policy: Option<String>, robot: Option<String>) -> anyhow::Result<()> {
        let mut setup = self.world.setup().clone();
        match policy {
            Some(policy) => match self.cache.find(&policy, robot.as_deref()) {
                Ok(seat) if index < setup.robots.len() => setup.robots[index] = seat,
                Ok(seat) => setup.robots.push(seat),
                Err(error) => {
                    self.publisher.notice(error.to_string());
                    return Ok(());
                }
            },
            None if setup.robots.len() > 1 && index < setup.robots.len() => drop(setup.robots.remove(index)),
            None => {
                self.publisher.notice("the last robot cannot be removed".to_owned());
                return Ok(());
            }
        }
        self.set_up(Input::Setup(setup))
    }

    fn keep(&mut self, what: Kept) {
        let tick = self.world.tick();
        let (session, recording) = save::free_names(&self.folder);
        let from = (what == Kept::Minute).then(|| tick.saturating_sub(MINUTE));
        let kept = self.writer.keep(&session, from, tick, self.world.fingerprint());
        if let Err(error) = kept {
            self.publisher.notice(format!("cannot write {}: {error}", session.display()));
            return;
        }
        self.publisher.notice(format!("saved the session as {}; its recording is being written", session.display()));
        let to_self = self.to_self.clone();
        let shown = self.publisher.updates().shown;
        let started = match what {
            Kept::Minute => {
                let minute = self.minute.clone();
                save::in_background(move || minute.record(&recording), to_self)
            }
            Kept::All => {
                save::in_background(move || save::write_all(&session, &recording, || shown.borrow().is_behind), to_self)
            }
        };
        if let Err(error) = started {
            self.publisher.notice(format!("cannot write the recording: {error}"));
        }
    }

    fn watch_policies(&self) {
        let files = self.world.setup().robots.iter().filter_map(|seat| watch_run::file_of(&seat.policy));
        if let Ok(mut watched) = self.watched.lock() {
            *watched = files.collect();
        }
    }
}
