//! Sums the linear system for dV of the finest grid up to several coarser [grids](super::grid) in one dispatch.
//!
//! On a GPU a dispatch of [`halve_grid`](super::halve_grid) takes longer than its work. A tile of 64 x 64 cells makes
//! the cells of six grids without those of other tiles.

use super::grid::{FLOATS, Grid, halved};
use super::pass::{Memory, Pass, bindings, push_constants};
use super::{Number, WORKGROUP, pixels};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

/// The most coarser grids of a dispatch.
pub(crate) const GRIDS: usize = shaders::halve_grids::GRIDS as usize;

/// Width and height of a tile, cells of the finest grid.
const TILE: u32 = 4 * shaders::halve_grids::SIDE;

const _: () = assert!(TILE == 1 << GRIDS && WORKGROUP[0] * WORKGROUP[1] == TILE * TILE / 16);

push_constants! {
    /// Width of the finest grid, cells.
    width: u32,
    /// Height of the finest grid, cells.
    height: u32,
    /// Its first cell.
    first: u32,
    /// Coarser grids, at most 6.
    grids: u32,
}

bindings! {
    HALVE_GRIDS:
    /// Equations of all grids: the finest is read.
    finest: Reads<GridEquations>,
    /// The same buffer: the coarser grids are written. With a binding for each, validation reports missing
    /// barriers.
    coarser: Writes<GridEquations>,
}

/// Workgroups over the finest grid.
pub(crate) fn tiles([width, height]: [u32; 2]) -> [u32; 3] {
    [width.div_ceil(TILE), height.div_ceil(TILE), 1]
}

impl Pass for Bindings {
    /// Compulsory traffic: the equations of the finest grid read, those of the coarser ones written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        let sizes = std::iter::successors(Some([c.width, c.height]), |size| Some(halved(*size)));
        4 * FLOATS as u64 * sizes.take(c.grids as usize + 1).map(|[width, height]| pixels(width, height)).sum::<u64>()
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let grid = Grid::of(memory.numbers(self.finest), c.first as usize, [c.width, c.height]);
        let (next, numbers) = (FLOATS * (c.first as usize + grid.cells.len()), cpu_reference(c, &grid));
        let end = next + numbers.len();
        memory.numbers_mut(self.coarser, end)[next..end].copy_from_slice(&numbers);
    }
}

/// The systems of the coarser grids, one behind the other.
pub fn cpu_reference<N: Number>(c: &Constants, finest: &Grid<N>) -> Vec<N> {
    let coarser = std::iter::successors(Some(finest.halved()), |grid| Some(grid.halved()));
    coarser.take(c.grids as usize).flat_map(|grid| grid.cells.as_flattened().to_vec()).collect()
}

#[cfg(test)]
mod tests {
    use super::super::grid::tests::random_grid;
    use super::super::grid::{cells, grids};
    use super::super::harness::Rig;
    use super::*;
    use crate::engine::vulkan::Resource;

    #[test]
    fn matches_the_cpu_reference() {
        for (level, count) in [([300, 260], 4), ([129, 131], 3), ([258, 1100], 4), ([1100, 1040], 6), ([40, 36], 1)] {
            let [width, height] = grids(level)[0].size;
            let c = Constants { width, height, first: 0, grids: count };
            let finest = random_grid([width, height], 6);
            let mut numbers: Vec<f32> = finest.cells.iter().flatten().map(|&v| v as f32).collect();
            let next = numbers.len();
            numbers.resize(FLOATS * cells(level) as usize, f32::NAN);
            let rig = Rig::new();
            let buffer = rig.upload(bytemuck::cast_slice(&numbers));
            rig.run_groups(&STAGE, &[Resource::Buffer(&buffer); 2], &c, tiles([width, height]));
            let (actual, expected) = (rig.floats(&buffer), cpu_reference(&c, &finest));
            for (n, (a, e)) in actual[next..].iter().zip(&expected).enumerate() {
                // Of up to 4096 numbers.
                assert!((f64::from(*a) - e).abs() < 1e-5 * (1.0 + e.abs()), "{n}: {a}, not {e}");
            }
            assert!(actual[next + expected.len()..].iter().all(|number| number.is_nan()), "beyond the grids");
        }
    }
}
