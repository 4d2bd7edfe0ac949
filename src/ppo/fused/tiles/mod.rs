/*! The arithmetic `mixed` on the tile units of x86-64 (AMX): the operands of all products are bf16 numbers, everything else
(sums, activations, losses, Adam) stays f32.

An operand of the forward pass is the sum of two bf16 numbers, so that outputs are as exact as in f32; one of the backward
pass is a single bf16 number, so that gradients are off by some thousandths.

As in [`panels`](super::panels), blocks and panels are in read-write locks, no gradient is summed across threads and all
sums run in a fixed order: bits do not depend on the number of threads.
*/

mod block;
mod pack;
mod panel;
mod unit;

use std::sync::RwLock;

use pulp::NullaryFnOnce;
use pulp::x86::V4;

pub use self::unit::available;

use self::block::{HALVES, ROWS, TileBlock, Workspace};
use self::panel::{TilePanel, unpack};
use self::unit::{Operand, SQUARE, TileUnit, prefetch};
use super::losses::Pass;
use super::optimizer::{Adam, AdamParameters, AdamStep};
use super::team::{Member, read, write};
use super::{Arithmetic, Chunk, LayerPanels};
use crate::network::kernels::{AlignedBuffer, SumOfSquares};
use crate::network::{ActorCritic, Mlp};
use crate::ppo::loss::Minibatch;

/// Both networks, with weights as operands of the tile unit.
#[derive(Debug)]
pub struct Tiles {
    simd: V4,
    /// Panels of both networks, layer by layer.
    panels: Vec<RwLock<TilePanel>>,
    /// Blocks of the policy and of the value function.
    blocks: [Vec<RwLock<TileBlock>>; 2],
    /// Number of layers of the policy.
    depth: usize,
    /// Number of columns of the widest layer, in units of 32.
    widest: usize,
}

impl Arithmetic for Tiles {
    const BLOCK: usize = ROWS;
    const LEAST_BLOCK: usize = ROWS;
    const CHUNK: usize = 256;
    const KL_ROUNDING: f64 = 1e-6;
    type Workspace = Workspace;

    fn new(parts: [&ActorCritic; 3], blocks: usize) -> Self {
        let simd = V4::try_new().expect("chosen where there are tiles");
        let mut panels = Vec::new();
        for (network, mlps) in [parts.map(|part| &part.policy), parts.map(|part| &part.value)].into_iter().enumerate() {
            for (depth, layer) in mlps[0].layers.iter().enumerate() {
                let layers = mlps.map(|mlp| &mlp.layers[depth]);
                let panel = |index| RwLock::new(TilePanel::new(network, depth, index, layers, simd));
                panels.extend((0..layer.outputs().div_ceil(32)).map(panel));
            }
        }
        let mlps = [&parts[0].policy, &parts[0].value];
        let blocks = mlps.map(|mlp| (0..blocks).map(|_| RwLock::new(TileBlock::new(mlp))).collect());
        let widths = |mlp: &Mlp| mlp.layers.iter().map(|layer| layer.inputs().max(layer.outputs())).max();
        let widest = mlps.into_iter().filter_map(widths).max().unwrap_or(0).div_ceil(32);
        Self { simd, panels, blocks, depth: parts[0].policy.layers.len(), widest }
    }

    fn workspace(&self) -> Self::Workspace {
        Workspace::new(TileUnit::new().expect("chosen where there are tiles"), self.widest)
    }

    fn passes(
        &self,
        team: Member<'_>,
        workspace: &mut Self::Workspace,
        minibatch: &Minibatch<'_>,
        chunk: Chunk,
        loss: impl Fn(Pass<'_>),
    ) {
        let panels: Vec<_> = self.panels.iter().map(read).collect();
        let layers: Vec<_> = panels.chunk_by(|a, b| (a.network, a.depth) == (b.network, b.depth)).collect();
        let (policy, value) = layers.split_at(self.depth);
        let networks: [&[LayerPanels<'_, '_, _>]; 2] = [policy, value];
        let samples = minibatch.batch.returns.len();
        let inputs = [minibatch.batch.observations, minibatch.batch.value_inputs()];
        let inputs = inputs.map(|inputs| (inputs, inputs.len() / samples));
        let task = |task: usize| {
            let (network, index) = (task / chunk.blocks, task % chunk.blocks);
            let mut block = write(&self.blocks[network][index]);
            let rows = minibatch.block(ROWS, chunk.start + index);
            block.forward(workspace, networks[network], inputs[network], rows);
            loss(block.pass(network, chunk.start + index));
            if index + 1 < chunk.blocks {
                minibatch.batch.prefetch(minibatch.block(ROWS, chunk.start + index + 1), prefetch);
            }
            block.backward(workspace, networks[network]);
        };
        team.phase(2 * chunk.blocks, task, || ());
    }

    fn gradients(&self, team: Member<'_>, workspace: &mut Self::Workspace, chunk: Chunk, conclude: impl FnOnce(f64)) {
        let task = |task: usize| {
            let panel = &mut *write(&self.panels[task]);
            let blocks: Vec<_> = self.blocks[panel.network][..chunk.blocks].iter().map(read).collect();
            let (depth, index) = (panel.depth, panel.index);
            let operands: Vec<_> =
                blocks.iter().map(|block| (&block.deltas[depth][index], &*block.inputs[depth])).collect();
            for piece in chunk.pieces() {
                let (blocks, operands) = (&blocks[piece.blocks.clone()], &operands[piece.blocks]);
                let (weights, biases) = panel.parameters.gradient.split_at_mut(panel.forward.len() * SQUARE);
                let add = !piece.is_first;
                self.simd.vectorize(Gradient { unit: &mut workspace.unit, operands, add, weights });
                if !add {
                    biases.fill(0.0);
                }
                for block in blocks {
                    biases.iter_mut().zip(&block.bias[depth][32 * index..]).for_each(|(sum, bias)| *sum += bias);
                }
                if piece.is_last {
                    panel.tree.add(piece.shard, chunk.shards, &mut panel.parameters.gradient);
                }
            }
            if chunk.completes {
                panel.squares = pulp::Simd::vectorize(self.simd, SumOfSquares(&panel.parameters.gradient));
            }
        };
        team.phase(self.panels.len(), task, || conclude(self.panels.iter().map(|panel| read(panel).squares).sum()));
    }

    fn panels(&self) -> usize {
        self.panels.len()
    }

    fn gradient(&self, panel: usize, with: impl FnOnce(&mut AlignedBuffer)) -> f64 {
        let panel = &mut *write(&self.panels[panel]);
        with(&mut panel.parameters.gradient);
        pulp::Simd::vectorize(self.simd, SumOfSquares(&panel.parameters.gradient))
    }

    fn steps(&self, team: Member<'_>, _: &mut Self::Workspace, step: &AdamStep) {
        let task = |task: usize| {
            let mut panel = write(&self.panels[task]);
            pulp::Simd::vectorize(self.simd, Adam { parameters: &mut panel.parameters, step });
            panel.refresh(self.simd);
        };
        team.phase(self.panels.len(), task, || ());
    }

    fn unpack(&self, part: fn(&AdamParameters) -> &AlignedBuffer, networks: &mut ActorCritic) {
        for panel in self.panels.iter().map(read) {
            let mlp = if panel.network == 0 { &mut networks.policy } else { &mut networks.value };
            unpack(part(&panel.parameters), panel.index, &mut mlp.layers[panel.depth]);
        }
    }
}

/// The gradient by the weights of 32 outputs: deltas times inputs, over all blocks of rows.
struct Gradient<'a> {
    unit: &'a mut TileUnit,
    /// Left operand and, for each 32 inputs, right operand of each block.
    operands: &'a [(&'a [Operand<1>; HALVES], &'a [[Operand<1>; HALVES]])],
    /// True if the result is added to the gradient of the chunks before.
    add: bool,
    weights: &'a mut [f32],
}

impl NullaryFnOnce for Gradient<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let (squares, _) = self.weights.as_chunks_mut::<SQUARE>();
        for (column, square) in squares.iter_mut().enumerate() {
            let steps = (0..HALVES * self.operands.len()).map(|step| {
                let (left, right) = self.operands[step / HALVES];
                (&left[step % HALVES], &right[column][step % HALVES])
            });
            self.unit.product(steps, square, self.add);
        }
    }
}
