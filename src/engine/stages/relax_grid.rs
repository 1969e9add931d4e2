//! Half a relaxation sweep on a coarse [grid](super::grid): one color of the red-black scheme.

use std::ops::Range;

use super::grid::{FLOATS, Grid, prolonged};
use super::pass::{Memory, Pass, bindings, push_constants};
use super::{Number, WORKGROUP, pixels};
use crate::engine::shaders;
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
    /// 0 red, 1 black.
    color: u32,
    /// ω of successive over-relaxation.
    over_relaxation: f32,
}

/// The variant for the first relaxation sweep, which starts from dV of the coarser grid.
pub(crate) const FIRST: Variant = [true, false, false, false, false];

/// Workgroups over a grid.
pub(crate) fn tiles([width, height]: [u32; 2]) -> [u32; 3] {
    [width.div_ceil(2 * WORKGROUP[0]), height.div_ceil(WORKGROUP[1] * shaders::relax_grid::LINES), 1]
}

bindings! {
    RELAX_GRID:
    /// Equations of all grids.
    equations: Reads<GridEquations>,
    /// dV of all grids.
    steps: Updates<GridSteps>,
}

impl Pass for Bindings {
    /// Compulsory traffic: the equations and dV of the grid read, half of dV written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        (4 * FLOATS as u64 + 6) * pixels(c.width, c.height)
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let color = c.color as usize;
        self.relax(c, color..color + 1, variant == FIRST && color == 0, memory);
    }
}

impl Bindings {
    /// Halves of relaxation sweeps. `is_first`: from dV of the coarser grid.
    fn relax<N: Number>(&self, c: &Constants, halves: Range<usize>, is_first: bool, memory: &mut Memory<N>) {
        let (size, first) = ([c.width as usize, c.height as usize], c.first as usize);
        let own = first..first + size[0] * size[1];
        let mut steps = memory.take_numbers(self.steps);
        steps.resize(steps.len().max(own.end), N::default());
        let start = if is_first { prolonged(&steps[c.next as usize..], size) } else { steps[own.clone()].to_vec() };
        let grid = Grid::of(memory.numbers(self.equations), first, [c.width, c.height]);
        grid.relax(&start, halves, c.over_relaxation.into(), &mut steps[own]);
        memory.put_numbers(self.steps, steps);
    }
}

/// Runs the leading dispatches that are half-sweeps of one grid. Returns their number.
pub(crate) fn run_all<N: Number>(dispatches: &[(Bindings, Constants, Variant)], memory: &mut Memory<N>) -> usize {
    let Some((grid, c, _)) = dispatches.first() else { return 0 };
    let is_next = |(n, (_, next, variant)): &(usize, &(Bindings, Constants, Variant))| {
        next.first == c.first && next.color as usize == n % 2 && (*variant == FIRST) == (*n < 2)
    };
    let count = dispatches.iter().enumerate().take_while(is_next).count();
    if count > 0 {
        grid.relax(c, 0..count, true, memory);
    }
    count
}

#[cfg(test)]
mod tests {
    use super::super::NO_VARIANT;
    use super::super::grid::halved;
    use super::super::grid::tests::random_grid;
    use super::super::harness::{Rig, assert_numbers, random_field};
    use super::*;
    use crate::engine::vulkan::Resource;

    #[test]
    fn matches_the_cpu_reference_from_the_coarser_grid() {
        for [width, height] in [[37, 21], [64, 16], [17, 18], [131, 9], [2, 2]] {
            let (grid, [columns, rows]) = (random_grid([width, height], 2), halved([width, height]));
            let coarse = random_field(columns as usize, rows as usize, 7);
            let rig = Rig::new();
            let steps = [vec![f64::NAN; (width * height) as usize], coarse.data.clone()].concat();
            let buffers = [rig.numbers(grid.cells.as_flattened().to_vec()), rig.numbers(steps)];
            let mut expected = prolonged(&coarse.data, [width as usize, height as usize]);
            for (variant, color) in [(FIRST, 0), (FIRST, 1), (NO_VARIANT, 0), (NO_VARIANT, 1)] {
                let c = Constants { width, height, first: 0, next: width * height, color, over_relaxation: 1.3 };
                let color = color as usize;
                grid.relax(&expected.clone(), color..color + 1, c.over_relaxation.into(), &mut expected);
                rig.run_variant(&STAGE, variant, &buffers.each_ref().map(Resource::Buffer), &c, tiles([width, height]));
            }
            assert_numbers(&rig.floats(&buffers[1]), &expected, 1e-4);
        }
    }
}
