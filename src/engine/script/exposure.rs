//! Gain, offset and shading, by what V says of either side.

use super::compose::Composer;
use crate::engine::arguments::Grid;
use crate::engine::plan::Level;
use crate::engine::slot;
use crate::engine::stages::exposure::Adopt;
use crate::engine::stages::stack::Slopes;
use crate::engine::stages::{NO_VARIANT, blur_matched_pair, exposure, linearise, uncertainty_terms};

impl Composer<'_> {
    /// Matches them, or measures the correlation alone; without stacks I2 is read from its spline, V being zero.
    pub(super) fn exposure(&mut self, level: &Level, adopt: Adopt, stacked: bool) {
        let (plan, size) = (self.plan, uncertainty_terms::size(level.size));
        let stacks = if stacked { slot::STACKS.plane() } else { slot::SPLINE2.plane() };
        let bindings = blur_matched_pair::Bindings {
            i1: slot::i1(level.index).read(),
            v: slot::relative_blur(level.index).read(),
            stacks: stacks.read(),
            sides: slot::EVIDENCE.write(),
            state: slot::STATE.read(),
            masks: slot::masks(level.index).read(),
        };
        let slopes = if stacked { plan.slopes() } else { Slopes::Laplacian };
        let variant = linearise::variant(slopes, stacked && plan.warps(level), self.masked, false);
        self.over(size, bindings, &plan.sides(level, stacked), variant);
        for layer in 0..blur_matched_pair::LAYERS {
            self.smooth((slot::EVIDENCE.plane(), layer), size);
        }
        let bindings = exposure::Bindings { sides: slot::EVIDENCE.read(), state: slot::STATE.update() };
        self.dispatch(bindings, &plan.exposure(level, adopt), NO_VARIANT, Grid::Direct([1, 1, 1]));
    }
}
