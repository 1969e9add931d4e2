//! The part of the cascade that comes before a [grid] or the level, in the same dispatch.
//!
//! On a GPU a small grid takes as long as its latency and its barrier. So each workgroup of a grid or level computes
//! all that its tile starts from: the smallest grids in shared memory, as [`coarsest_grids`] does in a buffer, and a
//! tile of each grid in between. `glsl/include/cascade.glsl`.

use bytemuck::{Pod, Zeroable};

use super::coarsest_grids::{self, COARSEST_SWEEPS};
use super::grid::{self, Grid, halved, prolonged};
use super::{Number, WORKGROUP, pixels};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

const _: () = assert!(WORKGROUP[0] * WORKGROUP[1] == shaders::cascade::TOTAL);

/// The most relaxation sweeps with which a tile of each grid in between is enough.
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
        [self.small_grids > 0, false, false, false, false]
    }

    /// dV of the next coarser grid than a target of a size. `equations` and `steps` are those of all grids. If joined,
    /// `steps` is not read.
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
        let ([width, height], mut first) = (size_of(target, self.grids + 1), self.next);
        let &Self { small_grids: grids, coarsest_sweeps, .. } = self;
        let c = coarsest_grids::Constants { width, height, first, grids, sweeps, coarsest_sweeps, over_relaxation };
        let mut dv = coarsest_grids::cpu_reference(&c, &Grid::of(equations, first as usize, [width, height]));
        for size in (1..=self.grids).rev().map(|n| size_of(target, n)) {
            first -= size[0] * size[1];
            dv = prolonged(&dv, size.map(|side| side as usize));
            Grid::of(equations, first as usize, size).relax_all(&mut dv, sweeps, over_relaxation);
        }
        dv
    }
}

/// The size of the n-th grid after a target.
pub(crate) fn size_of(target: [u32; 2], n: u32) -> [u32; 2] {
    (0..n).fold(target, |size, _| halved(size))
}

/// Whether the interior of a grid's tile covers the next finer grid's tile, with a halo for this number of relaxation
/// sweeps.
pub(crate) fn covers(sweeps: u32) -> bool {
    sweeps <= MOST_SWEEPS
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
