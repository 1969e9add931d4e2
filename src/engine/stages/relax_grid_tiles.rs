//! All relaxation sweeps on a coarse [grid](super::grid) in one dispatch, on tiles with a halo.
//!
//! [`relax_tiles`](super::relax_tiles) does the same on a level.

use super::grid::{FLOATS, Grid, prolonged};
use super::pass::{Memory, Pass, bindings, push_constants};
use super::{Number, pixels, relax_tiles};
use crate::engine::vulkan::Variant;

push_constants! {
    /// Width of the grid, cells.
    width: u32,
    /// Height of the grid, cells.
    height: u32,
    /// First cell of the grid.
    first: u32,
    /// First cell of the next coarser grid.
    next: u32,
    /// Relaxation sweeps.
    sweeps: u32,
    /// ω of successive over-relaxation.
    over_relaxation: f32,
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
    /// Compulsory traffic: for tiles with their halos, the equations, and dV of the coarser grid, a quarter of a number
    /// per cell; dV written once.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        let cells = relax_tiles::pixels_with_halos([c.width, c.height], c.sweeps);
        (4 * FLOATS as u64 + 1) * cells + 4 * pixels(c.width, c.height)
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let (size, first) = ([c.width as usize, c.height as usize], c.first as usize);
        let start = prolonged(&memory.numbers(self.coarse)[c.next as usize..], size);
        let dv = cpu_reference(c, &Grid::of(memory.numbers(self.equations), first, [c.width, c.height]), start);
        memory.numbers_mut(self.steps, first + dv.len())[first..first + dv.len()].copy_from_slice(&dv);
    }
}

/// dV of a grid, relaxed from a start.
pub fn cpu_reference<N: Number>(c: &Constants, grid: &Grid<N>, mut dv: Vec<N>) -> Vec<N> {
    for color in (0..2 * c.sweeps).map(|half| half % 2) {
        grid.relax(&mut dv, color as usize, c.over_relaxation.into());
    }
    dv
}

#[cfg(test)]
mod tests {
    use super::super::grid::halved;
    use super::super::grid::tests::random_grid;
    use super::super::harness::{Rig, random_field};
    use super::*;
    use crate::engine::vulkan::Resource;

    #[test]
    fn matches_the_cpu_reference_from_the_coarser_grid() {
        for ([width, height], sweeps) in
            [([137, 121], 3), ([64, 16], 3), ([17, 18], 1), ([2, 2], 3), ([200, 53], 8), ([53, 104], 3), ([105, 52], 2)]
        {
            let (grid, [columns, rows]) = (random_grid([width, height], 2), halved([width, height]));
            let coarse = random_field(columns as usize, rows as usize, 7);
            let rig = Rig::new();
            let equations: Vec<f32> = grid.cells.iter().flatten().map(|&v| v as f32).collect();
            let mut steps = vec![f32::NAN; (width * height) as usize];
            steps.extend(coarse.to_f32());
            let [equations, steps] =
                [rig.upload(bytemuck::cast_slice(&equations)), rig.upload(bytemuck::cast_slice(&steps))];
            let resources = [&equations, &steps, &steps].map(Resource::Buffer);
            let c = Constants { width, height, first: 0, next: width * height, sweeps, over_relaxation: 1.3 };
            rig.run_groups(&STAGE, &resources, &c, relax_tiles::tiles([width, height], sweeps));
            let start = prolonged(&coarse.data, [width as usize, height as usize]);
            let expected = cpu_reference(&c, &grid, start);
            let actual = rig.floats(&steps);
            for (f, e) in actual.iter().zip(&expected) {
                assert!((f64::from(*f) - e).abs() < 1e-4, "{f}, not {e}");
            }
            assert_eq!(&actual[expected.len()..], coarse.to_f32(), "of the coarser grid");
        }
    }
}
