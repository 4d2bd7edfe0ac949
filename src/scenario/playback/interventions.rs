//! What somebody does to a robot that is being played. It takes effect with the next step.

use super::Playback;
use crate::mujoco;
use crate::policy::Controller;
use crate::sim::Push;
use crate::task::{Command, SwingTracker};

impl<'a> Playback<'a> {
    /// What is asked of the policy.
    pub fn command(&self) -> &Command {
        &self.command
    }

    /// Asks something else of the policy.
    pub fn ask(&mut self, command: Command) {
        self.command = command;
    }

    /// Pushes the trunk.
    pub fn push(&mut self, push: Push) {
        self.pushes_due.push(push);
    }

    /// Takes the trunk in hand and pulls with this force, forward and left in the heading frame \[N\], or lets it go.
    pub fn pull(&mut self, force: Option<[f64; 2]>) {
        self.pull_in_heading = force;
    }

    /// Gives the robot to another controller as it stands.
    pub fn hand_over(&mut self, controller: Box<dyn Controller + 'a>) {
        self.controller = controller;
        self.starts_afresh = true;
    }

    /// Sets the robot on its feet where it is, facing as it does: see [`Sim::set_on_feet`](crate::sim::Sim::set_on_feet).
    ///
    /// # Errors
    /// A fault of MuJoCo.
    pub fn set_on_feet(&mut self) -> mujoco::Result<()> {
        self.sim.set_on_feet(&self.controller.rest())?;
        self.begin_afresh();
        Ok(())
    }

    /// Puts robot and scene back to their start. Time goes on; the script's own disturbances are not repeated.
    ///
    /// # Errors
    /// A fault of MuJoCo.
    pub fn restart(&mut self) -> mujoco::Result<()> {
        self.sim.reset(self.script.conditions, &self.controller.rest())?;
        // The force of a hand is gone with all else: it is set anew where it is still held.
        self.pull_in_world = None;
        self.passed_goal_since = None;
        self.begin_afresh();
        Ok(())
    }

    /// Whether physics or sensors have failed: only [`Playback::restart`] helps.
    pub fn has_failed(&self) -> bool {
        self.failed
    }

    fn begin_afresh(&mut self) {
        self.state = self.sim.state();
        self.swings = SwingTracker::new(&self.state.feet, self.config.reward.foot_height_m);
        self.fallen_since = None;
        self.failed = false;
        self.last_disturbance = None;
        self.shown_push = None;
        self.starts_afresh = true;
    }
}
