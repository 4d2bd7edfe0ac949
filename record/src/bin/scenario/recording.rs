//! The recording of a scenario, and clips of falls.

use anyhow::{Context, Result};
use supple::scenario::PlaybackStep;
use supple::scenario::trace::Trace;
use supple::util::terminal;
use supple_record::{RecordError, Recorder, Sink, page_url, record};

use crate::Trial;

/// Length of a clip before the fall \[s\].
const CLIP_S: f64 = 2.0;

/// A recording in progress, or none.
pub struct Recording {
    recorder: Option<Recorder>,
    sink: Option<Sink>,
}

impl Recording {
    /// Opens the recording that the command line selects.
    pub fn start(trial: &Trial<'_>) -> Result<Self> {
        let (args, title) = (trial.args, trial.scenario.name());
        let sink = match (&args.record, &args.connect, args.serve) {
            (Some(path), _, _) => Sink::File(path.clone()),
            (None, Some(url), _) => Sink::Connect(url.clone()),
            (None, None, Some(port)) => Sink::Serve(port),
            (None, None, None) if args.no_record => return Ok(Self::none()),
            (None, None, None) => Sink::File(format!("{title}.rrd").into()),
        };
        let models = trial.models()?;
        let recorder = Recorder::new(sink.clone(), title, &trial.views(&models))?;
        if let Sink::Serve(port) = sink {
            terminal::note(format_args!("watch it at {}", page_url(port)));
        }
        Ok(Recording { recorder: Some(recorder), sink: Some(sink) })
    }

    /// Creates a recording that stores nothing.
    pub fn none() -> Self {
        Recording { recorder: None, sink: None }
    }

    pub fn add(&mut self, robot: usize, played: &PlaybackStep) -> Result<()> {
        let Some(recorder) = &mut self.recorder else { return Ok(()) };
        let logged = recorder.step(robot, played.frame.as_ref(), &played.events);
        self.unless_the_viewer_is_gone(logged)
    }

    /// Handles an error: if a viewer disconnects, the playback continues; if a file cannot be written, the error is
    /// returned.
    fn unless_the_viewer_is_gone(&mut self, logged: Result<(), RecordError>) -> Result<()> {
        match logged {
            Err(error) if matches!(self.sink, Some(Sink::Connect(_))) => {
                terminal::note(format_args!("warning: {error}; continuing without a viewer"));
                self.recorder = None;
                Ok(())
            }
            logged => Ok(logged?),
        }
    }

    /// Writes the clips of falls and closes the recording; a served recording is closed at Ctrl-C.
    pub fn finish(mut self, trial: &Trial<'_>, traces: &[Trace]) -> Result<()> {
        let title = trial.scenario.name();
        for (((name, _), script), trace) in trial.parts().zip(traces) {
            if let (Some(folder), Some(fall)) = (&trial.args.on_fall, trace.fall()) {
                let path = folder.join(format!("{title}-{name}-seed{}-fall.rrd", trial.seed));
                record(&path, title, name, &script.scene, &trace.after(fall.time_s - CLIP_S))?;
                terminal::note(format_args!("the fall is in {}", path.display()));
            }
        }
        if let Some(Sink::Serve(_)) = self.sink {
            wait_for_interrupt()?;
        }
        if let Some(recorder) = self.recorder.take() {
            let finished = recorder.finish();
            self.unless_the_viewer_is_gone(finished)?;
        }
        if let Some(Sink::File(path)) = self.sink {
            let (path, word) = (path.display(), terminal::shell_word(&path));
            terminal::note(format_args!("recorded {path}; open it with: rerun {word}"));
        }
        Ok(())
    }
}

fn wait_for_interrupt() -> Result<()> {
    let (interrupted, wait) = std::sync::mpsc::channel();
    ctrlc::set_handler(move || {
        // An error means that the program is ending anyway.
        let _ = interrupted.send(());
    })
    .context("cannot catch Ctrl-C")?;
    terminal::note("serving until Ctrl-C");
    Ok(wait.recv()?)
}
