/*! The ball pit against the clock: physics, policy and recording, as the `scenario` program plays it.

The slowest second counts more than the mean for whoever watches: it is when the robot is deepest among the balls.
*/

use std::time::Instant;

use anyhow::Context;
use clap::{FromArgMatches, Subcommand};
use serde::Serialize;
use supple::config::{Config, flat_parameters};
use supple::go1::JOINT_COUNT;
use supple::policy::{Policy, Provenance};
use supple::ppo::ActorCritic;
use supple::random::{Purpose, stream};
use supple::scenario::Rollout;
use supple::scenario::catalog::{DEFAULTS, Scenario};
use supple::task::observation::LENGTH;
use supple::trace::EventKind;

use crate::stopwatch::{Effort, median};

/// Name of the scenario.
const NAME: &str = "ball-pit";

/// All of it.
#[derive(Debug, Serialize)]
pub struct Pit {
    /// What moved the robot.
    pub moved_by: String,
    /// Whether every frame went into a recording.
    pub recorded: bool,
    /// Simulated in one repetition [s].
    pub simulated_s: f64,
    /// How far the robot got [m].
    pub distance_m: f64,
    /// Physics steps per second of wall-clock time, the recording included.
    pub physics_steps_per_s: f64,
    /// Simulated over wall-clock time.
    pub real_time: f64,
    /// The same in the slowest simulated second.
    pub slowest_second_real_time: f64,
    /// Most contacts at the end of any policy step, and room for them.
    pub contacts: [usize; 2],
    /// What MuJoCo complained about, such as a full buffer; none if all went well.
    pub fault: Option<String>,
}

/// One repetition.
struct Play {
    elapsed_s: f64,
    /// When each frame was done [s].
    frames_s: Vec<f64>,
    distance_m: f64,
    contacts: [usize; 2],
    fault: Option<String>,
}

/// Plays the scenario with its own parameters.
pub fn measure(policy: Option<Policy>, config: &Config, effort: &Effort) -> anyhow::Result<Pit> {
    let moved_by = policy.as_ref().map_or("nothing: it stands".into(), |policy| {
        format!("{} after {} samples", policy.provenance.config_name, policy.provenance.samples)
    });
    let policy = policy.unwrap_or_else(|| standing(config));
    let scenario = scenario(effort.pit_s)?;
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("ball-pit.rrd");
    let plays =
        (0..effort.repetitions).map(|_| play(&scenario, &policy, &path)).collect::<anyhow::Result<Vec<Play>>>()?;

    let period_s = policy.provenance.config.simulation.policy_period_s();
    let second = (1.0 / period_s).round() as usize;
    let simulated_s = |play: &Play| play.frames_s.len() as f64 * period_s;
    let slowest = |play: &Play| {
        let windows = play.frames_s.windows(second + 1).map(|window| 1.0 / (window[second] - window[0]));
        windows.fold(simulated_s(play) / play.elapsed_s, f64::min)
    };
    let real_time = median(plays.iter().map(|play| simulated_s(play) / play.elapsed_s));
    Ok(Pit {
        moved_by,
        recorded: cfg!(feature = "record"),
        simulated_s: median(plays.iter().map(simulated_s)),
        distance_m: median(plays.iter().map(|play| play.distance_m)),
        physics_steps_per_s: real_time / config.simulation.timestep_s(),
        real_time,
        slowest_second_real_time: median(plays.iter().map(slowest)),
        contacts: plays.first().map_or([0; 2], |play| play.contacts),
        fault: plays.into_iter().find_map(|play| play.fault),
    })
}

/// The scenario as the program builds it from its defaults.
fn scenario(duration_s: f64) -> anyhow::Result<Scenario> {
    let (_, text) = DEFAULTS.iter().find(|(name, _)| *name == NAME).context("there is no ball pit")?;
    let mut line = vec!["scenario".to_owned(), NAME.to_owned()];
    for (key, value) in flat_parameters(NAME, text)? {
        let value = if key == "duration_s" { duration_s.to_string() } else { value };
        line.push(format!("--{}={value}", key.replace('_', "-")));
    }
    let command = Scenario::augment_subcommands(clap::Command::new("scenario"));
    Ok(Scenario::from_arg_matches(&command.try_get_matches_from(line)?)?)
}

fn play(scenario: &Scenario, policy: &Policy, path: &std::path::Path) -> anyhow::Result<Play> {
    let script = scenario.script(0, &policy.provenance.config)?;
    let mut rollout = Rollout::new(&script, &policy.provenance.config, Box::new(policy.controller()))?;
    if cfg!(feature = "record") {
        rollout = rollout.with_bodies();
    }
    let mut recording = Recording::new(&script, path)?;
    let mut play = Play { elapsed_s: 0.0, frames_s: Vec::new(), distance_m: 0.0, contacts: [0; 2], fault: None };
    let started = Instant::now();
    while let Some(played) = rollout.next() {
        for event in played.events.iter().filter(|event| event.kind == EventKind::Fault) {
            play.fault = Some(event.text.clone());
        }
        let Some(frame) = played.frame else { continue };
        recording.frame(&frame)?;
        play.frames_s.push(started.elapsed().as_secs_f64());
        play.distance_m = frame.position[0];
        let data = rollout.sim().data();
        play.contacts = [play.contacts[0].max(data.contact_count()), data.model().nconmax()];
    }
    recording.finish()?;
    play.elapsed_s = started.elapsed().as_secs_f64();
    Ok(play)
}

#[cfg(feature = "record")]
struct Recording(supple::record::Recorder);

#[cfg(feature = "record")]
impl Recording {
    fn new(script: &supple::scenario::Script, path: &std::path::Path) -> anyhow::Result<Self> {
        use supple::record::{Recorder, RobotView, Sink};
        let model = script.scene.compile_visual()?;
        let view =
            RobotView { name: "robot", model: &model, ground: &script.scene.ground, tint: None, estimates: false };
        Ok(Recording(Recorder::new(Sink::File(path.to_owned()), NAME, &[view])?))
    }

    fn frame(&mut self, frame: &supple::trace::Frame) -> anyhow::Result<()> {
        Ok(self.0.frame(0, frame)?)
    }

    fn finish(self) -> anyhow::Result<()> {
        Ok(self.0.finish()?)
    }
}

/// Without the feature there is nothing to record with.
#[cfg(not(feature = "record"))]
struct Recording;

#[cfg(not(feature = "record"))]
impl Recording {
    fn new(_: &supple::scenario::Script, _: &std::path::Path) -> anyhow::Result<Self> {
        Ok(Recording)
    }

    fn frame(&mut self, _: &supple::trace::Frame) -> anyhow::Result<()> {
        Ok(())
    }

    fn finish(self) -> anyhow::Result<()> {
        Ok(())
    }
}

/// A policy that holds the nominal pose.
fn standing(config: &Config) -> Policy {
    let mut rng = stream(0, Purpose::Weights, 0, 0);
    let network = ActorCritic::orthogonal(LENGTH, &config.ppo.hidden_layers, JOINT_COUNT, 0.0, &mut rng);
    let provenance = Provenance {
        config_name: "standing".into(),
        config: config.clone(),
        seed: 0,
        samples: 0,
        git_revision: supple::provenance::GIT_REVISION.into(),
        mujoco_version: supple::provenance::MUJOCO_VERSION.into(),
    };
    Policy::new(&network.zeros_like(), provenance)
}
