//! Reports about a failed update.

use super::collection::Rollout;
use super::environment::{EpisodeEnd, EpisodeReport};
use super::metrics::explained_variance;
use crate::ppo::{Batch, UpdateFault};
use crate::ranks::{Alone, Ranks};
use crate::robot::JOINTS;

/// Formats this rank's samples of the failed minibatch as CSV.
pub(super) fn minibatch_csv(fault: &UpdateFault, rollout: &Rollout, batch: &Batch<'_>, ranks: &dyn Ranks) -> String {
    let UpdateFault::NotFinite { samples, .. } = fault else { return String::new() };
    let length = batch.observations.len() / batch.returns.len().max(1);
    let columns = |name: &str, count: usize| (0..count).map(|k| format!(",{name}_{k}")).collect::<String>();
    let (actions, seen) = (columns("action", JOINTS), columns("observation", length));
    let header = format!("sample,reward,value,advantage,return,log_prob{actions}{seen}\n");
    let mut csv = if ranks.index() == 0 { header } else { String::new() };
    for row in samples.iter().map(|sample| *sample as usize) {
        // A mirror image has the reward and the value of its sample.
        let (reward, value) = (rollout.rewards[row % rollout.len()], rollout.values[row % rollout.len()]);
        let numbers = [reward, value, batch.advantages[row], batch.returns[row], batch.log_probs[row]];
        let action = &batch.actions[row * JOINTS..(row + 1) * JOINTS];
        let observation = &batch.observations[row * length..(row + 1) * length];
        let numbers: String =
            numbers.iter().chain(action).chain(observation).map(|number| format!(",{number}")).collect();
        let (image, sample) = (row / rollout.len(), row % rollout.len());
        let row = (image * ranks.count() + ranks.index()) * rollout.len() + sample;
        csv.push_str(&format!("{row}{numbers}\n"));
    }
    csv
}

/// Describes the update and the rollout of this rank as JSON; numbers that are not finite are `null`.
pub(super) fn circumstances(
    fault: &UpdateFault,
    rollout: &Rollout,
    episodes: &[EpisodeReport],
    returns: &[f32],
    log_std: &[f32],
    shards: usize,
) -> serde_json::Value {
    let range = |values: &[f32]| {
        let low = values.iter().copied().fold(f32::INFINITY, f32::min);
        let high = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let not_finite = values.iter().filter(|value| !value.is_finite()).count();
        serde_json::json!({ "low": low, "high": high, "not_finite": not_finite })
    };
    let count = |end: EpisodeEnd| episodes.iter().filter(|episode| episode.end == end).count();
    let statistics = match fault {
        UpdateFault::NotFinite { summary, .. } => Some(summary),
        UpdateFault::Misfit(_) | UpdateFault::Candle(_) => None,
    };
    serde_json::json!({
        "message": fault.to_string(),
        "minibatch": statistics,
        "rollout": {
            "observations": range(&rollout.observations),
            "actions": range(&rollout.actions),
            "log_probs": range(&rollout.log_probs),
            "rewards": range(&rollout.rewards),
            "values": range(&rollout.values),
            "returns": range(returns),
            "falls": count(EpisodeEnd::Fall),
            "faults": count(EpisodeEnd::Fault),
            "explained_variance": explained_variance(&Alone, shards, rollout, returns),
        },
        "log_std": log_std,
    })
}
