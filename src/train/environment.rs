/*! The training environment: the simulated robot and the task, one policy step at a time.

An environment draws each episode from its own random stream, keeps the history that the observation needs, and
distinguishes the ends of episodes: a fall ends the return, a time limit does not, a physics fault is neither and is
counted.
*/

use std::sync::Arc;

use nalgebra::Vector3;
use rand::RngExt;
use serde::{Deserialize, Serialize};

use super::TrainError;
use super::held_feet::{HeldFeet, Pins};
use super::step_meter::{FootForces, StepMeter};
use super::terrain::{self, Course, Kind};
use crate::config::{Config, Reward, ValueError};
use crate::mujoco;
use crate::observation::{Command, Layout, Moment, Observer, Privileged};
use crate::robot::{JOINTS, Joints, Robot, RobotState, joint_target};
use crate::sim::last_second::LastSecond;
use crate::sim::{Ground, HeightField, Scene, Sim, SimState};
use crate::task::deviation::HoldSpring;
use crate::task::reward;
use crate::task::{Curriculum, EpisodePlan, Stage, Stages, SwingTracker, Terms};
use crate::util::random::{Purpose, stream};

/// The way in which an episode ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EpisodeEnd {
    /// The robot fell: the return ends here.
    Fall,
    /// The time limit was reached, or there are no pushes yet: the value of the last state continues the return.
    TimeLimit,
    /// The physics failed: the step has no advantage, and the fault is counted.
    Fault,
}

/// The result of one policy step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EnvStep {
    /// Reward of equation 3, or of the recovery stage.
    pub reward: f64,
    /// Set if this step ended the episode. The observation afterwards is the final one.
    pub end: Option<EpisodeEnd>,
    /// Stage of the episode that the step belongs to.
    pub stage: Stage,
    /// The terms of the reward as measured (never replaced); zero if the physics failed.
    pub terms: Terms,
}

/// Summary of a finished episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpisodeReport {
    /// The way in which the episode ended.
    pub end: EpisodeEnd,
    /// Length of the episode \[steps\].
    pub steps: usize,
    /// True if the robot was pushed.
    pub pushed: bool,
    /// Sum of the rewards over the episode.
    pub reward: f64,
    /// Sums of the terms over all steps, as measured (never replaced).
    pub terms: Terms,
    /// Mean `r_lin` of the walking stage, if the episode completed it.
    pub walking_linear: Option<f64>,
    /// Mean peak height of the swings that ended in this episode \[m\].
    pub swing_height_m: Option<f64>,
    /// Level of the terrain, if the episode was on uneven ground.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub terrain_level: Option<usize>,
    /// Report of the physics fault, if one ended the episode.
    pub fault: Option<Box<EpisodeFault>>,
}

/// Report of a physics fault.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpisodeFault {
    /// Error message of MuJoCo.
    pub error: String,
    /// Index of the environment in its run.
    pub environment: u64,
    /// Number of earlier episodes of this environment.
    pub episode: u64,
    /// Number of earlier steps in the episode.
    pub step: usize,
    /// CSV of the last second before the fault, see [`LastSecond::csv`].
    pub last_second: String,
}

/// Progress of an episode, saved with the environment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct EpisodeState {
    plan: EpisodePlan,
    step: usize,
    /// Number of earlier episodes.
    episode: u64,
    /// Length of the first episode \[steps\]; staggers the environments.
    cut: usize,
    pushed: bool,
    reward: f64,
    terms: Terms,
    walking: Terms,
    swings: SwingTracker,
    swing_sum_m: f64,
    swing_count: usize,
    observer: Observer,
    #[serde(default, skip_serializing_if = "Observer::is_empty")]
    critic_observer: Observer,
    last_action: Joints,
    last_target: Joints,
    #[serde(default, skip_serializing_if = "Pins::is_free")]
    pins: Pins,
    /// The way on uneven ground; `None` on a plane.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    course: Option<Course>,
}

/// Complete state of an environment, from which it continues with the same bits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EnvState {
    sim: SimState,
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
    /// The robot cannot be read, or an observation is invalid.
    pub fn new(config: &Config) -> Result<Self, TrainError> {
        let critic = config.critic_layout().map_err(ValueError::Critic)?;
        Ok(Shared {
            robot: config.robot.load()?,
            layout: Arc::new(config.layout().map_err(ValueError::Observation)?),
            critic: critic.map(Arc::new),
            fields: config.terrain.as_ref().map(|terrain| Kind::ALL.map(|kind| Arc::new(terrain.field(kind)))),
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
/// use supple::task::Curriculum;
/// use supple::train::environment::LocomotionEnv;
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
    /// The reward's settings on the ground of this environment.
    reward: Reward,
    /// Number of levels of uneven ground; `None` on a plane.
    levels: Option<usize>,
    nominal: Joints,
    seed: u64,
    index: u64,
    sim: Sim,
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
        let uneven = terrain.and_then(|(terrain, fields)| Some((terrain, &fields[terrain.kind(index)? as usize])));
        let (mut scene, mut reward) =
            (Scene::flat(Arc::clone(&shared.robot), config.simulation.timestep_s()), config.reward.clone());
        if let Some((terrain, field)) = uneven {
            scene.lists_pairs = true;
            (scene.ground, scene.buffers) = (Ground::Field(HeightField::clone(field)), terrain::BUFFERS);
            reward.tracking_sharpness *= terrain.sharpness_factor;
        }
        let levels = uneven.map(|(terrain, _)| terrain.levels);
        let sim = Sim::new(&scene, &config.simulation, config.episode.min_height_m)?;
        let stages = Stages::new(&config.episode, &config.simulation);
        let nominal = config.action.nominal_pose_rad.joints();
        let cut = first_cut(seed, index, &stages);
        let mut env = LocomotionEnv {
            progress: start(config, seed, index, 0, curriculum, cut, levels.map(|_| Course::new(0))),
            config: config.clone(),
            reward,
            levels,
            shared: shared.clone(),
            stages,
            nominal,
            seed,
            index,
            last_second: LastSecond::new(
                config.simulation.policy_rate_hz as usize,
                sim.data().model().nq(),
                sim.data().model().nv(),
            ),
            sim,
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
        if let Some(dynamics) = &self.progress.plan.dynamics {
            self.sim.set_dynamics(dynamics)?;
        }
        if let (Some(course), Some(terrain)) = (self.progress.course, &self.config.terrain) {
            self.sim.set_start(terrain.start(course.level));
        }
        self.sim.reset(self.progress.plan.conditions, &self.nominal)?;
        self.last_second.clear();
        let state = self.sim.state();
        self.progress.swings = SwingTracker::new(&state.feet, self.config.reward.foot_height_m);
        self.observe(&state, [Vector3::zeros(); 4]);
        Ok(())
    }

    /// Measures the observations of policy and critic; `foot_forces` are means over the last policy step, world frame
    /// \[N\].
    fn observe(&mut self, state: &RobotState, foot_forces: [Vector3<f64>; 4]) {
        let privileged = self.shared.critic.is_some().then(|| self.privileged(state, foot_forces));
        let p = &mut self.progress;
        let seen = p.plan.imu.map(|imu| {
            let mut rng = stream(self.seed, Purpose::Imu, self.index, p.episode << 24 | p.step as u64);
            imu.seen(state, &mut rng)
        });
        let now = Moment {
            state: seen.as_ref().unwrap_or(state),
            command: &p.plan.command,
            last_action: &p.last_action,
            last_target: &p.last_target,
            nominal: &self.nominal,
            time_s: p.step as f64 * self.config.simulation.policy_period_s(),
            privileged: Privileged::default(),
        };
        p.observer.measure(&self.shared.layout, &now);
        if let (Some(layout), Some(privileged)) = (&self.shared.critic, privileged) {
            p.critic_observer.measure(layout, &Moment { state, privileged, ..now });
        }
    }

    /// Returns what only the simulator knows before the coming policy step.
    fn privileged(&self, state: &RobotState, foot_forces: [Vector3<f64>; 4]) -> Privileged {
        let p = &self.progress;
        let base_from_world = state.world_from_base.inverse();
        let [x, y] = p.plan.force(p.step as f64 * self.config.simulation.policy_period_s());
        let dynamics = p.plan.dynamics;
        let push = p.plan.push.filter(|_| p.step == self.stages.recovery_start).unwrap_or_default();
        Privileged {
            foot_forces: foot_forces.map(|force| base_from_world * force),
            friction: p.plan.conditions.friction,
            encoder_bias: p.plan.conditions.encoder_bias,
            pull: base_from_world * Vector3::new(x, y, 0.0),
            push: base_from_world * (state.heading() * Vector3::new(push.linear[0], push.linear[1], 0.0)),
            trunk_mass_kg: dynamics.map_or(0.0, |dynamics| dynamics.trunk_mass_kg),
            trunk_offset_m: dynamics.map_or([0.0; 3], |dynamics| dynamics.trunk_offset_m).into(),
            latency_s: dynamics.map_or(self.config.simulation.latency_s, |dynamics| dynamics.latency_s),
        }
    }

    /// Returns the environment's index in the run.
    pub fn index(&self) -> u64 {
        self.index
    }

    /// Returns the memory of the simulation \[bytes\].
    pub fn simulation_bytes(&self) -> usize {
        let heights = match self.sim.ground() {
            Ground::Flat => 0,
            Ground::Field(field) => field.heights.len(),
        };
        self.sim.data().bytes() + heights * size_of::<f64>()
    }

    /// Returns the random part of this episode: command, conditions, push and pulls.
    pub fn plan(&self) -> &EpisodePlan {
        &self.progress.plan
    }

    /// Returns the velocity command of the episode.
    pub fn command(&self) -> &Command {
        &self.progress.plan.command
    }

    /// Returns the layout of the observation.
    pub fn layout(&self) -> &Layout {
        &self.shared.layout
    }

    /// Returns the numbers of inputs of the policy and of the value function.
    pub fn inputs(&self) -> [usize; 2] {
        self.shared.inputs()
    }

    /// Returns the layout of what the critic observes in addition; `None` if it observes what the policy does.
    pub fn critic_layout(&self) -> Option<&Layout> {
        self.shared.critic.as_deref()
    }

    /// Returns the present observation in physical units, shape (length of the layout).
    pub fn observation(&self) -> Vec<f64> {
        self.progress.observer.raw(&self.shared.layout)
    }

    /// Writes the present observation, normalised for the networks, into a slice of the layout's length.
    pub fn normalised_observation(&self, out: &mut [f32]) {
        self.progress.observer.normalised(&self.shared.layout, out);
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
                let fault = EpisodeFault {
                    error: error.to_string(),
                    environment: self.index,
                    episode: self.progress.episode,
                    step: self.progress.step,
                    last_second: self.last_second.csv(),
                };
                let stage = self.stages.at(self.progress.step);
                let step = EnvStep { reward: 0.0, end: Some(EpisodeEnd::Fault), stage, terms: Terms::default() };
                (step, Some(self.report(EpisodeEnd::Fault, Some(Box::new(fault)))))
            }
        }
    }

    fn try_step(&mut self, action: &[f32]) -> mujoco::Result<(EnvStep, Option<EpisodeReport>)> {
        let scale = self.config.action.scale_rad;
        let target: Joints =
            std::array::from_fn(|joint| joint_target(self.nominal[joint], scale, f64::from(action[joint])));
        self.last_second.note(self.sim.data().positions(), self.sim.data().velocities(), &target);
        let stage = self.stages.at(self.progress.step);
        let mut from_outside = Vector3::zeros();
        if self.progress.step == self.stages.recovery_start {
            // Without a push the episode ended with the step before.
            if let Some(push) = &self.progress.plan.push {
                let [forward, left] = push.linear;
                let impulse =
                    self.sim.robot().mass_kg * (self.sim.state().heading() * Vector3::new(forward, left, 0.0));
                from_outside += impulse / self.config.simulation.policy_period_s();
                self.sim.push(push)?;
                self.progress.pushed = true;
            }
        }
        if self.config.pulls.is_some() {
            let time_s = self.progress.step as f64 * self.config.simulation.policy_period_s();
            let force = self.progress.plan.force(time_s);
            let pull = Vector3::new(force[0], force[1], 0.0);
            self.sim.set_trunk_force(pull);
            from_outside += pull;
        }
        let EpisodeState { plan, step, swings, pins, .. } = &mut self.progress;
        let period_s = self.config.simulation.policy_period_s();
        let held_feet = self.config.held_feet.as_ref().map(|held| {
            let spring = HoldSpring { force_n: held.force_n, stiffness_n_per_m: held.stiffness_n_per_m };
            HeldFeet::new(&plan.holds, *step as f64 * period_s, spring, pins)
        });
        let foot_forces = self.shared.critic.is_some().then(FootForces::default);
        let mut meter = StepMeter { swings, foot_forces, held_feet };
        let summary = self.sim.step(&target, &mut meter)?;
        let foot_forces = meter.foot_forces.map_or([Vector3::zeros(); 4], |forces| forces.mean());
        let mut state = self.sim.state();
        // What an observer of forces would find, without its cost.
        let felt = state.heading().inverse() * from_outside;
        state.felt_force = Some([felt.x, felt.y]);

        let p = &mut self.progress;
        let landings = p.swings.take();
        let step = reward::RewardInput {
            state: &state,
            command: &p.plan.command,
            summary: &summary,
            landings: &landings,
            config: &self.reward,
        };
        let terms = Terms::new(&step);
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
        let reward = paid.total(&self.reward);
        p.reward += reward;
        p.step += 1;
        if let Some(course) = &mut p.course {
            course.advance(&state, &p.plan.command, period_s, summary.fall.is_some());
        }
        p.last_action = std::array::from_fn(|joint| f64::from(action[joint]));
        p.last_target = target;
        self.observe(&state, foot_forces);

        let end = self.end(summary.fall.is_some());
        let report = end.map(|end| self.report(end, None));
        Ok((EnvStep { reward, end, stage, terms }, report))
    }

    fn end(&self, fell: bool) -> Option<EpisodeEnd> {
        let p = &self.progress;
        let last = if p.plan.push.is_some() { self.stages.end } else { self.stages.recovery_start };
        if fell {
            Some(EpisodeEnd::Fall)
        } else if p.step >= last.min(p.cut) {
            Some(EpisodeEnd::TimeLimit)
        } else {
            None
        }
    }

    fn report(&self, end: EpisodeEnd, fault: Option<Box<EpisodeFault>>) -> EpisodeReport {
        let p = &self.progress;
        let walked = p.step >= self.stages.recovery_start;
        EpisodeReport {
            end,
            steps: p.step,
            pushed: p.pushed,
            reward: p.reward,
            terms: p.terms,
            walking_linear: walked.then(|| p.walking.linear_velocity() / self.stages.recovery_start as f64),
            terrain_level: p.course.map(|course| course.level),
            swing_height_m: (p.swing_count > 0).then(|| p.swing_sum_m / p.swing_count as f64),
            fault,
        }
    }

    /// Returns the simulation, to be inspected or disturbed.
    pub fn sim_mut(&mut self) -> &mut Sim {
        &mut self.sim
    }

    /// Replaces the observation by another one of the same quantities.
    #[cfg(test)]
    pub(super) fn see(&mut self, layout: &Arc<Layout>) {
        self.shared.layout = Arc::clone(layout);
    }

    /// Returns the state from which the environment continues with the same bits.
    pub fn save(&self) -> EnvState {
        EnvState { sim: self.sim.save(), progress: self.progress.clone() }
    }

    /// Restores a saved state.
    ///
    /// # Errors
    /// The state belongs to another model or observation, or MuJoCo fails in it.
    pub fn restore(&mut self, state: &EnvState) -> mujoco::Result<()> {
        if let Some(dynamics) = &state.progress.plan.dynamics {
            self.sim.set_dynamics(dynamics)?;
        }
        self.sim.restore(&state.sim)?;
        self.last_second.clear();
        self.progress = state.progress.clone();
        let fits_critic = |layout: &Arc<Layout>| self.progress.critic_observer.fits(layout);
        if self.progress.observer.fits(&self.shared.layout) && self.shared.critic.as_ref().is_none_or(fits_critic) {
            Ok(())
        } else {
            let message = "it belongs to another observation".into();
            Err(mujoco::Error::Load { what: "a saved state".into(), message })
        }
    }
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
        step: 0,
        episode,
        cut,
        pushed: false,
        reward: 0.0,
        terms: Terms::default(),
        walking: Terms::default(),
        swings: SwingTracker::default(),
        swing_sum_m: 0.0,
        swing_count: 0,
        observer: Observer::new(),
        critic_observer: Observer::new(),
        last_action: [0.0; JOINTS],
        last_target: config.action.nominal_pose_rad.joints(),
        pins: Pins::default(),
        course,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{HeldFeet as HeldFeetRange, Pulls, Terrain};
    use crate::observation::{Observed, Quantity};
    use crate::sim::{Pull, Push};
    use crate::task::deviation::Hold;

    /// Returns an action of a clumsy trot.
    fn action(step: usize) -> [f32; 12] {
        std::array::from_fn(|joint| {
            let phase = step as f32 * 0.3 + if matches!(joint / 3, 0 | 3) { 0.0 } else { std::f32::consts::PI };
            0.8 * (phase + (joint % 3) as f32).sin()
        })
    }

    #[test]
    fn an_episode_tells_the_fraction_of_its_time_in_flight() {
        let mut config = Config::load("compliant").unwrap();
        config.episode.walking_s = 0.25;
        // From 0.5 m above the ground, a fall takes 0.32 s: longer than the episode.
        for (lifted_m, expected) in [(0.0, 0.0), (0.5, 1.0)] {
            let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
            env.reset(Curriculum::new(&config.command)).unwrap();
            env.sim_mut().data_mut().positions_mut()[2] += lifted_m;
            env.sim_mut().refresh().unwrap();
            let report = (0..15).find_map(|_| env.step(&[0.0; 12]).1).unwrap();
            assert_eq!((report.end, report.terms.flight()), (EpisodeEnd::TimeLimit, 15.0 * expected));
        }
    }

    #[test]
    fn a_restarted_environment_has_the_bits_of_a_new_one() {
        let mut config = Config::load("compliant").unwrap();
        config.episode.walking_s = 0.5;
        let curriculum = Curriculum::complete();
        let mut used = LocomotionEnv::new(&config, 1, 2, curriculum).unwrap();
        // Into the second episode, in the middle of a step's latency.
        for step in 0..40 {
            if used.step(&action(step)).0.end.is_some() {
                used.reset(curriculum).unwrap();
            }
        }
        used.restart(7, curriculum).unwrap();
        let mut new = LocomotionEnv::new(&config, 7, 2, curriculum).unwrap();
        for step in 0..150 {
            assert_eq!(used.observation(), new.observation(), "step {step}");
            let outcome = used.step(&action(step));
            assert_eq!(outcome, new.step(&action(step)), "step {step}");
            if outcome.0.end.is_some() {
                used.reset(curriculum).unwrap();
                new.reset(curriculum).unwrap();
            }
        }
    }

    #[test]
    fn without_stagger_the_first_episode_is_as_long_as_any() {
        let config = Config::load("compliant").unwrap();
        let steps = |staggered: bool| {
            let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::new(&config.command)).unwrap();
            if !staggered {
                env.without_stagger();
            }
            (0..200).find_map(|_| env.step(&[0.0; 12]).1).unwrap().steps
        };
        // 2 s at 60 Hz.
        assert_eq!(steps(false), 120);
        assert!(steps(true) < 120);
    }

    #[test]
    fn a_step_tells_its_stage_and_its_terms() {
        let config = Config::load("compliant").unwrap();
        let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
        let (mut terms, mut stages) = (Terms::default(), Vec::new());
        let report = loop {
            let (step, report) = env.step(&[0.0; 12]);
            terms.add(&step.terms);
            stages.push(step.stage);
            if let Some(report) = report {
                break report;
            }
        };
        assert_eq!((report.terms, report.steps), (terms, stages.len()));
        assert!(stages.iter().enumerate().all(|(step, stage)| *stage == env.stages.at(step)));
    }

    #[test]
    fn a_restored_environment_goes_on_with_the_same_bits_from_every_step() {
        let compliant = Config::load("compliant").unwrap();
        let with_pulls = Config { pulls: Some(pulls()), ..compliant.clone() };
        for (name, mut config) in [("plain", compliant), ("with pulls", with_pulls), ("with all", with_all())] {
            config.episode.walking_s = 0.5;
            let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
            // Somewhere else in another episode; its terrain and its sensor's noise are those of its index.
            let mut other = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
            other.reset(Curriculum::complete()).unwrap();
            for step in 0..200 {
                let json = serde_json::to_string(&env.save()).unwrap();
                other.restore(&serde_json::from_str(&json).unwrap()).unwrap();
                assert_eq!(env.save(), other.save(), "{name}, step {step}");
                let (outcome, report) = env.step(&action(step));
                assert_eq!((outcome, report), other.step(&action(step)), "{name}, step {step}");
                assert_eq!(env.observation(), other.observation(), "{name}, step {step}");
                if outcome.end.is_some() {
                    env.reset(Curriculum::complete()).unwrap();
                }
            }
        }
    }

    /// Returns a configuration whose critic observes what only the simulator knows.
    fn privileged(quantities: &[Quantity]) -> Config {
        let critic_observation = quantities.iter().copied().map(Observed::now).collect();
        let mut config = Config { critic_observation, ..Config::load("compliant").unwrap() };
        (config.episode.walking_s, config.episode.slope) = (0.5, 0.0);
        config
    }

    /// Returns what the critic observes in addition to the policy, of which a test lists the quantities unscaled.
    fn added(env: &LocomotionEnv) -> Vec<f32> {
        let [policy, both] = env.inputs();
        let mut seen = vec![0.0; both];
        env.critic_observation(&mut seen);
        let mut of_policy = vec![0.0; policy];
        env.normalised_observation(&mut of_policy);
        assert_eq!(seen[..policy], of_policy);
        seen.split_off(policy)
    }

    #[test]
    fn critic_sees_the_weight_on_the_feet_of_a_standing_robot() {
        let config = privileged(&[Quantity::FootForces, Quantity::FootHeights]);
        let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::new(&config.command)).unwrap();
        env.without_stagger();
        assert_eq!(added(&env)[..12], [0.0; 12]);
        (0..29).for_each(|_| drop(env.step(&[0.0; 12])));
        let seen = added(&env);
        let up: f32 = seen[..12].iter().skip(2).step_by(3).sum();
        let weight = (9.81 * env.sim.robot().mass_kg) as f32;
        assert!((up / weight - 1.0).abs() < 0.02, "{up} of {weight} N");
        assert!(seen[12..].iter().all(|height| height.abs() < 0.005), "{seen:?}");
    }

    #[test]
    fn critic_sees_the_push_when_it_comes_and_the_encoder_bias_always() {
        let mut config = privileged(&[Quantity::Push, Quantity::EncoderBias, Quantity::Friction]);
        config.randomisation.enabled = true;
        let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
        env.without_stagger();
        let plan = env.plan().clone();
        let ([forward, left], bias) = (plan.push.unwrap().linear, plan.conditions.encoder_bias);
        for step in 0..32 {
            let (seen, state) = (added(&env), env.sim.state());
            let size = seen[0].hypot(seen[1]).hypot(seen[2]);
            let expected = if step == 30 { forward.hypot(left) as f32 } else { 0.0 };
            assert!((size - expected).abs() < 1e-6, "step {step}: {size} instead of {expected}");
            assert_eq!(seen[3..15], bias.map(|bias| bias as f32));
            assert_eq!(seen[15], plan.conditions.friction as f32);
            if step == 30 {
                env.sim.push(&plan.push.unwrap()).unwrap();
                let change = env.sim.state().velocity_in_base - state.velocity_in_base;
                let expected = [change.x as f32, change.y as f32, change.z as f32];
                assert!((0..3).all(|k| (seen[k] - expected[k]).abs() < 1e-6), "{seen:?} {expected:?}");
            }
            env.step(&[0.0; 12]);
        }
    }

    #[test]
    fn critic_sees_the_pull_that_acts() {
        let mut config = privileged(&[Quantity::Pull]);
        config.pulls = Some(pulls());
        let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
        env.without_stagger();
        env.progress.plan.pulls = vec![Pull { from_s: 0.09, until_s: 0.19, force: [3.0, 4.0] }];
        // Steps begin every 1/60 s: 6 to 11 lie in between.
        for step in 0..20 {
            let size = added(&env).iter().map(|force| force * force).sum::<f32>().sqrt();
            let expected = if (6..12).contains(&step) { 5.0 } else { 0.0 };
            assert!((size - expected).abs() < 1e-5, "step {step}: {size}");
            env.step(&[0.0; 12]);
        }
    }

    /// Returns the configuration for a real robot with every option of ground and hands.
    fn with_all() -> Config {
        let mut config = Config::load("real").unwrap();
        config.pulls = Some(pulls());
        config.held_feet = Some(HeldFeetRange {
            force_n: 60.0,
            stiffness_n_per_m: 600.0,
            height_m: [0.02, 0.05],
            duration_s: [0.05, 0.15],
            gap_s: [0.1, 0.3],
        });
        config.terrain = Some(Terrain {
            environments: 1.0,
            levels: 3,
            rough_m: [0.01, 0.06],
            boxes_m: [0.02, 0.08],
            sharpness_factor: 0.33,
        });
        config
    }

    #[test]
    fn a_real_robot_is_heavier_or_later_as_its_plan_says() {
        let mut config = Config::load("real").unwrap();
        config.episode.walking_s = 0.5;
        let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
        let mass = |env: &LocomotionEnv| env.sim.data().model().body_mass().iter().sum::<f64>();
        let nominal = LocomotionEnv::new(&Config::load("fast").unwrap(), 1, 0, Curriculum::complete()).unwrap();
        let mut differences = Vec::new();
        for _ in 0..4 {
            let dynamics = env.plan().dynamics.unwrap();
            assert!((mass(&env) - mass(&nominal) - dynamics.trunk_mass_kg).abs() < 1e-9);
            differences.push(dynamics.trunk_mass_kg);
            // The joint stays where it is until its target acts: the latency in steps of 1/240 s.
            let start = env.sim.state().joint_rates[2];
            let moved = (0..4).find(|_| {
                env.step(&[3.0; 12]);
                (env.sim.state().joint_rates[2] - start).abs() > 1.0
            });
            assert_eq!(moved, Some((dynamics.latency_s * 60.0).floor() as usize), "{dynamics:?}");
            env.reset(Curriculum::complete()).unwrap();
        }
        assert!(differences.windows(2).all(|pair| pair[0] != pair[1]));
    }

    #[test]
    fn policy_sees_inertial_errors_and_critic_does_not() {
        let mut config = privileged(&[Quantity::AngularVelocity]);
        config.randomisation.enabled = true;
        config.randomisation.gyro_bias_sd_rad_s = 0.1;
        let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
        let bias = env.plan().imu.unwrap().gyro_bias_rad_s;
        for step in 0..20 {
            let (seen, true_rate) = (env.observation(), env.sim.state().angular_velocity_in_base);
            // Left, up, forward, after height, gravity, joint angles and velocity.
            for (k, axis) in [1, 2, 0].into_iter().enumerate() {
                assert!((seen[46 + 19 + k] - true_rate[axis] - bias[axis]).abs() < 1e-12, "step {step}");
                assert_eq!(added(&env)[axis], true_rate[axis] as f32);
            }
            env.step(&action(step));
        }
    }

    #[test]
    fn a_held_foot_stays_behind_until_it_is_lifted() {
        let mut config = with_all();
        (config.terrain, config.randomisation.enabled, config.episode.slope) = (None, false, 0.0);
        let swung_m = |height_m: f64| {
            let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
            env.without_stagger();
            env.progress.plan.pulls.clear();
            env.progress.plan.holds = vec![Hold { leg: 0, from_s: 0.0, until_s: 1.0, height_m }];
            let place = |env: &LocomotionEnv| env.sim.parts().foot_centres(env.sim.data())[0];
            let start = place(&env);
            // The front right foot is lifted, then swung forward.
            for step in 0..16 {
                let mut action = [0.0; 12];
                (action[1], action[2]) = if step < 6 { (0.6, -1.2) } else { (-1.6, -1.2) };
                env.step(&action);
            }
            place(&env)[0] - start[0]
        };
        let (free, held) = (swung_m(0.0), swung_m(0.3));
        assert!(free > 0.05 && held < 0.6 * free, "{free} {held}");
    }

    #[test]
    fn every_level_of_the_terrain_starts_on_its_own_tile() {
        let config = with_all();
        let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
        for level in [0, 1, 2] {
            assert_eq!(env.progress.course.unwrap().level, level);
            let position = env.sim.state().position;
            assert!((position.x - 8.0 * (level as f64 - 1.0)).abs() < 1e-9 && position.y == 0.0);
            assert!((env.sim.state().height - env.sim.robot().stand[2]).abs() < 1e-9);
            assert_eq!(env.reward.tracking_sharpness, 0.33 * config.reward.tracking_sharpness);
            // As if it had walked where it should.
            let mut course = Course::new(level);
            let state = RobotState { velocity_in_base: Vector3::x(), ..RobotState::default() };
            course.advance(&state, &Command::velocity(1.0, 0.0, 0.0), 1.0, false);
            env.progress.course = Some(course);
            assert_eq!(env.report(EpisodeEnd::TimeLimit, None).terrain_level, Some(level));
            env.reset(Curriculum::complete()).unwrap();
        }
    }

    fn pulls() -> Pulls {
        Pulls {
            force_n: 50.0,
            duration_s: [0.5, 2.5],
            gap_s: [0.2, 1.5],
            fraction_step: 0.001,
            fraction_gate: 0.8,
            buckets: Vec::new(),
        }
    }

    #[test]
    fn pulls_and_pushes_are_felt_in_the_step_in_which_they_act() {
        let observation = vec![Observed::now(Quantity::FeltForce)];
        let mut config = Config { pulls: Some(pulls()), observation, ..Config::load("fast").unwrap() };
        config.episode.slope = 0.0;
        let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
        env.without_stagger();
        env.progress.plan.pulls = vec![Pull { from_s: 0.01, until_s: 0.1, force: [3.0, -4.0] }];
        env.progress.plan.push = Some(Push { linear: [0.01, 0.2], angular: [0.0; 3] });
        let felt = |env: &mut LocomotionEnv| {
            env.step(&[0.0; 12]);
            let [forward, left, _] = *env.observation().first_chunk().unwrap();
            [forward, left]
        };
        assert_eq!(felt(&mut env), [0.0; 2]);
        // The heading has hardly changed.
        let [forward, left] = felt(&mut env);
        assert!((forward - 3.0).abs() < 0.1 && (left + 4.0).abs() < 0.1, "{forward}, {left}");
        while env.progress.step < env.stages.recovery_start {
            felt(&mut env);
        }
        // 13.1 kg · 0.01 m/s · 60 /s, and beyond what is observed.
        let [forward, left] = felt(&mut env);
        assert!((forward - 7.86).abs() < 0.5 && left == 100.0, "{forward}, {left}");
    }

    #[test]
    fn a_pull_moves_the_trunk() {
        let mut config = Config { pulls: Some(pulls()), ..Config::load("fast").unwrap() };
        (config.command.forward_m_s, config.command.left_m_s, config.episode.slope) = (0.0, 0.0, 0.0);
        let left_m = |force: [f64; 2]| {
            let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
            env.progress.plan.pulls = vec![Pull { from_s: 0.0, until_s: 10.0, force }];
            (0..30).for_each(|_| drop(env.step(&[0.0; 12])));
            env.sim.state().position.y
        };
        assert!(left_m([0.0, 20.0]) > left_m([0.0; 2]) + 0.001);
    }
}
