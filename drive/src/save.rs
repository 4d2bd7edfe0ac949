/*! Saves the last minute or the whole session, and then its recording.

Each of the two has a thread, which writes one at a time. A few saves may wait; further ones are refused with a notice.
*/

use std::collections::VecDeque;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use supple::scenario::session::{RobotStep, SavedSession, SessionPart};
use supple::util::terminal;
use supple_record::Sink;

use crate::message::Message;
use crate::replay;
use crate::server::start_thread;
use crate::viewer_stream::Cast;

/// Pause of a recording after each step while the live robots are late.
const STEP_ASIDE: Duration = Duration::from_millis(30);

/// Largest number of sessions, and of recordings, that wait to be written.
const WAITING: usize = 3;

/// Longest wait for the last sessions at the end of the program.
const PATIENCE: Duration = Duration::from_secs(5);

/// The steps of the last minute.
#[derive(Debug, Clone)]
pub struct Minute {
    cast: Arc<Cast>,
    /// Steps, each with the tick at which it began.
    steps: VecDeque<(u64, RobotStep)>,
}

impl Minute {
    pub fn new(cast: &Arc<Cast>) -> Self {
        Minute { cast: Arc::clone(cast), steps: VecDeque::new() }
    }

    /// Adds steps of these robots that began at a tick. A recording holds the frames of one set-up: others are dropped.
    pub fn add(&mut self, cast: &Arc<Cast>, tick: u64, steps: Vec<RobotStep>) {
        if !Arc::ptr_eq(&self.cast, cast) {
            *self = Minute::new(cast);
        }
        self.steps.extend(steps.into_iter().map(|played| (tick, played)));
    }

    /// Drops the steps before a tick.
    pub fn forget(&mut self, before: u64) {
        while self.steps.front().is_some_and(|(tick, _)| *tick < before) {
            self.steps.pop_front();
        }
    }

    fn record(&self, path: &Path) -> anyhow::Result<()> {
        let mut recorder = self.cast.record(Sink::File(path.to_owned()), false)?;
        self.steps.iter().try_for_each(|(_, played)| replay::record(&mut recorder, played))?;
        Ok(recorder.finish()?)
    }
}

/// A session to be saved, or its last part, and the steps to be recorded; `None` replays the session.
type Save = (SessionPart, Option<Minute>);

/// A session that is saved, and the name reserved for its recording.
struct Saved {
    session: PathBuf,
    recording: PathBuf,
    minute: Option<Minute>,
}

/// Paths of recordings that are reserved and not yet whole; `None` once the program ends, when no further one is begun.
type Unfinished = Arc<Mutex<Option<Vec<PathBuf>>>>;

/// The threads that write sessions and recordings.
pub struct Saver {
    to: SyncSender<Save>,
    unfinished: Unfinished,
    /// Disconnected when the last session is written.
    ended: Receiver<()>,
}

impl Saver {
    /// Starts the threads. Saves go into `folder`, and notices `to_robots`; recordings pause while the live robots are late.
    pub fn start(
        folder: PathBuf,
        to_robots: SyncSender<Message>,
        is_late: impl Fn() -> bool + Send + 'static,
    ) -> anyhow::Result<Self> {
        let (to, saves) = sync_channel::<Save>(WAITING);
        let (to_recorder, saved) = sync_channel::<Saved>(WAITING);
        let (end, ended) = channel();
        let (notices, unfinished) = (to_robots.clone(), Unfinished::new(Mutex::new(Some(Vec::new()))));
        let (reserved, done) = (Arc::clone(&unfinished), Arc::clone(&unfinished));
        let save = move || {
            for (part, minute) in saves {
                let text = match write_session(&folder, &part) {
                    Ok((session, recording)) => {
                        with(&reserved, |all| all.push(recording.clone()));
                        hand_on(Saved { session, recording, minute }, &to_recorder, &reserved)
                    }
                    Err(error) => format!("cannot save a session in {}: {error}", folder.display()),
                };
                // The receiver is gone if the program is ending.
                let _ = notices.send(Message::Notice(text));
            }
            drop(end);
        };
        let record = move || {
            for saved in saved {
                if with(&done, |_| ()).is_none() {
                    return;
                }
                let name = saved.recording.display();
                let text = match saved.record(&is_late) {
                    Ok(()) => format!("the recording {name} is written"),
                    Err(error) => format!("the recording {name} could not be written: {error:#}"),
                };
                with(&done, |all| all.retain(|path| *path != saved.recording));
                let _ = to_robots.send(Message::Notice(text));
            }
        };
        start_thread("saving sessions", save)?;
        start_thread("recording", record)?;
        Ok(Saver { to, unfinished, ended })
    }

    /// Saves a session, unless too many others wait.
    pub fn save(&self, part: SessionPart, minute: Option<Minute>) -> Result<(), String> {
        let full = |_| "not saved, because others are being saved: try again in a moment".to_owned();
        self.to.try_send((part, minute)).map_err(full)
    }

    /// Waits for a moment until all sessions are written; recordings that are not whole are removed.
    pub fn finish(self) {
        drop(self.to);
        let _ = self.ended.recv_timeout(PATIENCE);
        let unfinished = self.unfinished.lock().ok().and_then(|mut unfinished| unfinished.take());
        for recording in unfinished.into_iter().flatten() {
            let (session, name) = (recording.with_extension("jsonl"), recording.display());
            let (session, word) = (terminal::shell_word(session), terminal::shell_word(&recording));
            // A file that cannot be removed is incomplete, as the note says.
            let _ = fs::remove_file(&recording);
            let command = format!("drive --replay {session} --record {word}");
            terminal::note(format_args!("the recording {name} was given up; write it with: {command}"));
        }
    }
}

impl Saved {
    fn record(&self, is_late: &impl Fn() -> bool) -> anyhow::Result<()> {
        if let Some(minute) = &self.minute {
            return minute.record(&self.recording);
        }
        let step_aside = || thread::sleep(if is_late() { STEP_ASIDE } else { Duration::ZERO });
        replay::play(SavedSession::load(&self.session)?, Some(&self.recording), step_aside).map(drop)
    }
}

/// Changes the list of unfinished recordings; `None` if the program is ending.
fn with<T>(unfinished: &Unfinished, change: impl FnOnce(&mut Vec<PathBuf>) -> T) -> Option<T> {
    unfinished.lock().ok()?.as_mut().map(change)
}

/// Queues the recording of a saved session; returns the notice.
fn hand_on(saved: Saved, to: &SyncSender<Saved>, unfinished: &Unfinished) -> String {
    let (session, recording) = (saved.session.display().to_string(), saved.recording.clone());
    if to.try_send(saved).is_ok() {
        return format!("saved the session as {session}; its recording is being written");
    }
    with(unfinished, |all| all.retain(|path| *path != recording));
    // The empty file only reserved the name.
    let _ = fs::remove_file(recording);
    let hint = "because others wait: `--replay` with `--record` writes it";
    format!("saved the session as {session}, without a recording, {hint}")
}

/// Writes a session under the first free name of a folder; returns its path and that of its recording, an empty file.
fn write_session(folder: &Path, part: &SessionPart) -> io::Result<(PathBuf, PathBuf)> {
    for number in 1_u64.. {
        let name = |end: &str| folder.join(format!("drive-{number}{end}"));
        let (session, recording) = (name(".jsonl"), name(".rrd"));
        if session.exists() || replay::numbered(&recording, 1).exists() {
            continue;
        }
        // Another program may take a name at any moment.
        let written = File::create_new(&recording)
            .and_then(|_| part.write_new(&session).inspect_err(|_| drop(fs::remove_file(&recording))));
        match written {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            written => return written.map(|()| (session, recording)),
        }
    }
    unreachable!("there are more names than a folder can hold")
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::Sender;

    use supple::scenario::session::{AgentCache, Input, SceneKind, Setup, Writer};

    use super::*;

    /// A saver whose recorder waits until a message arrives, as behind a recording that takes long.
    fn busy_saver(folder: &Path) -> (Saver, Receiver<Message>, Sender<()>) {
        let (to_robots, messages) = sync_channel(512);
        let (go_on, wait) = channel::<()>();
        let saver = Saver::start(folder.to_owned(), to_robots, move || wait.recv().is_ok()).unwrap();
        (saver, messages, go_on)
    }

    #[test]
    fn recordings_that_wait_at_the_end_leave_no_empty_files() {
        let folder = tempfile::tempdir().unwrap();
        let (saver, messages, _go_on) = busy_saver(folder.path());
        let mut cache = AgentCache::default();
        let robots = vec![cache.find("compliant", None).unwrap()];
        let setup = Setup { scene: SceneKind::Flat, seed: 0, robots };
        let mut writer = Writer::new(tempfile::tempfile().unwrap());
        writer.input(0, &Input::Setup(setup), &cache).unwrap();
        for _ in 0..2 {
            let part = writer.part(None, 40, String::new()).unwrap();
            saver.save(part, None).unwrap();
            assert!(matches!(messages.recv().unwrap(), Message::Notice(text) if text.contains("is being written")));
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 4);
        saver.finish();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
        assert!(["drive-1.jsonl", "drive-2.jsonl"].iter().all(|name| folder.path().join(name).exists()));
    }

    #[test]
    fn names_of_others_are_never_taken() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["drive-1.jsonl", "drive-2.rrd", "drive-3-2.rrd"] {
            fs::write(folder.path().join(name), name).unwrap();
        }
        let save = || {
            let part = Writer::new(tempfile::tempfile().unwrap()).part(None, 0, String::new()).unwrap();
            (0..20).map(|_| write_session(folder.path(), &part).unwrap()).collect::<Vec<_>>()
        };
        let saved = thread::scope(|scope| [scope.spawn(save), scope.spawn(save)].map(|saved| saved.join().unwrap()));
        let sessions: std::collections::BTreeSet<_> = saved.concat().into_iter().map(|(session, _)| session).collect();
        assert_eq!(sessions.len(), 40);
        assert!(sessions.iter().all(|path| fs::read_to_string(path).unwrap().contains("end")));
        assert!(!sessions.contains(&folder.path().join("drive-3.jsonl")));
        for name in ["drive-1.jsonl", "drive-2.rrd", "drive-3-2.rrd"] {
            assert_eq!(fs::read_to_string(folder.path().join(name)).unwrap(), name);
        }
        // Each of the 40 with the reserved name of its recording, and the three.
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2 * 40 + 3);
    }
}
