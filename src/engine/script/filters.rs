//! The passes that filter: the pyramid and the blur stacks.

use std::ops::Range;

use super::compose::Composer;
use crate::engine::arguments::{Grid, Over, Place};
use crate::engine::plan::{FilterRange, Level, SCRATCH_LAYERS, StackLayer, takes_both_axes};
use crate::engine::slot::{self, Handle, Plane};
use crate::engine::stages::stack::Sampling;
use crate::engine::stages::{NO_VARIANT, apply_shading, convolve, separable, subdivide, warp};

/// A layer of an image.
type Layer = (Handle<Plane>, u32);

/// Layers of an image that are filtered at once, each as the others.
#[derive(Clone, Copy)]
pub(super) struct Layers {
    pub(super) image: Handle<Plane>,
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
    Layers { count, ..(slot::SCRATCH, 0).into() }
}

/// Pixels around the wanted tiles for which a blur stack is computed: 4½ σ of the widest blur that a sweep compares.
/// Pixels beyond weigh less than 1e-5.
const REACH: u32 = 16;

/// The axis of a filter.
struct Axis {
    /// Pixels along the axis, before the filter.
    length: u32,
    /// Pixels across it.
    breadth: u32,
    /// 1, or 2 to halve.
    stride: u32,
    /// Pixels after which the mirrored image repeats.
    period: u32,
    /// Along y instead of x.
    vertical: bool,
    /// Pixels of the level from one filtered pixel to the next, along the axis and across it.
    spacing: [u32; 2],
}

impl Composer<'_> {
    /// The pyramid of an image and of its mask: each level halves the one below.
    pub(super) fn pyramid(&mut self, image: usize) {
        let plan = self.plan;
        for (parent, level) in plan.pyramid.iter().zip(&plan.pyramid[1..]) {
            self.place = Place::level(level.index);
            let images = [parent, level].map(|level| (slot::luminance(image, level.index), 0));
            self.separable(images, parent.size, [plan.halve; 2], 2, false);
            if self.masked {
                let masks = [parent, level].map(|level| (slot::masks(level.index).plane(), image as u32));
                self.separable(masks, parent.size, [plan.halve; 2], 2, false);
            }
        }
    }

    /// The first layers of a level's blur stacks: the spline coefficients of the photographs.
    pub(super) fn stack_starts(&mut self, level: &Level) {
        if self.plan.warps(level) {
            self.spline2(level);
        }
        let shaded = self.shaded(level);
        if self.plan.joins_photographs(level) {
            return self.both_splines(level, shaded);
        }
        self.spline(level, (slot::luminance(0, level.index), 0), (slot::STACKS.plane(), 0));
        self.spline(level, shaded, (slot::STACKS.plane(), self.plan.second_stack(level)));
    }

    /// I2 with its shading applied, on levels where it is warped on I1's pixels, in the scratch image.
    fn shaded(&mut self, level: &Level) -> Layer {
        let to = (slot::SCRATCH, 1);
        if self.plan.warps(level) {
            self.warp(level, to)
        } else {
            self.apply_shading(level, to)
        }
        to
    }

    /// Spline coefficients of I1 and of the shaded I2, in one dispatch.
    fn both_splines(&mut self, level: &Level, shaded: Layer) {
        let (periods, first) = (level.size.map(|side| 2 * (side - 1)), slot::luminance(0, level.index));
        let from = Layers { step: shaded.1, count: 2, ..(first, 0).into() };
        let to = self.stacks(level, 0..2, 0);
        self.both_axes([from, to], Some(shaded.0), level.size, [self.plan.prefilter; 2], 1, periods, 1);
    }

    /// Layer n of the level's blur stacks of some images. A single one is not packed.
    pub(super) fn stacks(&self, level: &Level, images: Range<usize>, n: u32) -> Layers {
        let (count, step) = (images.len() as u32, self.plan.second_stack(level));
        let first = images.start as u32 * step + n;
        Layers { image: slot::STACKS.plane(), first, step, count, is_packed: count == 2 && self.plan.packs(level) }
    }

    /// A layer n > 0 of the level's blur stacks of some images: a filter of an earlier layer. Returns the number of
    /// separable filters.
    pub(super) fn stack_layer(&mut self, level: &Level, images: Range<usize>, n: u32) -> u64 {
        let (plan, to) = (self.plan, self.stacks(level, images, n));
        let layer = |k: u32| Layers { first: to.first + k - n, ..to };
        let StackLayer { from, sampling, terms } = &plan.layers[n as usize - 1];
        if *sampling != Sampling::Every {
            let first = *sampling == Sampling::Halving;
            if plan.halves_by_both_axes(level) {
                debug_assert!(first || *from == n - 1, "half-size layers follow each other");
                let last = Layers { is_packed: to.is_packed, ..scratch(to.count) };
                let half = if n + 1 < plan.layers_of(level) { layer(n + 1) } else { last };
                // The half-size layer before is in this layer's place.
                self.half_by_both_axes(level, [if first { layer(*from) } else { to }, half], first, terms[0]);
                self.subdivide(level, half, to);
            } else {
                self.half_layer(level, [layer(*from), to], first, terms[0]);
                self.subdivide(level, scratch(to.count), to);
            }
            return u64::from(to.count);
        }
        for (add, &term) in terms.iter().enumerate() {
            self.separable([layer(*from), to], level.size, term, 1, add > 0);
        }
        u64::from(to.count) * terms.len() as u64
    }

    /// Spline coefficients of I2.
    pub(super) fn spline2(&mut self, level: &Level) {
        self.spline(level, (slot::luminance(1, level.index), 0), (slot::SPLINE2.plane(), 0));
    }

    /// I2 with its shading applied, into a layer.
    fn apply_shading(&mut self, level: &Level, to: Layer) {
        let bindings = apply_shading::Bindings {
            from: slot::i2(level.index).read(),
            to: to.0.write(),
            state: slot::STATE.update(),
        };
        let ([width, height], centre) = (level.size, level.centre.map(|c| c as f32));
        self.over(level.size, bindings, &apply_shading::Constants { width, height, layer: to.1, centre }, NO_VARIANT);
    }

    /// Spline coefficients of an image.
    pub(super) fn spline(&mut self, level: &Level, from: Layer, to: Layer) {
        self.separable([from, to], level.size, [self.plan.prefilter; 2], 1, false);
    }

    /// The mean over the window around each pixel of an image's first `count` layers, in place.
    pub(super) fn smooth(&mut self, image: Handle<Plane>, count: u32, size: [u32; 2]) {
        for first in (0..count).step_by(SCRATCH_LAYERS as usize) {
            self.smooth_layers(Layers { count: SCRATCH_LAYERS.min(count - first), ..(image, first).into() }, size);
        }
    }

    /// The same of some layers, at most as many as the scratch image has.
    pub(super) fn smooth_layers(&mut self, layers: impl Into<Layers>, size: [u32; 2]) {
        let layers = layers.into();
        self.separable([layers; 2], size, [self.plan.window; 2], 1, false);
    }

    /// I2 with its shading applied, on I1's pixels, into a layer.
    fn warp(&mut self, level: &Level, to: Layer) {
        let bindings = warp::Bindings { spline2: slot::SPLINE2.read(), to: to.0.write(), state: slot::STATE.update() };
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
            self.spline(level, shaded, (slot::STACKS.plane(), self.plan.second_stack(level)));
            1..2
        };
        for layer in 1..self.plan.layers_of(level) {
            self.stack_layer(level, images.clone(), layer);
        }
        if self.plan.finds_shape(level) {
            self.shape(level, images);
        }
        self.warping_again = None;
    }

    /// A grid of workgroups; while I2 is warped again, one that has none unless T has moved.
    pub(super) fn grid(&mut self, groups: [u32; 3]) -> Grid {
        let Some(level) = self.warping_again else { return Grid::Direct(groups) };
        let warps = &mut self.warps[level];
        warps.push(groups);
        Grid::IfMoved { level, n: warps.len() - 1 }
    }

    /// Layers on every other pixel.
    ///
    /// A half-size layer is in the corner of the scratch image, which holds the layer before unless this is the
    /// first. The layer's own place holds the result of the first direction in between.
    fn half_layer(
        &mut self,
        level: &Level,
        [from, layers]: [Layers; 2],
        first: bool,
        [along_x, along_y]: [FilterRange; 2],
    ) {
        let ([width, height], [half_width, half_height]) = (level.size, level.size.map(|side| side.div_ceil(2)));
        let (stride, period) = if first { (2, 2) } else { (1, 1) };
        let [length, breadth] = if first { [width, height] } else { [half_width, half_height] };
        let spacing = if first { [1, 1] } else { [2, 2] };
        let x = Axis { length, breadth, stride, period: period * (width - 1), vertical: false, spacing };
        let length = if first { height } else { half_height };
        let spacing = if first { [1, 2] } else { [2, 2] };
        let y = Axis { length, breadth: half_width, stride, period: period * (height - 1), vertical: true, spacing };
        let half = scratch(layers.count);
        self.convolve([if first { from } else { half }, layers], &x, along_x, false);
        self.convolve([layers, half], &y, along_y, false);
    }

    /// A half-size layer, from the full-size one or from the half-size one before.
    ///
    /// It is in the corner of the layer that comes next, which is not computed yet, or of the scratch image.
    fn half_by_both_axes(&mut self, level: &Level, layers: [Layers; 2], first: bool, filters: [FilterRange; 2]) {
        let periods = level.size.map(|side| side - 1);
        match first {
            true => self.both_axes(layers, None, level.size, filters, 2, periods.map(|period| 2 * period), 1),
            false => self.both_axes(layers, None, level.size.map(|side| side.div_ceil(2)), filters, 1, periods, 2),
        }
    }

    /// Layers on every pixel from half-size ones.
    fn subdivide(&mut self, level: &Level, from: Layers, to: Layers) {
        let [width, height] = level.size;
        let tile = subdivide::STAGE.workgroup.map(|side| 2 * side);
        let groups = subdivide::groups(level.size.map(|side| side.div_ceil(2)), to.groups());
        let (grid, list) = self.extent(tile, groups);
        let bindings = subdivide::Bindings {
            coarse: from.image.words().read(),
            fine: slot::STACKS.write(),
            tiles: slot::TILES.read(),
        };
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

    /// A filter along x, then one along y: in one dispatch where that is faster and possible, else by way of the
    /// scratch image. The results replace the target layers or are added to them.
    pub(super) fn separable(
        &mut self,
        layers: [impl Into<Layers>; 2],
        size @ [width, height]: [u32; 2],
        filters @ [along_x, along_y]: [FilterRange; 2],
        stride: u32,
        add: bool,
    ) {
        let (spacing, periods) = ([1, 1], size.map(|side| 2 * (side - 1)));
        let x = Axis { length: width, breadth: height, stride, period: 2 * (width - 1), vertical: false, spacing };
        let breadth = width.div_ceil(stride);
        let y = Axis { length: height, breadth, stride, period: 2 * (height - 1), vertical: true, spacing };
        let [from, to] = layers.map(Into::into);
        let in_place = from.image.slot() == to.image.slot() && from.first == to.first;
        if self.plan.for_gpu && !add && !in_place && takes_both_axes(size, filters, periods) {
            return self.both_axes([from, to], None, size, filters, stride, periods, 1);
        }
        self.convolve([from, scratch(from.count)], &x, along_x, false);
        self.convolve([scratch(from.count), to], &y, along_y, add);
    }

    /// Filters along x and along y in one dispatch, from layers to others. `spacing`: pixels of the level from one
    /// filtered pixel to the next. `second`: the image of the second layer, if it is another than that of the first.
    #[allow(clippy::too_many_arguments)]
    fn both_axes(
        &mut self,
        [from, to]: [Layers; 2],
        second: Option<Handle<Plane>>,
        size @ [width, height]: [u32; 2],
        filters: [FilterRange; 2],
        stride: u32,
        periods: [u32; 2],
        spacing: u32,
    ) {
        debug_assert!(self.unsettled.is_none(), "its grid is not that of a level");
        let radii = filters.map(|filter| filter.radius);
        let long = separable::is_long(radii);
        let tile = separable::tile(stride, long).map(|side| side * stride * spacing);
        let (grid, list) = self.extent(tile, separable::groups(size, stride, long, to.groups()));
        let constants = separable::Constants {
            width,
            height,
            from_layer: from.first,
            to_layer: to.first,
            from_step: from.step,
            to_step: to.step,
            planes: from.count,
            offsets: filters.map(|filter| filter.offset),
            radii,
            periods,
            listed: list.unwrap_or(0),
            blocks: filters.map(|filter| filter.blocks),
        };
        let bindings = separable::Bindings {
            from: from.image.words().read(),
            second: second.unwrap_or(from.image).words().read(),
            to: to.image.words().write(),
            filters: slot::filters(filters[0].bank).read(),
            tiles: slot::TILES.read(),
            state: slot::STATE.read(),
        };
        let variant = separable::variant(stride, [long, list.is_some(), second.is_some(), to.is_packed]);
        self.dispatch(bindings, &constants, variant, grid);
    }

    /// A filter along one axis.
    fn convolve(
        &mut self,
        [from, to]: [Layers; 2],
        &Axis { length, breadth, stride, period, vertical, spacing: [along, across] }: &Axis,
        FilterRange { bank, offset, blocks, radius }: FilterRange,
        add: bool,
    ) {
        let [width, height] = convolve::tile(vertical);
        let tile = if vertical { [across * width, along * height] } else { [along * width, across * height] };
        let constants = convolve::Constants {
            length,
            breadth,
            from_layer: from.first,
            to_layer: to.first,
            from_step: from.step,
            to_step: to.step,
            planes: from.count,
            offset,
            blocks,
            radius,
            add: u32::from(add),
            period: period.max(1),
            listed: 0,
        };
        let (grid, list) = self.extent(tile, convolve::groups([length, breadth], vertical, from.count));
        let over = if vertical { Over::AlongY } else { Over::AlongX };
        let grid = self.unsettled.map_or(grid, |level| Grid::Level { level, over });
        let constants = convolve::Constants { listed: list.unwrap_or(0), ..constants };
        let variant = convolve::variant(&constants, vertical, stride, list.is_some());
        let bindings = convolve::Bindings {
            from: from.image.read(),
            to: to.image.update(),
            filters: slot::filters(bank).read(),
            tiles: slot::TILES.read(),
        };
        self.dispatch(bindings, &constants, variant, grid);
    }
}
