//! What of a pair is solved, and what is done to it before and after.

use crate::base::{CancellationToken, Error, Format, Frame, Mask, Region, Settings, centre};
use crate::engine::{Engine, PairSolver, Progress, Solution, large, same_size};
use crate::solve::FieldCurvature;

/// A part of the frame, a mask, and what is known of the lens; nothing of it by default.
#[derive(Clone, Debug, Default)]
pub struct SolveOptions {
    /// The part of I1 that results are wanted of, px.
    pub region: Option<Region>,
    /// Which pixels of I1 count.
    pub mask: Option<Mask>,
    /// Of the same size as the photographs: what a flat target showed, to be taken from V.
    pub flat: Option<FieldCurvature>,
    /// Whether results are cropped to the largest rectangle in which V is valid everywhere.
    pub crop_valid: bool,
    /// What calls the solve off.
    pub cancel: CancellationToken,
}

/// A solver that is kept for pairs like the last one.
pub struct SolverCache {
    size: [u32; 2],
    formats: [Format; 2],
    settings: Settings,
    solver: PairSolver,
}

impl SolveOptions {
    /// The largest pair, px: of one that the device does not hold, results and photographs take some 8 GiB of the host.
    pub const MOST_PIXELS: u64 = large::MOST_PIXELS;

    /// Checks it against photographs of this size.
    ///
    /// # Errors
    /// [`Error::Region`]: the region is not within them. [`Error::Mismatch`]: mask or flat reference are of another size.
    pub fn check(&self, size: [u32; 2]) -> Result<(), Error> {
        let [width, height] = size;
        let of_size = |what: &str, found: Option<[u32; 2]>| match found {
            Some([w, h]) if [w, h] != size => {
                Err(Error::Mismatch(format!("the {what} is {w}x{h} and the photographs are {width}x{height}")))
            }
            _ => Ok(()),
        };
        of_size("mask", self.mask.as_ref().map(Mask::size))?;
        of_size("flat reference", self.flat.as_ref().map(FieldCurvature::size))?;
        self.region.map_or(Ok(()), |region| region.check((width, height)))
    }

    /// Solves a pair, with the solver kept if it fits; one that is too large for the device, or for [`EngineOptions::memory`](crate::EngineOptions::memory), in parts,
    /// with T and brightness as half its size has them. `origin`, `width` and `height` of what comes back say which part of I1 it is
    /// of.
    ///
    /// # Errors
    /// As [`SolveOptions::check`], [`PairSolver::for_pair`] and [`PairSolver::solve`].
    pub fn solve(
        &self,
        engine: &Engine,
        kept: &mut Option<SolverCache>,
        [i1, i2]: [&Frame; 2],
        settings: &Settings,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Solution, Error> {
        same_size([i1, i2])?;
        let size = [i1.width(), i1.height()];
        self.check(size)?;
        let mut solution = match self.region {
            None => self.solve_all(engine, kept, [i1, i2], settings, self.mask.clone(), progress)?,
            Some(region) => {
                let part = region.expanded(margin(size, settings), size);
                let [a, b] = [i1.cropped(part).map_err(Error::Region)?, i2.cropped(part).map_err(Error::Region)?];
                let start = settings.start.about(centre(size[0], size[1]), part.centre());
                let settings = Settings { start, ..settings.clone() };
                let mask = self.mask.as_ref().map(|mask| mask.cropped(part));
                let mut solution = self.solve_all(engine, kept, [&a, &b], &settings, mask, progress)?;
                solution.place_in(part, size);
                solution.crop(Region { x: region.x - part.x, y: region.y - part.y, ..region })?;
                solution
            }
        };
        if self.crop_valid {
            match solution.largest_valid() {
                Some(valid) => solution.crop(valid)?,
                None => solution.warnings.push("no pixel is valid: nothing was cropped".to_string()),
            }
        }
        // Before V is changed: its limit is that of the blur in the photographs.
        solution.count(settings.max_relative_blur);
        if let Some(flat) = &self.flat {
            flat.flatten(&mut solution, settings.max_relative_blur);
        }
        Ok(solution)
    }

    /// Solves photographs of which all counts but for the mask.
    fn solve_all(
        &self,
        engine: &Engine,
        kept: &mut Option<SolverCache>,
        [i1, i2]: [&Frame; 2],
        settings: &Settings,
        mask: Option<Mask>,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Solution, Error> {
        let (size, formats) = ([i1.width(), i1.height()], [i1.format(), i2.format()]);
        if engine.needs_parts(size, formats, settings)? {
            // What is kept would take of the memory that parts are made for.
            *kept = None;
            return large::solve(engine, [i1, i2], settings, mask.as_ref(), &self.cancel, progress);
        }
        let fits = |kept: &SolverCache| kept.size == size && kept.formats == formats && kept.settings == *settings;
        let solver = match kept.take().filter(fits) {
            Some(kept) => kept.solver,
            None => PairSolver::for_pair(engine, i1, i2, settings)?,
        };
        let SolverCache { solver, .. } = kept.insert(SolverCache { size, formats, settings: settings.clone(), solver });
        solver.set_mask(mask)?;
        solver.set_cancel(self.cancel.clone());
        solver.solve_with(i1, i2, progress)
    }
}

/// What is solved around a region, so that V is valid up to its borders: the widest blur window, and two hundredths of
/// the frame for the displacement.
pub(super) fn margin([width, height]: [u32; 2], settings: &Settings) -> u32 {
    (3.0 * settings.max_relative_blur.sqrt() + 0.02 * f64::from(width.max(height))).ceil() as u32
}
