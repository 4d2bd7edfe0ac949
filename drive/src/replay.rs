//! Plays a session again: the same inputs, the same code, the same bits.

use std::path::{Path, PathBuf};
use std::sync::mpsc::Receiver;

use supple::scenario::session::{Input, ReplayStep, RobotStep, SavedSession, SessionReplay};
use supple_record::{RecordError, Recorder, Sink};

use crate::display::{Display, Due};
use crate::live::Message;
use crate::request::Request;
use crate::show::Cast;

/// How a session went when it was played again.
#[derive(Debug)]
pub struct Replayed {
    /// Policy steps of all robots.
    pub steps: usize,
    /// Simulated time, as far as it is shown \[s\].
    pub shown_s: f64,
    /// How often each robot has fallen since the last set-up.
    pub falls: Vec<u32>,
    /// Whether the world ended as it had, to the last bit; none if the session was cut off.
    pub is_as_it_was: Option<bool>,
    /// Recordings that were written: one for each set-up.
    pub recordings: Vec<PathBuf>,
}

/// Plays a session, writes recordings if asked to, and shows each step to `look`.
///
/// # Errors
/// A policy or robot that is gone or has changed, a full disk.
pub fn play(
    session: SavedSession,
    recording: Option<&Path>,
    mut look: impl FnMut(&SessionReplay, &ReplayStep),
) -> anyhow::Result<Replayed> {
    let mut playback = session.play()?;
    let mut recorder: Option<Recorder> = None;
    let mut replayed =
        Replayed { steps: 0, shown_s: 0.0, falls: Vec::new(), is_as_it_was: None, recordings: Vec::new() };
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
                recorder = Some(Cast::of(&playback.world).record(Sink::File(path.clone()))?);
                replayed.recordings.push(path);
            }
            if let Some(recorder) = &mut recorder {
                step.played.iter().try_for_each(|played| record(recorder, played))?;
            }
        }
        look(&playback, &step);
    }
    recorder.map_or(Ok(()), Recorder::finish)?;
    replayed.falls = playback.world.falls().collect();
    replayed.is_as_it_was = playback.is_as_it_was();
    replayed.shown_s = first.map_or(0.0, |first| (last - first) as f64 / supple::scenario::session::RATE_HZ as f64);
    Ok(replayed)
}

/// Records a step.
///
/// # Errors
/// [`RecordError`], as of a full disk.
pub fn record(recorder: &mut Recorder, played: &RobotStep) -> Result<(), RecordError> {
    let Some(frame) = &played.frame else { return Ok(()) };
    if played.is_beginning {
        recorder.begin_again(played.robot)?;
    }
    recorder.frame(played.robot, frame)?;
    played.events.iter().try_for_each(|event| recorder.event(played.robot, event))
}

/// Plays a session again in real time, for pages and viewers; at its end, time stands still. Whoever drives can stop time, slow
/// it down, and start over.
///
/// # Errors
/// A policy or robot that is gone or has changed.
pub fn watch(
    path: &Path,
    mut playback: SessionReplay,
    mut display: Display,
    messages: &Receiver<Message>,
) -> anyhow::Result<()> {
    loop {
        let message = match display.wait(&playback.world, messages) {
            Some(Due::Message(message)) => message,
            Some(Due::Step) => {
                show(&mut playback, &mut display)?;
                continue;
            }
            None => continue,
        };
        let tick = playback.world.tick();
        match message {
            Message::Stop => return Ok(()),
            Message::Came(page) => display.driver = display.driver.or(Some(page)),
            Message::Went(page) => display.driver = display.driver.filter(|driver| *driver != page),
            Message::Asked(page, Request::Drive) => display.driver = Some(page),
            Message::Asked(page, request) if display.driver == Some(page) => match request {
                Request::Pause(is_paused) => display.clock.pause(is_paused, tick),
                Request::Speed(speed) => display.clock.set_speed(speed, tick),
                Request::Reset => {
                    playback = begin(path)?;
                    display.begin(&playback.world);
                    display.clock.pause(false, playback.world.tick());
                }
                _ => {}
            },
            Message::Notice(text) => display.notice(text),
            Message::Asked(..) | Message::Read { .. } => {}
        }
        display.tell(&playback.world);
    }
}

/// A session at the place from which it is shown.
///
/// # Errors
/// It is no session, or a policy or robot is gone or has changed.
pub fn begin(path: &Path) -> anyhow::Result<SessionReplay> {
    let mut playback = SavedSession::load(path)?.play()?;
    while !playback.is_shown(playback.world.tick()) && playback.step()?.is_some() {}
    Ok(playback)
}

/// Plays a step and shows it; at the end, says whether it is the end that it was.
fn show(playback: &mut SessionReplay, display: &mut Display) -> anyhow::Result<()> {
    let Some(step) = playback.step()? else {
        display.clock.pause(true, playback.world.tick());
        display.notice(match playback.is_as_it_was() {
            Some(true) => "the end, as it was, to the last bit".to_owned(),
            Some(false) => "the end, but not as it was: this program, or this machine, computes otherwise".to_owned(),
            None => "the session was cut off here".to_owned(),
        });
        display.tell(&playback.world);
        return Ok(());
    };
    step.inputs.iter().for_each(|input| display.note_input(&playback.world, input));
    display.note_steps(&playback.world, step.tick, &step.played);
    Ok(())
}

/// The path itself for the first recording, with a number for those after it.
fn numbered(path: &Path, count: usize) -> PathBuf {
    if count == 0 {
        return path.to_owned();
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}-{}.rrd", count + 1))
}
