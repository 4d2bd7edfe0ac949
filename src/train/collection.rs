/*! Collection of a batch: every worker steps its own environments, and evaluates the policy for all of them at once.

Samples are stored environment by environment, `row = environment · steps + step`, so that a worker writes one
contiguous part of every array. Noise comes from a stream of each environment, and a row's network outputs have the same
bits in any batch: the result does not depend on the number of workers.
*/

use std::time::{Duration, Instant};

use rand::RngExt;
use rand_distr::StandardNormal;

use crate::mujoco;
use crate::network::{ActorCritic, PackedMlp, Scratch};
use crate::ppo::{Batch, DiagonalGaussian, Together};
use crate::train::Curriculum;
use crate::train::environment::{EpisodeEnd, EpisodeReport, LocomotionEnv};
use crate::util::random::{Purpose, stream};

/// A batch of `n = environments · steps` samples.
#[derive(Debug, Clone, Default)]
pub struct Rollout {
    /// Number of steps of each environment.
    pub steps: usize,
    /// Normalised observations, shape (n, observation).
    pub observations: Vec<f32>,
    /// Normalised observations of the critic, shape (n, critic's observation); empty if they are those of the policy.
    pub critic_observations: Vec<f32>,
    /// Actions as sampled, shape (n, actions).
    pub actions: Vec<f32>,
    /// Mean actions of the policy that sampled, shape (n, actions).
    pub means: Vec<f32>,
    /// Log-probabilities of the actions, shape (n).
    pub log_probs: Vec<f32>,
    /// Rewards of the steps, shape (n).
    pub rewards: Vec<f32>,
    /// Values of the observations, shape (n).
    pub values: Vec<f32>,
    /// Ends of episodes by step, shape (n).
    pub ends: Vec<Option<EpisodeEnd>>,
    /// Value of the state after each step from which the return continues, at time limits and at the end of the batch;
    /// 0 elsewhere. Shape (n).
    pub bootstraps: Vec<f32>,
    /// Finished episodes, by environment and then time.
    pub episodes: Vec<EpisodeReport>,
    /// Time of the workers.
    pub together: Together,
}

/// Settings of a collection.
#[derive(Debug, Clone, Copy)]
pub struct Collection<'a> {
    /// Networks of the policy and the value function.
    pub network: &'a ActorCritic,
    /// Seed of the run.
    pub seed: u64,
    /// Index of the iteration, for the noise streams.
    pub iteration: u64,
    /// Number of steps of each environment.
    pub steps: usize,
    /// Curriculum of episodes that start during the collection.
    pub curriculum: Curriculum,
    /// Number of worker threads.
    pub threads: usize,
}

impl Collection<'_> {
    /// Steps all environments and returns the batch.
    ///
    /// # Errors
    /// MuJoCo fails at the start of an episode. A fault within an episode only ends that episode.
    pub fn collect(&self, envs: &mut [LocomotionEnv]) -> mujoco::Result<Rollout> {
        let networks = Networks {
            policy: PackedMlp::new(&self.network.policy),
            value: PackedMlp::new(&self.network.value),
            gaussian: DiagonalGaussian::new(&self.network.log_std),
            std: self.network.log_std.iter().map(|log_std| log_std.exp()).collect(),
        };
        let widths = [self.network.policy.inputs(), self.network.value.inputs(), self.network.log_std.len()];
        // What the critic observes in addition to the policy.
        let is_privileged = envs.first().is_some_and(|env| env.critic_layout().is_some());
        let mut rollout = Rollout::zeros(envs.len() * self.steps, self.steps, widths, is_privileged);
        let share = envs.len().div_ceil(self.threads.max(1)).max(1);
        let parts = rollout.parts(share * self.steps, widths);
        let start = Instant::now();
        let episodes: mujoco::Result<Vec<_>> = std::thread::scope(|scope| {
            let networks = &networks;
            let collect =
                |(envs, part)| scope.spawn(move || Ok((self.collect_part(envs, part, networks)?, start.elapsed())));
            let workers: Vec<_> = envs.chunks_mut(share).zip(parts).map(collect).collect();
            // A worker that panicked has broken an invariant: pass the panic on.
            workers.into_iter().map(|worker| worker.join().unwrap_or_else(|p| std::panic::resume_unwind(p))).collect()
        });
        let (episodes, ends): (Vec<_>, Vec<_>) = episodes?.into_iter().unzip();
        rollout.episodes = episodes.concat();
        let wall = start.elapsed();
        let waiting = ends.iter().map(|end| wall - *end).sum::<Duration>() / ends.len().max(1) as u32;
        rollout.together = Together { wall, waiting };
        Ok(rollout)
    }

    /// Steps the environments of a worker, and returns their finished episodes by environment and then time.
    fn collect_part(
        &self,
        envs: &mut [LocomotionEnv],
        rollout: Part<'_>,
        networks: &Networks,
    ) -> mujoco::Result<Vec<EpisodeReport>> {
        let (count, steps) = (envs.len(), self.steps);
        let (length, width) = (self.network.policy.inputs(), self.network.log_std.len());
        let critic_length = self.network.value.inputs();
        let is_privileged = !rollout.critic_observations.is_empty();
        let mut noise: Vec<_> =
            envs.iter().map(|env| stream(self.seed, Purpose::Action, env.index(), self.iteration)).collect();
        let mut scratch = Scratch::default();
        let (mut seen, mut means) = (vec![0.0; count * length], vec![0.0; count * width]);
        // Rows after which the return continues with a value, and the observations of that value.
        let (mut continued, mut final_observations) = (Vec::new(), Vec::new());
        // By environment: sums over them must not depend on which environments a worker has.
        let mut episodes: Vec<Vec<EpisodeReport>> = vec![Vec::new(); count];

        for step in 0..steps {
            for (env, seen) in envs.iter().zip(seen.chunks_exact_mut(length)) {
                env.normalised_observation(seen);
            }
            networks.policy.forward(count, &seen, &mut means, &mut scratch);
            for (index, env) in envs.iter_mut().enumerate() {
                let row = index * steps + step;
                let mean = &means[index * width..(index + 1) * width];
                let action = &mut rollout.actions[row * width..(row + 1) * width];
                for (k, value) in action.iter_mut().enumerate() {
                    *value = mean[k] + networks.std[k] * noise[index].sample::<f32, _>(StandardNormal);
                }
                rollout.log_probs[row] = networks.gaussian.log_prob(mean, action) as f32;
                rollout.means[row * width..(row + 1) * width].copy_from_slice(mean);
                rollout.observations[row * length..(row + 1) * length]
                    .copy_from_slice(&seen[index * length..(index + 1) * length]);
                if is_privileged {
                    env.critic_observation(&mut rollout.critic_observations[row * critic_length..][..critic_length]);
                }

                let (outcome, report) = env.step(action);
                rollout.rewards[row] = outcome.reward as f32;
                rollout.ends[row] = outcome.end;
                episodes[index].extend(report);
                let goes_on =
                    outcome.end == Some(EpisodeEnd::TimeLimit) || (outcome.end.is_none() && step + 1 == steps);
                if goes_on {
                    let start = final_observations.len();
                    final_observations.resize(start + critic_length, 0.0);
                    env.critic_observation(&mut final_observations[start..]);
                    continued.push(row);
                }
                if outcome.end.is_some() {
                    env.reset(self.curriculum)?;
                }
            }
        }

        let seen_by_critic: &[f32] = if is_privileged { rollout.critic_observations } else { rollout.observations };
        networks.value.forward(count * steps, seen_by_critic, rollout.values, &mut scratch);
        let mut final_values = vec![0.0; continued.len()];
        networks.value.forward(continued.len(), &final_observations, &mut final_values, &mut scratch);
        for (row, value) in continued.into_iter().zip(final_values) {
            rollout.bootstraps[row] = value;
        }
        Ok(episodes.concat())
    }
}

/// The rows of a [`Rollout`] that one worker writes; arrays as there.
struct Part<'a> {
    observations: &'a mut [f32],
    critic_observations: &'a mut [f32],
    actions: &'a mut [f32],
    means: &'a mut [f32],
    log_probs: &'a mut [f32],
    rewards: &'a mut [f32],
    values: &'a mut [f32],
    ends: &'a mut [Option<EpisodeEnd>],
    bootstraps: &'a mut [f32],
}

struct Networks {
    policy: PackedMlp,
    value: PackedMlp,
    gaussian: DiagonalGaussian,
    std: Vec<f32>,
}

impl Rollout {
    /// Returns a batch of zeros. `widths` are those of the policy's observation, the critic's, and the actions.
    fn zeros(rows: usize, steps: usize, [length, critic_length, width]: [usize; 3], is_privileged: bool) -> Self {
        Rollout {
            steps,
            observations: vec![0.0; rows * length],
            critic_observations: vec![0.0; if is_privileged { rows * critic_length } else { 0 }],
            actions: vec![0.0; rows * width],
            means: vec![0.0; rows * width],
            log_probs: vec![0.0; rows],
            rewards: vec![0.0; rows],
            values: vec![0.0; rows],
            ends: vec![None; rows],
            bootstraps: vec![0.0; rows],
            ..Rollout::default()
        }
    }

    /// Splits the batch into parts of `rows` rows; the last may have fewer.
    fn parts(&mut self, rows: usize, [length, critic_length, width]: [usize; 3]) -> Vec<Part<'_>> {
        let count = self.rewards.len().div_ceil(rows);
        let mut observations = self.observations.chunks_mut(rows * length);
        let mut critic_observations = self.critic_observations.chunks_mut(rows * critic_length);
        let [mut actions, mut means] = [&mut self.actions, &mut self.means].map(|all| all.chunks_mut(rows * width));
        let all = [&mut self.log_probs, &mut self.rewards, &mut self.values, &mut self.bootstraps];
        let [mut log_probs, mut rewards, mut values, mut bootstraps] = all.map(|all| all.chunks_mut(rows));
        let mut ends = self.ends.chunks_mut(rows);
        let part = |_| Part {
            observations: observations.next().unwrap_or_default(),
            critic_observations: critic_observations.next().unwrap_or_default(),
            actions: actions.next().unwrap_or_default(),
            means: means.next().unwrap_or_default(),
            log_probs: log_probs.next().unwrap_or_default(),
            rewards: rewards.next().unwrap_or_default(),
            values: values.next().unwrap_or_default(),
            ends: ends.next().unwrap_or_default(),
            bootstraps: bootstraps.next().unwrap_or_default(),
        };
        (0..count).map(part).collect()
    }

    /// Returns the number of samples.
    pub fn len(&self) -> usize {
        self.rewards.len()
    }

    /// Returns true if there are no samples.
    pub fn is_empty(&self) -> bool {
        self.rewards.is_empty()
    }

    /// Returns the learner's batch. `log_std` is that of the policy that sampled; advantages and returns have shape
    /// (n).
    pub fn batch<'a>(&'a self, log_std: &'a [f32], advantages: &'a [f32], returns: &'a [f32]) -> Batch<'a> {
        let (observations, critic_observations) = (&self.observations, &self.critic_observations);
        let (actions, means, log_probs) = (&self.actions, &self.means, &self.log_probs);
        Batch { observations, critic_observations, actions, means, log_std, log_probs, advantages, returns }
    }

    /// Computes generalised advantage estimates: advantages and returns (`advantage + value`), shape (n) each.
    ///
    /// `δ_t = r_t + γ V(s_{t+1}) − V(s_t)`, `A_t = δ_t + γ λ A_{t+1}`. After a fall `V(s_{t+1}) = 0`, after a time
    /// limit it is the value of the final observation, and in both cases `A_{t+1} = 0`. The step in which the physics
    /// failed has no next state: `A_t = 0`, and its return is its value.
    pub fn advantages(&self, discount: f64, lambda: f64) -> (Vec<f32>, Vec<f32>) {
        let (mut advantages, mut returns) = (vec![0.0; self.len()], vec![0.0; self.len()]);
        for first in (0..self.len()).step_by(self.steps.max(1)) {
            let mut advantage = 0.0;
            for row in (first..first + self.steps).rev() {
                let last = row + 1 == first + self.steps;
                let next = if self.ends[row].is_some() || last { self.bootstraps[row] } else { self.values[row + 1] };
                let value = f64::from(self.values[row]);
                let delta = f64::from(self.rewards[row]) + discount * f64::from(next) - value;
                advantage = match self.ends[row] {
                    None => delta + discount * lambda * advantage,
                    Some(EpisodeEnd::Fall | EpisodeEnd::TimeLimit) => delta,
                    Some(EpisodeEnd::Fault) => 0.0,
                };
                advantages[row] = advantage as f32;
                returns[row] = (advantage + value) as f32;
            }
        }
        (advantages, returns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mujoco::FIXED_BUFFERS;

    /// Length of the paper's observation.
    const LENGTH: usize = 83;

    #[test]
    fn advantages_follow_the_ends_of_episodes() {
        use EpisodeEnd::{Fall, Fault, TimeLimit};
        for (end, bootstrap, expected) in [
            // γ = 0.5, λ = 0.5: δ = [1 + 10 − 10, 2 + 15 − 20, 3 + 20 − 30] = [1, −3, −7]
            // A₂ = −7, A₁ = −3 − 1.75 = −4.75, A₀ = 1 − 1.1875
            (None, 0.0, [-0.1875, -4.75, -7.0]),
            // δ₁ = 2 − 20 = −18; A₀ = 1 + 10 − 10 − 0.25·18: the next episode stays out
            (Some(Fall), 0.0, [-3.5, -18.0, -7.0]),
            // Cut with final value 24: δ₁ = 2 + 12 − 20 = −6; A₀ = 1 − 0.25·6
            (Some(TimeLimit), 24.0, [-0.5, -6.0, -7.0]),
            // A₁ = 0; δ₀ = 1 + 0.5 · 20 − 10 = 1
            (Some(Fault), 0.0, [1.0, 0.0, -7.0]),
        ] {
            let (rewards, values, ends) = (vec![1.0, 2.0, 3.0], vec![10.0, 20.0, 30.0], vec![None, end, None]);
            let bootstraps = vec![0.0, bootstrap, 40.0];
            let rollout = Rollout { steps: 3, rewards, values, ends, bootstraps, ..Rollout::default() };
            let (advantages, returns) = rollout.advantages(0.5, 0.5);
            for (k, expected) in expected.into_iter().enumerate() {
                let errors = [advantages[k] - expected, returns[k] - rollout.values[k] - expected];
                assert!(errors.iter().all(|error| error.abs() < 1e-4), "{end:?}: {advantages:?} {returns:?}");
            }
        }
    }

    fn collect(threads: usize, disturb: impl Fn(&mut [LocomotionEnv])) -> Rollout {
        let config = crate::config::Config::load("compliant").unwrap();
        let mut rng = stream(2, Purpose::Weights, 0, 0);
        let network = ActorCritic::orthogonal(LENGTH, &[16], 12, -1.0, &mut rng);
        let mut envs: Vec<_> =
            (0..5).map(|index| LocomotionEnv::new(&config, 2, index, Curriculum::complete()).unwrap()).collect();
        disturb(&mut envs);
        let network = &network;
        Collection { network, seed: 2, iteration: 0, steps: 60, curriculum: Curriculum::complete(), threads }
            .collect(&mut envs)
            .unwrap()
    }

    /// Breaks four of the five environments, each in a different way.
    fn break_four(envs: &mut [LocomotionEnv]) {
        // Not a number.
        envs[1].sim_mut().data_mut().velocities_mut()[3] = f64::NAN;
        // A robot that is shot into the ground.
        envs[2].sim_mut().data_mut().velocities_mut()[2] = -1e8;
        // A robot that lies in the ground, with more contacts than there is room for.
        envs[3].sim_mut().data_mut().limit_contacts(8);
        envs[3].sim_mut().data_mut().positions_mut()[2] = 0.0;
        // An error raised inside MuJoCo, on one worker's thread.
        envs[4].sim_mut().data_mut().exhaust_stack();
    }

    #[test]
    fn physics_faults_end_only_their_own_episodes() {
        let calm = collect(2, |_| {});
        let faulty = collect(2, break_four);
        let faults: Vec<_> = faulty.episodes.iter().filter_map(|episode| episode.fault.as_ref()).collect();
        let found: Vec<(u64, String)> =
            faults.iter().map(|fault| (fault.environment, fault.error.to_string())).collect();
        let expected = if FIXED_BUFFERS {
            vec![(1, "unstable"), (2, "contacts is full at 40"), (3, "contacts is full at 8"), (4, "stack overflow")]
        } else {
            vec![(1, "unstable"), (2, "unstable"), (4, "stack overflow")]
        };
        let as_expected = |((environment, message), expected): (&(u64, String), &(u64, &str))| {
            *environment == expected.0 && message.to_lowercase().contains(expected.1)
        };
        assert!(found.len() == expected.len() && found.iter().zip(&expected).all(as_expected), "{found:?}");
        assert!(faults[0].last_second.contains("NaN"));
        let rows = |fault: &crate::train::environment::EpisodeFault| fault.last_second.lines().count() - 1;
        assert!(faults.iter().all(|fault| rows(fault) == (fault.step + 1).min(60)), "{found:?}");
        for fault in &faults {
            assert_eq!(faulty.ends[60 * fault.environment as usize + fault.step], Some(EpisodeEnd::Fault));
        }
        assert!(faulty.observations.iter().chain(&faulty.rewards).all(|value| value.is_finite()));
        let untouched =
            |rollout: &Rollout| (rollout.observations[..60 * LENGTH].to_vec(), rollout.rewards[..60].to_vec());
        assert!(untouched(&calm) == untouched(&faulty), "the other environment must not notice");
    }

    #[test]
    fn neither_batches_nor_faults_depend_on_the_number_of_workers() {
        let disturbances: [fn(&mut [LocomotionEnv]); 2] = [|_| (), break_four];
        for disturb in disturbances {
            let (one, three) = (collect(1, disturb), collect(3, disturb));
            assert_eq!(one.episodes, three.episodes);
            assert!(one.observations == three.observations && one.actions == three.actions);
            assert!(one.values == three.values && one.rewards == three.rewards && one.bootstraps == three.bootstraps);
        }
    }
}
