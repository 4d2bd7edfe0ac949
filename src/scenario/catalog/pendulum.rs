/*! The scenario `pendulum`: a ball on a string swings into the trunk (E10).

The ball is released at rest with the string taut. At its lowest point it is level with the trunk's middle and
touches its side: the stand is aimed at the predicted position of the walking robot a quarter of a period later.
Duration and hardness of the contact are those of MuJoCo's default contact, whose time constant is 20 ms: a padded ball
rather than bare steel.
*/

use std::f64::consts::FRAC_PI_2;

use super::{ParameterError, Parameters, Task, in_range, lasting, metric, no_turn, towards};
use crate::robot::{Extent, GRAVITY_M_S2};
use crate::scenario::Script;
use crate::scenario::metrics::{self, Metric, STRIDE_S};
use crate::scenario::trace::{Frame, Trace};
use crate::world::disturbance::{Disturbance, Holder, Load, LoadShape, Rig};

/// Time after the first contact within which the trunk reaches its largest velocity \[s\].
const LONGEST_BLOW_S: f64 = 0.2;

/// Duration of the sum of impulses, from the first contact on \[s\].
const IMPULSE_S: f64 = 1.0;

parameters! {
    /// Pendulum: a ball on a string swings into the trunk.
    Pendulum {
        /// Mass of the ball (kg)
        mass_kg: f64 = 1e-3 to 100.0, "0.001 to 100 kg";
        /// Radius of the ball (m)
        radius_m: f64 = 0.01 to 0.2, "0.01 to 0.2 m";
        /// Distance from the pivot to the ball's centre (m)
        string_m: f64 = 0.1 to 100.0, "0.1 to 100 m";
        /// Height of the release above the ball's lowest point; at most the string's length (m)
        release_height_m: f64;
        /// Direction in which the ball hits, from the robot's heading: 0 forward, 90 to the left (deg)
        direction_deg: f64 = -360.0 to 360.0, "-360 to 360 degrees";
        /// Time at which the ball is released (s)
        at_s: f64 = 0.0 to 3600.0, "0 to 3600 s";
    }
}

/// The ball's first contact with the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Impact {
    /// Time at which the contact began \[s\].
    pub time_s: f64,
    /// Largest change of the trunk's velocity along the blow from the frame before it, within 0.2 s, as a push in the
    /// heading frame (forward, left) [m/s].
    pub push: [f64; 2],
}

impl Pendulum {
    /// Returns the direction of the ball at its lowest point, forward and left of the robot; a unit vector.
    pub fn direction(&self) -> [f64; 2] {
        towards(self.direction_deg)
    }

    /// Returns the time from the release to the lowest point \[s\]: `(π / 2) √(L / g) / agm(1, cos(θ / 2))`, exact for
    /// a point on a string that is released at the angle θ.
    pub fn fall_s(&self) -> f64 {
        let half_angle = 0.5 * (1.0 - self.release_height_m / self.string_m).acos();
        FRAC_PI_2 * (self.string_m / GRAVITY_M_S2).sqrt() / arithmetic_geometric_mean(1.0, half_angle.cos())
    }

    /// Returns the first contact of the ball with the robot, if there was one.
    pub fn impact(&self, trace: &Trace) -> Option<Impact> {
        let [ahead, left] = self.direction();
        let first = trace.frames.iter().position(|frame| frame.peak_obstacle_force_n > 0.0)?;
        let along = |frame: &Frame| frame.velocity_in_heading[0] * ahead + frame.velocity_in_heading[1] * left;
        let before = along(trace.frames.get(first.checked_sub(1)?)?);
        let blow = trace.frames[first..].iter().take((LONGEST_BLOW_S / trace.period_s).round() as usize);
        let change = metrics::largest(blow, along)? - before;
        let time_s = trace.frames[first].time_s - trace.period_s;
        Some(Impact { time_s, push: [change * ahead, change * left] })
    }

    fn rig(&self, trunk: &Extent) -> Rig {
        let [ahead, left] = self.direction();
        // The ball comes from behind its direction and touches that end of the trunk.
        let reach =
            |component: f64, end: f64| if component.abs() < 1e-9 { f64::INFINITY } else { end / component.abs() };
        let along = if ahead > 0.0 { trunk.behind } else { trunk.ahead };
        let trunk_m = reach(ahead, along).min(reach(left, trunk.side));
        let lowest_m = -(trunk_m + self.radius_m);
        let away_m = (self.string_m.powi(2) - (self.string_m - self.release_height_m).powi(2)).sqrt();
        let at = |along: f64, height: f64| [ahead * along, left * along, height];
        let place = at(lowest_m, self.string_m);
        let pivot = Holder { name: "pivot".into(), place, radius_m: 0.025, has_post: false };
        let (place, shape) = (at(lowest_m - away_m, self.release_height_m), LoadShape::Ball(self.radius_m));
        let (holders, load) = (vec![pivot], Load { name: "ball".into(), place, mass_kg: self.mass_kg, shape });
        let (lead_s, release_s, until_s) = (self.fall_s(), self.at_s, f64::INFINITY);
        Rig { from: None, holders, load, is_level_with_trunk: true, slack_m: 0.0, lead_s, release_s, until_s }
    }
}

fn arithmetic_geometric_mean(mut a: f64, mut b: f64) -> f64 {
    while (a - b).abs() > 1e-12 * a {
        (a, b) = (0.5 * (a + b), (a * b).sqrt());
    }
    a
}

impl Parameters for Pendulum {
    fn prepare(&self, script: &mut Script, _: u64) -> Result<(), ParameterError> {
        self.check_ranges()?;
        no_turn(&self.task)?;
        // From lower down it would touch the trunk while it is carried along.
        in_range("release-height-m", self.release_height_m, 0.02, self.string_m, "0.02 m to the string's length")?;
        let rig = self.rig(&script.scene.robot.trunk);
        rig.hang_in(&mut script.scene);
        script.disturbances.push(Disturbance::Rig(rig));
        Ok(())
    }

    fn metrics(&self, _: &Script, trace: &Trace, found: &mut Vec<Metric>) {
        let impact = self.impact(trace);
        let after = impact.map(|impact| metrics::window(trace, impact.time_s, impact.time_s + IMPULSE_S));
        // As that of a push.
        let decay = |threshold| metrics::decay(trace, impact?.time_s, impact?.push, threshold, STRIDE_S);
        let [to_10, to_20] = [0.1, 0.2].map(decay);
        let [ahead, left] = self.direction();
        let push = impact.map(|impact| impact.push[0] * ahead + impact.push[1] * left);
        // A fall before the second is over ends the trace, and with it the sum.
        let is_whole = impact
            .zip(trace.frames.last())
            .is_some_and(|(impact, last)| last.time_s + 0.5 * trace.period_s > impact.time_s + IMPULSE_S);
        let impulse = after.filter(|_| is_whole).map(|frames| frames.map(|frame| frame.obstacle_impulse_n_s).sum());
        let peak = metrics::largest(trace.frames.iter(), |frame| frame.peak_obstacle_force_n);
        let numbers = [
            metric("impact_time_s", "hit at", impact.map(|impact| impact.time_s), "s"),
            metric("push_m_s", "velocity change by the hit", push, "m/s"),
            lasting("decay_10_s", "decay to 10 %", to_10),
            lasting("decay_20_s", "decay to 20 %", to_20),
            metric("peak_contact_force_n", "peak contact force", peak.filter(|_| impact.is_some()), "N"),
            metric("contact_impulse_n_s", "impulse in the first second", impulse, "N s"),
        ];
        let reason = |metric: Metric| if impact.is_none() { metric.because("it was not hit") } else { metric };
        found.extend(numbers.map(reason));
    }

    fn delay(&mut self, phase_s: f64) {
        self.at_s += phase_s;
        self.task.duration_s += phase_s;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::catalog::defaults;

    #[test]
    fn swing_time_matches_pendulum_theory() {
        let mut pendulum: Pendulum = defaults("pendulum").unwrap();
        // 1 m: 2π √(1 / 9.81) / 4 = 0.50152 s; from 90° the period is 1.18034 times as long.
        pendulum.release_height_m = 1e-6;
        assert!((pendulum.fall_s() - 0.501_52).abs() < 1e-4, "{}", pendulum.fall_s());
        pendulum.release_height_m = 1.0;
        assert!((pendulum.fall_s() / 0.501_52 - 1.180_34).abs() < 1e-3, "{}", pendulum.fall_s());
    }
}
