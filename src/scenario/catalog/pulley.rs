/*! The scenario `pulley`: a weight on a rope over a pulley pulls the trunk (E9).

The rope goes from the trunk's centre of mass to a pulley about as high as the trunk, from there straight up to a second one
and down to the weight. When the robot moves towards the pulley the weight sinks, when it moves away the weight rises,
and the rope's force is the weight's `m (g + a)`. Pulleys are points without friction and inertia. The rope passes
through legs, because a real one, tied to a harness on the back, would not touch them.
*/

use super::{ParameterError, Parameters, Task, in_range, metric, no_turn, towards};
use crate::robot::HARNESS;
use crate::scenario::Script;
use crate::scenario::metrics::{self, Metric};
use crate::scenario::trace::{Frame, Trace};
use crate::world::disturbance::{Disturbance, Holder, Load, LoadShape, Rig};

/// Density of the weight, a cube of steel [kg/m³].
const STEEL_KG_M3: f64 = 7850.0;

/// Horizontal distance from the lower to the upper pulley \[m\].
const UPPER_PULLEY_M: f64 = 0.25;

/// Time after the release at which the averages of velocity and force start: the rope no longer jerks \[s\].
const SETTLED_S: f64 = 1.0;

parameters! {
    /// Pulley: a hanging weight pulls the trunk.
    Pulley {
        /// Mass of the weight (kg)
        mass_kg: f64 = 1e-3 to 100.0, "0.001 to 100 kg";
        /// Direction of the pull from the robot's heading: 0 ahead, 90 left, 180 back (deg)
        direction_deg: f64 = -360.0 to 360.0, "-360 to 360 degrees";
        /// Distance from the robot's course to the pulley; abreast of the robot half-way through the pull if it walks as commanded (m)
        distance_m: f64;
        /// Height of the pulley that the rope comes from (m)
        height_m: f64 = 0.05 to 10.0, "0.05 to 10 m";
        /// Distance that the weight can sink or rise, in addition to that of the commanded walk, before it meets ground or pulley (m)
        drop_m: f64 = 0.1 to 100.0, "0.1 to 100 m";
        /// Slack of the rope at the release; the weight falls freely until the rope is taut (m)
        slack_m: f64 = 0.0 to 10.0, "0 to 10 m";
        /// Time at which the weight is released (s)
        at_s: f64 = 0.0 to 3600.0, "0 to 3600 s";
        /// Duration for which the rope stays on the robot (s)
        for_s: f64 = 0.0 to 3600.0, "0 to 3600 s";
    }
}

impl Pulley {
    /// Returns the direction of the pull, forward and left at the robot's heading when it begins; a unit vector.
    pub fn direction(&self) -> [f64; 2] {
        towards(self.direction_deg)
    }

    /// Builds the rig of pulleys, weight and rope.
    fn rig(&self) -> Rig {
        let [ahead, left] = self.direction();
        let upper_m = self.distance_m + UPPER_PULLEY_M;
        let at = |distance: f64, height: f64| [ahead * distance, left * distance, height];
        let pulley =
            |name: &'static str, place, has_post| Holder { name: name.into(), place, radius_m: 0.04, has_post };
        let (place, shape) = (at(upper_m, self.start_height_m()), LoadShape::Cube(self.half_edge_m()));
        Rig {
            from: Some(HARNESS.into()),
            holders: vec![
                pulley("pulley", at(self.distance_m, self.height_m), false),
                pulley("upper_pulley", at(upper_m, self.upper_height_m()), true),
            ],
            load: Load { name: "weight".into(), place, mass_kg: self.mass_kg, shape },
            is_level_with_trunk: false,
            slack_m: self.slack_m,
            lead_s: 0.5 * self.for_s,
            release_s: self.at_s,
            until_s: self.at_s + self.for_s,
        }
    }

    fn half_edge_m(&self) -> f64 {
        0.5 * (self.mass_kg / STEEL_KG_M3).cbrt()
    }

    /// Returns the distance by which the commanded walk approaches the pulley during the pull \[m\].
    fn approach_m(&self) -> f64 {
        let [ahead, left] = self.direction();
        (self.task.forward_m_s * ahead + self.task.left_m_s * left) * self.for_s
    }

    /// Returns the height of the weight at its release \[m\].
    fn start_height_m(&self) -> f64 {
        self.half_edge_m() + self.drop_m + self.approach_m().max(0.0)
    }

    fn upper_height_m(&self) -> f64 {
        self.start_height_m() + self.drop_m + (-self.approach_m()).max(0.0)
    }
}

impl Parameters for Pulley {
    fn prepare(&self, script: &mut Script, _: u64) -> Result<(), ParameterError> {
        self.check_ranges()?;
        no_turn(&self.task)?;
        let nearest_m = 0.5 + 0.5 * self.approach_m().abs();
        let expected = "0.5 m to 100 m from where the commanded walk leads (half the way of the pull is on each side)";
        in_range("distance-m", self.distance_m, nearest_m, 100.0, expected)?;
        let rig = self.rig();
        rig.hang_in(&mut script.scene);
        script.disturbances.push(Disturbance::Rig(rig));
        Ok(())
    }

    fn metrics(&self, script: &Script, trace: &Trace, found: &mut Vec<Metric>) {
        let end_s = (self.at_s + self.for_s).min(script.duration_s);
        let from_s = self.at_s + SETTLED_S;
        // The jerk of the rope at the release does not depend on the policy.
        let settled = || metrics::window(trace, from_s, end_s);
        let direction = self.direction();
        let moved = metrics::displacement_off_course(trace, direction, self.at_s, end_s);
        let offset = metrics::yaw_at(trace, self.at_s).and_then(|yaw| {
            let pull = metrics::in_world(direction, yaw);
            metrics::offset_along_force(trace, pull, from_s, end_s)
        });
        let window_s = settled().next().map(|_| end_s.min(trace.frames.last().map_or(0.0, |f| f.time_s)) - from_s);
        let force = |frame: &Frame| frame.rope.as_ref().map_or(0.0, |rope| rope.force_n);
        let peak = |frame: &Frame| frame.rope.as_ref().map_or(0.0, |rope| rope.peak_force_n);
        found.extend([
            metric("displacement_m", "moved along the pull", moved, "m"),
            metric("offset_m_s", "velocity along the pull", offset, "m/s"),
            metric("pull_window_s", "means of the pull are over", window_s, "s"),
            metric("mean_rope_force_n", "mean rope force", metrics::mean(settled(), force), "N"),
            metric("peak_rope_force_n", "peak rope force", metrics::largest(settled(), peak), "N"),
            metric("power_pulled_w", "power while pulled", metrics::mean(settled(), |frame| frame.power_w), "W"),
        ]);
    }

    fn delay(&mut self, phase_s: f64) {
        self.at_s += phase_s;
        self.task.duration_s += phase_s;
    }
}
