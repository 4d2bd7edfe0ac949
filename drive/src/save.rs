/*! Saves the last minute or the whole session, and then its recording.

Both happen beside the robots, one at a time each: few saves wait, and further ones are refused with a notice.
*/

use std::collections::VecDeque;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::thread;
use std::time::Duration;

use supple::scenario::session::{RobotStep, SavedSession, SessionPart};
use supple_record::Sink;

use crate::message::Message;
use crate::replay;
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
    /// Creates an empty minute for these robots.
    pub fn new(cast: &Arc<Cast>) -> Self {
        Minute { cast: Arc::clone(cast), steps: VecDeque::new() }
    }

    /// Returns true if the steps are of these robots.
    pub fn belongs_to(&self, cast: &Arc<Cast>) -> bool {
        Arc::ptr_eq(&self.cast, cast)
    }

    /// Adds steps that began at a tick.
    pub fn add(&mut self, tick: u64, steps: Vec<RobotStep>) {
        self.steps.extend(steps.into_iter().map(|played| (tick, played)));
    }

    /// Drops the steps before a tick.
    pub fn forget(&mut self, before: u64) {
        while self.steps.front().is_some_and(|(tick, _)| *tick < before) {
            self.steps.pop_front();
        }
    }

    /// Writes the steps as a recording.
    fn record(&self, path: &Path) -> anyhow::Result<()> {
        let mut recorder = self.cast.record(Sink::File(path.to_owned()))?;
        self.steps.iter().try_for_each(|(_, played)| replay::record(&mut recorder, played))?;
        Ok(recorder.finish()?)
    }
}

/// A session to be saved.
#[derive(Debug)]
pub struct Save {
    /// The session, or its last part.
    pub part: SessionPart,
    /// The steps to be recorded; `None` replays the session.
    pub minute: Option<Minute>,
}

/// A session that is saved, and the name reserved for its recording.
struct Saved {
    session: PathBuf,
    recording: PathBuf,
    minute: Option<Minute>,
}

/// The threads that write sessions and recordings.
#[derive(Debug)]
pub struct Saver {
    to: SyncSender<Save>,
    /// Disconnected when the last session is written.
    ended: Receiver<()>,
}

impl Saver {
    /// Starts the threads. Saves go into `folder`, and notices `to_robots`; recordings pause while the live robots are late.
    ///
    /// # Errors
    /// A thread cannot be started.
    pub fn start(
        folder: PathBuf,
        to_robots: SyncSender<Message>,
        is_late: impl Fn() -> bool + Send + 'static,
    ) -> io::Result<Self> {
        let (to, saves) = sync_channel::<Save>(WAITING);
        let (to_recorder, saved) = sync_channel::<Saved>(WAITING);
        let (end, ended) = channel();
        let notices = to_robots.clone();
        let save = move || {
            for Save { part, minute } in saves {
                let text = match write_session(&folder, &part) {
                    Ok((session, recording)) => hand_on(Saved { session, recording, minute }, &to_recorder),
                    Err(error) => format!("cannot save a session in {}: {error}", folder.display()),
                };
                // The receiver is gone if the program is ending.
                let _ = notices.send(Message::Notice(text));
            }
            drop(end);
        };
        let record = move || {
            for saved in saved {
                let name = saved.recording.display();
                let text = match saved.record(&is_late) {
                    Ok(()) => format!("the recording {name} is written"),
                    Err(error) => format!("the recording {name} could not be written: {error:#}"),
                };
                let _ = to_robots.send(Message::Notice(text));
            }
        };
        thread::Builder::new().name("saving sessions".to_owned()).spawn(save)?;
        thread::Builder::new().name("recording".to_owned()).spawn(record)?;
        Ok(Saver { to, ended })
    }

    /// Saves a session.
    ///
    /// # Errors
    /// Too many others wait.
    pub fn save(&self, save: Save) -> Result<(), String> {
        self.to
            .try_send(save)
            .map_err(|_| "not saved, because others are being saved: try again in a moment".to_owned())
    }

    /// Waits for a moment until all sessions are written; recordings are given up.
    pub fn finish(self) {
        drop(self.to);
        let _ = self.ended.recv_timeout(PATIENCE);
    }
}

impl Saved {
    fn record(&self, is_late: &impl Fn() -> bool) -> anyhow::Result<()> {
        let step_aside = || {
            if is_late() {
                thread::sleep(STEP_ASIDE)
            }
        };
        match &self.minute {
            Some(minute) => minute.record(&self.recording),
            None => {
                let session = SavedSession::load(&self.session)?;
                replay::play(session, Some(&self.recording), |_, _| step_aside()).map(drop)
            }
        }
    }
}

/// Has the recording of a saved session written; returns the notice.
fn hand_on(saved: Saved, to: &SyncSender<Saved>) -> String {
    let (session, recording) = (saved.session.display().to_string(), saved.recording.clone());
    if to.try_send(saved).is_ok() {
        return format!("saved the session as {session}; its recording is being written");
    }
    // It is empty, and was only to reserve the name.
    let _ = fs::remove_file(recording);
    format!(
        "saved the session as {session}, without a recording, because others wait: `--replay` with `--record` writes it"
    )
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
    use supple::scenario::session::Writer;

    use super::*;

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
        let [one, other] =
            thread::scope(|scope| [scope.spawn(save), scope.spawn(save)].map(|saved| saved.join().unwrap()));
        let sessions: std::collections::BTreeSet<_> =
            one.into_iter().chain(other).map(|(session, _)| session).collect();
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
