//! `scenario`: play a disturbance with one policy or two, and record it.

mod args;
mod output;
mod recording;
mod session;

use std::path::Path;
use std::process::ExitCode;

use anyhow::Context;
use args::{Args, What};
use clap::CommandFactory;
use output::Outcome;
use supple::estimate::contact::ContactNetwork;
use supple::policy::Agent;
use supple::policy::shipped;
use supple::robot::Robot;
use supple::scenario::catalog::Scenario;
use supple::scenario::estimation::Estimation;
use supple::scenario::metrics::Metric;
use supple::scenario::trace::Trace;
use supple::scenario::{Rollout, Script, Sensing};
use supple::util::terminal;

fn main() -> ExitCode {
    terminal::conclude(args::parse().and_then(|args| run(&args)))
}

fn run(args: &Args) -> anyhow::Result<()> {
    match &args.what {
        What::List => list(),
        What::Session { file } => session::measure(args, file),
        What::Play(scenario) => play_scenario(args, scenario),
    }
}

fn list() -> anyhow::Result<()> {
    let is_scenario = |command: &&clap::Command| !matches!(command.get_name(), "list" | "session");
    for scenario in Args::command().get_subcommands().filter(is_scenario) {
        let about = scenario.get_about().map(ToString::to_string).unwrap_or_default();
        terminal::print(format_args!("{:10} {about}\n", scenario.get_name()))?;
    }
    Ok(())
}

fn play_scenario(args: &Args, scenario: &Scenario) -> anyhow::Result<()> {
    let mut robots = robots(args)?;
    if let Some(model) = &args.model {
        terminal::note(format_args!("{model}:"));
        let robot = Robot::load(model)?;
        robot.report.iter().for_each(|line| terminal::note(format_args!("  {line}")));
        robots.iter_mut().for_each(|(_, agent)| agent.run_on(&robot));
    }
    for (name, agent) in &robots {
        let compliance = scenario.task().compliance;
        agent.check_compliance(compliance).with_context(|| format!("--compliance {compliance} with {name}"))?;
    }
    let scripts: Vec<Script> = robots
        .iter()
        .map(|(_, agent)| Ok(scenario.script(args.seed, &agent.config)?))
        .collect::<anyhow::Result<_>>()
        .map_err(|error| match &args.params {
            Some(file) => error.context(format!("with the parameters of {}", file.display())),
            None => error,
        })?;
    if let Some(late) = scripts.first().and_then(Script::too_late) {
        terminal::note(format_args!("note: {late}"));
    }
    if args.sensing == Sensing::Estimated {
        let policies = robots.iter().map(|(name, agent)| (name.clone(), agent.sha256.as_str()));
        let unfamiliar = ContactNetwork::shipped()?.unfamiliar(policies);
        unfamiliar.iter().for_each(|what| terminal::note(format_args!("note: {what}")));
    }
    let mut recording = recording::Recording::start(args, scenario, &robots, &scripts)?;
    let traces = play(args, &robots, &scripts, &mut recording)?;
    let played = robots.iter().zip(&scripts).zip(&traces);
    let outcomes: Vec<Outcome<'_>> = played
        .map(|(((name, agent), script), trace)| Outcome {
            policy: name,
            sha256: agent.sha256.clone(),
            robot: &agent.config.robot.model,
            metrics: metrics(args.sensing, scenario, script, trace),
            trace,
        })
        .collect();

    if let Some(path) = &args.csv {
        output::write_csv(path, &outcomes).with_context(|| format!("cannot write {}", path.display()))?;
    }
    if args.json {
        terminal::print(format_args!("{}\n", output::to_json(scenario, args.seed, args.sensing, &outcomes)))?;
    } else {
        terminal::print(output::summary(scenario.name(), &outcomes))?;
    }
    recording.finish(args, scenario, &robots, &scripts, &traces)?;
    let failed = outcomes.iter().find_map(|outcome| Some((outcome.policy, outcome.trace.fault()?)));
    if let Some((policy, fault)) = failed {
        anyhow::bail!("{policy}: the simulation failed after {:.2} s: {}", fault.time_s, fault.text);
    }
    Ok(())
}

/// The scenario's numbers, and those of the estimates if there are any.
fn metrics(sensing: Sensing, scenario: &Scenario, script: &Script, trace: &Trace) -> Vec<Metric> {
    let mut found = scenario.metrics(script, trace);
    if sensing == Sensing::Estimated {
        found.extend(Estimation::metrics(trace));
    }
    found
}

/// The policies to play, by name.
fn robots(args: &Args) -> anyhow::Result<Vec<(String, Agent)>> {
    let label = |name: &str| {
        let path = Path::new(name);
        path.file_stem().map_or(name.to_owned(), |stem| stem.to_string_lossy().into_owned())
    };
    let first = args.policy.as_deref().unwrap_or("compliant");
    let ships_both = || ["compliant", "baseline"].iter().all(|name| shipped::find(name).is_ok());
    let second = match args.compare.as_deref() {
        Some("none") => None,
        Some(name) => Some(name),
        None => (args.policy.is_none() && ships_both()).then_some("baseline"),
    };
    let mut robots = vec![(label(first), shipped::find(first)?)];
    if let Some(second) = second {
        let name = if label(second) == robots[0].0 { format!("{} (2)", label(second)) } else { label(second) };
        robots.push((name, shipped::find(second)?));
    }
    Ok(robots)
}

/// Plays all robots step by step beside one another, recording as they go.
fn play(
    args: &Args,
    robots: &[(String, Agent)],
    scripts: &[Script],
    recording: &mut recording::Recording,
) -> anyhow::Result<Vec<Trace>> {
    let mut rollouts = Vec::new();
    for ((_, agent), script) in robots.iter().zip(scripts) {
        let rollout = Rollout::new(script, &agent.config, agent.controller())?.with_bodies();
        rollouts.push(rollout.with_sensing(args.sensing, args.seed)?);
    }
    let mut traces: Vec<Trace> = rollouts.iter().map(Rollout::empty_trace).collect();
    let steps = rollouts.iter().map(Rollout::steps).max().unwrap_or(0) as u64;
    let bar = terminal::progress_bar(steps, "{bar:30} {percent} %, {eta} left");
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
