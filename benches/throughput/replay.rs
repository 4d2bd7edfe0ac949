/*! The same trajectory twice: once by an environment, once by nothing but `mj_step`.

An environment is driven by a policy with noise, and a twin of its simulation follows step by step and writes down the
torques of every physics step, and the state at every reset and push. Both can then go through the stretch again as
often as needed: the environment from its saved state with the same actions, plain MuJoCo from the same state with the
same torques. Contacts, solver iterations and cache misses are then the same ones, and what remains between the two is
the environment's own work. [`Replay::check`] holds both to that: they end at the same positions, bit for bit.
*/

use anyhow::{Context, ensure};
use rand::RngExt;
use rand_distr::StandardNormal;
use serde::Deserialize;
use supple::config::Config;
use supple::mujoco::Data;
use supple::policy::{InferenceBuffers, Policy};
use supple::robot::{JOINTS, Joints, Robot};
use supple::sim::{Conditions, Parts, Scene, Sim, StepObserver};
use supple::task::Stages;
use supple::train::Curriculum;
use supple::train::environment::{EnvState, EpisodeEnd, LocomotionEnv};
use supple::util::random::{Purpose, stream};

/// Standard deviation of the actions' noise, as of a policy after some million samples.
const NOISE: f32 = 0.2;

/// Where a simulation stands, as MuJoCo needs it. Positions as they were before they were normalised.
#[derive(Debug, Clone, Deserialize)]
struct Start {
    positions: Vec<f64>,
    velocities: Vec<f64>,
    warm_start: Vec<f64>,
    conditions: Conditions,
}

impl Start {
    fn of(sim: &Sim) -> anyhow::Result<Self> {
        Ok(serde_json::from_value(serde_json::to_value(sim.save())?)?)
    }

    fn put(&self, data: &mut Data, ground: usize) {
        data.set_gravity(self.conditions.gravity);
        data.set_sliding_friction(ground, self.conditions.friction);
        data.positions_mut().copy_from_slice(&self.positions);
        data.velocities_mut().copy_from_slice(&self.velocities);
        data.warm_start_mut().copy_from_slice(&self.warm_start);
    }
}

/// One environment's stretch, ready to be gone through again.
pub struct Replay {
    env: LocomotionEnv,
    env_start: EnvState,
    actions: Vec<[f32; JOINTS]>,
    /// Normalised observation, kept so that it is not optimised away.
    seen: Vec<f32>,
    raw: Data,
    ground: usize,
    substeps: usize,
    /// States to go on from, by policy step; the first is the beginning.
    starts: Vec<(usize, Start)>,
    next_start: usize,
    /// By physics step.
    torques: Vec<Joints>,
    end: Vec<f64>,
}

impl Replay {
    /// Records `steps` policy steps of environment `index`, after `warm_up` others.
    pub fn record(config: &Config, policy: &Policy, index: u64, warm_up: usize, steps: usize) -> anyhow::Result<Self> {
        let mut env = LocomotionEnv::new(config, 0, index, Curriculum::complete())?;
        let scene = Scene::flat(Robot::load(&config.robot.model)?, config.simulation.timestep_s());
        let mut twin = Sim::new(&scene, &config.simulation, config.episode.min_height_m)?;
        let recovery_start = Stages::new(&config.episode, &config.simulation).recovery_start;
        let (nominal, scale) = (config.action.nominal_pose_rad.joints(), config.action.scale_rad);
        let mut buffers = InferenceBuffers::default();
        let mut tape = Tape::default();
        let (mut env_start, mut starts, mut actions) = (env.save(), Vec::new(), Vec::new());
        // Policy steps since the episode began.
        let mut age = 0;
        for step in 0..warm_up + steps {
            let now = step.checked_sub(warm_up);
            if now == Some(0) {
                env_start = env.save();
                tape.torques.clear();
            }
            if age == 0 {
                twin.restore(&env.sim_mut().save())?;
            }
            if age == recovery_start {
                let push = env.world().coming().1.context("no push comes after the walking stage")?;
                twin.push(push.linear, push.angular)?;
            }
            if let Some(now) = now
                && (now == 0 || age == 0 || age == recovery_start)
            {
                starts.push((now, Start::of(&twin)?));
            }
            let mut noise = stream(0, Purpose::Action, index, step as u64);
            let wanted = policy.joint_targets(&env.observation(), &mut buffers);
            let action: [f32; JOINTS] = std::array::from_fn(|joint| {
                ((wanted[joint] - nominal[joint]) / scale) as f32 + NOISE * noise.sample::<f32, _>(StandardNormal)
            });
            // As the environment maps an action to joint targets.
            let target = std::array::from_fn(|joint| nominal[joint] + scale * f64::from(action[joint]));
            twin.step(&target, &mut tape)?;
            let (outcome, _) = env.step(&action);
            ensure!(outcome.end != Some(EpisodeEnd::Fault), "the physics failed in environment {index}");
            ensure!(
                twin.data().positions() == env.sim_mut().data().positions(),
                "the twin of environment {index} lost it"
            );
            if now.is_some() {
                actions.push(action);
            }
            age += 1;
            if outcome.end.is_some() {
                env.reset(Curriculum::complete())?;
                age = 0;
            }
        }
        let end = twin.data().positions().to_vec();
        let (ground, raw) = (twin.parts().ground(), Data::new(scene.compile()?)?);
        Ok(Replay {
            env,
            env_start,
            actions,
            seen: vec![0.0; config.layout()?.length()],
            raw,
            ground,
            substeps: config.simulation.substeps(),
            starts,
            next_start: 0,
            torques: tape.torques,
            end,
        })
    }

    pub fn physics_steps(&self) -> usize {
        self.torques.len()
    }

    /// Episodes and pushes that begin in the stretch.
    pub fn interventions(&self) -> usize {
        self.starts.len() - 1
    }

    pub fn rewind(&mut self) -> anyhow::Result<()> {
        self.env.restore(&self.env_start)?;
        self.raw.reset()?;
        self.next_start = 0;
        Ok(())
    }

    /// What a rollout does before the policy is asked: the observation, normalised.
    pub fn observe(&mut self) {
        self.env.normalised_observation(&mut self.seen);
        std::hint::black_box(&self.seen);
    }

    /// One policy step of the environment, with a new episode where one is due.
    pub fn environment_step(&mut self, step: usize) -> anyhow::Result<()> {
        let (outcome, report) = self.env.step(&self.actions[step]);
        std::hint::black_box((outcome, report));
        if outcome.end.is_some() {
            self.env.reset(Curriculum::complete())?;
        }
        Ok(())
    }

    /// The same by `mj_step` alone.
    pub fn raw_step(&mut self, step: usize) -> anyhow::Result<()> {
        if let Some((due, start)) = self.starts.get(self.next_start)
            && *due == step
        {
            start.put(&mut self.raw, self.ground);
            self.next_start += 1;
        }
        for torques in &self.torques[step * self.substeps..(step + 1) * self.substeps] {
            self.raw.controls_mut().copy_from_slice(torques);
            self.raw.step()?;
        }
        Ok(())
    }

    /// After the stretch: raw steps came to the same end as the environment.
    pub fn check(&self) -> anyhow::Result<()> {
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
struct Tape {
    torques: Vec<Joints>,
}

impl StepObserver for Tape {
    fn forces(&mut self, data: &Data, _: &Parts, _: &Joints) {
        let mut controls = [0.0; JOINTS];
        controls.copy_from_slice(data.controls());
        self.torques.push(controls);
    }
}
