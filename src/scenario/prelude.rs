//! The prelude: the steps before the first disturbance, played once for many playbacks.

use super::metrics::PHASE_S;
use super::playback::{Playback, PlaybackStep, Recorded};
use super::{Script, TimedPush};
use crate::config::{Config, Simulation};
use crate::mujoco;
use crate::policy::Controller;
use crate::sim::{Pull, Scene};

/// The undisturbed steps of scripts that differ only in their disturbances, by one policy on the true state.
///
/// [`Playback::trace_after`] starts with these steps and continues with the same bits.
#[derive(Debug)]
pub struct Prelude {
    calm: Script,
    pub(super) steps: Vec<Recorded>,
}

impl Script {
    /// Returns the script without disturbances and end; `None` unless it only pushes or pulls a robot on a plane.
    pub fn calm(&self) -> Option<Script> {
        let is_alone = self.scene == Scene::flat(self.scene.robot.clone(), self.scene.timestep_s);
        let only_pushed = self.spring.is_none() && self.rig.is_none() && self.goal.is_none();
        let calm = || Script { pushes: Vec::new(), pull: None, duration_s: 0.0, after_fall_s: 0.0, ..self.clone() };
        (is_alone && only_pushed).then(calm)
    }

    /// Number of steps before the first disturbance.
    pub(super) fn calm_steps(&self, simulation: &Simulation) -> usize {
        let period_s = simulation.policy_period_s();
        let begins = |step: &usize| {
            let time_s = *step as f64 * period_s;
            self.pushes.iter().any(|push| push.is_due(time_s, period_s))
                || self.pull.is_some_and(|pull| pull.acts(time_s))
        };
        let steps = simulation.policy_steps(self.duration_s);
        (0..steps).find(begins).unwrap_or(steps)
    }
}

impl TimedPush {
    /// True if the push comes no later than the step that starts at `time_s`.
    pub(super) fn is_due(&self, time_s: f64, period_s: f64) -> bool {
        self.time_s < time_s + 0.5 * period_s
    }
}

impl Pull {
    /// True if the pull acts in the step that starts at `time_s`.
    pub(super) fn acts(&self, time_s: f64) -> bool {
        (self.from_s..self.until_s).contains(&(time_s + 1e-9))
    }
}

impl Prelude {
    /// Plays the undisturbed part of a script, long enough for disturbances at any phase of the gait; `None` if no other script
    /// could share it.
    ///
    /// # Errors
    /// Same as [`Playback::new`].
    pub fn new(script: &Script, config: &Config, controller: Box<dyn Controller + '_>) -> mujoco::Result<Option<Self>> {
        let Some(calm) = script.calm() else { return Ok(None) };
        let simulation = &config.simulation;
        let calm_s = script.calm_steps(simulation) as f64 * simulation.policy_period_s();
        let played = Script { duration_s: script.duration_s.min(calm_s + PHASE_S), ..calm.clone() };
        let mut rollout = Playback::new(&played, config, controller)?;
        let mut steps = Vec::new();
        loop {
            let Some(before) = rollout.moment() else { return Ok(None) };
            match rollout.next() {
                // The prelude ends before the first event.
                Some(PlaybackStep { frame: Some(frame), events }) if events.is_empty() => {
                    steps.push(before.followed_by(frame))
                }
                _ => return Ok((!steps.is_empty()).then_some(Prelude { calm, steps })),
            }
        }
    }

    /// True if the prelude fits the script.
    pub fn is_of(&self, script: &Script) -> bool {
        script.calm().is_some_and(|calm| calm == self.calm)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::{Agent, shipped};
    use crate::robot::{Joints, RobotState, same_in_every_leg};
    use crate::scenario::Sensing;
    use crate::scenario::catalog::Scenario;
    use crate::scenario::trace::Trace;
    use crate::sim::Push;
    use crate::task::Command;

    impl Prelude {
        /// Gives a step a power that none has.
        fn mark(&mut self, step: usize) {
            self.steps[step].frame_mut().power_w = -1.0;
        }
    }

    const SIDEWAYS: Push = Push { linear: [0.0, 0.5], angular: [0.0; 3] };

    fn script(name: &str, later_s: f64, agent: &Agent) -> Script {
        Scenario::named(name, "{}").unwrap().later(later_s).script(3, &agent.config).unwrap()
    }

    fn trace(script: &Script, agent: &Agent, prelude: Option<&Prelude>) -> Trace {
        let rollout = Playback::new(script, &agent.config, agent.controller()).unwrap();
        match prelude {
            Some(prelude) => rollout.trace_after(prelude),
            None => rollout.trace(),
        }
    }

    #[test]
    fn rollouts_have_the_same_frames_with_and_without_a_prelude() {
        let mut agent = shipped::find("compliant").unwrap();
        agent.told = 0.03;
        for name in ["push", "leash", "walk"] {
            let tell = |later_s| {
                let mut script = script(name, later_s, &agent);
                script.tell(agent.told);
                script
            };
            let first = tell(0.0);
            let prelude = Prelude::new(&first, &agent.config, agent.controller()).unwrap().unwrap();
            let at_once = Script { pushes: vec![TimedPush { time_s: 0.0, push: SIDEWAYS }], ..first.clone() };
            // One that is disturbed later than the prelude lasts, too.
            for script in [first, at_once, tell(0.4), tell(1.5)] {
                assert!(prelude.is_of(&script), "{name}");
                let (alone, after) = (trace(&script, &agent, None), trace(&script, &agent, Some(&prelude)));
                assert!(alone.frames == after.frames && alone.events == after.events, "{name}");
            }
        }
    }

    #[test]
    fn a_prelude_is_where_its_steps_come_from() {
        let agent = shipped::find("compliant").unwrap();
        let push = script("push", 0.0, &agent);
        let mut prelude = Prelude::new(&push, &agent.config, agent.controller()).unwrap().unwrap();
        prelude.mark(7);
        assert_eq!(trace(&push, &agent, Some(&prelude)).frames[7].power_w, -1.0);
        let rollout = Playback::new(&push, &agent.config, agent.controller()).unwrap();
        let sensing = rollout.with_sensing(Sensing::Estimated, 1).unwrap();
        assert!(sensing.trace_after(&prelude).frames[7].power_w > 0.0, "what is sensed is not in it");
    }

    #[test]
    fn a_prelude_is_of_scripts_that_differ_only_in_their_disturbances() {
        let agent = shipped::find("compliant").unwrap();
        let push = script("push", 0.0, &agent);
        let prelude = Prelude::new(&push, &agent.config, agent.controller()).unwrap().unwrap();
        assert!(prelude.is_of(&Script { pushes: Vec::new(), duration_s: 3.0, ..push.clone() }));
        let mut faster = push.clone();
        faster.command.forward = 0.9;
        assert!(!prelude.is_of(&faster));
        let rigged = script("pulley", 0.0, &agent);
        assert!(Prelude::new(&rigged, &agent.config, agent.controller()).unwrap().is_none());
    }

    #[test]
    fn a_controller_that_keeps_its_past_to_itself_is_played_from_the_start() {
        struct Stands;

        impl Controller for Stands {
            fn rest(&self) -> Joints {
                same_in_every_leg([0.0, 0.72, -1.44])
            }

            fn begin(&mut self, _: &RobotState) {}

            fn joint_targets(&mut self, _: &RobotState, _: &Command) -> Joints {
                self.rest()
            }
        }

        let agent = shipped::find("compliant").unwrap();
        let push = script("push", 0.0, &agent);
        assert!(Prelude::new(&push, &agent.config, Box::new(Stands)).unwrap().is_none());
        let mut of_agent = Prelude::new(&push, &agent.config, agent.controller()).unwrap().unwrap();
        of_agent.mark(7);
        let rollout = Playback::new(&push, &agent.config, Box::new(Stands)).unwrap();
        assert!(rollout.trace_after(&of_agent).frames[7].power_w > 0.0);
    }
}
