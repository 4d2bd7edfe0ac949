/*! The f32 arithmetic, for every machine: weights in slices of panels of 32 outputs, in portable SIMD.

Blocks and slices are in read-write locks: a phase writes one kind and reads the other. No gradient is ever summed
across threads, and sums of partial results run in a fixed order, so the parameters have the same bits for any number of
threads, and for any instruction set.
*/

mod block;
mod slice;

use std::sync::RwLock;

use pulp::Arch;

use self::block::PanelBlock;
use self::slice::Slice;
use super::losses::Pass;
use super::optimizer::{Adam, AdamParameters, AdamStep};
use super::team::{Member, read, write};
use super::{Arithmetic, Chunk, LayerPanels};
use crate::network::kernels::{AlignedBuffer, ColumnSums, Ends, PANEL, Product, Stretch, SumOfSquares};
use crate::network::panel::{panel_outputs, unpack};
use crate::network::{ActorCritic, BLOCK};
use crate::ppo::loss::Minibatch;

/// Both networks in single precision.
#[derive(Debug)]
pub struct Panels {
    pub(in crate::ppo) arch: Arch,
    /// Slices of both networks, layer by layer.
    slices: Vec<RwLock<Slice>>,
    /// Blocks of the policy and of the value function.
    blocks: [Vec<RwLock<PanelBlock>>; 2],
    /// Number of layers of the policy.
    depth: usize,
}

impl Arithmetic for Panels {
    const BLOCK: usize = BLOCK;
    /// 64 threads all have a block of a minibatch of 512 samples.
    const LEAST_BLOCK: usize = 16;
    const CHUNK: usize = 128;
    /// Zero: the policy of the rollout has the same bits.
    const KL_ROUNDING: f64 = 0.0;
    type Workspace = ();

    fn new(parts: [&ActorCritic; 3], blocks: usize) -> Self {
        let mut slices = Vec::new();
        for (network, mlps) in [parts.map(|part| &part.policy), parts.map(|part| &part.value)].into_iter().enumerate() {
            for depth in 0..mlps[0].layers.len() {
                let layers = mlps.map(|mlp| &mlp.layers[depth]);
                slices.extend(Slice::all(network, depth, layers).into_iter().map(RwLock::new));
            }
        }
        let blocks = [&parts[0].policy, &parts[0].value]
            .map(|mlp| (0..blocks).map(|_| RwLock::new(PanelBlock::new(mlp))).collect());
        Self { arch: Arch::new(), slices, blocks, depth: parts[0].policy.layers.len() }
    }

    fn workspace(&self) {}

    fn passes(&self, team: Member<'_>, (): &mut (), minibatch: &Minibatch<'_>, chunk: Chunk, loss: impl Fn(Pass<'_>)) {
        let slices: Vec<_> = self.slices.iter().map(read).collect();
        let layers: Vec<_> = slices.chunk_by(|a, b| (a.network, a.depth) == (b.network, b.depth)).collect();
        let (policy, value) = layers.split_at(self.depth);
        let networks: [&[LayerPanels<'_, '_, _>]; 2] = [policy, value];
        let inputs = [minibatch.batch.observations, minibatch.batch.value_inputs()];
        let task = |task: usize| {
            let (network, index) = (task / chunk.blocks, task % chunk.blocks);
            let mut block = write(&self.blocks[network][index]);
            let rows = minibatch.block(chunk.rows, chunk.start + index);
            block.forward(self.arch, networks[network], inputs[network], rows);
            loss(block.pass(network, chunk.start + index));
            block.backward(self.arch, networks[network]);
        };
        team.phase(2 * chunk.blocks, task, || ());
    }

    fn gradients(&self, team: Member<'_>, (): &mut (), chunk: Chunk, conclude: impl FnOnce(f64)) {
        let task = |task: usize| {
            let slice = &mut *write(&self.slices[task]);
            let blocks: Vec<_> = self.blocks[slice.network][..chunk.blocks].iter().map(read).collect();
            let (depth, index) = (slice.depth, slice.first / PANEL);
            let has_bias = slice.has_bias();
            let mut stretches = Vec::new();
            for piece in chunk.pieces() {
                let gradient = &mut slice.parameters.gradient;
                if piece.is_first {
                    gradient.fill(0.0);
                }
                let weights = gradient.rows().len() - usize::from(has_bias);
                let (weights, bias) = gradient.rows_mut().split_at_mut(weights);
                for (input, c) in (slice.from / PANEL..).zip(weights.chunks_mut(PANEL)) {
                    stretches.clear();
                    stretches.extend(blocks[piece.blocks.clone()].iter().map(|block| Stretch {
                        a: &block.activations[depth].panel(input)[..block.rows],
                        b: &block.deltas[depth].panel(index)[..block.rows],
                    }));
                    let (rows, columns) = (c.len(), panel_outputs(slice.layer_outputs, slice.first));
                    let (stretches, ends) = (&stretches[..], Ends::Add);
                    Product { rows, columns, stretches, a_transposed: true, ends, c }.compute(self.arch);
                }
                // The deltas, which are the same for all inputs.
                for sums in bias {
                    self.arch.dispatch(ColumnSums { stretches: &stretches, sums });
                }
                if piece.is_last {
                    slice.tree.add(piece.shard, chunk.shards, &mut slice.parameters.gradient);
                }
            }
            if chunk.completes {
                slice.squares = self.arch.dispatch(SumOfSquares(&slice.parameters.gradient));
            }
        };
        team.phase(self.slices.len(), task, || conclude(self.slices.iter().map(|slice| read(slice).squares).sum()));
    }

    fn panels(&self) -> usize {
        self.slices.len()
    }

    fn gradient(&self, panel: usize, with: impl FnOnce(&mut AlignedBuffer)) -> f64 {
        let slice = &mut *write(&self.slices[panel]);
        with(&mut slice.parameters.gradient);
        self.arch.dispatch(SumOfSquares(&slice.parameters.gradient))
    }

    fn steps(&self, team: Member<'_>, (): &mut (), step: &AdamStep) {
        let task = |task: usize| {
            let mut slice = write(&self.slices[task]);
            self.arch.dispatch(Adam { parameters: &mut slice.parameters, step });
            slice.transpose();
        };
        team.phase(self.slices.len(), task, || ());
    }

    fn unpack(&self, part: fn(&AdamParameters) -> &AlignedBuffer, networks: &mut ActorCritic) {
        for slice in self.slices.iter().map(read) {
            let mlp = if slice.network == 0 { &mut networks.policy } else { &mut networks.value };
            unpack(part(&slice.parameters).rows(), slice.first, slice.from, &mut mlp.layers[slice.depth]);
        }
    }
}
