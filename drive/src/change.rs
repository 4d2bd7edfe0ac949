/*! Changes of robots and scene, which are built while the present robots walk on.

Files are read and scenes are built on a thread, one change after another. A change that takes too long, because a file or
folder does not answer, is given up when another one waits.
*/

use std::collections::VecDeque;
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};

use supple::mujoco;
use supple::policy::AgentError;
use supple::scenario::session::{AgentCache, LiveSession, SceneKind, SessionError, Setup};

use crate::message::{Built, Message, NewPolicy};
use crate::server::start_thread;
use crate::watch_run;

/// Time after which pages show that a change is still being built.
const SLOW: Duration = Duration::from_secs(2);

/// Time after which a change is given up for the next one.
const PATIENCE: Duration = Duration::from_secs(10);

/// Largest number of changes that wait.
const WAITING: usize = 16;

/// Largest number of changes that were given up and have not ended.
const GIVEN_UP: usize = 4;

/// A change of robots or scene.
#[derive(Debug)]
pub enum Change {
    /// Another seed; `None` takes the next one.
    Seed(Option<u64>),
    Scene(SceneKind),
    /// Another policy and robot, as in [`Request::Robot`](crate::request::Request::Robot).
    Robot {
        index: usize,
        policy: Option<String>,
        robot: Option<String>,
    },
    Policy(Box<NewPolicy>),
    Setup(Setup),
}

impl Change {
    fn name(&self) -> String {
        match self {
            Change::Robot { policy: Some(policy), robot: Some(robot), .. } => format!("'{policy}' on '{robot}'"),
            Change::Robot { policy: Some(policy), .. } => format!("'{policy}'"),
            Change::Scene(scene) => format!("the scene '{}'", scene.name()),
            _ => "the scene".to_owned(),
        }
    }

    fn build(self, mut setup: Setup, mut cache: AgentCache) -> anyhow::Result<Built> {
        match self {
            Change::Seed(seed) => setup.seed = seed.unwrap_or(setup.seed.wrapping_add(1)),
            Change::Scene(scene) => setup.scene = scene,
            Change::Robot { index, policy: Some(policy), robot } => {
                let seat = cache.find(&policy, robot.as_deref())?;
                match setup.robots.get_mut(index) {
                    Some(old) => *old = seat,
                    None => setup.robots.push(seat),
                }
            }
            Change::Robot { index, .. } if setup.robots.len() > 1 && index < setup.robots.len() => {
                setup.robots.remove(index);
            }
            Change::Robot { .. } => anyhow::bail!("the last robot cannot be removed"),
            Change::Setup(new) => setup = new,
            Change::Policy(_) => {}
        }
        let world = LiveSession::new(setup, &mut cache)?;
        cache.tidy(&world.setup().robots);
        Ok(Built { files: watch_run::files_of(&world), world, cache })
    }
}

/// The change that is being built.
struct Present {
    number: u64,
    name: String,
    since: Instant,
    is_announced: bool,
    before: Setup,
}

/// Builds changes, one after another.
pub struct Builder {
    waiting: VecDeque<Change>,
    present: Option<Present>,
    number: u64,
    given_up: usize,
    to_robots: SyncSender<Message>,
    /// True if pages on other machines may name files: only the terminal then shows errors about them.
    is_shared: bool,
}

impl Builder {
    /// Creates a builder that sends what it has built.
    pub fn new(to_robots: SyncSender<Message>, is_shared: bool) -> Self {
        Builder { waiting: VecDeque::new(), present: None, number: 0, given_up: 0, to_robots, is_shared }
    }

    /// Adds a change, unless too many wait.
    pub fn add(&mut self, change: Change) -> Result<(), String> {
        if self.waiting.len() >= WAITING {
            let name = change.name();
            return Err(format!("{name} is not loaded, because {WAITING} changes wait: try again in a moment"));
        }
        self.waiting.push_back(change);
        Ok(())
    }

    /// Returns true if nothing is being built and nothing waits.
    #[cfg(test)]
    pub(crate) fn is_idle(&self) -> bool {
        self.present.is_none() && self.waiting.is_empty()
    }

    /// Makes the present change as old as one that is given up.
    #[cfg(test)]
    pub(crate) fn age(&mut self) {
        if let Some(present) = &mut self.present {
            present.since -= PATIENCE;
        }
    }

    /// Returns a notice about a change that takes long, and gives it up if another one has waited long enough.
    pub fn look(&mut self) -> Option<String> {
        let present = self.present.as_mut()?;
        let taken = present.since.elapsed();
        if taken > PATIENCE && !self.waiting.is_empty() {
            self.given_up += 1;
            return self.present.take().map(|given_up| format!("{} does not answer: given up", given_up.name));
        }
        let is_news = taken > SLOW && !std::mem::replace(&mut present.is_announced, taken > SLOW);
        is_news.then(|| format!("{} is still being loaded", present.name))
    }

    /// Returns the change to be started; `None` while another one is being built.
    pub fn take_due(&mut self) -> Option<Change> {
        if self.present.is_some() { None } else { self.waiting.pop_front() }
    }

    /// Starts to build a change of a set-up, unless too many others do not end.
    pub fn start(&mut self, change: Change, before: &Setup, cache: &AgentCache) -> Result<(), String> {
        let name = change.name();
        if self.given_up >= GIVEN_UP {
            return Err(format!(
                "{name} is not loaded, because {GIVEN_UP} files or folders do not answer; start again"
            ));
        }
        self.number += 1;
        let (number, to_robots, is_shared) = (self.number, self.to_robots.clone(), self.is_shared);
        let (setup, cache, what) = (before.clone(), cache.clone(), name.clone());
        let work = move || {
            // Frees the memory of the scene before the present one.
            mujoco::release_memory();
            let result = change.build(setup, cache).map(Box::new).map_err(|error| {
                let is_harmless = matches!(error.downcast_ref(), Some(SessionError::Agent(AgentError::Unknown { .. })));
                watch_run::told(&format!("{error:#}"), &what, is_shared && !is_harmless)
            });
            // The receiver is gone if the program is ending.
            let _ = to_robots.send(Message::Built(number, result));
        };
        start_thread("loading", work).map_err(|error| format!("{name} cannot be loaded: {error:#}"))?;
        let (since, before) = (Instant::now(), before.clone());
        self.present = Some(Present { number, name, since, is_announced: false, before });
        Ok(())
    }

    /// Takes what was built and the set-up before it, or the reason why it was not; `None` if it had been given up.
    pub fn finish(
        &mut self,
        number: u64,
        result: Result<Box<Built>, String>,
    ) -> Option<Result<(Box<Built>, Setup), String>> {
        let Some(present) = self.present.take_if(|present| present.number == number) else {
            self.given_up = self.given_up.saturating_sub(1);
            return None;
        };
        Some(result.map(|built| (built, present.before)))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::sync_channel;

    use super::*;

    #[test]
    fn pages_elsewhere_never_see_what_a_file_holds() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("private.yaml");
        std::fs::write(&path, "password_of_the_lab: 1234\n").unwrap();
        let mut cache = AgentCache::default();
        let robots = vec![cache.find("compliant", None).unwrap()];
        let setup = Setup { scene: SceneKind::Flat, seed: 0, robots };
        let told = |policy: &str, is_shared| {
            let (to_robots, messages) = sync_channel(1);
            let change = Change::Robot { index: 0, policy: Some(policy.to_owned()), robot: None };
            Builder::new(to_robots, is_shared).start(change, &setup, &cache).unwrap();
            let Message::Built(_, Err(text)) = messages.recv().unwrap() else { panic!("it is built") };
            text
        };
        let path = path.to_str().unwrap();
        assert!(told(path, false).contains("password_of_the_lab"), "{}", told(path, false));
        assert_eq!(told(path, true), format!("'{path}' cannot be loaded: the terminal shows the reason"));
        assert!(told("missing", true).contains("there is no policy 'missing'"));
    }
}
