//! All relaxation sweeps on a coarse [grid](super::grid) in one dispatch, on tiles with a halo; if
//! [joined](super::cascade) also those on all coarser grids.
//!
//! [`relax_tiles`](super::relax_tiles) does the same on a level.

use super::cascade::Coarser;
use super::grid::{FLOATS, Grid, prolonged};
use super::pass::{Memory, Pass, bindings, push_constants};
use super::{Number, pixels, relax_tiles};
use crate::engine::slot::Bound;
use crate::engine::vulkan::Variant;

push_constants! {
    /// Width of the grid, cells.
    width: u32,
    /// Height of the grid, cells.
    height: u32,
    /// First cell of the grid.
    first: u32,
    /// Relaxation sweeps.
    sweeps: u32,
    /// ω of successive over-relaxation.
    over_relaxation: f32,
    /// The coarser grids, stored or joined.
    coarser: Coarser,
}

bindings! {
    RELAX_GRID_TILES:
    /// Equations of all grids.
    equations: Reads<GridEquations>,
    /// dV of all grids: the next coarser one is read.
    coarse: Reads<GridSteps>,
    /// The same buffer: the grid is written. With a binding for each, validation reports missing barriers.
    steps: Writes<GridSteps>,
}

impl Pass for Bindings {
    /// Compulsory traffic: for tiles with their halos, the equations and what they start from; dV written once.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        let size = [c.width, c.height];
        let cells = relax_tiles::pixels_with_halos(size, 0, c.sweeps);
        let before = relax_tiles::bytes_before(size, c.sweeps, &c.coarser);
        4 * FLOATS as u64 * cells + before + 4 * pixels(c.width, c.height)
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let (size, first, relaxation) = ([c.width, c.height], c.first as usize, (c.sweeps, c.over_relaxation));
        // dV may never have been written before, if joined.
        let (equations, steps) = (memory.numbers(self.equations), memory.numbers_in(self.coarse.slot()));
        let coarse = c.coarser.cpu_reference(size, relaxation, equations, steps);
        let dv = cpu_reference(c, &Grid::of(equations, first, size), &coarse);
        memory.numbers_mut(self.steps, first + dv.len())[first..first + dv.len()].copy_from_slice(&dv);
    }
}

/// dV of a grid, relaxed from that of the next coarser one.
pub fn cpu_reference<N: Number>(c: &Constants, grid: &Grid<N>, coarse: &[N]) -> Vec<N> {
    let mut dv = prolonged(coarse, [grid.width, grid.height]);
    grid.relax_all(&mut dv, c.sweeps, c.over_relaxation);
    dv
}

#[cfg(test)]
mod tests {
    use super::super::cascade::{covers, fits};
    use super::super::coarsest_grids::COARSEST_SWEEPS;
    use super::super::grid::tests::random_grid;
    use super::super::grid::{grids, halved};
    use super::super::harness::{Rig, assert_numbers, random_field};
    use super::*;
    use crate::engine::vulkan::Resource;

    #[test]
    fn matches_the_cpu_reference_from_the_coarser_grid() {
        for ([width, height], sweeps) in
            [([137, 121], 3), ([64, 16], 3), ([17, 18], 1), ([2, 2], 3), ([200, 53], 8), ([53, 104], 3), ([105, 52], 2)]
        {
            let (grid, [columns, rows]) = (random_grid([width, height], 2), halved([width, height]));
            let coarse = random_field(columns as usize, rows as usize, 7);
            let steps = [vec![f64::NAN; (width * height) as usize], coarse.data.clone()].concat();
            let rig = Rig::new();
            let [equations, steps] = [rig.numbers(grid.cells.as_flattened().to_vec()), rig.numbers(steps)];
            let resources = [&equations, &steps, &steps].map(Resource::Buffer);
            let coarser = Coarser::stored(width * height);
            let c = Constants { width, height, first: 0, sweeps, over_relaxation: 1.3, coarser };
            rig.run_groups(&STAGE, &resources, &c, relax_tiles::tiles([width, height], sweeps));
            let expected = cpu_reference(&c, &grid, &coarse.data);
            let actual = rig.floats(&steps);
            assert_numbers(&actual, &expected, 1e-4);
            assert_eq!(&actual[expected.len()..], coarse.to_f32(), "of the coarser grid");
        }
    }

    /// Grids of one and of many tiles, with none to four grids before the small ones: odd, narrow and tiny ones. The
    /// buffer of dV holds no numbers before, and cells before the grid stay as they are.
    #[test]
    fn matches_the_cpu_reference_with_all_coarser_grids() {
        for (size, sweeps) in [
            ([250, 250], 3),
            ([500, 301], 3),
            ([137, 121], 4),
            ([131, 118], 1),
            ([64, 64], 3),
            ([63, 59], 2),
            ([74, 43], 3),
            ([128, 32], 3),
            ([120, 17], 3),
            ([17, 18], 3),
            ([400, 36], 4),
            ([9, 8], 3),
            ([3, 2], 3),
            ([64, 64], 6),
            ([30, 128], 8),
            ([821, 777], 3),
        ] {
            let [width, height] = size;
            let (first, mut places) = (5, grids(size));
            places.iter_mut().for_each(|place| place.first += first + width * height);
            let small = places.iter().position(|place| fits(place.size)).unwrap();
            assert!(covers(sweeps) || small == 0);
            let last = places[places.len() - 1];
            let mut cells = vec![[f64::NAN; FLOATS]; (last.first + last.size[0] * last.size[1]) as usize];
            let mut grid = random_grid(size, 5);
            for first in [first].into_iter().chain(places[..=small].iter().map(|place| place.first)) {
                cells[first as usize..][..grid.cells.len()].copy_from_slice(&grid.cells);
                grid = grid.halved();
            }
            let (rig, numbers) = (Rig::new(), cells.as_flattened());
            let [equations, steps] = [rig.numbers(numbers.to_vec()), rig.numbers(vec![f64::NAN; cells.len()])];
            let resources = [&equations, &steps, &steps].map(Resource::Buffer);
            let coarser = Coarser::joined(&places, small);
            assert_eq!(coarser.coarsest_sweeps, COARSEST_SWEEPS);
            let c = Constants { width, height, first, sweeps, over_relaxation: 1.3, coarser };
            rig.run_variant(&STAGE, coarser.variant(), &resources, &c, relax_tiles::tiles(size, sweeps));
            let coarse = coarser.cpu_reference(size, (sweeps, 1.3), numbers, &[]);
            let expected = cpu_reference(&c, &Grid::of(numbers, first as usize, size), &coarse);
            let actual = rig.floats(&steps);
            assert_numbers(&actual[first as usize..], &expected, 1e-4);
            let others = actual[..first as usize].iter().chain(&actual[first as usize + expected.len()..]);
            assert!(others.into_iter().all(|step| step.is_nan()));
        }
    }
}
