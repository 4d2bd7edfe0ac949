//! `scenario`: play a disturbance with one policy or two, and record it.

mod args;
mod output;
#[cfg(feature = "record")]
mod recording;
#[cfg(not(feature = "record"))]
#[path = "no_recording.rs"]
mod recording;

use std::process::ExitCode;

use anyhow::Context;
use args::{Args, What};
use clap::CommandFactory;
use indicatif::{ProgressBar, ProgressStyle};
use output::Outcome;
use supple::policies;
use supple::policy::Policy;
use supple::scenario::{Rollout, Script};
use supple::terminal;
use supple::trace::Trace;

fn main() -> ExitCode {
    match args::parse().and_then(|args| run(&args)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            terminal::note(format_args!("error: {}", terminal::complaint(error.as_ref())));
            ExitCode::from(2)
        }
    }
}

fn run(args: &Args) -> anyhow::Result<()> {
    let What::Play(scenario) = &args.what else {
        for scenario in Args::command().get_subcommands().filter(|command| command.get_name() != "list") {
            let about = scenario.get_about().map(ToString::to_string).unwrap_or_default();
            terminal::print(format_args!("{:10} {about}\n", scenario.get_name()))?;
        }
        return Ok(());
    };
    let robots = robots(args)?;
    let scripts: Vec<Script> = robots
        .iter()
        .map(|(_, policy)| Ok(scenario.script(args.seed, &policy.provenance.config)?))
        .collect::<anyhow::Result<_>>()?;
    let mut recording = recording::Recording::start(args, scenario, &robots, &scripts)?;
    let traces = play(&robots, &scripts, &mut recording)?;
    let played = robots.iter().zip(&scripts).zip(&traces);
    let outcomes: Vec<Outcome<'_>> = played
        .map(|(((name, policy), script), trace)| Outcome {
            policy: name,
            sha256: policy.sha256(),
            metrics: scenario.metrics(script, trace),
            trace,
        })
        .collect();

    if let Some(path) = &args.csv {
        output::write_csv(path, &outcomes).with_context(|| format!("cannot write {}", path.display()))?;
    }
    if args.json {
        terminal::print(format_args!("{}\n", output::to_json(scenario, args.seed, &outcomes)))?;
    } else {
        terminal::print(output::summary(scenario, &outcomes))?;
    }
    recording.finish(args, scenario, &robots, &scripts, &traces)
}

/// The policies to play, by name.
fn robots(args: &Args) -> anyhow::Result<Vec<(String, Policy)>> {
    let label = |name: &str| {
        let path = std::path::Path::new(name);
        path.file_stem().map_or(name.to_owned(), |stem| stem.to_string_lossy().into_owned())
    };
    let first = args.policy.as_deref().unwrap_or("compliant");
    let ships_both = || ["compliant", "baseline"].iter().all(|name| policies::find(name).is_ok());
    let second = match args.compare.as_deref() {
        Some("none") => None,
        Some(name) => Some(name),
        None => (args.policy.is_none() && ships_both()).then_some("baseline"),
    };
    let mut robots = vec![(label(first), policies::find(first)?)];
    if let Some(second) = second {
        let name = if label(second) == robots[0].0 { format!("{} (2)", label(second)) } else { label(second) };
        robots.push((name, policies::find(second)?));
    }
    Ok(robots)
}

/// Plays all robots step by step beside one another, recording as they go.
fn play(
    robots: &[(String, Policy)],
    scripts: &[Script],
    recording: &mut recording::Recording,
) -> anyhow::Result<Vec<Trace>> {
    let mut rollouts = Vec::new();
    for ((_, policy), script) in robots.iter().zip(scripts) {
        rollouts.push(Rollout::new(script, &policy.provenance.config, Box::new(policy.controller()), true)?);
    }
    let mut traces: Vec<Trace> = robots
        .iter()
        .map(|(_, policy)| Trace { period_s: policy.simulation.policy_period_s(), ..Trace::default() })
        .collect();
    let bar = progress_bar(rollouts.iter().map(Rollout::steps).max().unwrap_or(0) as u64);
    let mut playing = true;
    while playing {
        playing = false;
        for (index, rollout) in rollouts.iter_mut().enumerate() {
            let Some(played) = rollout.next() else { continue };
            playing = true;
            recording.add(index, &played)?;
            traces[index].events.extend(played.events);
            traces[index].frames.extend(played.frame);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(traces)
}

fn progress_bar(steps: u64) -> ProgressBar {
    let bar = ProgressBar::new(steps);
    if let Ok(style) = ProgressStyle::with_template("{bar:30} {percent} %, {eta} left") {
        bar.set_style(style);
    }
    bar
}
