//! The part of the cascade that comes before a [grid] or the level, in the same dispatch.
//!
//! On a GPU a small grid takes as long as its latency and its barrier. So each workgroup of a grid or level computes all
//! that its tile starts from: the smallest grids in shared memory, as [`coarsest_grids`] does in a buffer, and a tile of
//! each grid in between. `glsl/include/cascade.glsl`.

use bytemuck::{Pod, Zeroable};

use super::coarsest_grids::{self, COARSEST_SWEEPS};
use super::grid::{self, FLOATS, Grid, halved, prolonged};
use super::{Number, WORKGROUP, pixels};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

const _: () = assert!(WORKGROUP[0] * WORKGROUP[1] == shaders::cascade::TOTAL);

/// The most relaxation sweeps: with more, the interior of a grid's tile does not cover the next finer grid's tile.
const MOST_SWEEPS: u32 = 4;

/// What a pass on a target, a grid or the level, starts from.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Coarser {
    /// First cell of the grid whose dV is stored. If joined: of the finest grid in shared memory.
    pub next: u32,
    /// If joined: grids between that one and the target.
    pub grids: u32,
    /// Grids in shared memory; 0 unless joined.
    pub small_grids: u32,
    /// Relaxation sweeps on the coarsest grid.
    pub coarsest_sweeps: u32,
}

impl Coarser {
    /// The stored dV of the next coarser grid.
    pub(crate) fn stored(next: u32) -> Self {
        Self { next, grids: 0, small_grids: 0, coarsest_sweeps: COARSEST_SWEEPS }
    }

    /// All coarser grids, from the `small`-th on in shared memory.
    pub(crate) fn joined(grids: &[grid::Place], small: usize) -> Self {
        let small_grids = (grids.len() - small) as u32;
        Self { grids: small as u32, small_grids, ..Self::stored(grids[small].first) }
    }

    /// The variant of the pass on the target.
    pub(crate) fn variant(&self) -> Variant {
        [self.small_grids > 0, false, false, false]
    }

    /// Compulsory traffic: dV of the next coarser grid, a quarter of a number per pixel of the target's tiles with their
    /// halos; if joined, the equations of the coarser grids.
    pub(crate) fn bytes(&self, [width, height]: [u32; 2], pixels_with_halos: u64) -> u64 {
        if self.small_grids == 0 {
            return pixels_with_halos;
        }
        let cells = (1..=self.grids + 1).map(|n| pixels(width.div_ceil(1 << n), height.div_ceil(1 << n)));
        4 * FLOATS as u64 * cells.sum::<u64>()
    }

    /// dV of the next coarser grid than a target of a size. `equations` and `steps` are those of all grids; joined, steps
    /// are not read.
    pub(crate) fn cpu_reference<N: Number>(
        &self,
        target: [u32; 2],
        (sweeps, over_relaxation): (u32, f32),
        equations: &[N],
        steps: &[N],
    ) -> Vec<N> {
        if self.small_grids == 0 {
            return steps[self.next as usize..].to_vec();
        }
        let size_of = |n| (0..n).fold(target, |size, _| halved(size));
        let ([width, height], mut first) = (size_of(self.grids + 1), self.next);
        let &Self { small_grids: grids, coarsest_sweeps, .. } = self;
        let c = coarsest_grids::Constants { width, height, first, grids, sweeps, coarsest_sweeps, over_relaxation };
        let mut dv = coarsest_grids::cpu_reference(&c, &Grid::of(equations, first as usize, [width, height]));
        for size in (1..=self.grids).rev().map(size_of) {
            first -= size[0] * size[1];
            dv = prolonged(&dv, size.map(|side| side as usize));
            relax(&Grid::of(equations, first as usize, size), &mut dv, sweeps, over_relaxation);
        }
        dv
    }
}

/// All relaxation sweeps on a grid.
pub(crate) fn relax<N: Number>(grid: &Grid<N>, dv: &mut [N], sweeps: u32, over_relaxation: f32) {
    for color in (0..2 * sweeps).map(|half| half % 2) {
        grid.relax(dv, color as usize, over_relaxation.into());
    }
}

/// Whether a workgroup takes all coarser grids with a tile, from one of this size on in shared memory.
pub(crate) fn joins(sweeps: u32, finest_small: [u32; 2]) -> bool {
    sweeps <= MOST_SWEEPS && fits(finest_small)
}

/// Whether a grid and all coarser ones fit the shared memory and the invocations of a workgroup.
pub(crate) fn fits([width, height]: [u32; 2]) -> bool {
    let of_color = pixels(width.div_ceil(2), height);
    of_color <= u64::from(shaders::cascade::TOTAL * shaders::cascade::PER_COLOR)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_grids_fit() {
        for width in 1..=1100 {
            for height in (1..=1100 / width + 1).filter(|&height| fits([width, height])) {
                let (mut size, mut all) = ([width, height], pixels(width, height));
                assert!(all <= u64::from(shaders::cascade::CELLS));
                while size[0].min(size[1]) >= 16 {
                    size = halved(size);
                    all += pixels(size[0], size[1]);
                    // Two cells of the next grid for each invocation.
                    assert!(pixels(size[0], size[1]) <= 512);
                }
                assert!(all <= u64::from(shaders::cascade::ALL_CELLS), "{width} x {height}");
            }
        }
    }
}
