//! The sections of a configuration. Every struct is a section of the file: a key with its meaning, unit, range and default.

use std::fmt;
use std::sync::Arc;

use garde::Validate;
use serde::{Deserialize, Serialize};

use super::LOG_STD_RANGE;
use super::check::{
    MAX_BATCH_SIZE, MAX_EPOCHS, MAX_STAGE_S, a_step_to_an_hour, at_least_one, between_learning_rates, cost,
    divides_batch, divides_batch_above_one, finite_angles, fraction, known_to_learner, layer_widths, low_and_high,
    not_negative, observable, physics_rate, positive, power_of_two_that_divides, shortest_and_longest, within,
};
use crate::observation::{Layout, Nominal, Observed};
use crate::robot::{JOINTS, Joints, Losses, Robot, same_in_every_leg};
use crate::util::files::FileError;

/// Everything that defines a training run but its seed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct Config {
    /// The robot.
    #[garde(dive)]
    pub robot: RobotModel,
    /// Rates, gains, latency.
    #[garde(dive)]
    pub simulation: Simulation,
    /// The map from network outputs to joint targets.
    #[garde(dive)]
    pub action: Action,
    /// The entries of the observation, in order.
    #[garde(custom(observable))]
    pub observation: Vec<Observed>,
    /// Velocity commands and their curriculum.
    #[garde(dive)]
    pub command: CommandRange,
    /// Stages, pushes, slopes, termination.
    #[garde(dive)]
    pub episode: Episode,
    /// Sustained pulls on the trunk; without this section nothing pulls.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[garde(dive)]
    pub pulls: Option<Pulls>,
    /// Weights and targets of Table II.
    #[garde(dive)]
    pub reward: Reward,
    /// Dynamics randomisation.
    #[garde(dive)]
    pub randomisation: Randomisation,
    /// Table III.
    #[garde(dive)]
    pub ppo: Ppo,
    /// Length of the run.
    #[garde(dive)]
    pub run: Run,
}

/// The robot's model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct RobotModel {
    /// Name of a robot that ships, or path of an MJCF file, or of a YAML file about one.
    #[garde(skip)]
    pub model: String,
    /// Dry friction of every joint [N·m].
    #[serde(default)]
    #[garde(custom(not_negative))]
    pub friction_loss_n_m: f64,
    /// Viscous damping of every joint, beside `K_d` [N·m·s/rad].
    #[serde(default)]
    #[garde(custom(not_negative))]
    pub damping_n_m_s_per_rad: f64,
}

impl RobotModel {
    /// The robot.
    ///
    /// # Errors
    /// See [`Robot::load`].
    pub fn load(&self) -> Result<Arc<Robot>, FileError> {
        let losses = Losses { friction_n_m: self.friction_loss_n_m, damping_n_m_s_per_rad: self.damping_n_m_s_per_rad };
        Ok(Robot::load(&self.model)?.with_losses(losses))
    }

    /// Gives its joints other losses.
    pub fn set_losses(&mut self, losses: Losses) {
        (self.friction_loss_n_m, self.damping_n_m_s_per_rad) = (losses.friction_n_m, losses.damping_n_m_s_per_rad);
    }
}

/// Section IV: physics at 240 Hz, policy at 60 Hz, PD control with delayed targets.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct Simulation {
    /// Physics steps per second.
    #[garde(custom(physics_rate))]
    pub physics_rate_hz: u32,
    /// Policy queries per second; divides the physics rate.
    #[garde(custom(within(1..=1000, " Hz")))]
    pub policy_rate_hz: u32,
    /// `K_p` [N·m/rad].
    #[garde(custom(not_negative))]
    pub kp_n_m_per_rad: f64,
    /// `K_d` [N·m·s/rad].
    #[garde(custom(not_negative))]
    pub kd_n_m_s_per_rad: f64,
    /// Delay of the joint target \[s\].
    #[garde(custom(within(0.0..=1.0, " s")))]
    pub latency_s: f64,
}

impl Simulation {
    /// Physics steps per policy step.
    pub fn substeps(&self) -> usize {
        (self.physics_rate_hz / self.policy_rate_hz) as usize
    }

    /// Duration of a physics step \[s\].
    pub fn timestep_s(&self) -> f64 {
        1.0 / f64::from(self.physics_rate_hz)
    }

    /// Duration of a policy step \[s\].
    pub fn policy_period_s(&self) -> f64 {
        1.0 / f64::from(self.policy_rate_hz)
    }

    /// Policy steps in a duration.
    pub fn policy_steps(&self, duration_s: f64) -> usize {
        (duration_s * f64::from(self.policy_rate_hz)).round() as usize
    }
}

/// Joint target = nominal pose + scale · action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct Action {
    /// Hip, thigh and calf of every leg, or twelve angles in the order of [`crate::robot::LEGS`] \[rad\].
    #[garde(custom(finite_angles))]
    pub nominal_pose_rad: LegPose,
    /// \[rad\] per unit of action.
    #[garde(custom(positive))]
    pub scale_rad: f64,
}

/// Joint angles of one leg, which stand for every leg, or of all four.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "three angles, or twelve")]
pub enum LegPose {
    /// Hip, thigh, calf of every leg.
    Alike([f64; 3]),
    /// One value for each joint.
    Each(Joints),
}

impl LegPose {
    /// Returns the value of each joint.
    pub fn joints(&self) -> Joints {
        match *self {
            LegPose::Alike(leg) => same_in_every_leg(leg),
            LegPose::Each(joints) => joints,
        }
    }
}

impl fmt::Display for LegPose {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            LegPose::Alike(leg) => write!(f, "{leg:?}"),
            LegPose::Each(joints) => write!(f, "{joints:?}"),
        }
    }
}

impl From<Joints> for LegPose {
    fn from(joints: Joints) -> Self {
        let leg = [joints[0], joints[1], joints[2]];
        if same_in_every_leg(leg) == joints { LegPose::Alike(leg) } else { LegPose::Each(joints) }
    }
}

/// Commands are drawn uniformly from ± range · fraction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct CommandRange {
    /// `v_z*` of the paper [m/s].
    #[garde(custom(not_negative))]
    pub forward_m_s: f64,
    /// `v_x*` of the paper [m/s].
    #[garde(custom(not_negative))]
    pub left_m_s: f64,
    /// `ω_y*` of the paper [rad/s].
    #[garde(custom(not_negative))]
    pub yaw_rad_s: f64,
    /// Fraction of the range that is open at first.
    #[garde(custom(fraction))]
    pub initial_fraction: f64,
    /// Widening per iteration.
    #[garde(custom(fraction))]
    pub fraction_step: f64,
    /// Mean `r_lin` above which it is widened.
    #[garde(custom(fraction))]
    pub fraction_gate: f64,
}

/// Section III-C and III-D.
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
    /// Replaces tracking rewards in the recovery stage; false gives the baseline.
    #[garde(skip)]
    pub recovery_stage: bool,
    /// Mean `r_lin` of an iteration's walking stages above which episodes go on to the push, from then on.
    #[garde(custom(fraction))]
    pub push_gate: f64,
    /// Largest push along forward and left [m/s].
    #[garde(custom(not_negative))]
    pub push_speed_m_s: f64,
    /// Largest rotational push about each axis [rad/s].
    #[garde(custom(not_negative))]
    pub push_rate_rad_s: f64,
    /// Largest incline (rise over run).
    #[garde(custom(fraction))]
    pub slope: f64,
    /// Base height below which the robot has fallen \[m\].
    #[garde(custom(not_negative))]
    pub min_height_m: f64,
}

/// Sustained pulls on the trunk from any side, in training; not in the paper.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct Pulls {
    /// The largest pull \[N\].
    #[garde(custom(not_negative))]
    pub force_n: f64,
    /// The shortest and the longest pull \[s\].
    #[garde(custom(shortest_and_longest))]
    pub duration_s: [f64; 2],
    /// The shortest and the longest time between two pulls \[s\].
    #[garde(custom(shortest_and_longest))]
    pub gap_s: [f64; 2],
    /// Growth per iteration of the open fraction of `force_n`, from zero on.
    #[garde(custom(fraction))]
    pub fraction_step: f64,
    /// The mean `r_lin` above which that fraction grows.
    #[garde(custom(fraction))]
    pub fraction_gate: f64,
}

/// Table II and equations 1–3.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct Reward {
    /// `w_lin`.
    #[garde(custom(not_negative))]
    pub linear_velocity: f64,
    /// `w_ang`.
    #[garde(custom(not_negative))]
    pub angular_velocity: f64,
    /// `w_e`.
    #[garde(custom(cost))]
    pub energy: f64,
    /// `w_τ`.
    #[garde(custom(cost))]
    pub torque: f64,
    /// `w_pose`.
    #[garde(custom(cost))]
    pub pose: f64,
    /// `w_cl`.
    #[garde(custom(cost))]
    pub foot_clearance: f64,
    /// `w_h`.
    #[garde(custom(cost))]
    pub foot_height: f64,
    /// `w_f`, not in the paper: time in flight.
    #[garde(custom(cost))]
    pub flight: f64,
    /// The 8 in `r_lin` and `r_ang`.
    #[garde(custom(not_negative))]
    pub tracking_sharpness: f64,
    /// The 10 in `r_pose` [1/m²].
    #[garde(custom(not_negative))]
    pub height_sharpness: f64,
    /// The 0.45 of equation 3.
    #[garde(custom(not_negative))]
    pub negative_sharpness: f64,
    /// `y_des` \[m\].
    #[garde(custom(positive))]
    pub base_height_m: f64,
    /// `p_des` \[m\].
    #[garde(custom(positive))]
    pub foot_height_m: f64,
}

/// Section IV-D.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct Randomisation {
    /// Off for the simulation experiments.
    #[garde(skip)]
    pub enabled: bool,
    /// Range of the floor's sliding friction.
    #[garde(custom(low_and_high))]
    pub friction: [f64; 2],
    /// Standard deviation of the encoders' biases, the paper's calibration offsets \[rad\].
    #[garde(custom(not_negative))]
    pub encoder_bias_sd_rad: f64,
    /// Sliding friction when randomisation is off.
    #[garde(custom(positive))]
    pub default_friction: f64,
}

/// Table III and what Stable-Baselines3 does where the paper is silent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct Ppo {
    /// Samples per iteration.
    #[garde(custom(within(1..=MAX_BATCH_SIZE, "")))]
    pub batch_size: usize,
    /// Samples per gradient step.
    #[garde(custom(divides_batch_above_one))]
    pub minibatch_size: usize,
    /// Passes over the batch.
    #[garde(custom(within(1..=MAX_EPOCHS, "")))]
    pub epochs: usize,
    /// Parts that a run is divided into, a power of two; a run on several [`ranks`](crate::ranks) has at least one for each.
    /// Sums run within each and then over a tree of them: the result depends on it.
    #[serde(default = "one")]
    #[garde(custom(power_of_two_that_divides))]
    pub shards: usize,
    /// The learner that computes the updates.
    #[serde(default)]
    #[garde(skip)]
    pub learner: LearnerKind,
    /// The precision of the learner's arithmetic.
    #[serde(default)]
    #[garde(custom(known_to_learner))]
    pub precision: Precision,
    /// Learns from half of the samples with left and right exchanged.
    #[garde(skip)]
    pub symmetry: bool,
    /// Clip range of the probability ratio.
    #[garde(custom(positive))]
    pub clip_range: f64,
    /// Weight of the entropy bonus.
    #[garde(custom(not_negative))]
    pub entropy_coefficient: f64,
    /// γ.
    #[garde(custom(fraction))]
    pub discount: f64,
    /// λ of generalised advantage estimation.
    #[garde(custom(fraction))]
    pub gae_lambda: f64,
    /// KL divergence at which the learning rate aims.
    #[garde(custom(positive))]
    pub desired_kl: f64,
    /// Logarithm of the initial standard deviation.
    #[garde(custom(within(LOG_STD_RANGE.map(f64::from)[0]..=LOG_STD_RANGE.map(f64::from)[1], "")))]
    pub initial_log_std: f64,
    /// Widths of the hidden layers of both networks.
    #[garde(custom(layer_widths))]
    pub hidden_layers: Vec<usize>,
    /// Parallel environments; divides the batch size.
    #[garde(custom(divides_batch))]
    pub environments: usize,
    /// Weight of the value loss.
    #[garde(custom(not_negative))]
    pub value_coefficient: f64,
    /// Largest norm of the joint gradient.
    #[garde(custom(positive))]
    pub max_gradient_norm: f64,
    /// ε of Adam.
    #[garde(custom(positive))]
    pub adam_epsilon: f64,
    /// Learning rate of the first gradient step.
    #[garde(custom(between_learning_rates))]
    pub initial_learning_rate: f64,
    /// Lower bound of the adaptive rate.
    #[garde(custom(positive))]
    pub min_learning_rate: f64,
    /// Upper bound of the adaptive rate.
    #[garde(custom(positive))]
    pub max_learning_rate: f64,
}

fn one() -> usize {
    1
}

/// What computes PPO's updates: see [`crate::ppo`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LearnerKind {
    /// The fast one.
    #[default]
    Fused,
    /// The one to read and to change.
    Candle,
}

/// The arithmetic of the fused learner. A run keeps to the one in which it began.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    /// `mixed` where the processor can, else `f32`; what it comes to is written into the run.
    Auto,
    /// On any processor; in use before there was a choice.
    #[default]
    F32,
    /// On tile units: outputs as exact as f32, gradients of operands rounded to bf16.
    Mixed,
    /// On tile units: both as exact as f32, with three bf16 products for one of f32.
    #[serde(rename = "bf16x3")]
    Bf16x3,
    /// On tile units: bf16 operands throughout.
    Bf16,
}

impl Ppo {
    /// Steps of each environment in a batch.
    pub fn steps(&self) -> usize {
        self.batch_size / self.environments
    }
}

/// Length of the run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Validate)]
#[serde(deny_unknown_fields)]
#[garde(context(Config))]
pub struct Run {
    /// Samples in all.
    #[garde(skip)]
    pub samples: u64,
    /// Iterations between checkpoints.
    #[garde(custom(at_least_one))]
    pub checkpoint_every: u64,
    /// Samples between policies that are kept beside the newest, as `policy-SAMPLES.safetensors`; without it, none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[garde(inner(custom(at_least_one)))]
    pub keep_policy_every: Option<u64>,
}

impl Config {
    /// The largest velocity that an outer loop may command, forward and left, unless the command itself is larger [m/s].
    pub fn outer_loop_limits_m_s(&self) -> [f64; 2] {
        [self.command.forward_m_s, self.command.left_m_s]
    }

    /// Builds the layout of the observation.
    ///
    /// # Errors
    /// In words: the entry, what was found and what was expected.
    pub fn layout(&self) -> Result<Layout, String> {
        Layout::new(&self.observation, &self.nominal())
    }

    /// Returns the nominal values that offsets and scales refer to by name.
    pub fn nominal(&self) -> Nominal {
        Nominal {
            pose: self.action.nominal_pose_rad.joints(),
            height_m: self.reward.base_height_m,
            action_scale_rad: [self.action.scale_rad; JOINTS],
        }
    }
}
