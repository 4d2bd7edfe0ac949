//! Measures the observation step by step, and keeps the history that it needs.

use serde::{Deserialize, Serialize};

use super::{Command, Layout, Privileged};
use crate::robot::{Joints, RobotState};

/// All that can be observed before a policy step.
#[derive(Debug, Clone, Copy)]
pub struct ObservationInput<'a> {
    /// State of the robot, true or estimated.
    pub state: &'a RobotState,
    /// Command to the policy, base frame.
    pub command: &'a Command,
    /// The network's last outputs, clipped, in the policy's order; zero at first.
    pub last_action: &'a Joints,
    /// Last joint targets \[rad\]; the nominal pose at first.
    pub last_target: &'a Joints,
    /// Joint targets at action zero \[rad\].
    pub nominal: &'a Joints,
    /// Time since the policy began \[s\].
    pub time_s: f64,
    /// Values that only the simulator has, for a critic; the default for a policy, which cannot observe them.
    pub privileged: Privileged,
}

/// The measured frames of an observation: now, and as many steps ago as the layout needs.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Observer {
    /// Frames in physical units, newest first. Each has the width of the layout's frame.
    frames: Vec<Vec<f64>>,
}

impl Observer {
    /// Creates an observer without history; the first measurement also fills the past.
    pub fn new() -> Self {
        Self::default()
    }

    /// Measures the present frame.
    pub fn measure(&mut self, layout: &Layout, now: &ObservationInput<'_>) {
        let begun = !self.frames.is_empty();
        self.frames.resize_with(layout.depth(), || vec![0.0; layout.frame_width()]);
        self.frames.rotate_right(1);
        if let Some((newest, older)) = self.frames.split_first_mut() {
            layout.measure(now, newest);
            if !begun {
                older.iter_mut().for_each(|frame| frame.copy_from_slice(newest));
            }
        }
    }

    /// Returns the observation in physical units, shape (layout's length).
    ///
    /// # Panics
    /// Nothing has been measured yet.
    pub fn raw(&self, layout: &Layout) -> Vec<f64> {
        layout.sources().iter().map(|source| self.frames[source.age][source.index]).collect()
    }

    /// Writes the normalised observation, shape (layout's length).
    ///
    /// # Panics
    /// Nothing has been measured yet, or the slice is shorter than the layout.
    pub fn normalised(&self, layout: &Layout, out: &mut [f32]) {
        for (k, source) in layout.sources().iter().enumerate() {
            out[k] = layout.normalised(k, self.frames[source.age][source.index]);
        }
    }

    /// Returns true if nothing has been measured yet.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Returns true if the stored history fits this layout.
    pub fn fits(&self, layout: &Layout) -> bool {
        self.frames.len() == layout.depth() && self.frames.iter().all(|frame| frame.len() == layout.frame_width())
    }
}
