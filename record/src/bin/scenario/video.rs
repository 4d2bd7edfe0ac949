//! The video of a scenario.

use supple::policy::Agent;
use supple::scenario::Script;
use supple::scenario::catalog::Scenario;
use supple::scenario::trace::Trace;
use supple::util::progress::progress;
use supple::util::terminal;
use supple_record::Video;

use crate::args::Args;
use crate::recording::{models, views};

/// Checks the video that the command line asks for, if any, before anything is played.
pub fn check(args: &Args) -> anyhow::Result<Option<Video>> {
    Ok(args.video.as_deref().map(|path| Video::new(path, args.video_size)).transpose()?)
}

/// Draws the traces and writes the video.
pub fn write(
    video: &Video,
    args: &Args,
    scenario: &Scenario,
    robots: &[(String, Agent)],
    scripts: &[Script],
    traces: &[Trace],
) -> anyhow::Result<()> {
    let models = models(scripts)?;
    let played: Vec<_> = views(args.sensing, robots, scripts, &models).into_iter().zip(traces).collect();
    let bar = progress(0);
    bar.set_message("drawing the video");
    video.write(scenario.name(), &played, |drawn, count| {
        bar.set_length(count);
        bar.set_position(drawn);
    })?;
    bar.finish_and_clear();
    terminal::note(format_args!("the video is in {}", video.path().display()));
    Ok(())
}
