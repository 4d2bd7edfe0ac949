//! The sections of a configuration: one struct for each section of the file.

use std::fmt;
use std::sync::Arc;

use garde::Validate;
use serde::{Deserialize, Serialize};

use super::check::{
    MAX_BATCH_SIZE, MAX_EPOCHS, MAX_SAMPLES, MAX_STAGE_S, a_step_to_an_hour, between_learning_rates, cost, delays,
    divides_batch, finite_angles, gains_not_negative, layer_widths, low_and_high, physics_rate, positive,
    power_of_two_that_divides, rising_to_one, shortest_and_longest, supported_precision, within,
};
use super::{Config, LOG_STD_RANGE};
use crate::robot::{JOINTS, Joints, Losses, Robot, same_in_every_leg};
use crate::util::files::FileError;
use crate::util::numbers::maximum;

/// The robot's model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct RobotModel {
    /// Name of a shipped robot, or path of an MJCF file or of a YAML description of one.
    #[garde(skip)]
    pub model: String,
    /// Dry friction of every joint [N·m].
    #[serde(default)]
    #[garde(custom(within(0.0..=1e3, " N m")))]
    pub friction_loss_n_m: f64,
    /// Viscous damping of every joint, in addition to `K_d` [N·m·s/rad].
    #[serde(default)]
    #[garde(custom(within(0.0..=1e3, " N m s/rad")))]
    pub damping_n_m_s_per_rad: f64,
}

impl RobotModel {
    /// Loads the robot, with the joint losses of this section.
    ///
    /// # Errors
    /// The robot's file is missing, unreadable, or not a quadruped that can be simulated.
    pub fn load(&self) -> Result<Arc<Robot>, FileError> {
        let losses = Losses { friction_n_m: self.friction_loss_n_m, damping_n_m_s_per_rad: self.damping_n_m_s_per_rad };
        Ok(Robot::load(&self.model)?.with_losses(losses))
    }

    /// Sets the joint losses.
    pub fn set_losses(&mut self, losses: Losses) {
        (self.friction_loss_n_m, self.damping_n_m_s_per_rad) = (losses.friction_n_m, losses.damping_n_m_s_per_rad);
    }
}

/// Rates, gains and latency (section IV): physics at 240 Hz, policy at 60 Hz, PD control with delayed targets.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct Simulation {
    /// Physics rate \[Hz\].
    #[garde(custom(physics_rate))]
    pub physics_rate_hz: u32,
    /// Policy rate \[Hz\]; divides the physics rate.
    #[garde(custom(within(1..=1000, " Hz")))]
    pub policy_rate_hz: u32,
    /// Proportional gain `K_p` of the PD controller [N·m/rad].
    #[garde(custom(gains_not_negative))]
    pub kp_n_m_per_rad: PerJoint,
    /// Derivative gain `K_d` of the PD controller [N·m·s/rad].
    #[garde(custom(gains_not_negative))]
    pub kd_n_m_s_per_rad: PerJoint,
    /// Delay of the joint target \[s\].
    #[garde(custom(within(0.0..=1.0, " s")))]
    pub latency_s: f64,
}

impl Simulation {
    methods! {
        /// Returns the number of physics steps in a policy step.
        fn substeps(&self) -> usize = (self.physics_rate_hz / self.policy_rate_hz) as usize;
        /// Returns the duration of a physics step \[s\].
        fn timestep_s(&self) -> f64 = 1.0 / f64::from(self.physics_rate_hz);
        /// Returns the duration of a policy step \[s\].
        fn policy_period_s(&self) -> f64 = 1.0 / f64::from(self.policy_rate_hz);
        /// Returns the number of policy steps in a duration \[s\], rounded.
        fn policy_steps(&self, duration_s: f64) -> usize = (duration_s * f64::from(self.policy_rate_hz)).round() as usize;
    }
}

/// Numbers of the joints: one for all, one for each joint of a leg, or one for each joint.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "a number, three (hip, thigh, calf), or twelve")]
pub enum PerJoint {
    /// The number of every joint.
    Same(f64),
    /// Those of hip, thigh and calf of every leg.
    Alike([f64; 3]),
    /// Twelve, in the order of [`crate::robot::LEGS`].
    Each(Joints),
}

impl PerJoint {
    /// Returns the number of each joint.
    pub fn joints(&self) -> Joints {
        match *self {
            PerJoint::Same(number) => [number; JOINTS],
            PerJoint::Alike(leg) => same_in_every_leg(leg),
            PerJoint::Each(joints) => joints,
        }
    }

    /// Returns these numbers, each replaced.
    pub fn map(self, f: impl Fn(f64) -> f64) -> Self {
        match self {
            PerJoint::Same(number) => PerJoint::Same(f(number)),
            PerJoint::Alike(leg) => PerJoint::Alike(leg.map(f)),
            PerJoint::Each(joints) => PerJoint::Each(joints.map(f)),
        }
    }

    /// Returns the largest of the numbers, or 0 if that is larger.
    pub fn largest(&self) -> f64 {
        self.joints().into_iter().fold(0.0, maximum)
    }
}

impl fmt::Display for PerJoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            PerJoint::Same(number) => write!(f, "{number}"),
            PerJoint::Alike(leg) => write!(f, "{leg:?}"),
            PerJoint::Each(joints) => write!(f, "{joints:?}"),
        }
    }
}

impl From<f64> for PerJoint {
    fn from(number: f64) -> Self {
        PerJoint::Same(number)
    }
}

impl From<Joints> for PerJoint {
    fn from(joints: Joints) -> Self {
        let leg = [joints[0], joints[1], joints[2]];
        if same_in_every_leg(leg) == joints { PerJoint::Alike(leg) } else { PerJoint::Each(joints) }
    }
}

/// The meaning of actions: joint target = nominal pose + scale · action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct Action {
    /// Joint targets at action zero \[rad\]: hip, thigh and calf of every leg, or twelve angles in the order of
    /// [`crate::robot::LEGS`].
    #[garde(custom(finite_angles))]
    pub nominal_pose_rad: PerJoint,
    /// Change of the joint target per unit of action \[rad\].
    #[garde(custom(positive(100.0)))]
    pub scale_rad: f64,
}

/// Range of velocity commands, which are drawn uniformly from ± range · fraction, base frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct CommandRange {
    /// Largest forward velocity, `v_z*` of the paper [m/s].
    #[garde(custom(within(0.0..=100.0, " m/s")))]
    pub forward_m_s: f64,
    /// Largest velocity to the left, `v_x*` of the paper [m/s].
    #[garde(custom(within(0.0..=100.0, " m/s")))]
    pub left_m_s: f64,
    /// Largest yaw rate, `ω_y*` of the paper [rad/s].
    #[garde(custom(within(0.0..=100.0, " rad/s")))]
    pub yaw_rad_s: f64,
    /// Fraction of the range that is open at first.
    #[garde(custom(within(0.0..=1.0, "")))]
    pub initial_fraction: f64,
    /// Increase of the open fraction per iteration.
    #[garde(custom(within(0.0..=1.0, "")))]
    pub fraction_step: f64,
    /// Mean `r_lin` above which the open fraction increases.
    #[garde(custom(within(0.0..=1.0, "")))]
    pub fraction_gate: f64,
}

/// Stages, pushes, slopes and falls of an episode (sections III-C and III-D).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct Episode {
    /// Duration of the walking stage \[s\].
    #[garde(custom(a_step_to_an_hour))]
    pub walking_s: f64,
    /// Duration of the recovery stage, which starts with the push \[s\].
    #[garde(custom(within(0.0..=MAX_STAGE_S, " s")))]
    pub recovery_s: f64,
    /// Duration of the post-recovery stage \[s\].
    #[garde(custom(within(0.0..=MAX_STAGE_S, " s")))]
    pub post_recovery_s: f64,
    /// True replaces the tracking rewards in the recovery stage; false gives the baseline.
    #[garde(skip)]
    pub recovery_stage: bool,
    /// Mean `r_lin` of an iteration's walking stages above which episodes continue to the push, from then on.
    #[garde(custom(within(0.0..=1.0, "")))]
    pub push_gate: f64,
    /// Samples before which no episode continues to the push, whatever `r_lin`: a gait gets calm while nothing disturbs it.
    #[serde(default)]
    #[garde(skip)]
    pub push_from_samples: u64,
    /// Largest push along forward and left [m/s].
    #[garde(custom(within(0.0..=100.0, " m/s")))]
    pub push_speed_m_s: f64,
    /// Largest rotational push about each axis [rad/s].
    #[garde(custom(within(0.0..=100.0, " rad/s")))]
    pub push_rate_rad_s: f64,
    /// Steepest slope of the ground (rise over run).
    #[garde(custom(within(0.0..=1.0, "")))]
    pub slope: f64,
    /// Base height below which the robot has fallen \[m\].
    #[garde(custom(within(0.0..=10.0, " m")))]
    pub min_height_m: f64,
}

/// Sustained pulls on the trunk from any side, in training; not in the paper.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct Pulls {
    /// Largest force of a pull \[N\].
    #[garde(custom(within(0.0..=1e5, " N")))]
    pub force_n: f64,
    /// The shortest and the longest pull \[s\].
    #[garde(custom(shortest_and_longest))]
    pub duration_s: [f64; 2],
    /// The shortest and the longest time between two pulls \[s\].
    #[garde(custom(shortest_and_longest))]
    pub gap_s: [f64; 2],
    /// Increase of the open fraction of `force_n` per iteration, starting at zero.
    #[garde(custom(within(0.0..=1.0, "")))]
    pub fraction_step: f64,
    /// Mean `r_lin` above which that fraction increases.
    #[garde(custom(within(0.0..=1.0, "")))]
    pub fraction_gate: f64,
    /// Upper ends of ranges of the force, as fractions of `force_n`, rising up to 1: each episode draws one of the ranges
    /// with equal probability, and the forces of its pulls from it. `[0, 0.2, 0.5, 1]` leaves a quarter of the episodes
    /// without pulls. One range without it.
    #[serde(default)]
    #[garde(custom(rising_to_one))]
    pub buckets: Vec<f64>,
}

/// Feet that are held back in their swing, as by the edge of a mat or a root, in training; not in the paper.
///
/// A spring without geometry holds a foot horizontally to the place at which it is caught. It lets go when the foot is lifted
/// above the height of the obstacle, touches the ground, or when the time is over. Feet are held once there are pushes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct HeldFeet {
    /// Largest horizontal force on a foot \[N\].
    #[garde(custom(within(0.0..=1e5, " N")))]
    pub force_n: f64,
    /// Stiffness of the spring [N/m].
    #[garde(custom(within(0.0..=20_000.0, " N/m")))]
    pub stiffness_n_per_m: f64,
    /// The lowest and the highest obstacle \[m\]: a foot is held only below its height.
    #[garde(custom(low_and_high))]
    pub height_m: [f64; 2],
    /// The shortest and the longest time for which a foot is held \[s\].
    #[garde(custom(shortest_and_longest))]
    pub duration_s: [f64; 2],
    /// The shortest and the longest time between two of these, for each foot \[s\].
    #[garde(custom(shortest_and_longest))]
    pub gap_s: [f64; 2],
}

/// Weights, targets and sharpnesses of the reward (Table II and equations 1 to 3).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct Reward {
    /// Weight `w_lin` of the linear velocity reward.
    #[garde(custom(within(0.0..=1e6, "")))]
    pub linear_velocity: f64,
    /// Weight `w_ang` of the yaw rate reward.
    #[garde(custom(within(0.0..=1e6, "")))]
    pub angular_velocity: f64,
    /// Weight `w_e` of the energy cost; not above zero.
    #[garde(custom(cost))]
    pub energy: f64,
    /// Weight `w_τ` of the torque cost; not above zero.
    #[garde(custom(cost))]
    pub torque: f64,
    /// Weight `w_pose` of the pose cost; not above zero.
    #[garde(custom(cost))]
    pub pose: f64,
    /// Weight `w_cl` of the foot clearance cost; not above zero.
    #[garde(custom(cost))]
    pub foot_clearance: f64,
    /// Weight `w_h` of the foot height cost; not above zero.
    #[garde(custom(cost))]
    pub foot_height: f64,
    /// Weight `w_f` of the time in flight, a cost that is not in the paper; not above zero.
    #[garde(custom(cost))]
    pub flight: f64,
    /// Sharpness of `r_lin` and `r_ang`; 8 in the paper.
    #[garde(custom(within(0.0..=1e6, "")))]
    pub tracking_sharpness: f64,
    /// Sharpness of the height in `r_pose`; 10 in the paper [1/m²].
    #[garde(custom(within(0.0..=1e6, " per m²")))]
    pub height_sharpness: f64,
    /// Sharpness of the negative part in equation 3; 0.45 in the paper.
    #[garde(custom(within(0.0..=1e6, "")))]
    pub negative_sharpness: f64,
    /// Desired base height `y_des` \[m\].
    #[garde(custom(positive(10.0)))]
    pub base_height_m: f64,
    /// Desired peak height of a foot's swing, `p_des` \[m\].
    #[garde(custom(within(0.001..=10.0, " m")))]
    pub foot_height_m: f64,
    /// The lowest and the highest compliance of a [reference](crate::task::compliance::follow), which is drawn for each episode,
    /// commanded to the policy, and followed by `r_lin` in place of the commanded velocity [m/s/N]. `None`: there is no reference.
    #[garde(inner(custom(low_and_high)))]
    pub reference_m_s_per_n: Option<[f64; 2]>,
}

/// Randomised differences between a simulated and a real robot: those of section IV-D, and others.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct Randomisation {
    /// True randomises the dynamics; false for the simulation experiments.
    #[garde(skip)]
    pub enabled: bool,
    /// Range of the floor's sliding friction.
    #[garde(custom(low_and_high))]
    pub friction: [f64; 2],
    /// Standard deviation of the encoder bias, which the paper calls calibration offset \[rad\].
    #[garde(custom(within(0.0..=10.0, " rad")))]
    pub encoder_bias_sd_rad: f64,
    /// Sliding friction when randomisation is off.
    #[garde(custom(positive(100.0)))]
    pub default_friction: f64,
    /// Largest mass that is added to the trunk or taken from it \[kg\]; 0 if missing, as all of the following.
    #[serde(default)]
    #[garde(custom(within(0.0..=1e4, " kg")))]
    pub trunk_mass_kg: f64,
    /// Largest displacement of the trunk's centre of mass along each axis \[m\].
    #[serde(default)]
    #[garde(custom(within(0.0..=1.0, " m")))]
    pub trunk_offset_m: f64,
    /// Largest relative error of `K_p` and of `K_d`; 0.1 is ± 10 %.
    #[serde(default)]
    #[garde(custom(within(0.0..=1.0, "")))]
    pub gain_error: f64,
    /// The shortest and the longest delay of the joint target \[s\], in place of `simulation.latency_s`.
    #[garde(inner(custom(delays)))]
    pub latency_s: Option<[f64; 2]>,
    /// Largest dry friction of the joints, in addition to the robot's [N·m].
    #[serde(default)]
    #[garde(custom(within(0.0..=1e3, " N m")))]
    pub joint_friction_n_m: f64,
    /// Largest viscous damping of the joints, in addition to the robot's [N·m·s/rad].
    #[serde(default)]
    #[garde(custom(within(0.0..=1e3, " N m s/rad")))]
    pub joint_damping_n_m_s_per_rad: f64,
    /// Standard deviation of the observed angular velocity about each axis in a policy step [rad/s].
    #[serde(default)]
    #[garde(custom(within(0.0..=100.0, " rad/s")))]
    pub gyro_noise_sd_rad_s: f64,
    /// Standard deviation of the constant error of the angular velocity about each axis [rad/s].
    #[serde(default)]
    #[garde(custom(within(0.0..=100.0, " rad/s")))]
    pub gyro_bias_sd_rad_s: f64,
    /// Standard deviation of the constant error of roll and pitch in the observed gravity \[rad\].
    #[serde(default)]
    #[garde(custom(within(0.0..=10.0, " rad")))]
    pub tilt_error_sd_rad: f64,
    /// Standard deviation of the constant error of the observed felt force, forward and left \[N\].
    #[serde(default)]
    #[garde(custom(within(0.0..=1e5, " N")))]
    pub felt_force_error_sd_n: f64,
}

/// Settings of PPO: Table III, and those of Stable-Baselines3 where the paper is silent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct Ppo {
    /// Number of samples in an iteration.
    #[garde(custom(within(1..=MAX_BATCH_SIZE, "")))]
    pub batch_size: usize,
    /// Number of samples in a gradient step.
    #[garde(custom(divides_batch(2)))]
    pub minibatch_size: usize,
    /// Passes over the batch.
    #[garde(custom(within(1..=MAX_EPOCHS, "")))]
    pub epochs: usize,
    /// Number of parts that a run is divided into, a power of two and at least the number of [`ranks`](crate::ranks).
    /// Sums run within each part and then over a tree of the parts, so results depend on it.
    #[serde(default = "one")]
    #[garde(custom(power_of_two_that_divides))]
    pub shards: usize,
    /// The learner that computes the updates.
    #[serde(default)]
    #[garde(skip)]
    pub learner: LearnerKind,
    /// The precision of the learner's arithmetic.
    #[serde(default)]
    #[garde(custom(supported_precision))]
    pub precision: Precision,
    /// True trains on half of the samples with left and right exchanged.
    #[garde(skip)]
    pub symmetry: bool,
    /// Clip range of the probability ratio.
    #[garde(custom(positive(1e6)))]
    pub clip_range: f64,
    /// Weight of the entropy bonus; of the first iteration, with `final_entropy_coefficient`.
    #[garde(custom(within(0.0..=1e3, "")))]
    pub entropy_coefficient: f64,
    /// Weight of the entropy bonus at the last sample of the run, which changes linearly until then; `None`: constant.
    #[garde(inner(custom(within(0.0..=1e3, ""))))]
    pub final_entropy_coefficient: Option<f64>,
    /// Discount factor γ.
    #[garde(custom(within(0.0..=1.0, "")))]
    pub discount: f64,
    /// λ of generalised advantage estimation.
    #[garde(custom(within(0.0..=1.0, "")))]
    pub gae_lambda: f64,
    /// KL divergence that the adaptive learning rate aims at.
    #[garde(custom(positive(1e3)))]
    pub desired_kl: f64,
    /// Logarithm of the initial standard deviation.
    #[garde(custom(within(LOG_STD_RANGE.map(f64::from)[0]..=LOG_STD_RANGE.map(f64::from)[1], "")))]
    pub initial_log_std: f64,
    /// Widths of the hidden layers of both networks.
    #[garde(custom(layer_widths))]
    pub hidden_layers: Vec<usize>,
    /// Parallel environments; divides the batch size.
    #[garde(custom(divides_batch(1)))]
    pub environments: usize,
    /// Weight of the value loss.
    #[garde(custom(within(0.0..=1e6, "")))]
    pub value_coefficient: f64,
    /// Largest norm of the joint gradient; larger gradients are scaled down.
    #[garde(custom(positive(1e6)))]
    pub max_gradient_norm: f64,
    /// ε of Adam.
    #[garde(custom(within(1e-12..=1.0, "")))]
    pub adam_epsilon: f64,
    /// Learning rate of the first gradient step.
    #[garde(custom(between_learning_rates))]
    pub initial_learning_rate: f64,
    /// Lower bound of the adaptive rate.
    #[garde(custom(positive(10.0)))]
    pub min_learning_rate: f64,
    /// Upper bound of the adaptive rate.
    #[garde(custom(positive(10.0)))]
    pub max_learning_rate: f64,
}

fn one() -> usize {
    1
}

/// The implementation of PPO's update, see [`crate::ppo`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LearnerKind {
    /// The fast learner, with gradients written by hand.
    #[default]
    Fused,
    /// The readable learner, with automatic differentiation; for experiments with the loss.
    Candle,
}

/// The arithmetic of the fused learner. It stays the same for a whole run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    /// `mixed` if the processor has tile units, else `f32`; the choice is stored with the run.
    Auto,
    /// Single precision, on any processor; the choice of old runs.
    #[default]
    F32,
    /// On tile units (AMX): outputs as exact as f32, operands of gradients rounded to bf16.
    Mixed,
}

impl Ppo {
    /// Returns the number of steps of each environment in a batch.
    pub fn steps(&self) -> usize {
        self.batch_size / self.environments
    }

    /// Returns the number of weights and biases of a network with these hidden layers.
    pub fn parameters(&self, inputs: usize, outputs: usize) -> u64 {
        let widths = self.hidden_layers.iter().copied().chain([outputs]);
        widths.fold((0, inputs), |(sum, from), to| (sum + (from as u64 + 1) * to as u64, to)).0
    }
}

/// Length of the run, and how often it is saved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct Run {
    /// Number of samples in the whole run.
    #[garde(custom(within(0..=MAX_SAMPLES, "")))]
    pub samples: u64,
    /// Iterations between checkpoints.
    #[garde(custom(within(1..=MAX_SAMPLES, "")))]
    pub checkpoint_every: u64,
    /// Number of samples between policies kept as `policy-SAMPLES.safetensors` in addition to the newest; none are kept
    /// without it.
    #[garde(inner(custom(within(1..=MAX_SAMPLES, ""))))]
    pub keep_policy_every: Option<u64>,
    /// Policy from which the run starts: a file, a run's folder or a shipped one; or several, NAME-seedN, of which each seed takes
    /// its own, or the first if it has none. It observes the same, and its network has the same layers. Commands, pushes and pulls
    /// are complete then.
    #[garde(skip)]
    pub start_from: Option<String>,
}
