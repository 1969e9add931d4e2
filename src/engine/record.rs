//! The method as one recording: a line a pass, in the order of `docs/method.md`.

mod stacks;

use std::sync::Arc;

use bytemuck::Pod;

use crate::base::color::LUMINANCE;
use crate::base::{Channels, Decode, Error};
use crate::engine::plan::{Level, Plan};
use crate::engine::profile::{Dispatch, Place};
use crate::engine::stages::stack::Slopes;
use crate::engine::stages::state::State;
use crate::engine::stages::{
    Pipelines, Weighing, appearance, confidence, evidence, expose, fuse, ingest, linearise, mask, prolong, relax,
    relax_level, residual, step, update,
};
use crate::engine::vulkan::{Clock, Device, Groups, Image, Pipeline, Recorder, Recording, Resource};
use crate::engine::workspace::{Grid, LevelImages, Workspace, arguments};

/// Which photograph.
const BOTH: [usize; 2] = [0, 1];
const RED: usize = 0;
const BLACK: usize = 1;

/// Pixels times outer iterations of one part at most: some 8 s on lavapipe, and by estimate (0.7 kB a
/// pixel and iteration) 1 s on a GPU of 50 GB/s, within the 2 s that Windows allows a submission.
const PART_BUDGET: u64 = 1 << 26;
/// Separable filters that take as long as an outer iteration: on lavapipe 5, of a disk's stacks.
const FILTERS_AN_ITERATION: u64 = 5;

/// What a part of the recording is for.
#[derive(Clone, Copy, Default)]
pub(crate) struct Part {
    /// The level, 0 the finest, that is done when it ends.
    pub(crate) level_done: Option<usize>,
    /// The level whose iterations it goes on with: not wanted once that has settled.
    pub(crate) goes_on: Option<usize>,
}

/// How a solve is recorded.
#[derive(Clone, Copy, Default)]
pub(crate) struct Variant {
    /// The time of every single dispatch is taken, which takes time itself.
    pub(crate) traced: bool,
    /// Pixels are masked or clipped.
    pub(crate) masked: bool,
}

/// A recorded solve.
pub(crate) struct Recorded {
    pub(crate) recording: Recording,
    pub(crate) parts: Vec<Part>,
    /// How many of the parts it takes until the registration is known.
    pub(crate) registered: usize,
    /// What was recorded, in order.
    pub(crate) dispatches: Vec<Dispatch>,
}

/// Records a whole solve: one part for the way up, some for each level, one for the results. Where the registration
/// does not wait for V, it comes first, with parts and levels of its own.
pub(crate) fn record(
    device: &Arc<Device>,
    pipelines: &Pipelines,
    plan: &Plan,
    workspace: &Workspace,
    variant: Variant,
) -> Result<Recorded, Error> {
    let clock = if variant.traced { Clock::Dispatches } else { Clock::Passes };
    let recorder = Recorder::new(device, clock(timestamps(plan)))?;
    let (warps, place) = (vec![Vec::new(); plan.solved], Place::default());
    let parts = vec![Part::default()];
    let mut r = Script {
        recorder,
        pipelines,
        weighing: pipelines.weighing(variant.masked)?,
        masked: variant.masked,
        plan,
        w: workspace,
        anew: None,
        warps,
        place,
        parts,
        dispatches: Vec::new(),
    };
    r.reset();
    for image in BOTH {
        r.ingest(image, LUMINANCE)?;
        if variant.masked {
            r.mask(image)?;
        }
        r.pyramid(image)?;
    }
    for level in plan.appearance_levels() {
        r.next_part()?;
        r.register_level(level)?;
    }
    let mut registered = 0;
    if !plan.solves_transform() {
        r.next_part()?;
        r.place = Place::level(0);
        r.recorder.clear(r.relative_blur(0));
        r.expose(&plan.pyramid[0], plan.matches_exposure() && !plan.solves_appearance())?;
        r.bring_down_registration();
        r.reset_levels();
        registered = r.parts.len();
    }
    for level in plan.coarse_to_fine() {
        r.next_part()?;
        r.solve_level(level)?;
    }
    r.next_part()?;
    r.place = Place::level(0);
    r.expose(&plan.pyramid[0], false)?;
    if plan.solves_transform() {
        r.bring_down_registration();
        registered = r.parts.len();
        r.next_part()?;
    }
    r.confidence()?;
    for channel in 0..plan.fused_channels().count() {
        r.fuse(channel)?;
    }
    r.bring_down();
    workspace.start_arguments.write(bytemuck::cast_slice(&arguments(plan, &r.warps)))?;
    Ok(Recorded { recording: r.recorder.finish()?, parts: r.parts, registered, dispatches: r.dispatches })
}

/// Whether iteration k of a level goes into a new part.
fn starts_part(level: &Level, k: u32) -> bool {
    let per_part = (PART_BUDGET / level.pixels()).max(1) as u32;
    k > 0 && k.is_multiple_of(per_part)
}

/// More than the passes there are.
fn timestamps(plan: &Plan) -> u32 {
    let iteration = 5 + 2 * plan.settings.sweeps;
    let stacks = 8 + 6 * plan.layers.iter().map(|layer| layer.terms.len() as u32).sum::<u32>();
    let anew = plan.settings.outer_iterations.ilog2() * stacks;
    plan.solved as u32 * (plan.settings.outer_iterations * iteration + stacks + anew + 8)
        + 8 * plan.pyramid.len() as u32
        + 32
}

/// The recorder with what its passes are about.
struct Script<'a> {
    recorder: Recorder,
    pipelines: &'a Pipelines,
    weighing: &'a Weighing,
    masked: bool,
    plan: &'a Plan,
    w: &'a Workspace,
    /// The level whose I2 is being brought onto I1's pixels anew, by passes that run only if T has moved.
    anew: Option<usize>,
    /// The workgroups of those passes, by level.
    warps: Vec<Vec<[u32; 3]>>,
    /// Where the next pass stands.
    place: Place,
    parts: Vec<Part>,
    dispatches: Vec<Dispatch>,
}

impl<'a> Script<'a> {
    /// Records a pass that must move so many bytes.
    fn pass<C: Pod>(
        &mut self,
        pipeline: &Arc<Pipeline>,
        resources: &[Resource<'_>],
        constants: &C,
        groups: Groups<'_>,
        bytes: u64,
    ) -> Result<(), Error> {
        self.dispatches.push(Dispatch { pass: pipeline.name, place: self.place, bytes });
        self.recorder.pass(pipeline, resources, bytemuck::bytes_of(constants), groups)
    }

    /// The rest goes into another submission.
    fn next_part(&mut self) -> Result<(), Error> {
        self.parts.push(Part::default());
        self.recorder.next_part()
    }

    /// Iteration k of a level: into another part, if the host is to be asked whether it is wanted or the part at hand is full.
    fn begin_iteration(&mut self, level: &Level, k: u32, may_settle: impl Fn(u32) -> bool) -> Result<(), Error> {
        if Plan::asks_before(k, may_settle) {
            self.recorder.copy(&self.w.state, &self.w.progress);
            self.parts.push(Part { goes_on: Some(level.index), level_done: None });
            self.recorder.next_part_if_wanted()?;
        } else if starts_part(level, k) {
            self.next_part()?;
        }
        self.place = self.place.iteration(k);
        Ok(())
    }

    /// The part at hand is the last of a level.
    fn end_level(&mut self, level: &Level) {
        if let Some(part) = self.parts.last_mut() {
            part.level_done = Some(level.index);
        }
    }

    /// T on one level, by appearance.
    fn register_level(&mut self, level: &Level) -> Result<(), Error> {
        let (w, plan) = (self.w, self.plan);
        self.place = Place::registering(level.index);
        if plan.matches_exposure() {
            // Nothing is known of V yet.
            self.recorder.clear(self.relative_blur(level.index));
            self.expose(level, true)?;
        }
        self.spline(level, (&w.levels[level.index].images[1], 0), (&w.spline2, 0))?;
        for k in 0..plan.settings.outer_iterations {
            self.begin_iteration(level, k, |k| plan.appearance_step(level, k).may_settle == 1)?;
            self.appearance(level)?;
            self.step(level, &plan.appearance_step(level, k))?;
        }
        self.end_level(level);
        Ok(())
    }

    /// V on one level, and the registration where it is solved for together with V.
    fn solve_level(&mut self, level: &Level) -> Result<(), Error> {
        let plan = self.plan;
        self.place = Place::level(level.index);
        self.start(level)?;
        if plan.matches_exposure() {
            self.expose(level, true)?;
        }
        let mut passed = 0;
        for (image, layer) in BOTH.iter().flat_map(|&image| (0..plan.layers_of(level)).map(move |n| (image, n))) {
            passed += self.stack_layer(level, image, layer)? * level.pixels();
            if passed > FILTERS_AN_ITERATION * PART_BUDGET {
                self.next_part()?;
                passed = 0;
            }
        }
        for k in 0..plan.settings.outer_iterations {
            self.begin_iteration(level, k, |k| plan.may_settle(level, k))?;
            if plan.warps_anew(level, k) {
                if level.pixels() > PART_BUDGET / FILTERS_AN_ITERATION {
                    self.next_part()?;
                }
                self.warp_anew(level)?;
            }
            self.linearise(level, k)?;
            self.step(level, &plan.step(level, k))?;
            self.relaxation(level)?;
            self.update(level)?;
        }
        self.end_level(level);
        Ok(())
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
        let groups = Groups::Direct(pipeline.groups(self.plan.size));
        self.pass(pipeline, &resources, &constants, groups, ingest::bytes(&constants))
    }

    /// Which pixels of a photograph count, on the finest level.
    fn mask(&mut self, image: usize) -> Result<(), Error> {
        let ([width, height], format) = (self.plan.size, self.plan.formats[image]);
        let constants = mask::Constants {
            width,
            height,
            channels: format.channels.count(),
            bytes: format.depth.bytes(),
            second: image as u32,
            clipped: self.plan.settings.clipped(format.depth),
        };
        let (w, pipeline) = (self.w, &self.pipelines.mask);
        let resources =
            [Resource::Buffer(&w.frames[image]), Resource::Buffer(&w.mask), Resource::Image(&w.levels[0].masks)];
        let groups = Groups::Direct(pipeline.groups(self.plan.size));
        self.pass(pipeline, &resources, &constants, groups, mask::bytes(&constants))?;
        let layer = (&w.levels[0].masks, image as u32);
        self.separable([layer, layer], self.plan.size, [self.plan.window; 2], 1, false)
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
        let groups = Groups::Direct(pipeline.groups(level.size));
        self.pass(pipeline, &resources, &constants, groups, prolong::bytes(&constants))
    }

    /// Gain and offset at low pass, or only the correlation there.
    fn expose(&mut self, level: &Level, adopt: bool) -> Result<(), Error> {
        let (index, constants) = self.plan.expose(level, adopt);
        let low_pass = &self.w.levels[index];
        let [i1, i2] = &low_pass.images;
        let [i1, i2, v, masks] = [i1, i2, self.relative_blur(level.index), &low_pass.masks].map(Resource::Image);
        let resources = [i1, i2, v, Resource::Buffer(&self.w.state), masks];
        let groups = Groups::Direct([1, 1, 1]);
        self.pass(&self.weighing.expose, &resources, &constants, groups, expose::bytes(&constants))
    }

    /// The registration integrals without a blur model: equation 36.
    fn appearance(&mut self, level: &Level) -> Result<(), Error> {
        let constants = self.plan.appearance(level);
        let w = self.w;
        let resources = [
            Resource::Image(&w.levels[level.index].images[0]),
            Resource::Image(&w.spline2),
            Resource::Buffer(&w.state),
            Resource::Buffer(&w.partials),
            Resource::Image(&w.levels[level.index].masks),
        ];
        let (groups, bytes) = (self.grid(Grid::Tiles, level), appearance::bytes(&constants));
        self.pass(&self.weighing.appearance, &resources, &constants, groups, bytes)
    }

    /// S1, S2, D, b and the registration integrals: equations 22 to 32 and 23.
    fn linearise(&mut self, level: &Level, k: u32) -> Result<(), Error> {
        let constants = self.plan.linearise(level, k);
        let w = self.w;
        let LevelImages { images: [i1, _], masks } = &w.levels[level.index];
        let images = [i1, self.relative_blur(level.index), &w.stacks, &w.right_sides, &w.weights];
        let buffers = [&w.state, &w.partials].map(Resource::Buffer);
        let resources = [&images.map(Resource::Image)[..], &buffers, &[Resource::Image(masks)]].concat();
        let p = self.weighing;
        let pipeline = match self.plan.slopes() {
            Slopes::Layers => &p.linearise_any_kernel,
            Slopes::Laplacian if self.plan.warps(level) => &p.linearise_warped,
            Slopes::Laplacian => &p.linearise,
        };
        let (groups, bytes) = (self.grid(Grid::Tiles, level), linearise::bytes(&constants, self.plan.slopes()));
        self.pass(pipeline, &resources, &constants, groups, bytes)
    }

    /// T, gain, offset; settled?
    fn step(&mut self, level: &Level, constants: &step::Constants) -> Result<(), Error> {
        let resources = [&self.w.partials, &self.w.state, &self.w.energies, &self.w.arguments, &self.w.start_arguments];
        let resources = resources.map(Resource::Buffer);
        let (groups, bytes) = (self.grid(Grid::One, level), step::bytes(constants));
        self.pass(&self.pipelines.step, &resources, constants, groups, bytes)?;
        self.place = self.place.after_step();
        Ok(())
    }

    /// dV by red-black sweeps: two passes each, or one pass for all where the level is small.
    fn relaxation(&mut self, level: &Level) -> Result<(), Error> {
        let sweeps = self.plan.settings.sweeps;
        if relax_level::takes(level.size) {
            return self.relax_level(level, sweeps);
        }
        for sweep in 0..sweeps {
            self.relax(level, RED, sweep)?;
            self.relax(level, BLACK, sweep)?;
        }
        Ok(())
    }

    /// All sweeps on a small level.
    fn relax_level(&mut self, level: &Level, sweeps: u32) -> Result<(), Error> {
        let [width, height] = level.size;
        let over_relaxation = self.plan.settings.over_relaxation as f32;
        let constants = relax_level::Constants { width, height, sweeps, over_relaxation };
        let w = self.w;
        let resources = [&w.right_sides, &w.weights, &w.changes[RED], &w.changes[BLACK]].map(Resource::Image);
        let (groups, bytes) = (self.grid(Grid::One, level), relax_level::bytes(&constants));
        self.pass(&self.pipelines.relax_level, &resources, &constants, groups, bytes)
    }

    /// One half-iteration on dV.
    fn relax(&mut self, level: &Level, color: usize, sweep: u32) -> Result<(), Error> {
        let constants = relax::Constants {
            width: level.size[0],
            height: level.size[1],
            color: color as u32,
            rows: relax::ROWS,
            over_relaxation: self.plan.settings.over_relaxation as f32,
        };
        let w = self.w;
        let resources = [&w.right_sides, &w.weights, &w.changes[1 - color], &w.changes[color]].map(Resource::Image);
        let pipeline = if sweep == 0 { &self.pipelines.relax_first } else { &self.pipelines.relax };
        let (groups, bytes) = (self.grid(Grid::Half, level), relax::bytes(&constants, sweep == 0));
        self.pass(pipeline, &resources, &constants, groups, bytes)
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
        let (groups, bytes) = (self.grid(Grid::Pixels, level), update::bytes(&constants));
        self.pass(&self.pipelines.update, &resources, &constants, groups, bytes)
    }

    /// V where it is valid, its standard deviation and the residual, into the first layers of the results.
    fn confidence(&mut self) -> Result<(), Error> {
        self.evidence()?;
        let (w, constants) = (self.w, self.plan.confidence());
        let images = [self.relative_blur(0), &w.evidence, &w.stacks];
        let resources = [&images.map(Resource::Image)[..], &[Resource::Buffer(&w.state)]].concat();
        let pipeline = &self.pipelines.confidence;
        let groups = Groups::Direct(pipeline.groups(self.plan.size));
        self.pass(pipeline, &resources, &constants, groups, confidence::bytes(&constants))
    }

    /// The squared residual on the finest level, into the last layer of the evidence.
    fn residual(&mut self) -> Result<(), Error> {
        let (w, p, finest, constants) = (self.w, self.pipelines, &self.plan.pyramid[0], self.plan.residual());
        let pipeline = match self.plan.slopes() {
            Slopes::Layers => &p.residual_any_kernel,
            Slopes::Laplacian if self.plan.warps(finest) => &p.residual_warped,
            Slopes::Laplacian => &p.residual,
        };
        let images = [&w.levels[0].images[0], self.relative_blur(0), &w.stacks, &w.evidence];
        let resources = [&images.map(Resource::Image)[..], &[Resource::Buffer(&w.state)]].concat();
        let groups = Groups::Direct(pipeline.groups(evidence::size(self.plan.size)));
        self.pass(pipeline, &resources, &constants, groups, residual::bytes(&constants))
    }

    /// What decided V and what nothing explains, averaged over a window around each pixel.
    fn evidence(&mut self) -> Result<(), Error> {
        let (w, constants) = (self.w, self.plan.evidence());
        let resources = [self.relative_blur(0), &w.right_sides, &w.weights, &w.evidence].map(Resource::Image);
        let pipeline = &self.pipelines.evidence;
        let size = evidence::size(self.plan.size);
        let groups = Groups::Direct(pipeline.groups(size));
        self.pass(pipeline, &resources, &constants, groups, evidence::bytes(&constants))?;
        self.residual()?;
        (0..evidence::LAYERS as u32).try_for_each(|layer| {
            let image = (&w.evidence, layer);
            self.separable([image, image], size, [self.plan.window; 2], 1, false)
        })
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
        self.spline(finest, (i2, 0), (&self.w.spline2, 0))?;
        let constants = fuse::Constants {
            width: finest.size[0],
            height: finest.size[1],
            layer: 3 + channel,
            centre: finest.centre.map(|c| c as f32),
            epsilon: self.plan.settings.heaviside_epsilon as f32,
        };
        let images = [i1, &self.w.spline2, self.relative_blur(0), &self.w.stacks];
        let resources = [&images.map(Resource::Image)[..], &[Resource::Buffer(&self.w.state)]].concat();
        let pipeline = &self.pipelines.fuse;
        let groups = Groups::Direct(pipeline.groups(finest.size));
        self.pass(pipeline, &resources, &constants, groups, fuse::bytes(&constants))
    }

    /// The registration, into mapped memory, before the results are there.
    fn bring_down_registration(&mut self) {
        self.recorder.copy(&self.w.state, &self.w.registered_state);
        self.recorder.copy(&self.w.energies, &self.w.registered_energies);
        self.recorder.host_barrier();
    }

    /// The results, into mapped memory.
    fn bring_down(&mut self) {
        let layers = 3 + self.plan.fused_channels().count();
        self.recorder.download(&self.w.stacks, self.plan.size, layers, &self.w.results);
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
