//! Relaxation sweeps on a coarse [grid](super::grid) in one dispatch, on tiles with a halo; if
//! [joined](super::cascade) also those on all coarser grids.
//!
//! [`relax_tiles`](super::relax_tiles) does the same on a level. Sweeps that exceed a halo are several dispatches.

use super::cascade;
use super::grid::{FLOATS, Grid, prolonged};
use super::pass::{Memory, Pass};
use super::{Number, pixels, relax_tiles};
use crate::engine::slot::Bound;
use crate::engine::vulkan::Variant;

pub use super::interface::relax_grid_tiles::*;

impl Pass for Bindings {
    /// Compulsory traffic: for tiles with their halos, the equations and what they start from; dV written once.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        let size = [c.width, c.height];
        let cells = relax_tiles::pixels_with_halos(size, 0, c.halo);
        let before = relax_tiles::bytes_before(size, c.halo, &c.coarser);
        4 * FLOATS as u64 * cells + before + 4 * pixels(c.width, c.height)
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let (size, first, relaxation) = ([c.width, c.height], c.first as usize, (c.sweeps, c.over_relaxation));
        let cells = (c.width * c.height) as usize;
        // dV may never have been written before, if joined.
        let (equations, steps) = (memory.numbers(self.equations), memory.numbers_in(self.steps.slot()));
        let mut dv = match cascade::continues(variant) {
            true => steps[c.coarser.next as usize..][..cells].to_vec(),
            false => {
                let coarse = c.coarser.cpu_reference(size, relaxation, equations, steps);
                prolonged(&coarse, size.map(|side| side as usize))
            }
        };
        Grid::of(equations, first, size).relax_all(&mut dv, c.sweeps, c.over_relaxation);
        let to = c.to as usize..c.to as usize + cells;
        memory.numbers_mut(self.own_steps, to.end)[to].copy_from_slice(&dv);
    }
}

#[cfg(test)]
mod tests {
    use super::super::cascade::{Start, covers, fits};
    use super::super::grid::tests::random_grid;
    use super::super::grid::{Place, grids};
    use super::super::harness::{Rig, assert_numbers};
    use super::*;
    use crate::engine::slot::Slot;
    use crate::engine::vulkan::Resource;

    /// Compares dV of all grids with the CPU reference.
    fn check(c: &Constants, variant: Variant, equations: Vec<f64>, steps: Vec<f64>) {
        let mut memory = Memory::<f64>::new();
        memory.numbers.insert(Slot::GridEquations, equations.clone());
        memory.numbers.insert(Slot::GridSteps, steps.clone());
        Bindings::on(0).run(c, variant, &mut memory);
        let expected = &memory.numbers[&Slot::GridSteps];
        let rig = Rig::new();
        let [equations, steps] = [rig.numbers(equations), rig.numbers(steps)];
        let resources = [&equations, &steps, &steps].map(Resource::Buffer);
        rig.run_variant(&STAGE, variant, &resources, c, relax_tiles::tiles([c.width, c.height], c.halo));
        let written = c.to as usize..(c.to + c.width * c.height) as usize;
        let actual = rig.floats(&steps);
        assert_numbers(&actual[written.clone()], &expected[written.clone()], 1e-4);
        for n in (0..actual.len()).filter(|n| !written.contains(n)) {
            assert!(actual[n] == expected[n] as f32 || actual[n].is_nan() && expected[n].is_nan());
        }
    }

    /// Grids of one and of many tiles, with none to four grids before the small ones: odd, narrow and tiny ones. The
    /// buffer of dV holds no numbers before, and cells before the grid stay as they are.
    #[test]
    fn matches_the_cpu_reference_with_all_coarser_grids() {
        for (size, sweeps) in [([250, 250], 3), ([9, 8], 3), ([821, 777], 3)] {
            let [width, height] = size;
            let (first, mut places) = (5, grids(size));
            places.iter_mut().for_each(|place| place.first += first + width * height);
            let small = places.iter().position(|place| fits(place.size)).unwrap();
            assert!(covers(sweeps) || small == 0);
            let Place { size: [columns, rows], first: last } = places[places.len() - 1];
            let mut cells = vec![[f64::NAN; FLOATS]; (last + columns * rows) as usize];
            let mut grid = random_grid(size, 5);
            for first in [first].into_iter().chain(places[..=small].iter().map(|place| place.first)) {
                cells[first as usize..][..grid.cells.len()].copy_from_slice(&grid.cells);
                grid = grid.halved();
            }
            let start = Start::Joined { grids: &places, small };
            let coarser = start.constants();
            let c = Constants { width, height, first, to: first, sweeps, halo: sweeps, over_relaxation: 1.3, coarser };
            let steps = vec![f64::NAN; cells.len()];
            check(&c, start.variant(), cells.as_flattened().to_vec(), steps);
        }
    }
}
