//! The method as one recording: a line a pass, in the order of `docs/method.md`.

use std::sync::Arc;

use bytemuck::Pod;

use crate::plan::{FilterRange, Level, Plan, StackLayer};
use crate::stages::stack::{self, Slopes};
use crate::stages::state::State;
use crate::stages::{Pipelines, confidence, convolve, fuse, ingest, prolong, refine, relax, step, update};
use crate::vulkan::{Device, Groups, Image, Pipeline, Recorder, Recording, Resource};
use crate::workspace::{Grid, Workspace};
use crate::{Channels, Decode, Error};

/// Which photograph.
const BOTH: [usize; 2] = [0, 1];
const RED: usize = 0;
const BLACK: usize = 1;

/// Pixels times outer iterations of one part at most: some 8 s on lavapipe, and by estimate (0.7 kB a
/// pixel and iteration) 1 s on a GPU of 50 GB/s, within the 2 s that Windows allows a submission.
const PART_BUDGET: u64 = 1 << 26;
/// Separable filters that take as long as an outer iteration: on lavapipe 5, of a disk's stacks.
const FILTERS_AN_ITERATION: u64 = 5;

/// A recorded solve.
pub(crate) struct Recorded {
    pub(crate) recording: Recording,
    /// For each part the level, 0 the finest, that is done when it ends.
    pub(crate) level_done: Vec<Option<usize>>,
    /// How many of the parts it takes until the registration is known.
    pub(crate) registered: usize,
}

/// Records a whole solve: one part for the way up, one or more for each level, one for the results. Where the registration
/// does not wait for V, it comes first, with parts and levels of its own.
pub(crate) fn record(
    device: &Arc<Device>,
    pipelines: &Pipelines,
    plan: &Plan,
    workspace: &Workspace,
) -> Result<Recorded, Error> {
    let mut r = Script { recorder: Recorder::new(device, timestamps(plan))?, pipelines, plan, w: workspace };
    r.reset();
    for image in BOTH {
        r.ingest(image, ingest::LUMINANCE)?;
        r.pyramid(image)?;
    }
    let mut level_done = vec![None];
    for level in plan.appearance_levels() {
        r.recorder.next_part()?;
        if plan.matches_exposure() {
            // Nothing is known of V yet.
            r.recorder.clear(r.relative_blur(level.index));
            r.expose(level, true)?;
        }
        r.stack_layer(level, 1, 0)?;
        for k in 0..plan.settings.outer_iterations {
            if starts_part(level, k) {
                r.recorder.next_part()?;
                level_done.push(None);
            }
            r.appearance(level)?;
            r.step(level, &plan.appearance_step(level, k))?;
        }
        level_done.push(Some(level.index));
    }
    let mut registered = 0;
    if !plan.solves_transform() {
        r.recorder.next_part()?;
        r.recorder.clear(r.relative_blur(0));
        r.expose(&plan.pyramid[0], plan.matches_exposure() && !plan.solves_appearance())?;
        r.bring_down_registration();
        r.reset_levels();
        level_done.push(None);
        registered = level_done.len();
    }
    for level in plan.coarse_to_fine() {
        r.recorder.next_part()?;
        r.start(level)?;
        if plan.matches_exposure() {
            r.expose(level, true)?;
        }
        let mut passed = 0;
        for (image, layer) in BOTH.iter().flat_map(|&image| (0..plan.layers_of(level)).map(move |n| (image, n))) {
            passed += r.stack_layer(level, image, layer)? * level.pixels();
            if passed > FILTERS_AN_ITERATION * PART_BUDGET {
                r.recorder.next_part()?;
                level_done.push(None);
                passed = 0;
            }
        }
        for k in 0..plan.settings.outer_iterations {
            if starts_part(level, k) {
                r.recorder.next_part()?;
                level_done.push(None);
            }
            r.linearise(level, k)?;
            r.step(level, &plan.step(level, k))?;
            for _ in 0..plan.settings.sweeps {
                r.relax(level, RED)?;
                r.relax(level, BLACK)?;
            }
            r.update(level)?;
        }
        level_done.push(Some(level.index));
    }
    r.recorder.next_part()?;
    r.expose(&plan.pyramid[0], false)?;
    if plan.solves_transform() {
        r.bring_down_registration();
        level_done.push(None);
        registered = level_done.len();
        r.recorder.next_part()?;
    }
    r.confidence()?;
    for channel in 0..plan.fused_channels().count() {
        r.fuse(channel)?;
    }
    r.bring_down();
    level_done.push(None);
    Ok(Recorded { recording: r.recorder.finish()?, level_done, registered })
}

/// Whether iteration k of a level goes into a new part.
fn starts_part(level: &Level, k: u32) -> bool {
    let per_part = (PART_BUDGET / level.pixels()).max(1) as u32;
    k > 0 && k.is_multiple_of(per_part)
}

/// More than the passes there are.
fn timestamps(plan: &Plan) -> u32 {
    let iteration = 5 + 2 * plan.settings.sweeps;
    let stacks = 4 + 6 * plan.layers.iter().map(|layer| layer.terms.len() as u32).sum::<u32>();
    plan.solved as u32 * (plan.settings.outer_iterations * iteration + stacks + 8) + 4 * plan.pyramid.len() as u32 + 32
}

/// The recorder with what its passes are about.
struct Script<'a> {
    recorder: Recorder,
    pipelines: &'a Pipelines,
    plan: &'a Plan,
    w: &'a Workspace,
}

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
    fn pass<C: Pod>(
        &mut self,
        pipeline: &Arc<Pipeline>,
        resources: &[Resource<'_>],
        constants: &C,
        groups: Groups<'_>,
    ) -> Result<(), Error> {
        self.recorder.pass(pipeline, resources, bytemuck::bytes_of(constants), groups)
    }

    /// State, indirect arguments and energies as they are before a solve.
    fn reset(&mut self) {
        self.recorder.copy(&self.w.start_state, &self.w.state);
        self.recorder.copy(&self.w.start_arguments, &self.w.arguments);
    }

    /// What levels have done, and their indirect arguments, as they are before a solve; T, gain and offset stay.
    fn reset_levels(&mut self) {
        self.recorder.copy_from(&self.w.start_state, &self.w.state, std::mem::offset_of!(State, levels) as u64);
        self.recorder.copy(&self.w.start_arguments, &self.w.arguments);
    }

    /// One channel of a photograph, or its luminance, onto the finest level.
    fn ingest(&mut self, image: usize, weights: [f32; 3]) -> Result<(), Error> {
        let [width, height] = self.plan.size;
        let format = self.plan.formats[image];
        let constants = ingest::Constants {
            width,
            height,
            channels: format.channels.count(),
            bytes: format.depth.bytes(),
            weights,
        };
        let p = self.pipelines;
        let pipeline = if self.plan.settings.decode == Decode::Srgb { &p.ingest_srgb } else { &p.ingest };
        let resources = [Resource::Buffer(&self.w.frames[image]), Resource::Image(&self.w.levels[0].images[image])];
        self.pass(pipeline, &resources, &constants, Groups::Direct(pipeline.groups(self.plan.size)))
    }

    /// Each level from its parent, both axes halved.
    fn pyramid(&mut self, image: usize) -> Result<(), Error> {
        for (parent, level) in self.plan.pyramid.iter().zip(&self.plan.pyramid[1..]) {
            let (from, to) = (&self.w.levels[parent.index].images[image], &self.w.levels[level.index].images[image]);
            self.separable([(from, 0), (to, 0)], parent.size, [self.plan.halve; 2], 2, false)?;
        }
        Ok(())
    }

    /// A layer of a level's stack: the spline coefficients of its image, or a filter of an earlier layer. Says how many
    /// separable filters it took.
    fn stack_layer(&mut self, level: &Level, image: usize, layer: u32) -> Result<u64, Error> {
        let (from, stack) = (&self.w.levels[level.index].images[image], &self.w.stacks[image]);
        if layer == 0 {
            self.separable([(from, 0), (stack, 0)], level.size, [self.plan.prefilter; 2], 1, false)?;
            return Ok(1);
        }
        let StackLayer { from, grid, terms } = &self.plan.layers[layer as usize - 1];
        if *grid != stack::Grid::Every {
            self.half_layer(level, stack, [*from, layer], *grid == stack::Grid::Halving, terms[0])?;
            return Ok(1);
        }
        for (n, &term) in terms.iter().enumerate() {
            self.separable([(stack, *from), (stack, layer)], level.size, term, 1, n > 0)?;
        }
        Ok(terms.len() as u64)
    }

    /// A layer on every other pixel, in the corner of the scratch image, where the one before it is unless this is the
    /// first; then on every pixel in its place, which until then holds what is between the two directions.
    fn half_layer(
        &mut self,
        level: &Level,
        stack: &Arc<Image>,
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
        let scratch = &self.w.scratch;
        let source = if first { (stack, from) } else { (scratch, 0) };
        self.convolve([source, (stack, layer)], &x, along_x, false)?;
        self.convolve([(stack, layer), (scratch, 0)], &y, along_y, false)?;
        let constants = refine::Constants { width, height, layer };
        let pipeline = &self.pipelines.refine;
        let resources = [Resource::Image(scratch), Resource::Image(stack)];
        self.pass(pipeline, &resources, &constants, Groups::Direct(pipeline.groups([half_width, half_height])))
    }

    /// A filter along x into the scratch image, then one along y, from a layer of an image to one, in its place or added.
    fn separable(
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
        self.pass(pipeline, &resources, &constants, Groups::Direct(pipeline.groups(convolve::grid(&constants))))
    }

    /// V of a level before its first iteration: zero, or the coarser level's.
    fn start(&mut self, level: &Level) -> Result<(), Error> {
        let v = self.relative_blur(level.index);
        if level.index + 1 == self.plan.solved {
            self.recorder.clear(v);
            return Ok(());
        }
        let [width, height] = level.size;
        let constants = prolong::Constants { width, height, limit: level.limit as f32 };
        let pipeline = &self.pipelines.prolong;
        let resources = [Resource::Image(self.relative_blur(level.index + 1)), Resource::Image(v)];
        self.pass(pipeline, &resources, &constants, Groups::Direct(pipeline.groups(level.size)))
    }

    /// Gain and offset at low pass, or only the correlation there.
    fn expose(&mut self, level: &Level, adopt: bool) -> Result<(), Error> {
        let (index, constants) = self.plan.expose(level, adopt);
        let [i1, i2] = &self.w.levels[index].images;
        let [i1, i2, v] = [i1, i2, self.relative_blur(level.index)].map(Resource::Image);
        let resources = [i1, i2, v, Resource::Buffer(&self.w.state)];
        self.pass(&self.pipelines.expose, &resources, &constants, Groups::Direct([1, 1, 1]))
    }

    /// The registration integrals without a blur model: equation 36.
    fn appearance(&mut self, level: &Level) -> Result<(), Error> {
        let constants = self.plan.appearance(level);
        let w = self.w;
        let resources = [
            Resource::Image(&w.levels[level.index].images[0]),
            Resource::Image(&w.stacks[1]),
            Resource::Buffer(&w.state),
            Resource::Buffer(&w.partials),
        ];
        self.pass(&self.pipelines.appearance, &resources, &constants, self.grid(Grid::Tiles, level))
    }

    /// S1, S2, D, b and the registration integrals: equations 22 to 32 and 23.
    fn linearise(&mut self, level: &Level, k: u32) -> Result<(), Error> {
        let constants = self.plan.linearise(level, k);
        let w = self.w;
        let images = [
            &w.levels[level.index].images[0],
            self.relative_blur(level.index),
            &w.stacks[0],
            &w.stacks[1],
            &w.right_sides,
            &w.weights,
            &w.changes[RED],
            &w.changes[BLACK],
        ];
        let resources =
            [&images.map(Resource::Image)[..], &[Resource::Buffer(&w.state), Resource::Buffer(&w.partials)]].concat();
        let p = self.pipelines;
        let pipeline = if self.plan.slopes() == Slopes::Laplacian { &p.linearise } else { &p.linearise_any_kernel };
        self.pass(pipeline, &resources, &constants, self.grid(Grid::Tiles, level))
    }

    /// T, gain, offset; settled?
    fn step(&mut self, level: &Level, constants: &step::Constants) -> Result<(), Error> {
        let resources = [&self.w.partials, &self.w.state, &self.w.energies, &self.w.arguments].map(Resource::Buffer);
        self.pass(&self.pipelines.step, &resources, constants, self.grid(Grid::One, level))
    }

    /// One half-iteration on dV.
    fn relax(&mut self, level: &Level, color: usize) -> Result<(), Error> {
        let constants = relax::Constants {
            width: level.size[0],
            height: level.size[1],
            color: color as u32,
            over_relaxation: self.plan.settings.over_relaxation as f32,
        };
        let w = self.w;
        let resources = [&w.right_sides, &w.weights, &w.changes[1 - color], &w.changes[color]].map(Resource::Image);
        self.pass(&self.pipelines.relax, &resources, &constants, self.grid(Grid::Half, level))
    }

    /// V + clamp(dV).
    fn update(&mut self, level: &Level) -> Result<(), Error> {
        let constants = update::Constants {
            width: level.size[0],
            height: level.size[1],
            largest_step: self.plan.settings.largest_step as f32,
            limit: level.limit as f32,
        };
        let w = self.w;
        let resources = [&w.changes[RED], &w.changes[BLACK], self.relative_blur(level.index)].map(Resource::Image);
        self.pass(&self.pipelines.update, &resources, &constants, self.grid(Grid::Pixels, level))
    }

    /// V where it is valid, and its confidence, into the first layers of the results.
    fn confidence(&mut self) -> Result<(), Error> {
        let finest = &self.plan.pyramid[0];
        let [width, height] = finest.size;
        let constants = confidence::Constants { width, height, centre: finest.centre.map(|c| c as f32) };
        let images = [self.relative_blur(0), &self.w.weights, &self.w.stacks[0]];
        let resources = [&images.map(Resource::Image)[..], &[Resource::Buffer(&self.w.state)]].concat();
        let pipeline = &self.pipelines.confidence;
        self.pass(pipeline, &resources, &constants, Groups::Direct(pipeline.groups(finest.size)))
    }

    /// One channel of the pseudo-radiance, equation 37. The channel takes the luminance's place.
    fn fuse(&mut self, channel: u32) -> Result<(), Error> {
        let mut weights = [0.0; 3];
        weights[channel as usize] = 1.0;
        for image in BOTH {
            // A grey photograph beside a coloured one gives its only channel to all three.
            self.ingest(image, weights)?;
        }
        let finest = &self.plan.pyramid[0];
        let [i1, i2] = &self.w.levels[0].images;
        self.separable([(i2, 0), (&self.w.stacks[1], 0)], finest.size, [self.plan.prefilter; 2], 1, false)?;
        let constants = fuse::Constants {
            width: finest.size[0],
            height: finest.size[1],
            layer: 2 + channel,
            centre: finest.centre.map(|c| c as f32),
            epsilon: self.plan.settings.heaviside_epsilon as f32,
        };
        let images = [i1, &self.w.stacks[1], self.relative_blur(0), &self.w.stacks[0]];
        let resources = [&images.map(Resource::Image)[..], &[Resource::Buffer(&self.w.state)]].concat();
        let pipeline = &self.pipelines.fuse;
        self.pass(pipeline, &resources, &constants, Groups::Direct(pipeline.groups(finest.size)))
    }

    /// The registration, into mapped memory, before the results are there.
    fn bring_down_registration(&mut self) {
        self.recorder.copy(&self.w.state, &self.w.registered_state);
        self.recorder.copy(&self.w.energies, &self.w.registered_energies);
        self.recorder.host_barrier();
    }

    /// The results, into mapped memory.
    fn bring_down(&mut self) {
        let layers = 2 + self.plan.fused_channels().count();
        self.recorder.download(&self.w.stacks[0], self.plan.size, layers, &self.w.results);
        self.recorder.copy(&self.w.state, &self.w.end_state);
        self.recorder.copy(&self.w.energies, &self.w.end_energies);
    }

    fn grid(&self, grid: Grid, level: &Level) -> Groups<'a> {
        Groups::Indirect(&self.w.arguments, grid.offset(level.index))
    }

    fn relative_blur(&self, level: usize) -> &'a Arc<Image> {
        &self.w.relative_blur[level]
    }
}

/// The channels of the fused image as the results hold them: planes, to be interleaved.
pub(crate) fn interleave(planes: &[f32], channels: Channels) -> Vec<f32> {
    let count = channels.count() as usize;
    let pixels = planes.len() / count;
    (0..pixels).flat_map(|i| (0..count).map(move |c| planes[c * pixels + i])).collect()
}
