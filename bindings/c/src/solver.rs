//! Solvers of pairs, and the options of a solve.

use std::ffi::c_void;
use std::sync::Arc;

use parfocal::frame::{Channels, Samples};
use parfocal::{Engine, Frame, Mask, PairSolver, Region, Settings, SolveOptions};

use crate::cancel::{control, parfocal_cancellation_token, parfocal_progress};
use crate::engine::parfocal_engine;
use crate::fault::{Fault, call, parfocal_status};
use crate::handle::{free, get, get_mut, give, slice};
use crate::image::{frame, parfocal_image};
use crate::settings::{CallerSettings, parfocal_settings};
use crate::sized::{Versioned, read};
use crate::solution::parfocal_solution;

/// A solver of pairs. It keeps memory and recorded work for pairs of the last size and format.
pub struct parfocal_solver {
    engine: Arc<Engine>,
    caller_settings: CallerSettings,
    solver: Option<PairSolver>,
}

/// A rectangle of pixels.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_region {
    /// Left edge, px.
    pub x: u32,
    /// Upper edge, px.
    pub y: u32,
    /// Width, px.
    pub width: u32,
    /// Height, px.
    pub height: u32,
}

impl From<parfocal_region> for Region {
    fn from(parfocal_region { x, y, width, height }: parfocal_region) -> Self {
        Self { x, y, width, height }
    }
}

/// The options of one solve: region, mask, cropping, progress and cancellation.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_solve_options {
    /// sizeof(parfocal_solve_options).
    pub size: usize,
    /// The part of I1, or of the reference frame, to solve. Width 0: all of it.
    pub region: parfocal_region,
    /// One byte per pixel of I1, row by row without gaps; pixels with 0 do not count. NULL: all pixels count.
    pub mask: *const u8,
    /// Not 0: crop results to the largest rectangle in which V is valid everywhere.
    pub crop_valid: i32,
    /// Called with the share done; may be NULL.
    pub progress: parfocal_progress,
    /// Passed to progress.
    pub context: *mut c_void,
    /// Token that cancels the solve from another thread; may be NULL.
    pub cancel: *const parfocal_cancellation_token,
}

// SAFETY: `repr(C)`, integers and pointers, the size first.
unsafe impl Versioned for parfocal_solve_options {
    const NAME: &'static str = "parfocal_solve_options";

    fn start() -> Self {
        let region = parfocal_region { x: 0, y: 0, width: 0, height: 0 };
        let (mask, context, cancel) = (std::ptr::null(), std::ptr::null_mut(), std::ptr::null());
        Self { size: size_of::<Self>(), region, mask, crop_valid: 0, progress: None, context, cancel }
    }
}

/// Converts the options of a solve of `i1`.
///
/// # Safety
/// The C contract holds for `from`, and its mask has the size of `i1`.
pub(crate) unsafe fn solve_options(from: *const parfocal_solve_options, i1: &Frame) -> Result<SolveOptions, Fault> {
    // SAFETY: by the C contract.
    let stated = if from.is_null() { parfocal_solve_options::start() } else { unsafe { read(from) }? };
    // SAFETY: by the C contract, a handle or NULL, and a function that may be called with `context`.
    let control = unsafe { control(stated.progress, stated.context, stated.cancel) }?;
    let region = Some(stated.region).filter(|region| region.width != 0).map(Region::from);
    // SAFETY: by the C contract the mask has one byte per pixel.
    let mask = unsafe { mask(stated.mask, [i1.width(), i1.height()]) }?;
    Ok(SolveOptions { region, mask, crop_valid: stated.crop_valid != 0, ..control })
}

/// Converts a mask of this size.
///
/// # Safety
/// `from` is NULL, or points to one byte per pixel.
pub(crate) unsafe fn mask(from: *const u8, [width, height]: [u32; 2]) -> Result<Option<Mask>, Fault> {
    if from.is_null() {
        return Ok(None);
    }
    // SAFETY: guaranteed by the caller.
    let counts = unsafe { slice(from, width as usize * height as usize, "mask") }?;
    let white = counts.iter().map(|&counts| if counts == 0 { 0 } else { 255 }).collect();
    let picture = Frame::new(width, height, Channels::Gray, Samples::U8(white)).map_err(Fault::argument)?;
    Ok(Some(Mask::from_image(&picture)))
}

/// Makes a solver. settings may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_solver_new(
    engine: *const parfocal_engine,
    settings: *const parfocal_settings,
    solver: *mut *mut parfocal_solver,
) -> parfocal_status {
    let make = || {
        // SAFETY: by the C contract.
        let (engine, caller_settings) =
            unsafe { (get(engine, "engine")?.engine.clone(), CallerSettings::read(settings)?) };
        Ok(parfocal_solver { engine, caller_settings, solver: None })
    };
    // SAFETY: by the C contract.
    call(|| unsafe { give(solver, make) })
}

/// Solves a pair. options may be NULL. The first pair of a size and format takes longer.
///
/// A pair that does not converge is no error: the solution has converged 0, and its warnings say why.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_solver_solve(
    solver: *mut parfocal_solver,
    i1: *const parfocal_image,
    i2: *const parfocal_image,
    options: *const parfocal_solve_options,
    solution: *mut *mut parfocal_solution,
) -> parfocal_status {
    let make = || {
        // SAFETY: by the C contract.
        let (solver, i1, i2) = unsafe { (get_mut(solver, "solver")?, frame(i1, "i1")?, frame(i2, "i2")?) };
        // SAFETY: by the C contract.
        let options = unsafe { solve_options(options, &i1) }?;
        let settings = solver.caller_settings.resolved_for(&[&i1, &i2]);
        let solved = solver.with(&settings)?.solve([&i1, &i2], &options)?;
        Ok(parfocal_solution::solved(solved, &settings))
    };
    // SAFETY: by the C contract.
    call(|| unsafe { give(solution, make) })
}

/// Registers a pair. The fields of the solution are NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_solver_register(
    solver: *mut parfocal_solver,
    i1: *const parfocal_image,
    i2: *const parfocal_image,
    solution: *mut *mut parfocal_solution,
) -> parfocal_status {
    let make = || {
        // SAFETY: by the C contract.
        let (solver, i1, i2) = unsafe { (get_mut(solver, "solver")?, frame(i1, "i1")?, frame(i2, "i2")?) };
        solver.register(&i1, &i2)
    };
    // SAFETY: by the C contract.
    call(|| unsafe { give(solution, make) })
}

impl parfocal_solver {
    fn register(&mut self, i1: &Frame, i2: &Frame) -> Result<parfocal_solution, Fault> {
        let settings = self.caller_settings.resolved_for(&[i1, i2]);
        let registered = self.with(&settings)?.register([i1, i2], &SolveOptions::default())?;
        Ok(parfocal_solution::registered(registered, &settings))
    }

    /// Returns the solver with these settings, made on the first call.
    fn with(&mut self, settings: &Settings) -> Result<&mut PairSolver, Fault> {
        let mut solver = match self.solver.take() {
            Some(solver) => solver,
            None => PairSolver::new(&self.engine, settings)?,
        };
        solver.set_settings(settings)?;
        Ok(self.solver.insert(solver))
    }
}

/// Frees a solver. Its solutions stay valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_solver_free(solver: *mut parfocal_solver) {
    // SAFETY: by the C contract.
    unsafe { free(solver) };
}

/// Checks what the header says about threads.
const _: () = {
    const fn may_move<T: Send>() {}
    const fn may_be_shared<T: Send + Sync>() {}
    may_be_shared::<parfocal_engine>();
    may_move::<parfocal_solver>();
    may_be_shared::<parfocal_solution>();
};
