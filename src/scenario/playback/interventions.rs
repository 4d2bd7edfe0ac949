//! Interactive commands, pushes, pulls and resets during a playback; they take effect with the next step.

use super::Playback;
use crate::mujoco;
use crate::policy::Controller;
use crate::task::Command;
use crate::world::{Disturbance, Push};

impl<'a> Playback<'a> {
    /// Returns the present command.
    pub fn command(&self) -> &Command {
        &self.command
    }

    /// Changes the command from the next step on. A commanded compliance needs [`Playback::with_felt_forces`] from the start.
    pub fn ask(&mut self, command: Command) {
        self.command = command;
    }

    /// Pushes the trunk at the next step: change of velocity, forward and left in the heading frame [m/s].
    pub fn push(&mut self, linear: [f64; 2]) {
        let at_s = self.world.time_s();
        // A push needs no part of the scene.
        let _ = self.world.disturb(Disturbance::Push(Push { at_s, linear, angular: [0.0; 3] }));
    }

    /// Pulls the trunk with a constant force, forward and left in the heading frame \[N\]; `None` ends the pull.
    pub fn pull(&mut self, force: Option<[f64; 2]>) {
        self.world.pull_by_hand(force);
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

    /// Resets robot and scene to their start. Time goes on; the script's own disturbances are not repeated.
    ///
    /// # Errors
    /// MuJoCo fails in the starting state.
    pub fn restart(&mut self) -> mujoco::Result<()> {
        self.world.restart(self.script.conditions, &self.controller.rest())?;
        self.passed_goal_since = None;
        self.begin_again();
        Ok(())
    }

    /// Returns true if physics or sensors have failed; then only [`Playback::restart`] helps.
    pub fn has_failed(&self) -> bool {
        self.failed
    }

    fn begin_again(&mut self) {
        if let Some(force_sense) = &mut self.force_sense {
            force_sense.reset(self.world.sim(), &self.script.conditions);
        }
        (self.felt, self.true_force) = Default::default();
        self.fallen_since = None;
        self.failed = false;
        self.last_disturbance = None;
        self.controller_must_begin = true;
    }
}
