//! Focus sweeps: what is done on the device between two questions of the host.

use super::Script;
use super::compose::Composer;
use crate::base::color::LUMINANCE;
use crate::engine::plan::{Level, Plan};
use crate::engine::slot::{self, Slot};
use crate::engine::stages::{NO_VARIANT, align, copy, half_pair, prolong, system, update};
use crate::engine::tiles::DeviceRequirements;

fn script(plan: &Plan, fill: impl FnOnce(&mut Composer)) -> Script {
    let mut composer = Composer::new(plan, false);
    composer.settles = false;
    fill(&mut composer);
    composer.finish(0)
}

/// The photograph in the first buffer as frame n, on all levels.
pub(crate) fn bring_up(plan: &Plan, n: u32) -> Script {
    script(plan, |s| {
        s.ingest(0, LUMINANCE);
        let [width, height] = plan.size;
        let bindings = copy::Bindings { from: slot::luminance(0, 0).read(), to: slot::frames(0).write() };
        s.over(plan.size, bindings, &copy::Constants { width, height, layer: n }, NO_VARIANT);
        for (parent, level) in plan.pyramid.iter().zip(&plan.pyramid[1..]) {
            let layers = [parent, level].map(|level| (slot::frames(level.index), n));
            s.separable(layers, parent.size, [plan.halve; 2], 2, false);
        }
    })
}

/// Frames on the reference's pixels of a level, where the constants put them, filtered.
pub(crate) fn align(plan: &Plan, level: &Level, frames: &[(u32, align::Constants)]) -> Script {
    script(plan, |s| {
        for (frame, constants) in frames {
            s.spline(level, (slot::frames(level.index), *frame), (slot::SPLINE2.plane(), 0));
            let bindings = align::Bindings { spline: slot::SPLINE2.plane().read(), aligned: slot::ALIGNED.write() };
            s.over(level.size, bindings, constants, NO_VARIANT);
            let [low, along_x, along_y] = plan.band;
            let layers = [(slot::ALIGNED, *frame); 2];
            s.separable(layers, level.size, [low; 2], 1, false);
            s.separable(layers, level.size, [along_x, along_y], 1, true);
        }
    })
}

/// u of a level from the coarser one.
pub(crate) fn prolong(plan: &Plan, level: &Level, limit: f32) -> Script {
    script(plan, |s| {
        let [width, height] = level.size;
        let coarse = slot::relative_blur(level.index + 1).read();
        let bindings = prolong::Bindings { coarse, fine: slot::relative_blur(level.index).write() };
        s.over(level.size, bindings, &prolong::Constants { width, height, limit, gain: 1.0 }, NO_VARIANT);
    })
}

/// A frame of a sweep, and those that it is compared with.
pub(crate) struct Beside {
    pub(crate) frame: u32,
    pub(crate) others: Vec<half_pair::Constants>,
    /// Where it is to be the sharper.
    pub(crate) wanted: DeviceRequirements,
}

/// What pairs say, by the sharper frame of each: one stack at a time.
pub(crate) fn half_pairs(plan: &Plan, level: &Level, frames: &[Beside], stays: bool) -> Script {
    script(plan, |s| {
        s.empty(Slot::NormalEquations, level.size);
        // What lies beyond the tiles that are wanted is read, and hardly counts; but it must be a number, and the same each time.
        s.empty(Slot::Stacks, plan.size);
        s.empty(Slot::Scratch, plan.size);
        let variant = half_pair::variant(plan.slopes(), stays, plan.projective());
        for Beside { frame, others, wanted } in frames {
            s.want(wanted.clone());
            let Some((listed, grid)) = s.list(half_pair::TILE, 0) else { continue };
            s.spline(level, (slot::ALIGNED, *frame), (slot::STACKS.plane(), 0));
            for layer in 1..plan.layers_of(level) {
                s.stack_layer(level, 0, layer);
            }
            for constants in others {
                let bindings = half_pair::Bindings {
                    focus: slot::relative_blur(level.index).read(),
                    stacks: slot::STACKS.read(),
                    aligned: slot::ALIGNED.read(),
                    equations: slot::NORMAL_EQUATIONS.update(),
                    partials: slot::PARTIALS.write(),
                    tiles: slot::TILES.read(),
                    hidden: slot::HIDDEN.read(),
                };
                s.dispatch(bindings, &half_pair::Constants { listed, ..*constants }, variant, grid);
            }
        }
    })
}

/// A step of u, by what pairs say over a window.
pub(crate) fn step(plan: &Plan, level: &Level, constants: &system::Constants, update: &update::Constants) -> Script {
    script(plan, |s| {
        s.system(level, constants, system::SWEEP);
        s.relaxation(level);
        s.update(level, update);
    })
}
