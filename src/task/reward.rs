/*! The reward: Table II and equations 1 to 3, every term its own function.

`r = max(0, w_lin r_lin + w_ang r_ang + w_h r_h) · exp(0.45 (w_e r_e + w_τ r_τ + w_pose r_pose + w_cl r_cl + w_f r_f))`

The last term, `r_f`, is not the paper's: its reward does not tell a trot from hopping on all fours, and some runs learn to
hop. Its weight is zero unless a configuration asks for it.

Readings where the paper leaves room: `r_e` is the sum of the joints' absolute powers; `r_e` and `r_τ` are means over
the physics steps of a policy step; `ω_z` in `r_ang` is the yaw rate; a foot's height is that of its lowest point;
pitch, roll and height are relative to the ground plane, which on a simulated slope is the world's.
*/

use serde::{Deserialize, Serialize};

use super::episode::Command;
use crate::config::Reward;
use crate::go1::{FootState, Foothold, RobotState};
use crate::sim::{StepObserver, StepSummary};

/// The terms of Table II for one step, before their weights.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Terms {
    /// `r_lin`.
    pub linear_velocity: f64,
    /// `r_ang`.
    pub angular_velocity: f64,
    /// `r_e` \[W\].
    pub energy: f64,
    /// `r_τ` [N²·m²].
    pub torque: f64,
    /// `r_pose`.
    pub pose: f64,
    /// `r_cl` [m⁴/s²].
    pub foot_clearance: f64,
    /// `r_h`.
    pub foot_height: f64,
    /// `r_f`, share of the step in which no foot touched the ground: a few percent in a walk, much more in hopping.
    pub flight: f64,
}

impl Terms {
    /// All terms of a step. `landings` come from the [`SwingTracker`], which needs the past.
    pub fn new(
        state: &RobotState,
        command: &Command,
        summary: &StepSummary,
        landings: &Landings,
        config: &Reward,
    ) -> Self {
        Terms {
            linear_velocity: linear_velocity(state, command, config.tracking_sharpness),
            angular_velocity: angular_velocity(state, command, config.tracking_sharpness),
            energy: summary.power_w,
            torque: summary.squared_torque,
            pose: pose(state, config),
            foot_clearance: foot_clearance(&state.feet, config.foot_height_m),
            foot_height: landings.foot_height,
            flight: landings.flight_share,
        }
    }

    /// Equations 1 to 3.
    pub fn total(&self, weights: &Reward) -> f64 {
        let positive = weights.linear_velocity * self.linear_velocity
            + weights.angular_velocity * self.angular_velocity
            + weights.foot_height * self.foot_height;
        let negative = weights.energy * self.energy
            + weights.torque * self.torque
            + weights.pose * self.pose
            + weights.foot_clearance * self.foot_clearance
            + weights.flight * self.flight;
        positive.max(0.0) * (weights.negative_sharpness * negative).exp()
    }

    /// Adds another step's terms.
    pub fn add(&mut self, other: &Terms) {
        for ((_, sum), (_, value)) in self.fields_mut().into_iter().zip(other.fields()) {
            *sum += value;
        }
    }

    /// The terms divided by a number.
    pub fn divided(mut self, divisor: f64) -> Terms {
        for (_, value) in self.fields_mut() {
            *value /= divisor;
        }
        self
    }

    /// Names and values in the order of Table II, and `r_f`.
    pub fn fields(&self) -> [(&'static str, f64); 8] {
        let mut copy = *self;
        copy.fields_mut().map(|(name, value)| (name, *value))
    }

    fn fields_mut(&mut self) -> [(&'static str, &mut f64); 8] {
        [
            ("linear_velocity", &mut self.linear_velocity),
            ("angular_velocity", &mut self.angular_velocity),
            ("energy", &mut self.energy),
            ("torque", &mut self.torque),
            ("pose", &mut self.pose),
            ("foot_clearance", &mut self.foot_clearance),
            ("foot_height", &mut self.foot_height),
            ("flight", &mut self.flight),
        ]
    }
}

/// `r_lin = exp(−8 ((v_x − v_x*)² + (v_z − v_z*)²))`.
pub fn linear_velocity(state: &RobotState, command: &Command, sharpness: f64) -> f64 {
    let left = state.velocity_in_base.y - command.left;
    let forward = state.velocity_in_base.x - command.forward;
    (-sharpness * (left * left + forward * forward)).exp()
}

/// `r_ang = exp(−8 (ω − ω*)²)` of the yaw rate.
pub fn angular_velocity(state: &RobotState, command: &Command, sharpness: f64) -> f64 {
    let error = state.angular_velocity_in_base.z - command.yaw;
    (-sharpness * error * error).exp()
}

/// `r_pose = φ² + ψ² + 10 (y − y_des)²`.
pub fn pose(state: &RobotState, config: &Reward) -> f64 {
    let (roll, pitch, _) = state.roll_pitch_yaw();
    let height = state.height - config.base_height_m;
    pitch * pitch + roll * roll + config.height_sharpness * height * height
}

/// `r_cl = Σ_i ‖v_i,xz‖² (p_i,y − p_des)²`, horizontal foot speed against missing height.
pub fn foot_clearance(feet: &[FootState; 4], desired_m: f64) -> f64 {
    let of_foot = |foot: &FootState| {
        let [x, y, _] = foot.velocity;
        (x * x + y * y) * (foot.height - desired_m).powi(2)
    };
    feet.iter().map(of_foot).sum()
}

/// Follows every foot through its swing for `r_h = Σ_i (p_i,peak / p_des − 1)²`, paid once when the foot touches down.
///
/// It looks at every physics step: a foot that chatters on the ground at 240 Hz touches down again and again, at a peak
/// of nothing, and pays for it.
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
    looks: usize,
    #[serde(skip)]
    looks_in_flight: usize,
}

/// What a [`SwingTracker`] has gathered since it was last asked.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Landings {
    /// `r_h`.
    pub foot_height: f64,
    /// Swings that ended.
    pub count: usize,
    /// Sum of their peak heights \[m\].
    pub peak_sum_m: f64,
    /// Share of the physics steps in which no foot touched the ground.
    pub flight_share: f64,
}

impl SwingTracker {
    /// Starts with feet as they are; `desired_m` is `p_des`.
    pub fn new(feet: &[FootState; 4], desired_m: f64) -> Self {
        SwingTracker { desired_m, in_contact: feet.map(|foot| foot.contact), ..SwingTracker::default() }
    }

    /// What has landed since the last call.
    pub fn take(&mut self) -> Landings {
        let landings = Landings {
            foot_height: self.paid,
            count: self.landings,
            peak_sum_m: self.landed_m,
            flight_share: self.looks_in_flight as f64 / self.looks.max(1) as f64,
        };
        (self.paid, self.landings, self.landed_m) = (0.0, 0, 0.0);
        (self.looks, self.looks_in_flight) = (0, 0);
        landings
    }
}

impl StepObserver for SwingTracker {
    fn feet(&mut self, feet: &[Foothold; 4]) {
        self.looks += 1;
        self.looks_in_flight += usize::from(feet.iter().all(|foot| !foot.contact));
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
            position: Vector3::zeros(),
            world_from_base: UnitQuaternion::from_euler_angles(0.1, -0.2, 2.0),
            height: 0.36,
            velocity_in_base: Vector3::new(0.7, -0.1, 5.0),
            angular_velocity_in_base: Vector3::new(9.0, 9.0, 0.3),
            gravity_in_base: Vector3::zeros(),
            joint_angles: [0.0; 12],
            joint_rates: [0.0; 12],
            feet: [FootState::default(); 4],
        }
    }

    fn close(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-9, "{found} instead of {expected}");
    }

    #[test]
    fn linear_velocity_term_is_a_bell_over_the_horizontal_error() {
        let command = Command { forward: 0.5, left: 0.2, yaw: 0.0 };
        // exp(−8 ((−0.1 − 0.2)² + (0.7 − 0.5)²)) = exp(−8 · 0.13) = exp(−1.04)
        close(linear_velocity(&state(), &command, 8.0), 0.353_454_681_95);
    }

    #[test]
    fn angular_velocity_term_looks_at_the_yaw_rate_alone() {
        let command = Command { forward: 0.0, left: 0.0, yaw: -0.2 };
        // exp(−8 · 0.5²) = exp(−2)
        close(angular_velocity(&state(), &command, 8.0), 0.135_335_283_236_612_7);
    }

    #[test]
    fn pose_term_adds_pitch_roll_and_ten_times_the_height_error() {
        // 0.2² + 0.1² + 10 · 0.05² = 0.04 + 0.01 + 0.025
        close(pose(&state(), &weights()), 0.075);
    }

    #[test]
    fn clearance_term_weighs_horizontal_foot_speed_with_missing_height() {
        let mut feet = [FootState { height: 0.08, velocity: [1.0, 1.0, 0.0], contact: false }; 4];
        feet[2] = FootState { height: 0.02, velocity: [3.0, 4.0, 100.0], contact: false };
        // (3² + 4²) · 0.06² = 25 · 0.0036
        close(foot_clearance(&feet, 0.08), 0.09);
    }

    #[test]
    fn foot_height_term_is_paid_once_at_touchdown_with_the_peak_of_the_swing() {
        let at = |height: f64, contact: bool| [Foothold { height, contact }; 4];
        let on_ground = [FootState { contact: true, ..FootState::default() }; 4];
        let mut tracker = SwingTracker::new(&on_ground, 0.08);
        for height in [0.04, 0.06, 0.01] {
            tracker.feet(&at(height, false));
            assert_eq!(tracker.take(), Landings { flight_share: 1.0, ..Landings::default() });
        }
        tracker.feet(&at(0.05, false));
        tracker.feet(&at(0.0, true));
        let landings = tracker.take();
        close(landings.flight_share, 0.5);
        // four feet: 4 · (0.06 / 0.08 − 1)² = 4 · 0.0625
        close(landings.foot_height, 0.25);
        close(landings.peak_sum_m, 4.0 * 0.06);
        assert_eq!(landings.count, 4);
        tracker.feet(&at(0.0, true));
        assert_eq!(tracker.take(), Landings::default());
    }

    #[test]
    fn total_follows_equations_one_to_three() {
        let terms = Terms {
            linear_velocity: 0.9,
            angular_velocity: 0.8,
            energy: 40.0,
            torque: 160.0,
            pose: 0.05,
            foot_clearance: 0.01,
            foot_height: 0.25,
            flight: 0.5,
        };
        // r_pos = 0.8·0.9 + 0.5·0.8 − 0.7·0.25 = 0.945
        // r_neg = −0.015·40 − 0.0015·160 − 2·0.05 − 0.1·0.01 = −0.941
        close(terms.total(&weights()), 0.945 * (0.45_f64 * -0.941).exp());
        // − 2 · 0.5
        let against_hops = Reward { flight: -2.0, ..weights() };
        close(terms.total(&against_hops), 0.945 * (0.45_f64 * -1.941).exp());
    }

    #[test]
    fn reward_is_never_negative() {
        let terms = Terms { foot_height: 4.0, ..Terms::default() };
        assert_eq!(terms.total(&weights()), 0.0);
    }
}
