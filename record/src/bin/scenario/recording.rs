//! The recording of a scenario, and clips of falls.

use std::path::Path;

use anyhow::Context;
use supple::mujoco::Model;
use supple::policy::Agent;
use supple::scenario::catalog::Scenario;
use supple::scenario::trace::Trace;
use supple::scenario::{PlaybackStep, Script, Sensing};
use supple::util::terminal;
use supple_record::{BLUE, ORANGE, RecordError, Recorder, RobotView, Sink, page_url};

use crate::args::Args;

/// Length of a clip before the fall \[s\].
const CLIP_S: f64 = 2.0;

/// A recording in progress, or none.
pub struct Recording {
    recorder: Option<Recorder>,
    sink: Option<Sink>,
}

impl Recording {
    /// Opens the recording that the command line selects.
    pub fn start(
        args: &Args,
        scenario: &Scenario,
        robots: &[(String, Agent)],
        scripts: &[Script],
    ) -> anyhow::Result<Self> {
        let sink = match (&args.record, &args.connect, args.serve) {
            (Some(path), _, _) => Sink::File(path.clone()),
            (None, Some(url), _) => Sink::Connect(url.clone()),
            (None, None, Some(port)) => Sink::Serve(port),
            (None, None, None) if args.no_record => return Ok(Self::none()),
            (None, None, None) => Sink::File(format!("{}.rrd", scenario.name()).into()),
        };
        let recorder = open(sink.clone(), scenario.name(), args.sensing, robots, scripts)?;
        if let Sink::Serve(port) = sink {
            terminal::note(format_args!("watch it at {}", page_url(port)));
        }
        Ok(Recording { recorder: Some(recorder), sink: Some(sink) })
    }

    /// Creates a recording that records nothing.
    pub fn none() -> Self {
        Recording { recorder: None, sink: None }
    }

    /// Adds a step of a robot.
    pub fn add(&mut self, robot: usize, played: &PlaybackStep) -> anyhow::Result<()> {
        let Some(recorder) = &mut self.recorder else {
            return Ok(());
        };
        let mut log = || {
            if let Some(frame) = &played.frame {
                recorder.frame(robot, frame)?;
            }
            played.events.iter().try_for_each(|event| recorder.event(robot, event))
        };
        let logged = log();
        self.unless_the_viewer_is_gone(logged)
    }

    /// Handles an error: if a viewer disconnects, the playback continues; if a file cannot be written, the error is
    /// returned.
    fn unless_the_viewer_is_gone(&mut self, logged: Result<(), RecordError>) -> anyhow::Result<()> {
        match logged {
            Err(error) if matches!(self.sink, Some(Sink::Connect(_))) => {
                terminal::note(format_args!("warning: {error}; going on without a viewer"));
                self.recorder = None;
                Ok(())
            }
            logged => Ok(logged?),
        }
    }

    /// Writes the clips of falls and closes the recording; a served recording is closed at Ctrl-C.
    pub fn finish(
        mut self,
        args: &Args,
        scenario: &Scenario,
        robots: &[(String, Agent)],
        scripts: &[Script],
        traces: &[Trace],
    ) -> anyhow::Result<()> {
        for ((robot, script), trace) in robots.iter().zip(scripts).zip(traces) {
            if let (Some(folder), Some(fall)) = (&args.on_fall, trace.fall()) {
                let path = folder.join(format!("{}-{}-seed{}-fall.rrd", scenario.name(), robot.0, args.seed));
                clip(&path, scenario.name(), robot, script, trace, fall.time_s)?;
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

fn wait_for_interrupt() -> anyhow::Result<()> {
    let (interrupted, wait) = std::sync::mpsc::channel();
    ctrlc::set_handler(move || {
        // An error means that the program is ending anyway.
        let _ = interrupted.send(());
    })
    .context("cannot catch Ctrl-C")?;
    terminal::note("serving until Ctrl-C");
    Ok(wait.recv()?)
}

fn open(
    sink: Sink,
    title: &str,
    sensing: Sensing,
    robots: &[(String, Agent)],
    scripts: &[Script],
) -> anyhow::Result<Recorder> {
    let models = models(scripts)?;
    let views = views(sensing, robots, scripts, &models);
    Ok(Recorder::new(sink, title, &views)?)
}

/// Compiles the model of each robot for display.
pub fn models(scripts: &[Script]) -> supple::mujoco::Result<Vec<Model>> {
    scripts.iter().map(|script| script.scene.compile_visual()).collect()
}

/// Returns how each robot is drawn: in blue and orange if there are two.
pub fn views<'a>(
    sensing: Sensing,
    robots: &'a [(String, Agent)],
    scripts: &'a [Script],
    models: &'a [Model],
) -> Vec<RobotView<'a>> {
    let tints = if robots.len() > 1 { vec![Some(BLUE), Some(ORANGE)] } else { vec![None] };
    robots
        .iter()
        .zip(scripts)
        .zip(models)
        .zip(tints)
        .map(|((((name, _), script), model), tint)| RobotView {
            name,
            model,
            ground: &script.scene.ground,
            tint,
            estimates: sensing == Sensing::Estimated,
        })
        .collect()
}

fn clip(
    path: &Path,
    title: &str,
    robot: &(String, Agent),
    script: &Script,
    trace: &Trace,
    fall_s: f64,
) -> anyhow::Result<()> {
    let model = script.scene.compile_visual()?;
    let view = RobotView {
        name: &robot.0,
        model: &model,
        ground: &script.scene.ground,
        tint: None,
        estimates: trace.frames.iter().any(|frame| frame.sensed.is_some()),
    };
    let mut recorder = Recorder::new(Sink::File(path.to_owned()), title, &[view])?;
    recorder.trace(0, &trace.after(fall_s - CLIP_S))?;
    Ok(recorder.finish()?)
}
