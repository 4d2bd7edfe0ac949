//! The recording of a scenario, and clips of falls.

use std::path::{Path, PathBuf};

use supple::mujoco::Model;
use supple::policy::Policy;
use supple::record::{BLUE, ORANGE, Recorder, RobotView, Sink};
use supple::scenario::catalog::Scenario;
use supple::scenario::{Played, Script};
use supple::trace::Trace;

use crate::args::Args;

/// Length of a clip before the fall \[s\].
const CLIP_S: f64 = 2.0;

/// A recording under way, or none.
pub struct Recording {
    recorder: Option<Recorder>,
    path: Option<PathBuf>,
}

impl Recording {
    /// Opens what the command line asks for.
    pub fn start(
        args: &Args,
        scenario: &Scenario,
        robots: &[(String, Policy)],
        scripts: &[Script],
    ) -> anyhow::Result<Self> {
        let path = match (&args.record, args.no_record, &args.connect) {
            (Some(path), _, _) => Some(path.clone()),
            (None, false, None) => Some(format!("{}.rrd", scenario.name()).into()),
            _ => None,
        };
        let sink = match (&path, &args.connect) {
            (Some(path), _) => Sink::File(path.clone()),
            (None, Some(url)) => Sink::Connect(url.clone()),
            (None, None) => {
                return Ok(Recording { recorder: None, path: None });
            }
        };
        Ok(Recording { recorder: Some(open(sink, scenario.name(), robots, scripts)?), path })
    }

    /// Adds a step of a robot.
    pub fn add(&mut self, robot: usize, played: &Played) -> anyhow::Result<()> {
        let Some(recorder) = &mut self.recorder else {
            return Ok(());
        };
        if let Some(frame) = &played.frame {
            recorder.frame(robot, frame)?;
        }
        for event in &played.events {
            recorder.event(robot, event)?;
        }
        Ok(())
    }

    /// Closes the recording and writes the clips of falls.
    pub fn finish(
        self,
        args: &Args,
        scenario: &Scenario,
        robots: &[(String, Policy)],
        scripts: &[Script],
        traces: &[Trace],
    ) -> anyhow::Result<()> {
        if let Some(recorder) = self.recorder {
            recorder.finish()?;
        }
        if let Some(path) = self.path {
            eprintln!("recorded {path}; open it with: rerun {path}", path = path.display());
        }
        let Some(folder) = &args.on_fall else { return Ok(()) };
        for ((robot, script), trace) in robots.iter().zip(scripts).zip(traces) {
            if let Some(fall) = trace.fall() {
                let path = folder.join(format!("{}-{}-seed{}-fall.rrd", scenario.name(), robot.0, args.seed));
                clip(&path, scenario.name(), robot, script, trace, fall.time_s)?;
                eprintln!("the fall is in {}", path.display());
            }
        }
        Ok(())
    }
}

fn open(sink: Sink, title: &str, robots: &[(String, Policy)], scripts: &[Script]) -> anyhow::Result<Recorder> {
    let models: Vec<Model> =
        scripts.iter().map(|script| script.scene.compile_visual()).collect::<supple::mujoco::Result<_>>()?;
    let tints = if robots.len() > 1 { vec![Some(BLUE), Some(ORANGE)] } else { vec![None] };
    let views: Vec<RobotView<'_>> = robots
        .iter()
        .zip(scripts)
        .zip(&models)
        .zip(tints)
        .map(|((((name, _), script), model), tint)| RobotView { name, model, ground: &script.scene.ground, tint })
        .collect();
    Ok(Recorder::new(sink, title, &views)?)
}

fn clip(
    path: &Path,
    title: &str,
    robot: &(String, Policy),
    script: &Script,
    trace: &Trace,
    fall_s: f64,
) -> anyhow::Result<()> {
    let model = script.scene.compile_visual()?;
    let view = RobotView { name: &robot.0, model: &model, ground: &script.scene.ground, tint: None };
    let mut recorder = Recorder::new(Sink::File(path.to_owned()), title, &[view])?;
    for frame in trace.frames.iter().filter(|frame| frame.time_s > fall_s - CLIP_S) {
        recorder.frame(0, frame)?;
    }
    for event in trace.events.iter().filter(|event| event.time_s > fall_s - CLIP_S) {
        recorder.event(0, event)?;
    }
    Ok(recorder.finish()?)
}
