//! The shape of the kernel, by what the photographs say.

use super::compose::{BOTH, Composer};
use crate::engine::arguments::Grid;
use crate::engine::plan::Level;
use crate::engine::slot;
use crate::engine::stages::pass::Pass;
use crate::engine::stages::{NO_VARIANT, shape, shape_median, shape_windows};

impl Composer<'_> {
    /// What windows say, their median, and both stacks as it has them.
    pub(super) fn find_shape(&mut self, level: &Level) {
        let windows = shape_windows::Bindings {
            v: slot::relative_blur(level.index).read(),
            stacks: slot::STACKS.read(),
            state: slot::STATE.read(),
            masks: slot::masks(level.index).read(),
            windows: slot::PARTIALS.write(),
        };
        let constants = self.plan.shape_windows(level);
        let [columns, rows] = constants.grid;
        self.dispatch(windows, &constants, [false, false, self.masked, false], Grid::Direct([columns, rows, 1]));
        let median = shape_median::Bindings { windows: slot::PARTIALS.read(), state: slot::STATE.update() };
        let constants = shape_median::Constants { windows: columns * rows };
        self.dispatch(median, &constants, NO_VARIANT, Grid::Direct([1, 1, 1]));
        for image in BOTH {
            self.shape(level, image);
        }
    }

    /// A stack as the shape has it.
    pub(super) fn shape(&mut self, level: &Level, image: usize) {
        let bindings = shape::Bindings { stacks: slot::STACKS.update(), state: slot::STATE.read() };
        let [width, height] = level.size;
        let constants =
            shape::Constants { width, height, nodes: level.nodes as u32, first: self.plan.first_layer(image) };
        let grid = self.grid(shape::Bindings::STAGE.groups(level.size));
        self.dispatch(bindings, &constants, NO_VARIANT, grid);
    }
}
