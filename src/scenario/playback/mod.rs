//! Plays a script with a controller, one policy step at a time.

mod contact_meter;
mod interventions;

use std::borrow::Cow;

use contact_meter::ContactMeter;
use nalgebra::Vector3;

use super::rig::RigState;
use super::senses::Senses;
use super::spring::SpringState;
use super::{Goal, Script, Sensing, SensingError, TimedPush};
use crate::config::Config;
use crate::estimate::contact::ContactNetwork;
use crate::estimate::{SensorFault, SensorNoise};
use crate::mujoco::{self, Data, Kind};
use crate::policy::Controller;
use crate::robot::{GRAVITY_M_S2, Joints, RobotState};
use crate::scenario::trace::{Disturbance, Event, EventKind, Frame, Pose, Rope, Stretch, Trace};
use crate::sim::{Pull, Push, Sim, StepSummary};
use crate::task::{Command, Stage, Stages, SwingTracker, Terms, reward};

/// How long a push's arrow stays in the frames \[s\].
const PUSH_SHOWN_S: f64 = 0.3;

/// What is still played once the robot is where the script ends \[s\].
const AFTER_GOAL_S: f64 = 1.0;

/// What one step of a rollout brought.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaybackStep {
    /// The state after the step; none if the physics or the sensors failed in it.
    pub frame: Option<Frame>,
    /// What happened in it.
    pub events: Vec<Event>,
}

/// A script being played.
pub struct Playback<'a> {
    script: Cow<'a, Script>,
    config: Cow<'a, Config>,
    controller: Box<dyn Controller + 'a>,
    sim: Sim,
    state: RobotState,
    /// Of the script, until somebody asks for something else.
    command: Command,
    /// Pushes that are not the script's, due before the next step: heading frame.
    pushes_due: Vec<Push>,
    /// Force of a hand at the trunk: forward and left, heading frame \[N\].
    pull_in_heading: Option<[f64; 2]>,
    /// Whether the controller has to forget the past before the next step.
    starts_afresh: bool,
    /// None if the controller sees the true state.
    pub(super) senses: Option<Senses>,
    with_bodies: bool,
    step: usize,
    steps: usize,
    pushes_done: usize,
    shown_push: Option<(f64, Vector3<f64>)>,
    /// When the last disturbance came \[s\], and what it was.
    last_disturbance: Option<(f64, String)>,
    script_pulls: bool,
    /// The force of the hand in the last step, world frame \[N\].
    pull_in_world: Option<Vector3<f64>>,
    fallen_since: Option<usize>,
    failed: bool,
    spring: Option<SpringState>,
    rig: Option<RigState>,
    /// The body from which the way to the goal is measured.
    goal_from: Option<usize>,
    passed_goal_since: Option<usize>,
    swings: SwingTracker,
}

impl<'a> Playback<'a> {
    /// Sets the scene. `config` has the rates, gains and latency that the robot runs with, and the reward that frames
    /// are rated by.
    ///
    /// # Errors
    /// A fault of MuJoCo, such as a scene that does not compile.
    pub fn new(script: &'a Script, config: &'a Config, controller: Box<dyn Controller + 'a>) -> mujoco::Result<Self> {
        Self::of(Cow::Borrowed(script), Cow::Borrowed(config), controller)
    }

    /// As [`Playback::new`], to keep.
    ///
    /// # Errors
    /// As [`Playback::new`].
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
        Ok(Playback {
            steps: config.simulation.policy_steps(script.duration_s),
            controller,
            command: script.command,
            pushes_due: Vec::new(),
            pull_in_heading: None,
            starts_afresh: true,
            senses: None,
            with_bodies: false,
            step: 0,
            pushes_done: 0,
            shown_push: None,
            last_disturbance: None,
            script_pulls: false,
            pull_in_world: None,
            fallen_since: None,
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
        })
    }

    /// Keeps the pose of every body in the frames: recordings need them, metrics do not.
    pub fn with_bodies(mut self) -> Self {
        self.with_bodies = true;
        self
    }

    /// Decides what the controller acts on, before the first step; the sensors' noise is drawn from `seed`. Without this
    /// call it is the true state.
    ///
    /// # Errors
    /// [`SensingError`], as for rates that the contact network was not trained for.
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

    /// A trace without frames yet.
    pub fn empty_trace(&self) -> Trace {
        let weight_n = self.sim.robot().mass_kg * GRAVITY_M_S2;
        Trace { period_s: self.sim.policy_period_s(), weight_n, ..Trace::default() }
    }

    /// Plays to the end.
    pub fn trace(self) -> Trace {
        let mut trace = self.empty_trace();
        for played in self {
            trace.events.extend(played.events);
            trace.frames.extend(played.frame);
        }
        trace
    }

    /// One policy step: disturb, act, simulate, observe, record.
    fn try_step(&mut self, events: &mut Vec<Event>) -> Result<Frame, PlaybackFault> {
        self.disturb(self.time_s(), events)?;
        let target = self.act();
        let (summary, meter) = self.simulate(&target)?;
        self.step += 1;
        let observed = self.observe(&summary, meter, events)?;
        let frame = self.record(target, &summary, &observed);
        self.state = observed.state;
        Ok(frame)
    }

    /// The time at which the next policy step starts \[s\].
    fn time_s(&self) -> f64 {
        self.step as f64 * self.sim.policy_period_s()
    }

    /// Asks the controller for joint targets \[rad\], on the true state or on what the sensors give.
    fn act(&mut self) -> Joints {
        let sensed = self.senses.as_ref().map(Senses::state);
        let state = sensed.as_ref().unwrap_or(&self.state);
        if std::mem::take(&mut self.starts_afresh) {
            self.controller.begin(state);
        }
        let target = self.controller.joint_targets(state, &self.command);
        if let Some(senses) = &mut self.senses {
            senses.act(&target);
        }
        target
    }

    /// Simulates one policy step towards the joint targets, and sums the forces in it.
    fn simulate(&mut self, target: &Joints) -> mujoco::Result<(StepSummary, ContactMeter<'static>)> {
        let mut meter = ContactMeter {
            swings: self.swings,
            pull: self.steady_force(),
            senses: self.senses.as_mut(),
            spring: self.script.spring.as_ref().zip(self.spring.as_mut()),
            rope: self.rig.as_ref().map(RigState::tendon),
            ..ContactMeter::default()
        };
        let summary = self.sim.step(target, &mut meter)?;
        Ok((summary, ContactMeter { senses: None, spring: None, ..meter }))
    }

    /// Finds out what happened in the step that has just been simulated, and says so in events.
    fn observe(
        &mut self,
        summary: &StepSummary,
        meter: ContactMeter<'static>,
        events: &mut Vec<Event>,
    ) -> Result<Observed, PlaybackFault> {
        let time_s = self.time_s();
        let event = |kind, text| Event { time_s, kind, text };
        if let Some(fault) = self.senses.as_mut().map_or(Ok(None), Senses::fault)? {
            events.push(event(EventKind::Disturbance, format!("sensors: {fault}; the others bridge it")));
        }
        let stretch = self.spring.as_mut().zip(self.script.spring.as_ref()).and_then(|(state, spring)| {
            let (stretch, text) = state.after_step(spring)?;
            events.extend(text.map(|text| event(EventKind::Disturbance, text.to_owned())));
            Some(stretch)
        });
        let state = self.sim.state();
        self.swings = meter.swings;
        let landings = self.swings.take();
        if let Some(event) = events.iter().rfind(|event| event.kind == EventKind::Disturbance) {
            self.last_disturbance = Some((event.time_s, event.text.clone()));
        }
        let terms = Terms::new(&reward::RewardInput {
            state: &state,
            command: &self.command,
            summary,
            landings: &landings,
            config: &self.config.reward,
        });
        if let (Some(fall), None) = (summary.fall, self.fallen_since) {
            self.fallen_since = Some(self.step);
            let since = |(since_s, what): &(f64, String)| format!(", {:.2} s after: {what}", time_s - since_s);
            let after = self.last_disturbance.as_ref().map_or(String::new(), since);
            events.push(event(EventKind::Fall, format!("fell: {}{after}", self.sim.describe(fall))));
        }
        let rope = self
            .rig
            .as_mut()
            .zip(self.script.rig.as_ref())
            .map(|(state, rig)| state.after_step(rig, &self.sim, time_s, meter.rope_forces, meter.touched, events));
        self.look_for_goal(&state, time_s, events);
        Ok(Observed { state, terms, meter, stretch, rope })
    }

    /// The frame of the step that has just been simulated.
    fn record(&self, target: Joints, summary: &StepSummary, observed: &Observed) -> Frame {
        let Observed { state, terms, meter, stretch, rope } = observed;
        let (time_s, period_s) = (self.time_s(), self.sim.policy_period_s());
        let substeps = f64::from(meter.substeps.max(1));
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
            terms: *terms,
            joint_angles: state.joint_angles,
            joint_targets: target,
            torques: meter.torques,
            foot_positions: self.sim.parts().feet().map(|geom| array(&data.geom_positions()[3 * geom..])),
            foot_heights: state.feet.map(|foot| foot.height),
            foot_forces: meter.foot_forces.map(|force| force.map(|value| value / substeps)),
            peak_foot_force_n: meter.peak_foot_force_n,
            peak_obstacle_force_n: meter.peak_obstacle_force_n,
            obstacle_impulse_n_s: meter.obstacle_force_sum_n * period_s / substeps,
            obstacle_contact_s: f64::from(meter.obstacle_substeps) * period_s / substeps,
            rope: rope.clone(),
            spring: *stretch,
            sensed: self.senses.as_ref().map(|senses| senses.sensed(state)),
            disturbance: self.disturbance(time_s, *stretch),
            stage: self.stage(time_s),
        }
    }

    /// Stage of the training episode that this would be, if it is one.
    fn stage(&self, time_s: f64) -> Option<Stage> {
        let [push] = &self.script.pushes[..] else { return None };
        let stages = Stages::new(&self.config.episode, &self.config.simulation);
        let since_push = ((time_s - push.time_s) / self.sim.policy_period_s()).round() as i64;
        Some(stages.at((since_push + stages.recovery_start as i64 - 1).max(0) as usize))
    }

    /// Applies what is due before the step that starts at `time_s`.
    fn disturb(&mut self, time_s: f64, events: &mut Vec<Event>) -> mujoco::Result<()> {
        let period_s = self.sim.policy_period_s();
        let due = |push: &&TimedPush| push.is_due(time_s, period_s);
        while let Some(push) = self.script.pushes.get(self.pushes_done).filter(due).map(|due| due.push) {
            self.pushes_done += 1;
            self.push_now(&push, time_s, events)?;
        }
        for push in std::mem::take(&mut self.pushes_due) {
            self.push_now(&push, time_s, events)?;
        }
        if let Some(pull) = self.script.pull {
            let active = pull.acts(time_s);
            if active != self.script_pulls {
                self.script_pulls = active;
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
        self.update_pull(time_s, events);
        Ok(())
    }

    fn push_now(&mut self, push: &Push, time_s: f64, events: &mut Vec<Event>) -> mujoco::Result<()> {
        let before = self.sim.state().velocity_in_world();
        self.sim.push(push)?;
        let change = self.sim.state().velocity_in_world() - before;
        self.shown_push = Some((time_s + PUSH_SHOWN_S, change));
        let [forward, left] = push.linear;
        let text = format!("push: {forward:+.2} m/s forward, {left:+.2} m/s left");
        events.push(Event { time_s, kind: EventKind::Disturbance, text });
        Ok(())
    }

    /// The force of a hand turns with the robot.
    fn update_pull(&mut self, time_s: f64, events: &mut Vec<Event>) {
        let before = self.pull_in_world;
        self.pull_in_world =
            self.pull_in_heading.map(|[forward, left]| self.sim.state().heading() * Vector3::new(forward, left, 0.0));
        if let Some(force) = self.pull_in_world.or(before.map(|_| Vector3::zeros())) {
            self.sim.set_trunk_force(force);
        }
        let text = match (before, self.pull_in_heading) {
            (None, Some([forward, left])) => format!("pull: {forward:+.1} N forward, {left:+.1} N left"),
            (Some(_), None) => "pull ends".to_owned(),
            _ => return,
        };
        events.push(Event { time_s, kind: EventKind::Disturbance, text });
    }

    /// Tells once that the robot is where it was to get, on its feet.
    fn look_for_goal(&mut self, state: &RobotState, time_s: f64, events: &mut Vec<Event>) {
        let (Some(goal), Some(from), None) = (&self.script.goal, self.goal_from, self.fallen_since) else { return };
        if self.passed_goal_since.is_none()
            && state.position.x > self.sim.data().body_positions()[3 * from] + goal.ahead_m
        {
            self.passed_goal_since = Some(self.step);
            if state.position.y.abs() < goal.half_width_m {
                events.push(Event { time_s, kind: EventKind::Success, text: goal.text.to_owned() });
            }
        }
    }

    /// The force on the trunk now that is not a spring's, world frame \[N\].
    fn steady_force(&self) -> Vector3<f64> {
        let pull = self.script.pull.filter(|_| self.script_pulls);
        let pull = pull.map(|pull| Vector3::new(pull.force[0], pull.force[1], 0.0));
        pull.or(self.pull_in_world).unwrap_or_default()
    }

    fn disturbance(&self, time_s: f64, stretch: Option<Stretch>) -> Option<Disturbance> {
        if self.script_pulls || self.pull_in_world.is_some() {
            return Some(Disturbance::Pull { force: self.steady_force().into() });
        }
        if let Some(acting) = self.script.spring.as_ref().zip(stretch).and_then(|(it, now)| it.disturbance(now.force_n))
        {
            return Some(acting);
        }
        let (until_s, velocity) = self.shown_push?;
        (time_s <= until_s).then(|| Disturbance::Push { velocity: velocity.into() })
    }

    /// The simulation, to look at.
    pub fn sim(&self) -> &Sim {
        &self.sim
    }
}

impl Iterator for Playback<'_> {
    type Item = PlaybackStep;

    /// One policy step, until the script is over, the robot has lain for a while or is where the script ends, or physics or
    /// sensors failed.
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
                let time_s = self.step as f64 * self.sim.policy_period_s();
                events.push(Event { time_s, kind: EventKind::Fault, text: fault.to_string() });
                self.failed = true;
                Some(PlaybackStep { frame: None, events })
            }
        }
    }
}

/// What happened in a policy step.
struct Observed {
    state: RobotState,
    terms: Terms,
    meter: ContactMeter<'static>,
    stretch: Option<Stretch>,
    rope: Option<Rope>,
}

/// Why a step has no frame.
#[derive(Debug, thiserror::Error)]
enum PlaybackFault {
    #[error(transparent)]
    Physics(#[from] mujoco::Error),
    #[error("the sensors failed: {0}")]
    Sensors(#[from] SensorFault),
}

/// The body from which the way to a script's goal is measured.
fn goal_body(script: &Script, sim: &Sim) -> mujoco::Result<Option<usize>> {
    let body = |goal: &Goal| goal.from.map_or(Ok(0), |name| sim.data().model().id(Kind::Body, name));
    script.goal.as_ref().map(body).transpose()
}

impl TimedPush {
    /// True once the push is due: not later than the step that starts at `time_s`.
    fn is_due(&self, time_s: f64, period_s: f64) -> bool {
        self.time_s < time_s + 0.5 * period_s
    }
}

impl Pull {
    /// True while the pull acts in the step that starts at `time_s`.
    fn acts(&self, time_s: f64) -> bool {
        (self.from_s..self.until_s).contains(&(time_s + 1e-9))
    }
}

fn array<const N: usize>(values: &[f64]) -> [f64; N] {
    std::array::from_fn(|k| values[k])
}

fn poses(data: &Data) -> Vec<Pose> {
    (0..data.model().count(Kind::Body)).map(|body| pose(data, body)).collect()
}

fn pose(data: &Data, body: usize) -> Pose {
    Pose {
        position: array::<3>(&data.body_positions()[3 * body..]).map(|value| value as f32),
        quaternion: array::<4>(&data.body_quaternions()[4 * body..]).map(|value| value as f32),
    }
}
