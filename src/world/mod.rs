/*! The world: a simulated robot, its disturbances, the true forces on it, and its reward.

Training and playback both step a [`World`]: an environment adds the plan of an episode, observers and curricula; a playback
adds a controller, sensors and a trace. One call of [`World::step`] makes the disturbances act, runs the physics of one policy
step, and measures: forces, the terms of the reward, and events.

The world stores what the reward needs beyond the present state: the state and the joint targets before, and the swings of the feet. It
saves them, and the memory of each disturbance, with the simulation, so that it continues with the same bits.
*/

pub mod disturbance;
mod meter;
#[cfg(test)]
mod tests;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

pub use disturbance::{
    Disturbance, DisturbanceMark, Event, EventKind, Hold, Profile, Pull, Push, Rig, Rope, Spring, SpringState,
};

use crate::config::{Reward, Simulation};
use crate::mujoco::{Data, Error, Result};
use crate::observation::Command;
use crate::robot::{JOINTS, Joints, LEGS, RobotState};
use crate::sim::{Conditions, Parts, Scene, Sim, SimState, StepForces, StepSummary};
use crate::task::reward::{Landings, RewardInput};
use crate::task::{SwingTracker, Terms, compliance};
use disturbance::{Acting, Effects, StepTime};
use meter::StepMeter;

/// Time for which a push is drawn \[s\].
const PUSH_SHOWN_S: f64 = 0.3;

/// The result of one policy step of a world.
#[derive(Debug, Clone, PartialEq)]
pub struct WorldStep {
    /// Effort, and the first fall.
    pub summary: StepSummary,
    /// Terms of the reward, without their weights.
    pub terms: Terms,
    /// Swings that ended.
    pub landings: Landings,
    /// Forces on the robot.
    pub forces: StepForces,
    /// The rope, if the world has one.
    pub rope: Option<Rope>,
    /// The spring, if the world has one and it has begun.
    pub spring: Option<SpringState>,
    /// The drawn mark of the present disturbance.
    pub mark: Option<DisturbanceMark>,
    /// Events of the disturbances.
    pub events: Vec<Event>,
}

/// Complete state of a world, from which it continues with the same bits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WorldState {
    sim: SimState,
    steps: usize,
    disturbances: Vec<Acting>,
    swings: SwingTracker,
    targets: [Joints; 3],
    #[serde(default)]
    reference: [f64; 2],
}

/// A simulated robot with everything that disturbs it.
#[derive(Debug)]
pub struct World {
    sim: Sim,
    reward: Reward,
    measures_contacts: bool,
    /// The disturbances that act or are to come.
    disturbances: Vec<Acting>,
    /// Time of the last push \[s\], and its change of velocity, world frame [m/s].
    last_push: Option<(f64, Vector3<f64>)>,
    /// Number of policy steps since the beginning.
    steps: usize,
    state: RobotState,
    /// Joint targets of this step and of the two before \[rad\].
    targets: [Joints; 3],
    swings: SwingTracker,
    /// Velocity of the [reference](compliance::follow), if the reward follows one, forward and left, heading frame [m/s].
    reference: [f64; 2],
}

impl World {
    /// Compiles a scene. `reward` are the targets and sharpnesses of the reward's terms. The robot counts as fallen below
    /// `fall_height_m` \[m\], unless its description states another height. Call [`World::begin`] before the first step.
    ///
    /// # Errors
    /// The scene does not compile, the model lacks a part of the robot, or MuJoCo fails.
    pub fn new(scene: &Scene, simulation: &Simulation, fall_height_m: f64, reward: Reward) -> Result<Self> {
        let sim = Sim::new(scene, simulation, fall_height_m)?;
        Ok(World {
            sim,
            reward,
            measures_contacts: true,
            disturbances: Vec::new(),
            last_push: None,
            steps: 0,
            state: RobotState::default(),
            targets: [[0.0; JOINTS]; 3],
            swings: SwingTracker::default(),
            reference: [0.0; 2],
        })
    }

    /// Leaves contact forces unmeasured, to be faster where nothing observes them and no term of the reward reads them.
    pub fn without_contact_forces(self) -> Self {
        World { measures_contacts: false, ..self }
    }

    /// Puts the robot at its start, at rest, holding `target` \[rad\], with these disturbances to come.
    ///
    /// # Errors
    /// MuJoCo fails in the starting state, or the scene lacks a part of a disturbance.
    pub fn begin(
        &mut self,
        conditions: Conditions,
        target: &Joints,
        disturbances: impl IntoIterator<Item = Disturbance>,
    ) -> Result<()> {
        self.steps = 0;
        self.restart(conditions, target)?;
        self.disturbances =
            disturbances.into_iter().map(|it| Acting::new(it, &self.sim)).collect::<Result<Vec<_>>>()?;
        Ok(())
    }

    /// Puts robot and scene at their start, while time goes on: disturbances that have come do not come again.
    ///
    /// # Errors
    /// MuJoCo fails in the starting state.
    pub fn restart(&mut self, conditions: Conditions, target: &Joints) -> Result<()> {
        self.sim.reset(conditions, target)?;
        let time_s = self.time_s();
        self.sim.data_mut().set_time_s(time_s);
        // The reset has cleared all forces; what still pulls begins anew.
        for it in &mut self.disturbances {
            if let Acting::Pull(_, memory) = it {
                *memory = Default::default();
            }
        }
        self.stand_again(target);
        Ok(())
    }

    /// Sets the robot on its feet at its present place: see [`Sim::set_on_feet`].
    ///
    /// # Errors
    /// MuJoCo fails in the new state.
    pub fn set_on_feet(&mut self, target: &Joints) -> Result<()> {
        self.sim.set_on_feet(target)?;
        self.stand_again(target);
        Ok(())
    }

    fn stand_again(&mut self, target: &Joints) {
        self.state = self.sim.state();
        self.targets = [*target; 3];
        self.swings = SwingTracker::new(&self.state.feet, self.reward.foot_height_m);
        self.reference = [0.0; 2];
        self.last_push = None;
    }

    /// Adds a disturbance, which acts from its own time on.
    ///
    /// # Errors
    /// The scene lacks a part of it.
    pub fn disturb(&mut self, disturbance: Disturbance) -> Result<()> {
        self.disturbances.push(Acting::new(disturbance, &self.sim)?);
        Ok(())
    }

    /// Pulls the trunk by hand from the next step on, forward and left in the heading frame \[N\]; `None` lets go.
    pub fn pull_by_hand(&mut self, force: Option<[f64; 2]>) {
        let hand = self.disturbances.iter_mut().find_map(|it| match it {
            Acting::Pull(pull, _) if pull.is_by_hand() => Some(pull),
            _ => None,
        });
        match (hand, force) {
            (Some(pull), Some(force)) => *pull = Pull::hand(force),
            (Some(pull), None) => pull.until_s = f64::NEG_INFINITY,
            (None, Some(force)) => self.disturbances.push(Acting::Pull(Pull::hand(force), Default::default())),
            (None, None) => {}
        }
    }

    /// Runs one policy step towards joint targets \[rad\]: disturbs, simulates, measures. The reward compares with `command`, or
    /// with the reference that follows from it; `sensors` is called after each physics step, with the torques in it [N·m].
    ///
    /// # Errors
    /// A target is not finite, or MuJoCo fails; then begin anew.
    pub fn step(
        &mut self,
        target: &Joints,
        command: &Command,
        sensors: impl FnMut(&Data, &Parts, &Joints),
    ) -> Result<WorldStep> {
        let (at, mut effects) = (self.at(), Effects::default());
        for it in &mut self.disturbances {
            it.before_step(at, command, &mut self.sim, &mut effects)?;
        }
        let Effects { mut events, impulse, pushed } = effects;
        self.last_push = pushed.map(|change| (at.time_s, change)).or(self.last_push);
        let mut meter = StepMeter {
            disturbances: &mut self.disturbances,
            swings: &mut self.swings,
            sensors,
            measures_contacts: self.measures_contacts,
            sums: StepForces::default(),
            substeps: 0,
            obstacle_substeps: 0,
            touched: None,
        };
        let summary = self.sim.step(target, &mut meter)?;
        let (mut forces, touched) = (meter.forces(at.period_s), meter.touched);
        self.steps += 1;
        let before = std::mem::replace(&mut self.state, self.sim.state());
        self.targets = [*target, self.targets[0], self.targets[1]];
        let landings = self.swings.take();
        forces.trunk += impulse / at.period_s;
        let (rope, spring, mark) = self.after_step(touched, &mut forces, &mut events);
        self.disturbances.retain(|it| !it.is_over(at));
        // The felt force of a perfect observer.
        let felt = self.state.heading().inverse() * forces.trunk;
        self.state.felt_force = Some([felt.x, felt.y]);
        let mut paid = *command;
        if self.reward.reference_m_s_per_n.is_some() {
            compliance::follow(&mut self.reference, command, [felt.x, felt.y], self.sim.robot().mass_kg, at.period_s);
            [paid.forward, paid.left] = self.reference;
        }
        let terms = Terms::new(&self.reward_input(&before, &paid, (&summary, &landings, &forces)));
        Ok(WorldStep { summary, terms, landings, forces, rope, spring, mark, events })
    }

    /// Returns the inputs of the reward's terms after a step.
    fn reward_input<'a>(
        &'a self,
        before: &'a RobotState,
        command: &'a Command,
        (summary, landings, forces): (&'a StepSummary, &'a Landings, &'a StepForces),
    ) -> RewardInput<'a> {
        let (state, targets, period_s) = (&self.state, &self.targets, self.sim.policy_period_s());
        let (time_s, config) = (self.time_s(), &self.reward);
        RewardInput { state, before, targets, command, summary, landings, forces, period_s, time_s, config }
    }

    /// Collects the effects of the disturbances in the step.
    fn after_step(
        &mut self,
        touched: Option<usize>,
        forces: &mut StepForces,
        events: &mut Vec<Event>,
    ) -> (Option<Rope>, Option<SpringState>, Option<DisturbanceMark>) {
        let (time_s, mut rope, mut spring, mut pull, mut mark) = (self.time_s(), None, None, None, None);
        for it in &mut self.disturbances {
            match it {
                Acting::Pull(value, memory) => {
                    let force = memory.acting(value, self.sim.data().time_s());
                    pull = [pull, force].into_iter().flatten().reduce(|sum: Vector3<f64>, force| sum + force);
                }
                Acting::Spring(value, memory) => {
                    if let Some((state, text)) = memory.after_step(value) {
                        events.extend(text.map(|text| Event::disturbance(time_s, text)));
                        mark = value.mark(state.force_n);
                        spring = Some(state);
                    }
                }
                Acting::Rig(value, memory) => {
                    let found = memory.after_step(value, &self.sim, time_s, touched, events);
                    if value.from.is_some() {
                        forces.trunk += found.pull();
                    }
                    rope = Some(found);
                }
                Acting::Push(..) | Acting::Hold(..) => {}
            }
        }
        let push = self.last_push.filter(|(at_s, _)| time_s <= at_s + PUSH_SHOWN_S);
        let push = push.map(|(_, change)| DisturbanceMark::Push { velocity: change.into() });
        (rope, spring, pull.map(|force| DisturbanceMark::Rope { force: force.into() }).or(mark).or(push))
    }

    fn at(&self) -> StepTime {
        StepTime { time_s: self.time_s(), period_s: self.sim.policy_period_s() }
    }

    /// Sets the clock back to zero.
    pub fn rewind_clock(&mut self) {
        let passed_s = self.time_s();
        self.last_push = self.last_push.map(|(at_s, change)| (at_s - passed_s, change));
        self.steps = 0;
        self.sim.data_mut().set_time_s(0.0);
    }

    /// Replaces the felt force on the trunk, forward and left in the heading frame \[N\].
    pub fn set_felt_force(&mut self, force: Option<[f64; 2]>) {
        self.state.felt_force = force;
    }

    /// Returns what disturbs the trunk at the beginning of the coming step: the force of all pulls, world frame \[N\], and the
    /// push.
    pub fn coming(&self) -> (Vector3<f64>, Option<&Push>) {
        let (at, mut pull, mut push) = (self.at(), Vector3::zeros(), None);
        for it in &self.disturbances {
            match it {
                Acting::Pull(it, _) => {
                    let force = it.in_step(at, &self.sim).unwrap_or_default();
                    pull += it.profile.at(at.time_s - it.from_s) * force;
                }
                Acting::Push(it, false) if at.has_come(it.at_s) => push = Some(it),
                _ => {}
            }
        }
        (pull, push)
    }

    methods! {
        /// Returns the time at which the next step begins \[s\].
        fn time_s(&self) -> f64 = self.steps as f64 * self.sim.policy_period_s();
        /// Returns the number of policy steps since the beginning.
        fn steps(&self) -> usize = self.steps;
        /// Returns the state after the last step. The felt force is the true one unless [`World::set_felt_force`] replaced it.
        fn state(&self) -> &RobotState = &self.state;
        /// Returns the joint targets of the last step \[rad\]; those of the beginning before the first.
        fn last_target(&self) -> &Joints = &self.targets[0];
        /// Returns the targets and sharpnesses of the reward's terms, and their weights.
        fn reward(&self) -> &Reward = &self.reward;
        /// Returns the simulation.
        fn sim(&self) -> &Sim = &self.sim;
        /// Returns the simulation, to be changed.
        fn sim_mut(&mut self) -> &mut Sim = &mut self.sim;
    }

    /// Returns the state from which the world continues with the same bits.
    pub fn save(&self) -> WorldState {
        let World { steps, swings, targets, reference, .. } = *self;
        WorldState { sim: self.sim.save(), steps, disturbances: self.disturbances.clone(), swings, targets, reference }
    }

    /// Continues from the saved state of an undisturbed world, with the disturbances of this one to come.
    ///
    /// # Errors
    /// The same as those of [`World::restore`].
    pub fn go_on_from(&mut self, undisturbed: &WorldState) -> Result<()> {
        let to_come = std::mem::take(&mut self.disturbances);
        self.restore(undisturbed)?;
        self.disturbances = to_come;
        Ok(())
    }

    /// Restores a saved state.
    ///
    /// # Errors
    /// The state belongs to another model or is impossible, or MuJoCo fails in it.
    pub fn restore(&mut self, state: &WorldState) -> Result<()> {
        let last = LEGS.len() - 1;
        let problem = state.disturbances.iter().find_map(|it| match it {
            Acting::Hold(hold, _) if hold.leg > last => {
                Some(format!("it holds the foot of leg {}, expected 0 to {last}", hold.leg))
            }
            Acting::Spring(..) | Acting::Rig(..) => Some("it has a leash or a rope, which are not saved".to_owned()),
            _ => None,
        });
        if let Some(message) = problem {
            return Err(Error::Load { what: "a saved state".into(), message });
        }
        self.sim.restore(&state.sim)?;
        self.disturbances.clone_from(&state.disturbances);
        (self.steps, self.swings, self.targets) = (state.steps, state.swings, state.targets);
        self.reference = state.reference;
        (self.state, self.last_push) = (self.sim.state(), None);
        Ok(())
    }
}
