/*! The last second before a physics fault, for diagnosis.

MuJoCo resets a simulation that has become unstable, so its history is lost when the fault is noticed. Every
environment therefore stores state and joint targets before each policy step in a ring buffer: no allocation, some
hundred bytes copied per step. Only a fault reads it.
*/

use crate::robot::{JOINTS, Joints, joint_names};

/// A ring buffer of policy steps: positions, velocities and joint targets before each.
#[derive(Debug, Clone)]
pub(crate) struct LastSecond {
    positions: usize,
    velocities: usize,
    /// The stored steps, shape (steps kept, positions + velocities + targets).
    rows: Vec<f64>,
    /// Number of steps stored since the episode began.
    noted: usize,
}

impl LastSecond {
    /// Creates a ring buffer of `steps` policy steps for a model with these numbers of positions and velocities.
    pub fn new(steps: usize, positions: usize, velocities: usize) -> Self {
        let width = positions + velocities + JOINTS;
        LastSecond { positions, velocities, rows: vec![0.0; steps.max(1) * width], noted: 0 }
    }

    /// Empties the buffer at the start of an episode.
    pub fn clear(&mut self) {
        self.noted = 0;
    }

    /// Stores the state before a policy step, in MuJoCo's coordinates, and the joint targets \[rad\] of that step.
    pub(crate) fn note(&mut self, positions: &[f64], velocities: &[f64], targets: &Joints) {
        let width = self.width();
        let kept = self.rows.len() / width;
        let row = &mut self.rows[self.noted % kept * width..][..width];
        let (first, rest) = row.split_at_mut(self.positions);
        let (second, third) = rest.split_at_mut(self.velocities);
        first.copy_from_slice(positions);
        second.copy_from_slice(velocities);
        third.copy_from_slice(targets);
        self.noted += 1;
    }

    /// Formats the steps as CSV, oldest first: the first column counts down to 0, the step in which the physics failed.
    pub fn csv(&self) -> String {
        let positions = (0..self.positions).map(|k| format!(",position_{k}"));
        let velocities = (0..self.velocities).map(|k| format!(",velocity_{k}"));
        let targets = joint_names().map(|joint| format!(",target_{joint}_rad"));
        let columns: String = positions.chain(velocities).chain(targets).collect();
        let width = self.width();
        let kept = self.rows.len() / width;
        let rows = (self.noted.saturating_sub(kept)..self.noted).map(|noted| {
            let row = &self.rows[noted % kept * width..][..width];
            let numbers: String = row.iter().map(|number| format!(",{number}")).collect();
            format!("{}{numbers}\n", self.noted - 1 - noted)
        });
        format!("steps_before_fault{columns}\n{}", rows.collect::<String>())
    }

    fn width(&self) -> usize {
        self.positions + self.velocities + JOINTS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ring_keeps_newest_steps_of_the_episode() {
        let mut ring = LastSecond::new(3, 2, 1);
        ring.note(&[9.0, 9.0], &[9.0], &[9.0; 12]);
        ring.clear();
        for step in 0..5 {
            let value = f64::from(step);
            ring.note(&[value, f64::NAN], &[-value], &[0.5; 12]);
        }
        let csv = ring.csv();
        let rows: Vec<&str> = csv.lines().collect();
        assert!(rows[0].starts_with("steps_before_fault,position_0,position_1,velocity_0,target_FR_hip_rad,"), "{csv}");
        let starts: Vec<&str> = rows[1..].iter().map(|line| line.split_at(11).0).collect();
        assert_eq!(starts, ["2,2,NaN,-2,", "1,3,NaN,-3,", "0,4,NaN,-4,"]);
        assert!(rows.iter().all(|line| line.split(',').count() == 1 + 2 + 1 + 12));
    }
}
