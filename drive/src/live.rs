/*! The thread that owns the robots.

It waits until the next step is due and reads messages meanwhile; they take effect with that step and are written into the
session as inputs. The driving page must keep sending messages: after [`SILENCE`](crate::driver::SILENCE) without one, the command becomes zero and
a pull ends.
*/

use std::fs::File;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, SyncSender};
use std::sync::{Arc, Mutex};

use anyhow::Context;
use supple::scenario::session::{Act, AgentCache, Input, LiveSession, RATE_HZ, Seat, SessionError, Setup, Writer};
use supple::task::Command;

use crate::change::{Builder, Change};
use crate::driver::Heard;
use crate::message::{Built, Message, NewPolicy};
use crate::publisher::{Due, Publisher, Updates};
use crate::request::{Kept, Request, bounded};
use crate::save::{Minute, Saver};
use crate::watch_run;

/// Length of a minute \[ticks\].
const MINUTE: u64 = 60 * RATE_HZ;

/// The state of the thread that owns the robots.
pub struct Live {
    world: LiveSession,
    cache: AgentCache,
    publisher: Publisher,
    /// The session so far, or why it can no longer be saved.
    writer: Result<Writer, String>,
    saver: Saver,
    minute: Minute,
    command: Command,
    pull: Option<[f64; 2]>,
    builder: Builder,
    /// File of each robot's policy, if it may change while it is used.
    files: Vec<Option<PathBuf>>,
    watched: Arc<Mutex<Vec<PathBuf>>>,
}

impl Live {
    /// Builds the robots and their scene. Inputs are written into the file `session`; saved sessions go into `folder`. With `is_shared`,
    /// pages on other machines may name files: pages then do not show errors about them.
    ///
    /// # Errors
    /// The scene cannot be built, the session cannot be written, or a thread cannot be started.
    pub fn new(
        setup: Setup,
        mut cache: AgentCache,
        folder: PathBuf,
        session: File,
        to_self: SyncSender<Message>,
        is_shared: bool,
    ) -> anyhow::Result<Self> {
        let world = LiveSession::new(setup, &mut cache)?;
        let mut writer = Writer::new(session);
        writer.input(0, &Input::Setup(world.setup().clone()), &cache).with_context(temporary)?;
        let watched = Arc::default();
        watch_run::start(Arc::clone(&watched), to_self.clone(), is_shared)?;
        let publisher = Publisher::new(&world);
        let shown = publisher.updates.shown.clone();
        let live = Live {
            cache,
            writer: Ok(writer),
            saver: Saver::start(folder, to_self.clone(), move || shown.borrow().is_behind)?,
            minute: Minute::new(publisher.cast()),
            publisher,
            command: Command::default(),
            pull: None,
            builder: Builder::new(to_self, is_shared),
            files: watch_run::files_of(&world),
            watched,
            world,
        };
        live.watch_policies();
        Ok(live)
    }

    /// Returns the channels to pages and viewers.
    pub fn updates(&self) -> Updates {
        self.publisher.updates.clone()
    }

    /// Plays until a [`Message::Stop`] arrives.
    ///
    /// # Errors
    /// The physics fails for good.
    pub fn run(mut self, messages: &Receiver<Message>) -> anyhow::Result<()> {
        self.publisher.clock.restart(self.world.tick());
        loop {
            if self.publisher.driver.is_silent() {
                self.let_go()?;
            }
            self.build()?;
            match self.publisher.wait(&self.world, messages) {
                Some(Due::Step) => self.step()?,
                Some(Due::Message(Message::Stop)) => {
                    self.saver.finish();
                    return Ok(());
                }
                Some(Due::Message(message)) => self.take(message)?,
                None => {}
            }
        }
    }

    fn step(&mut self) -> anyhow::Result<()> {
        let tick = self.world.tick();
        let played = self.world.step()?;
        self.publisher.note_steps(&self.world, tick, &played);
        self.minute.add(self.publisher.cast(), tick, played);
        let past = tick.saturating_sub(MINUTE);
        self.minute.forget(past);
        if let Ok(writer) = &mut self.writer {
            writer.tidy(past);
        }
        Ok(())
    }

    fn take(&mut self, message: Message) -> anyhow::Result<()> {
        match self.publisher.driver.take(message) {
            Heard::Request(request) => self.answer(request)?,
            Heard::Released => self.let_go()?,
            Heard::Other(Message::PolicySaved(new)) => self.change(Change::Policy(new)),
            Heard::Other(Message::Built(number, result)) => match self.builder.finish(number, result) {
                Some(Ok((built, before))) => self.take_over(*built, &before)?,
                Some(Err(problem)) => self.publisher.notice(problem),
                None => {}
            },
            Heard::Other(Message::Notice(text)) => self.publisher.notice(text),
            Heard::Nothing | Heard::Other(_) => {}
        }
        if self.publisher.clock.is_paused {
            self.publisher.publish(&self.world);
        }
        Ok(())
    }

    fn answer(&mut self, request: Request) -> anyhow::Result<()> {
        let tick = self.world.tick();
        match request {
            Request::Drive => {}
            Request::Act(act) => self.act(act)?,
            Request::Seed(seed) => self.change(Change::Seed(seed)),
            Request::Scene(scene) => self.change(Change::Scene(scene)),
            Request::Robot { index, policy, robot } => self.change(Change::Robot { index, policy, robot }),
            Request::Pause(is_paused) => self.publisher.clock.pause(is_paused, tick),
            Request::Speed(speed) => self.publisher.clock.set_speed(speed, tick),
            Request::Keep(what) => self.keep(what),
        }
        Ok(())
    }

    /// Does what the driving page requests, within bounds.
    fn act(&mut self, act: Act) -> anyhow::Result<()> {
        match bounded(act, &self.world.range()) {
            Act::Command(command) => self.command(command),
            Act::Hand(force) => self.hold(force),
            act => self.input(Input::Act(act)),
        }
    }

    fn command(&mut self, command: Command) -> anyhow::Result<()> {
        let is_new = std::mem::replace(&mut self.command, command) != command;
        if is_new { self.input(Input::Act(Act::Command(command))) } else { Ok(()) }
    }

    fn hold(&mut self, force: Option<[f64; 2]>) -> anyhow::Result<()> {
        let is_new = std::mem::replace(&mut self.pull, force) != force;
        if is_new { self.input(Input::Act(Act::Hand(force))) } else { Ok(()) }
    }

    fn let_go(&mut self) -> anyhow::Result<()> {
        self.command(Command::default())?;
        self.hold(None)
    }

    /// Applies an input and writes it into the session; an input that does not fit becomes a notice.
    fn input(&mut self, input: Input) -> anyhow::Result<()> {
        let tick = self.world.tick();
        match self.world.apply(&input, &mut self.cache) {
            Ok(()) => self.write(tick, &input),
            // A reset has failed, maybe of one robot only.
            Err(SessionError::Physics(error)) => return Err(error.into()),
            Err(error) => self.publisher.notice(error.to_string()),
        }
        Ok(())
    }

    /// Writes an input that was applied at a tick into the session.
    fn write(&mut self, tick: u64, input: &Input) {
        if let Ok(writer) = &mut self.writer
            && let Err(error) = writer.input(tick, input, &self.cache)
        {
            let (time_s, place) = (tick as f64 / RATE_HZ as f64, temporary());
            let hint = "make room there, or choose another folder with TMPDIR, and start again";
            let problem = format!("since {time_s:.1} s nothing can be saved: {place}: {error}; {hint}");
            self.publisher.notice(problem.clone());
            self.writer = Err(problem);
        }
        self.publisher.note_input(&self.world, input);
    }

    /// Adds a change of scene or robots to those that wait to be built.
    fn change(&mut self, change: Change) {
        self.builder.add(change).unwrap_or_else(|problem| self.publisher.notice(problem));
    }

    /// Begins to build the next change.
    fn build(&mut self) -> anyhow::Result<()> {
        if let Some(news) = self.builder.look() {
            self.publisher.notice(news);
        }
        while let Some(change) = self.builder.take_due() {
            let change = match change {
                Change::Policy(new) => self.renew(*new)?,
                change => Some(change),
            };
            let started = change.map_or(Ok(()), |change| self.builder.start(change, self.world.setup(), &self.cache));
            started.unwrap_or_else(|problem| self.publisher.notice(problem));
        }
        Ok(())
    }

    /// Continues with robots and scene that were built from the set-up `before`; keeps the command and the pull.
    fn take_over(&mut self, built: Built, before: &Setup) -> anyhow::Result<()> {
        let (tick, old) = (self.world.tick(), self.world.setup().robots.clone());
        self.world.replace(built.world);
        (self.cache, self.files) = (built.cache, built.files);
        let setup = self.world.setup().clone();
        self.write(tick, &Input::Setup(setup.clone()));
        let (command, pull) = (std::mem::take(&mut self.command), self.pull.take());
        self.command(command)?;
        self.hold(pull)?;
        // Keeps the compliance that was commanded meanwhile.
        for (robot, ((new, old), before)) in setup.robots.iter().zip(&old).zip(&before.robots).enumerate() {
            if old.compliance != before.compliance && old.sha256 == new.sha256 {
                self.input(Input::Act(Act::Comply { robot, compliance: old.compliance }))?;
            }
        }
        self.note_newer_policies(&old);
        self.watch_policies();
        Ok(())
    }

    fn note_newer_policies(&mut self, old: &[Seat]) {
        let seats = self.world.setup().robots.iter().zip(old).zip(&self.publisher.cast().names);
        let newer = seats.filter(|((seat, old), _)| seat.policy == old.policy && seat.sha256 != old.sha256);
        let texts: Vec<String> =
            newer.map(|(_, name)| format!("{name}: now walks with the newer policy of its run")).collect();
        texts.into_iter().for_each(|text| self.publisher.notice(text));
    }

    /// Replaces the policy of every robot whose policy comes from the file of a newer one; returns the change that is to be
    /// built for it, if there is one.
    fn renew(&mut self, new: NewPolicy) -> anyhow::Result<Option<Change>> {
        let (sha256, simulation) = (new.agent.sha256.clone(), new.agent.config.simulation.clone());
        let (old, mut setup) = (self.world.setup().robots.clone(), self.world.setup().clone());
        let mut robots = Vec::new();
        for (robot, (seat, file)) in setup.robots.iter_mut().zip(&self.files).enumerate() {
            if seat.sha256 != sha256 && file.as_ref() == Some(&new.path) {
                (seat.sha256, seat.compliance) = (sha256.clone(), None);
                robots.push(robot);
            }
        }
        if robots.is_empty() {
            return Ok(None);
        }
        self.cache.put(new.agent, new.file);
        // Other rates, gains or latency need a new scene.
        if robots.iter().any(|robot| self.world.simulation(*robot) != Some(&simulation)) {
            return Ok(Some(Change::Setup(setup)));
        }
        for robot in robots {
            self.input(Input::Renew { robot, sha256: sha256.clone() })?;
        }
        self.note_newer_policies(&old);
        self.cache.tidy(&self.world.setup().robots);
        Ok(None)
    }

    fn keep(&mut self, what: Kept) {
        let (tick, state) = (self.world.tick(), self.world.fingerprint());
        let from = (what == Kept::Minute).then(|| tick.saturating_sub(MINUTE));
        let part = match &mut self.writer {
            Ok(writer) => writer
                .part(from, tick, state)
                .map_err(|error| format!("cannot save the session, which is in {} meanwhile: {error}", temporary())),
            Err(problem) => Err(problem.clone()),
        };
        let minute = (what == Kept::Minute).then(|| self.minute.clone());
        let saved = part.and_then(|part| self.saver.save(part, minute));
        saved.unwrap_or_else(|problem| self.publisher.notice(problem));
    }

    fn watch_policies(&self) {
        if let Ok(mut watched) = self.watched.lock() {
            *watched = self.files.iter().flatten().cloned().collect();
        }
    }
}

/// Creates the file of the session while it happens.
///
/// # Errors
/// No file can be created in the folder for temporary files, for example because it is full.
pub fn session_file() -> anyhow::Result<File> {
    tempfile::tempfile().with_context(|| format!("cannot begin a session: {}", temporary()))
}

/// Names the folder for temporary files.
fn temporary() -> String {
    format!("the folder for temporary files, {}", std::env::temp_dir().display())
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::sync_channel;
    use std::time::{Duration, Instant};

    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};
    use supple::scenario::session::{SavedSession, SceneKind};

    use super::*;
    use crate::request::PageId;

    const PAGE: PageId = 1;

    /// Robots that stand, their messages, and the folder of their saves.
    fn live(session: File) -> (Live, Receiver<Message>, tempfile::TempDir) {
        let folder = tempfile::tempdir().unwrap();
        let mut cache = AgentCache::default();
        let robots = ["compliant", "baseline"].map(|name| cache.find(name, None).unwrap()).to_vec();
        let setup = Setup { scene: SceneKind::Flat, seed: 0, robots };
        let (to_self, messages) = sync_channel(512);
        let mut live = Live::new(setup, cache, folder.path().to_owned(), session, to_self, false).unwrap();
        live.take(Message::PageOpened(PAGE)).unwrap();
        (live, messages, folder)
    }

    fn ask(live: &mut Live, text: &str) {
        if let Ok(request) = Request::parse(text) {
            live.take(Message::Request(PAGE, request)).unwrap();
        }
    }

    /// Plays steps and takes messages until `is_done`.
    fn play_until(live: &mut Live, messages: &Receiver<Message>, is_done: impl Fn(&Live) -> bool) {
        let start = Instant::now();
        while !is_done(live) {
            assert!(start.elapsed() < Duration::from_secs(60));
            live.build().unwrap();
            messages.try_iter().for_each(|message| live.take(message).unwrap());
            live.step().unwrap();
        }
    }

    fn state(live: &Live) -> String {
        live.publisher.publish(&live.world);
        live.updates().state.borrow().to_string()
    }

    #[test]
    fn whatever_a_page_sends_is_saved_and_replayed() {
        let numbers =
            ["0", "-0.0", "0.3", "-1", "3", "1e308", "-1.7976931348623157e308", "5e-324", "1e-300", "1e999", "-1e999"];
        let policies =
            ["compliant", "baseline", "baseline@0.04", "baseline@1e308", "baseline@inf", "baseline@nan", "", "../"];
        let mut rng = StdRng::seed_from_u64(49);
        for _ in 0..4 {
            let (mut live, messages, folder) = live(session_file().unwrap());
            for _ in 0..150 {
                let mut number = || numbers[rng.random_range(0..numbers.len())];
                let (a, b, c) = (number(), number(), number());
                let (policy, index) = (policies[rng.random_range(0..policies.len())], rng.random_range(0..3));
                let text = match rng.random_range(0..40) {
                    0..6 => format!(r#"{{"command":[{a},{b},{c}]}}"#),
                    6..14 => format!(r#"{{"push":{{"size":[{a},{b}],"unit":"m/s"}}}}"#),
                    14..22 => format!(r#"{{"push":{{"size":[{a},{b}],"unit":"N·s"}}}}"#),
                    22..28 => format!(r#"{{"pull":[{a},{b}]}}"#),
                    28..32 => format!(r#"{{"comply":{{"robot":{index},"compliance":{a}}}}}"#),
                    32 => format!(r#"{{"comply":{{"robot":{index},"compliance":null}}}}"#),
                    33 => r#"{"pull":null}"#.to_owned(),
                    34 => r#""reset""#.to_owned(),
                    35 => r#"{"seed":18446744073709551615}"#.to_owned(),
                    36 => r#"{"seed":null}"#.to_owned(),
                    37 => r#"{"scene":"box"}"#.to_owned(),
                    _ => format!(r#"{{"robot":{{"index":{index},"policy":"{policy}","robot":null}}}}"#),
                };
                ask(&mut live, &text);
                let until = live.world.tick() + 4 * rng.random_range(0..8);
                play_until(&mut live, &messages, |live| live.world.tick() >= until);
            }
            play_until(&mut live, &messages, |live| live.builder.is_idle());
            for (from, name) in [(None, "all"), (Some(live.world.tick().saturating_sub(240)), "last")] {
                let path = folder.path().join(name);
                let (tick, state) = (live.world.tick(), live.world.fingerprint());
                live.writer.as_mut().unwrap().part(from, tick, state).unwrap().write_new(&path).unwrap();
                let mut replay = SavedSession::load(&path).unwrap().play().unwrap();
                while replay.step().unwrap().is_some() {}
                assert_eq!(replay.verify(), Some(Ok(())));
            }
        }
    }

    #[test]
    fn robots_walk_on_when_nothing_can_be_saved() {
        let full = File::options().read(true).write(true).open("/dev/full").unwrap();
        let (mut live, messages, folder) = live(full);
        let mut count = 0;
        while live.writer.is_ok() {
            count += 1;
            assert!(count < 10_000);
            ask(&mut live, r#"{"push":{"size":[0,0.01],"unit":"m/s"}}"#);
        }
        let tick = live.world.tick();
        play_until(&mut live, &messages, |live| live.world.tick() > tick + 100);
        for _ in 0..2 {
            let text = state(&live);
            let temporary = std::env::temp_dir();
            for part in ["since 0.0 s nothing can be saved", temporary.to_str().unwrap(), "TMPDIR", "No space left"] {
                assert!(text.contains(part), "{part}: {text}");
            }
            (0..6).for_each(|_| live.publisher.notice("another".to_owned()));
            ask(&mut live, r#"{"keep":"all"}"#);
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn file_that_does_not_answer_stops_neither_robots_nor_other_changes() {
        let (mut live, messages, folder) = live(session_file().unwrap());
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        ask(&mut live, &format!(r#"{{"robot":{{"index":0,"policy":{pipe:?},"robot":null}}}}"#));
        ask(&mut live, r#"{"scene":"box"}"#);
        play_until(&mut live, &messages, |live| live.world.tick() > 100);
        assert_eq!(live.world.setup().scene, SceneKind::Flat);
        live.builder.age();
        ask(&mut live, r#"{"comply":{"robot":1,"compliance":0.04}}"#);
        play_until(&mut live, &messages, |live| live.world.setup().scene == SceneKind::Box);
        assert!(state(&live).contains("pipe' does not answer: given up"), "{}", state(&live));
        let robots = &live.world.setup().robots;
        assert_eq!((robots[0].policy.as_str(), robots[1].compliance), ("compliant", Some(0.04)));
    }

    #[test]
    fn what_is_commanded_while_a_scene_is_built_is_kept() {
        let (mut live, messages, _folder) = live(session_file().unwrap());
        ask(&mut live, r#"{"command":[0.3,0,0]}"#);
        ask(&mut live, r#"{"pull":[5,0]}"#);
        ask(&mut live, r#"{"seed":7}"#);
        live.build().unwrap();
        ask(&mut live, r#"{"comply":{"robot":1,"compliance":0.04}}"#);
        assert_eq!(live.world.setup().seed, 0);
        play_until(&mut live, &messages, |live| live.world.setup().seed == 7);
        assert_eq!((live.command.forward, live.pull), (0.3, Some([5.0, 0.0])));
        assert_eq!(live.world.setup().robots[1].compliance, Some(0.04));
    }
}
