//! A focus sweep as one solve: one unknown a pixel, the setting u at which it is in focus, by all pairs of frames that tell of it, and
//! the registration of all frames, jointly. Section 11 of `docs/method.md`.
//!
//! The device holds the frames, one stack of blurred images at a time, and the system that all pairs add up to ([`joint`]). Between
//! iterations the host steps what is [`common`] to all pixels: the registrations, by the [graph] of pairs, and c. Of large photographs
//! the finest level is solved by [`parts`].

mod common;
mod deviation;
mod graph;
mod hidden;
mod joint;
mod pairs;
mod parts;
mod shown;
mod spacing;
mod start;
#[cfg(test)]
mod tests;

use std::time::Duration;

use self::common::Common;
use self::hidden::Hidden;
use self::joint::{Joint, LIMIT, SWEEPS};
use self::parts::Parts;
use crate::base::{
    Brightness, CancellationToken, Channels, Deadline, Decode, Depth, Error, Format, Frame, Homography, Mask,
    Photometric, Settings,
};
use crate::engine::Engine;
use crate::engine::plan::Plan;

/// How far aside the mean of a kernel may lie, px at a variance of 1 px²: pictures of kernels have it somewhere.
const ASIDE: f64 = 0.1;
/// Bytes that a sweep takes of a device at most before its finest level is solved by parts.
const BUDGET: u64 = 4 << 30;

/// What is asked of a sweep besides its frames.
pub struct Asked<'a> {
    /// What the frames are focused at, ascending, about a step apart.
    pub settings: &'a [f64],
    /// Whether that is known. Else it is what the sweep itself says, where it says that the settings are others.
    pub known: bool,
    /// The frame on whose pixels the results are.
    pub reference: usize,
    /// Which of its pixels count.
    pub mask: Option<&'a Mask>,
}

/// Where a scene is in focus, and where the frames lie.
#[derive(Clone, Debug)]
pub struct Focus {
    /// u at each pixel of the reference, in settings.
    pub focus: Vec<f32>,
    /// Its standard deviation, in settings; NaN where no pair tells.
    pub deviation: Vec<f32>,
    /// Where the reference's pixels lie in each frame.
    pub transforms: Vec<Homography>,
    /// What brings each frame to the reference's brightness.
    pub brightness: Vec<Brightness>,
    /// c: px² of variance by squared settings.
    pub rate: f64,
    /// What the frames are focused at: what was known or taken, or what the sweep says.
    pub settings: Vec<f64>,
}

/// Where the frames of a sweep lie, as [`Focus`] has it.
#[derive(Clone, Debug)]
pub struct RegisteredFrames {
    /// Where the reference's pixels lie in each frame.
    pub transforms: Vec<Homography>,
    /// What brings each frame to the reference's brightness.
    pub brightness: Vec<Brightness>,
    /// c: px² of variance by squared settings.
    pub rate: f64,
    /// What the frames are focused at: what was known or taken, or what the sweep says.
    pub settings: Vec<f64>,
}

/// A size and a number of frames, prepared for sweeps.
pub struct SweepSolver {
    settings: Settings,
    size: [u32; 2],
    timeout: Duration,
    /// Of the photographs; where there are parts, of half their size.
    joint: Joint,
    parts: Option<Parts>,
}

impl SweepSolver {
    /// Prepares for sweeps of so many frames of `width` x `height` pixels.
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
        Self::within(BUDGET, engine, size, format, frames, settings)
    }

    /// The same within so many bytes of the device.
    fn within(
        budget: u64,
        engine: &Engine,
        size: [u32; 2],
        format: Format,
        frames: usize,
        settings: &Settings,
    ) -> Result<Self, Error> {
        let [right, down] = settings.kernel.mean();
        if right.hypot(down) > ASIDE {
            let name = settings.kernel.name();
            return Err(Error::Mismatch(format!(
                "the kernel {name} has its mean aside, and frames of a sweep are blurred to either side of their focus, where it lies mirrored; \
                 take a symmetric one"
            )));
        }
        let (timeout, max_relative_blur) = (engine.timeout(), settings.max_relative_blur.min(LIMIT));
        let decode = settings.decode.resolved([format.depth]);
        let settings = Settings { max_relative_blur, sweeps: SWEEPS, decode, ..settings.clone() };
        let plan = Plan::new(size[0], size[1], [format; 2], &settings)?;
        let is_small = plan.sweep_bytes(frames as u32) <= budget;
        if is_small && plan.check_sweep(engine.device(), frames as u32).is_ok() || plan.pyramid.len() == 1 {
            return Ok(Self { settings, size, timeout, joint: Joint::new(engine, plan, frames)?, parts: None });
        }
        let parts = Parts::new(engine, &plan, frames, budget / 2)?;
        let max_relative_blur = (max_relative_blur / 4.0).max(1.0);
        let half = Settings { max_relative_blur, decode: Decode::None, levels: None, ..settings.clone() };
        let format = Format { channels: Channels::Gray, depth: Depth::F32 };
        let plan = Plan::new(size[0].div_ceil(2), size[1].div_ceil(2), [format; 2], &half)?;
        Ok(Self { settings, size, timeout, joint: Joint::new(engine, plan, frames)?, parts: Some(parts) })
    }

    /// What calls the solves to come off.
    pub fn set_cancel(&mut self, cancel: &CancellationToken) {
        self.joint.cancel = cancel.clone();
        if let Some(parts) = &mut self.parts {
            parts.set_cancel(cancel);
        }
    }

    /// Solves a sweep; `say` is told how many of its levels and parts are done.
    ///
    /// # Errors
    /// [`Error::Cancelled`], [`Error::Timeout`], [`Error::Poisoned`], [`Error::Vulkan`].
    pub fn solve(
        &mut self,
        frames: &[Frame],
        asked: &Asked<'_>,
        say: &mut dyn FnMut(usize, usize),
    ) -> Result<Focus, Error> {
        let (mut done, all) = (0, self.joint.levels() + self.parts.as_ref().map_or(0, Parts::count));
        let mut say = || {
            done += 1;
            say(done, all);
        };
        let (mut common, hidden) = self.descend(frames, asked, &mut say)?;
        let [focus, deviation] = match &mut self.parts {
            None => {
                let found = self.joint.finish(&mut common, &hidden)?;
                say();
                found
            }
            Some(parts) => {
                let coarse = self.joint.focus(self.joint.finest())?;
                parts.solve(frames, asked.mask, &coarse, &common, &mut say)?
            }
        };
        Ok(Focus {
            focus: focus.data.iter().map(|u| (u + common.middle) as f32).collect(),
            deviation: deviation.to_f32(),
            brightness: self.brightness(&common),
            transforms: common.transforms,
            rate: common.rate,
            settings: common.settings,
        })
    }

    /// The registration of a sweep alone, the same as of [`solve`](Self::solve): T and c stay on the finest level, which is left out.
    ///
    /// # Errors
    /// As [`solve`](Self::solve).
    pub fn register(
        &mut self,
        frames: &[Frame],
        asked: &Asked<'_>,
        say: &mut dyn FnMut(usize, usize),
    ) -> Result<RegisteredFrames, Error> {
        let (mut done, all) = (0, self.joint.levels() - usize::from(self.parts.is_none()));
        let mut say = || {
            done += 1;
            say(done, all);
        };
        let (common, _) = self.descend(frames, asked, &mut say)?;
        Ok(RegisteredFrames {
            brightness: self.brightness(&common),
            transforms: common.transforms,
            rate: common.rate,
            settings: common.settings,
        })
    }

    /// Goes down to the level above the finest, where u stays on the device; what does not count on the solver's levels.
    fn descend(
        &mut self,
        frames: &[Frame],
        asked: &Asked<'_>,
        say: &mut dyn FnMut(),
    ) -> Result<(Common, Hidden), Error> {
        // One limit for the whole solve, all parts included.
        self.joint.deadline = Deadline::after(self.timeout);
        if let Some(parts) = &mut self.parts {
            parts.set_deadline(self.joint.deadline);
        }
        let levels = self.joint.levels() + usize::from(self.parts.is_some());
        let hidden = Hidden::of(frames, asked.mask, &self.settings, levels);
        if self.parts.is_none() {
            self.joint.bring_up(frames.iter())?;
            let common = self.joint.descend(asked, &hidden, 1, say)?;
            return Ok((common, hidden));
        }
        let hidden = hidden.halved();
        self.joint.bring_up(parts::halved(frames, &self.settings)?.iter())?;
        let common = self.joint.descend(asked, &hidden, 0, say)?;
        Ok((parts::doubled(&common, self.size), hidden))
    }

    fn brightness(&self, common: &Common) -> Vec<Brightness> {
        let of = |&(gain, shading): &_| Brightness {
            photometric: Photometric { gain, offset: 0.0 },
            shading,
            ..Brightness::unchanged(self.size)
        };
        common.brightness.iter().map(of).collect()
    }
}
