//! Metrics of one training iteration: a flat list of named numbers, one JSON object, one TensorBoard step.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::Curriculum;
use crate::config::Config;
use crate::ppo::{Together, UpdateStatistics};
use crate::ranks::{Ranks, sum_over_samples};
use crate::task::Terms;
use crate::train::collection::Rollout;
use crate::train::environment::{EpisodeEnd, EpisodeReport};
use crate::util::numbers::mean;

/// Metrics of one iteration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IterationMetrics {
    /// Number of finished iterations, this one included.
    pub iteration: u64,
    /// Number of collected samples, this iteration's included.
    pub samples: u64,
    /// Mean reward per step.
    pub step_reward: f64,
    /// Statistics of the episodes that finished.
    #[serde(flatten)]
    pub means: EpisodeMeans,
    /// Open fraction of the command range.
    pub command_fraction: f64,
    /// Open fraction of the largest pull, where there are pulls.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_fraction: Option<f64>,
    /// Mean standard deviation of the actions.
    pub action_std: f64,
    /// Fraction of the returns' variance that the values explain.
    pub explained_variance: f64,
    /// Statistics of the learner's update.
    pub learner: UpdateStatistics,
    /// Wall-clock times; the only numbers that differ between two runs of the same seed.
    pub time: Timing,
}

/// Wall-clock times of an iteration.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Timing {
    /// Time of the collection \[s\].
    pub rollout_s: f64,
    /// Time of the update \[s\].
    pub update_s: f64,
    /// Part of both in which one thread works alone \[s\].
    #[serde(default)]
    pub alone_s: f64,
    /// Part of the rest in which a thread waits for others, mean over the threads \[s\].
    #[serde(default)]
    pub waiting_s: f64,
    /// Samples per second, over the whole iteration [1/s].
    pub samples_per_s: f64,
    /// Training time of the run, over all sessions \[s\].
    pub elapsed_s: f64,
}

impl Timing {
    /// Computes the times from those of collection and update, and from the parts of both in which threads work together.
    pub fn new(samples: usize, [rollout, update]: [Duration; 2], together: [Together; 2], elapsed_s: f64) -> Self {
        let whole = rollout + update;
        let [collected, learnt] = together;
        Timing {
            rollout_s: rollout.as_secs_f64(),
            update_s: update.as_secs_f64(),
            alone_s: whole.saturating_sub(collected.wall + learnt.wall).as_secs_f64(),
            waiting_s: (collected.waiting + learnt.waiting).as_secs_f64(),
            samples_per_s: samples as f64 / whole.as_secs_f64().max(1e-9),
            elapsed_s,
        }
    }
}

/// Means over the episodes that finished in a rollout; `None` if there were none.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpisodeMeans {
    /// Number of finished episodes.
    pub episodes: usize,
    /// Number of episodes that ended in a fall.
    pub falls: usize,
    /// Number of episodes that ended in a physics fault.
    pub faults: usize,
    /// Fraction of episodes that ended in a fall.
    pub fall_rate: Option<f64>,
    /// Falls over episodes, of those that were pushed.
    pub pushed_fall_rate: Option<f64>,
    /// Number of completed walking stages.
    #[serde(skip)]
    pub walks: usize,
    /// Fraction of completed walking stages after which the robot was pushed.
    pub push_fraction: Option<f64>,
    /// Mean sum of rewards of an episode.
    pub episode_reward: Option<f64>,
    /// Mean length of an episode \[steps\].
    pub episode_steps: Option<f64>,
    /// Mean `r_lin` of completed walking stages, 0 to 1.
    pub walking_linear: Option<f64>,
    /// Mean peak height of swings \[m\].
    pub swing_height_m: Option<f64>,
    /// Mean level of the terrain, counted from 0, of the episodes on uneven ground.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub terrain_level: Option<f64>,
    /// Mean terms of Table II per step.
    pub terms: Option<Terms>,
}

impl EpisodeMeans {
    /// Summarises a rollout's finished episodes.
    pub fn new(episodes: &[EpisodeReport]) -> Self {
        let count = |end: EpisodeEnd| episodes.iter().filter(|episode| episode.end == end).count();
        let pushed = || episodes.iter().filter(|episode| episode.pushed);
        let walks = || episodes.iter().filter_map(|episode| episode.walking_linear);
        let fraction = |part: usize, whole: usize| (whole > 0).then(|| part as f64 / whole as f64);
        let mut terms = Terms::default();
        episodes.iter().for_each(|episode| terms.add(&episode.terms));
        let steps: usize = episodes.iter().map(|episode| episode.steps).sum();
        EpisodeMeans {
            episodes: episodes.len(),
            falls: count(EpisodeEnd::Fall),
            faults: count(EpisodeEnd::Fault),
            fall_rate: fraction(count(EpisodeEnd::Fall), episodes.len()),
            pushed_fall_rate: fraction(pushed().filter(|it| it.end == EpisodeEnd::Fall).count(), pushed().count()),
            walks: walks().count(),
            push_fraction: fraction(pushed().count(), walks().count()),
            episode_reward: mean(episodes.iter().map(|episode| episode.reward)),
            episode_steps: mean(episodes.iter().map(|episode| episode.steps as f64)),
            walking_linear: mean(walks()),
            swing_height_m: mean(episodes.iter().filter_map(|episode| episode.swing_height_m)),
            terrain_level: mean(episodes.iter().filter_map(|episode| episode.terrain_level).map(|level| level as f64)),
            terms: (steps > 0).then(|| terms.divided(steps as f64)),
        }
    }
}

impl EpisodeMeans {
    /// Advances the curriculum, if these episodes, which began after so many samples, reached its gates.
    pub fn advance(&self, curriculum: &mut Curriculum, samples: u64, config: &Config) {
        // The mean of a few that walk among many that fall is not representative.
        if let Some(mean) = self.walking_linear.filter(|_| 2 * self.walks >= self.episodes) {
            curriculum.update(mean, samples, config);
        }
    }
}

/// Computes `1 − Var(returns − values) / Var(returns)` over the samples of all ranks; those of this rank are in
/// `shards` shards. Returns 0 if the returns do not vary.
pub fn explained_variance(ranks: &dyn Ranks, shards: usize, rollout: &Rollout, returns: &[f32]) -> f64 {
    let all = (returns.len() * ranks.count()).max(1) as f64;
    let mean = |of: &dyn Fn(usize) -> f64| sum_over_samples(ranks, shards, returns.len(), of) / all;
    let variance = |of: &dyn Fn(usize) -> f64| {
        let center = mean(of);
        mean(&|row| (of(row) - center).powi(2))
    };
    let total = variance(&|row| f64::from(returns[row]));
    let unexplained = variance(&|row| f64::from(returns[row]) - f64::from(rollout.values[row]));
    if total > 0.0 { 1.0 - unexplained / total } else { 0.0 }
}

impl IterationMetrics {
    /// Returns the numbers for TensorBoard, grouped by subject.
    pub fn scalars(&self) -> Vec<(String, f64)> {
        let mut scalars: Vec<(String, f64)> = Vec::new();
        let mut put = |name: &str, value: Option<f64>| scalars.extend(value.map(|value| (name.to_owned(), value)));
        put("episode/reward", self.means.episode_reward);
        put("episode/steps", self.means.episode_steps);
        put("episode/step_reward", Some(self.step_reward));
        put("episode/fall_rate", self.means.fall_rate);
        put("episode/pushed_fall_rate", self.means.pushed_fall_rate);
        put("episode/faults", Some(self.means.faults as f64));
        put("episode/walking_linear", self.means.walking_linear);
        put("episode/swing_height_m", self.means.swing_height_m);
        put("curriculum/command_fraction", Some(self.command_fraction));
        put("curriculum/force_fraction", self.force_fraction);
        put("curriculum/terrain_level", self.means.terrain_level);
        put("curriculum/push_fraction", self.means.push_fraction);
        for (name, value) in self.means.terms.iter().flat_map(Terms::fields) {
            put(&format!("reward/{name}"), Some(value));
        }
        put("learner/policy_loss", Some(self.learner.policy_loss));
        put("learner/value_loss", Some(self.learner.value_loss));
        put("learner/entropy", Some(self.learner.entropy));
        put("learner/kl", Some(self.learner.kl));
        put("learner/clip_fraction", Some(self.learner.clip_fraction));
        put("learner/max_ratio", Some(self.learner.max_ratio));
        put("learner/gradient_norm", Some(self.learner.gradient_norm));
        put("learner/max_gradient_norm", Some(self.learner.max_gradient_norm));
        put("learner/learning_rate", Some(self.learner.learning_rate));
        put("learner/action_std", Some(self.action_std));
        put("learner/explained_variance", Some(self.explained_variance));
        put("time/rollout_s", Some(self.time.rollout_s));
        put("time/update_s", Some(self.time.update_s));
        put("time/samples_per_s", Some(self.time.samples_per_s));
        scalars
    }
}
