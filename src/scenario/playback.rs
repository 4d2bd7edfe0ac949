//! Playback: plays a script with a controller, one policy step at a time. Start with `Playback::try_step`. Commands, pushes, pulls
//! and resets during a playback serve robots that are driven live; they take effect with the next step.

use nalgebra::{Rotation2, Vector2};

use super::force_sense::{ForceMemory, ForceSense};
use super::senses::Senses;
use super::{Goal, Script, Sensing, SensingError};
use crate::config::Config;
use crate::estimate::contact::ContactNetwork;
use crate::estimate::external_force::ExternalForces;
use crate::estimate::{SensorFault, SensorNoise};
use crate::mujoco::{self, Data, Object};
use crate::policy::Controller;
use crate::robot::{GRAVITY_M_S2, Joints, RobotState, joint_name};
use crate::scenario::trace::{Event, EventKind, Felt, Frame, Pose, Trace};
use crate::sim::{Fall, Sim};
use crate::task::{Command, Stage, Stages};
use crate::world::{Disturbance, Push, World, WorldState, WorldStep};

/// Time played after the robot has reached the goal that ends the script \[s\].
const AFTER_GOAL_S: f64 = 1.0;

/// The result of one policy step of a playback.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaybackStep {
    /// The state after the step; `None` if the physics or the sensors failed.
    pub frame: Option<Frame>,
    /// Events that occurred in the step.
    pub events: Vec<Event>,
}

/// The undisturbed beginning of a script, step by step.
#[derive(Debug, Default)]
pub struct Beginning {
    /// The moments at which the steps begin.
    moments: Vec<Moment>,
    /// The frames of the steps.
    frames: Vec<Frame>,
}

/// A moment between two policy steps, from which a playback continues with the same bits.
#[derive(Debug)]
struct Moment {
    state: RobotState,
    world: WorldState,
    forces: Option<ForceMemory>,
    /// The felt forces and the true force, low-passed.
    felt: [ExternalForces; 2],
}

/// A script being played with a controller: an iterator over policy steps.
///
/// ```
/// use supple::policy::shipped;
/// use supple::scenario::{Playback, catalog::Scenario};
///
/// let agent = shipped::find("compliant")?;
/// let script = Scenario::named("walk", "{forward_m_s: 0.5, duration_s: 1.0}")?.script(0, &agent.config)?;
/// let steps: Vec<_> = Playback::new(&script, &agent.config, agent.controller())?.collect();
/// assert_eq!(steps.len(), 60); // 1 s at 60 Hz
/// let frame = steps[59].frame.as_ref().ok_or("the physics failed")?;
/// assert!(frame.position[0] > 0.1); // it has walked forward [m]
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Playback<'a> {
    script: Script,
    config: Config,
    controller: Box<dyn Controller + 'a>,
    world: World,
    /// The present command; starts as the script's.
    command: Command,
    /// Where commands alone would have led the robot, world frame \[m\]; `None` before the first step.
    set_point: Option<Vector2<f64>>,
    /// True if the controller has to start from the current state in the next step.
    controller_must_begin: bool,
    /// The sensors; `None` if the controller sees the true state.
    pub(super) senses: Option<Senses>,
    /// The observer of the forces from outside; `None` unless they are observed.
    force_sense: Option<ForceSense>,
    /// The felt forces, low-passed.
    felt: ExternalForces,
    /// The true force on the trunk, low-passed alike.
    true_force: ExternalForces,
    with_bodies: bool,
    /// Number of steps until the script's end.
    length: usize,
    /// Time \[s\] and text of the last disturbance.
    last_disturbance: Option<(f64, String)>,
    /// Number of steps before the fall.
    fallen_since: Option<usize>,
    /// True while the script's clock is held at zero.
    clock_is_held: bool,
    failed: bool,
    /// The body from which the distance to the goal is measured.
    goal_from: Option<usize>,
    passed_goal_since: Option<usize>,
}

impl<'a> Playback<'a> {
    /// Compiles the scene. `config` provides the rates, gains and latency of the robot, and the reward of the frames.
    ///
    /// # Errors
    /// The scene does not compile, or MuJoCo fails in the starting state.
    pub fn new(script: &Script, config: &Config, controller: Box<dyn Controller + 'a>) -> mujoco::Result<Self> {
        let mut world =
            World::new(&script.scene, &config.simulation, config.episode.min_height_m, config.reward.clone())?;
        world.begin(script.conditions, &controller.rest(), script.disturbances.iter().cloned())?;
        let playback = Playback {
            length: config.simulation.policy_steps(script.duration_s),
            controller,
            command: script.command,
            set_point: None,
            controller_must_begin: true,
            senses: None,
            force_sense: None,
            felt: ExternalForces::default(),
            true_force: ExternalForces::default(),
            with_bodies: false,
            last_disturbance: None,
            fallen_since: None,
            clock_is_held: false,
            failed: false,
            goal_from: goal_body(script, world.sim())?,
            passed_goal_since: None,
            world,
            script: script.clone(),
            config: config.clone(),
        };
        if playback.command.compliance.is_some() || playback.controller.needs_felt_force() {
            playback.with_felt_forces()
        } else {
            Ok(playback)
        }
    }

    /// Observes the external forces and stores them in the frames. It is always on for a commanded compliance and for policies that need
    /// it. Call it before the first step.
    ///
    /// # Errors
    /// MuJoCo cannot compile the robot alone.
    pub fn with_felt_forces(mut self) -> mujoco::Result<Self> {
        if self.force_sense.is_none() {
            self.force_sense = Some(ForceSense::new(self.world.sim(), &self.script.conditions)?);
        }
        Ok(self)
    }

    /// Stores the pose of every body in the frames; recordings need them, metrics do not.
    pub fn with_bodies(mut self) -> Self {
        self.with_bodies = true;
        self
    }

    /// Selects what the controller acts on (the true state by default); `seed` seeds the sensor noise. Call it before the
    /// first step.
    ///
    /// # Errors
    /// The sensors cannot start, for example because the contact network was trained for another physics rate.
    pub fn with_sensing(self, sensing: Sensing, seed: u64) -> Result<Self, SensingError> {
        match sensing {
            Sensing::True => Ok(self),
            Sensing::Estimated => {
                let (network, noise, rest) =
                    (ContactNetwork::shipped()?, SensorNoise::default(), self.controller.rest());
                let senses = Senses::new(network, noise, seed, self.world.sim(), &self.script.conditions, &rest)?;
                Ok(Playback { senses: Some(senses), ..self })
            }
        }
    }

    /// Returns a trace of this robot without frames.
    pub fn empty_trace(&self) -> Trace {
        let weight_n = self.sim().robot().mass_kg * GRAVITY_M_S2;
        Trace { period_s: self.sim().policy_period_s(), weight_n, ..Trace::default() }
    }

    /// Plays to the end and returns the trace.
    pub fn trace(self) -> Trace {
        let trace = self.empty_trace();
        self.trace_on(trace)
    }

    fn trace_on(self, mut trace: Trace) -> Trace {
        for played in self {
            trace.events.extend(played.events);
            trace.frames.extend(played.frame);
        }
        trace
    }

    /// Plays this script, which has no disturbances, to the end, and returns the beginning of scripts that differ only in disturbances.
    /// `None` if an event occurs.
    pub fn beginning(mut self) -> Option<Beginning> {
        let mut beginning = Beginning::default();
        for _ in 0..self.length {
            let (forces, felt) = (self.force_sense.as_mut().map(ForceSense::save), [self.felt, self.true_force]);
            let moment = Moment { state: self.world.state().clone(), world: self.world.save(), forces, felt };
            beginning.moments.push(moment);
            match self.next() {
                Some(PlaybackStep { frame: Some(frame), events }) if events.is_empty() => beginning.frames.push(frame),
                _ => return None,
            }
        }
        Some(beginning)
    }

    /// Plays to the end and returns the same trace as [`Playback::trace`], but takes the part before the first disturbance from
    /// `beginning`. It must be that of this script, configuration and policy, on the true state.
    ///
    /// # Errors
    /// MuJoCo fails in a state of the beginning.
    pub fn trace_after(mut self, beginning: &Beginning) -> mujoco::Result<Trace> {
        // One step early, so that rounding does not matter.
        let steps = (self.script.undisturbed_s() / self.sim().policy_period_s() - 1.0).max(0.0) as usize;
        let steps = steps.min(beginning.moments.len().saturating_sub(1));
        if steps == 0 {
            return Ok(self.trace());
        }
        let (before, now) = (&beginning.moments[..steps], &beginning.moments[steps]);
        self.controller.begin(&before[0].state);
        for moment in before {
            self.controller.joint_targets(&moment.state, &self.command);
        }
        self.controller_must_begin = false;
        self.world.go_on_from(&now.world)?;
        self.world.set_felt_force(now.state.felt_force);
        if let (Some(force_sense), Some(memory)) = (&mut self.force_sense, &now.forces) {
            force_sense.restore(memory);
        }
        [self.felt, self.true_force] = now.felt;
        let mut trace = self.empty_trace();
        trace.frames.extend_from_slice(&beginning.frames[..steps]);
        for frame in &mut trace.frames {
            frame.stage = self.stage(frame.time_s);
        }
        Ok(self.trace_on(trace))
    }

    /// Plays one policy step: act, step the world, feel, record.
    fn try_step(&mut self, events: &mut Vec<Event>) -> Result<Frame, PlaybackFault> {
        let command = self.led_back();
        let target = self.act(&command)?;
        let (senses, force_sense) = (&mut self.senses, &mut self.force_sense);
        let mut step = self.world.step(&target, &command, |data, parts, torques| {
            if let Some(senses) = senses {
                senses.read(data, parts);
            }
            if let Some(force_sense) = force_sense {
                // A fault is kept as a doubt beside the forces.
                let _ = force_sense.read(data, parts, torques, senses.as_ref());
            }
        })?;
        events.append(&mut step.events);
        if let Some(fault) = self.senses.as_mut().map_or(Ok(None), Senses::fault)? {
            events.push(Event::disturbance(
                self.world.time_s(),
                format!("sensors: {fault}; bridged by the other sensor"),
            ));
        }
        self.look_for_fall(step.summary.fall, events);
        self.look_for_goal(events);
        self.feel(&step);
        let frame = self.record(target, command, step);
        if self.clock_is_held {
            self.world.rewind_clock();
        }
        Ok(frame)
    }

    /// Moves the set point by the command, and returns the command that also leads the robot back to it.
    fn led_back(&mut self) -> Command {
        let (state, rate) = (self.world.state(), self.script.set_point_per_s);
        if rate == 0.0 {
            return self.command;
        }
        let (at, heading) = (state.position.xy(), Rotation2::new(state.roll_pitch_yaw().2));
        let command = Vector2::new(self.command.forward, self.command.left);
        let point = self.set_point.unwrap_or(at) + heading * command * self.sim().policy_period_s();
        self.set_point = Some(point);
        let back = command + heading.inverse() * (point - at) * rate;
        let range = &self.config.command;
        let within = |value: f64, most: f64, asked: f64| value.clamp(-most.max(asked.abs()), most.max(asked.abs()));
        Command {
            forward: within(back.x, range.forward_m_s, command.x),
            left: within(back.y, range.left_m_s, command.y),
            ..self.command
        }
    }

    /// Returns the controller's joint targets \[rad\], which are finite.
    fn act(&mut self, command: &Command) -> Result<Joints, PlaybackFault> {
        let state = self.world.state();
        let estimated =
            self.senses.as_ref().map(|senses| RobotState { felt_force: state.felt_force, ..senses.state() });
        let known = estimated.as_ref().unwrap_or(state);
        if std::mem::take(&mut self.controller_must_begin) {
            self.controller.begin(known);
        }
        let target = self.controller.joint_targets(known, command);
        if let Some(joint) = target.iter().position(|target| !target.is_finite()) {
            return Err(PlaybackFault::Policy { joint, target: target[joint] });
        }
        if let Some(senses) = &mut self.senses {
            senses.act(&target);
        }
        Ok(target)
    }

    /// Takes in the felt forces of the step.
    fn feel(&mut self, step: &WorldStep) {
        let Some(force_sense) = &mut self.force_sense else { return self.world.set_felt_force(None) };
        let felt = force_sense.take_mean();
        self.world.set_felt_force(felt.doubt.is_none().then_some([felt.force.x, felt.force.y]));
        // Both through the same low-pass.
        let truth = self.world.state().heading().inverse() * step.forces.trunk;
        let period_s = self.sim().policy_period_s();
        self.felt.follow(&felt, period_s);
        self.true_force.follow(&ExternalForces { force: truth, ..ExternalForces::default() }, period_s);
    }

    /// Builds the frame of the step that has just been played.
    fn record(&self, target: Joints, command: Command, step: WorldStep) -> Frame {
        let WorldStep { summary, terms, forces, rope, spring, mark, .. } = step;
        let (time_s, state, data) = (self.world.time_s(), self.world.state(), self.sim().data());
        let (roll, pitch, yaw) = state.roll_pitch_yaw();
        Frame {
            time_s,
            bodies: if self.with_bodies { poses(data) } else { Vec::new() },
            goal: self.goal_from.map(|body| pose(data, body)),
            command,
            velocity: state.velocity_in_base.into(),
            velocity_in_heading: state.velocity_in_heading().into(),
            position: state.position.into(),
            yaw_rate: state.angular_velocity_in_base.z,
            roll_pitch_yaw: [roll, pitch, yaw],
            height_m: state.height,
            power_w: summary.power_w,
            torque_n_m: summary.torque_n_m,
            reward: terms.total(&self.config.reward),
            terms,
            joint_angles: state.joint_angles,
            joint_targets: target,
            torques: forces.torques,
            foot_positions: self.sim().parts().foot_centres(data),
            foot_heights: state.feet.map(|foot| foot.height),
            foot_forces: forces.feet.map(Into::into),
            peak_foot_force_n: forces.peak_foot_n,
            peak_obstacle_force_n: forces.peak_obstacle_n,
            obstacle_impulse_n_s: forces.obstacle_impulse_n_s,
            obstacle_contact_s: forces.obstacle_contact_s,
            rope,
            spring,
            sensed: self.senses.as_ref().map(|senses| senses.sensed(state)),
            felt: self.force_sense.as_ref().map(|_| Felt {
                force: self.felt.force.into(),
                true_force: self.true_force.force.into(),
                feet: self.felt.feet.map(Into::into),
                doubt: self.felt.doubt,
            }),
            mark,
            stage: self.stage(time_s),
        }
    }

    /// Returns the matching stage of a training episode, for scripts with a single push.
    fn stage(&self, time_s: f64) -> Option<Stage> {
        let mut pushes = self.script.pushes();
        let (Some(push), None) = (pushes.next(), pushes.next()) else { return None };
        let stages = Stages::new(&self.config.episode, &self.config.simulation);
        let since_push = ((time_s - push.at_s) / self.sim().policy_period_s()).round() as i64;
        Some(stages.at((since_push + stages.recovery_start as i64 - 1).max(0) as usize))
    }

    /// Adds an event at the first fall, with the last disturbance before it.
    fn look_for_fall(&mut self, fall: Option<Fall>, events: &mut Vec<Event>) {
        if let Some(event) = events.iter().rfind(|event| event.kind == EventKind::Disturbance) {
            self.last_disturbance = Some((event.time_s, event.text.clone()));
        }
        let (Some(fall), None, false) = (fall, self.fallen_since, self.clock_is_held) else { return };
        self.fallen_since = Some(self.world.steps());
        let time_s = self.world.time_s();
        let after = self
            .last_disturbance
            .as_ref()
            .map_or(String::new(), |(since_s, what)| format!(", {:.2} s after: {what}", time_s - since_s));
        let text = format!("fell: {}{after}", self.sim().describe(fall));
        events.push(Event { time_s, kind: EventKind::Fall, text });
    }

    /// Adds an event when the robot first reaches the goal on its feet.
    fn look_for_goal(&mut self, events: &mut Vec<Event>) {
        let (Some(goal), Some(from), None) = (&self.script.goal, self.goal_from, self.fallen_since) else { return };
        let position = self.world.state().position;
        if !self.clock_is_held
            && self.passed_goal_since.is_none()
            && position.x > self.sim().data().body_positions()[3 * from] + goal.ahead_m
        {
            self.passed_goal_since = Some(self.world.steps());
            if position.y.abs() < goal.half_width_m {
                let time_s = self.world.time_s();
                events.push(Event { time_s, kind: EventKind::Success, text: goal.text.to_owned() });
            }
        }
    }

    /// Returns the simulation.
    pub fn sim(&self) -> &Sim {
        self.world.sim()
    }
}

impl<'a> Playback<'a> {
    methods! {
        /// Returns the present command.
        fn command(&self) -> &Command = &self.command;
        /// Pulls the trunk with a constant force, forward and left in the heading frame \[N\]; `None` ends the pull.
        fn pull(&mut self, force: Option<[f64; 2]>) = self.world.pull_by_hand(force);
        /// Returns true if physics or sensors have failed; then only [`Playback::restart`] helps.
        fn has_failed(&self) -> bool = self.failed;
    }

    /// Changes the command from the next step on. A commanded compliance needs [`Playback::with_felt_forces`] from the start.
    pub fn ask(&mut self, command: Command) {
        self.command = command;
    }

    /// Pushes the trunk at the next step: change of velocity, forward and left in the heading frame [m/s].
    pub fn push(&mut self, linear: [f64; 2]) {
        let at_s = self.world.time_s();
        // A push needs no part of the scene.
        let _ = self.world.disturb(Disturbance::Push(Push { at_s, linear, ..Push::default() }));
    }

    /// Holds the script's clock at zero, for a robot that first has to get up: until it is released, there are no disturbances
    /// of the script, no falls and no goal.
    pub fn hold_clock(&mut self, hold: bool) {
        self.clock_is_held = hold;
    }

    /// Replaces the controller without changing the robot's state.
    pub fn hand_over(&mut self, controller: Box<dyn Controller + 'a>) {
        self.controller = controller;
        self.controller_must_begin = true;
    }

    /// Sets the robot on its feet at its present place and heading: see [`Sim::set_on_feet`](crate::sim::Sim::set_on_feet).
    ///
    /// # Errors
    /// MuJoCo fails in the new state.
    pub fn set_on_feet(&mut self) -> mujoco::Result<()> {
        self.world.set_on_feet(&self.controller.rest())?;
        self.begin_again();
        Ok(())
    }

    /// Resets robot and scene to their start. Time continues; the script's own disturbances are not repeated.
    ///
    /// # Errors
    /// MuJoCo fails in the starting state.
    pub fn restart(&mut self) -> mujoco::Result<()> {
        self.world.restart(self.script.conditions, &self.controller.rest())?;
        self.passed_goal_since = None;
        self.begin_again();
        Ok(())
    }

    fn begin_again(&mut self) {
        if let Some(force_sense) = &mut self.force_sense {
            force_sense.reset(self.world.sim(), &self.script.conditions);
        }
        (self.felt, self.true_force) = Default::default();
        self.set_point = None;
        self.fallen_since = None;
        self.failed = false;
        self.last_disturbance = None;
        self.controller_must_begin = true;
    }
}

impl Iterator for Playback<'_> {
    type Item = PlaybackStep;

    /// Plays one policy step; `None` after the script's end, a while after a fall or after its goal, or after a fault.
    fn next(&mut self) -> Option<PlaybackStep> {
        let is_after = |since: Option<usize>, time_s| {
            since.is_some_and(|since| self.world.steps() >= since + self.config.simulation.policy_steps(time_s))
        };
        let has_fallen = is_after(self.fallen_since, self.script.after_fall_s);
        let ends_there = self.script.goal.as_ref().is_some_and(|goal| goal.is_end);
        let is_there = ends_there && is_after(self.passed_goal_since, AFTER_GOAL_S);
        if has_fallen || is_there || self.failed || self.world.steps() >= self.length {
            return None;
        }
        let mut events = Vec::new();
        match self.try_step(&mut events) {
            Ok(frame) => Some(PlaybackStep { frame: Some(frame), events }),
            Err(fault) => {
                let time_s = self.world.time_s();
                events.push(Event { time_s, kind: EventKind::Fault, text: fault.to_string() });
                self.failed = true;
                Some(PlaybackStep { frame: None, events })
            }
        }
    }
}

/// The reason why a step has no frame.
#[derive(Debug, thiserror::Error)]
enum PlaybackFault {
    #[error(transparent)]
    Physics(#[from] mujoco::Error),
    #[error("the sensors failed: {0}")]
    Sensors(#[from] SensorFault),
    #[error("the policy fails: its joint target of {} is {target}, expected a finite angle", joint_name(*joint))]
    Policy { joint: usize, target: f64 },
}

/// Returns the body from which the distance to the script's goal is measured.
fn goal_body(script: &Script, sim: &Sim) -> mujoco::Result<Option<usize>> {
    let body = |goal: &Goal| goal.from.map_or(Ok(0), |name| sim.data().model().id(Object::Body, name));
    script.goal.as_ref().map(body).transpose()
}

fn array<const N: usize>(values: &[f64]) -> [f64; N] {
    std::array::from_fn(|k| values[k])
}

fn poses(data: &Data) -> Vec<Pose> {
    (0..data.model().count(Object::Body)).map(|body| pose(data, body)).collect()
}

fn pose(data: &Data, body: usize) -> Pose {
    Pose {
        position: array::<3>(&data.body_positions()[3 * body..]).map(|value| value as f32),
        quaternion: array::<4>(&data.body_quaternions()[4 * body..]).map(|value| value as f32),
    }
}
