//! Sums the linear system of a [grid](super::grid) up to the next coarser one.

use super::grid::{FLOATS, Grid, halved};
use super::pass::{Memory, Pass};
use super::{Number, pixels};
use crate::engine::vulkan::Variant;

pub use super::interface::halve_grid::*;

impl Pass for Bindings {
    /// Compulsory traffic: the equations of the finer grid read, those of the coarser written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        let [width, height] = halved([c.width, c.height]);
        4 * FLOATS as u64 * (pixels(c.width, c.height) + pixels(width, height))
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let coarse = cpu_reference(&Grid::of(memory.numbers(self.equations), c.first as usize, [c.width, c.height]));
        let (numbers, next) = (coarse.cells.as_flattened(), FLOATS * c.next as usize);
        memory.numbers_mut(self.equations, next + numbers.len())[next..][..numbers.len()].copy_from_slice(numbers);
    }
}

/// The system of the next coarser grid.
pub fn cpu_reference<N: Number>(fine: &Grid<N>) -> Grid<'static, N> {
    fine.halved()
}

#[cfg(test)]
mod tests {
    use super::super::grid::tests::random_grid;
    use super::super::harness::{Rig, assert_numbers};
    use super::*;
    use crate::engine::slot::Slot;
    use crate::engine::stages::NO_VARIANT;
    use crate::engine::vulkan::Resource;

    #[test]
    fn matches_the_cpu_reference() {
        for [width, height] in [[37, 21], [64, 16], [17, 18], [3, 2]] {
            let grid = random_grid([width, height], 1);
            let [columns, rows] = halved([width, height]);
            let c = Constants { width, height, first: 0, next: width * height };
            let mut numbers = grid.cells.as_flattened().to_vec();
            numbers.resize(numbers.len() + FLOATS * (columns * rows) as usize, f64::NAN);
            let (mut memory, rig) = (Memory::<f64>::new(), Rig::new());
            memory.numbers.insert(Slot::GridEquations, numbers.clone());
            Bindings::on(0).run(&c, NO_VARIANT, &mut memory);
            let buffer = rig.numbers(numbers);
            rig.run_groups(&STAGE, &[Resource::Buffer(&buffer)], &c, STAGE.groups([columns, rows]));
            assert_numbers(&rig.floats(&buffer), &memory.numbers[&Slot::GridEquations], 1e-5);
        }
    }
}
