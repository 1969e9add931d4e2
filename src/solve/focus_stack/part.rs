//! A part of the frames, and what of it has results.

use super::order::{Order, judge};
use super::{LEAST, Positions, Sweep, SweepOptions, check, position, solve_whole};
use crate::base::{Brightness, Error, Frame, Homography, Mask, Region, centre};
use crate::engine::Engine;
use crate::solve::SolveOptions;
use crate::solve::pair_solver::margin;

/// Solves a sweep, or the part of it that its scope names. Frames that stand in the wrong place or are there twice are put in order, as
/// [`Sweep::order`] and a warning say, where that is certain and no positions are stated.
///
/// # Errors
/// [`Error::Mismatch`]: fewer than three frames, sizes or formats that differ, positions or a mask that do not fit.
/// [`Error::Region`]: the part is not within the frames.
/// Those of [`PairSolver::for_size`](crate::PairSolver::for_size) and [`PairSolver::solve`](crate::PairSolver::solve).
pub fn solve_sweep(engine: &Engine, frames: &[Frame], options: &SweepOptions) -> Result<Sweep, Error> {
    let solve = |frames: &[Frame], options: &SweepOptions| solve_scope(engine, frames, options);
    let (mut sweep, order) = in_order(frames, options, solve)?;
    let told = position::told(&options.positions, &sweep.positions, &order.frames);
    sweep.warnings.splice(..0, order.warnings.into_iter().chain(told));
    sweep.order = order.frames;
    Ok(sweep)
}

/// What is done with frames once they are checked and in order.
pub(super) fn in_order<T>(
    frames: &[Frame],
    options: &SweepOptions,
    solve: impl FnOnce(&[Frame], &SweepOptions) -> Result<T, Error>,
) -> Result<(T, Order), Error> {
    check(frames, options)?;
    options.scope.check([frames[0].width(), frames[0].height()])?;
    let order = judge(frames, options.positions != Positions::Counted);
    if order.frames.iter().copied().eq(0..frames.len()) {
        return Ok((solve(frames, options)?, order));
    }
    if order.frames.len() < LEAST {
        return Err(Error::Mismatch(format!(
            "only {} of the frames differ: {LEAST} or more make a sweep",
            order.frames.len()
        )));
    }
    let ordered: Vec<Frame> = order.frames.iter().map(|n| frames[*n].clone()).collect();
    let place = |given: usize| {
        let same = |n: &usize| *n == given || frames[*n].samples() == frames[given].samples();
        order.frames.iter().position(same)
    };
    let within = SweepOptions { reference: options.reference.and_then(place), ..options.clone() };
    Ok((solve(&ordered, &within)?, order))
}

/// The part of the reference that is solved where one is asked for, the frames cut to it, and how these are solved.
pub(super) fn cut(
    frames: &[Frame],
    options: &SweepOptions,
) -> Result<Option<(Region, Vec<Frame>, SweepOptions)>, Error> {
    let (scope, size) = (&options.scope, [frames[0].width(), frames[0].height()]);
    let Some(region) = scope.region else { return Ok(None) };
    let part = region.grown(margin(size, &options.settings), size);
    let cut = frames.iter().map(|frame| frame.cropped(part).map_err(Error::Region));
    let cut = cut.collect::<Result<Vec<Frame>, Error>>()?;
    let mask = scope.mask.as_ref().map(|mask| mask.cropped(part));
    let (cancel, progress) = (scope.cancel.clone(), scope.progress.clone());
    let scope = SolveOptions { mask, cancel, progress, ..SolveOptions::default() };
    let within = SweepOptions { scope, ..options.clone() };
    Ok(Some((part, cut, within)))
}

/// Solves frames that are in order.
fn solve_scope(engine: &Engine, frames: &[Frame], options: &SweepOptions) -> Result<Sweep, Error> {
    let (scope, size) = (&options.scope, [frames[0].width(), frames[0].height()]);
    let mut sweep = match (scope.region, cut(frames, options)?) {
        (Some(region), Some((part, cut, within))) => {
            let mut sweep = solve_whole(engine, &cut, &within)?;
            sweep.place_in(part, size);
            sweep.crop(Region { x: region.x - part.x, y: region.y - part.y, ..region });
            sweep
        }
        _ => solve_whole(engine, frames, options)?,
    };
    if let Some(mask) = &scope.mask {
        sweep.leave_out(&mask.cropped(sweep.region));
    }
    if scope.crop_valid {
        match sweep.largest_valid() {
            Some(valid) => sweep.crop(valid),
            None => sweep.warnings.push("no pixel is valid: nothing was cropped".to_string()),
        }
    }
    sweep.depth = sweep.stated.depth(&sweep.focus, &sweep.uncertainty);
    Ok(sweep)
}

/// States what was found of a part about the centre of the whole frames.
pub(super) fn restate(
    transforms: &mut [Homography],
    brightness: &mut [Brightness],
    part: Region,
    photograph: [u32; 2],
) {
    let (from, to) = (part.centre(), centre(photograph[0], photograph[1]));
    transforms.iter_mut().for_each(|transform| *transform = transform.about(from, to));
    for brightness in brightness {
        brightness.part.x += part.x;
        brightness.part.y += part.y;
    }
}

impl Sweep {
    /// Says that what was solved is a part of larger frames, and states the transforms about their centre.
    fn place_in(&mut self, part: Region, photograph: [u32; 2]) {
        restate(&mut self.transforms, &mut self.brightness, part, photograph);
        (self.region, self.photograph) = (part, photograph);
    }

    /// Keeps a part of the results, which must be within them.
    fn crop(&mut self, part: Region) {
        let row = self.width as usize;
        for field in [&mut self.focus, &mut self.uncertainty] {
            *field = part.of(field, row, 1);
        }
        self.beyond = part.of(&self.beyond, row, 1);
        self.frames = part.of(&self.frames, row, 1);
        self.fused = part.of(&self.fused, row, self.fused_channels.count() as usize);
        self.region = Region { x: self.region.x + part.x, y: self.region.y + part.y, ..part };
        (self.width, self.height) = (part.width, part.height);
    }

    /// Makes nothing of what a mask leaves out.
    fn leave_out(&mut self, mask: &Mask) {
        for (pixel, _) in mask.bytes().iter().enumerate().filter(|(_, counts)| **counts == 0) {
            (self.focus[pixel], self.uncertainty[pixel], self.beyond[pixel]) = (f32::NAN, f32::NAN, 0);
        }
    }

    /// The largest rectangle in which the focus is known everywhere; `None` where no pixel's is.
    fn largest_valid(&self) -> Option<Region> {
        let valid: Vec<bool> = self.focus.iter().map(|u| u.is_finite()).collect();
        Region::largest(&valid, self.width as usize)
    }
}
