//! The pyramid and the stacks of blurred images: the passes that filter.

use std::sync::Arc;

use super::Script;
use crate::base::Error;
use crate::engine::plan::{FilterRange, Level, StackLayer};
use crate::engine::profile::Place;
use crate::engine::stages::{convolve, refine, stack, warp};
use crate::engine::vulkan::{Groups, Image, Resource};
use crate::engine::workspace::Grid;

/// What a filter goes along: pixels along the axis and across it, before the filter, the stride, after how many pixels
/// the mirrored image repeats itself, and 1 for y.
struct Axis {
    length: u32,
    breadth: u32,
    stride: u32,
    period: u32,
    vertical: u32,
}

impl<'a> Script<'a> {
    /// Each level from its parent, both axes halved: an image, and which of its pixels count.
    pub(super) fn pyramid(&mut self, image: usize) -> Result<(), Error> {
        for (parent, level) in self.plan.pyramid.iter().zip(&self.plan.pyramid[1..]) {
            self.place = Place::level(level.index);
            let [from, to] = [parent, level].map(|level| &self.w.levels[level.index]);
            let images = [(&from.images[image], 0), (&to.images[image], 0)];
            let masks = [(&from.masks, image as u32), (&to.masks, image as u32)];
            self.separable(images, parent.size, [self.plan.halve; 2], 2, false)?;
            if self.masked {
                self.separable(masks, parent.size, [self.plan.halve; 2], 2, false)?;
            }
        }
        Ok(())
    }

    /// A layer of a level's stack: the spline coefficients of its image, or a filter of an earlier layer. Says how many
    /// separable filters it took.
    pub(super) fn stack_layer(&mut self, level: &Level, image: usize, layer: u32) -> Result<u64, Error> {
        let w = self.w;
        let base = self.plan.first_layer(image);
        if layer == 0 {
            if image == 1 && self.plan.warps(level) {
                self.spline(level, (&w.levels[level.index].images[1], 0), (&w.spline2, 0))?;
                self.warp(level)?;
                return Ok(2);
            }
            self.spline(level, (&w.levels[level.index].images[image], 0), (&w.stacks, base))?;
            return Ok(1);
        }
        let StackLayer { from, grid, terms } = &self.plan.layers[layer as usize - 1];
        if *grid != stack::Grid::Every {
            self.half_layer(level, [base + from, base + layer], *grid == stack::Grid::Halving, terms[0])?;
            return Ok(1);
        }
        for (n, &term) in terms.iter().enumerate() {
            self.separable([(&w.stacks, base + from), (&w.stacks, base + layer)], level.size, term, 1, n > 0)?;
        }
        Ok(terms.len() as u64)
    }

    /// Coefficients of the spline through an image.
    pub(super) fn spline(
        &mut self,
        level: &Level,
        from: (&Arc<Image>, u32),
        to: (&Arc<Image>, u32),
    ) -> Result<(), Error> {
        self.separable([from, to], level.size, [self.plan.prefilter; 2], 1, false)
    }

    /// The first layer of I2's stack: I2 on I1's pixels. The samples stand in the second until it is made.
    fn warp(&mut self, level: &Level) -> Result<(), Error> {
        let w = self.w;
        let base = self.plan.first_layer(1);
        let constants = warp::Constants {
            width: level.size[0],
            height: level.size[1],
            layer: base + 1,
            factor: level.factor as f32,
            centre: level.centre.map(|c| c as f32),
        };
        let pipeline = &self.pipelines.warp;
        let resources = [Resource::Image(&w.spline2), Resource::Image(&w.stacks), Resource::Buffer(&w.state)];
        let groups = self.groups(pipeline.groups(level.size));
        self.pass(pipeline, &resources, &constants, groups, warp::bytes(&constants))?;
        self.spline(level, (&w.stacks, base + 1), (&w.stacks, base))
    }

    /// I2 on I1's pixels and its whole stack, if T has moved since.
    pub(super) fn warp_anew(&mut self, level: &Level) -> Result<(), Error> {
        self.anew = Some(level.index);
        let place = self.place;
        self.place = place.if_moved();
        self.warps[level.index].clear();
        self.warp(level)?;
        for layer in 1..self.plan.layers_of(level) {
            self.stack_layer(level, 1, layer)?;
        }
        (self.anew, self.place) = (None, place);
        Ok(())
    }

    /// So many workgroups; if need be, only if T has moved.
    fn groups(&mut self, groups: [u32; 3]) -> Groups<'a> {
        let Some(level) = self.anew else { return Groups::Direct(groups) };
        let warps = &mut self.warps[level];
        warps.push(groups);
        Groups::Indirect(&self.w.arguments, Grid::warp_offset(level, warps.len() - 1))
    }

    /// A layer on every other pixel, in the corner of the scratch image, where the one before it is unless this is the
    /// first; then on every pixel in its place, which until then holds what is between the two directions.
    fn half_layer(
        &mut self,
        level: &Level,
        [from, layer]: [u32; 2],
        first: bool,
        [along_x, along_y]: [FilterRange; 2],
    ) -> Result<(), Error> {
        let ([width, height], [half_width, half_height]) = (level.size, level.size.map(|side| side.div_ceil(2)));
        let (stride, period) = if first { (2, 2) } else { (1, 1) };
        let [length, breadth] = if first { [width, height] } else { [half_width, half_height] };
        let x = Axis { length, breadth, stride, period: period * (width - 1), vertical: 0 };
        let length = if first { height } else { half_height };
        let y = Axis { length, breadth: half_width, stride, period: period * (height - 1), vertical: 1 };
        let (scratch, stack) = (&self.w.scratch, &self.w.stacks);
        let source = if first { (stack, from) } else { (scratch, 0) };
        self.convolve([source, (stack, layer)], &x, along_x, false)?;
        self.convolve([(stack, layer), (scratch, 0)], &y, along_y, false)?;
        let constants = refine::Constants { width, height, layer };
        let pipeline = &self.pipelines.refine;
        let resources = [Resource::Image(scratch), Resource::Image(stack)];
        let groups = self.groups(pipeline.groups([half_width, half_height]));
        self.pass(pipeline, &resources, &constants, groups, refine::bytes(&constants))
    }

    /// A filter along x into the scratch image, then one along y, from a layer of an image to one, in its place or added.
    pub(super) fn separable(
        &mut self,
        [from, to]: [(&Arc<Image>, u32); 2],
        [width, height]: [u32; 2],
        [along_x, along_y]: [FilterRange; 2],
        stride: u32,
        add: bool,
    ) -> Result<(), Error> {
        let x = Axis { length: width, breadth: height, stride, period: 2 * (width - 1), vertical: 0 };
        let breadth = width.div_ceil(stride);
        let y = Axis { length: height, breadth, stride, period: 2 * (height - 1), vertical: 1 };
        let scratch = (&self.w.scratch, 0);
        self.convolve([from, scratch], &x, along_x, false)?;
        self.convolve([scratch, to], &y, along_y, add)
    }

    /// A filter along one axis.
    fn convolve(
        &mut self,
        [(from, from_layer), (to, to_layer)]: [(&Arc<Image>, u32); 2],
        &Axis { length, breadth, stride, period, vertical }: &Axis,
        FilterRange { bank, offset, blocks, radius }: FilterRange,
        add: bool,
    ) -> Result<(), Error> {
        let constants = convolve::Constants {
            length,
            breadth,
            stride,
            vertical,
            from_layer,
            to_layer,
            offset,
            blocks,
            radius,
            add: u32::from(add),
            period: period.max(1) as f32,
        };
        let p = self.pipelines;
        let pipeline = if add || blocks > 1 { &p.convolve_long } else { &p.convolve };
        let resources = [Resource::Image(from), Resource::Image(to), Resource::Uniform(&self.w.filters[bank])];
        let groups = self.groups(pipeline.groups(convolve::grid(&constants)));
        self.pass(pipeline, &resources, &constants, groups, convolve::bytes(&constants))
    }
}
