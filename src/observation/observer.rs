//! Measures what a policy sees, step by step, and keeps the history that it needs.

use serde::{Deserialize, Serialize};

use super::{Command, Layout};
use crate::robot::{Joints, RobotState};

/// Everything that there is to be measured before a policy step.
#[derive(Debug, Clone, Copy)]
pub struct Moment<'a> {
    /// The robot, as its sensing has it.
    pub state: &'a RobotState,
    /// The command.
    pub command: &'a Command,
    /// The network's last outputs, clipped, in the policy's order; zero at first.
    pub last_action: &'a Joints,
    /// The last joint targets \[rad\]; the nominal pose at first.
    pub last_target: &'a Joints,
    /// The pose that the policy moves about \[rad\].
    pub nominal: &'a Joints,
    /// Since the policy began \[s\].
    pub time_s: f64,
}

/// The measurements that an observation is made of: now, and as many steps ago as the layout looks back.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Observer {
    /// Physical units; the newest first. Each has the width of the layout's frame.
    frames: Vec<Vec<f64>>,
}

impl Observer {
    /// Without a past: before the first measurement, everything was as it is in it.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes note of now.
    pub fn measure(&mut self, layout: &Layout, now: &Moment<'_>) {
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

    /// The observation in physical units, shape (layout's length).
    ///
    /// # Panics
    /// Before the first measurement.
    pub fn raw(&self, layout: &Layout) -> Vec<f64> {
        layout.sources().iter().map(|source| self.frames[source.age][source.index]).collect()
    }

    /// The observation as the network sees it, shape (layout's length).
    ///
    /// # Panics
    /// Before the first measurement, or if the slice is shorter.
    pub fn normalised(&self, layout: &Layout, out: &mut [f32]) {
        for (k, source) in layout.sources().iter().enumerate() {
            out[k] = layout.normalised(k, self.frames[source.age][source.index]);
        }
    }

    /// True if the stored history fits this layout.
    pub fn fits(&self, layout: &Layout) -> bool {
        self.frames.len() == layout.depth() && self.frames.iter().all(|frame| frame.len() == layout.frame_width())
    }
}
