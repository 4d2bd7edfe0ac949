/*! A spring between the trunk and a moving point: a leash whose holder walks away, or a soft wall.

It acts along one horizontal direction of the world, that of its force, and only one way: it exerts no force while it is
slack. From its start on, the point moves along the direction with a constant speed v, and the trunk's centre of mass by
x:

`s = v t − x − gap,   F = max(0, k s + d ṡ) where s > 0, else 0`

with the stiffness k and the damping d. The force is updated in every physics step: at 700 N/m a robot of 12 kg would
oscillate with a period of 0.8 s, about 200 physics steps.
*/

use nalgebra::Vector3;

use serde::{Deserialize, Serialize};

use super::DisturbanceMark;
use super::rig::RopeForces;
use crate::mujoco::{self, Data, Object};
use crate::robot::HARNESS;
use crate::sim::Sim;

/// A spring between the trunk and a moving point.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Spring {
    /// Kind of the other end.
    pub end: SpringEnd,
    /// Time at which the point starts to move \[s\].
    pub from_s: f64,
    /// Direction of the force and of the point's motion: horizontal unit vector, world frame.
    pub direction: [f64; 2],
    /// Speed of the point [m/s].
    pub speed_m_s: f64,
    /// Distance by which point and trunk can part before the spring is stretched \[m\].
    pub gap_m: f64,
    /// Stiffness k [N/m].
    pub stiffness_n_per_m: f64,
    /// Damping d [N·s/m].
    pub damping_n_s_per_m: f64,
}

/// The other end of a spring.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SpringEnd {
    /// A hand that holds a leash.
    Hand,
    /// A soft wall.
    Wall,
}

impl SpringEnd {
    /// Returns the text of the event when the spring first acts.
    fn text(self) -> &'static str {
        match self {
            SpringEnd::Hand => "the leash is taut",
            SpringEnd::Wall => "meets the wall",
        }
    }
}

/// A spring between the trunk and a point, in a policy step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SpringState {
    /// Stretch in the last physics step; negative while slack \[m\].
    pub stretch_m: f64,
    /// Force on the trunk, mean over the step's physics steps \[N\].
    pub force_n: f64,
    /// Largest force in the step \[N\].
    pub peak_force_n: f64,
}

impl Spring {
    /// Returns the drawn mark of a force of this size \[N\].
    pub(in crate::world) fn mark(&self, force_n: f64) -> Option<DisturbanceMark> {
        let force = [force_n * self.direction[0], force_n * self.direction[1], 0.0];
        (force_n > 0.0).then_some(match self.end {
            SpringEnd::Hand => DisturbanceMark::Rope { force },
            SpringEnd::Wall => DisturbanceMark::Press { force },
        })
    }

    /// Returns the force \[N\] when the spring is stretched by `stretch_m` \[m\], and the stretch grows at `rate_m_s`
    /// [m/s].
    fn force_n(&self, stretch_m: f64, rate_m_s: f64) -> f64 {
        let force_n = self.stiffness_n_per_m * stretch_m + self.damping_n_s_per_m * rate_m_s;
        if stretch_m > 0.0 { force_n.max(0.0) } else { 0.0 }
    }
}

/// The memory of a spring.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(in crate::world) struct Memory {
    /// Id of the site at the trunk's centre of mass.
    harness: usize,
    /// Position of the trunk along the direction when the point started to move \[m\].
    start_m: Option<f64>,
    /// Stretch in the last physics step \[m\].
    stretch_m: Option<f64>,
    #[serde(skip)] // Empty between policy steps.
    forces: RopeForces,
    has_acted: bool,
}

impl Memory {
    /// Looks up the site at the trunk's centre of mass.
    pub(super) fn new(sim: &Sim) -> mujoco::Result<Self> {
        let harness = sim.data().model().id(Object::Site, HARNESS)?;
        Ok(Memory { harness, start_m: None, stretch_m: None, forces: RopeForces::default(), has_acted: false })
    }

    /// Returns the force on the trunk in the coming physics step, world frame \[N\].
    pub(in crate::world) fn force(&mut self, spring: &Spring, data: &Data) -> Vector3<f64> {
        let place = &data.site_positions()[3 * self.harness..];
        let along_m = spring.direction[0] * place[0] + spring.direction[1] * place[1];
        let force_n = self.force_n(spring, data.time_s() - spring.from_s, along_m, data.model().timestep_s());
        Vector3::new(spring.direction[0], spring.direction[1], 0.0) * force_n
    }

    /// Returns the force when the point has moved for `time_s`, the trunk is at `along_m` in its direction, and the
    /// last physics step was `step_s` ago \[N\].
    fn force_n(&mut self, spring: &Spring, time_s: f64, along_m: f64, step_s: f64) -> f64 {
        // Times of physics steps are sums of many small ones.
        if time_s < -1e-9 {
            return 0.0;
        }
        let walked_m = along_m - *self.start_m.get_or_insert(along_m);
        let stretch_m = spring.speed_m_s * time_s - walked_m - spring.gap_m;
        let rate_m_s = self.stretch_m.map_or(0.0, |before_m| (stretch_m - before_m) / step_s);
        let force_n = spring.force_n(stretch_m, rate_m_s);
        self.stretch_m = Some(stretch_m);
        self.forces.add(force_n);
        force_n
    }

    /// Returns the stretch and forces of the last policy step, with an event text if the spring acted for the first time;
    /// `None` before the point has started to move.
    pub(in crate::world) fn after_step(&mut self, spring: &Spring) -> Option<(SpringState, Option<&'static str>)> {
        let forces = std::mem::take(&mut self.forces);
        let stretch =
            SpringState { stretch_m: self.stretch_m?, force_n: forces.mean_n(), peak_force_n: forces.peak_n() };
        let acts_first = stretch.peak_force_n > 0.0 && !std::mem::replace(&mut self.has_acted, true);
        Some((stretch, acts_first.then(|| spring.end.text())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_S: f64 = 1.0 / 240.0;

    /// Creates a leash of 0.2 m that is led to the left at 0.5 m/s from 0 s on.
    fn leash() -> Spring {
        let (direction, speed_m_s, gap_m) = ([0.0, 1.0], 0.5, 0.2);
        let (stiffness_n_per_m, damping_n_s_per_m) = (200.0, 20.0);
        Spring { end: SpringEnd::Hand, from_s: 0.0, direction, speed_m_s, gap_m, stiffness_n_per_m, damping_n_s_per_m }
    }

    fn state() -> Memory {
        Memory { harness: 0, start_m: None, stretch_m: None, forces: RopeForces::default(), has_acted: false }
    }

    #[test]
    fn leash_force_follows_stretch_and_stretch_rate() {
        let (leash, mut state) = (leash(), state());
        // Before the hand sets off, and while the leash is slack: 0.5 · 0.3 = 0.15 m of 0.2 m.
        assert_eq!(state.force_n(&leash, -0.5, 1.0, STEP_S), 0.0);
        assert_eq!(state.after_step(&leash), None);
        assert_eq!(state.force_n(&leash, 0.0, 1.0, STEP_S), 0.0);
        assert_eq!(state.force_n(&leash, 0.3, 1.0, STEP_S), 0.0);
        let (slack, text) = state.after_step(&leash).unwrap();
        assert!((slack.stretch_m + 0.05).abs() < 1e-12 && slack.force_n == 0.0 && text.is_none(), "{slack:?}");
        let mut state = self::state();
        // 0.5 · 0.6 − 0.2 = 0.1 m, growing by 0.5 m/s: 200 · 0.1 + 20 · 0.5 = 30 N.
        state.force_n(&leash, 0.6 - STEP_S, 1.0, STEP_S);
        assert!((state.force_n(&leash, 0.6, 1.0, STEP_S) - 30.0).abs() < 1e-9);
        let (taut, text) = state.after_step(&leash).unwrap();
        assert!((taut.stretch_m - 0.1).abs() < 1e-12 && (taut.peak_force_n - 30.0).abs() < 1e-9, "{taut:?}");
        assert_eq!(text, Some("the leash is taut"));
        // A robot that goes along as fast as the hand keeps the stretch: 200 · 0.1 = 20 N; the event comes once.
        assert!((state.force_n(&leash, 0.6 + STEP_S, 1.0 + 0.5 * STEP_S, STEP_S) - 20.0).abs() < 1e-9);
        assert_eq!(state.after_step(&leash).unwrap().1, None);
    }

    #[test]
    fn walls_press_but_do_not_hold() {
        let (direction, speed_m_s, gap_m, stiffness_n_per_m) = ([-1.0, 0.0], 0.0, 2.0, 700.0);
        let damping_n_s_per_m = 4.0;
        let leash = Spring { direction, speed_m_s, gap_m, stiffness_n_per_m, damping_n_s_per_m, ..leash() };
        let wall = Spring { end: SpringEnd::Wall, ..leash };
        // Its direction is back: a robot at x is at −x along it.
        let mut state = state();
        let mut at = |time_s: f64, x: f64| state.force_n(&wall, time_s, -x, STEP_S);
        assert_eq!(at(0.0, 0.0), 0.0);
        assert_eq!(at(2.5, 2.0), 0.0);
        // 5 cm deep and going deeper at 0.8 m/s: 700 · 0.05 + 4 · 0.8 = 38.2 N.
        at(2.6 - STEP_S, 2.05 - 0.8 * STEP_S);
        assert!((at(2.6, 2.05) - 38.2).abs() < 1e-9);
        // 1 mm deep and leaving at 2 m/s: 700 · 0.001 − 4 · 2 is below zero.
        at(3.0 - STEP_S, 2.001 + 2.0 * STEP_S);
        assert_eq!(at(3.0, 2.001), 0.0);
    }
}
