//! The passes that filter: the pyramid and the blur stacks.

use std::ops::Range;

use super::StackKernel;
use super::compose::Composer;
use crate::engine::arguments::{Grid, Indirect, Place};
use crate::engine::plan::{FilterRange, Level, StackLayer};
use crate::engine::shaders::separable::CHUNK;
use crate::engine::slot::Slot;
use crate::engine::stages::stack::Sampling;
use crate::engine::stages::{NO_VARIANT, apply_shading, separable, subdivide, warp};

/// A layer of an image.
type Layer = (Slot, u32);

/// Layers of an image that are filtered at once, each as the others.
#[derive(Clone, Copy)]
pub(super) struct Layers {
    pub(super) image: Slot,
    pub(super) first: u32,
    /// From a layer to the next.
    pub(super) step: u32,
    pub(super) count: u32,
    /// Whether they are of both photographs, packed.
    pub(super) is_packed: bool,
}

impl Layers {
    /// Workgroups along z of a pass over them: one for each, or one for both photographs if they are packed.
    pub(super) fn groups(self) -> u32 {
        if self.is_packed { 1 } else { self.count }
    }
}

impl From<Layer> for Layers {
    fn from((image, first): Layer) -> Self {
        Self { image, first, step: 1, count: 1, is_packed: false }
    }
}

/// The targets of the first direction of a separable filter of `count` layers.
fn scratch(count: u32) -> Layers {
    Layers { count, ..(Slot::Scratch, 0).into() }
}

/// Pixels around the wanted tiles for which a blur stack is computed: 4½ σ of the widest blur that a sweep compares.
/// Pixels beyond weigh less than 1e-5.
const REACH: u32 = 16;

/// A filter along x and one along y of an image.
struct Filters {
    /// Width and height before the filters.
    size: [u32; 2],
    /// The filters along x and along y.
    along: [FilterRange; 2],
    /// 1, or 2 to halve.
    stride: u32,
    /// Pixels after which the mirrored image repeats, along x and along y.
    periods: [u32; 2],
    /// Pixels of the level from one filtered pixel to the next.
    spacing: u32,
    /// Whether the results are added to the target.
    adds: bool,
}

impl Filters {
    /// Filters on every pixel of an image of a size.
    fn on(size: [u32; 2], along: [FilterRange; 2]) -> Self {
        Self { size, along, stride: 1, periods: size.map(|side| 2 * (side - 1)), spacing: 1, adds: false }
    }
}

impl Composer<'_> {
    /// The pyramid of an image and of its mask: each level halves the one below.
    pub(super) fn pyramid(&mut self, image: usize) {
        let plan = self.plan;
        for (parent, level) in plan.pyramid.iter().zip(&plan.pyramid[1..]) {
            self.place = Place::level(level.index);
            let images = [parent, level].map(|level| (Slot::Luminance { image, level: level.index }, 0));
            self.halve(images, parent.size);
            if self.masked {
                let masks = [parent, level].map(|level| (Slot::Masks { level: level.index }, image as u32));
                self.halve(masks, parent.size);
            }
        }
    }

    /// The first layers of a level's blur stacks: the spline coefficients of the photographs.
    pub(super) fn stack_starts(&mut self, level: &Level) {
        if self.plan.warps(level) {
            self.spline2(level);
        }
        let shaded = self.shaded(level);
        self.both_splines(level, shaded);
    }

    /// I2 with its shading applied, on levels where it is warped on I1's pixels, in the scratch image.
    fn shaded(&mut self, level: &Level) -> Layer {
        let to = (Slot::Scratch, 1);
        if self.plan.warps(level) {
            self.warp(level, to)
        } else {
            self.apply_shading(level, to)
        }
        to
    }

    /// Spline coefficients of I1 and of the shaded I2, in one dispatch.
    fn both_splines(&mut self, level: &Level, shaded: Layer) {
        let from = Layers { step: shaded.1, count: 2, ..(Slot::Luminance { image: 0, level: level.index }, 0).into() };
        let to = self.stacks(level, 0..2, 0);
        self.filter([from, to], Some(shaded.0), &Filters::on(level.size, [self.plan.prefilter; 2]));
    }

    /// Layer n of the level's blur stacks of some images. A single one is not packed.
    pub(super) fn stacks(&self, level: &Level, images: Range<usize>, n: u32) -> Layers {
        let (count, step) = (images.len() as u32, self.plan.second_stack(level));
        let first = images.start as u32 * step + n;
        Layers { image: Slot::Stacks, first, step, count, is_packed: count == 2 && self.plan.packs(level) }
    }

    /// A layer n > 0 of the level's blur stacks of some images: a filter of an earlier layer. Returns the number of
    /// separable filters.
    pub(super) fn stack_layer(&mut self, level: &Level, images: Range<usize>, n: u32) -> u64 {
        let (plan, to) = (self.plan, self.stacks(level, images, n));
        let layer = |k: u32| Layers { first: to.first + k - n, ..to };
        let StackLayer { from, sampling, terms } = &plan.layers[n as usize - 1];
        if *sampling != Sampling::Every {
            let first = *sampling == Sampling::Halving;
            debug_assert!(first || *from == n - 1, "half-size layers follow each other");
            let last = Layers { is_packed: to.is_packed, ..scratch(to.count) };
            let half = if n + 1 < plan.layers_of(level) { layer(n + 1) } else { last };
            // The half-size layer before is in this layer's place.
            self.half_layer(level, [if first { layer(*from) } else { to }, half], *sampling, terms[0]);
            self.subdivide(level, half, to);
            return u64::from(to.count);
        }
        for (add, &term) in terms.iter().enumerate() {
            self.filter([layer(*from), to], None, &Filters { adds: add > 0, ..Filters::on(level.size, term) });
        }
        u64::from(to.count) * terms.len() as u64
    }

    /// Spline coefficients of I2.
    pub(super) fn spline2(&mut self, level: &Level) {
        self.spline(level, (Slot::Luminance { image: 1, level: level.index }, 0), (Slot::Spline2, 0));
    }

    /// I2 with its shading applied, into a layer.
    fn apply_shading(&mut self, level: &Level, to: Layer) {
        let (from, named) =
            (Slot::Luminance { image: 1, level: level.index }.read(), apply_shading::Bindings::on(level.index));
        let bindings = apply_shading::Bindings { from, to: to.0.write(), ..named };
        let ([width, height], centre) = (level.size, level.centre.map(|c| c as f32));
        self.over(level.size, bindings, &apply_shading::Constants { width, height, layer: to.1, centre }, NO_VARIANT);
    }

    /// Spline coefficients of an image.
    pub(super) fn spline(&mut self, level: &Level, from: Layer, to: Layer) {
        self.separable([from, to], level.size, [self.plan.prefilter; 2]);
    }

    /// The mean over the window around each pixel.
    pub(super) fn smooth(&mut self, layers: [Layer; 2], size: [u32; 2]) {
        self.separable(layers, size, [self.plan.window; 2]);
    }

    /// Halves an image of a size.
    pub(super) fn halve(&mut self, layers: [Layer; 2], size: [u32; 2]) {
        let filters = Filters { stride: 2, ..Filters::on(size, [self.plan.halve; 2]) };
        self.filter(layers.map(Into::into), None, &filters);
    }

    /// A filter along x and one along y, of one layer into another.
    pub(super) fn separable(&mut self, layers: [Layer; 2], size: [u32; 2], along: [FilterRange; 2]) {
        self.filter(layers.map(Into::into), None, &Filters::on(size, along));
    }

    /// Adds the results of a filter along x and one along y to another layer.
    pub(super) fn add_separable(&mut self, layers: [Layer; 2], size: [u32; 2], along: [FilterRange; 2]) {
        self.filter(layers.map(Into::into), None, &Filters { adds: true, ..Filters::on(size, along) });
    }

    /// I2 with its shading applied, on I1's pixels, into a layer.
    fn warp(&mut self, level: &Level, to: Layer) {
        let bindings = warp::Bindings { to: to.0.write(), ..warp::Bindings::on(level.index) };
        let grid = self.grid(warp::tiles(level.size));
        let ([width, height], centre) = (level.size, level.centre.map(|c| c as f32));
        let constants = warp::Constants { width, height, layer: to.1, factor: level.factor as f32, centre };
        self.dispatch(bindings, &constants, NO_VARIANT, grid);
    }

    /// Warps I2 again and computes its blur stack, if T or the shading has changed. If it is packed, that of I1 too,
    /// which stays as it was: to keep its half of each texel would take as long.
    pub(super) fn warp_again(&mut self, level: &Level) {
        self.warping_again = Some(level.index);
        self.warps[level.index].clear();
        let shaded = self.shaded(level);
        let images = if self.plan.packs(level) {
            self.both_splines(level, shaded);
            0..2
        } else {
            self.spline(level, shaded, (Slot::Stacks, self.plan.second_stack(level)));
            1..2
        };
        for layer in 1..self.plan.layers_of(level) {
            self.stack_layer(level, images.clone(), layer);
        }
        if self.plan.finds_lens(level) {
            self.shape(level, images, StackKernel::Gaussian);
        }
        self.warping_again = None;
    }

    /// A grid of workgroups; while I2 is warped again, one that has none unless T has moved.
    pub(super) fn grid(&mut self, groups: [u32; 3]) -> Grid {
        let Some(level) = self.warping_again else { return Grid::Direct(groups) };
        let warps = &mut self.warps[level];
        warps.push(groups);
        Grid::Indirect(Indirect::IfMoved { level, n: warps.len() - 1 })
    }

    /// A half-size layer, from the full-size one or from the half-size one before.
    ///
    /// It is in the corner of the layer that comes next, which is not computed yet, or of the scratch image.
    fn half_layer(&mut self, level: &Level, layers: [Layers; 2], sampling: Sampling, along: [FilterRange; 2]) {
        let halves = Filters { stride: 2, ..Filters::on(level.size, along) };
        let filters = match sampling {
            Sampling::Half => Filters {
                size: level.size.map(|side| side.div_ceil(2)),
                stride: 1,
                periods: level.size.map(|side| side - 1),
                spacing: 2,
                ..halves
            },
            _ => halves,
        };
        self.filter(layers, None, &filters);
    }

    /// Layers on every pixel from half-size ones.
    fn subdivide(&mut self, level: &Level, from: Layers, to: Layers) {
        let [width, height] = level.size;
        let tile = subdivide::STAGE.workgroup.map(|side| 2 * side);
        let groups = subdivide::groups(level.size.map(|side| side.div_ceil(2)), to.groups());
        let (grid, list) = self.extent(tile, groups);
        let (coarse, fine) = (from.image.read(), Slot::Stacks.write());
        let bindings = subdivide::Bindings { coarse, fine, ..subdivide::Bindings::on(level.index) };
        let (from_layer, from_step, listed) = (from.first, from.step, list.unwrap_or(0));
        let Layers { first: layer, step, count: planes, .. } = to;
        let constants = subdivide::Constants { width, height, from_layer, from_step, layer, step, planes, listed };
        self.dispatch(bindings, &constants, subdivide::variant(list.is_some(), to.is_packed), grid);
    }

    /// The grid of a filter: over the listed tiles of a size, with the first entry of their list, or `groups`
    /// workgroups for all. Tiles are listed for single layers only.
    fn extent(&mut self, tile: [u32; 2], groups: [u32; 3]) -> (Grid, Option<u32>) {
        match self.list(tile, REACH) {
            Some((first, grid)) => (grid, Some(first)),
            None => (self.grid(groups), None),
        }
    }

    /// Filters along x and along y in one dispatch, from layers to others. `second`: the image of the second layer, if it
    /// is another than that of the first.
    fn filter(&mut self, [from, to]: [Layers; 2], second: Option<Slot>, filters: &Filters) {
        let &Filters { size: size @ [width, height], along, stride, periods, spacing, adds } = filters;
        debug_assert!(along[0].bank == along[1].bank, "a dispatch binds one bank");
        debug_assert!(from.image != to.image || from.first != to.first, "it does not work in place");
        let radii = along.map(|filter| filter.radius);
        let any = adds || separable::is_any(size, radii, periods);
        debug_assert!(!to.is_packed || along.iter().all(|filter| filter.blocks <= CHUNK), "one chunk of weights");
        let tile = separable::tile(stride, any).map(|side| side * stride * spacing);
        let (grid, list) = self.extent(tile, separable::groups(size, stride, any, to.groups()));
        let constants = separable::Constants {
            width,
            height,
            from_layer: from.first,
            to_layer: to.first,
            from_step: from.step,
            to_step: to.step,
            planes: from.count,
            offsets: along.map(|filter| filter.offset),
            radii,
            periods: periods.map(|period| period.max(1)),
            listed: list.unwrap_or(0),
            blocks: along.map(|filter| filter.blocks),
            add: u32::from(adds),
        };
        let bindings = separable::Bindings {
            from: from.image.read(),
            second: second.unwrap_or(from.image).read(),
            to: to.image.update(),
            filters: Slot::Filters { bank: along[0].bank }.read(),
            ..separable::Bindings::on(0)
        };
        let variant = separable::variant(stride, [any, list.is_some(), second.is_some(), to.is_packed]);
        self.dispatch(bindings, &constants, variant, grid);
    }
}
