/*! The f32 arithmetic, for every machine: weights in panels of 32 outputs, in portable SIMD.

Blocks and panels are in read-write locks: a phase writes one kind and reads the other. No gradient is ever summed
across threads, and sums of partial results run in a fixed order, so the parameters have the same bits for any number of
threads, and for any instruction set.
*/

mod block;
mod panel;

use std::sync::RwLock;

use pulp::Arch;

use self::block::PanelBlock;
use self::panel::Panel;
use super::losses::Pass;
use super::optimizer::{Adam, AdamParameters, AdamStep};
use super::team::{Member, read, write};
use super::{Arithmetic, Chunk, LayerPanels};
use crate::network::kernels::{AlignedBuffer, ColumnSums, Ends, PANEL, Product, Stretch, SumOfSquares};
use crate::network::panel::{panel_outputs, panel_starts, unpack};
use crate::network::{ActorCritic, BLOCK};
use crate::ppo::loss::Minibatch;

/// Both networks in single precision.
#[derive(Debug)]
pub struct Panels {
    pub(in crate::ppo) arch: Arch,
    /// Panels of both networks, layer by layer.
    panels: Vec<RwLock<Panel>>,
    /// Blocks of the policy and of the value function.
    blocks: [Vec<RwLock<PanelBlock>>; 2],
    /// Number of layers of the policy.
    depth: usize,
}

impl Arithmetic for Panels {
    const BLOCK: usize = BLOCK;
    const CHUNK: usize = 128;
    /// Zero: the policy of the rollout has the same bits.
    const KL_ROUNDING: f64 = 0.0;
    type Workspace = ();

    fn new(parts: [&ActorCritic; 3], blocks: usize) -> Self {
        let mut panels = Vec::new();
        for (network, mlps) in [parts.map(|part| &part.policy), parts.map(|part| &part.value)].into_iter().enumerate() {
            for (depth, layer) in mlps[0].layers.iter().enumerate() {
                let layers = mlps.map(|mlp| &mlp.layers[depth]);
                let panel = |first| RwLock::new(Panel::new(network, depth, first, layers));
                panels.extend(panel_starts(layer.outputs()).map(panel));
            }
        }
        let blocks = [&parts[0].policy, &parts[0].value]
            .map(|mlp| (0..blocks).map(|_| RwLock::new(PanelBlock::new(mlp))).collect());
        Self { arch: Arch::new(), panels, blocks, depth: parts[0].policy.layers.len() }
    }

    fn workspace(&self) {}

    fn passes(&self, team: Member<'_>, (): &mut (), minibatch: &Minibatch<'_>, chunk: Chunk, loss: impl Fn(Pass<'_>)) {
        let panels: Vec<_> = self.panels.iter().map(read).collect();
        let layers: Vec<_> = panels.chunk_by(|a, b| (a.network, a.depth) == (b.network, b.depth)).collect();
        let (policy, value) = layers.split_at(self.depth);
        let networks: [&[LayerPanels<'_, '_, _>]; 2] = [policy, value];
        let inputs = [minibatch.batch.observations, minibatch.batch.value_inputs()];
        let task = |task: usize| {
            let (network, index) = (task / chunk.blocks, task % chunk.blocks);
            let mut block = write(&self.blocks[network][index]);
            let rows = minibatch.block(BLOCK, chunk.start + index);
            block.forward(self.arch, networks[network], inputs[network], rows);
            loss(block.pass(network, chunk.start + index));
            block.backward(self.arch, networks[network]);
        };
        team.phase(2 * chunk.blocks, task, || ());
    }

    fn gradients(&self, team: Member<'_>, (): &mut (), chunk: Chunk, conclude: impl FnOnce(f64)) {
        let task = |task: usize| {
            let panel = &mut *write(&self.panels[task]);
            let blocks: Vec<_> = self.blocks[panel.network][..chunk.blocks].iter().map(read).collect();
            let (depth, index) = (panel.depth, panel.first / PANEL);
            let mut stretches = Vec::new();
            for piece in chunk.pieces() {
                if piece.is_first {
                    panel.parameters.gradient.fill(0.0);
                }
                let (bias, weights) =
                    panel.parameters.gradient.rows_mut().split_last_mut().expect("a row for the bias");
                for (input, c) in weights.chunks_mut(PANEL).enumerate() {
                    stretches.clear();
                    stretches.extend(blocks[piece.blocks.clone()].iter().map(|block| Stretch {
                        a: &block.activations[depth].panel(input)[..block.rows],
                        b: &block.deltas[depth].panel(index)[..block.rows],
                    }));
                    let (rows, columns) = (c.len(), panel_outputs(panel.layer_outputs, panel.first));
                    let (stretches, ends) = (&stretches[..], Ends::Add);
                    Product { rows, columns, stretches, a_transposed: true, ends, c }.compute(self.arch);
                }
                // The deltas, which are the same for all inputs.
                self.arch.dispatch(ColumnSums { stretches: &stretches, sums: bias });
                if piece.is_last {
                    panel.tree.add(piece.shard, chunk.shards, &mut panel.parameters.gradient);
                }
            }
            if chunk.completes {
                panel.squares = self.arch.dispatch(SumOfSquares(&panel.parameters.gradient));
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
        self.arch.dispatch(SumOfSquares(&panel.parameters.gradient))
    }

    fn steps(&self, team: Member<'_>, (): &mut (), step: &AdamStep) {
        let task = |task: usize| {
            let mut panel = write(&self.panels[task]);
            self.arch.dispatch(Adam { parameters: &mut panel.parameters, step });
            panel.transpose();
        };
        team.phase(self.panels.len(), task, || ());
    }

    fn unpack(&self, part: fn(&AdamParameters) -> &AlignedBuffer, networks: &mut ActorCritic) {
        for panel in self.panels.iter().map(read) {
            let mlp = if panel.network == 0 { &mut networks.policy } else { &mut networks.value };
            unpack(part(&panel.parameters), panel.first, &mut mlp.layers[panel.depth]);
        }
    }
}
