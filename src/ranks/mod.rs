/*! Ranks: the processes that train one run together, and the order in which they sum.

Start with the trait [`Ranks`] and [`Alone`], the single process; with the feature `mpi`, `Mpi` is a process started by
`mpirun`.

A run is divided into `ppo.shards` equal parts, a power of two: shard `s` of `S` has environments `s·E/S` to
`(s + 1)·E/S`, their samples, its own order of the samples, and an equal part of every minibatch. A sum over samples runs
within each shard in order, then over the shards by a fixed tree, `((0 + 1) + (2 + 3)) + ((4 + 5) + (6 + 7))`. Every
rank has the same number of consecutive shards, so that its sum is a node of that tree: the result depends on the number
of shards, but neither on that of ranks nor on that of threads.
*/

#[cfg(feature = "mpi")]
mod mpi;

#[cfg(feature = "mpi")]
pub use self::mpi::{Mpi, MpiError};

use std::fmt::{Debug, Display};
use std::ops::Range;
use std::sync::Arc;

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::util::yaml;

/// This process among those that train together. All of them call collective operations, in the same order.
pub trait Ranks: Debug + Send + Sync {
    /// Returns the index of this rank, counted from zero.
    fn index(&self) -> usize;

    /// Returns the number of ranks; a power of two in training.
    fn count(&self) -> usize;

    /// Returns the number of ranks on this machine, this one included.
    fn here(&self) -> usize {
        1
    }

    /// Returns true if the process was not started as a rank, not even as the only one.
    fn is_alone(&self) -> bool {
        false
    }

    /// Returns the name of a rank below [`count`](Ranks::count) and its machine.
    fn name(&self, rank: usize) -> String;

    /// Replaces numbers by their sums over all ranks, over a fixed tree.
    fn sum(&self, singles: &mut Vec<f32>, doubles: &mut Vec<f64>);

    /// Gathers the bytes of every rank, in rank order.
    fn gather(&self, own: Vec<u8>) -> Vec<Vec<u8>>;

    /// Returns this rank's part of `whole`, which is a multiple of the number of ranks.
    fn share(&self, whole: usize) -> Range<usize> {
        let each = whole / self.count();
        self.index() * each..(self.index() + 1) * each
    }
}

/// The single rank of a program that was not started by `mpirun`.
#[derive(Debug, Clone, Copy, Default)]
pub struct Alone;

impl Alone {
    /// Returns a shared single rank.
    pub fn shared() -> Arc<dyn Ranks> {
        Arc::new(Alone)
    }
}

impl Ranks for Alone {
    fn is_alone(&self) -> bool {
        true
    }

    fn index(&self) -> usize {
        0
    }

    fn count(&self) -> usize {
        1
    }

    fn name(&self, _: usize) -> String {
        "this process".into()
    }

    fn sum(&self, _: &mut Vec<f32>, _: &mut Vec<f64>) {}

    fn gather(&self, own: Vec<u8>) -> Vec<Vec<u8>> {
        vec![own]
    }
}

/// Sums `part` over `shards`, a power of two, in the order of their tree.
pub fn tree_sum(shards: usize, part: impl Fn(usize) -> f64) -> f64 {
    fn node(shards: Range<usize>, part: &impl Fn(usize) -> f64) -> f64 {
        if shards.len() < 2 {
            return part(shards.start);
        }
        let middle = shards.start + shards.len() / 2;
        node(shards.start..middle, part) + node(middle..shards.end, part)
    }
    node(0..shards, &part)
}

/// Sums `of` over the samples of all ranks; this rank has `samples` of them, in `shards` shards.
pub fn sum_over_samples(ranks: &dyn Ranks, shards: usize, samples: usize, of: impl Fn(usize) -> f64) -> f64 {
    let size = samples / shards;
    let mut sum = vec![tree_sum(shards, |shard| (shard * size..(shard + 1) * size).map(&of).sum())];
    ranks.sum(&mut Vec::new(), &mut sum);
    sum[0]
}

/// Returns true if `own` is true on any rank.
pub fn any(ranks: &dyn Ranks, own: bool) -> bool {
    let mut count = vec![f64::from(u8::from(own))];
    ranks.sum(&mut Vec::new(), &mut count);
    count[0] > 0.0
}

/// An error on one of several ranks, reported on all of them.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{name}: {problem}")]
pub struct RankError {
    /// Index and host of the rank.
    pub name: String,
    /// Message of the error.
    pub problem: String,
}

/// Returns every rank's result in rank order, or the error of the first rank that failed.
///
/// # Errors
/// A rank failed: with a single rank its own error, with several a [`RankError`] on all of them.
pub fn agree<T, E>(ranks: &dyn Ranks, own: Result<T, E>) -> Result<Vec<T>, E>
where
    T: Serialize + DeserializeOwned,
    E: Display + From<RankError>,
{
    if ranks.count() == 1 {
        return own.map(|own| vec![own]);
    }
    let told = own.map_err(|error| error.to_string());
    let bytes = serde_json::to_vec(&told).or_else(|error| serde_json::to_vec(&Err::<T, _>(error.to_string())));
    let told = ranks.gather(bytes.unwrap_or_default());
    let read = |(rank, bytes): (usize, &Vec<u8>)| {
        let told = serde_json::from_slice::<Result<T, String>>(bytes).map_err(|error| error.to_string());
        told.flatten().map_err(|problem| RankError { name: ranks.name(rank), problem }.into())
    };
    told.iter().enumerate().map(read).collect()
}

/// Checks that named values are the same on all ranks as on the first.
///
/// # Errors
/// A value differs; the error, the same on all ranks, names a rank and the values.
pub fn check_alike(ranks: &dyn Ranks, facts: Value) -> Result<(), RankError> {
    let all = agree::<_, RankError>(ranks, Ok(facts))?;
    for (rank, own) in all.iter().enumerate() {
        let differences = yaml::differences(own, &all[0]).into_iter();
        let differences: Vec<_> =
            differences.map(|(fact, [own, first])| format!("{fact} is {own}, not {first}")).collect();
        if !differences.is_empty() {
            let problem = format!("not like {}: {}", ranks.name(0), differences.join("; "));
            return Err(RankError { name: ranks.name(rank), problem });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_summed_over_a_tree_and_not_in_order() {
        let parts = [1e16, 1.0, 1.0, 1.0];
        // (10¹⁶ + 1) + (1 + 1): the first sum loses its 1, as 10¹⁶ has neighbours at a distance of 2. In order all are lost.
        assert_eq!(tree_sum(4, |shard| parts[shard]), 1e16 + 2.0);
        assert_eq!(parts.iter().sum::<f64>(), 1e16);
        assert_eq!(sum_over_samples(&Alone, 4, 4, |row| parts[row]), 1e16 + 2.0);
        assert_eq!(sum_over_samples(&Alone, 1, 4, |row| parts[row]), 1e16);
    }
}
