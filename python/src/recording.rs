//! Recordings for the rerun viewer.

use std::path::Path;

use supple::scenario::Script;
use supple::scenario::trace::Trace;
use supple_record::{RecordError, Recorder, RobotView, Sink};

/// Writes a trace that has its bodies as an `.rrd` file.
pub fn write(path: &Path, title: &str, name: &str, script: &Script, trace: &Trace) -> Result<(), RecordError> {
    let model = script.scene.compile_visual()?;
    let view = RobotView {
        name,
        model: &model,
        ground: &script.scene.ground,
        tint: None,
        estimates: trace.frames.iter().any(|frame| frame.sensed.is_some()),
    };
    let mut recorder = Recorder::new(Sink::File(path.to_owned()), title, &[view])?;
    recorder.trace(0, trace)?;
    recorder.finish()
}
