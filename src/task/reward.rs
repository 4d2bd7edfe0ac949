/*! The reward: Table II and equations 1 to 3, every term its own function.

`r = max(0, w_lin r_lin + w_ang r_ang + w_h r_h) · exp(0.45 (w_e r_e + w_τ r_τ + w_pose r_pose + w_cl r_cl + w_f r_f))`

The last term, `r_f`, is not the paper's: the paper's reward does not distinguish a trot from hopping on all fours, and
some runs learn to hop. Its weight is zero unless a configuration sets it.

Interpretations where the paper leaves room: `r_e` is the sum of the joints' absolute powers; `r_e` and `r_τ` are means
over the physics steps of a policy step; `ω_z` in `r_ang` is the yaw rate; a foot's height is that of its lowest point;
pitch, roll and height are relative to the ground plane, which on a simulated slope is the world's.
*/

use std::collections::BTreeMap;

use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::config::Reward;
use crate::observation::Command;
use crate::robot::{FootState, Foothold, Joints, RobotState};
use crate::sim::{StepForces, StepObserver, StepSummary};

/// Inputs of the reward terms: one policy step, and what came before it.
#[derive(Debug, Clone, Copy)]
pub struct RewardInput<'a> {
    /// State at the end of the step; its felt force is the true one.
    pub state: &'a RobotState,
    /// State at the end of the step before.
    pub before: &'a RobotState,
    /// Joint targets of this step and of the two before \[rad\]; the nominal pose before the first.
    pub targets: &'a [Joints; 3],
    /// Command to the policy, base frame.
    pub command: &'a Command,
    /// Power and torque over the step.
    pub summary: &'a StepSummary,
    /// Swings that ended in the step.
    pub landings: &'a Landings,
    /// Motor torques, and forces on trunk and feet; in training without a critic's own observation, those of contacts are not
    /// measured, and NaN: see [`World::without_contact_forces`](crate::world::World::without_contact_forces).
    pub forces: &'a StepForces,
    /// Length of the step \[s\].
    pub period_s: f64,
    /// Time at the end of the step since the episode began \[s\].
    pub time_s: f64,
    /// Targets and sharpnesses of the terms.
    pub config: &'a Reward,
}

impl RewardInput<'_> {
    /// Returns the rates of the joint targets [rad/s].
    pub fn target_rates(&self) -> Joints {
        std::array::from_fn(|joint| (self.targets[0][joint] - self.targets[1][joint]) / self.period_s)
    }

    /// Returns the accelerations of the joints, mean over the step [rad/s²].
    pub fn joint_accelerations(&self) -> Joints {
        std::array::from_fn(|joint| (self.state.joint_rates[joint] - self.before.joint_rates[joint]) / self.period_s)
    }
}

/// A term of the reward; its number is its place in [`TERMS`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Term {
    LinearVelocity,
    AngularVelocity,
    Energy,
    Torque,
    Pose,
    FootClearance,
    FootHeight,
    Flight,
}

/// The definition of a term: a line of [`TERMS`].
#[derive(Debug)]
pub struct TermDefinition {
    term: Term,
    /// Name of the term: its key in the configuration and its column in the metrics.
    pub name: &'static str,
    /// The paper's symbol, with a unit where it has one, for plots.
    pub symbol: &'static str,
    /// The sum that the term enters.
    part: Part,
    weight: fn(&Reward) -> f64,
    value: fn(&RewardInput<'_>) -> f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Part {
    /// The positive sum `r_pos`, equation 1.
    Positive,
    /// The negative sum `r_neg`, equation 2.
    Negative,
}

const fn define(
    term: Term,
    name: &'static str,
    symbol: &'static str,
    part: Part,
    weight: fn(&Reward) -> f64,
    value: fn(&RewardInput<'_>) -> f64,
) -> TermDefinition {
    TermDefinition { term, name, symbol, part, weight, value }
}

/// The terms of Table II in order, and `r_f`.
pub const TERMS: &[TermDefinition] = &[
    define(
        Term::LinearVelocity,
        "linear_velocity",
        "r_lin",
        Part::Positive,
        |w| w.linear_velocity,
        |step| linear_velocity(step.state, step.command, step.config.tracking_sharpness),
    ),
    define(
        Term::AngularVelocity,
        "angular_velocity",
        "r_ang",
        Part::Positive,
        |w| w.angular_velocity,
        |step| angular_velocity(step.state, step.command, step.config.tracking_sharpness),
    ),
    define(Term::Energy, "energy", "r_e [W]", Part::Negative, |w| w.energy, |step| step.summary.power_w),
    define(Term::Torque, "torque", "r_τ [N²·m²]", Part::Negative, |w| w.torque, |step| step.summary.squared_torque),
    define(Term::Pose, "pose", "r_pose", Part::Negative, |w| w.pose, |step| pose(step.state, step.config)),
    define(
        Term::FootClearance,
        "foot_clearance",
        "r_cl [m⁴/s²]",
        Part::Negative,
        |w| w.foot_clearance,
        |step| foot_clearance(&step.state.feet, step.config.foot_height_m),
    ),
    define(Term::FootHeight, "foot_height", "r_h", Part::Positive, |w| w.foot_height, |step| step.landings.foot_height),
    define(Term::Flight, "flight", "r_f", Part::Negative, |w| w.flight, |step| step.landings.flight_fraction),
];

const _: () = {
    let mut k = 0;
    while k < TERMS.len() {
        assert!(TERMS[k].term as usize == k, "TERMS is not in the order of Term");
        k += 1;
    }
};

/// The terms of one step, or sums of them, without their weights.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Terms([f64; TERMS.len()]);

impl Terms {
    /// Computes all terms of a step.
    pub fn new(step: &RewardInput<'_>) -> Self {
        Terms(std::array::from_fn(|k| (TERMS[k].value)(step)))
    }

    /// Returns the reward of equations 1 to 3.
    pub fn total(&self, weights: &Reward) -> f64 {
        let sum = |part: Part| {
            let terms = TERMS.iter().zip(self.0).filter(|(term, _)| term.part == part);
            terms.fold(0.0, |sum, (term, value)| sum + (term.weight)(weights) * value)
        };
        sum(Part::Positive).max(0.0) * (weights.negative_sharpness * sum(Part::Negative)).exp()
    }

    /// Adds another step's terms.
    pub fn add(&mut self, other: &Terms) {
        self.0.iter_mut().zip(other.0).for_each(|(sum, value)| *sum += value);
    }

    /// Returns the terms divided by a number.
    pub fn divided(mut self, divisor: f64) -> Terms {
        self.0.iter_mut().for_each(|value| *value /= divisor);
        self
    }

    /// Returns these terms with the tracking terms of `other`, as in the recovery stage.
    pub fn with_tracking_of(mut self, other: &Terms) -> Terms {
        for term in [Term::LinearVelocity, Term::AngularVelocity] {
            self.0[term as usize] = other.0[term as usize];
        }
        self
    }

    /// Returns the linear velocity term `r_lin`.
    pub fn linear_velocity(&self) -> f64 {
        self.0[Term::LinearVelocity as usize]
    }

    /// Returns the fraction of the time in which no foot touched the ground.
    pub fn flight(&self) -> f64 {
        self.0[Term::Flight as usize]
    }

    /// Returns names and values in the order of [`TERMS`].
    pub fn fields(&self) -> impl Iterator<Item = (&'static str, f64)> {
        TERMS.iter().zip(self.0).map(|(term, value)| (term.name, value))
    }
}

impl Serialize for Terms {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(TERMS.len()))?;
        for (name, value) in self.fields() {
            map.serialize_entry(name, &value)?;
        }
        map.end()
    }
}

/// Reads terms by name; missing terms are zero.
impl<'de> Deserialize<'de> for Terms {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let found = BTreeMap::<String, f64>::deserialize(deserializer)?;
        Ok(Terms(std::array::from_fn(|k| found.get(TERMS[k].name).copied().unwrap_or(0.0))))
    }
}

/// Computes `r_lin = exp(−8 ((v_x − v_x*)² + (v_z − v_z*)²))`.
pub fn linear_velocity(state: &RobotState, command: &Command, sharpness: f64) -> f64 {
    let left = state.velocity_in_base.y - command.left;
    let forward = state.velocity_in_base.x - command.forward;
    (-sharpness * (left * left + forward * forward)).exp()
}

/// Computes `r_ang = exp(−8 (ω − ω*)²)` of the yaw rate.
pub fn angular_velocity(state: &RobotState, command: &Command, sharpness: f64) -> f64 {
    let error = state.angular_velocity_in_base.z - command.yaw;
    (-sharpness * error * error).exp()
}

/// Computes `r_pose = φ² + ψ² + 10 (y − y_des)²`.
pub fn pose(state: &RobotState, config: &Reward) -> f64 {
    let (roll, pitch, _) = state.roll_pitch_yaw();
    let height = state.height - config.base_height_m;
    pitch * pitch + roll * roll + config.height_sharpness * height * height
}

/// Computes `r_cl = Σ_i ‖v_i,xz‖² (p_i,y − p_des)²`, horizontal foot speed times missing height.
pub fn foot_clearance(feet: &[FootState; 4], desired_m: f64) -> f64 {
    let of_foot = |foot: &FootState| {
        let [x, y, _] = foot.velocity;
        (x * x + y * y) * (foot.height - desired_m).powi(2)
    };
    feet.iter().map(of_foot).sum()
}

/// Tracks every foot through its swing for `r_h = Σ_i (p_i,peak / p_des − 1)²`, added once when the foot touches down.
///
/// Contacts are checked at every physics step: a foot that chatters on the ground at 240 Hz lands repeatedly with a peak
/// of zero and is penalised.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct SwingTracker {
    desired_m: f64,
    peak_m: [f64; 4],
    in_contact: [bool; 4],
    paid: f64,
    landed_m: f64,
    landings: usize,
    // Zero between policy steps, when checkpoints are written.
    #[serde(skip)]
    steps: usize,
    #[serde(skip)]
    steps_in_flight: usize,
}

/// The landings counted by a [`SwingTracker`] since the last call of [`SwingTracker::take`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Landings {
    /// Sum of the foot height term `r_h` over the landings.
    pub foot_height: f64,
    /// Number of swings that ended.
    pub count: usize,
    /// Sum of the swings' peak heights \[m\].
    pub peak_sum_m: f64,
    /// Fraction of the physics steps in which no foot touched the ground.
    pub flight_fraction: f64,
}

impl SwingTracker {
    /// Creates a tracker that starts with the feet in this state; `desired_m` is the desired peak height `p_des` \[m\].
    pub fn new(feet: &[FootState; 4], desired_m: f64) -> Self {
        SwingTracker { desired_m, in_contact: feet.map(|foot| foot.contact), ..SwingTracker::default() }
    }

    /// Returns the landings since the last call, and resets them.
    pub fn take(&mut self) -> Landings {
        let (count, flight_fraction) = (self.landings, self.steps_in_flight as f64 / self.steps.max(1) as f64);
        let landings = Landings { foot_height: self.paid, count, peak_sum_m: self.landed_m, flight_fraction };
        (self.paid, self.landings, self.landed_m) = (0.0, 0, 0.0);
        (self.steps, self.steps_in_flight) = (0, 0);
        landings
    }
}

impl StepObserver for SwingTracker {
    fn feet(&mut self, feet: &[Foothold; 4]) {
        self.steps += 1;
        self.steps_in_flight += usize::from(feet.iter().all(|foot| !foot.contact));
        for (leg, foot) in feet.iter().enumerate() {
            if !foot.contact {
                self.peak_m[leg] = self.peak_m[leg].max(foot.height);
            } else if !self.in_contact[leg] {
                self.paid += (self.peak_m[leg] / self.desired_m - 1.0).powi(2);
                self.landings += 1;
                self.landed_m += self.peak_m[leg];
                self.peak_m[leg] = 0.0;
            }
            self.in_contact[leg] = foot.contact;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use nalgebra::{UnitQuaternion, Vector3};

    fn weights() -> Reward {
        Config::load("compliant").unwrap().reward
    }

    fn state() -> RobotState {
        RobotState {
            world_from_base: UnitQuaternion::from_euler_angles(0.1, -0.2, 2.0),
            height: 0.36,
            velocity_in_base: Vector3::new(0.7, -0.1, 5.0),
            angular_velocity_in_base: Vector3::new(9.0, 9.0, 0.3),
            ..RobotState::default()
        }
    }

    /// Creates terms from those of Table II in order, and `r_f`; further ones are zero.
    fn terms(values: [f64; 8]) -> Terms {
        let mut terms = Terms::default();
        terms.0[..8].copy_from_slice(&values);
        terms
    }

    fn close(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-9, "{found} instead of {expected}");
    }

    #[test]
    fn linear_velocity_term_is_a_bell_over_the_horizontal_error() {
        let command = Command::velocity(0.5, 0.2, 0.0);
        // exp(−8 ((−0.1 − 0.2)² + (0.7 − 0.5)²)) = exp(−8 · 0.13) = exp(−1.04)
        close(linear_velocity(&state(), &command, 8.0), 0.353_454_681_95);
    }

    #[test]
    fn angular_velocity_term_looks_at_the_yaw_rate_alone() {
        let command = Command::velocity(0.0, 0.0, -0.2);
        // exp(−8 · 0.5²) = exp(−2)
        close(angular_velocity(&state(), &command, 8.0), 0.135_335_283_236_612_7);
    }

    #[test]
    fn pose_term_adds_pitch_roll_and_ten_times_the_height_error() {
        // 0.2² + 0.1² + 10 · 0.05² = 0.04 + 0.01 + 0.025
        close(pose(&state(), &weights()), 0.075);
    }

    #[test]
    fn clearance_term_weighs_foot_speed_with_missing_height() {
        let mut feet = [FootState { height: 0.08, velocity: [1.0, 1.0, 0.0], contact: false }; 4];
        feet[2] = FootState { height: 0.02, velocity: [3.0, 4.0, 100.0], contact: false };
        // (3² + 4²) · 0.06² = 25 · 0.0036
        close(foot_clearance(&feet, 0.08), 0.09);
    }

    #[test]
    fn foot_height_term_counts_swing_peak_once_at_touchdown() {
        let at = |height: f64, contact: bool| [Foothold { height, contact }; 4];
        let on_ground = [FootState { contact: true, ..FootState::default() }; 4];
        let mut tracker = SwingTracker::new(&on_ground, 0.08);
        for height in [0.04, 0.06, 0.01] {
            tracker.feet(&at(height, false));
            assert_eq!(tracker.take(), Landings { flight_fraction: 1.0, ..Landings::default() });
        }
        tracker.feet(&at(0.05, false));
        tracker.feet(&at(0.0, true));
        let landings = tracker.take();
        close(landings.flight_fraction, 0.5);
        // four feet: 4 · (0.06 / 0.08 − 1)² = 4 · 0.0625
        close(landings.foot_height, 0.25);
        close(landings.peak_sum_m, 4.0 * 0.06);
        assert_eq!(landings.count, 4);
        tracker.feet(&at(0.0, true));
        assert_eq!(tracker.take(), Landings::default());
    }

    #[test]
    fn total_follows_equations_one_to_three() {
        // In the order of Table II.
        let all = terms([0.9, 0.8, 40.0, 160.0, 0.05, 0.01, 0.25, 0.5]);
        // r_pos = 0.8·0.9 + 0.5·0.8 − 0.7·0.25 = 0.945
        // r_neg = −0.015·40 − 0.0015·160 − 2·0.05 − 0.1·0.01 = −0.941
        close(all.total(&weights()), 0.945 * (0.45_f64 * -0.941).exp());
        // − 2 · 0.5
        let against_hops = Reward { flight: -2.0, ..weights() };
        close(all.total(&against_hops), 0.945 * (0.45_f64 * -1.941).exp());
    }

    #[test]
    fn reward_is_never_negative() {
        let all = terms([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 4.0, 0.0]);
        assert_eq!(all.total(&weights()), 0.0);
    }

    #[test]
    fn terms_are_kept_by_name_and_one_that_a_file_lacks_is_zero() {
        let all = terms([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);
        let json = serde_json::to_string(&all).unwrap();
        assert!(json.starts_with(r#"{"linear_velocity":1.0,"angular_velocity":2.0,"energy":3.0,"#), "{json}");
        assert_eq!(serde_json::from_str::<Terms>(&json).unwrap(), all);
        let old = serde_json::from_str::<Terms>(r#"{"pose": 5.0}"#).unwrap();
        assert_eq!(old, terms([0.0, 0.0, 0.0, 0.0, 5.0, 0.0, 0.0, 0.0]));
    }
}
