//! The linear system for the step of the unknown, V of a pair or u of a sweep, and its relaxation: the same for both.

use super::compose::Composer;
use crate::engine::arguments::Over;
use crate::engine::plan::Level;
use crate::engine::slot;
use crate::engine::stages::{NO_VARIANT, relax, relax_level, system, update};
use crate::engine::vulkan::Variant;

const RED: usize = 0;
const BLACK: usize = 1;

impl Composer<'_> {
    /// The system, by what the photographs say over a window.
    pub(super) fn system(&mut self, level: &Level, constants: &system::Constants, variant: Variant) {
        self.unsettled = self.settles.then_some(level.index);
        for layer in 0..system::layers(variant) {
            self.smooth((slot::NORMAL_EQUATIONS, layer), level.size);
        }
        self.unsettled = None;
        let bindings = system::Bindings {
            unknown: slot::relative_blur(level.index).read(),
            equations: slot::NORMAL_EQUATIONS.read(),
            right_sides: slot::RIGHT_SIDES.write(),
            weights: slot::WEIGHTS.write(),
            partials: slot::PARTIALS.write(),
            state: slot::STATE.read(),
        };
        self.within(level, Over::Pixels, bindings, constants, variant);
    }

    /// dV by red-black sweeps: two passes each, or one pass for all where the level is small.
    pub(super) fn relaxation(&mut self, level: &Level) {
        if relax_level::takes(level.size) {
            return self.relax_level(level);
        }
        for sweep in 0..self.plan.settings.relaxation_sweeps {
            self.relax(level, RED, sweep);
            self.relax(level, BLACK, sweep);
        }
    }

    /// All sweeps on a small level.
    fn relax_level(&mut self, level: &Level) {
        let bindings = relax_level::Bindings {
            right_sides: slot::RIGHT_SIDES.read(),
            weights: slot::WEIGHTS.read(),
            red: slot::change(RED).update(),
            black: slot::change(BLACK).update(),
        };
        self.within(level, Over::One, bindings, &self.plan.relax_level(level), NO_VARIANT);
    }

    /// One half-iteration on dV.
    fn relax(&mut self, level: &Level, color: usize, sweep: u32) {
        let bindings = relax::Bindings {
            right_sides: slot::RIGHT_SIDES.read(),
            weights: slot::WEIGHTS.read(),
            other: slot::change(1 - color).read(),
            own: slot::change(color).update(),
        };
        let variant = if sweep == 0 { relax::FIRST } else { NO_VARIANT };
        self.within(level, Over::Half, bindings, &self.plan.relax(level, color), variant);
    }

    /// V + clamp(dV).
    pub(super) fn update(&mut self, level: &Level, constants: &update::Constants) {
        let bindings = update::Bindings {
            red: slot::change(RED).read(),
            black: slot::change(BLACK).read(),
            v: slot::relative_blur(level.index).update(),
        };
        self.within(level, Over::Pixels, bindings, constants, NO_VARIANT);
    }
}
