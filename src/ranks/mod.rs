/*! The processes that train one run together, and the order in which they sum.

A run is divided into `ppo.shards` equal parts, a power of two: shard `s` of `S` has environments `s·E/S` to `(s + 1)·E/S`,
the samples they make, an order of its own in which those are learnt from, and an equal part of every minibatch. Whatever
is summed over samples is summed within each shard in order, then over shards by a fixed tree,
`((0 + 1) + (2 + 3)) + ((4 + 5) + (6 + 7))`. A rank has the same number of shards as every other, one after the other, so
that its sum is a node of that tree: the result depends on the number of shards, but neither on that of ranks nor on that
of threads.

[`Alone`] is a program by itself.
*/

use std::fmt::Debug;
use std::ops::Range;
use std::sync::Arc;

/// This process among those that train together. Whatever is done together is called by all of them, in the same order.
pub trait Ranks: Debug + Send + Sync {
    /// Which of them it is, counted from zero.
    fn index(&self) -> usize;

    /// How many there are, a power of two.
    fn count(&self) -> usize;

    /// Replaces numbers by their sums over all ranks, over a fixed tree.
    fn sum(&self, singles: &mut [f32], doubles: &mut [f64]);

    /// What every rank has to say, rank by rank.
    fn gather(&self, own: Vec<u8>) -> Vec<Vec<u8>>;

    /// The part of `whole` that is this rank's, `whole` being a multiple of their number.
    fn share(&self, whole: usize) -> Range<usize> {
        let each = whole / self.count();
        self.index() * each..(self.index() + 1) * each
    }
}

/// A program by itself.
#[derive(Debug, Clone, Copy, Default)]
pub struct Alone;

impl Alone {
    /// As it is passed around.
    pub fn shared() -> Arc<dyn Ranks> {
        Arc::new(Alone)
    }
}

impl Ranks for Alone {
    fn index(&self) -> usize {
        0
    }

    fn count(&self) -> usize {
        1
    }

    fn sum(&self, _: &mut [f32], _: &mut [f64]) {}

    fn gather(&self, own: Vec<u8>) -> Vec<Vec<u8>> {
        vec![own]
    }
}

/// The sum of `part` over `shards`, a power of two of them, over their tree.
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

/// The sum of `of` over the samples of all ranks, of which `samples` in `shards` shards are here.
pub fn sum_over_samples(ranks: &dyn Ranks, shards: usize, samples: usize, of: impl Fn(usize) -> f64) -> f64 {
    let size = samples / shards;
    let mut sum = [tree_sum(shards, |shard| (shard * size..(shard + 1) * size).map(&of).sum())];
    ranks.sum(&mut [], &mut sum);
    sum[0]
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
