//! The sections of a configuration: one struct for each section of the file.

use std::fmt;
use std::sync::Arc;

use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use crate::observation::{Layout, Nominal, Observed, Scales, paper_layout};
use crate::robot::{JOINTS, Joints, Losses, Robot, same_in_every_leg};
use crate::util::files::FileError;

/// A training configuration: everything that defines a run except its seed.
///
/// ```
/// use supple::config::Config;
///
/// let config = Config::load("compliant")?; // a shipped name, or the path of a YAML file
/// assert_eq!(config.simulation.policy_rate_hz, 60);
/// let changed = config.with(&["ppo.epochs=4".to_owned()])?; // checked like the file itself
/// assert_eq!(changed.ppo.epochs, 4);
/// assert!(config.with(&["ppo.epochs=0".to_owned()]).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The robot and its joint losses.
    pub robot: RobotModel,
    /// Rates, gains and latency of control and physics.
    pub simulation: Simulation,
    /// The map from network outputs to joint targets.
    pub action: Action,
    /// The entries of the observation, in order.
    #[serde(deserialize_with = "observation")]
    pub observation: Vec<Observed>,
    /// Range of velocity commands, and its curriculum.
    pub command: CommandRange,
    /// Stages, pushes, slopes, termination.
    pub episode: Episode,
    /// Sustained pulls on the trunk; none if the section is missing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pulls: Option<Pulls>,
    /// Weights and targets of the reward (Table II).
    pub reward: Reward,
    /// Randomisation of friction and encoder bias.
    pub randomisation: Randomisation,
    /// Settings of PPO (Table III).
    pub ppo: Ppo,
    /// Length of the run, and how often it is saved.
    pub run: Run,
}

/// The robot and the losses in its joints.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotModel {
    /// Name of a shipped robot, or path of an MJCF file or of a YAML description of one.
    pub model: String,
    /// Dry friction of every joint [N·m].
    #[serde(default)]
    pub friction_loss_n_m: f64,
    /// Viscous damping of every joint, in addition to `K_d` [N·m·s/rad].
    #[serde(default)]
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Simulation {
    /// Physics rate \[Hz\].
    pub physics_rate_hz: u32,
    /// Policy rate \[Hz\]; divides the physics rate.
    pub policy_rate_hz: u32,
    /// Proportional gain `K_p` of the PD controller [N·m/rad].
    pub kp_n_m_per_rad: f64,
    /// Derivative gain `K_d` of the PD controller [N·m·s/rad].
    pub kd_n_m_s_per_rad: f64,
    /// Delay of the joint target \[s\].
    pub latency_s: f64,
}

impl Simulation {
    /// Returns the number of physics steps in a policy step.
    pub fn substeps(&self) -> usize {
        (self.physics_rate_hz / self.policy_rate_hz) as usize
    }

    /// Returns the duration of a physics step \[s\].
    pub fn timestep_s(&self) -> f64 {
        1.0 / f64::from(self.physics_rate_hz)
    }

    /// Returns the duration of a policy step \[s\].
    pub fn policy_period_s(&self) -> f64 {
        1.0 / f64::from(self.policy_rate_hz)
    }

    /// Returns the number of policy steps in a duration \[s\], rounded.
    pub fn policy_steps(&self, duration_s: f64) -> usize {
        (duration_s * f64::from(self.policy_rate_hz)).round() as usize
    }
}

/// The meaning of actions: joint target = nominal pose + scale · action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Action {
    /// Joint targets at action zero \[rad\]: hip, thigh and calf of every leg, or twelve angles in the order of
    /// [`crate::robot::LEGS`].
    pub nominal_pose_rad: LegPose,
    /// Change of the joint target per unit of action \[rad\].
    pub scale_rad: f64,
}

/// Joint angles of one leg, used for every leg, or those of all four.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "three angles, or twelve")]
pub enum LegPose {
    /// Hip, thigh and calf of every leg \[rad\].
    Alike([f64; 3]),
    /// Twelve angles, leg by leg \[rad\].
    Each(Joints),
}

impl LegPose {
    /// Returns the angle of each joint \[rad\].
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

/// Range of velocity commands, which are drawn uniformly from ± range · fraction, base frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandRange {
    /// Largest forward velocity, `v_z*` of the paper [m/s].
    pub forward_m_s: f64,
    /// Largest velocity to the left, `v_x*` of the paper [m/s].
    pub left_m_s: f64,
    /// Largest yaw rate, `ω_y*` of the paper [rad/s].
    pub yaw_rad_s: f64,
    /// Fraction of the range that is open at first.
    #[serde(alias = "initial_share")]
    pub initial_fraction: f64,
    /// Increase of the open fraction per iteration.
    #[serde(alias = "share_step")]
    pub fraction_step: f64,
    /// Mean `r_lin` above which the open fraction increases.
    #[serde(alias = "share_gate")]
    pub fraction_gate: f64,
}

/// Stages, pushes, slopes and termination of an episode (sections III-C and III-D).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Episode {
    /// Duration of the walking stage \[s\].
    pub walking_s: f64,
    /// Duration of the recovery stage, which starts with the push \[s\].
    pub recovery_s: f64,
    /// Duration of the post-recovery stage \[s\].
    pub post_recovery_s: f64,
    /// True replaces the tracking rewards in the recovery stage; false gives the baseline.
    pub recovery_stage: bool,
    /// Mean `r_lin` of an iteration's walking stages above which episodes include the push, from then on.
    pub push_gate: f64,
    /// Largest push along forward and left [m/s].
    pub push_speed_m_s: f64,
    /// Largest rotational push about each axis [rad/s].
    pub push_rate_rad_s: f64,
    /// Steepest slope of the ground (rise over run).
    pub slope: f64,
    /// Base height below which the robot counts as fallen \[m\].
    pub min_height_m: f64,
}

/// Sustained pulls on the trunk from any side, in training; not in the paper.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pulls {
    /// Largest force of a pull \[N\].
    pub force_n: f64,
    /// The shortest and the longest pull \[s\].
    pub duration_s: [f64; 2],
    /// The shortest and the longest time between two pulls \[s\].
    pub gap_s: [f64; 2],
    /// Increase of the open fraction of `force_n` per iteration, starting at zero.
    pub fraction_step: f64,
    /// Mean `r_lin` above which that fraction increases.
    pub fraction_gate: f64,
}

/// Weights and targets of the reward (Table II and equations 1 to 3).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reward {
    /// Weight `w_lin` of the linear velocity reward.
    pub linear_velocity: f64,
    /// Weight `w_ang` of the yaw rate reward.
    pub angular_velocity: f64,
    /// Weight `w_e` of the energy cost; not above zero.
    pub energy: f64,
    /// Weight `w_τ` of the torque cost; not above zero.
    pub torque: f64,
    /// Weight `w_pose` of the pose cost; not above zero.
    pub pose: f64,
    /// Weight `w_cl` of the foot clearance cost; not above zero.
    pub foot_clearance: f64,
    /// Weight `w_h` of the foot height cost; not above zero.
    pub foot_height: f64,
    /// Weight `w_f` of the time in flight, a cost that is not in the paper; not above zero.
    pub flight: f64,
    /// Sharpness of `r_lin` and `r_ang`; 8 in the paper.
    pub tracking_sharpness: f64,
    /// Sharpness of the height in `r_pose`; 10 in the paper [1/m²].
    pub height_sharpness: f64,
    /// Sharpness of the negative part in equation 3; 0.45 in the paper.
    pub negative_sharpness: f64,
    /// Desired base height `y_des` \[m\].
    pub base_height_m: f64,
    /// Desired peak height of a foot's swing, `p_des` \[m\].
    pub foot_height_m: f64,
}

/// Dynamics randomisation (section IV-D).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Randomisation {
    /// True randomises the dynamics; false for the simulation experiments.
    pub enabled: bool,
    /// Range of the floor's sliding friction.
    pub friction: [f64; 2],
    /// Standard deviation of the encoder bias, which the paper calls calibration offset \[rad\].
    #[serde(alias = "joint_offset_sd_rad")]
    pub encoder_bias_sd_rad: f64,
    /// Sliding friction when randomisation is off.
    pub default_friction: f64,
}

/// Settings of PPO: Table III, and those of Stable-Baselines3 where the paper is silent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ppo {
    /// Number of samples in an iteration.
    pub batch_size: usize,
    /// Number of samples in a gradient step.
    pub minibatch_size: usize,
    /// Number of passes over the batch.
    pub epochs: usize,
    /// Number of parts that a run is divided into, a power of two and at least the number of [`ranks`](crate::ranks).
    /// Sums run within each part and then over a tree of the parts, so results depend on it.
    #[serde(default = "one")]
    pub shards: usize,
    /// The learner that computes the updates.
    #[serde(default)]
    pub learner: LearnerKind,
    /// The precision of the learner's arithmetic.
    #[serde(default)]
    pub precision: Precision,
    /// True trains on half of the samples with left and right exchanged.
    #[serde(alias = "mirror")]
    pub symmetry: bool,
    /// Clip range of the probability ratio.
    pub clip_range: f64,
    /// Weight of the entropy bonus.
    pub entropy_coefficient: f64,
    /// Discount factor γ.
    pub discount: f64,
    /// λ of generalised advantage estimation.
    pub gae_lambda: f64,
    /// KL divergence that the adaptive learning rate aims at.
    pub desired_kl: f64,
    /// Logarithm of the initial standard deviation of actions.
    pub initial_log_std: f64,
    /// Widths of the hidden layers of both networks.
    pub hidden_layers: Vec<usize>,
    /// Parallel environments; divides the batch size.
    pub environments: usize,
    /// Weight of the value loss.
    pub value_coefficient: f64,
    /// Largest norm of the joint gradient; larger gradients are scaled down.
    pub max_gradient_norm: f64,
    /// Term `ε` in the denominator of Adam's step.
    pub adam_epsilon: f64,
    /// Learning rate of the first gradient step.
    pub initial_learning_rate: f64,
    /// Lower bound of the adaptive rate.
    pub min_learning_rate: f64,
    /// Upper bound of the adaptive rate.
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
    /// On tile units (AMX): all as exact as f32, with three bf16 products in place of one of f32.
    #[serde(rename = "bf16x3")]
    Bf16x3,
    /// On tile units (AMX): bf16 operands throughout.
    Bf16,
}

impl Ppo {
    /// Returns the number of steps of each environment in a batch.
    pub fn steps(&self) -> usize {
        self.batch_size / self.environments
    }
}

/// Length of the run, and how often it is saved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Run {
    /// Number of samples in the whole run.
    pub samples: u64,
    /// Iterations between checkpoints.
    pub checkpoint_every: u64,
    /// Number of samples between policies kept as `policy-SAMPLES.safetensors` in addition to the newest; none are kept
    /// without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub keep_policy_every: Option<u64>,
}

impl Config {
    /// Returns the largest velocity that an outer loop may command, forward and left, unless the command itself is
    /// larger [m/s].
    pub fn outer_loop_limits_m_s(&self) -> [f64; 2] {
        [self.command.forward_m_s, self.command.left_m_s]
    }

    /// Builds the layout of the observation.
    ///
    /// # Errors
    /// An entry of the observation is invalid; the text names it, what was found and what was expected.
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

/// Reads a list of quantities, or from old files the scales of the paper's observation.
fn observation<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Observed>, D::Error> {
    struct ListOrScales;

    impl<'de> Visitor<'de> for ListOrScales {
        type Value = Vec<Observed>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a list of quantities")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<Self::Value, A::Error> {
            Deserialize::deserialize(SeqAccessDeserializer::new(list))
        }

        fn visit_map<A: MapAccess<'de>>(self, scales: A) -> Result<Self::Value, A::Error> {
            Scales::deserialize(MapAccessDeserializer::new(scales)).map(|scales| paper_layout(&scales))
        }
    }

    deserializer.deserialize_any(ListOrScales)
}
