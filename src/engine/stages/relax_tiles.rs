//! Relaxation sweeps on the linear system for dV and the [update](super::update) of V in one dispatch, on tiles with a
//! halo; if [joined](super::cascade) also those on all grids, before.
//!
//! The half-sweeps of [`relax`](super::relax) take as long as their traffic and their barriers. A tile is read once,
//! with a halo as wide as there are half-sweeps, and is relaxed in shared memory. Workgroups compute the halo again
//! instead of waiting for each other. dV is not stored. With more sweeps than a halo leaves room for, `relax` takes the
//! others before.

use super::cascade::{self, Coarser};
use super::grid::FLOATS;
use super::pass::{Memory, Pass};
use super::relax::{own_of, relaxed, start_of};
use super::{Number, WORKGROUP, pixels, update};
use crate::engine::shaders;
use crate::engine::slot::Bound;
use crate::engine::vulkan::Variant;

pub use super::interface::relax_tiles::*;

/// Width and height of a tile with its halo, pixels.
const SIDE: u32 = shaders::relaxation_tile::SIDE;

/// The layer of the right sides, as [`system_tiles`](super::system_tiles) stores them.
const RIGHT_SIDE: usize = shaders::relax_tiles::RIGHT_SIDE as usize;

/// The most relaxation sweeps of a dispatch: with more, less than a quarter of the tile is in its interior.
pub(crate) const MOST_SWEEPS: u32 = 8;

/// The most tiles of a grid or level that compute the coarser grids. With more tiles, the repeated work costs more than
/// the dispatches it saves, on navi21 by `tools/gpu-model`.
const MOST_TILES: u64 = 64;

const _: () = assert!(WORKGROUP[0] * WORKGROUP[1] * 2 * shaders::relaxation_tile::ROWS == SIDE * SIDE);

impl Constants {
    /// The start and the sweeps, and the update that follows.
    pub(crate) fn new(coarser: Coarser, (sweeps, over_relaxation): (u32, f32), update: &update::Constants) -> Self {
        let &update::Constants { width, height, largest_step, relative_step, limit, share, extrapolation } = update;
        Self {
            width,
            height,
            sweeps,
            halo: sweeps,
            over_relaxation,
            largest_step,
            relative_step,
            limit,
            share,
            extrapolation,
            coarser,
        }
    }

    fn update(&self) -> update::Constants {
        let &Self { width, height, largest_step, relative_step, limit, share, extrapolation, .. } = self;
        update::Constants { width, height, largest_step, relative_step, limit, share, extrapolation }
    }
}

/// The relaxation sweeps of each dispatch but the last, and the dispatches, of sweeps on a grid.
pub(crate) fn dispatches(sweeps: u32) -> [u32; 2] {
    let count = sweeps.div_ceil(MOST_SWEEPS);
    [sweeps.div_ceil(count), count]
}

/// Width and height of a tile without its halo.
fn interior(sweeps: u32) -> u32 {
    SIDE - 4 * sweeps
}

/// Workgroups over a level or a grid.
pub(crate) fn tiles(size: [u32; 2], sweeps: u32) -> [u32; 3] {
    let [x, y] = size.map(|side| side.div_ceil(interior(sweeps)));
    [x, y, 1]
}

/// Whether a grid or level has so few tiles that they all compute the coarser grids.
pub(crate) fn has_few_tiles(size: [u32; 2], sweeps: u32) -> bool {
    let [columns, rows, _] = tiles(size, sweeps);
    pixels(columns, rows) <= MOST_TILES
}

/// The cells of the n-th grid from a target in all tiles of the target, with their halos: those of `corner_of` in
/// `cascade.glsl`. With n = 0: the pixels of the target.
pub(crate) fn pixels_with_halos(target: [u32; 2], n: u32, sweeps: u32) -> u64 {
    let [width, height] = target.map(|side| {
        let tiles = (0..side).step_by(interior(sweeps) as usize).map(|x| {
            let [corner, halo] = [x as i32 - 2 * sweeps as i32, 4 * sweeps as i32 + 2];
            let corner = if n == 0 { corner } else { (corner >> n & !1) - halo };
            (corner + SIDE as i32).min(side.div_ceil(1 << n) as i32) - corner.max(0)
        });
        tiles.sum::<i32>() as u32
    });
    pixels(width, height)
}

/// Compulsory traffic of what the tiles of a grid or level start from: dV of the next coarser grid, a quarter of a
/// number per pixel with the halos. If joined, each tile reads the equations of its tiles of the grids in between, with
/// their halos, and those of the finest grid in shared memory.
pub(crate) fn bytes_before(size: [u32; 2], sweeps: u32, coarser: &Coarser) -> u64 {
    if coarser.small_grids == 0 {
        return pixels_with_halos(size, 0, sweeps);
    }
    let ([columns, rows, _], [width, height]) = (tiles(size, sweeps), cascade::size_of(size, coarser.grids + 1));
    let in_between: u64 = (1..=coarser.grids).map(|n| pixels_with_halos(size, n, sweeps)).sum();
    4 * FLOATS as u64 * (in_between + pixels(columns, rows) * pixels(width, height))
}

impl Pass for Bindings {
    /// Compulsory traffic: for tiles with their halos, right sides, four weights and what they start from; that of
    /// [`update`] without dV.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        let update = update::bytes(&c.update()) - 4 * pixels(c.width, c.height);
        let size = [c.width, c.height];
        12 * pixels_with_halos(size, 0, c.sweeps) + bytes_before(size, c.sweeps, &c.coarser) + update
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let (size, relaxation) = ([c.width, c.height], (c.sweeps, c.over_relaxation));
        let reused = [(); 2].map(|()| memory.take_spare());
        // Never written before, if joined.
        let steps = memory.numbers_in(self.steps.slot());
        let system = [0, 1].map(|color| memory.system((self.smoothed, RIGHT_SIDE + color), self.weights, color));
        let change = if cascade::continues(variant) {
            let dv = &steps[c.coarser.next as usize..];
            relaxed(reused, size, relaxation, &system, [0, 1].map(|color| own_of(dv, c.width, color)))
        } else {
            let coarse = c.coarser.cpu_reference(size, relaxation, memory.numbers(self.equations), steps);
            relaxed(reused, size, relaxation, &system, [0, 1].map(|color| start_of(&coarse, c.width, color)))
        };
        let (mut v, mut kept) = (memory.take_layer(self.relative_blur, 0), memory.take_layer(self.kept, update::KEPT));
        let (d, variance) = (memory.layer(self.smoothed, 0), memory.state(self.state).variance);
        let moving = update::cpu_reference(&c.update(), change.each_ref(), d, variance, &mut kept, &mut v);
        memory.set_layer(self.relative_blur, 0, v);
        memory.set_layer(self.kept, update::KEPT, kept);
        memory.state_mut(self.state).count(moving);
        change.into_iter().for_each(|dv| memory.keep_spare(dv));
    }
}

#[cfg(test)]
mod tests {

    use super::*;

    #[test]
    fn a_grid_of_few_tiles_comes_before_the_small_ones() {
        for height in [1, 2, 4, 8, 16, 32] {
            let small = [1024 / height, height];
            assert!(cascade::fits(small) && has_few_tiles(small.map(|side| 2 * side), 4), "{small:?}");
        }
    }

    #[test]
    fn halos_overlap_their_neighbours_and_end_at_the_border() {
        // Two tiles of 52 px: 58 and 54 px with the halo of 6 px.
        assert_eq!(tiles([100, 52], 3), [2, 1, 1]);
        assert_eq!(pixels_with_halos([100, 52], 0, 3), (58 + 54) * 52);
        // Of the next grid, of 50 x 26 cells, from -18 to 46 and from 8 on.
        assert_eq!(pixels_with_halos([100, 52], 1, 3), (46 + 42) * 26);
        assert_eq!([3, 8, 9, 30].map(dispatches), [[3, 1], [8, 1], [5, 2], [8, 4]]);
    }
}
