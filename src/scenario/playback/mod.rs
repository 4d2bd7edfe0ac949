//! Playback: plays a script with a controller, one policy step at a time. Start with `Playback::try_step`; `contact_meter`
//! measures forces within a step, `interventions` serves robots driven live.

mod contact_meter;
mod interventions;

use std::borrow::Cow;

use contact_meter::ContactMeter;
use nalgebra::Vector3;

use super::force_sense::ForceSense;
use super::rig::RigState;
use super::senses::Senses;
use super::spring::SpringState;
use super::{Goal, Script, Sensing, SensingError, TimedPush};
use crate::config::Config;
use crate::estimate::contact::ContactNetwork;
use crate::estimate::external_force::ExternalForces;
use crate::estimate::{SensorFault, SensorNoise};
use crate::mujoco::{self, Data, Object};
use crate::policy::Controller;
use crate::robot::{GRAVITY_M_S2, Joints, RobotState, joint_name};
use crate::scenario::trace::{Disturbance, Event, EventKind, Felt, Frame, Pose, Rope, Stretch, Trace};
use crate::sim::{Pull, Push, Sim, StepSummary};
use crate::task::{Command, Stage, Stages, SwingTracker, Terms, reward};

/// Time for which the arrow of a push stays in the frames \[s\].
const PUSH_SHOWN_S: f64 = 0.3;

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
    script: Cow<'a, Script>,
    config: Cow<'a, Config>,
    controller: Box<dyn Controller + 'a>,
    sim: Sim,
    state: RobotState,
    /// The present command; starts as the script's.
    command: Command,
    /// Interactive pushes to apply before the next step, heading frame.
    pushes_due: Vec<Push>,
    /// Interactive pull on the trunk: forward and left, heading frame \[N\].
    pull: Option<[f64; 2]>,
    /// True if the controller has to start from the current state in the next step.
    controller_must_begin: bool,
    /// The sensors; `None` if the controller sees the true state.
    pub(super) senses: Option<Senses>,
    /// The observer of the forces from outside; `None` unless they are wanted.
    force_sense: Option<ForceSense>,
    /// The felt forces, low-passed.
    felt: ExternalForces,
    /// The true force on the trunk, low-passed alike.
    true_force: ExternalForces,
    /// Impulse of the pushes in this step, world frame [N·s].
    push_impulse: Vector3<f64>,
    with_bodies: bool,
    step: usize,
    steps: usize,
    pushes_done: usize,
    shown_push: Option<(f64, Vector3<f64>)>,
    /// Time \[s\] and text of the last disturbance.
    last_disturbance: Option<(f64, String)>,
    script_pull_is_on: bool,
    /// Force of the interactive pull in the last step, world frame \[N\].
    pull_force: Option<Vector3<f64>>,
    fallen_since: Option<usize>,
    /// True while the script's clock is held at zero.
    clock_is_held: bool,
    failed: bool,
    spring: Option<SpringState>,
    rig: Option<RigState>,
    /// The body from which the distance to the goal is measured.
    goal_from: Option<usize>,
    passed_goal_since: Option<usize>,
    swings: SwingTracker,
}

impl<'a> Playback<'a> {
    /// Compiles the scene. `config` provides the rates, gains and latency of the robot, and the reward of the frames.
    ///
    /// # Errors
    /// The scene does not compile, or MuJoCo fails in the starting state.
    pub fn new(script: &'a Script, config: &'a Config, controller: Box<dyn Controller + 'a>) -> mujoco::Result<Self> {
        Self::of(Cow::Borrowed(script), Cow::Borrowed(config), controller)
    }

    /// Like [`Playback::new`], but takes ownership of script and configuration.
    ///
    /// # Errors
    /// The scene does not compile, or MuJoCo fails in the starting state.
    pub fn owned(script: Script, config: Config, controller: Box<dyn Controller + 'a>) -> mujoco::Result<Self> {
        Self::of(Cow::Owned(script), Cow::Owned(config), controller)
    }

    fn of(
        script: Cow<'a, Script>,
        config: Cow<'a, Config>,
        controller: Box<dyn Controller + 'a>,
    ) -> mujoco::Result<Self> {
        let mut sim = Sim::new(&script.scene, &config.simulation, config.episode.min_height_m)?;
        sim.reset(script.conditions, &controller.rest())?;
        let state = sim.state();
        let playback = Playback {
            steps: config.simulation.policy_steps(script.duration_s),
            controller,
            command: script.command,
            pushes_due: Vec::new(),
            pull: None,
            controller_must_begin: true,
            senses: None,
            force_sense: None,
            felt: ExternalForces::default(),
            true_force: ExternalForces::default(),
            push_impulse: Vector3::zeros(),
            with_bodies: false,
            step: 0,
            pushes_done: 0,
            shown_push: None,
            last_disturbance: None,
            script_pull_is_on: false,
            pull_force: None,
            fallen_since: None,
            clock_is_held: false,
            failed: false,
            spring: script.spring.as_ref().map(|_| SpringState::new(&sim)).transpose()?,
            rig: script.rig.as_ref().map(|rig| RigState::new(rig, &sim)).transpose()?,
            goal_from: goal_body(&script, &sim)?,
            passed_goal_since: None,
            swings: SwingTracker::new(&state.feet, config.reward.foot_height_m),
            state,
            sim,
            script,
            config,
        };
        if playback.command.compliance.is_some() || playback.controller.needs_felt_force() {
            playback.with_felt_forces()
        } else {
            Ok(playback)
        }
    }

    /// Observes the forces from outside, as a commanded compliance and some policies need (which switches this on by itself), and
    /// stores them in the frames. Call it before the first step.
    ///
    /// # Errors
    /// MuJoCo cannot compile the robot alone.
    pub fn with_felt_forces(mut self) -> mujoco::Result<Self> {
        if self.force_sense.is_none() {
            self.force_sense = Some(ForceSense::new(&self.sim, &self.script.conditions)?);
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
                let senses = Senses::new(network, noise, seed, &self.sim, &self.script.conditions, &rest)?;
                Ok(Playback { senses: Some(senses), ..self })
            }
        }
    }

    /// Returns a trace of this robot without frames.
    pub fn empty_trace(&self) -> Trace {
        let weight_n = self.sim.robot().mass_kg * GRAVITY_M_S2;
        Trace { period_s: self.sim.policy_period_s(), weight_n, ..Trace::default() }
    }

    /// Plays to the end and returns the trace.
    pub fn trace(self) -> Trace {
        let mut trace = self.empty_trace();
        for played in self {
            trace.events.extend(played.events);
            trace.frames.extend(played.frame);
        }
        trace
    }

    /// Plays one policy step: disturb, act, simulate, observe, record.
    fn try_step(&mut self, events: &mut Vec<Event>) -> Result<Frame, PlaybackFault> {
        self.disturb(self.time_s(), events)?;
        let target = self.act()?;
        let (summary, meter) = self.simulate(&target)?;
        self.step += 1;
        let outcome = self.observe(&summary, &meter, events)?;
        let frame = self.record(target, &summary, &meter, outcome);
        if self.clock_is_held {
            self.step = 0;
            self.sim.data_mut().set_time_s(0.0);
        }
        Ok(frame)
    }

    /// Returns the time at which the next step begins \[s\].
    fn time_s(&self) -> f64 {
        self.step as f64 * self.sim.policy_period_s()
    }

    /// Returns the controller's joint targets \[rad\], which are finite.
    fn act(&mut self) -> Result<Joints, PlaybackFault> {
        let estimated =
            self.senses.as_ref().map(|senses| RobotState { felt_force: self.state.felt_force, ..senses.state() });
        let known = estimated.as_ref().unwrap_or(&self.state);
        if std::mem::take(&mut self.controller_must_begin) {
            self.controller.begin(known);
        }
        let target = self.controller.joint_targets(known, &self.command);
        if let Some(joint) = target.iter().position(|target| !target.is_finite()) {
            return Err(PlaybackFault::Policy { joint, target: target[joint] });
        }
        if let Some(senses) = &mut self.senses {
            senses.act(&target);
        }
        Ok(target)
    }

    /// Runs the physics of one policy step.
    fn simulate(&mut self, target: &Joints) -> mujoco::Result<(StepSummary, ContactMeter<'static>)> {
        let mut meter = ContactMeter {
            swings: self.swings,
            pull: self.steady_force(),
            rope: self.rig.as_ref().map(RigState::tendon),
            senses: self.senses.as_mut(),
            force_sense: self.force_sense.as_mut(),
            spring: self.script.spring.as_ref().zip(self.spring.as_mut()),
            ..ContactMeter::default()
        };
        let summary = self.sim.step(target, &mut meter)?;
        Ok((summary, ContactMeter { senses: None, force_sense: None, spring: None, ..meter }))
    }

    /// Detects the events of the step: sensor faults, spring, reward, fall, rope and goal.
    fn observe(
        &mut self,
        summary: &StepSummary,
        meter: &ContactMeter<'_>,
        events: &mut Vec<Event>,
    ) -> Result<StepOutcome, SensorFault> {
        let time_s = self.time_s();
        if let Some(fault) = self.senses.as_mut().map_or(Ok(None), Senses::fault)? {
            let text = format!("sensors: {fault}; the others bridge it");
            events.push(Event { time_s, kind: EventKind::Disturbance, text });
        }
        let spring = self.spring.as_mut().zip(self.script.spring.as_ref()).and_then(|(state, spring)| {
            let (stretch, text) = state.after_step(spring)?;
            let event = |text: &str| Event { time_s, kind: EventKind::Disturbance, text: text.to_owned() };
            events.extend(text.map(event));
            Some(stretch)
        });
        self.state = self.sim.state();
        self.swings = meter.swings;
        let landings = self.swings.take();
        if let Some(event) = events.iter().rfind(|event| event.kind == EventKind::Disturbance) {
            self.last_disturbance = Some((event.time_s, event.text.clone()));
        }
        let terms = Terms::new(&reward::RewardInput {
            state: &self.state,
            command: &self.command,
            summary,
            landings: &landings,
            config: &self.config.reward,
        });
        self.look_for_fall(summary, time_s, events);
        let rope = self
            .rig
            .as_mut()
            .zip(self.script.rig.as_ref())
            .map(|(state, rig)| state.after_step(rig, &self.sim, time_s, meter.rope_forces, meter.touched, events));
        self.look_for_goal(time_s, events);
        self.feel(meter, rope.as_ref());
        Ok(StepOutcome { terms, spring, rope })
    }

    /// Takes in the felt forces of the step.
    fn feel(&mut self, meter: &ContactMeter<'_>, rope: Option<&Rope>) {
        let Some(force_sense) = &mut self.force_sense else { return };
        let felt = force_sense.take_mean();
        self.state.felt_force = felt.doubt.is_none().then_some([felt.force.x, felt.force.y]);
        let mut truth = meter.trunk_force / f64::from(meter.substeps.max(1));
        truth += std::mem::take(&mut self.push_impulse) / self.sim.policy_period_s();
        let rope = rope.filter(|_| self.script.rig.as_ref().is_some_and(|rig| rig.from.is_some()));
        if let Some((rope, [from, to])) = rope.and_then(|rope| Some((rope, rope.points.first_chunk::<2>()?))) {
            let along = Vector3::from(to.map(f64::from)) - Vector3::from(from.map(f64::from));
            truth += rope.force_n * along.try_normalize(1e-9).unwrap_or_default();
        }
        // Both through the same low-pass.
        let truth = ExternalForces { force: self.state.heading().inverse() * truth, ..ExternalForces::default() };
        let period_s = self.sim.policy_period_s();
        self.felt.follow(&felt, period_s);
        self.true_force.follow(&truth, period_s);
    }

    /// Builds the frame of the step that has just been played.
    fn record(
        &self,
        target: Joints,
        summary: &StepSummary,
        meter: &ContactMeter<'_>,
        StepOutcome { terms, spring, rope }: StepOutcome,
    ) -> Frame {
        let (time_s, period_s) = (self.time_s(), self.sim.policy_period_s());
        let substeps = f64::from(meter.substeps.max(1));
        let state = &self.state;
        let (roll, pitch, yaw) = state.roll_pitch_yaw();
        let data = self.sim.data();
        Frame {
            time_s,
            bodies: if self.with_bodies { poses(data) } else { Vec::new() },
            goal: self.goal_from.map(|body| pose(data, body)),
            command: self.command,
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
            torques: meter.torques,
            foot_positions: self.sim.parts().foot_centres(data),
            foot_heights: state.feet.map(|foot| foot.height),
            foot_forces: meter.foot_forces.map(|force| force.map(|value| value / substeps)),
            peak_foot_force_n: meter.peak_foot_force_n,
            peak_obstacle_force_n: meter.peak_obstacle_force_n,
            obstacle_impulse_n_s: meter.obstacle_force_sum_n * period_s / substeps,
            obstacle_contact_s: f64::from(meter.obstacle_substeps) * period_s / substeps,
            rope,
            spring,
            sensed: self.senses.as_ref().map(|senses| senses.sensed(state)),
            felt: self.force_sense.as_ref().map(|_| Felt {
                force: self.felt.force.into(),
                true_force: self.true_force.force.into(),
                feet: self.felt.feet.map(Into::into),
                doubt: self.felt.doubt,
            }),
            disturbance: self.disturbance(time_s, spring),
            stage: self.stage(time_s),
        }
    }

    /// Returns the matching stage of a training episode, for scripts with a single push.
    fn stage(&self, time_s: f64) -> Option<Stage> {
        let [push] = &self.script.pushes[..] else { return None };
        let stages = Stages::new(&self.config.episode, &self.config.simulation);
        let since_push = ((time_s - push.time_s) / self.sim.policy_period_s()).round() as i64;
        Some(stages.at((since_push + stages.recovery_start as i64 - 1).max(0) as usize))
    }

    /// Applies the disturbances that are due before the step that starts at `time_s`.
    fn disturb(&mut self, time_s: f64, events: &mut Vec<Event>) -> mujoco::Result<()> {
        let period_s = self.sim.policy_period_s();
        let due = |push: &&TimedPush| push.is_due(time_s, period_s);
        while let Some(push) = self.script.pushes.get(self.pushes_done).filter(due).map(|due| due.push) {
            self.pushes_done += 1;
            self.apply_push(&push, time_s, events)?;
        }
        for push in std::mem::take(&mut self.pushes_due) {
            self.apply_push(&push, time_s, events)?;
        }
        if let Some(pull) = self.script.pull {
            let active = pull.acts(time_s);
            if active != self.script_pull_is_on {
                self.script_pull_is_on = active;
                let force = self.steady_force();
                self.sim.set_trunk_force(force);
                let text = match active {
                    true => format!("pull: {:+.1} N forward, {:+.1} N left", pull.force[0], pull.force[1]),
                    false => "pull ends".to_owned(),
                };
                events.push(Event { time_s, kind: EventKind::Disturbance, text });
            }
        }
        if let (Some(state), Some(rig)) = (&mut self.rig, &self.script.rig) {
            state.before_step(rig, &self.script, &mut self.sim, time_s, events)?;
        }
        self.apply_pull(time_s, events);
        Ok(())
    }

    fn apply_push(&mut self, push: &Push, time_s: f64, events: &mut Vec<Event>) -> mujoco::Result<()> {
        let before = self.sim.state().velocity_in_world();
        self.sim.push(push)?;
        let change = self.sim.state().velocity_in_world() - before;
        self.shown_push = Some((time_s + PUSH_SHOWN_S, change));
        self.push_impulse += self.sim.robot().mass_kg * change;
        let [forward, left] = push.linear;
        let text = format!("push: {forward:+.2} m/s forward, {left:+.2} m/s left");
        events.push(Event { time_s, kind: EventKind::Disturbance, text });
        Ok(())
    }

    /// Applies the interactive pull, whose direction turns with the robot.
    fn apply_pull(&mut self, time_s: f64, events: &mut Vec<Event>) {
        let before = self.pull_force;
        self.pull_force =
            self.pull.map(|[forward, left]| self.sim.state().heading() * Vector3::new(forward, left, 0.0));
        if let Some(force) = self.pull_force.or(before.map(|_| Vector3::zeros())) {
            self.sim.set_trunk_force(force);
        }
        let text = match (before, self.pull) {
            (None, Some([forward, left])) => format!("pull: {forward:+.1} N forward, {left:+.1} N left"),
            (Some(_), None) => "pull ends".to_owned(),
            _ => return,
        };
        events.push(Event { time_s, kind: EventKind::Disturbance, text });
    }

    /// Adds an event at the first fall.
    fn look_for_fall(&mut self, summary: &StepSummary, time_s: f64, events: &mut Vec<Event>) {
        let (Some(fall), None, false) = (summary.fall, self.fallen_since, self.clock_is_held) else { return };
        self.fallen_since = Some(self.step);
        let after = self
            .last_disturbance
            .as_ref()
            .map_or(String::new(), |(since_s, what)| format!(", {:.2} s after: {what}", time_s - since_s));
        let text = format!("fell: {}{after}", self.sim.describe(fall));
        events.push(Event { time_s, kind: EventKind::Fall, text });
    }

    /// Adds an event when the robot first reaches the goal on its feet.
    fn look_for_goal(&mut self, time_s: f64, events: &mut Vec<Event>) {
        let (Some(goal), Some(from), None) = (&self.script.goal, self.goal_from, self.fallen_since) else { return };
        if !self.clock_is_held
            && self.passed_goal_since.is_none()
            && self.state.position.x > self.sim.data().body_positions()[3 * from] + goal.ahead_m
        {
            self.passed_goal_since = Some(self.step);
            if self.state.position.y.abs() < goal.half_width_m {
                events.push(Event { time_s, kind: EventKind::Success, text: goal.text.to_owned() });
            }
        }
    }

    /// Returns the present force on the trunk without that of the spring, world frame \[N\].
    fn steady_force(&self) -> Vector3<f64> {
        let pull = self.script.pull.filter(|_| self.script_pull_is_on);
        let pull = pull.map(|pull| Vector3::new(pull.force[0], pull.force[1], 0.0));
        pull.or(self.pull_force).unwrap_or_default()
    }

    /// Returns the disturbance to draw in the frame.
    fn disturbance(&self, time_s: f64, stretch: Option<Stretch>) -> Option<Disturbance> {
        if self.script_pull_is_on || self.pull_force.is_some() {
            return Some(Disturbance::Pull { force: self.steady_force().into() });
        }
        if let Some(acting) = self.script.spring.as_ref().zip(stretch).and_then(|(it, now)| it.disturbance(now.force_n))
        {
            return Some(acting);
        }
        let (until_s, velocity) = self.shown_push?;
        (time_s <= until_s).then(|| Disturbance::Push { velocity: velocity.into() })
    }

    /// Returns the simulation.
    pub fn sim(&self) -> &Sim {
        &self.sim
    }
}

impl Iterator for Playback<'_> {
    type Item = PlaybackStep;

    /// Plays one policy step; `None` after the script's end, a while after a fall or after its goal, or after a fault.
    fn next(&mut self) -> Option<PlaybackStep> {
        let is_after = |since: Option<usize>, time_s| {
            since.is_some_and(|since| self.step >= since + self.config.simulation.policy_steps(time_s))
        };
        let has_fallen = is_after(self.fallen_since, self.script.after_fall_s);
        let ends_there = self.script.goal.as_ref().is_some_and(|goal| goal.is_end);
        let is_there = ends_there && is_after(self.passed_goal_since, AFTER_GOAL_S);
        if has_fallen || is_there || self.failed || self.step >= self.steps {
            return None;
        }
        let mut events = Vec::new();
        match self.try_step(&mut events) {
            Ok(frame) => Some(PlaybackStep { frame: Some(frame), events }),
            Err(fault) => {
                let time_s = self.time_s();
                events.push(Event { time_s, kind: EventKind::Fault, text: fault.to_string() });
                self.failed = true;
                Some(PlaybackStep { frame: None, events })
            }
        }
    }
}

/// Parts of a frame besides the state, the summary and the contact meter.
struct StepOutcome {
    terms: Terms,
    spring: Option<Stretch>,
    rope: Option<Rope>,
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

impl TimedPush {
    /// Returns true if the push comes no later than the step that starts at `time_s`.
    fn is_due(&self, time_s: f64, period_s: f64) -> bool {
        self.time_s < time_s + 0.5 * period_s
    }
}

impl Pull {
    /// Returns true if the pull acts in the step that starts at `time_s`.
    fn acts(&self, time_s: f64) -> bool {
        (self.from_s..self.until_s).contains(&(time_s + 1e-9))
    }
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
