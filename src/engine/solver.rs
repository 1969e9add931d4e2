//! What an embedding program holds: a size and settings, prepared, and what solves one pair at a time.

use std::sync::Arc;

use crate::base::{CancellationToken, Error, Frame, Mask, Method, PixelFormat, Settings, Shading};
use crate::engine::frame_in_flight::{Common, FrameInFlight, Start};
use crate::engine::plan::Plan;
use crate::engine::profile::{Profile, Reading};
use crate::engine::slot::Slot;
use crate::engine::vulkan::{Clock, Recorder};
use crate::engine::workspace::Workspace;
use crate::engine::{Engine, KeyPoints, Progress, Registered, Solution, SolutionRef};

/// A size and settings, prepared once and used for any number of pairs.
///
/// A solver has one slot, or [as many as are asked for](PairSolver::with_slots): mapped memory for a pair and its results. While the device solves
/// the pair of one, the next is brought up into another, and the results of a third are read:
///
/// ```
/// # use std::time::Duration;
/// # use parfocal::{Engine, EngineOptions, Error, Frame, Settings, PairSolver, Ticket};
/// # fn photograph(soft: f32) -> Frame {
/// #     let value = |i: usize| 0.5 + soft * ((i % 64) as f32 * 1.1).sin() * ((i / 64) as f32 * 0.9).cos();
/// #     Frame::gray(64, 48, (0..64 * 48).map(value).collect()).unwrap()
/// # }
/// # fn main() -> Result<(), Error> {
/// # let pairs: Vec<[Frame; 2]> = [0.1, 0.2, 0.3, 0.4].map(|soft| [photograph(0.4), photograph(soft)]).to_vec();
/// # let mut ranges = Vec::new();
/// let engine = Engine::new(&EngineOptions::default())?;
/// let [i1, i2] = &pairs[0];
/// let formats = [i1.format(), i2.format()];
/// let mut solver = PairSolver::with_slots(2, &engine, [i1.width(), i1.height()], formats, &Settings::default())?;
/// let mut last: Option<Ticket> = None;
/// for (n, [i1, i2]) in pairs.iter().enumerate() {
///     let ticket = solver.submit(n % 2, i1, i2)?;
///     if let Some(view) = last.replace(ticket).map(|last| solver.wait(&last, Duration::MAX)).transpose()?.flatten() {
///         println!("{:?}", view.transform);
/// #       ranges.push(view.relative_blur().len());
///     }
/// }
/// # assert_eq!(ranges.len(), 3);
/// # Ok(())
/// # }
/// ```
pub struct PairSolver {
    pub(super) common: Arc<Common>,
    pub(super) lanes: Vec<FrameInFlight>,
    pub(super) mask: Option<Mask>,
    /// What calls pairs off.
    pub(super) cancel: CancellationToken,
    /// Where pairs start, if not as the settings say.
    start: Option<Start>,
    key_points: Option<KeyPoints>,
}

impl PairSolver {
    /// Prepares for pairs of `width` x `height` pixels, I1 and I2 in the given formats, of frames or as cameras pack them; with clipped or masked pixels, and without: no pair
    /// compiles anything.
    ///
    /// # Errors
    /// [`Error::Setting`], [`Error::TooSmall`], [`Error::TooLarge`], [`Error::Poisoned`], [`Error::Vulkan`].
    pub fn new(
        engine: &Engine,
        width: u32,
        height: u32,
        formats: [impl Into<PixelFormat>; 2],
        settings: &Settings,
    ) -> Result<Self, Error> {
        Self::with_slots(1, engine, [width, height], formats, settings)
    }

    /// The same, with so many slots, at least one.
    ///
    /// # Errors
    /// As [`PairSolver::new`].
    pub fn with_slots(
        slots: usize,
        engine: &Engine,
        size: [u32; 2],
        formats: [impl Into<PixelFormat>; 2],
        settings: &Settings,
    ) -> Result<Self, Error> {
        Self::prepare(slots, engine, size, formats, settings, None, Self::reading(engine))
    }

    /// The same; for pairs with masked or clipped pixels, without, or by `None` for both; and when the device's clock is read.
    pub(crate) fn prepare(
        slots: usize,
        engine: &Engine,
        [width, height]: [u32; 2],
        formats: [impl Into<PixelFormat>; 2],
        settings: &Settings,
        is_masked: Option<bool>,
        reading: Reading,
    ) -> Result<Self, Error> {
        let plan = Plan::new(width, height, formats, settings)?;
        let device = engine.device().clone();
        if device.is_poisoned() {
            return Err(Error::Poisoned);
        }
        engine.admits(&plan, slots.max(1) as u64)?;
        let first = Workspace::new(&device, &plan)?;
        let mut recorder = Recorder::new(&device, Clock::Never)?;
        recorder.initialize(&first.images());
        recorder.finish()?.run()?;
        first.buffer(Slot::Mask).write(&mask_bytes(&plan, None))?;
        let others = (1..slots).map(|_| first.beside(&device, &plan)).collect::<Result<Vec<_>, Error>>()?;
        let common = Arc::new(Common { plan, device, pipelines: engine.pipelines().clone(), reading });
        let workspaces = [first].into_iter().chain(others);
        let lanes = workspaces
            .map(|workspace| FrameInFlight::new(common.clone(), workspace, is_masked))
            .collect::<Result<_, Error>>()?;
        let (cancel, key_points) = (CancellationToken::default(), engine.key_points);
        Ok(Self { common, lanes, mask: None, cancel, start: None, key_points })
    }

    /// Leaves out pixels of I1 in the solves to come; `None`: none. Waits for what is under way.
    ///
    /// # Errors
    /// [`Error::Mismatch`] where the mask is not of the size prepared for, [`Error::Vulkan`].
    pub fn set_mask(&mut self, mask: Option<Mask>) -> Result<(), Error> {
        let plan = &self.common.plan;
        if let Some([width, height]) = mask.as_ref().map(Mask::size).filter(|size| *size != plan.size) {
            let [w, h] = plan.size;
            return Err(Error::Mismatch(format!("the mask is {width}x{height} and the images are {w}x{h}")));
        }
        // Of pairs without a mask, the usual, nothing need go up.
        if self.mask != mask {
            self.lanes.iter_mut().try_for_each(FrameInFlight::rest)?;
            self.lanes[0].mask().write(&mask_bytes(plan, mask.as_ref()))?;
            self.mask = mask;
        }
        Ok(())
    }

    /// What calls the solves to come off. Those that begin after it has are [`Error::Cancelled`] at once.
    pub fn set_cancel(&mut self, cancel: CancellationToken) {
        self.cancel = cancel;
    }

    /// Where the pairs to come start.
    pub(super) fn start_from(&mut self, start: Start) {
        self.start = Some(start);
    }

    /// As was said, or as the settings say; with the method SIFT T starts where key-points put it.
    pub(super) fn start(&self, frames: Option<[&Frame; 2]>) -> Result<Start, Error> {
        if let Some(start) = self.start {
            return Ok(start);
        }
        let settings = &self.common.plan.settings;
        let transform = match (settings.method, frames, self.key_points) {
            (Method::Sift, Some(frames), Some(find)) => find(frames, settings.decode, self.mask.as_ref())?.into(),
            (Method::Sift, ..) => return Err(Error::NoKeyPoints),
            _ => settings.start,
        };
        Ok(Start { transform, photometric: settings.start_photometric, shading: Shading::NONE, kernel_shape: 0.0 })
    }

    /// Prepares for pairs like this one: if it has clipped pixels, for pairs that have some. The first of the other kind compiles what it takes.
    ///
    /// # Errors
    /// As [`PairSolver::new`], and [`Error::Mismatch`] where the sizes differ.
    pub fn for_pair(engine: &Engine, i1: &Frame, i2: &Frame, settings: &Settings) -> Result<Self, Error> {
        same_size([i1, i2])?;
        let (size, formats) = ([i1.width(), i1.height()], [i1.format(), i2.format()]);
        let clips = [i1, i2].iter().any(|frame| frame.has_clipped_pixels(settings.clipped(frame.format().depth)));
        Self::prepare(1, engine, size, formats, settings, Some(clips), Self::reading(engine))
    }

    fn reading(engine: &Engine) -> Reading {
        if engine.timed { Reading::Passes } else { Reading::Never }
    }

    /// Solves one pair.
    ///
    /// # Errors
    /// [`Error::Mismatch`] where a frame is not of the size and format prepared for, [`Error::NoKeyPoints`] or what they failed of with the
    /// method SIFT, [`Error::Cancelled`], [`Error::Timeout`], [`Error::Poisoned`], [`Error::Vulkan`].
    pub fn solve(&mut self, i1: &Frame, i2: &Frame) -> Result<Solution, Error> {
        self.solve_with(i1, i2, &mut |_| ())
    }

    /// Solves one pair and tells after each level how far it has come.
    ///
    /// # Errors
    /// As [`PairSolver::solve`].
    pub fn solve_with(
        &mut self,
        i1: &Frame,
        i2: &Frame,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Solution, Error> {
        self.bring_frames(i1, i2)?;
        self.lanes[0].run(|script| script.parts.len(), progress)?;
        Ok(self.lanes[0].view(self.mask.as_ref())?.to_owned())
    }

    /// Solves one pair, and lends the results.
    ///
    /// # Errors
    /// As [`PairSolver::solve`].
    pub fn solve_in_place(&mut self, i1: &Frame, i2: &Frame) -> Result<SolutionRef<'_>, Error> {
        self.bring_frames(i1, i2)?;
        self.lanes[0].run(|script| script.parts.len(), &mut |_| ())?;
        self.lanes[0].view(self.mask.as_ref())
    }

    /// Registers one pair and does no more than that takes: for the method appearance no blur is solved for, for SIFT
    /// and aligned only exposure and correlation are measured on the device.
    ///
    /// # Errors
    /// As [`PairSolver::solve`].
    pub fn register(&mut self, i1: &Frame, i2: &Frame) -> Result<Registered, Error> {
        self.register_with(i1, i2, &mut |_| ())
    }

    /// Registers one pair and tells after each level how far it has come.
    ///
    /// # Errors
    /// As [`PairSolver::solve`].
    pub fn register_with(
        &mut self,
        i1: &Frame,
        i2: &Frame,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Registered, Error> {
        self.bring_frames(i1, i2)?;
        self.lanes[0].run(|script| script.registered, progress)?;
        self.lanes[0].registered()
    }

    /// Everything about the solves that does not depend on the pixels.
    pub(crate) fn plan(&self) -> &Plan {
        &self.common.plan
    }

    /// What the latest solve did, dispatch by dispatch.
    pub(crate) fn profile(&self) -> Result<Profile, Error> {
        self.lanes[0].profile()
    }
}

/// A byte for each pixel of I1, 0 where it is left out.
fn mask_bytes(plan: &Plan, mask: Option<&Mask>) -> Vec<u8> {
    let mut bytes = mask.map_or_else(Vec::new, |mask| mask.bytes().to_vec());
    bytes.resize(plan.mask_bytes() as usize, 1);
    bytes
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
