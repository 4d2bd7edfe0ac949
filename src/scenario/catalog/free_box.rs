//! The scenario `box`: a free box in the way (E6).

use rand::RngExt;

use super::{ParameterError, Parameters, Task, metric, truth};
use crate::scenario::metrics::{self, Metric};
use crate::scenario::trace::{Frame, Trace};
use crate::scenario::{Goal, Script};
use crate::sim::Buffers;
use crate::util::random::{Purpose, stream};

parameters! {
    /// Box: walk into a free box.
    FreeBox {
        /// Mass of the box (kg)
        mass_kg: f64 = 1e-3 to 1e4, "0.001 to 10000 kg";
        /// Edge length of the box (m)
        size_m: f64 = 0.01 to 10.0, "0.01 to 10 m";
        /// Distance from the robot's centre to the box's near face (m)
        distance_m: f64 = 0.4 to 100.0, "0.4 to 100 m, clear of the robot";
        /// Sliding friction of the box on the ground
        friction: f64 = 1e-3 to 10.0, "0.001 to 10";
        /// Largest sideways offset of the box, drawn from the seed (m)
        max_offset_m: f64 = 0.0 to 10.0, "0 to 10 m";
    }
}

impl Parameters for FreeBox {
    fn prepare(&self, script: &mut Script, seed: u64) -> Result<(), ParameterError> {
        self.check_ranges()?;
        let offset = self.max_offset_m * stream(seed, Purpose::Scenario, 0, 1).random_range(-1.0..=1.0);
        let half = 0.5 * self.size_m;
        // Priority 2: the box's friction holds on the ground too.
        script.scene.obstacles = format!(
            r#"    <body name="box" pos="{x} {offset} {half}">
      <freejoint name="box_joint"/>
      <geom name="box" type="box" size="{half} {half} {half}" mass="{mass}" friction="{friction} 0.005 0.0001"
            priority="2" rgba="0.72 0.53 0.33 1"/>
    </body>
"#,
            x = self.distance_m + half,
            mass = self.mass_kg,
            friction = self.friction,
        );
        let (from, ahead_m, text) = (Some("box"), 0.5 * self.size_m, "got past the box");
        script.goal = Some(Goal { from, ahead_m, half_width_m: f64::INFINITY, text, is_end: false });
        script.scene.buffers = Buffers { contacts: 100, rows: 500, stack: 200_000 };
        Ok(())
    }

    fn metrics(&self, _: &Script, trace: &Trace, found: &mut Vec<Metric>) {
        let frames = || trace.frames.iter();
        let contact_s: f64 = frames().map(|frame| frame.obstacle_contact_s).sum();
        let impulse: f64 = frames().map(|frame| frame.obstacle_impulse_n_s).sum();
        let peak = metrics::largest(frames(), |frame| frame.peak_obstacle_force_n);
        let place = |frame: &Frame| frame.goal.map(|pose| pose.position);
        let moved = trace
            .frames
            .first()
            .and_then(place)
            .zip(trace.frames.last().and_then(place))
            .map(|(a, b)| f64::from(b[0] - a[0]).hypot(f64::from(b[1] - a[1])));
        let mean_force = (contact_s > 0.0).then(|| impulse / contact_s);
        let passed = trace.frames.last().and_then(|last| {
            let box_x = f64::from(place(last)?[0]);
            Some(last.position[0] > box_x + 0.5 * self.size_m)
        });
        found.extend([
            metric("box_displacement_m", "box moved by", moved, "m"),
            metric("contact_time_s", "in contact", Some(contact_s), "s"),
            metric("contact_impulse_n_s", "impulse on the box", Some(impulse), "N s"),
            metric("mean_contact_force_n", "mean contact force", mean_force, "N"),
            metric("peak_contact_force_n", "peak contact force", peak, "N"),
            truth("passed", "got past", passed),
        ]);
    }

    /// Moves the box away by the distance walked during the delay.
    fn delay(&mut self, phase_s: f64) {
        self.distance_m += phase_s * self.task.forward_m_s;
    }
}
