//! The video of a scenario.

use supple::scenario::trace::Trace;
use supple::util::progress::progress;
use supple::util::terminal;
use supple_record::Video;

use crate::Trial;
use crate::args::Args;

/// Checks the video that the command line asks for, if any, before anything is played.
pub fn check(args: &Args) -> anyhow::Result<Option<Video>> {
    Ok(args.video.as_deref().map(|path| Video::new(path, args.video_size)).transpose()?)
}

/// Draws the traces and writes the video.
pub fn write(video: &Video, trial: &Trial<'_>, traces: &[Trace]) -> anyhow::Result<()> {
    let models = trial.models()?;
    let played: Vec<_> = trial.views(&models).into_iter().zip(traces).collect();
    let bar = progress(0);
    bar.set_message("drawing the video");
    video.write(trial.scenario.name(), &played, |drawn, count| {
        bar.set_length(count);
        bar.set_position(drawn);
    })?;
    bar.finish_and_clear();
    terminal::note(format_args!("the video is in {}", video.path.display()));
    Ok(())
}
