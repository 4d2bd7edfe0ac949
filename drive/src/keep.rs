//! What is kept of a drive: its session, written at once, and its recording, written in the background.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::SyncSender;
use std::thread;
use std::time::Duration;

use supple::scenario::session::{RobotStep, SavedSession};
use supple_record::Sink;

use crate::live::Message;
use crate::replay;
use crate::show::Cast;

/// How long a recording waits after a step while robots that are driven are late.
const STEP_ASIDE: Duration = Duration::from_millis(30);

/// Frames of the last minute.
#[derive(Debug, Clone)]
pub struct Minute {
    cast: Arc<Cast>,
    /// Each with the tick at which it began.
    steps: VecDeque<(u64, RobotStep)>,
}

impl Minute {
    /// Of these robots, with nothing in it yet.
    pub fn of(cast: &Arc<Cast>) -> Self {
        Minute { cast: Arc::clone(cast), steps: VecDeque::new() }
    }

    /// Whether it is of these robots.
    pub fn is_of(&self, cast: &Arc<Cast>) -> bool {
        Arc::ptr_eq(&self.cast, cast)
    }

    /// Adds steps that began at a tick.
    pub fn add(&mut self, tick: u64, steps: Vec<RobotStep>) {
        self.steps.extend(steps.into_iter().map(|played| (tick, played)));
    }

    /// Forgets what was before a tick.
    pub fn forget(&mut self, before: u64) {
        while self.steps.front().is_some_and(|(tick, _)| *tick < before) {
            self.steps.pop_front();
        }
    }

    /// Writes it as a recording.
    ///
    /// # Errors
    /// As of a full disk.
    pub fn record(&self, path: &Path) -> anyhow::Result<()> {
        let mut recorder = self.cast.record(Sink::File(path.to_owned()))?;
        self.steps.iter().try_for_each(|(_, played)| replay::record(&mut recorder, played))?;
        Ok(recorder.finish()?)
    }
}

/// The names of a session and its recording that are free in a folder.
pub fn names(folder: &Path) -> (PathBuf, PathBuf) {
    let name = |number: u32, extension: &str| folder.join(format!("drive-{number}.{extension}"));
    let pairs = (1..).map(|number| (name(number, "jsonl"), name(number, "rrd")));
    pairs.into_iter().find(|(session, recording)| !session.exists() && !recording.exists()).unwrap_or_default()
}

/// Writes the recording of a session that was kept, stepping aside while something more urgent is late.
///
/// # Errors
/// As of a full disk.
pub fn all(session: &Path, recording: &Path, is_late: impl Fn() -> bool) -> anyhow::Result<()> {
    let step_aside = || {
        if is_late() {
            thread::sleep(STEP_ASIDE)
        }
    };
    replay::play(SavedSession::load(session)?, Some(recording), |_, _| step_aside()).map(drop)
}

/// Does something on a thread of its own, and tells how it went.
///
/// # Errors
/// There is no room for a thread.
pub fn in_background(
    write: impl FnOnce() -> anyhow::Result<()> + Send + 'static,
    to: SyncSender<Message>,
) -> std::io::Result<()> {
    let work = move || {
        let text = match write() {
            Ok(()) => "the recording is written".to_owned(),
            Err(error) => format!("the recording is not written: {error:#}"),
        };
        // Nobody is left to tell if the program is ending.
        let _ = to.send(Message::Notice(text));
    };
    thread::Builder::new().name("writing a recording".to_owned()).spawn(work).map(drop)
}
