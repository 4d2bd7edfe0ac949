//! The program `scenario`: plays a disturbance with one policy or two, and records it.

mod args;
mod output;
mod recording;
mod seeds;
mod session;

use std::ops::RangeInclusive;
use std::process::ExitCode;

use anyhow::{Context, Result};
use args::{Args, What};
use clap::CommandFactory;
use output::Outcome;
use recording::Recording;
use seeds::OfSeeds;
use supple::estimate::contact::ContactNetwork;
use supple::mujoco::{self, Model};
use supple::policy::Agent;
use supple::policy::compliance::policy_label;
use supple::policy::shipped;
use supple::robot::Robot;
use supple::scenario::catalog::Scenario;
use supple::scenario::estimation::{Estimation, felt_forces};
use supple::scenario::metrics::Metric;
use supple::scenario::trace::Trace;
use supple::scenario::{Playback, Script, Sensing};
use supple::util::progress::{ProgressBar, progress};
use supple::util::terminal;
use supple_record::RobotView;
#[cfg(feature = "video")]
use supple_record::Video;

/// The error of `--video` in a program without the feature of that name.
#[cfg(not(feature = "video"))]
const NO_VIDEO: &str =
    "this program was built without videos; build it with: cargo build --features video --bin scenario";

fn main() -> ExitCode {
    supple::robot::isolate_imports();
    supple::announce_revision!();
    terminal::conclude(args::parse().and_then(|args| run(&args)))
}

fn run(args: &Args) -> Result<()> {
    match &args.what {
        What::List => list(),
        What::Session { file } => session::measure(args, file),
        What::Play(scenario) => play_scenario(args, scenario),
    }
}

fn list() -> Result<()> {
    let is_scenario = |command: &&clap::Command| !matches!(command.get_name(), "list" | "session");
    for scenario in Args::command().get_subcommands().filter(is_scenario) {
        let about = scenario.get_about().map(ToString::to_string).unwrap_or_default();
        terminal::print(format_args!("{:10} {about}\n", scenario.get_name()))?;
    }
    Ok(())
}

fn play_scenario(args: &Args, scenario: &Scenario) -> Result<()> {
    output::check(args)?;
    #[cfg(not(feature = "video"))]
    anyhow::ensure!(args.video.is_none(), NO_VIDEO);
    #[cfg(feature = "video")]
    let video = args.video.as_deref().map(|path| Video::new(path, args.video_size)).transpose()?;
    let mut robots = robots(args)?;
    if let Some(model) = &args.model {
        terminal::note(format_args!("{model}:"));
        let robot = Robot::load(model)?;
        robot.report.iter().for_each(|line| terminal::note(format_args!("  {line}")));
        robots.iter_mut().for_each(|(_, agent)| agent.run_on(&robot));
    }
    if let Some(joints) = args.joints {
        robots.iter_mut().for_each(|(_, agent)| agent.config.robot.set_losses(joints.into()));
    }
    let trial = Trial::new(args, scenario, &robots, args.seed)?;
    if let Some(late) = trial.scripts.first().and_then(Script::too_late) {
        terminal::note(format_args!("note: {late}"));
    }
    if args.sensing == Sensing::Estimated {
        let policies = robots.iter().map(|(name, agent)| (name.clone(), agent.sha256.as_str()));
        let unfamiliar = ContactNetwork::shipped()?.unfamiliar(policies);
        unfamiliar.iter().for_each(|what| terminal::note(format_args!("note: {what}")));
    }
    if let Some(seeds) = &args.seeds {
        return play_seeds(args, scenario, &robots, seeds);
    }
    let mut recording = Recording::start(&trial)?;
    let bar = progress(trial.steps());
    let traces = trial.play(&mut recording, &bar)?;
    bar.finish_and_clear();
    let played = robots.iter().zip(trial.metrics(&traces)).zip(&traces);
    let outcomes: Vec<Outcome<'_>> = played
        .map(|(((name, agent), metrics), trace)| Outcome {
            policy: name,
            sha256: agent.sha256.clone(),
            robot: &agent.config.robot.model,
            metrics,
            trace,
        })
        .collect();

    let object = || output::to_json(scenario, args.seed, args.sensing, &outcomes);
    let told = output::tell(args, scenario.name(), &outcomes, object);
    #[cfg(feature = "video")]
    let told = told.and_then(|()| video.map_or(Ok(()), |video| trial.draw(&video, &traces)));
    // The recording is finished even if other output failed. A served one waits here until Ctrl-C.
    let recorded = recording.finish(&trial, &traces);
    if let (Err(_), Err(error)) = (&told, &recorded) {
        terminal::note(format_args!("error: {}", terminal::complaint(error.as_ref())));
    }
    told.and(recorded)?;
    let failed = outcomes.iter().find_map(|outcome| Some((outcome.policy, outcome.trace.fault()?)));
    if let Some((policy, fault)) = failed {
        anyhow::bail!("{policy}: stopped after {:.2} s: {}", fault.time_s, fault.text);
    }
    Ok(())
}

/// Plays the scenario with every seed, and prints means and spread; with the first seed only if the seed changes nothing.
fn play_seeds(args: &Args, scenario: &Scenario, robots: &[(String, Agent)], seeds: &RangeInclusive<u64>) -> Result<()> {
    let mut runs: Vec<OfSeeds<'_>> = robots.iter().map(|played| OfSeeds { played, metrics: Vec::new() }).collect();
    let of_seed = |seed: &u64| Trial::new(args, scenario, robots, *seed);
    let (first, last) = (seeds.start(), seeds.end());
    // Identical trials have no spread.
    let is_one = first < last && args.sensing == Sensing::True && of_seed(first)?.scripts == of_seed(last)?.scripts;
    if is_one {
        let name = scenario.name();
        terminal::note(format_args!("note: the seed changes nothing in {name}: only seed {first} is played"));
    }
    let seeds = &if is_one { *first..=*first } else { seeds.clone() };
    let mut failed = None;
    let bar = progress(0);
    for seed in seeds.clone() {
        let trial = of_seed(&seed)?;
        bar.set_length(seeds.clone().count() as u64 * trial.steps());
        bar.set_message(format!("seed {seed}"));
        let traces = trial.play(&mut Recording::none(), &bar)?;
        for ((run, metrics), trace) in runs.iter_mut().zip(trial.metrics(&traces)).zip(&traces) {
            run.metrics.push(metrics);
            if let (Some(fault), None) = (trace.fault(), &failed) {
                failed =
                    Some(format!("{}, seed {seed}: stopped after {:.2} s: {}", run.played.0, fault.time_s, fault.text));
            }
        }
    }
    bar.finish_and_clear();
    if args.json {
        terminal::print(format_args!("{}\n", seeds::to_json(scenario, seeds, serde_json::json!(args.sensing), &runs)))?;
    } else {
        terminal::print(seeds::summary(scenario, seeds, &runs))?;
    }
    failed.map_or(Ok(()), |failed| Err(anyhow::anyhow!(failed)))
}

/// Loads the policies to play, by name, with the commanded compliance [m/s/N] unless their names contain one.
fn robots(args: &Args) -> Result<Vec<(String, Agent)>> {
    let robot = |asked: &str| -> Result<(String, Agent)> {
        let agent = shipped::find(asked)?;
        if let Some(unfinished) = agent.policy().and_then(|policy| policy.provenance.unfinished()) {
            terminal::note(format_args!("note: {asked} {unfinished}"));
        }
        Ok((policy_label(asked), agent))
    };
    let first = args.policy.as_deref().unwrap_or("compliant");
    let ships_both = || ["compliant", "baseline"].iter().all(|name| shipped::find(name).is_ok());
    let second = match args.compare.as_deref() {
        Some("none") => None,
        Some(name) => Some(name),
        None => (args.policy.is_none() && ships_both()).then_some("baseline"),
    };
    let mut robots = vec![robot(first)?];
    if let Some(second) = second {
        let (label, agent) = robot(second)?;
        let label = if label == robots[0].0 { label + " (2)" } else { label };
        robots.push((label, agent));
    }
    Ok(robots)
}

/// A scenario with a seed, the robots that play it, and the script of each.
pub struct Trial<'a> {
    args: &'a Args,
    scenario: &'a Scenario,
    seed: u64,
    robots: &'a [(String, Agent)],
    scripts: Vec<Script>,
}

impl<'a> Trial<'a> {
    fn new(args: &'a Args, scenario: &'a Scenario, robots: &'a [(String, Agent)], seed: u64) -> Result<Self> {
        let script = |(name, agent): &(String, Agent)| -> Result<Script> {
            let mut script = scenario.script(seed, &agent.config)?;
            let compliance = agent.resolve_compliance(None, script.command.compliance);
            script.command.compliance = compliance.with_context(|| name.clone())?;
            Ok(script)
        };
        let scripts = robots.iter().map(script).collect::<Result<_>>().map_err(|error| match &args.params {
            Some(file) => error.context(format!("with the parameters of {}", file.display())),
            None => error,
        })?;
        Ok(Trial { args, scenario, seed, robots, scripts })
    }

    /// Iterates over the robots with their scripts.
    fn parts(&self) -> impl Iterator<Item = (&'a (String, Agent), &Script)> {
        self.robots.iter().zip(&self.scripts)
    }

    /// Returns the number of policy steps of the longest playback, at most.
    fn steps(&self) -> u64 {
        let steps = self.parts().map(|((_, agent), script)| agent.config.simulation.policy_steps(script.duration_s));
        steps.max().unwrap_or(0) as u64
    }

    fn play(&self, recording: &mut Recording, bar: &ProgressBar) -> Result<Vec<Trace>> {
        let mut rollouts = Vec::new();
        for ((_, agent), script) in self.parts() {
            let rollout = Playback::new(script, &agent.config, agent.controller())?.with_felt_forces()?.with_bodies();
            rollouts.push(rollout.with_sensing(self.args.sensing, self.seed)?);
        }
        let mut traces: Vec<Trace> = rollouts.iter().map(Playback::empty_trace).collect();
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
        Ok(traces)
    }

    /// Computes the scenario's metrics of each robot, and those of the state estimate if there is one.
    fn metrics(&self, traces: &[Trace]) -> Vec<Vec<Metric>> {
        let of = |(script, trace): (&Script, &Trace)| {
            let mut found = self.scenario.metrics(script, trace);
            found.extend(felt_forces(trace));
            if self.args.sensing == Sensing::Estimated {
                found.extend(Estimation::metrics(trace));
            }
            found
        };
        self.scripts.iter().zip(traces).map(of).collect()
    }

    /// Compiles the model of each robot for display.
    fn models(&self) -> mujoco::Result<Vec<Model>> {
        self.scripts.iter().map(|script| script.scene.compile_visual()).collect()
    }

    /// Returns how each robot is drawn.
    fn views<'m>(&'m self, models: &'m [Model]) -> Vec<RobotView<'m>> {
        let parts = self.parts().zip(models).map(|(((name, _), script), model)| (name.as_str(), model, &script.scene));
        let estimates = self.args.sensing == Sensing::Estimated;
        RobotView::several(parts).into_iter().map(|view| RobotView { estimates, ..view }).collect()
    }

    /// Draws the traces and writes the video.
    #[cfg(feature = "video")]
    fn draw(&self, video: &Video, traces: &[Trace]) -> Result<()> {
        let models = self.models()?;
        let played: Vec<_> = self.views(&models).into_iter().zip(traces).collect();
        let bar = progress(0);
        bar.set_message("drawing the video");
        video.write(self.scenario.name(), &played, |drawn, count| {
            bar.set_length(count);
            bar.set_position(drawn);
        })?;
        bar.finish_and_clear();
        terminal::note(format_args!("the video is in {}", video.path.display()));
        Ok(())
    }
}
