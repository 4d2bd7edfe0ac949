/*! Left-right symmetry: mirror images of samples as additional training data.

A quadruped is nearly its own mirror image about the plane between its left and right legs, and so is the task. A learner
that also trains on mirror images, about half of the time, gets twice the variety from the same physics, and its robot
does not drift to one side. rsl_rl calls this symmetry augmentation. It is off in Table III; the fast presets
use it.
*/

use rand::{Rng, RngExt};

use crate::network::{Mlp, PackedMlp, Scratch};
use crate::observation::{Layout, LayoutError};
use crate::ppo::{Batch, Samples};
use crate::robot::{JOINTS, Joints, Robot, joint_name};

/// The reason why a robot and its observation have no mirror image.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SymmetryError {
    /// The angle of a joint is not that of its mirror image.
    #[error(
        "{} is {} and {} is {} in action.nominal_pose_rad, which leans to one side",
        joint_name(joints[0]), angles_rad[0], joint_name(joints[1]), angles_rad[1]
    )]
    Pose {
        /// Indices of the joint and its mirror image.
        joints: [usize; 2],
        /// Their angles in the nominal pose \[rad\].
        angles_rad: [f64; 2],
    },
    /// A number of the observation has no mirror image.
    #[error(transparent)]
    Observation(#[from] LayoutError),
}

/// Left-right mirror of observations and actions: source index and sign of each number.
#[derive(Debug, Clone, PartialEq)]
pub struct Mirror {
    observation: Vec<(usize, f32)>,
    /// That of the critic's observation; empty if it is the policy's.
    critic: Vec<(usize, f32)>,
    action: Vec<(usize, f32)>,
}

impl Mirror {
    /// Builds the mirror for a robot, its nominal pose \[rad\], its policy's observation and what the critic observes in
    /// addition.
    ///
    /// # Errors
    /// The pose leans to one side, or a quantity of the observation has no mirror image.
    pub fn new(layout: &Layout, critic: Option<&Layout>, robot: &Robot, pose: &Joints) -> Result<Self, SymmetryError> {
        for joint in 0..JOINTS {
            let (image, sign) = robot.mirrored(joint);
            if pose[joint] != sign * pose[image] {
                return Err(SymmetryError::Pose { joints: [joint, image], angles_rad: [pose[joint], pose[image]] });
            }
        }
        let action = |joint| {
            let (image, sign) = robot.mirrored(joint);
            (image, sign as f32)
        };
        let observation = layout.mirrored(robot)?;
        let critic = critic.map_or(Ok(Vec::new()), |added| {
            let start = observation.len();
            let added = added.mirrored(robot)?.into_iter().map(|(index, sign)| (start + index, sign));
            Ok::<_, LayoutError>(observation.iter().copied().chain(added).collect())
        })?;
        Ok(Mirror { observation, critic, action: (0..JOINTS).map(action).collect() })
    }

    /// Writes the n samples of a batch and, as samples n to 2 n, their mirror images.
    ///
    /// Rewards and values do not change in a mirror, and an image is as likely under the mirrored policy as its sample
    /// was under the policy. The means are those of the policy itself, because the learning rate adapts to the policy's
    /// own change, not to its distance from its image.
    pub fn double(&self, batch: &Batch<'_>, policy: &Mlp, threads: usize, doubled: &mut Samples) {
        let policy = &PackedMlp::new(policy);
        let rows = batch.log_probs.len();
        let share = rows.div_ceil(threads.max(1)).max(1);
        let (length, critic_length, width) = (self.observation.len(), self.critic.len().max(1), self.action.len());
        let Samples { observations, critic_observations, actions, means, .. } = &mut *doubled;
        std::thread::scope(|scope| {
            let mut seen = halves(batch.observations, observations, share * length);
            let mut seen_by_critic = halves(batch.critic_observations, critic_observations, share * critic_length);
            let mut done = halves(batch.actions, actions, share * width);
            for (from, to, image) in halves(batch.means, means, share * width) {
                let (seen, done, seen_by_critic) = (seen.next(), done.next(), seen_by_critic.next());
                scope.spawn(move || {
                    to.copy_from_slice(from);
                    reflect(&self.action, done);
                    reflect(&self.critic, seen_by_critic);
                    let seen = reflect(&self.observation, seen);
                    policy.forward(image.len() / width, seen, image, &mut Scratch::default());
                });
            }
        });
        doubled.log_std = batch.log_std.to_vec();
        doubled.log_probs = batch.log_probs.repeat(2);
        doubled.advantages = batch.advantages.repeat(2);
        doubled.returns = batch.returns.repeat(2);
    }
}

/// Rows, their place in the first half of an array, and that of their images in the second.
type Halves<'a> = (&'a [f32], &'a mut [f32], &'a mut [f32]);

/// Gives an array twice the length of `from`, and splits it into parts of `length` numbers of each half.
fn halves<'a>(from: &'a [f32], to: &'a mut Vec<f32>, length: usize) -> impl Iterator<Item = Halves<'a>> {
    to.resize(2 * from.len(), 0.0);
    let (first, second) = to.split_at_mut(from.len());
    let halves = first.chunks_mut(length).zip(second.chunks_mut(length));
    from.chunks(length).zip(halves).map(|(from, (first, second))| (from, first, second))
}

/// Copies rows, writes their images, and returns these.
fn reflect<'a>(sources: &[(usize, f32)], halves: Option<Halves<'a>>) -> &'a [f32] {
    let Some((from, to, image)) = halves else { return &[] };
    to.copy_from_slice(from);
    for (row, image) in from.chunks_exact(sources.len()).zip(image.chunks_exact_mut(sources.len())) {
        for (image, (index, sign)) in image.iter_mut().zip(sources) {
            *image = sign * row[*index];
        }
    }
    image
}

/// Replaces samples of `order`, all of them below `samples`, by their images with probability ½.
pub fn flip(order: &mut [u32], samples: usize, rng: &mut impl Rng) {
    for row in order {
        if rng.random() {
            *row += samples as u32;
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::config::Config;
    use crate::network::ActorCritic;
    use crate::observation::{Command, ObservationInput, Observed, Observer, Privileged, Quantity};
    use crate::robot::{RobotState, same_in_every_leg};
    use crate::util::random::{Purpose, stream};

    const LENGTH: usize = 83;

    fn layout() -> Layout {
        Config::load("compliant").unwrap().layout().unwrap()
    }

    fn mirror() -> Mirror {
        let config = Config::load("compliant").unwrap();
        let robot = config.robot.load().unwrap();
        Mirror::new(&layout(), None, &robot, &config.action.nominal_pose_rad.joints()).unwrap()
    }

    #[test]
    fn a_pose_that_leans_to_one_side_has_no_mirror_image() {
        let pose = same_in_every_leg([0.1, 0.72, -1.44]);
        let error = Mirror::new(&layout(), None, &Robot::load("go1").unwrap(), &pose);
        assert!(error.unwrap_err().to_string().contains("FR_hip is 0.1 and FL_hip is 0.1"));
    }

    /// Returns an observation of a robot that leans, turns, moves and is commanded to its left, or for −1 to its right.
    fn leaning(side: f64) -> Vec<f32> {
        let joint = |values: [f64; 12]| -> [f64; 12] {
            if side > 0.0 {
                values
            } else {
                std::array::from_fn(|k| {
                    let swapped = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8][k];
                    if k % 3 == 0 { -values[swapped] } else { values[swapped] }
                })
            }
        };
        let angles = joint([0.1, 0.7, -1.4, 0.2, 0.8, -1.5, -0.1, 0.6, -1.3, 0.3, 0.9, -1.6]);
        let state = |age: f64| RobotState {
            height: 0.3 + age,
            velocity_in_base: Vector3::new(0.5, side * 0.2, -0.1),
            angular_velocity_in_base: Vector3::new(side * 0.3, 0.4, side * (0.5 + age)),
            gravity_in_base: Vector3::new(-0.5, side * 0.7, -9.7),
            joint_angles: angles,
            joint_rates: joint([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0]),
            ..RobotState::default()
        };
        let command = Command::velocity(0.9, side * 0.4, side * -0.3);
        let (mut observer, layout) = (Observer::new(), layout());
        let (zero, privileged) = (&[0.0; 12], Privileged::default());
        for age in [0.01, 0.0] {
            let (state, command, last_target) = (&state(age), &command, &angles);
            let (last_action, nominal) = (zero, zero);
            let now = ObservationInput { state, command, last_action, last_target, nominal, time_s: 0.0, privileged };
            observer.measure(&layout, &now);
        }
        let mut seen = vec![0.0; LENGTH];
        observer.normalised(&layout, &mut seen);
        seen
    }

    fn image(sources: &[(usize, f32)], rows: &[f32]) -> Vec<f32> {
        reflect(sources, halves(rows, &mut Vec::new(), rows.len()).next()).to_vec()
    }

    #[test]
    fn mirror_of_left_leaning_robot_leans_right() {
        assert_ne!(leaning(1.0), leaning(-1.0));
        assert_eq!(image(&mirror().observation, &leaning(1.0)), leaning(-1.0));
        assert_eq!(image(&mirror().observation, &image(&mirror().observation, &leaning(1.0))), leaning(1.0));
    }

    #[test]
    fn mirror_of_critic_continues_that_of_policy() {
        let critic_observation = vec![Observed::now(Quantity::TrunkForce), Observed::now(Quantity::FootHeights)];
        let config = Config { critic_observation, ..Config::load("compliant").unwrap() };
        let (robot, pose) = (config.robot.load().unwrap(), config.action.nominal_pose_rad.joints());
        let critic = config.critic_layout().unwrap();
        let mirror = Mirror::new(&layout(), critic.as_ref(), &robot, &pose).unwrap();
        let with = |seen: Vec<f32>, added: [f32; 7]| [seen, added.to_vec()].concat();
        let left = with(leaning(1.0), [10.0, 5.0, 1.0, 0.1, 0.2, 0.3, 0.4]);
        let right = with(leaning(-1.0), [10.0, -5.0, 1.0, 0.2, 0.1, 0.4, 0.3]);
        assert_eq!(image(&mirror.critic, &left), right);
    }

    #[test]
    fn actions_change_sides_and_hips_turn_around() {
        let done: Vec<f32> = (1..=12).map(|k| k as f32).collect();
        assert_eq!(image(&mirror().action, &done), [-4.0, 5.0, 6.0, -1.0, 2.0, 3.0, -10.0, 11.0, 12.0, -7.0, 8.0, 9.0]);
    }

    #[test]
    fn images_keep_what_has_no_side_and_have_means_of_their_own() {
        let network = ActorCritic::orthogonal(LENGTH, &[16], 12, -1.0, &mut stream(0, Purpose::Weights, 0, 0));
        let seen = [leaning(1.0), leaning(-1.0), leaning(1.0)].concat();
        let mut evaluated = vec![0.0; 3 * 12];
        PackedMlp::new(&network.policy).forward(3, &seen, &mut evaluated, &mut Scratch::default());
        let (observations, critic_observations, actions) = (&seen, &[], &[[0.5; 12]; 3].concat());
        let (means, log_std, log_probs) = (&evaluated, &network.log_std, &[1.0, 2.0, 3.0]);
        let (advantages, returns) = (&[4.0, 5.0, 6.0], &[7.0, 8.0, 9.0]);
        let batch =
            Batch { observations, critic_observations, actions, means, log_std, log_probs, advantages, returns };
        let images = |threads| {
            let mut doubled = Samples::default();
            mirror().double(&batch, &network.policy, threads, &mut doubled);
            doubled
        };
        let both = images(1);
        assert_eq!(both.means, images(2).means);
        // Samples 1 and 3 are the image of sample 2, which therefore has their means.
        assert_eq!(both.means[4 * 12..5 * 12], evaluated[..12]);
        assert_eq!(both.means[3 * 12..4 * 12], evaluated[12..24]);
        assert_eq!((both.advantages.as_slice(), both.returns[5]), (&[4.0, 5.0, 6.0, 4.0, 5.0, 6.0][..], 9.0));
        assert_eq!(both.log_probs, [1.0, 2.0, 3.0, 1.0, 2.0, 3.0]);
    }

    #[test]
    fn flipping_leaves_every_sample_once_on_either_side() {
        let mut order: Vec<u32> = (0..1000).rev().collect();
        flip(&mut order, 1000, &mut stream(0, Purpose::Shuffle, 0, 0));
        let flipped = order.iter().filter(|row| **row >= 1000).count();
        assert!((400..600).contains(&flipped), "{flipped} of 1000");
        assert!(order.iter().map(|row| row % 1000).eq((0..1000).rev()));
    }
}
