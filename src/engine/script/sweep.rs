//! The scripts of a focus sweep: what the device does between two steps of the host.

use super::compose::Composer;
use super::outlines::Search;
use super::{CountedPixels, Script};
use crate::engine::arguments::Place;
use crate::engine::plan::{Level, Plan};
use crate::engine::slot::Slot;
use crate::engine::stages::{NO_VARIANT, align, copy, edge, edge_costs, half_pair, prolong, system, update};
use crate::engine::tiles::NeededCells;

fn script(plan: &Plan, level: usize, fill: impl FnOnce(&mut Composer)) -> Script {
    let mut composer = Composer::new(plan, CountedPixels::All);
    (composer.settles, composer.place) = (false, Place::level(level));
    fill(&mut composer);
    composer.finish(0)
}

/// The upload of `frames` frames. The first part chooses the unit of intensities by the photograph in the buffer, which
/// is to be the reference. Then there is a part for each frame: from the photograph in the buffer, all levels of a layer
/// of the pyramid.
pub(crate) fn upload(plan: &Plan, frames: u32) -> Script {
    script(plan, 0, |s| {
        s.unit([0; 2]);
        for layer in 0..frames {
            s.next_part();
            s.luminance(0, false);
            let [width, height] = plan.size;
            let bindings = copy::Bindings {
                from: Slot::Luminance { image: 0, level: 0 }.read(),
                to: Slot::Frames { level: 0 }.write(),
            };
            s.over(plan.size, bindings, &copy::Constants { width, height, layer }, NO_VARIANT);
            for (parent, level) in plan.pyramid.iter().zip(&plan.pyramid[1..]) {
                let layers = [parent, level].map(|level| (Slot::Frames { level: level.index }, layer));
                s.halve(layers, parent.size);
            }
        }
    })
}

impl Composer<'_> {
    /// Resamples a frame onto the reference's pixels of a level.
    fn aligned(&mut self, level: &Level, frame: u32, constants: &align::Constants, (to, layer): (Slot, u32)) {
        self.spline(level, (Slot::Frames { level: level.index }, frame), (Slot::Spline2, 0));
        let bindings = align::Bindings { aligned: to.write(), ..align::Bindings::on(level.index) };
        self.over(level.size, bindings, &align::Constants { layer, ..*constants }, NO_VARIANT);
    }
}

/// Resamples frames onto the reference's pixels of a level, and band-passes them.
pub(crate) fn align(plan: &Plan, level: &Level, frames: &[(u32, align::Constants)]) -> Script {
    script(plan, level.index, |s| {
        for (frame, constants) in frames {
            let [low, along_x, along_y] = plan.band;
            let [resampled, filtered] = [0, 1].map(|layer| (Slot::Scratch, layer));
            let to = (Slot::Aligned, *frame);
            s.aligned(level, *frame, constants, resampled);
            s.separable([resampled, filtered], level.size, [low; 2]);
            s.separable([resampled, to], level.size, [low; 2]);
            s.add_separable([filtered, to], level.size, [along_x, along_y]);
        }
    })
}

/// Prolongs u of the coarser level.
pub(crate) fn prolong(plan: &Plan, level: &Level, limit: f32) -> Script {
    script(plan, level.index, |s| {
        let [width, height] = level.size;
        let coarse = Slot::RelativeBlur { level: level.index + 1 }.read();
        let bindings = prolong::Bindings { coarse, fine: Slot::RelativeBlur { level: level.index }.write() };
        s.over(level.size, bindings, &prolong::Constants { width, height, limit, gain: 1.0 }, NO_VARIANT);
    })
}

/// The pairs in which one frame is the sharper.
pub(crate) struct HalfPairs {
    pub(crate) sharper: u32,
    /// The other frames.
    pub(crate) others: Vec<half_pair::Constants>,
    /// The same pairs once more, for the step of parallax; none without it.
    pub(crate) of_parallax: Vec<half_pair::Constants>,
    /// The cells where the frame can be the sharper.
    pub(crate) needed: NeededCells,
}

/// Whether T and c of the frames step, or are held.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum RegistrationStep {
    Free,
    Held,
}

/// Sums the linear systems of all pairs, with one blur stack at a time.
pub(crate) fn half_pairs(plan: &Plan, level: &Level, frames: &[HalfPairs], registration: RegistrationStep) -> Script {
    script(plan, level.index, |s| {
        s.empty(Slot::NormalEquations, level.size, 0..half_pair::LAYERS);
        // Pixels beyond the listed tiles are read with little weight, but must be numbers, and the same each time.
        s.empty(Slot::Stacks, plan.size, 0..plan.layers_of(&plan.pyramid[0]));
        s.empty(Slot::Scratch, plan.size, 0..1);
        let variant = half_pair::variant(plan.slopes(), registration == RegistrationStep::Held, plan.projective());
        for HalfPairs { sharper, others, of_parallax, needed } in frames {
            s.want(needed.clone());
            let Some((listed, grid)) = s.list(half_pair::TILE, 0) else { continue };
            s.spline(level, (Slot::Aligned, *sharper), (Slot::Stacks, 0));
            for layer in 1..plan.layers_of(level) {
                s.stack_layer(level, 0..1, layer);
            }
            for constants in others.iter().chain(of_parallax) {
                let bindings = half_pair::Bindings::on(level.index);
                s.dispatch(bindings, &half_pair::Constants { listed, ..*constants }, variant, grid);
            }
        }
    })
}

/// Steps u by the linear system of all pairs, averaged over a window.
pub(crate) fn step(plan: &Plan, level: &Level, constants: &system::Constants, update: &update::Constants) -> Script {
    script(plan, level.index, |s| {
        s.system(level, constants, system::SWEEP);
        s.relaxation(level, update);
    })
}

/// What the search for outlines of u needs on a level.
pub(crate) struct Outlines<'a> {
    pub(crate) level: &'a Level,
    pub(crate) search: Search,
    /// The frames used.
    pub(crate) frames: Vec<(u32, align::Constants)>,
    /// The pairs of them that can show an edge.
    pub(crate) pairs: Vec<edge_costs::Constants>,
}

/// Begins the search for outlines: copies the standard deviation of u, which is in the place of u, into the results.
pub(crate) fn begin_outlines(plan: &Plan) -> Script {
    script(plan, 0, |s| {
        let (from, to) = (Slot::RelativeBlur { level: 0 }.read(), Slot::Stacks.write());
        let [width, height] = plan.size;
        // Only these are read before they are written: V of the results, and the sides.
        for layer in [0, edge::SIDES as u32] {
            s.empty(Slot::Stacks, plan.size, layer..layer + 1);
        }
        s.over(plan.size, copy::Bindings { from, to }, &copy::Constants { width, height, layer: 1 }, NO_VARIANT);
    })
}

/// Moves the outlines of u on a level.
pub(crate) fn outlines(plan: &Plan, Outlines { level, search, frames, pairs }: &Outlines) -> Script {
    script(plan, level.index, |s| {
        let [first, last] = [edge::COSTS, edge::REVERSED_COSTS].map(|n| n as u32);
        s.empty(Slot::Stacks, level.size, first..last + 1);
        s.outlines(level, search, |s, cells| {
            // Parallax follows u, which is on the level by now.
            for (frame, constants) in frames {
                s.aligned(level, *frame, constants, (Slot::Aligned, *frame));
            }
            for constants in pairs {
                s.edge_costs(level, [Slot::Aligned.read(); 2], constants, edge_costs::SWEEP, cells);
            }
        });
    })
}
