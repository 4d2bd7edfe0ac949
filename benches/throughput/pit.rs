/*! The ball pit against the clock: physics and policy, as the `scenario` program plays it.

The slowest second counts more than the mean for whoever watches: it is when the robot is deepest among the balls.
*/

use std::time::Instant;

use serde::Serialize;
use supple::config::Config;
use supple::policy::Policy;
use supple::scenario::Playback;
use supple::scenario::catalog::Scenario;
use supple::scenario::trace::EventKind;

use crate::physics::moved_by;
use crate::stopwatch::{Effort, median};

#[derive(Debug, Serialize)]
pub struct Pit {
    /// The source of the robot's actions.
    pub moved_by: String,
    /// Simulated in one repetition [s].
    pub simulated_s: f64,
    pub distance_m: f64,
    pub physics_steps_per_s: f64,
    pub real_time: f64,
    /// The same in the slowest simulated second.
    pub slowest_second_real_time: f64,
    /// Most contacts at the end of any policy step, and room for them.
    pub contacts: [usize; 2],
    /// The complaint of MuJoCo, such as a full buffer; none if there was none.
    pub fault: Option<String>,
}

struct Play {
    elapsed_s: f64,
    /// When each frame was done [s].
    frames_s: Vec<f64>,
    distance_m: f64,
    contacts: [usize; 2],
    fault: Option<String>,
}

/// Plays the scenario with its own parameters.
pub fn measure(policy: &Policy, config: &Config, effort: &Effort) -> anyhow::Result<Pit> {
    let scenario = Scenario::named("ball-pit", &format!("duration_s: {}", effort.pit_s))?;
    let plays = (0..effort.repetitions).map(|_| play(&scenario, policy)).collect::<anyhow::Result<Vec<Play>>>()?;

    let period_s = policy.provenance.config.simulation.policy_period_s();
    let second = (1.0 / period_s).round() as usize;
    let simulated_s = |play: &Play| play.frames_s.len() as f64 * period_s;
    let slowest = |play: &Play| {
        let windows = play.frames_s.windows(second + 1).map(|window| 1.0 / (window[second] - window[0]));
        windows.fold(simulated_s(play) / play.elapsed_s, f64::min)
    };
    let real_time = median(plays.iter().map(|play| simulated_s(play) / play.elapsed_s));
    Ok(Pit {
        moved_by: moved_by(policy),
        simulated_s: median(plays.iter().map(simulated_s)),
        distance_m: median(plays.iter().map(|play| play.distance_m)),
        physics_steps_per_s: real_time / config.simulation.timestep_s(),
        real_time,
        slowest_second_real_time: median(plays.iter().map(slowest)),
        contacts: plays.first().map_or([0; 2], |play| play.contacts),
        fault: plays.into_iter().find_map(|play| play.fault),
    })
}

fn play(scenario: &Scenario, policy: &Policy) -> anyhow::Result<Play> {
    let script = scenario.script(0, &policy.provenance.config)?;
    let mut rollout = Playback::new(&script, &policy.provenance.config, Box::new(policy.inference().controller()))?;
    let mut play = Play { elapsed_s: 0.0, frames_s: Vec::new(), distance_m: 0.0, contacts: [0; 2], fault: None };
    let started = Instant::now();
    while let Some(played) = rollout.next() {
        for event in played.events.iter().filter(|event| event.kind == EventKind::Fault) {
            play.fault = Some(event.text.clone());
        }
        let Some(frame) = played.frame else { continue };
        play.frames_s.push(started.elapsed().as_secs_f64());
        play.distance_m = frame.position[0];
        let data = rollout.sim().data();
        play.contacts = [play.contacts[0].max(data.contact_count()), data.model().nconmax()];
    }
    play.elapsed_s = started.elapsed().as_secs_f64();
    Ok(play)
}
