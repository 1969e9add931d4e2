//! Averages the evidence for an outline along the edge, so that an edge is moved as a whole or stays. Section 7 of
//! `docs/method.md`.

use super::edge::{self, DECISIONS, EDGES, Edge};
use super::pass::{Memory, Pass};
use super::{Number, Raster};
use crate::engine::vulkan::Variant;

pub use super::interface::edge_agree::*;
use crate::engine::shaders::edge_agree as shader;

/// Numbers of the evidence for an outline, of a cell.
pub(crate) const NUMBERS: usize = shader::EVIDENCE as usize;
/// How often they are averaged. From one pass to the next they alternate between two places.
pub(crate) const PASSES: u32 = 3;

/// The first number of the decisions after n passes.
pub(crate) fn place(n: u32) -> u32 {
    shader::EVIDENCE * (n % 2)
}

impl Pass for Bindings {
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        edge::traffic([c.width, c.height])
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let decisions = cpu_reference(c, memory.layer(self.results, EDGES), memory.layer(self.results, DECISIONS));
        memory.set_layer(self.results, DECISIONS, decisions);
    }
}

/// The layer of the decisions after a pass.
pub(crate) fn cpu_reference<N: Number>(c: &Constants, edges: &Raster<N>, decisions: &Raster<N>) -> Raster<N> {
    let (mut averaged, size) = (decisions.clone(), [c.width, c.height]);
    for cell in edge::all_cells(size) {
        let Some(edge) = Edge::of(edges, cell) else { continue };
        let (mut sums, mut sum) = ([0.0; NUMBERS], 0.0);
        for other in edge::cells_around(cell, shader::AROUND as usize, size) {
            let weight = Edge::of(edges, other).map_or(0.0, |neighbour| edge.agreement(&neighbour));
            sum += weight;
            for (n, total) in sums.iter_mut().enumerate() {
                *total += weight * edge::number(decisions, other, c.from as usize + n);
            }
        }
        edge::set(&mut averaged, cell, c.to as usize, &sums.map(|total| total / sum));
    }
    averaged
}
