//! Saves the last minute or the whole session: the session file at once, its recording in the background.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::SyncSender;
use std::thread;
use std::time::Duration;

use supple::scenario::session::{RobotStep, SavedSession};
use supple_record::Sink;

use crate::message::Message;
use crate::replay;
use crate::viewer_stream::Cast;

/// Pause of a recording after each step while the live robots are late.
const STEP_ASIDE: Duration = Duration::from_millis(30);

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
    ///
    /// # Errors
    /// The recording cannot be written, e.g. because the disk is full.
    pub fn record(&self, path: &Path) -> anyhow::Result<()> {
        let mut recorder = self.cast.record(Sink::File(path.to_owned()))?;
        self.steps.iter().try_for_each(|(_, played)| replay::record(&mut recorder, played))?;
        Ok(recorder.finish()?)
    }
}

/// Returns the first free pair of names for a session and its recording in a folder.
pub fn free_names(folder: &Path) -> (PathBuf, PathBuf) {
    let name = |number: u32, extension: &str| folder.join(format!("drive-{number}.{extension}"));
    let pairs = (1..).map(|number| (name(number, "jsonl"), name(number, "rrd")));
    pairs.into_iter().find(|(session, recording)| !session.exists() && !recording.exists()).unwrap_or_default()
}

/// Writes the recording of a saved session, pausing while the live robots are late.
///
/// # Errors
/// The session cannot be replayed, or the recording cannot be written, e.g. because the disk is full.
pub fn write_all(session: &Path, recording: &Path, is_late: impl Fn() -> bool) -> anyhow::Result<()> {
    let step_aside = || {
        if is_late() {
            thread::sleep(STEP_ASIDE)
        }
    };
    replay::play(SavedSession::load(session)?, Some(recording), |_, _| step_aside()).map(drop)
}

/// Writes a recording on a thread of its own and reports the result as a notice.
///
/// # Errors
/// The thread cannot be started.
pub fn in_background(
    write: impl FnOnce() -> anyhow::Result<()> + Send + 'static,
    to: SyncSender<Message>,
) -> std::io::Result<()> {
    let work = move || {
        let text = match write() {
            Ok(()) => "the recording is written".to_owned(),
            Err(error) => format!("the recording could not be written: {error:#}"),
        };
        // The receiver is gone if the program is ending.
        let _ = to.send(Message::Notice(text));
    };
    thread::Builder::new().name("writing a recording".to_owned()).spawn(work).map(drop)
}
