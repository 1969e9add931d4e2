//! Submit and wait: what an embedding program holds.

use std::sync::Arc;
use std::time::Instant;

use crate::base::{Channels, Error, Format, Frame, Homography, Kernel, Mask, Method, Region, Settings};
use crate::engine::motion::Form;
use crate::engine::plan::Plan;
use crate::engine::profile::{Phases, Profile, Ran, SUBMIT_WAIT};
use crate::engine::record::record;
use crate::engine::script::{Dispatch, Script, compose};
use crate::engine::slot::Slot;
use crate::engine::solution::{self, LevelHistory, Timings};
use crate::engine::stages::Pipelines;
use crate::engine::stages::state::{Registration, State};
use crate::engine::stages::sums::{Layout, Sums};
use crate::engine::vulkan::{Clock, Device, Recorder, Recording};
use crate::engine::workspace::Workspace;
use crate::engine::{Engine, KeyPoints, OtherMotion, Registered, Solution};

/// How far a solve has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Levels done; with the method appearance those of the registration count too.
    pub done: u32,
    /// Levels in all.
    pub levels: u32,
    /// Pixels of the levels done, which is nearer to the time spent than their number.
    pub pixels_done: u64,
    /// Pixels of all levels.
    pub pixels: u64,
    /// Width of the level just done, pixels.
    pub width: u32,
    /// Height of the level just done, pixels.
    pub height: u32,
}

/// A script, and its recording.
struct Prepared {
    script: Script,
    recording: Recording,
}

impl Prepared {
    fn new(
        device: &Arc<Device>,
        pipelines: &Pipelines,
        plan: &Plan,
        workspace: &Workspace,
        masked: bool,
        traced: bool,
    ) -> Result<Self, Error> {
        let script = compose(plan, masked);
        let recording = record(device, pipelines, workspace, &script, traced)?;
        workspace.buffer(Slot::StartArguments).write(bytemuck::cast_slice(&script.arguments))?;
        Ok(Self { script, recording })
    }
}

/// A size and settings, prepared once and used for any number of pairs.
pub struct Solver {
    plan: Plan,
    /// Of pairs all of whose pixels count.
    plain: Prepared,
    /// Of pairs with masked or clipped pixels, recorded when the first comes.
    masked: Option<Prepared>,
    /// Whether the latest pair had such pixels.
    is_masked: bool,
    traced: bool,
    phases: Phases,
    workspace: Workspace,
    mask: Option<Mask>,
    key_points: Option<KeyPoints>,
    device: Arc<Device>,
    pipelines: Arc<Pipelines>,
}

impl Solver {
    /// Prepares for pairs of `width` x `height` pixels, I1 and I2 in the given formats.
    ///
    /// # Errors
    /// [`Error::Setting`], [`Error::TooSmall`], [`Error::TooLarge`], [`Error::Poisoned`], [`Error::Vulkan`].
    pub fn new(
        engine: &Engine,
        width: u32,
        height: u32,
        formats: [Format; 2],
        settings: &Settings,
    ) -> Result<Self, Error> {
        Self::prepare(engine, [width, height], formats, settings, false)
    }

    /// The same, but the time of every single dispatch is taken if it is `traced`, which takes time itself.
    pub(crate) fn prepare(
        engine: &Engine,
        [width, height]: [u32; 2],
        formats: [Format; 2],
        settings: &Settings,
        traced: bool,
    ) -> Result<Self, Error> {
        let plan = Plan::new(width, height, formats, settings)?;
        let device = engine.device().clone();
        if device.is_poisoned() {
            return Err(Error::Poisoned);
        }
        plan.check(&device)?;
        let workspace = Workspace::new(&device, &plan)?;
        let mut first = Recorder::new(&device, Clock::Never)?;
        first.prepare(&workspace.images());
        first.finish()?.run()?;
        let pipelines = engine.pipelines().clone();
        let plain = Prepared::new(&device, &pipelines, &plan, &workspace, false, traced)?;
        let (phases, masked, mask) = (Phases::default(), None, None);
        let key_points = engine.key_points;
        let is_masked = false;
        Ok(Self { plan, plain, masked, is_masked, traced, phases, workspace, mask, key_points, device, pipelines })
    }

    /// What the latest pair took.
    fn latest(&self) -> &Prepared {
        self.masked.as_ref().filter(|_| self.is_masked).unwrap_or(&self.plain)
    }

    /// Chooses the recording for a pair: where no pixel is masked or clipped, the one that does not weigh them.
    fn choose(&mut self, frames: [&Frame; 2]) -> Result<(), Error> {
        let settings = &self.plan.settings;
        let clips = |frame: &Frame| frame.clips(settings.clipped(frame.format().depth));
        self.is_masked = self.mask.is_some() || frames.into_iter().any(clips);
        if self.is_masked && self.masked.is_none() {
            let (plan, workspace) = (&self.plan, &self.workspace);
            workspace.buffer(Slot::Mask).write(&mask_bytes(plan, self.mask.as_ref()))?;
            self.masked = Some(Prepared::new(&self.device, &self.pipelines, plan, workspace, true, self.traced)?);
        }
        Ok(())
    }

    /// Leaves out pixels of I1 in the solves to come; `None`: none.
    ///
    /// # Errors
    /// [`Error::Mismatch`] where the mask is not of the size prepared for, [`Error::Vulkan`].
    pub fn set_mask(&mut self, mask: Option<Mask>) -> Result<(), Error> {
        if let Some([width, height]) = mask.as_ref().map(Mask::size).filter(|size| *size != self.plan.size) {
            let [w, h] = self.plan.size;
            return Err(Error::Mismatch(format!("the mask is {width}x{height} and the images are {w}x{h}")));
        }
        // Of pairs without a mask, the usual, nothing need go up.
        if self.mask != mask {
            self.workspace.buffer(Slot::Mask).write(&mask_bytes(&self.plan, mask.as_ref()))?;
            self.mask = mask;
        }
        Ok(())
    }

    /// Where T starts: as the settings say, or, with the method SIFT, where key-points put it.
    fn start(&self, frames: [&Frame; 2]) -> Result<Homography, Error> {
        let settings = &self.plan.settings;
        if settings.method != Method::Sift {
            return Ok(settings.start);
        }
        let find = self.key_points.ok_or(Error::NoKeyPoints)?;
        Ok(find(frames, settings.decode, self.mask.as_ref())?.into())
    }

    /// Prepares for pairs like this one.
    ///
    /// # Errors
    /// As [`Solver::new`], and [`Error::Mismatch`] where the sizes differ.
    pub fn for_pair(engine: &Engine, i1: &Frame, i2: &Frame, settings: &Settings) -> Result<Self, Error> {
        same_size([i1, i2])?;
        Self::new(engine, i1.width(), i1.height(), [i1.format(), i2.format()], settings)
    }

    /// Solves one pair.
    ///
    /// # Errors
    /// [`Error::Mismatch`] where a frame is not of the size and format prepared for, [`Error::NoKeyPoints`] or what they failed of with the
    /// method SIFT, [`Error::Timeout`], [`Error::Poisoned`], [`Error::Vulkan`].
    pub fn solve(&mut self, i1: &Frame, i2: &Frame) -> Result<Solution, Error> {
        self.solve_with(i1, i2, &mut |_| ())
    }

    /// Solves one pair and tells after each level how far it has come.
    ///
    /// # Errors
    /// As [`Solver::solve`].
    pub fn solve_with(
        &mut self,
        i1: &Frame,
        i2: &Frame,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Solution, Error> {
        let started = Instant::now();
        self.run([i1, i2], |script| script.parts.len(), progress)?;
        let mut solution = self.collect()?;
        self.phases.end("collect");
        solution.timings.total_ms = started.elapsed().as_secs_f64() * 1e3;
        Ok(solution)
    }

    /// Registers one pair and does no more than that takes: for the method appearance no blur is solved for, for SIFT
    /// and aligned only exposure and correlation are measured on the device.
    ///
    /// # Errors
    /// As [`Solver::solve`].
    pub fn register(&mut self, i1: &Frame, i2: &Frame) -> Result<Registered, Error> {
        self.register_with(i1, i2, &mut |_| ())
    }

    /// Registers one pair and tells after each level how far it has come.
    ///
    /// # Errors
    /// As [`Solver::solve`].
    pub fn register_with(
        &mut self,
        i1: &Frame,
        i2: &Frame,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Registered, Error> {
        let started = Instant::now();
        self.run([i1, i2], |script| script.registered, progress)?;
        let mut registered = self.collect_registered()?;
        registered.timings.total_ms = started.elapsed().as_secs_f64() * 1e3;
        Ok(registered)
    }

    /// Brings a pair up and runs the first parts of the recording on it.
    fn run(
        &mut self,
        frames: [&Frame; 2],
        wanted_parts: fn(&Script) -> usize,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<(), Error> {
        self.check_frames(frames)?;
        if self.device.is_poisoned() {
            return Err(Error::Poisoned);
        }
        self.phases = Phases::default();
        for (image, frame) in frames.into_iter().enumerate() {
            self.workspace.buffer(Slot::Photograph { image }).write(frame.bytes())?;
        }
        self.phases.end("upload");
        let settings = &self.plan.settings;
        let start = Registration::new(self.start(frames)?, &settings.start_photometric);
        let mut state = State::new(&start);
        state.alpha = settings.regularization.map_or(state.alpha, |alpha| alpha as f32);
        self.workspace.buffer(Slot::StartState).write(bytemuck::bytes_of(&state))?;
        self.choose(frames)?;
        self.phases.end("start");
        let (plan, on_the_way) = (&self.plan, self.workspace.buffer(Slot::Progress));
        let latest = self.masked.as_mut().filter(|_| self.is_masked).unwrap_or(&mut self.plain);
        let Prepared { script, recording } = latest;
        let parts = wanted_parts(script);
        let levels = |parts: usize| script.parts[..parts].iter().filter_map(|part| part.level_done);
        let count = |parts: usize| levels(parts).count() as u32;
        let pixels =
            |parts: usize| levels(parts).map(|index| plan.pyramid[index].size.map(u64::from)).map(|[w, h]| w * h).sum();
        let mut wanted = |part: usize| {
            let state = on_the_way.read::<State>(0, 1)?[0];
            Ok(script.parts[part].goes_on.is_none_or(|level| state.levels[level].settled == 0))
        };
        recording.run_first(parts, &mut wanted, &mut |part| {
            if let Some(level) = script.parts[part - 1].level_done.map(|index| &plan.pyramid[index]) {
                let [width, height] = level.size;
                let (pixels_done, pixels) = (pixels(part), pixels(parts));
                progress(Progress { done: count(part), levels: count(parts), pixels_done, pixels, width, height });
            }
        })?;
        self.phases.end(SUBMIT_WAIT);
        Ok(())
    }

    /// Everything about the solves that does not depend on the pixels.
    pub(crate) fn plan(&self) -> &Plan {
        &self.plan
    }

    /// What the latest solve did, dispatch by dispatch.
    pub(crate) fn profile(&self) -> Result<Profile, Error> {
        let states = [Slot::EndState, Slot::RegisteredState].map(|slot| self.state(slot));
        let [solved, registered] = states;
        let done = [solved?.levels, registered?.levels];
        let Prepared { script, recording } = self.latest();
        let ran = |d: &Dispatch| Ran {
            pass: d.stage.shader.name,
            place: d.place,
            bytes: d.bytes,
            executed: d.place.executed(d.grid, &done),
        };
        let (dispatches, ends_ms) = (script.dispatches().map(ran).collect(), recording.times()?.ends_ms);
        Ok(Profile { dispatches, ends_ms, phases: self.phases.clone() })
    }

    fn check_frames(&self, frames: [&Frame; 2]) -> Result<(), Error> {
        same_size(frames)?;
        let [width, height] = self.plan.size;
        for (frame, format) in frames.iter().zip(self.plan.formats) {
            let found = [frame.width(), frame.height()];
            if found != self.plan.size || frame.format() != format {
                return Err(Error::Mismatch(format!(
                    "this solver was prepared for {width}x{height} {format:?}, not {}x{} {:?}: prepare another",
                    found[0],
                    found[1],
                    frame.format()
                )));
            }
        }
        Ok(())
    }

    /// The results, out of mapped memory.
    fn collect(&self) -> Result<Solution, Error> {
        let (results, plan) = (self.workspace.buffer(Slot::EndMaps), &self.plan);
        let pixels = plan.size[0] as usize * plan.size[1] as usize;
        let channels = plan.fused_channels();
        let state = self.state(Slot::EndState)?;
        let times = self.latest().recording.times()?;
        let uncertainty: Vec<f32> = results.read(4 * pixels, pixels)?;
        let mut solution = Solution {
            width: plan.size[0],
            height: plan.size[1],
            origin: [0, 0],
            photograph: plan.size,
            relative_blur: results.read(0, pixels)?,
            confidence: uncertainty.iter().map(|&deviation| solution::confidence(deviation)).collect(),
            uncertainty,
            residual: results.read(8 * pixels, pixels)?,
            fused_channels: channels,
            fused: interleave(&results.read::<f32>(12 * pixels, pixels * channels.count() as usize)?, channels),
            transform: state.registration().transform,
            photometric: state.registration().photometric(),
            shading: state.evened(),
            solved: Region { x: 0, y: 0, width: plan.size[0], height: plan.size[1] },
            regularization: state.alpha.into(),
            kernel_shape: (plan.settings.kernel == Kernel::Auto).then(|| state.kernel_shape.into()),
            other_motion: None,
            levels: self.levels(&state, Slot::EndEnergies)?,
            converged: false,
            warnings: Vec::new(),
            valid_fraction: 0.0,
            mean_confidence: 0.0,
            saturated_fraction: 0.0,
            timings: Timings { total_ms: 0.0, gpu_ms: times.total_ms, passes_ms: times.passes_ms },
        };
        // Whether the images overlap is judged before a mask, which may be small, leaves most of them out.
        solution.judge(&state, &plan.settings);
        if let Some(mask) = &self.mask {
            solution.leave_out(mask);
            solution.count(plan.settings.max_relative_blur);
        }
        if !plan.solves_transform() {
            solution.doubt(&self.collect_registered()?);
        } else if solution.converged {
            solution.other_motion = self.other_motion(&state)?;
        }
        Ok(solution)
    }

    /// The registration, out of mapped memory.
    fn collect_registered(&self) -> Result<Registered, Error> {
        let state = self.state(Slot::RegisteredState)?;
        let times = self.latest().recording.times()?;
        let mut registered = Registered {
            width: self.plan.size[0],
            height: self.plan.size[1],
            transform: state.registration().transform,
            photometric: state.registration().photometric(),
            shading: state.evened(),
            other_motion: None,
            levels: self.levels(&state, Slot::RegisteredEnergies)?,
            converged: false,
            warnings: Vec::new(),
            timings: Timings { total_ms: 0.0, gpu_ms: times.total_ms, passes_ms: times.passes_ms },
        };
        registered.judge(&state);
        if self.plan.solves_transform() && registered.converged {
            registered.other_motion = self.other_motion(&state)?;
        }
        Ok(registered)
    }

    /// What the last sums say of motion models.
    fn other_motion(&self, state: &State) -> Result<Option<OtherMotion>, Error> {
        let (layout, finest) = (Layout::of(true), &self.plan.pyramid[0]);
        let [columns, rows, _] = finest.tiles();
        let floats = (columns * rows) as usize * layout.length;
        let partials: Vec<f32> = self.workspace.buffer(Slot::EndPartials).read(0, floats)?;
        let blocks = partials.chunks_exact(layout.length).map(|row| Sums::from_partials(row, layout)).collect();
        let form = Form::new(blocks, finest.length, finest.centre);
        Ok(form.other(self.plan.settings.motion, &state.registration().transform))
    }

    fn state(&self, slot: Slot) -> Result<State, Error> {
        Ok(self.workspace.buffer(slot).read::<State>(0, 1)?[0])
    }

    /// What the levels did, coarse to fine.
    fn levels(&self, state: &State, energies: Slot) -> Result<Vec<LevelHistory>, Error> {
        let outer = self.plan.settings.outer_iterations as usize;
        let energies: Vec<f32> = self.workspace.buffer(energies).read(0, self.plan.solved * outer)?;
        let levels = self.plan.coarse_to_fine().map(|level| {
            let done = (state.levels[level.index].iterations as usize).min(outer);
            let energy = energies[level.index * outer..][..done].iter().map(|&e| e.into()).collect();
            LevelHistory { width: level.size[0], height: level.size[1], energy }
        });
        Ok(levels.collect())
    }
}

/// A byte for each pixel of I1, 0 where it is left out.
fn mask_bytes(plan: &Plan, mask: Option<&Mask>) -> Vec<u8> {
    let mut bytes = mask.map_or_else(Vec::new, |mask| mask.bytes().to_vec());
    bytes.resize(plan.mask_bytes() as usize, 1);
    bytes
}

/// The channels of the fused image as the results hold them: planes, to be interleaved.
fn interleave(planes: &[f32], channels: Channels) -> Vec<f32> {
    let count = channels.count() as usize;
    let pixels = planes.len() / count;
    (0..pixels).flat_map(|i| (0..count).map(move |c| planes[c * pixels + i])).collect()
}

/// Two images of one pair have one size.
pub(crate) fn same_size([i1, i2]: [&Frame; 2]) -> Result<(), Error> {
    if (i1.width(), i1.height()) == (i2.width(), i2.height()) {
        return Ok(());
    }
    Err(Error::Mismatch(format!(
        "the images differ in size: {}x{} and {}x{}",
        i1.width(),
        i1.height(),
        i2.width(),
        i2.height()
    )))
}
