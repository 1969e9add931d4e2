//! The solver for pairs, and the options of a solve.

use std::fmt;
use std::sync::Arc;

use crate::base::{
    CancellationToken, Error, Frame, Kernel, Mask, Method, PixelFormat, Progress, Region, Settings, centre,
};
use crate::engine::interop::{DeviceSource, ExternalCommandBuffer, SemaphoreWait};
use crate::engine::{
    Encoded, Engine, PairOptions, Pending, PreparedSolver, Registered, Solution, Source, parallax_start, parts,
    same_size,
};
use crate::solve::FieldCurvature;

/// Options of the solve of one pair or one focus sweep. The default solves the whole frame, without a mask.
#[derive(Clone, Default)]
pub struct SolveOptions {
    /// The part of I1 to solve, px; `None`: all.
    pub region: Option<Region>,
    /// The pixels of I1 that count.
    pub mask: Option<Mask>,
    /// V of a flat target, which is subtracted from V; it has the size of the photographs. Pairs only.
    pub flat: Option<FieldCurvature>,
    /// Whether to crop the results to the largest rectangle in which they are valid everywhere.
    pub crop_valid: bool,
    /// Cancels the solve.
    pub cancel: CancellationToken,
    /// A function that is called after every few iterations or each part, by the thread that solves.
    pub progress: Option<Arc<dyn Fn(Progress) + Send + Sync>>,
}

impl fmt::Debug for SolveOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { region, mask, flat, crop_valid, cancel, progress } = self;
        f.debug_struct("SolveOptions")
            .field("region", region)
            .field("mask", &mask.as_ref().map(Mask::size))
            .field("flat", &flat.as_ref().map(FieldCurvature::size))
            .field("crop_valid", crop_valid)
            .field("cancel", cancel)
            .field("progress", &progress.is_some())
            .finish()
    }
}

impl SolveOptions {
    /// Checks the options against photographs of this size, px.
    ///
    /// # Errors
    /// [`Error::Region`]: the region is not within the photographs. [`Error::Mismatch`]: mask or flat reference have
    /// another size.
    pub fn check(&self, size: [u32; 2]) -> Result<(), Error> {
        let [width, height] = size;
        let check = |what: &str, found: Option<[u32; 2]>| match found {
            Some([w, h]) if [w, h] != size => {
                Err(Error::Mismatch(format!("the {what} is {w}x{h} and the photographs are {width}x{height}")))
            }
            _ => Ok(()),
        };
        check("mask", self.mask.as_ref().map(Mask::size))?;
        check("flat reference", self.flat.as_ref().map(FieldCurvature::size))?;
        self.region.map_or(Ok(()), |region| region.check((width, height)))
    }

    /// Calls the progress function, if one is set.
    pub(crate) fn report(&self, progress: Progress) {
        if let Some(report) = &self.progress {
            report(progress);
        }
    }

    /// Refuses the options of a part and the corrections, for the operation `what`, which supports only whole fields.
    fn check_whole(&self, what: &str) -> Result<(), Error> {
        if self.region.is_none() && self.flat.is_none() && !self.crop_valid {
            return Ok(());
        }
        Err(Error::Mismatch(format!("{what} takes no region, flat reference or crop_valid: leave them out, or solve")))
    }
}

/// The size, formats and settings for which a solver is prepared.
#[derive(Clone, PartialEq)]
struct Layout {
    size: [u32; 2],
    formats: [PixelFormat; 2],
    settings: Settings,
}

impl Layout {
    fn of([i1, i2]: [&Frame; 2], settings: &Settings) -> Self {
        let formats = [i1, i2].map(|frame| frame.format().into());
        Self { size: [i1.width(), i1.height()], formats, settings: settings.clone() }
    }
}

/// Solves pairs of photographs by one choice of settings.
///
/// The first pair of a size and format prepares memory and recorded passes; later pairs of the same kind reuse them. A
/// solver that is [prepared for a size](PairSolver::for_size) can have several pairs in flight. While the device solves
/// one, the host uploads the next and reads the results of the previous one.
///
/// ```
/// # use parfocal::{Engine, EngineOptions, Error, Frame, PairSolver, Pending, Settings, SolveOptions};
/// # fn photograph(soft: f32) -> Frame {
/// #     let value = |i: usize| 0.5 + soft * ((i % 64) as f32 * 1.1).sin() * ((i / 64) as f32 * 0.9).cos();
/// #     Frame::gray(64, 48, (0..64 * 48).map(value).collect()).unwrap()
/// # }
/// # fn main() -> Result<(), Error> {
/// # let pairs: Vec<[Frame; 2]> = [0.1, 0.2, 0.3, 0.4].map(|soft| [photograph(0.4), photograph(soft)]).to_vec();
/// # let mut lengths = Vec::new();
/// let engine = Engine::new(&EngineOptions::default())?;
/// let formats = pairs[0].each_ref().map(Frame::format);
/// let mut solver = PairSolver::for_size(&engine, [64, 48], formats, 2, &Settings::default())?;
/// let mut last: Option<Pending> = None;
/// for [i1, i2] in &pairs {
///     let pending = solver.submit([i1, i2], &[], &SolveOptions::default())?;
///     if let Some(mut last) = last.replace(pending) {
///         let solution = last.wait()?;
///         println!("{:?}", solution.transform);
/// #       lengths.push(solution.relative_blur().len());
///     }
/// }
/// # assert_eq!(lengths.len(), 3);
/// # Ok(())
/// # }
/// ```
pub struct PairSolver {
    engine: Engine,
    settings: Settings,
    /// The layout of pairs in flight, and their greatest number.
    submits: Option<(Layout, usize)>,
    solving: Option<(Layout, PreparedSolver)>,
    /// The solver for registrations that need no memory for blur.
    registering: Option<(Layout, PreparedSolver)>,
}

impl PairSolver {
    /// The largest pair, px. Results and photographs of a pair that is solved in parts take some 8 GiB of host memory.
    pub const MOST_PIXELS: u64 = parts::MOST_PIXELS;

    /// Makes a solver that prepares itself for the first pair.
    ///
    /// # Errors
    /// [`Error::Setting`].
    pub fn new(engine: &Engine, settings: &Settings) -> Result<Self, Error> {
        settings.check()?;
        let (engine, settings) = (engine.clone(), settings.clone());
        Ok(Self { engine, settings, submits: None, solving: None, registering: None })
    }

    /// Makes a solver and prepares it for pairs like this one. It handles clipped pixels if this pair has some.
    ///
    /// # Errors
    /// [`Error::Mismatch`] where the sizes differ, [`Error::Setting`], [`Error::TooSmall`], [`Error::TooLarge`],
    /// [`Error::Poisoned`], [`Error::Vulkan`].
    pub fn for_frames(engine: &Engine, frames: [&Frame; 2], settings: &Settings) -> Result<Self, Error> {
        let mut solver = Self::new(engine, settings)?;
        same_size(frames)?;
        let layout = Layout::of(frames, settings);
        solver.prepare(frames, &layout)?;
        solver.submits = Some((layout, 1));
        Ok(solver)
    }

    /// Makes a solver and prepares it for pairs of this size in px and these formats of I1 and I2. `frames_in_flight`
    /// (at least 1) is the number of pairs that can be in flight. The solver also handles clipped and masked pixels, so
    /// no pair compiles anything.
    ///
    /// # Errors
    /// As for [`PairSolver::for_frames`]. [`Error::TooLarge`] also for pairs that [`solve`](Self::solve) would solve
    /// in parts.
    pub fn for_size(
        engine: &Engine,
        size: [u32; 2],
        formats: [impl Into<PixelFormat>; 2],
        frames_in_flight: usize,
        settings: &Settings,
    ) -> Result<Self, Error> {
        let mut solver = Self::new(engine, settings)?;
        let layout = Layout { size, formats: formats.map(Into::into), settings: settings.clone() };
        solver.submits = Some((layout, frames_in_flight));
        solver.prepare_to_submit()?;
        Ok(solver)
    }

    /// The settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Changes the settings of later pairs. The next pair prepares the solver again if the settings differ.
    ///
    /// # Errors
    /// [`Error::Setting`].
    pub fn set_settings(&mut self, settings: &Settings) -> Result<(), Error> {
        settings.check()?;
        self.settings.clone_from(settings);
        if let Some((layout, _)) = &mut self.submits {
            layout.settings.clone_from(settings);
        }
        Ok(())
    }

    /// Solves a pair. A pair that is too large for the device, or for
    /// [`EngineOptions::memory`](crate::EngineOptions::memory), is solved in parts, with T and brightness from half its
    /// size. `origin`, `width` and `height` of the solution state the part of I1 that it covers.
    ///
    /// If more than a tenth of the pixels reach the limit of |V| and none is stated, the pair is solved again with the
    /// widest one. [`Findings::max_relative_blur`](crate::results::Findings::max_relative_blur) is the limit in the end.
    ///
    /// # Errors
    /// As for [`PairSolver::for_frames`] and [`SolveOptions::check`]. With the method SIFT, [`Error::NoKeyPoints`] or
    /// the error of the key-point function. [`Error::Busy`] if all frames in flight are in use; [`Error::Cancelled`],
    /// [`Error::Timeout`].
    pub fn solve(&mut self, frames: [&Frame; 2], options: &SolveOptions) -> Result<Solution, Error> {
        same_size(frames)?;
        options.check([frames[0].width(), frames[0].height()])?;
        let settings = self.settings.clone();
        let solution = self.solve_by(&settings, frames, options)?;
        if settings.max_relative_blur.is_some() || solution.saturation().is_none() {
            return Ok(solution);
        }
        let wider = Settings { max_relative_blur: Some(Settings::WIDEST_BLUR), ..settings };
        let mut options = options.clone();
        if let Some(report) = options.progress.take() {
            let half = move |now: Progress| report(Progress { share: 0.5 + 0.5 * now.share, ..now });
            options.progress = Some(Arc::new(half));
        }
        match self.solve_by(&wider, frames, &options) {
            Err(Error::TooLarge { .. }) => Ok(solution),
            Err(error) => Err(error),
            Ok(mut wide) => {
                wide.timings.total_ms += solution.timings.total_ms;
                wide.timings.gpu_ms += solution.timings.gpu_ms;
                Ok(wide)
            }
        }
    }

    /// Solves the part of a pair that the options name.
    fn solve_by(
        &mut self,
        settings: &Settings,
        [i1, i2]: [&Frame; 2],
        options: &SolveOptions,
    ) -> Result<Solution, Error> {
        let (size, mask) = ([i1.width(), i1.height()], Mask::of_frame(i1, options.mask.as_ref()));
        let mask = mask.as_ref();
        let mut solution = match options.region {
            None => self.solve_frames([i1, i2], settings, mask, options)?,
            Some(region) => {
                let part = region.expanded(margin(size, settings.blur_limit()), size);
                let [a, b] = [i1.cropped(part).map_err(Error::Region)?, i2.cropped(part).map_err(Error::Region)?];
                let start = settings.start.about(centre(size[0], size[1]), part.centre());
                let mask = mask.map(|mask| mask.cropped(part));
                let settings = Settings { start, ..settings.clone() };
                let mut solution = self.solve_frames([&a, &b], &settings, mask.as_ref(), options)?;
                solution.place_in(part, size);
                solution.crop(Region { x: region.x - part.x, y: region.y - part.y, ..region })?;
                solution
            }
        };
        if options.crop_valid {
            match solution.largest_valid() {
                Some(valid) => solution.crop(valid)?,
                None => solution.warnings.push("no pixel is valid: nothing was cropped".to_string()),
            }
        }
        if i1 == i2 {
            let problem = "I1 and I2 are the same picture, so that V is 0 everywhere: give two photographs, focused at two distances";
            solution.converged = false;
            solution.warnings.push(problem.to_string());
        }
        // Before the flat reference is subtracted: the limit of |V| applies to the blur in the photographs.
        solution.recount();
        if let Some(flat) = &options.flat {
            flat.flatten(&mut solution);
        }
        Ok(solution)
    }

    /// Registers a pair without computing more than necessary. The method appearance does not solve for blur. SIFT and
    /// aligned only measure exposure and correlation.
    ///
    /// # Errors
    /// As for [`PairSolver::solve`]. [`Error::Mismatch`] for options with a region, flat reference or `crop_valid`.
    pub fn register(&mut self, frames: [&Frame; 2], options: &SolveOptions) -> Result<Registered, Error> {
        same_size(frames)?;
        options.check_whole("register")?;
        options.check([frames[0].width(), frames[0].height()])?;
        let mut settings = self.settings.clone();
        let report = |progress| options.report(progress);
        let mask = Mask::of_frame(frames[0], options.mask.as_ref());
        let pair = PairOptions::new(mask.as_ref(), &options.cancel, &report);
        let prepared;
        if settings.method == Method::Unified {
            prepared = &mut self.solving;
        } else {
            // Blur is not solved for, so it gets no memory.
            (settings.kernel, settings.max_relative_blur) = (Kernel::Gaussian, Some(1.0));
            prepared = &mut self.registering;
        }
        let engine = &self.engine;
        let prepare = |layout: &Layout| PreparedSolver::for_frames(engine, frames, &layout.settings);
        reuse(prepared, Layout::of(frames, &settings), prepare)?.register(frames, pair)
    }

    /// Submits a pair and returns. The device starts the solve after `waits`. On devices without
    /// VK_EXT_conditional_rendering the call blocks until the solve is done. Only the options mask and cancel apply.
    ///
    /// # Errors
    /// As for [`PairSolver::solve`]. [`Error::Busy`] if all frames in flight are in use: drop a [`Pending`] first.
    /// [`Error::Mismatch`] if a source does not have the size and format that the solver was made for.
    /// [`Error::NoKeyPoints`] with the method SIFT, which takes frames only.
    pub fn submit<'a>(
        &mut self,
        sources: [impl Into<Source<'a>>; 2],
        waits: &[SemaphoreWait],
        options: &SolveOptions,
    ) -> Result<Pending, Error> {
        let (solver, pair) = self.prepare_pair(options)?;
        solver.submit(sources.map(Into::into), waits, pair)
    }

    /// Records a solve of photographs on the device into a command buffer of the embedding program. The program may
    /// execute it several times, after each change of the photographs. The contract is that of
    /// [`ExternalCommandBuffer::new`].
    ///
    /// [`Encoded::on_device`] names the buffer of the results, for commands after a barrier.
    ///
    /// # Errors
    /// As for [`PairSolver::submit`].
    pub fn encode(
        &mut self,
        commands: ExternalCommandBuffer,
        sources: [DeviceSource; 2],
        options: &SolveOptions,
    ) -> Result<Encoded, Error> {
        let (solver, pair) = self.prepare_pair(options)?;
        solver.encode(commands, sources, pair)
    }

    /// Solves the whole of two frames.
    fn solve_frames(
        &mut self,
        frames: [&Frame; 2],
        settings: &Settings,
        mask: Option<&Mask>,
        options: &SolveOptions,
    ) -> Result<Solution, Error> {
        let settings = &parallax_start::resolved(frames, settings, mask)?;
        let layout = Layout::of(frames, settings);
        let report = |progress| options.report(progress);
        let pair = PairOptions::new(mask, &options.cancel, &report);
        let Some(solver) = self.prepare(frames, &layout)? else {
            // Frees memory for the parts.
            self.registering = None;
            return parts::solve_pair(&self.engine, frames, settings, pair);
        };
        let solution = solver.solve(frames, pair)?.wait()?.to_owned();
        Ok(solution)
    }

    /// The prepared solver for frames like these; `None` if they are solved in parts.
    fn prepare(&mut self, frames: [&Frame; 2], layout: &Layout) -> Result<Option<&mut PreparedSolver>, Error> {
        if self.solving.as_ref().is_none_or(|(earlier, _)| earlier != layout) {
            self.solving = None;
            let plan = self.engine.plan_whole(layout.size, frames.map(Frame::format), &layout.settings)?;
            let Some(plan) = plan else { return Ok(None) };
            self.solving = Some((layout.clone(), PreparedSolver::of_plan_for(&self.engine, frames, plan)?));
        }
        Ok(self.solving.as_mut().map(|(_, solver)| solver))
    }

    /// The prepared solver for pairs in flight.
    fn prepare_to_submit(&mut self) -> Result<&mut PreparedSolver, Error> {
        let Some((layout, count)) = &self.submits else {
            let problem =
                "pairs in flight have one size and format: make the solver with PairSolver::for_size or for_frames";
            return Err(Error::Mismatch(problem.to_string()));
        };
        let engine = &self.engine;
        reuse(&mut self.solving, layout.clone(), |Layout { size, formats, settings }| {
            PreparedSolver::new(engine, *size, *formats, settings, *count, None, engine.reading())
        })
    }

    fn prepare_pair<'a>(
        &'a mut self,
        options: &'a SolveOptions,
    ) -> Result<(&'a mut PreparedSolver, PairOptions<'a>), Error> {
        options.check_whole("submit")?;
        let solver = self.prepare_to_submit()?;
        options.check(solver.plan().size)?;
        Ok((solver, PairOptions::new(options.mask.as_ref(), &options.cancel, &|_| ())))
    }
}

/// Returns the prepared solver if its layout is the same; otherwise prepares one in its place.
pub(super) fn reuse<L: PartialEq, S>(
    prepared: &mut Option<(L, S)>,
    layout: L,
    prepare: impl FnOnce(&L) -> Result<S, Error>,
) -> Result<&mut S, Error> {
    let solver = match prepared.take().filter(|(earlier, _)| *earlier == layout) {
        Some((_, solver)) => solver,
        None => prepare(&layout)?,
    };
    Ok(&mut prepared.insert((layout, solver)).1)
}

/// The margin around a region that is also solved so that V is valid up to its borders, px: the widest blur window, and
/// 2 % of the longer side for the displacement.
pub(super) fn margin([width, height]: [u32; 2], max_relative_blur: f64) -> u32 {
    (3.0 * max_relative_blur.sqrt() + 0.02 * f64::from(width.max(height))).ceil() as u32
}
