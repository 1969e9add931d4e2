//! The small [grids](super::grid) of the cascade in one workgroup.
//!
//! On small grids a dispatch takes longer than its work.

use super::grid::{FLOATS, Grid, halved, prolonged};
use super::pass::{Memory, Pass, bindings, push_constants};
use super::{Number, pixels};
use crate::engine::vulkan::Variant;

/// The most cells of a grid for one workgroup, as [`relax_level`](super::relax_level) takes them.
pub(crate) const MOST_CELLS: u64 = 1 << 13;

/// Relaxation sweeps on the coarsest grid, of 8 to 15 cells along its short side.
pub(crate) const COARSEST_SWEEPS: u32 = 30;

push_constants! {
    /// Width of the finest of these grids, cells.
    width: u32,
    /// Height of the finest of these grids, cells.
    height: u32,
    /// Its first cell.
    first: u32,
    /// Grids.
    grids: u32,
    /// Relaxation sweeps on each grid but the coarsest.
    sweeps: u32,
    /// Relaxation sweeps on the coarsest grid.
    coarsest_sweeps: u32,
    /// ω of successive over-relaxation.
    over_relaxation: f32,
}

bindings! {
    COARSEST_GRIDS:
    /// Equations of all grids.
    equations: Updates<GridEquations>,
    /// dV of all grids.
    steps: Updates<GridSteps>,
}

impl Pass for Bindings {
    /// Compulsory traffic: the equations read and dV written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        (4 * FLOATS as u64 + 4) * pixels(c.width, c.height)
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let first = c.first as usize;
        let dv = cpu_reference(c, &Grid::of(memory.numbers(self.equations), first, [c.width, c.height]));
        memory.numbers_mut(self.steps, first + dv.len())[first..first + dv.len()].copy_from_slice(&dv);
    }
}

/// dV of the finest of these grids.
pub fn cpu_reference<N: Number>(c: &Constants, grid: &Grid<N>) -> Vec<N> {
    let size = [grid.width, grid.height];
    let (mut dv, sweeps) = if c.grids > 1 {
        let [columns, rows] = halved([c.width, c.height]);
        let coarse = Constants { width: columns, height: rows, grids: c.grids - 1, ..*c };
        (prolonged(&cpu_reference(&coarse, &grid.halved()), size), c.sweeps)
    } else {
        (vec![N::default(); size[0] * size[1]], c.coarsest_sweeps)
    };
    grid.relax_all(&mut dv, sweeps, c.over_relaxation);
    dv
}

#[cfg(test)]
mod tests {
    use super::super::Field;
    use super::super::grid::tests::{of_parts, random_grid};
    use super::super::grid::{cells, grids};
    use super::super::harness::{Rig, assert_numbers};
    use super::*;
    use crate::engine::vulkan::Resource;

    #[test]
    fn matches_the_cpu_reference_from_any_contents() {
        // The coarsest grid of the last has too many cells for shared memory.
        for level in [[74, 43], [128, 32], [35, 36], [16, 17], [9, 8], [300, 17]] {
            let places = grids(level);
            let [width, height] = places[0].size;
            let c = Constants {
                width,
                height,
                first: 0,
                grids: places.len() as u32,
                sweeps: 3,
                coarsest_sweeps: COARSEST_SWEEPS,
                over_relaxation: 1.3,
            };
            let grid = random_grid([width, height], 5);
            let rig = Rig::new();
            let mut equations = grid.cells.as_flattened().to_vec();
            equations.resize(FLOATS * cells(level) as usize, f64::NAN);
            let buffers = [rig.numbers(equations), rig.numbers(vec![f64::NAN; cells(level) as usize])];
            rig.run_groups(&STAGE, &buffers.each_ref().map(Resource::Buffer), &c, [1, 1, 1]);
            assert_numbers(&rig.floats(&buffers[1]), &cpu_reference(&c, &grid), 1e-4);
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
        let c = Constants {
            width: n as u32,
            height: n as u32,
            first: 0,
            grids: 4,
            sweeps: 3,
            coarsest_sweeps: COARSEST_SWEEPS,
            over_relaxation: 1.3,
        };
        let dv = cpu_reference(&c, &grid);
        let error = dv.iter().zip(&truth.data).map(|(a, e)| (a - e).powi(2)).sum::<f64>() / (n * n) as f64;
        // The truth is 1 rms.
        assert!(error.sqrt() < 0.1, "{}", error.sqrt());
    }
}
