//! The part of the cascade that comes before a [grid] or the level, in the same dispatch.
//!
//! On a GPU a small grid takes as long as its latency and its barrier. So each workgroup of a grid or level computes
//! all that its tile starts from: the smallest grids in shared memory, and a tile of each grid in between.
//! `glsl/include/cascade.glsl`.

use std::borrow::Cow;

use super::grid::{self, Grid, halved, prolonged};
use super::{Number, WORKGROUP, pixels};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

pub use shaders::coarser::Coarser;

const _: () = assert!(WORKGROUP[0] * WORKGROUP[1] == shaders::cascade::TOTAL);

/// The most relaxation sweeps with which a tile of each grid in between is enough.
const MOST_SWEEPS: u32 = 4;

/// Relaxation sweeps on the coarsest grid, of 8 to 15 cells along its short side.
pub(crate) const COARSEST_SWEEPS: u32 = 30;

/// What a pass on a target, a grid or the level, starts from.
#[derive(Clone, Copy)]
pub(crate) enum Start<'a> {
    /// dV is 0.
    Zero,
    /// The stored dV of the next coarser grid, at its first cell.
    Coarser(u32),
    /// The stored dV of the target, at its first cell, which an earlier dispatch has relaxed.
    Own(u32),
    /// All coarser grids, which the dispatch computes, from the `small`-th on in shared memory.
    Joined { grids: &'a [grid::Place], small: usize },
}

impl Start<'_> {
    /// The push constants.
    pub(crate) fn constants(self) -> Coarser {
        let stored = |next| Coarser { next, grids: 0, small_grids: 0, coarsest_sweeps: COARSEST_SWEEPS };
        match self {
            Self::Zero => stored(u32::MAX),
            Self::Coarser(first) | Self::Own(first) => stored(first),
            Self::Joined { grids, small } => {
                let small_grids = (grids.len() - small) as u32;
                Coarser { grids: small as u32, small_grids, ..stored(grids[small].first) }
            }
        }
    }

    /// The variant of the pass on the target.
    pub(crate) fn variant(self) -> Variant {
        Variant::JOINED.when(matches!(self, Self::Joined { .. }))
            | Variant::CONTINUES.when(matches!(self, Self::Own(_)))
    }
}

/// Whether a variant starts from the dV of its target.
pub(crate) fn continues(variant: Variant) -> bool {
    variant.has(Variant::CONTINUES)
}

impl Coarser {
    /// dV of the next coarser grid than a target of a size, unless it starts from its own dV. `equations` and `steps`
    /// are those of all grids. If joined, `steps` is not read.
    pub(crate) fn cpu_reference<'a, N: Number>(
        &self,
        target: [u32; 2],
        (sweeps, over_relaxation): (u32, f32),
        equations: &[N],
        steps: &'a [N],
    ) -> Cow<'a, [N]> {
        if self.next == u32::MAX {
            let [width, height] = halved(target);
            return vec![N::default(); (width * height) as usize].into();
        }
        if self.small_grids == 0 {
            return steps[self.next as usize..].into();
        }
        let (size, mut first) = (size_of(target, self.grids + 1), self.next);
        let finest = Grid::of(equations, first as usize, size);
        let mut dv = coarsest_grids(&finest, self.small_grids, [sweeps, self.coarsest_sweeps], over_relaxation);
        for size in (1..=self.grids).rev().map(|n| size_of(target, n)) {
            first -= size[0] * size[1];
            dv = prolonged(&dv, size.map(|side| side as usize));
            Grid::of(equations, first as usize, size).relax_all(&mut dv, sweeps, over_relaxation);
        }
        dv.into()
    }
}

/// dV of the finest of some grids: the system is summed up to the coarsest, and relaxed on the way back, with one number
/// of sweeps on each grid and another on the coarsest.
fn coarsest_grids<N: Number>(
    grid: &Grid<N>,
    grids: u32,
    [sweeps, on_coarsest]: [u32; 2],
    over_relaxation: f32,
) -> Vec<N> {
    let size = [grid.width, grid.height];
    let (mut dv, sweeps) = if grids > 1 {
        let coarse = coarsest_grids(&grid.halved(), grids - 1, [sweeps, on_coarsest], over_relaxation);
        (prolonged(&coarse, size), sweeps)
    } else {
        (vec![N::default(); size[0] * size[1]], on_coarsest)
    };
    grid.relax_all(&mut dv, sweeps, over_relaxation);
    dv
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
    use super::super::Field;
    use super::super::grid::tests::of_parts;
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

    /// -Δu + u/1e4 = f with a known u: a broad mode, which answers from afar, is there after one cascade.
    #[test]
    fn a_cascade_solves_broad_modes() {
        let n = 64;
        let mode = |i: usize| (std::f64::consts::PI * (i as f64 + 0.5) / n as f64).cos();
        let truth = Field::from_fn(n, n, |x, y| mode(x) + mode(y));
        let d = 1e-4;
        let frequency = 2.0 - 2.0 * (std::f64::consts::PI / n as f64).cos();
        let link = |last: usize| Field::from_fn(n, n, move |x, y| if [x, y][last] + 1 < n { 1.0 } else { 0.0 });
        let r = Field { data: truth.data.iter().map(|u| (d + frequency) * u).collect(), ..truth.clone() };
        let grid = of_parts([&Field::from_fn(n, n, |_, _| d), &r, &link(0), &link(1)]);
        let dv = coarsest_grids(&grid, 4, [3, COARSEST_SWEEPS], 1.3);
        let error = dv.iter().zip(&truth.data).map(|(a, e)| (a - e).powi(2)).sum::<f64>() / (n * n) as f64;
        // The truth is 1 rms.
        assert!(error.sqrt() < 0.1, "{}", error.sqrt());
    }
}
