//! Draws the videos of the README (a push while walking) and of docs/compliance.md (a hand that pulls among blocks and mats).
//!
//! `cargo run --release -p supple-record --features video --example opening -- docs/images`

use std::path::PathBuf;

use supple::policy::shipped;
use supple::scenario::Playback;
use supple::scenario::catalog::Scenario;
use supple::scenario::trace::Trace;
use supple::world::{Disturbance, Pull};
use supple_record::{RobotView, Video};

/// Width and height of the videos \[px\].
const SIZE: [usize; 2] = [640, 360];

fn main() -> anyhow::Result<()> {
    let folder = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "docs/images".into()));
    let push = Scenario::named("push", "{at_s: 1.0, duration_s: 3.6}")?;
    film(folder.join("push.webp"), "pushed sideways", (&push, 0, 0.5), ["compliant", "baseline"], None)?;
    let rubble = Scenario::named("rubble", "{duration_s: 4.5}")?;
    let hand = Pull::constant([1.2, 3.5], [0.0, 20.0]);
    // With seed 0, both fall under the same pull.
    film(folder.join("hand.webp"), "pulled among rubble", (&rubble, 4, 0.0), ["baseline@0.03", "baseline"], Some(hand))
}

/// Plays a scenario, with its seed, with two policies, pulled by a hand or not, and writes the video from a time \[s\] on.
fn film(
    path: PathBuf,
    title: &str,
    (scenario, seed, begin_s): (&Scenario, u64, f64),
    policies: [&str; 2],
    hand: Option<Pull>,
) -> anyhow::Result<()> {
    let video = Video::new(&path, SIZE)?;
    let (mut models, mut scripts, mut traces) = (Vec::new(), Vec::new(), Vec::new());
    for policy in policies {
        let agent = shipped::find(policy)?;
        let mut script = scenario.script(seed, &agent.config)?;
        script.command.compliance = agent.resolve_compliance(None, script.command.compliance)?;
        script.disturbances.extend(hand.map(Disturbance::Pull));
        let playback = Playback::new(&script, &agent.config, agent.controller())?.with_felt_forces()?.with_bodies();
        traces.push(from(begin_s, playback.trace()));
        models.push(script.scene.compile_visual()?);
        scripts.push(script);
    }
    let views = RobotView::several([0, 1].map(|index| (policies[index], &models[index], &scripts[index].scene)));
    video.write(title, &views.into_iter().zip(&traces).collect::<Vec<_>>(), |_, _| {})?;
    println!("{}: {} kB", path.display(), std::fs::metadata(&path)?.len() / 1000);
    Ok(())
}

/// Returns a trace from a time on, which becomes its zero.
fn from(begin_s: f64, mut trace: Trace) -> Trace {
    trace.frames.retain(|frame| frame.time_s > begin_s);
    trace.events.retain(|event| event.time_s > begin_s);
    trace.frames.iter_mut().for_each(|frame| frame.time_s -= begin_s);
    trace.events.iter_mut().for_each(|event| event.time_s -= begin_s);
    trace
}
