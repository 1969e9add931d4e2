//! The smallest [grids](super::grid) of the cascade in one workgroup, in shared memory.
//!
//! As [`coarsest_grids`] does for larger grids in a buffer, which other invocations read only after the latency of the
//! memory. On a GPU one workgroup takes as long as its latency.

use super::coarsest_grids::{self, Constants};
use super::grid::{FLOATS, Grid};
use super::pass::{Memory, Pass, bindings};
use super::{Number, WORKGROUP, pixels};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

const _: () = assert!(WORKGROUP[0] * WORKGROUP[1] == shaders::coarsest_grids_shared::TOTAL);

bindings! {
    COARSEST_GRIDS_SHARED:
    /// Equations of all grids.
    equations: Reads<GridEquations>,
    /// dV of all grids.
    steps: Writes<GridSteps>,
}

/// Whether a grid and all coarser ones fit the shared memory and the invocations of a workgroup.
pub(crate) fn takes([width, height]: [u32; 2]) -> bool {
    let of_color = pixels(width.div_ceil(2), height);
    of_color <= u64::from(shaders::coarsest_grids_shared::TOTAL * shaders::coarsest_grids_shared::PER_COLOR)
}

impl Pass for Bindings {
    /// Compulsory traffic: the equations of the finest of these grids read and its dV written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        (4 * FLOATS as u64 + 4) * pixels(c.width, c.height)
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let first = c.first as usize;
        let grid = Grid::of(memory.numbers(self.equations), first, [c.width, c.height]);
        let dv = coarsest_grids::cpu_reference(c, &grid);
        memory.numbers_mut(self.steps, first + dv.len())[first..first + dv.len()].copy_from_slice(&dv);
    }
}

#[cfg(test)]
mod tests {
    use super::super::coarsest_grids::COARSEST_SWEEPS;
    use super::super::grid::tests::random_grid;
    use super::super::grid::{cells, grids, halved};
    use super::super::harness::Rig;
    use super::*;
    use crate::engine::vulkan::Resource;

    /// Largest, odd, narrow and tiny grids, after other contents of the buffers.
    #[test]
    fn matches_the_cpu_reference_from_any_contents() {
        for level in [[64, 64], [63, 64], [63, 59], [74, 43], [128, 32], [35, 36], [16, 17], [9, 8], [120, 17], [3, 2]]
        {
            let places = grids(level);
            let [width, height] = places[0].size;
            assert!(takes([width, height]) && width * height <= shaders::coarsest_grids_shared::CELLS);
            assert!(cells(level) <= u64::from(shaders::coarsest_grids_shared::ALL_CELLS));
            let (sweeps, coarsest_sweeps, over_relaxation, first) = (3, COARSEST_SWEEPS, 1.3, 5);
            let grids = places.len() as u32;
            let c = Constants { width, height, first, grids, sweeps, coarsest_sweeps, over_relaxation };
            let grid = random_grid([width, height], 5);
            let rig = Rig::new();
            let mut equations = vec![f32::NAN; FLOATS * first as usize];
            equations.extend(grid.cells.iter().flatten().map(|&v| v as f32));
            equations.resize(equations.len() + FLOATS * cells(level) as usize, f32::NAN);
            let steps = vec![f32::NAN; first as usize + cells(level) as usize];
            let buffers = [rig.upload(bytemuck::cast_slice(&equations)), rig.upload(bytemuck::cast_slice(&steps))];
            rig.run_groups(&STAGE, &buffers.each_ref().map(Resource::Buffer), &c, [1, 1, 1]);
            let actual = rig.floats(&buffers[1]);
            for (f, e) in actual[first as usize..].iter().zip(&coarsest_grids::cpu_reference(&c, &grid)) {
                assert!((f64::from(*f) - e).abs() < 1e-4, "{f}, not {e}");
            }
        }
    }

    #[test]
    fn grids_that_are_taken_fit() {
        for width in 1..=1100 {
            for height in (1..=1100 / width + 1).filter(|&height| takes([width, height])) {
                let (mut size, mut all) = ([width, height], pixels(width, height));
                assert!(all <= u64::from(shaders::coarsest_grids_shared::CELLS));
                while size[0].min(size[1]) >= 16 {
                    size = halved(size);
                    all += pixels(size[0], size[1]);
                    // Two cells of the next grid for each invocation.
                    assert!(pixels(size[0], size[1]) <= 512);
                }
                assert!(all <= u64::from(shaders::coarsest_grids_shared::ALL_CELLS), "{width} x {height}");
            }
        }
    }
}
