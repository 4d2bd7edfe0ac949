/*! The trainer: collects, estimates advantages, learns and advances the curriculum, again and again.

A [`Trainer`] is a run in memory; [`RunFolder`](crate::train::run::RunFolder) stores it on disk.
*/

use std::mem;
use std::sync::Arc;
use std::time::Instant;

use rand::seq::SliceRandom;

use super::checkpoint::{Checkpoint, RunState};
use super::collection::{Collection, Rollout};
use super::environment::{EpisodeFault, LocomotionEnv, Shared};
use super::fault_report::{circumstances, minibatch_csv};
use super::memory::{MemoryError, MemoryEstimate};
use super::metrics::{EpisodeMeans, IterationMetrics, Timing, explained_variance};
use super::symmetry::{self, Mirror, SymmetryError};
use crate::config::{Config, ValueError};
use crate::mujoco;
use crate::network::ActorCritic;
use crate::observation::Layout;
use crate::policy::{AgentError, Policy, Provenance, shipped};
use crate::ppo::{Learner, LearnerState, PrecisionError, Samples, UpdateFault, learner, resolved, weight_after};
use crate::provenance;
use crate::ranks::{Alone, RankError, Ranks, agree, sum_over_samples};
use crate::robot::JOINTS;
use crate::train::Curriculum;
use crate::util::files::FileError;
use crate::util::random::{Purpose, stream};

/// Number of iterations in which a run that starts from a policy leaves it as it is, while the critic learns: without advantages
/// and entropy bonus.
const CRITIC_FIRST: u64 = 20;

/// The reason why training stopped.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// The configuration is invalid.
    #[error(transparent)]
    Config(#[from] ValueError),
    /// The robot's file is invalid.
    #[error(transparent)]
    Robot(#[from] FileError),
    /// The processor does not support the precision.
    #[error(transparent)]
    Precision(#[from] PrecisionError),
    /// An environment could not be set up.
    #[error(transparent)]
    Physics(#[from] mujoco::Error),
    /// The robot or its observation has no mirror image.
    #[error("ppo.symmetry is true, but {0}: make it false")]
    Symmetry(#[from] SymmetryError),
    /// The run needs more memory than the machine has.
    #[error(transparent)]
    Memory(#[from] MemoryError),
    /// The update produced numbers that are not finite.
    #[error("the learner stopped in iteration {iteration}: {fault}")]
    Learner {
        /// Number of finished iterations.
        iteration: u64,
        /// The fault of the update.
        fault: Box<UpdateFault>,
        /// The minibatch that failed, as CSV with a row for each sample; empty if no single minibatch failed.
        minibatch: String,
        /// Report on the update and the rollout before it, as JSON.
        circumstances: String,
    },
    /// The number of ranks is not a power of two.
    #[error("there are {0} ranks, expected a power of two: change mpirun's -n")]
    Count(usize),
    /// A rank failed; the error is reported on all of them.
    #[error(transparent)]
    Rank(#[from] RankError),
    /// The run cannot start from the policy that its configuration names.
    #[error("run.start_from: {0}")]
    Start(String),
    /// A checkpoint does not fit its own configuration.
    #[error("the checkpoint does not fit its configuration: {0}")]
    Checkpoint(String),
}

/// A training run in memory.
///
/// ```
/// use supple::config::Config;
/// use supple::train::Trainer;
///
/// let small = ["ppo.batch_size=128", "ppo.minibatch_size=64", "ppo.environments=8", "ppo.hidden_layers=[16]"];
/// let config = Config::load_with("fast", &small.map(str::to_owned))?;
/// let (seed, threads) = (0, 1);
/// let mut trainer = Trainer::new("small", config, seed, threads)?;
/// let metrics = trainer.iterate()?; // collects a batch and learns from it
/// assert_eq!(metrics.samples, 128);
/// assert_eq!(trainer.policy().layout().length(), 83); // `policy().save(path)` writes the policy file
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Trainer {
    /// State of the run without the environments.
    run: RunState,
    shared: Shared,
    /// The mirror, if mirrored samples are used.
    mirror: Option<Mirror>,
    threads: usize,
    ranks: Arc<dyn Ranks>,
    learner: Box<dyn Learner>,
    environments: Vec<LocomotionEnv>,
    /// The samples of an iteration with their images, whose memory serves the next one too.
    doubled: Samples,
    /// Physics faults of the last iteration.
    faults: Vec<EpisodeFault>,
}

impl Trainer {
    /// Starts a new run.
    ///
    /// # Errors
    /// A value of the configuration is out of range, or the robot's model cannot be simulated.
    pub fn new(config_name: &str, config: Config, seed: u64, threads: usize) -> Result<Self, TrainError> {
        Self::with_ranks(Alone::shared(), config_name, config, seed, threads)
    }

    /// Starts a new run as one of the ranks that train it.
    ///
    /// # Errors
    /// A value of the configuration is out of range or does not fit the number of ranks, or the robot's model cannot be
    /// simulated.
    pub fn with_ranks(
        ranks: Arc<dyn Ranks>,
        config_name: &str,
        mut config: Config,
        seed: u64,
        threads: usize,
    ) -> Result<Self, TrainError> {
        config.check()?;
        check_ranks(&config, &*ranks)?;
        MemoryEstimate::new(&config)?.for_ranks(ranks.here(), ranks.count()).check()?;
        config.ppo.precision = resolved(&config.ppo);
        let shared = Shared::new(&config)?;
        let mirror = mirror(&config, &shared)?;
        let mut rng = stream(seed, Purpose::Weights, 0, 0);
        let ppo = &config.ppo;
        let log_std = ppo.initial_log_std as f32;
        let mut network = ActorCritic::asymmetric(shared.inputs(), &ppo.hidden_layers, JOINTS, log_std, &mut rng);
        let mut curriculum = Curriculum::new(&config.command);
        if let Some(name) = &config.run.start_from {
            network.policy = started_from(name, seed, &config, &shared.layout)?.actor;
            curriculum = Curriculum::complete();
        }
        let learner = learner(ppo, LearnerState::new(network, ppo), threads, Arc::clone(&ranks))?;
        let environments = environments(&config, &shared, seed, curriculum, &*ranks)?;
        let run = RunState {
            config_name: config_name.to_owned(),
            config,
            git_revision: provenance::git_revision().to_owned(),
            mujoco_version: provenance::mujoco_version().to_owned(),
            robot_sha256: shared.robot.sha256().to_owned(),
            seed,
            iteration: 0,
            samples: 0,
            elapsed_s: 0.0,
            curriculum,
            environments: Vec::new(),
        };
        let (doubled, faults) = Default::default();
        Ok(Trainer { run, shared, mirror, threads, ranks, learner, environments, doubled, faults })
    }

    /// Resumes from a checkpoint.
    ///
    /// # Errors
    /// The checkpoint does not fit its own configuration, or the model cannot be simulated.
    pub fn resume(checkpoint: Checkpoint, threads: usize) -> Result<Self, TrainError> {
        Self::resume_with_ranks(Alone::shared(), checkpoint, threads)
    }

    /// Resumes from a checkpoint of any number of ranks, as one of the ranks of the run.
    ///
    /// # Errors
    /// The checkpoint does not fit its own configuration or the number of ranks, or the model cannot be simulated.
    pub fn resume_with_ranks(ranks: Arc<dyn Ranks>, saved: Checkpoint, threads: usize) -> Result<Self, TrainError> {
        let Checkpoint { mut run, learner: state } = saved;
        let (found, expected_environments) = (run.environments.len(), run.config.ppo.environments);
        if found != expected_environments {
            return Err(TrainError::Checkpoint(format!("{found} environments instead of {expected_environments}")));
        }
        check_ranks(&run.config, &*ranks)?;
        let shapes = |networks: &ActorCritic| -> Vec<_> {
            networks.tensors().into_iter().map(|(name, shape, _)| (name, shape)).collect()
        };
        let expected = shapes(&state.parameters);
        if [&state.first_moment, &state.second_moment].into_iter().any(|moment| shapes(moment) != expected) {
            return Err(TrainError::Checkpoint("its moments do not have the shapes of its parameters".into()));
        }
        MemoryEstimate::new(&run.config)?.for_ranks(ranks.here(), ranks.count()).check()?;
        let shared = Shared::new(&run.config)?;
        let mirror = mirror(&run.config, &shared)?;
        let robot = &shared.robot;
        // Another revision may read the robot's file differently; the caller warns that revision and robot differ.
        if robot.sha256() != run.robot_sha256 && run.git_revision == provenance::git_revision() {
            let problem = format!("the robot {} has changed since; put it back, or start anew", robot.name);
            return Err(TrainError::Checkpoint(problem));
        }
        let mut environments = environments(&run.config, &shared, run.seed, run.curriculum, &*ranks)?;
        let ActorCritic { policy, value, .. } = &state.parameters;
        for (name, mlp, inputs, outputs) in
            [("policy", policy, shared.inputs()[0], JOINTS), ("value function", value, shared.inputs()[1], 1)]
        {
            let found = (mlp.inputs(), mlp.outputs());
            if found != (inputs, outputs) {
                return Err(TrainError::Checkpoint(format!(
                    "its {name} maps {} to {} numbers, expected {inputs} to {outputs}",
                    found.0, found.1
                )));
            }
        }
        for (environment, saved) in environments.iter_mut().zip(&run.environments[ranks.share(expected_environments)]) {
            environment.restore(saved)?;
        }
        run.environments.clear();
        (run.git_revision, run.robot_sha256) = (provenance::git_revision().to_owned(), robot.sha256().to_owned());
        run.mujoco_version = provenance::mujoco_version().to_owned();
        let learner = learner(&run.config.ppo, state, threads, Arc::clone(&ranks))?;
        let (doubled, faults) = Default::default();
        Ok(Trainer { run, shared, mirror, threads, ranks, learner, environments, doubled, faults })
    }

    /// Runs one iteration: collects a batch and updates the networks with it.
    ///
    /// # Errors
    /// An environment cannot be reset, or the update meets numbers that are not finite.
    pub fn iterate(&mut self) -> Result<IterationMetrics, TrainError> {
        let started = Instant::now();
        let network = self.learner.parameters();
        let Config { ppo, run, .. } = &self.run.config;
        let part = self.run.samples as f64 / run.samples as f64;
        let (seed, iteration, curriculum) = (self.run.seed, self.run.iteration, self.run.curriculum);
        let threads = self.threads;
        let collection = Collection { network: &network, seed, iteration, steps: ppo.steps(), curriculum, threads };
        let (rollout, episodes) = match collection.collect(&mut self.environments) {
            Ok(mut rollout) => {
                let episodes = mem::take(&mut rollout.episodes);
                (rollout, Ok(episodes))
            }
            Err(error) => (Rollout::default(), Err(TrainError::from(error))),
        };
        let episodes = agree(&*self.ranks, episodes)?.concat();
        self.faults = episodes.iter().filter_map(|episode| episode.fault.as_deref().cloned()).collect();
        let (mut advantages, returns) = rollout.advantages(ppo.discount, ppo.gae_lambda);
        let is_critic_alone = self.run.config.run.start_from.is_some() && self.run.iteration < CRITIC_FIRST;
        if is_critic_alone {
            advantages.fill(0.0);
        }
        let collected = started.elapsed();

        let batch = rollout.batch(&network.log_std, &advantages, &returns);
        let permutations = self.permutations(rollout.len());
        let entropy_coefficient = weight_after(ppo.entropy_coefficient, ppo.final_entropy_coefficient, part);
        self.learner.set_entropy_coefficient(if is_critic_alone { 0.0 } else { entropy_coefficient });
        let batch = match &self.mirror {
            None => batch,
            Some(mirror) => {
                mirror.double(&batch, &network.policy, self.threads, &mut self.doubled);
                self.doubled.batch()
            }
        };
        let statistics = match self.learner.update(&batch, &permutations) {
            Ok(statistics) => statistics,
            Err(fault) => {
                let shards = ppo.shards / self.ranks.count();
                let csv = minibatch_csv(&fault, &rollout, &batch, &*self.ranks);
                let told = circumstances(&fault, &rollout, &episodes, &returns, &network.log_std, shards);
                // The error comes from sums over all ranks, so every rank meets it.
                let told = agree(&*self.ranks, Ok::<_, TrainError>((csv, told)))?;
                let (minibatch, mut circumstances): (String, Vec<_>) = told.into_iter().unzip();
                let circumstances = match circumstances.len() {
                    1 => circumstances.remove(0),
                    _ => serde_json::Value::Array(circumstances),
                };
                let (iteration, circumstances) = (self.run.iteration, format!("{circumstances:#}\n"));
                return Err(TrainError::Learner { iteration, minibatch, circumstances, fault: Box::new(fault) });
            }
        };

        let means = EpisodeMeans::new(&episodes);
        means.advance(&mut self.run.curriculum, self.run.samples, &self.run.config);
        self.run.iteration += 1;
        let (ranks, shards) = (&*self.ranks, self.run.config.ppo.shards / self.ranks.count());
        let samples = rollout.len() * ranks.count();
        self.run.samples += samples as u64;
        let rewards = sum_over_samples(ranks, shards, rollout.len(), |row| f64::from(rollout.rewards[row]));
        let explained_variance = explained_variance(ranks, shards, &rollout, &returns);
        let whole = started.elapsed();
        self.run.elapsed_s += whole.as_secs_f64();
        let log_std = &network.log_std;
        Ok(IterationMetrics {
            iteration: self.run.iteration,
            samples: self.run.samples,
            step_reward: rewards / samples as f64,
            means,
            command_fraction: self.run.curriculum.command_fraction,
            force_fraction: self.run.config.pulls.as_ref().map(|_| self.run.curriculum.force_fraction),
            action_std: log_std.iter().map(|value| f64::from(value.exp())).sum::<f64>() / log_std.len() as f64,
            explained_variance,
            learner: statistics,
            time: Timing::new(
                samples,
                [collected, whole - collected],
                [rollout.together, self.learner.together()],
                self.run.elapsed_s,
            ),
        })
    }

    /// Draws an order of each shard's samples on this rank for every epoch; minibatch by minibatch, and in it shard by
    /// shard.
    fn permutations(&self, samples: usize) -> Vec<Vec<u32>> {
        let (run, ppo, is_mirrored) = (&self.run, &self.run.config.ppo, self.mirror.is_some());
        let shards = self.ranks.share(ppo.shards);
        let (size, part) = (samples / shards.len(), ppo.minibatch_size / ppo.shards);
        let order = |epoch: usize, place: usize, shard: usize| {
            // No more than 1000 epochs.
            let stream = |purpose| stream(run.seed, purpose, run.iteration, epoch as u64 | (shard as u64) << 32);
            let mut order: Vec<u32> = (place * size..(place + 1) * size).map(|row| row as u32).collect();
            order.shuffle(&mut stream(Purpose::Shuffle));
            if is_mirrored {
                symmetry::flip(&mut order, samples, &mut stream(Purpose::Mirror));
            }
            order
        };
        let of_epoch = &|epoch: usize| {
            let orders: Vec<_> = shards.clone().enumerate().map(|(place, shard)| order(epoch, place, shard)).collect();
            let minibatch = |start: usize| orders.iter().flat_map(move |order| &order[start..start + part]).copied();
            (0..size).step_by(part).flat_map(minibatch).collect()
        };
        let mut orders = vec![Vec::new(); ppo.epochs];
        let share = ppo.epochs.div_ceil(self.threads.max(1));
        std::thread::scope(|scope| {
            for (index, orders) in orders.chunks_mut(share).enumerate() {
                let epochs = index * share..;
                scope.spawn(move || orders.iter_mut().zip(epochs).for_each(|(order, epoch)| *order = of_epoch(epoch)));
            }
        });
        orders
    }

    /// Returns the state to resume from, complete on every rank.
    ///
    /// # Errors
    /// Another rank failed while the environments were collected.
    pub fn checkpoint(&self) -> Result<Checkpoint, TrainError> {
        let own = self.environments.iter().map(LocomotionEnv::save).collect::<Vec<_>>();
        let environments = agree(&*self.ranks, Ok::<_, TrainError>(own))?.concat();
        Ok(Checkpoint { run: RunState { environments, ..self.run.clone() }, learner: self.learner.state() })
    }

    /// Returns the present policy, for deployment.
    pub fn policy(&self) -> Policy {
        let (config_name, config, samples) = (self.run.config_name.clone(), self.run.config.clone(), self.run.samples);
        let git_revision = provenance::git_revision().to_owned();
        let mujoco_version = provenance::mujoco_version().to_owned();
        let provenance = Provenance {
            config_name,
            config,
            seed: self.run.seed,
            samples,
            git_revision,
            mujoco_version,
            mean_of: vec![],
        };
        let Shared { robot, layout, .. } = &self.shared;
        Policy::new(&self.learner.parameters(), robot, Layout::clone(layout), provenance)
    }

    methods! {
        /// Returns the physics faults of the last iteration, by environment and then time.
        fn faults(&self) -> &[EpisodeFault] = &self.faults;
        /// Returns the ranks that train the run.
        fn ranks(&self) -> &dyn Ranks = &*self.ranks;
        /// Returns configuration and progress, without the environments.
        fn run(&self) -> &RunState = &self.run;
    }
}

/// Reads the policy from which a run of a seed starts: `NAME-seedN` if there is one, else `NAME`.
fn started_from(name: &str, seed: u64, config: &Config, layout: &Layout) -> Result<Policy, TrainError> {
    let policy = match shipped::find_ours(&format!("{name}-seed{seed}")) {
        Err(AgentError::Unknown { .. }) => shipped::find_ours(name),
        of_seed => of_seed,
    };
    let policy = policy.map_err(|error| TrainError::Start(error.to_string()))?;
    let [found, wanted] = [&policy.provenance.config, config].map(|config| (&config.ppo.hidden_layers, &config.action));
    let differs = match () {
        () if policy.layout() != layout => "observation",
        () if found.0 != wanted.0 => "ppo.hidden_layers",
        () if found.1 != wanted.1 => "action",
        () => return Ok(policy),
    };
    Err(TrainError::Start(format!("{name} has another `{differs}` than this configuration")))
}

/// Builds the mirror if it is used.
fn mirror(config: &Config, shared: &Shared) -> Result<Option<Mirror>, TrainError> {
    let Shared { robot, layout, critic, .. } = shared;
    let mirror = || Mirror::new(layout, critic.as_deref(), robot, &config.action.nominal_pose_rad.joints());
    Ok(config.ppo.symmetry.then(mirror).transpose()?)
}

/// Checks that the shards can be divided equally among the ranks.
fn check_ranks(config: &Config, ranks: &dyn Ranks) -> Result<(), TrainError> {
    let (shards, count) = (config.ppo.shards, ranks.count());
    ensure!(count.is_power_of_two(), TrainError::Count(count));
    if shards.is_multiple_of(count) {
        return Ok(());
    }
    let problem = format!("is {shards}, expected a multiple of the number of ranks ({count})");
    Err(ValueError::Range { key: "ppo.shards".into(), problem }.into())
}

/// Creates the environments of this rank.
fn environments(
    config: &Config,
    shared: &Shared,
    seed: u64,
    curriculum: Curriculum,
    ranks: &dyn Ranks,
) -> mujoco::Result<Vec<LocomotionEnv>> {
    let environment = |index| LocomotionEnv::with_shared(config, shared, seed, index as u64, curriculum);
    ranks.share(config.ppo.environments).map(environment).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::config::{LearnerKind, Precision};
    use crate::observation::{Observed, Quantity};

    /// Returns a configuration of 8 shards with the arithmetic of this machine, with mirrored samples.
    fn sharded(shards: usize) -> Config {
        let mut config = Config::load("fast").unwrap();
        config.ppo.batch_size = 256;
        config.ppo.minibatch_size = 64;
        config.ppo.environments = 16;
        config.ppo.hidden_layers = vec![40, 8];
        config.ppo.shards = shards;
        config
    }

    /// Returns the configuration for a real robot with a tiny learner of 8 shards, on uneven ground, with feet that are held.
    fn real() -> Config {
        let text =
            "{environments: 0.5, levels: 2, rough_m: [0.01, 0.06], boxes_m: [0.02, 0.08], sharpness_factor: 0.33}";
        let changes =
            [format!("terrain={text}"), "held_feet.gap_s=[0.1, 0.3]".to_owned(), "episode.push_gate=0".to_owned()];
        let mut config = Config::load_with("real", &changes).unwrap();
        (config.ppo, config.episode.walking_s) = (sharded(8).ppo, 0.1);
        config
    }

    /// Returns the sharded configuration with a critic that observes more than the policy.
    fn privileged() -> Config {
        let critic_observation = [Quantity::BaseVelocity, Quantity::FootForces, Quantity::Push, Quantity::EncoderBias];
        let critic_observation = critic_observation.map(Observed::now).to_vec();
        Config { critic_observation, ..sharded(8) }
    }

    #[test]
    fn policy_of_a_privileged_critic_is_the_actor_alone() {
        let mut config = privileged();
        (config.ppo.learner, config.ppo.precision, config.ppo.shards) = (LearnerKind::Candle, Precision::F32, 1);
        let mut trainer = Trainer::new("test", config, 0, 1).unwrap();
        trainer.iterate().unwrap();
        let networks = trainer.learner.parameters();
        // 3 + 4 · 3 + 3 + 12 numbers more than the policy.
        assert_eq!((networks.policy.inputs(), networks.value.inputs()), (83, 83 + 30));
        let bytes = trainer.policy().to_bytes().unwrap();
        let policy = Policy::from_bytes(&bytes, std::path::Path::new("policy")).unwrap();
        assert_eq!((policy.layout().length(), &policy.actor), (83, &networks.policy));
        // A checkpoint whose value function observes something else is refused.
        let mut checkpoint = trainer.checkpoint().unwrap();
        checkpoint.run.config.critic_observation.pop();
        let error = Trainer::resume(checkpoint, 1).unwrap_err().to_string();
        assert!(error.contains("another observation") || error.contains("value function maps 113"), "{error}");
    }

    #[test]
    fn run_from_a_policy_teaches_its_critic_first() {
        let small = ["ppo.batch_size=128", "ppo.minibatch_size=64", "ppo.environments=8", "run.start_from=real"];
        let config = Config::load_with("real", &small.map(str::to_owned)).unwrap();
        let mut trainer = Trainer::new("test", config.clone(), 1, 1).unwrap();
        let (before, policy) = (trainer.learner.parameters(), shipped::find_ours("real-seed1").unwrap());
        assert_eq!((&before.policy, trainer.run().curriculum), (&policy.actor, Curriculum::complete()));
        trainer.iterate().unwrap();
        let after = trainer.learner.parameters();
        assert!(before.policy == after.policy && before.log_std == after.log_std && before.value != after.value);
        trainer.run.iteration = CRITIC_FIRST;
        trainer.iterate().unwrap();
        assert!(trainer.learner.parameters().policy != policy.actor);
        for (change, differs) in
            [("ppo.hidden_layers=[16]", "ppo.hidden_layers"), ("action.scale_rad=0.5", "observation")]
        {
            let error = Trainer::new("test", config.with(&[change.to_owned()]).unwrap(), 0, 1).unwrap_err().to_string();
            assert!(error.contains("run.start_from") && error.contains(&format!("`{differs}`")), "{error}");
        }
    }

    #[test]
    fn training_has_same_bits_for_any_threads_and_resumption() {
        let run = |config: &Config, threads: [usize; 3]| {
            let mut trainer = Trainer::new("test", config.clone(), 3, threads[0]).unwrap();
            let mut metrics = Vec::new();
            for (index, threads) in threads.into_iter().enumerate() {
                if index > 0 {
                    let bytes = trainer.checkpoint().unwrap().to_bytes().unwrap();
                    trainer = Trainer::resume(Checkpoint::from_bytes(&bytes).unwrap(), threads).unwrap();
                }
                let of_iteration = trainer.iterate().unwrap();
                metrics.push(IterationMetrics { time: Timing::default(), ..of_iteration });
            }
            let mut end = trainer.checkpoint().unwrap();
            end.run.elapsed_s = 0.0;
            (metrics, end)
        };
        for config in [sharded(8), privileged(), real()] {
            let one = run(&config, [1, 1, 1]);
            assert!(run(&config, [2, 2, 2]) == one && run(&config, [3, 1, 2]) == one);
        }
    }

    #[test]
    fn a_checkpoint_keeps_its_environments_out_of_its_header() {
        let checkpoint = Trainer::new("test", sharded(1), 0, 1).unwrap().checkpoint().unwrap();
        let mut bytes = checkpoint.to_bytes().unwrap();
        // Files with headers of more than 100 MB are refused; one environment has about 10 kB.
        let header = u64::from_le_bytes(*bytes.first_chunk().unwrap());
        assert!(header < 10_000, "{header}");
        assert!(Checkpoint::from_bytes(&bytes).unwrap() == checkpoint);
        // That of the version before had its environments there.
        let at = bytes.windows(10).position(|part| part == b"format\\\":3").unwrap();
        bytes[at + 9] = b'2';
        let error = Checkpoint::from_bytes(&bytes).unwrap_err().to_string();
        assert!(error.contains("its format is 2, this program reads 3: resume with the version"), "{error}");
    }

    #[test]
    fn a_checkpoint_that_no_run_could_have_written_is_refused_by_name() {
        let Checkpoint { run, learner } = Trainer::new("test", real(), 0, 1).unwrap().checkpoint().unwrap();
        let run = serde_json::to_value(&run).unwrap();
        let hold =
            json!({"leg": 4, "from_s": 0, "until_s": 1, "height_m": 0.1, "force_n": 60, "stiffness_n_per_m": 600});
        let holds = json!([{"hold": [hold, {"acts": false, "acted": false, "pin": null}]}]);
        for (place, key, value, expected) in [
            ("/environments/0/progress/plan/dynamics", "latency_s", json!(1e12), "latency_s is 1000000000000"),
            ("/environments/0/world", "disturbances", holds, "the foot of leg 4, expected 0 to 3"),
            ("/environments/1/progress/course", "level", json!(2), "level 2, expected 0 to 1"),
            ("/curriculum", "force_fraction", json!(-1.0), "curriculum.force_fraction is -1, expected 0 to 1"),
            ("/curriculum", "command_fraction", json!(1.5), "curriculum.command_fraction is 1.5, expected 0 to 1"),
        ] {
            let mut changed = run.clone();
            changed.pointer_mut(place).unwrap()[key] = value;
            let changed = Checkpoint { run: serde_json::from_value(changed).unwrap(), learner: learner.clone() };
            let read = Checkpoint::from_bytes(&changed.to_bytes().unwrap()).map_err(|error| error.to_string());
            let resumed = read.and_then(|read| Trainer::resume(read, 1).map_err(|error| error.to_string()));
            let error = resumed.unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn minibatches_take_equally_from_every_shard() {
        let trainer = Trainer::new("test", sharded(4), 0, 1).unwrap();
        let orders = trainer.permutations(256);
        assert!(orders.len() == 8 && orders[0] != orders[1]);
        for order in orders {
            for (index, rows) in order.chunks(16).enumerate() {
                assert!(rows.iter().all(|row| *row as usize % 256 / 64 == index % 4), "{rows:?}");
            }
            let mut samples: Vec<u32> = order.iter().map(|row| row % 256).collect();
            samples.sort_unstable();
            assert!(samples.into_iter().eq(0..256));
        }
    }

    #[test]
    fn with_one_shard_an_order_is_a_plain_shuffle_of_all_samples() {
        let mut config = sharded(1);
        config.ppo.symmetry = false;
        let mut expected: Vec<u32> = (0..256).collect();
        expected.shuffle(&mut stream(5, Purpose::Shuffle, 0, 7));
        assert_eq!(Trainer::new("test", config, 5, 1).unwrap().permutations(256)[7], expected);
    }

    #[test]
    fn shards_that_nothing_divides_by_are_refused_by_name() {
        for (shards, learner, expected) in [
            (3, LearnerKind::Fused, "power of two"),
            (32, LearnerKind::Fused, "ppo.environments (16)"),
            (128, LearnerKind::Fused, "ppo.environments (16)"),
            (2, LearnerKind::Candle, "candle"),
        ] {
            let mut config = sharded(shards);
            config.ppo.learner = learner;
            let error = Trainer::new("test", config, 0, 1).unwrap_err().to_string();
            assert!(error.contains("ppo.shards") && error.contains(expected), "{error}");
        }
    }

    #[test]
    fn nan_in_update_names_iteration_and_minibatch() {
        let mut config = Config::load("compliant").unwrap();
        config.ppo.batch_size = 64;
        config.ppo.minibatch_size = 32;
        config.ppo.environments = 2;
        config.ppo.hidden_layers = vec![8];
        let mut trainer = Trainer::new("test", config, 0, 1).unwrap();
        trainer.iterate().unwrap();
        let before = trainer.policy().to_bytes().unwrap();
        let blind = Arc::new(trainer.shared.layout.blinded());
        trainer.environments.iter_mut().for_each(|environment| environment.see(&blind));
        let error = trainer.iterate().unwrap_err();
        assert!(error.to_string().contains("iteration 1"), "{error}");
        let TrainError::Learner { minibatch, circumstances, .. } = error else { panic!("another error") };
        let told: serde_json::Value = serde_json::from_str(&circumstances).unwrap();
        // At least the first number of each of the 64.
        assert!(told["rollout"]["observations"]["not_finite"].as_u64() >= Some(64), "{told}");
        assert!(told["minibatch"]["policy_loss"].is_null() && told["log_std"].as_array().unwrap().len() == 12);
        assert_eq!(minibatch.lines().count(), 1 + 32);
        assert!(minibatch.lines().nth(1).unwrap().contains("NaN"));
        // The parameters are those before the step that failed.
        assert!(trainer.policy().to_bytes().unwrap() == before);
    }
}
