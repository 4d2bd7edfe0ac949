//! Sums the gradients of shards in the order of a binary tree, as they arrive one after the other.

use std::mem::swap;

use pulp::{Arch, Simd, WithSimd};

use crate::network::kernels::AlignedBuffer;

/// Partial sums that wait for their other half: at level `k` the sum of 2ᵏ shards.
#[derive(Debug, Default)]
pub struct Tree {
    waiting: Vec<AlignedBuffer>,
}

impl Tree {
    /// Adds the gradient of `shard` of `shards`, a power of two. With the last shard, `gradient` becomes the sum of
    /// all; before, its content has no meaning.
    pub fn add(&mut self, shard: usize, shards: usize, gradient: &mut AlignedBuffer) {
        // As in a binary counter that goes from `shard` to the next number: ones become zeros until a zero becomes one.
        let merged = (shard + 1).trailing_zeros() as usize;
        for half in &self.waiting[..merged] {
            Arch::new().dispatch(Add { to: gradient, values: half });
        }
        if shard + 1 < shards {
            if self.waiting.len() == merged {
                self.waiting.push(AlignedBuffer::zeros(gradient.len()));
            }
            swap(gradient, &mut self.waiting[merged]);
        }
    }
}

/// The operation `to += values`.
struct Add<'a> {
    to: &'a mut [f32],
    values: &'a [f32],
}

impl WithSimd for Add<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.to.iter_mut().zip(self.values).for_each(|(to, value)| *to += value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eight_shards_are_summed_as_a_tree() {
        let shards = [1e8, 3.0, 3.0, 3.0, -1e8, 3.0, 5.0, 5.0_f32];
        let mut tree = Tree::default();
        // Twice: partial sums of the first time must not affect the second.
        for _ in 0..2 {
            let mut gradient = AlignedBuffer::zeros(1);
            for (index, &shard) in shards.iter().enumerate() {
                gradient[0] = shard;
                tree.add(index, 8, &mut gradient);
            }
            // Next to 10⁸, f32 are 8 apart: 10⁸ + 3 = 10⁸, 3 + 3 = 6, together 10⁸ + 8; −10⁸ + 3 = −10⁸, 5 + 5 = 10, together
            // −10⁸ + 8; and both of them 16. In order it would be 13.
            assert_eq!(gradient[0], 16.0);
        }
        assert_eq!(shards.iter().sum::<f32>(), 13.0);
    }
}
