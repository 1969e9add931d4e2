//! Solves of pairs.

use std::ffi::c_void;
use std::sync::Arc;

use parfocal::frame::{Channels, Samples};
use parfocal::{Engine, Frame, Mask, PairSolver, Region, Settings, SolveOptions};

use crate::cancel::{control, parfocal_cancel, parfocal_progress};
use crate::engine::parfocal_engine;
use crate::fault::{Fault, call, parfocal_status};
use crate::handle::{free, get, get_mut, give, slice};
use crate::image::{frame, parfocal_image};
use crate::settings::{Told, parfocal_settings};
use crate::sized::{Versioned, read};
use crate::solution::parfocal_solution;

/// Settings, and what is kept from one pair for the next: memory and the recorded work of pairs of one size and format.
pub struct parfocal_solver {
    engine: Arc<Engine>,
    told: Told,
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
    /// Px.
    pub width: u32,
    /// Px.
    pub height: u32,
}

impl From<parfocal_region> for Region {
    fn from(parfocal_region { x, y, width, height }: parfocal_region) -> Self {
        Self { x, y, width, height }
    }
}

/// What of a pair is solved, who is told how far it is, and what calls it off.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_scope {
    /// sizeof(parfocal_scope).
    pub size: usize,
    /// The part of I1 that results are wanted of; of a width of 0: all.
    pub region: parfocal_region,
    /// A byte a pixel of I1, row by row without gaps, 0 where a pixel is left out; NULL leaves out none.
    pub mask: *const u8,
    /// Not 0 crops results to the largest rectangle in which V is valid everywhere.
    pub crop_valid: i32,
    /// Is told how far the call is; NULL: nobody.
    pub progress: parfocal_progress,
    /// What that is called with.
    pub context: *mut c_void,
    /// What calls the call off, from another thread; NULL: nothing.
    pub cancel: *const parfocal_cancel,
}

// SAFETY: integers and a pointer, the size first.
unsafe impl Versioned for parfocal_scope {
    const NAME: &'static str = "parfocal_scope";

    fn start() -> Self {
        let region = parfocal_region { x: 0, y: 0, width: 0, height: 0 };
        let (mask, context, cancel) = (std::ptr::null(), std::ptr::null_mut(), std::ptr::null());
        Self { size: size_of::<Self>(), region, mask, crop_valid: 0, progress: None, context, cancel }
    }
}

/// The options of a solve of photographs such as this.
///
/// # Safety
/// `from` is NULL, or as the header says, the mask of this photograph's size.
pub(crate) unsafe fn scope(from: *const parfocal_scope, i1: &Frame) -> Result<SolveOptions, Fault> {
    // SAFETY: the contract is the same.
    let asked = if from.is_null() { parfocal_scope::start() } else { unsafe { read(from) }? };
    // SAFETY: the header asks for a handle, and for what may be called.
    let control = unsafe { control(asked.progress, asked.context, asked.cancel) }?;
    let region = Some(asked.region).filter(|region| region.width != 0).map(Region::from);
    let mask = match asked.mask.is_null() {
        true => None,
        false => {
            let pixels = i1.width() as usize * i1.height() as usize;
            // SAFETY: the header asks for a byte a pixel.
            let counts = unsafe { slice(asked.mask, pixels, "mask") }?;
            let white = counts.iter().map(|&counts| if counts == 0 { 0 } else { 255 }).collect();
            let picture = Frame::new(i1.width(), i1.height(), Channels::Gray, Samples::U8(white));
            Some(Mask::from_image(&picture.map_err(Fault::argument)?))
        }
    };
    Ok(SolveOptions { region, mask, crop_valid: asked.crop_valid != 0, ..control })
}

/// Prepares for pairs; settings may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_solver_new(
    engine: *const parfocal_engine,
    settings: *const parfocal_settings,
    solver: *mut *mut parfocal_solver,
) -> parfocal_status {
    let make = || {
        // SAFETY: the contract is the same.
        let (engine, told) = unsafe { (get(engine, "engine")?.engine.clone(), Told::read(settings)?) };
        Ok(parfocal_solver { engine, told, solver: None })
    };
    // SAFETY: the contract is the same.
    call(|| unsafe { give(solver, make) })
}

/// Solves a pair; scope may be NULL. A pair of another size or format than the last takes longer.
///
/// A pair that can be read but not solved is no error: it is a solution that has not converged, whose warnings say why.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_solver_solve(
    solver: *mut parfocal_solver,
    i1: *const parfocal_image,
    i2: *const parfocal_image,
    scope: *const parfocal_scope,
    solution: *mut *mut parfocal_solution,
) -> parfocal_status {
    let make = || {
        // SAFETY: the contract is the same.
        let (solver, i1, i2) = unsafe { (get_mut(solver, "solver")?, frame(i1, "i1")?, frame(i2, "i2")?) };
        // SAFETY: the contract is the same.
        let options = unsafe { self::scope(scope, &i1) }?;
        let settings = solver.told.of(&[&i1, &i2]);
        let solved = solver.with(&settings)?.solve([&i1, &i2], &options)?;
        Ok(parfocal_solution::solved(solved, &settings))
    };
    // SAFETY: the contract is the same.
    call(|| unsafe { give(solution, make) })
}

/// Registers a pair: a solution without fields, which are NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_solver_register(
    solver: *mut parfocal_solver,
    i1: *const parfocal_image,
    i2: *const parfocal_image,
    solution: *mut *mut parfocal_solution,
) -> parfocal_status {
    let make = || {
        // SAFETY: the contract is the same.
        let (solver, i1, i2) = unsafe { (get_mut(solver, "solver")?, frame(i1, "i1")?, frame(i2, "i2")?) };
        solver.register(&i1, &i2)
    };
    // SAFETY: the contract is the same.
    call(|| unsafe { give(solution, make) })
}

impl parfocal_solver {
    fn register(&mut self, i1: &Frame, i2: &Frame) -> Result<parfocal_solution, Fault> {
        let settings = self.told.of(&[i1, i2]);
        let registered = self.with(&settings)?.register([i1, i2], &SolveOptions::default())?;
        Ok(parfocal_solution::registered(registered, &settings))
    }

    /// The solver, with these settings.
    fn with(&mut self, settings: &Settings) -> Result<&mut PairSolver, Fault> {
        let mut solver = match self.solver.take() {
            Some(solver) => solver,
            None => PairSolver::new(&self.engine, settings)?,
        };
        solver.set_settings(settings)?;
        Ok(self.solver.insert(solver))
    }
}

/// Frees a solver; its solutions live on.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_solver_free(solver: *mut parfocal_solver) {
    // SAFETY: the contract is the same.
    unsafe { free(solver) };
}

/// What the header says of threads.
const _: () = {
    const fn may_move<T: Send>() {}
    const fn may_be_shared<T: Send + Sync>() {}
    may_be_shared::<parfocal_engine>();
    may_move::<parfocal_solver>();
    may_be_shared::<parfocal_solution>();
};
