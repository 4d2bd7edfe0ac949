/*! The training environment: the simulated robot and the task, one policy step at a time.

An environment draws each episode from its own random stream, keeps the history that the observation needs, and
distinguishes the ends of episodes: a fall ends the return, a time limit does not, a physics fault is neither and is
counted.
*/

mod report;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use nalgebra::Vector3;
use rand::RngExt;
use serde::{Deserialize, Serialize};

pub use report::{EnvStep, EpisodeEnd, EpisodeFault, EpisodeReport};

use super::TrainError;
use super::terrain::{self, Course, GroundKind};
use super::{Curriculum, EpisodePlan};
use crate::config::{Config, ValueError};
use crate::mujoco;
use crate::observation::{Command, Layout, ObservationInput, Observer, Privileged};
use crate::robot::{JOINTS, Joints, Robot, joint_target};
use crate::sim::last_second::LastSecond;
use crate::sim::{Ground, HeightField, Scene, Sim};
use crate::task::{Stage, Stages, Terms};
use crate::util::random::{Purpose, stream};
use crate::world::{World, WorldState, WorldStep};

/// Progress of an episode, saved with the environment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct EpisodeState {
    plan: EpisodePlan,
    /// Number of earlier episodes.
    episode: u64,
    /// Length of the first episode \[steps\]; staggers the environments.
    cut: usize,
    reward: f64,
    terms: Terms,
    walking: Terms,
    swing_sum_m: f64,
    swing_count: usize,
    observer: Observer,
    #[serde(default, skip_serializing_if = "Observer::is_empty")]
    critic_observer: Observer,
    last_action: Joints,
    /// The way on uneven ground; `None` on a plane.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    course: Option<Course>,
}

/// Complete state of an environment, from which it continues with the same bits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EnvState {
    world: WorldState,
    progress: EpisodeState,
}

/// The parts that all environments of a configuration share.
#[derive(Debug, Clone)]
pub struct Shared {
    /// The robot of the configuration.
    pub robot: Arc<Robot>,
    /// Layout of the policy's observation.
    pub layout: Arc<Layout>,
    /// Layout of what the critic observes in addition; `None` if it observes what the policy does.
    pub critic: Option<Arc<Layout>>,
    /// The fields of rough ground and of boxes; `None` if all environments have a plane.
    fields: Option<[Arc<HeightField>; 2]>,
}

impl Shared {
    /// Loads the robot and builds the layouts of a configuration.
    ///
    /// # Errors
    /// The robot cannot be read, an observation is invalid, or more mass may be taken from the trunk than it has.
    pub fn new(config: &Config) -> Result<Self, TrainError> {
        let robot = config.robot.load()?;
        let drawn = &config.randomisation;
        if drawn.enabled && drawn.trunk_mass_kg >= robot.trunk_mass_kg {
            let (found, trunk_kg) = (drawn.trunk_mass_kg, robot.trunk_mass_kg);
            return Err(ValueError::Range {
                key: "randomisation.trunk_mass_kg".to_owned(),
                problem: format!("is {found}, expected less than the {trunk_kg:.2} kg of the robot's trunk"),
            }
            .into());
        }
        let critic = config.critic_layout().map_err(ValueError::Critic)?;
        Ok(Shared {
            robot,
            layout: Arc::new(config.layout().map_err(ValueError::Observation)?),
            critic: critic.map(Arc::new),
            fields: config.terrain.as_ref().map(|terrain_config| {
                let reach_m = config.reach_m();
                GroundKind::ALL.map(|kind| Arc::new(terrain::field(terrain_config, kind, reach_m)))
            }),
        })
    }

    /// Returns the numbers of inputs of the policy and of the value function.
    pub fn inputs(&self) -> [usize; 2] {
        let length = self.layout.length();
        [length, length + self.critic.as_ref().map_or(0, |critic| critic.length())]
    }
}

/// The training environment: a robot on a tilted plane that follows velocity commands and is pushed.
///
/// ```
/// use supple::config::Config;
/// use supple::train::{Curriculum, environment::LocomotionEnv};
///
/// let (seed, index) = (0, 0);
/// let mut env = LocomotionEnv::new(&Config::load("fast")?, seed, index, Curriculum::complete())?;
/// env.without_stagger();
/// assert_eq!(env.observation().len(), 83);
/// for _ in 0..60 {
///     let (step, report) = env.step(&[0.0; 12]); // joint target = nominal pose + scale · action
///     assert!(step.reward >= 0.0 && report.is_none()); // it stands: no fall in the first second
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct LocomotionEnv {
    config: Config,
    shared: Shared,
    stages: Stages,
    /// Number of levels of uneven ground; `None` on a plane.
    levels: Option<usize>,
    nominal: Joints,
    seed: u64,
    index: u64,
    world: World,
    progress: EpisodeState,
    /// The last second, for fault reports. It is not saved: nothing depends on it, and it is empty after a resumption.
    last_second: LastSecond,
}

impl LocomotionEnv {
    /// Creates environment `index` of a run, at the start of its first episode.
    ///
    /// # Errors
    /// The robot and the observation do not fit together, or the scene does not compile.
    pub fn new(config: &Config, seed: u64, index: u64, curriculum: Curriculum) -> Result<Self, TrainError> {
        Ok(Self::with_shared(config, &Shared::new(config)?, seed, index, curriculum)?)
    }

    /// Like [`LocomotionEnv::new`], but shares parts of `config` with other environments.
    ///
    /// # Errors
    /// The scene does not compile, or MuJoCo fails in the starting state.
    pub fn with_shared(
        config: &Config,
        shared: &Shared,
        seed: u64,
        index: u64,
        curriculum: Curriculum,
    ) -> mujoco::Result<Self> {
        let terrain = config.terrain.as_ref().zip(shared.fields.as_ref());
        let uneven = terrain
            .and_then(|(terrain, fields)| Some((terrain, &fields[terrain::ground_kind(terrain, index)? as usize])));
        let (mut scene, mut reward) =
            (Scene::flat(Arc::clone(&shared.robot), config.simulation.timestep_s()), config.reward.clone());
        if let Some((terrain, field)) = uneven {
            scene.lists_pairs = true;
            (scene.ground, scene.buffers) = (Ground::Field(Arc::clone(field)), terrain::BUFFERS);
            reward.tracking_sharpness *= terrain.sharpness_factor;
        }
        let levels = uneven.map(|(terrain, _)| terrain.levels);
        let mut world = World::new(&scene, &config.simulation, config.episode.min_height_m, reward)?;
        if shared.critic.is_none() {
            world = world.without_contact_forces();
        }
        let stages = Stages::new(&config.episode, &config.simulation);
        let nominal = config.action.nominal_pose_rad.joints();
        let cut = first_cut(seed, index, &stages);
        let mut env = LocomotionEnv {
            progress: start(config, seed, index, 0, curriculum, cut, levels.map(|_| Course::new(0))),
            config: config.clone(),
            levels,
            shared: shared.clone(),
            stages,
            nominal,
            seed,
            index,
            last_second: LastSecond::new(
                config.simulation.policy_rate_hz as usize,
                world.sim().data().model().nq(),
                world.sim().data().model().nv(),
            ),
            world,
        };
        env.begin()?;
        Ok(env)
    }

    /// Starts the next episode.
    ///
    /// # Errors
    /// MuJoCo fails in the starting state.
    pub fn reset(&mut self, curriculum: Curriculum) -> mujoco::Result<()> {
        let episode = self.progress.episode + 1;
        let cut = usize::MAX;
        let course =
            self.progress.course.zip(self.levels).map(|(course, levels)| Course::new(course.next_level(levels)));
        self.progress = start(&self.config, self.seed, self.index, episode, curriculum, cut, course);
        self.begin()
    }

    /// Starts the first episode of another seed: the same bits as a new environment of that seed.
    ///
    /// # Errors
    /// MuJoCo fails in the starting state.
    pub fn restart(&mut self, seed: u64, curriculum: Curriculum) -> mujoco::Result<()> {
        self.seed = seed;
        let cut = first_cut(seed, self.index, &self.stages);
        let course = self.levels.map(|_| Course::new(0));
        self.progress = start(&self.config, seed, self.index, 0, curriculum, cut, course);
        self.begin()
    }

    /// Gives the first episode its full length. Otherwise it is cut at random, so that environments that are stepped
    /// together are not in the same phase.
    pub fn without_stagger(&mut self) {
        self.progress.cut = usize::MAX;
    }

    fn begin(&mut self) -> mujoco::Result<()> {
        let plan = &mut self.progress.plan;
        if let Some(dynamics) = &plan.dynamics {
            self.world.sim_mut().set_dynamics(dynamics)?;
        }
        if let (Some(course), Some(terrain)) = (self.progress.course, &self.config.terrain) {
            self.world.sim_mut().set_start(terrain::start(terrain, course.level));
        }
        self.world.begin(plan.conditions, &self.nominal, std::mem::take(&mut plan.disturbances))?;
        self.last_second.clear();
        self.observe([Vector3::zeros(); 4]);
        Ok(())
    }

    /// Measures the observations of policy and critic; `foot_forces` are means over the last policy step, world frame
    /// \[N\].
    fn observe(&mut self, foot_forces: [Vector3<f64>; 4]) {
        let privileged = self.shared.critic.is_some().then(|| self.privileged(foot_forces));
        let (p, world) = (&mut self.progress, &self.world);
        let state = world.state();
        let seen = p.plan.imu.map(|imu| {
            let mut rng = stream(self.seed, Purpose::Imu, self.index, p.episode << 24 | world.steps() as u64);
            imu.seen(state, &mut rng)
        });
        let now = ObservationInput {
            state: seen.as_ref().unwrap_or(state),
            command: &p.plan.command,
            last_action: &p.last_action,
            last_target: world.last_target(),
            nominal: &self.nominal,
            time_s: world.time_s(),
            privileged: Privileged::default(),
        };
        p.observer.measure(&self.shared.layout, &now);
        if let (Some(layout), Some(privileged)) = (&self.shared.critic, privileged) {
            p.critic_observer.measure(layout, &ObservationInput { state, privileged, ..now });
        }
    }

    /// Returns the privileged values before the coming policy step.
    fn privileged(&self, foot_forces: [Vector3<f64>; 4]) -> Privileged {
        let (plan, state) = (&self.progress.plan, self.world.state());
        let base_from_world = state.world_from_base.inverse();
        let dynamics = plan.dynamics;
        let (pull, push) = self.world.coming();
        let [forward, left] = push.map_or([0.0; 2], |push| push.linear);
        Privileged {
            foot_forces: foot_forces.map(|force| base_from_world * force),
            friction: plan.conditions.friction,
            encoder_bias: plan.conditions.encoder_bias,
            pull: base_from_world * pull,
            push: base_from_world * (state.heading() * Vector3::new(forward, left, 0.0)),
            trunk_mass_kg: dynamics.map_or(0.0, |dynamics| dynamics.trunk_mass_kg),
            trunk_offset_m: dynamics.map_or([0.0; 3], |dynamics| dynamics.trunk_offset_m).into(),
            latency_s: dynamics.map_or(self.config.simulation.latency_s, |dynamics| dynamics.latency_s),
        }
    }

    methods! {
        /// Returns the environment's index in the run.
        fn index(&self) -> u64 = self.index;
        /// Returns the memory of the simulation \[bytes\].
        fn simulation_bytes(&self) -> usize = self.world.sim().data().bytes();
        /// Returns the random part of this episode without its disturbances: those are in the world.
        fn plan(&self) -> &EpisodePlan = &self.progress.plan;
        /// Returns the velocity command of the episode.
        fn command(&self) -> &Command = &self.progress.plan.command;
        /// Returns the layout of the observation.
        fn layout(&self) -> &Layout = &self.shared.layout;
        /// Returns the numbers of inputs of the policy and of the value function.
        fn inputs(&self) -> [usize; 2] = self.shared.inputs();
        /// Returns the layout of what the critic observes in addition; `None` if it observes what the policy does.
        fn critic_layout(&self) -> Option<&Layout> = self.shared.critic.as_deref();
        /// Returns the present observation in physical units, shape (length of the layout).
        fn observation(&self) -> Vec<f64> = self.progress.observer.raw(&self.shared.layout);
        /// Writes the present observation, normalised for the networks, into a slice of the layout's length.
        fn normalised_observation(&self, out: &mut [f32]) = self.progress.observer.normalised(&self.shared.layout, out);
        /// Returns the world: the robot, and what disturbs it.
        fn world(&self) -> &World = &self.world;
        /// Returns the simulation, to be inspected or disturbed.
        fn sim_mut(&mut self) -> &mut Sim = self.world.sim_mut();
    }

    /// Writes the present observation of the critic, normalised: the policy's, then what the critic observes in
    /// addition. The slice has the length of both.
    pub fn critic_observation(&self, out: &mut [f32]) {
        let (policy, added) = out.split_at_mut(self.shared.layout.length());
        self.normalised_observation(policy);
        self.critic_addition(added);
    }

    /// Writes what the critic observes in addition to the policy, normalised, into a slice of that length.
    pub fn critic_addition(&self, out: &mut [f32]) {
        if let Some(layout) = &self.shared.critic {
            self.progress.critic_observer.normalised(layout, out);
        }
    }

    /// Runs one policy step with an action, one number for each joint; also reports the episode if the step ended it. A
    /// fault of the physics ends the episode with [`EpisodeEnd::Fault`] and a reward of zero.
    ///
    /// # Panics
    /// The action is shorter than the number of joints.
    pub fn step(&mut self, action: &[f32]) -> (EnvStep, Option<EpisodeReport>) {
        match self.try_step(action) {
            Ok((step, report)) => (step, report),
            Err(error) => {
                let (error, episode, step) = (error.to_string(), self.progress.episode, self.world.steps());
                let last_second = self.last_second.csv();
                let fault = EpisodeFault { error, environment: self.index, episode, step, last_second };
                let stage = self.stages.at(self.world.steps());
                let step = EnvStep { reward: 0.0, end: Some(EpisodeEnd::Fault), stage, terms: Terms::default() };
                (step, Some(self.report(EpisodeEnd::Fault, Some(Box::new(fault)))))
            }
        }
    }

    fn try_step(&mut self, action: &[f32]) -> mujoco::Result<(EnvStep, Option<EpisodeReport>)> {
        let scale = self.config.action.scale_rad;
        let target: Joints =
            std::array::from_fn(|joint| joint_target(self.nominal[joint], scale, f64::from(action[joint])));
        let data = self.world.sim().data();
        self.last_second.note(data.positions(), data.velocities(), &target);
        let stage = self.stages.at(self.world.steps());
        let WorldStep { summary, terms, landings, forces, .. } =
            self.world.step(&target, &self.progress.plan.command, |_, _, _| ())?;
        let p = &mut self.progress;
        p.terms.add(&terms);
        p.swing_sum_m += landings.peak_sum_m;
        p.swing_count += landings.count;
        let mut paid = terms;
        match stage {
            Stage::Walking => p.walking.add(&terms),
            Stage::Recovery if self.config.episode.recovery_stage => {
                paid = paid.with_tracking_of(&p.walking.divided(self.stages.recovery_start as f64));
            }
            Stage::Recovery | Stage::PostRecovery => {}
        }
        let reward = paid.total(self.world.reward());
        p.reward += reward;
        if let Some(course) = &mut p.course {
            let period_s = self.config.simulation.policy_period_s();
            course.advance(self.world.state(), &p.plan.command, period_s, summary.fall.is_some());
        }
        p.last_action = std::array::from_fn(|joint| f64::from(action[joint]));
        self.observe(forces.feet);

        let end = self.end(summary.fall.is_some());
        let report = end.map(|end| self.report(end, None));
        Ok((EnvStep { reward, end, stage, terms }, report))
    }

    fn end(&self, fell: bool) -> Option<EpisodeEnd> {
        let last = if self.progress.plan.is_pushed { self.stages.end } else { self.stages.recovery_start };
        if fell {
            Some(EpisodeEnd::Fall)
        } else if self.world.steps() >= last.min(self.progress.cut) {
            Some(EpisodeEnd::TimeLimit)
        } else {
            None
        }
    }

    fn report(&self, end: EpisodeEnd, fault: Option<Box<EpisodeFault>>) -> EpisodeReport {
        let p = &self.progress;
        let walked = self.world.steps() >= self.stages.recovery_start;
        let (steps, pushed) = (self.world.steps(), p.plan.is_pushed && self.world.steps() > self.stages.recovery_start);
        let (reward, terms) = (p.reward, p.terms);
        let walking_linear = walked.then(|| p.walking.linear_velocity() / self.stages.recovery_start as f64);
        let terrain_level = p.course.map(|course| course.level);
        let swing_height_m = (p.swing_count > 0).then(|| p.swing_sum_m / p.swing_count as f64);
        EpisodeReport { end, steps, pushed, reward, terms, walking_linear, terrain_level, swing_height_m, fault }
    }

    /// Replaces the observation by another one of the same quantities.
    #[cfg(test)]
    pub(super) fn see(&mut self, layout: &Arc<Layout>) {
        self.shared.layout = Arc::clone(layout);
    }

    /// Returns the state from which the environment continues with the same bits.
    pub fn save(&self) -> EnvState {
        EnvState { world: self.world.save(), progress: self.progress.clone() }
    }

    /// Restores a saved state.
    ///
    /// # Errors
    /// The state belongs to another model or observation or is impossible, or MuJoCo fails in it.
    pub fn restore(&mut self, state: &EnvState) -> mujoco::Result<()> {
        self.check(&state.progress)?;
        if let Some(dynamics) = &state.progress.plan.dynamics {
            self.world.sim_mut().set_dynamics(dynamics)?;
        }
        self.world.restore(&state.world)?;
        self.last_second.clear();
        self.progress = state.progress.clone();
        let fits_critic = |layout: &Arc<Layout>| self.progress.critic_observer.fits(layout);
        if self.progress.observer.fits(&self.shared.layout) && self.shared.critic.as_ref().is_none_or(fits_critic) {
            Ok(())
        } else {
            refuse("it belongs to another observation".to_owned())
        }
    }

    /// Refuses saved numbers that would take all memory or index beyond an array.
    fn check(&self, progress: &EpisodeState) -> mujoco::Result<()> {
        let plan = &progress.plan;
        if let Some(latency_s) = plan.dynamics.map(|dynamics| dynamics.latency_s)
            && !(0.0..=1.0).contains(&latency_s)
        {
            return refuse(format!("its latency_s is {latency_s}, expected 0 to 1 s"));
        }
        if let (Some(course), Some(levels)) = (progress.course, self.levels)
            && course.level >= levels
        {
            return refuse(format!("its terrain has level {}, expected 0 to {}", course.level, levels - 1));
        }
        Ok(())
    }
}

fn refuse(message: String) -> mujoco::Result<()> {
    Err(mujoco::Error::Load { what: "a saved state".into(), message })
}

/// Draws the length of the first episode \[steps\].
fn first_cut(seed: u64, index: u64, stages: &Stages) -> usize {
    stream(seed, Purpose::Stagger, index, 0).random_range(1..=stages.recovery_start)
}

fn start(
    config: &Config,
    seed: u64,
    index: u64,
    episode: u64,
    curriculum: Curriculum,
    cut: usize,
    course: Option<Course>,
) -> EpisodeState {
    let plan = EpisodePlan::draw(config, curriculum, &mut stream(seed, Purpose::Episode, index, episode));
    EpisodeState {
        plan,
        episode,
        cut,
        reward: 0.0,
        terms: Terms::default(),
        walking: Terms::default(),
        swing_sum_m: 0.0,
        swing_count: 0,
        observer: Observer::new(),
        critic_observer: Observer::new(),
        last_action: [0.0; JOINTS],
        course,
    }
}
