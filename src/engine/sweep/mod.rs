//! The joint solve of a focus sweep: u of each pixel, and the registration of all frames.
//!
//! u is the focus setting at which a pixel is sharp. Section 11 of `docs/method.md`. The device holds the frames, one
//! blur stack at a time, and the linear system that all pairs of frames add to. Between iterations the host steps the
//! parameters that all pixels share: T of each frame, and c. So nothing can be submitted ahead as it is for pairs, and
//! a sweep has no `submit`.

mod device;
mod pairs;
mod parts;
mod pyramid;
mod spacing;
mod start;
#[cfg(test)]
mod tests;
mod uncertainty;
mod validity;

use std::time::Duration;

use self::device::Limits;
use self::pairs::MAX_RELATIVE_BLUR;
use self::parts::PartSolver;
use self::pyramid::{PyramidSolver, RELAXATION_SWEEPS, SharedParameters};
use self::validity::ExcludedPixels;
use crate::base::{
    Brightness, CancellationToken, Channels, Deadline, Decode, Depth, Error, Format, Frame, Homography, Mask,
    Photometric, Progress, Settings,
};
use crate::engine::Engine;
use crate::engine::plan::Plan;

/// The largest distance of a kernel's mean from its origin, px at a variance of 1 px². Measured kernels are off by some
/// of it.
const MAX_KERNEL_MEAN: f64 = 0.1;
/// Bytes of the device beyond which the finest level is solved in parts.
const MEMORY: u64 = 4 << 30;

/// The focus settings, the reference and the mask of a sweep.
pub struct SweepInput<'a> {
    /// The focus settings of the frames, ascending, about one step apart.
    pub settings: &'a [f64],
    /// Whether the settings are known. If not, those that the sweep itself shows are used where it shows that they are
    /// uneven.
    pub are_settings_known: bool,
    /// The frame on whose pixels the results are.
    pub reference: usize,
    /// Which pixels of the reference count.
    pub mask: Option<&'a Mask>,
}

/// The registration of a sweep's frames.
#[derive(Clone, Debug, PartialEq)]
pub struct JointRegistration {
    /// Maps the reference's pixels to those of each frame.
    pub transforms: Vec<Homography>,
    /// Maps the brightness of each frame to the reference's.
    pub brightness: Vec<Brightness>,
    /// c, px² of variance by squared settings.
    pub rate: f64,
    /// The focus settings of the frames, as stated or as found.
    pub settings: Vec<f64>,
}

/// The result of a joint solve.
#[derive(Clone, Debug)]
pub struct JointSolution {
    /// u at each pixel of the reference, in settings.
    pub focus: Vec<f32>,
    /// The standard deviation of u, in settings; NaN where no pair contributes.
    pub deviation: Vec<f32>,
    /// The registration of the frames.
    pub registration: JointRegistration,
}

/// A solver for sweeps of one size, format and number of frames, prepared once and used for any number of them.
pub struct JointSolver {
    settings: Settings,
    size: [u32; 2],
    timeout: Duration,
    /// Solves the photographs or, if there are parts, the photographs at half their size.
    whole: PyramidSolver,
    parts: Option<PartSolver>,
}

impl JointSolver {
    /// Prepares for sweeps of `frames` frames.
    ///
    /// # Errors
    /// As [`PairSolver::new`](crate::PairSolver::new); [`Error::Mismatch`] for a kernel that is not symmetric.
    pub fn new(
        engine: &Engine,
        size: [u32; 2],
        format: Format,
        frames: usize,
        settings: &Settings,
    ) -> Result<Self, Error> {
        Self::within(MEMORY, engine, size, format, frames, settings)
    }

    /// The same within `memory` bytes of the device.
    fn within(
        memory: u64,
        engine: &Engine,
        size: [u32; 2],
        format: Format,
        frames: usize,
        settings: &Settings,
    ) -> Result<Self, Error> {
        let [right, down] = settings.kernel.mean();
        if right.hypot(down) > MAX_KERNEL_MEAN {
            let name = settings.kernel.name();
            return Err(Error::Mismatch(format!(
                "the kernel {name} is not centred: behind the focus of a sweep it would lie mirrored; choose a symmetric kernel"
            )));
        }
        let (timeout, max_relative_blur) = (engine.timeout(), settings.max_relative_blur.min(MAX_RELATIVE_BLUR));
        let decode = settings.decode.resolved([format.depth]);
        let settings = Settings { max_relative_blur, relaxation_sweeps: RELAXATION_SWEEPS, decode, ..settings.clone() };
        let plan = Plan::new(size[0], size[1], [format; 2], &settings)?;
        let is_small = plan.sweep_bytes(frames as u32) <= memory;
        if is_small && plan.check_sweep(engine.device(), frames as u32).is_ok() || plan.pyramid.len() == 1 {
            let whole = PyramidSolver::new(engine, plan, frames)?;
            return Ok(Self { settings, size, timeout, whole, parts: None });
        }
        let parts = Some(PartSolver::new(engine, &plan, frames, memory / 2)?);
        let max_relative_blur = (max_relative_blur / 4.0).max(1.0);
        let half = Settings { max_relative_blur, decode: Decode::None, levels: None, ..settings.clone() };
        let format = Format { channels: Channels::Gray, depth: Depth::F32 };
        let plan = Plan::new(size[0].div_ceil(2), size[1].div_ceil(2), [format; 2], &half)?;
        Ok(Self { settings, size, timeout, whole: PyramidSolver::new(engine, plan, frames)?, parts })
    }

    /// Solves a sweep; `report` is called after each level and part.
    ///
    /// # Errors
    /// [`Error::Cancelled`], [`Error::Timeout`], [`Error::Poisoned`], [`Error::Vulkan`].
    pub fn solve(
        &mut self,
        frames: &[Frame],
        input: &SweepInput<'_>,
        cancel: &CancellationToken,
        report: &mut dyn FnMut(Progress),
    ) -> Result<JointSolution, Error> {
        let mut sizes: Vec<_> = self.whole.levels().iter().map(|level| level.size).collect();
        sizes.extend(self.parts.iter().flat_map(PartSolver::sizes));
        let mut done = counter(&sizes, report);
        self.set_limits(cancel);
        let (mut shared, excluded) = self.descend(frames, input, &mut done)?;
        let [focus, deviation] = match &mut self.parts {
            None => {
                let fields = self.whole.finish(&mut shared, &excluded)?;
                done(self.size);
                fields
            }
            Some(parts) => {
                let finest = self.whole.finest().clone();
                let coarse = self.whole.focus(&finest)?;
                parts.solve(frames, input.mask, &coarse, &shared, &mut done)?
            }
        };
        Ok(JointSolution {
            focus: focus.data.iter().map(|u| (u + shared.middle) as f32).collect(),
            deviation: deviation.to_f32(),
            registration: self.registration(shared),
        })
    }

    /// Registers a sweep, with the same result as [`solve`](Self::solve): T and c stay on the finest level, which is
    /// left out.
    ///
    /// # Errors
    /// As [`solve`](Self::solve).
    pub fn register(
        &mut self,
        frames: &[Frame],
        input: &SweepInput<'_>,
        cancel: &CancellationToken,
        report: &mut dyn FnMut(Progress),
    ) -> Result<JointRegistration, Error> {
        let skipped = usize::from(self.parts.is_none());
        let sizes: Vec<_> = self.whole.levels()[skipped..].iter().map(|level| level.size).collect();
        let mut done = counter(&sizes, report);
        self.set_limits(cancel);
        let (shared, _) = self.descend(frames, input, &mut done)?;
        Ok(self.registration(shared))
    }

    /// Begins the time limit of a solve, which all its parts share.
    fn set_limits(&mut self, cancel: &CancellationToken) {
        let limits = Limits { cancel: cancel.clone(), deadline: Deadline::after(self.timeout) };
        self.whole.set_limits(limits.clone());
        if let Some(parts) = &mut self.parts {
            parts.set_limits(limits);
        }
    }

    /// Solves all levels but the finest of the photographs; u stays on the device.
    fn descend(
        &mut self,
        frames: &[Frame],
        input: &SweepInput<'_>,
        level_done: &mut dyn FnMut([u32; 2]),
    ) -> Result<(SharedParameters, ExcludedPixels), Error> {
        let levels = self.whole.levels().len() + usize::from(self.parts.is_some());
        let excluded = ExcludedPixels::new(frames, input.mask, &self.settings, levels);
        if self.parts.is_none() {
            self.whole.upload(frames.iter())?;
            let shared = self.whole.descend(input, &excluded, 1, level_done)?;
            return Ok((shared, excluded));
        }
        let excluded = excluded.halved();
        self.whole.upload(parts::halved(frames, &self.settings)?.iter())?;
        let shared = self.whole.descend(input, &excluded, 0, level_done)?;
        Ok((parts::doubled(&shared, self.size), excluded))
    }

    fn registration(&self, shared: SharedParameters) -> JointRegistration {
        let of = |&(gain, shading): &_| Brightness {
            photometric: Photometric { gain, offset: 0.0 },
            shading,
            ..Brightness::identity(self.size)
        };
        JointRegistration {
            brightness: shared.brightness.iter().map(of).collect(),
            transforms: shared.transforms,
            rate: shared.rate,
            settings: shared.settings,
        }
    }
}

/// Reports the progress over levels and parts of these sizes, each time that it is called with the size of one that is
/// done.
fn counter<'a>(sizes: &[[u32; 2]], report: &'a mut dyn FnMut(Progress)) -> impl FnMut([u32; 2]) + use<'a> {
    let pixels = |[width, height]: [u32; 2]| f64::from(width) * f64::from(height);
    let (total, all): (_, f64) = (sizes.len() as u32, sizes.iter().copied().map(pixels).sum());
    let (mut done, mut pixels_done) = (0, 0.0);
    move |size| {
        done += 1;
        pixels_done += pixels(size);
        report(Progress { done, total, share: pixels_done / all });
    }
}
