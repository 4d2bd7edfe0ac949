//! Replays a saved session: same inputs, same code, same bits.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender};

use supple::scenario::session::{Act, Input, RobotStep, SavedSession, SessionReplay};
use supple::util::files::FileError;
use supple::util::terminal;
use supple_record::{RecordError, Recorder, Sink, check_name};

use crate::driver::Heard;
use crate::message::Message;
use crate::publisher::{Due, Publisher};
use crate::request::Request;
use crate::server::start_thread;
use crate::viewer_stream::Cast;

/// The result of a replay.
pub struct Replayed {
    /// Number of policy steps, summed over the robots.
    pub steps: usize,
    /// Shown simulated time \[s\].
    pub shown_s: f64,
    /// Falls of each robot since the last set-up.
    pub falls: Vec<u32>,
    /// The comparison of the final state with the saved one, bit for bit; `None` if the session was cut off.
    pub verified: Option<Result<(), String>>,
    /// Recordings written, one per set-up.
    pub recordings: Vec<PathBuf>,
}

/// Replays a session as fast as possible, optionally writes recordings, and calls `after_step`. The first recording
/// may replace a file, those of further set-ups are numbered and new.
///
/// # Errors
/// A policy or robot is missing or has changed, or a recording cannot be written, is no `.rrd` file or would replace a file that
/// was not named.
pub fn play(session: SavedSession, recording: Option<&Path>, mut after_step: impl FnMut()) -> anyhow::Result<Replayed> {
    if let Some(path) = recording {
        check_name(path)?;
        let set_ups = session.inputs().iter().filter(|(_, input)| matches!(input, Input::Setup(_))).count();
        if let Some(taken) = (1..set_ups).map(|count| numbered(path, count)).find(|path| path.exists()) {
            let problem = "exists already and would be replaced by the recording of another set-up";
            anyhow::bail!("{} {problem}: remove it, or choose another name", taken.display());
        }
    }
    let mut playback = session.play()?;
    let mut recorder: Option<Recorder> = None;
    let mut replayed = Replayed { steps: 0, shown_s: 0.0, falls: Vec::new(), verified: None, recordings: Vec::new() };
    let (mut first, mut last) = (None, 0);
    while let Some(step) = playback.step()? {
        if step.inputs.iter().any(|input| matches!(input, Input::Setup(_))) {
            recorder.take().map_or(Ok(()), Recorder::finish)?;
        }
        replayed.steps += step.played.len();
        if playback.is_shown(step.tick) {
            first = first.or(Some(step.tick));
            last = step.tick;
            if let (None, Some(path)) = (&recorder, recording) {
                let path = numbered(path, replayed.recordings.len());
                if !replayed.recordings.is_empty() {
                    File::create_new(&path).map_err(FileError::of("cannot create the recording", &path))?;
                }
                recorder = Some(Cast::new(&playback.world).record(Sink::File(path.clone()), false)?);
                replayed.recordings.push(path);
            }
            if let Some(recorder) = &mut recorder {
                step.played.iter().try_for_each(|played| record(recorder, played))?;
            }
        }
        after_step();
    }
    recorder.map_or(Ok(()), Recorder::finish)?;
    replayed.falls = playback.world.falls().collect();
    replayed.verified = playback.verify();
    replayed.shown_s = first.map_or(0.0, |first| (last - first) as f64 / supple::scenario::session::RATE_HZ as f64);
    Ok(replayed)
}

/// Records a step.
pub(crate) fn record(recorder: &mut Recorder, played: &RobotStep) -> Result<(), RecordError> {
    let Some(frame) = &played.frame else { return Ok(()) };
    if played.is_beginning {
        recorder.begin_again(played.robot)?;
    }
    recorder.step(played.robot, Some(frame), &played.events)
}

/// Replays a session in real time on pages and viewers, and pauses at its end. The driving page can pause, slow down and start
/// over, for which the session is read again on a thread of its own, which sends it `to_self`.
///
/// # Errors
/// MuJoCo fails even after a reset.
pub fn watch(
    path: &Path,
    mut playback: SessionReplay,
    mut publisher: Publisher,
    to_self: &SyncSender<Message>,
    messages: &Receiver<Message>,
) -> anyhow::Result<()> {
    let mut is_loading = false;
    loop {
        let message = match publisher.wait(&playback.world, messages) {
            Some(Due::Message(message)) => message,
            Some(Due::Step) => {
                show(&mut playback, &mut publisher)?;
                continue;
            }
            None => continue,
        };
        let tick = playback.world.tick();
        match publisher.driver.take(message) {
            Heard::Other(Message::Stop) => return Ok(()),
            Heard::Request(Request::Pause(is_paused)) => publisher.clock.pause(is_paused, tick),
            Heard::Request(Request::Speed(speed)) => publisher.clock.set_speed(speed, tick),
            Heard::Request(Request::Act(Act::Reset)) if !is_loading => match rewind(path, to_self.clone()) {
                Ok(()) => is_loading = true,
                Err(error) => publisher.notice(format!("cannot start over: {error:#}")),
            },
            Heard::Other(Message::Rewound(result)) => {
                is_loading = false;
                match result {
                    Ok(rewound) => {
                        playback = *rewound;
                        publisher.begin(&playback.world);
                        publisher.clock.pause(false, playback.world.tick());
                    }
                    Err(problem) => {
                        terminal::note(format_args!("cannot start over: {problem}"));
                        publisher.notice("cannot start over: the terminal shows the reason".to_owned());
                    }
                }
            }
            Heard::Other(Message::Notice(text)) => publisher.notice(text),
            Heard::Request(_) | Heard::Released | Heard::Nothing | Heard::Other(_) => {}
        }
        publisher.publish(&playback.world);
    }
}

/// Loads a session again on a thread of its own, which sends it as a [`Message::Rewound`].
fn rewind(path: &Path, to_self: SyncSender<Message>) -> anyhow::Result<()> {
    let path = path.to_owned();
    start_thread("loading", move || {
        let rewound = begin(&path).map(Box::new).map_err(|error| format!("{error:#}"));
        // The receiver is gone if the program is ending.
        let _ = to_self.send(Message::Rewound(rewound));
    })
}

/// Loads a session and plays it silently up to its first shown step.
///
/// # Errors
/// The file is not a session, or a policy or robot is missing or has changed.
pub fn begin(path: &Path) -> anyhow::Result<SessionReplay> {
    let mut playback = SavedSession::load(path)?.play()?;
    while !playback.is_shown(playback.world.tick()) && playback.step()?.is_some() {}
    Ok(playback)
}

/// Plays and publishes a step; at the end, shows whether the final state matches.
fn show(playback: &mut SessionReplay, publisher: &mut Publisher) -> anyhow::Result<()> {
    let Some(step) = playback.step()? else {
        publisher.clock.pause(true, playback.world.tick());
        publisher.notice(match playback.verify() {
            Some(Ok(())) => "end of the session: matches the original bit for bit".to_owned(),
            Some(Err(difference)) => format!("end of the session: {difference}"),
            None => "end of the session: the file was cut off here".to_owned(),
        });
        publisher.publish(&playback.world);
        return Ok(());
    };
    step.inputs.iter().for_each(|input| publisher.note_input(&playback.world, input));
    publisher.note_steps(&playback.world, step.tick, &step.played);
    Ok(())
}

/// Returns the path itself for the first recording, and the path with a number for later ones.
pub(crate) fn numbered(path: &Path, count: usize) -> PathBuf {
    if count == 0 {
        return path.to_owned();
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}-{}.rrd", count + 1))
}
