/*! Environment steps against plain `mj_step`, through the same trajectories, on one thread and on all.

An environment is driven by a policy with noise, and a twin of its simulation follows step by step and writes down the
torques of every physics step, and the state at every reset and push. Both can then go through the stretch again as
often as needed: the environment from its saved state with the same actions, plain MuJoCo from the same state with the
same torques. Contacts, solver iterations and cache misses are then the same ones, and what remains between the two is
the environment's own work: all that a rollout does but the networks. [`Replay::check`] holds both to that: they end at
the same positions, bit for bit.
*/

use anyhow::ensure;
use rand::RngExt;
use rand_distr::StandardNormal;
use serde::Deserialize;
use supple::config::Config;
use supple::mujoco::Data;
use supple::policy::{InferenceBuffers, Policy, shipped};
use supple::robot::{JOINTS, Joints, Robot};
use supple::sim::{Conditions, Parts, Scene, Sim, StepObserver};
use supple::train::Curriculum;
use supple::train::environment::{EnvState, EpisodeEnd, LocomotionEnv};
use supple::util::random::{Purpose, stream};

use crate::{Effort, Figures, timed};

/// Standard deviation of the actions' noise, as of a policy after some million samples.
const NOISE: f32 = 0.2;

pub fn measure(config: &Config, threads: usize, effort: &Effort, figures: &mut Figures) -> anyhow::Result<()> {
    let policy = shipped::find_ours("compliant")?;
    let record = |index| Replay::record(config, &policy, index as u64, effort);
    let mut replays = (0..effort.environments).map(record).collect::<anyhow::Result<Vec<_>>>()?;
    let physics_steps = (effort.environments * effort.steps * config.simulation.substeps()) as f64;
    for (threads, on) in [(1, "_on_one_thread"), (threads, "")] {
        let (mut raw, mut env) = (Vec::new(), Vec::new());
        for _ in 0..effort.repetitions {
            replays.iter_mut().try_for_each(Replay::rewind)?;
            raw.push(physics_steps / seconds(threads, effort.steps, &mut replays, Replay::raw_step)?);
            replays.iter().try_for_each(Replay::check)?;
            env.push(physics_steps / seconds(threads, effort.steps, &mut replays, Replay::environment_step)?);
        }
        figures.note(format!("env_over_raw{on}"), env.iter().zip(&raw).map(|(env, raw)| env / raw));
        figures.note(format!("raw_steps_per_s{on}"), raw);
        figures.note(format!("env_steps_per_s{on}"), env);
    }
    Ok(())
}

/// Returns the time of all steps [s] in training's order: one step of every environment of a thread, then the next.
fn seconds(
    threads: usize,
    steps: usize,
    replays: &mut [Replay],
    step: fn(&mut Replay, usize) -> anyhow::Result<()>,
) -> anyhow::Result<f64> {
    let work = |part: &mut [Replay]| (0..steps).try_for_each(|now| part.iter_mut().try_for_each(|it| step(it, now)));
    let parts = replays.chunks_mut(replays.len().div_ceil(threads));
    let all = || {
        std::thread::scope(|scope| {
            let workers: Vec<_> = parts.map(|part| scope.spawn(move || work(part))).collect();
            let panicked = |panic| std::panic::resume_unwind(panic);
            workers.into_iter().try_for_each(|worker| worker.join().unwrap_or_else(panicked))
        })
    };
    Ok(timed(all)?.0)
}

/// The state of a simulation, as MuJoCo needs it. Positions are as they were before they were normalised.
#[derive(Debug, Deserialize)]
struct Start {
    positions: Vec<f64>,
    velocities: Vec<f64>,
    warm_start: Vec<f64>,
    conditions: Conditions,
}

/// A policy step: the action of the environment, and what plain MuJoCo needs for the same.
struct Step {
    action: [f32; JOINTS],
    /// State to go on from: at the beginning, and after a reset or a push.
    start: Option<Start>,
    /// Torques of each physics step.
    torques: Vec<Joints>,
}

/// One environment's stretch, ready to be gone through again.
struct Replay {
    env: LocomotionEnv,
    env_start: EnvState,
    /// Normalised observation, kept so that it is not optimised away.
    seen: Vec<f32>,
    raw: Data,
    ground: usize,
    steps: Vec<Step>,
    end: Vec<f64>,
}

impl Replay {
    /// Records the steps of environment `index` after those of the warm-up.
    fn record(config: &Config, policy: &Policy, index: u64, effort: &Effort) -> anyhow::Result<Self> {
        let mut env = LocomotionEnv::new(config, 0, index, Curriculum::complete())?;
        let scene = Scene::flat(Robot::load(&config.robot.model)?, config.simulation.timestep_s());
        let mut twin = Sim::new(&scene, &config.simulation, config.episode.min_height_m)?;
        let (nominal, scale) = (config.action.nominal_pose_rad.joints(), config.action.scale_rad);
        let mut buffers = InferenceBuffers::default();
        let (mut env_start, mut steps, mut is_new) = (env.save(), Vec::new(), true);
        for step in 0..effort.warm_up_steps + effort.steps {
            if step == effort.warm_up_steps {
                env_start = env.save();
            }
            if is_new {
                twin.restore(&env.sim_mut().save())?;
            }
            let push = env.world().coming().1;
            if let Some(push) = push {
                twin.push(push.linear, push.angular)?;
            }
            let start = (step == effort.warm_up_steps || is_new || push.is_some())
                .then(|| serde_json::from_value(serde_json::to_value(twin.save())?))
                .transpose()?;
            let mut noise = stream(0, Purpose::Action, index, step as u64);
            let wanted = policy.joint_targets(&env.observation(), &mut buffers);
            let action: [f32; JOINTS] = std::array::from_fn(|joint| {
                ((wanted[joint] - nominal[joint]) / scale) as f32 + NOISE * noise.sample::<f32, _>(StandardNormal)
            });
            // As the environment maps an action to joint targets.
            let target = std::array::from_fn(|joint| nominal[joint] + scale * f64::from(action[joint]));
            let mut tape = Tape::default();
            twin.step(&target, &mut tape)?;
            let (outcome, _) = env.step(&action);
            ensure!(outcome.end != Some(EpisodeEnd::Fault), "the physics failed in environment {index}");
            ensure!(twin.data().positions() == env.sim_mut().data().positions(), "environment {index}'s twin lost it");
            if step >= effort.warm_up_steps {
                steps.push(Step { action, start, torques: tape.0 });
            }
            is_new = outcome.end.is_some();
            if is_new {
                env.reset(Curriculum::complete())?;
            }
        }
        let (ground, raw, seen) = (twin.parts().ground(), Data::new(scene.compile()?)?, vec![0.0; env.inputs()[0]]);
        Ok(Replay { env, env_start, seen, raw, ground, steps, end: twin.data().positions().to_vec() })
    }

    fn rewind(&mut self) -> anyhow::Result<()> {
        self.env.restore(&self.env_start)?;
        Ok(self.raw.reset()?)
    }

    /// Takes the environment through a policy step, with a normalised observation before it and a new episode where one is due.
    fn environment_step(&mut self, step: usize) -> anyhow::Result<()> {
        self.env.normalised_observation(&mut self.seen);
        std::hint::black_box(&self.seen);
        let (outcome, report) = self.env.step(&self.steps[step].action);
        std::hint::black_box((outcome, report));
        if outcome.end.is_some() {
            self.env.reset(Curriculum::complete())?;
        }
        Ok(())
    }

    /// Takes the same step by `mj_step` alone.
    fn raw_step(&mut self, step: usize) -> anyhow::Result<()> {
        let Step { start, torques, .. } = &self.steps[step];
        if let Some(start) = start {
            self.raw.set_gravity(start.conditions.gravity);
            self.raw.set_sliding_friction(self.ground, start.conditions.friction);
            self.raw.positions_mut().copy_from_slice(&start.positions);
            self.raw.velocities_mut().copy_from_slice(&start.velocities);
            self.raw.warm_start_mut().copy_from_slice(&start.warm_start);
        }
        for torques in torques {
            self.raw.controls_mut().copy_from_slice(torques);
            self.raw.step()?;
        }
        Ok(())
    }

    /// Checks after the stretch that raw steps came to the same end as the environment.
    fn check(&self) -> anyhow::Result<()> {
        // `mj_step` leaves positions as they were integrated, the environment normalises their quaternion.
        let exact = |(index, (found, expected)): (usize, (&f64, &f64))| match index {
            3..7 => (found - expected).abs() < 1e-14,
            _ => found == expected,
        };
        ensure!(self.raw.positions().iter().zip(&self.end).enumerate().all(exact), "mj_step took another way");
        Ok(())
    }
}

/// Torques in the order of the actuators, which is that of the joints.
#[derive(Default)]
struct Tape(Vec<Joints>);

impl StepObserver for Tape {
    fn forces(&mut self, data: &Data, _: &Parts, _: &Joints) {
        let mut controls = [0.0; JOINTS];
        controls.copy_from_slice(data.controls());
        self.0.push(controls);
    }
}
