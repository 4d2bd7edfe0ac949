/*! Environment steps against plain `mj_step`, on one thread and on all.

Both go through the same recorded trajectories ([`Replay`]) of as many environments as in training, and in training's
order: one policy step of every environment of a thread, then the next. The environment's side holds everything that a
rollout does but the networks: normalised observations, PD control, latency, reward, statistics, falls, resets.
*/

use serde::Serialize;
use supple::config::Config;
use supple::policy::Policy;

use crate::replay::Replay;
use crate::stopwatch::{Effort, median, timed_on_threads};

/// Rates [physics steps/s] on some threads.
#[derive(Debug, Serialize)]
pub struct Rates {
    pub threads: usize,
    /// `mj_step` alone.
    pub raw_steps_per_s: f64,
    /// Within environment steps.
    pub env_steps_per_s: f64,
    /// Median of the repetitions' own ratios.
    pub env_over_raw: f64,
}

#[derive(Debug, Serialize)]
pub struct Physics {
    /// The source of the robots' actions.
    pub moved_by: String,
    pub environments: usize,
    /// Policy steps of each.
    pub steps: usize,
    /// Resets and pushes among them.
    pub interventions: usize,
    pub one_thread: Rates,
    pub all_threads: Rates,
}

pub fn measure(config: &Config, policy: &Policy, threads: usize, effort: &Effort) -> anyhow::Result<Physics> {
    let record = |index| Replay::record(config, policy, index as u64, effort.warm_up_steps, effort.steps);
    let mut replays = (0..effort.environments).map(record).collect::<anyhow::Result<Vec<_>>>()?;
    Ok(Physics {
        moved_by: moved_by(policy),
        environments: effort.environments,
        steps: effort.steps,
        interventions: replays.iter().map(Replay::interventions).sum(),
        one_thread: rates(&mut replays, 1, effort)?,
        all_threads: rates(&mut replays, threads, effort)?,
    })
}

/// Names what moves the robots.
pub fn moved_by(policy: &Policy) -> String {
    format!("{} after {} samples", policy.provenance.config_name, policy.provenance.samples)
}

fn rates(replays: &mut [Replay], threads: usize, effort: &Effort) -> anyhow::Result<Rates> {
    let physics_steps = replays.iter().map(Replay::physics_steps).sum::<usize>() as f64;
    let (mut raw, mut env) = (Vec::new(), Vec::new());
    for _ in 0..effort.repetitions {
        replays.iter_mut().try_for_each(Replay::rewind)?;
        let raw_s = timed_on_threads(threads, replays, |replays| {
            (0..effort.steps).try_for_each(|step| replays.iter_mut().try_for_each(|replay| replay.raw_step(step)))
        })?;
        replays.iter().try_for_each(Replay::check)?;
        let env_s = timed_on_threads(threads, replays, |replays| {
            (0..effort.steps).try_for_each(|step| {
                replays.iter_mut().for_each(Replay::observe);
                replays.iter_mut().try_for_each(|replay| replay.environment_step(step))
            })
        })?;
        raw.push(physics_steps / raw_s);
        env.push(physics_steps / env_s);
    }
    Ok(Rates {
        threads,
        env_over_raw: median(env.iter().zip(&raw).map(|(env, raw)| env / raw)),
        raw_steps_per_s: median(raw),
        env_steps_per_s: median(env),
    })
}
