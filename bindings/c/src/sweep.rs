//! Focus sweeps.

use std::ffi::{CString, c_char, c_void};

use parfocal::sweep::{Positions, Sweep, SweepOptions};
use parfocal::{Frame, SweepSolver};

use crate::engine::parfocal_engine;
use crate::fault::{Fault, call, parfocal_status};
use crate::handle::{free, get, give, slice, slice_mut};
use crate::image::{frame, parfocal_image};
use crate::settings::{Told, flat, parfocal_settings};
use crate::sized::{Versioned, read, write};
use crate::solution::{Moved, apply, nth, sentences};
use crate::solver::{parfocal_scope, scope};

/// What was found of a focus sweep.
pub struct parfocal_sweep {
    sweep: Sweep,
    warnings: Vec<CString>,
}

/// What positions are.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub enum parfocal_positions {
    /// Settings in any unit that is even in 1/distance.
    PARFOCAL_SETTINGS = 0,
    /// Distances from the lens at which it is focused, mm.
    PARFOCAL_DISTANCES = 1,
    /// Where a stage puts the plane in focus, mm from any origin.
    PARFOCAL_STAGE = 2,
}

/// How a sweep is solved.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_sweep_options {
    /// sizeof(parfocal_sweep_options).
    pub size: usize,
    /// What each frame is focused at, ascending or descending; NULL: counted from 0, evenly unless the sweep says otherwise.
    pub positions: *const f64,
    /// A parfocal_positions.
    pub unit: u32,
    /// The frame on whose pixels the results are, counted from 0; -1: the middle one.
    pub reference: i32,
}

// SAFETY: integers and a pointer, the size first.
unsafe impl Versioned for parfocal_sweep_options {
    const NAME: &'static str = "parfocal_sweep_options";

    fn start() -> Self {
        Self { size: size_of::<Self>(), positions: std::ptr::null(), unit: 0, reference: -1 }
    }
}

/// What was found of a sweep: fields are row by row without gaps, width x height, and live as long as the sweep.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_sweep_found {
    /// sizeof(parfocal_sweep_found).
    pub size: usize,
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The pixel of the reference that is the first of the fields.
    pub origin: [u32; 2],
    /// How many frames were solved: one that was there twice is left out.
    pub frames: u32,
    /// The reference among them, from 0.
    pub reference: u32,
    /// How many warnings there are.
    pub warnings: u32,
    /// Channels of fused, 1 or 3.
    pub fused_channels: u32,
    /// The setting at which each pixel is in focus, 1/m of distances; NaN where none is known.
    pub focus: *const f32,
    /// Its standard deviation.
    pub uncertainty: *const f32,
    /// Depth, mm, where positions are in mm; else NULL.
    pub depth: *const f32,
    /// Its standard deviation, mm.
    pub deviation: *const f32,
    /// -1 where the focus lies before the first frame, 1 beyond the last, else 0.
    pub beyond: *const i8,
    /// The image sharp all over, intensities, interleaved.
    pub fused: *const f32,
    /// The frame that each pixel of it is of, from 1.
    pub frame: *const u16,
    /// By how many px² of variance blur grows with the squared distance from the focus, in settings.
    pub blur_rate: f64,
}

// SAFETY: numbers and pointers, the size first.
unsafe impl Versioned for parfocal_sweep_found {
    const NAME: &'static str = "parfocal_sweep_found";

    fn start() -> Self {
        let none = std::ptr::null();
        Self {
            size: size_of::<Self>(),
            width: 0,
            height: 0,
            origin: [0; 2],
            frames: 0,
            reference: 0,
            warnings: 0,
            fused_channels: 0,
            focus: none,
            uncertainty: none,
            depth: none,
            deviation: none,
            beyond: std::ptr::null(),
            fused: none,
            frame: std::ptr::null(),
            blur_rate: f64::NAN,
        }
    }
}

/// Solves a focus sweep of three or more frames of one size and format, in the order of their focus; settings, options and scope
/// may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_stack(
    engine: *const parfocal_engine,
    frames: *const parfocal_image,
    count: usize,
    settings: *const parfocal_settings,
    options: *const parfocal_sweep_options,
    scope: *const parfocal_scope,
    sweep: *mut *mut parfocal_sweep,
) -> parfocal_status {
    let make = || {
        // SAFETY: the contract is the same.
        let (engine, told) = unsafe { (get(engine, "engine")?, Told::read(settings)?) };
        // SAFETY: the header asks for so many images.
        let frames = unsafe { self::frames(frames, count) }?;
        let first = frames.first().ok_or_else(|| Fault::argument("there are no frames"))?;
        let all: Vec<&Frame> = frames.iter().collect();
        // SAFETY: the contract is the same.
        let (positions, reference, scope) =
            unsafe { (positions(options, count)?, reference(options)?, self::scope(scope, first)?) };
        let options = SweepOptions { settings: told.of(&all), positions, reference };
        let sweep = SweepSolver::new(&engine.engine, &options)?.solve(&frames, &scope)?;
        Ok(parfocal_sweep { warnings: sentences(&sweep.warnings), sweep })
    };
    // SAFETY: the contract is the same.
    call(|| unsafe { give(sweep, make) })
}

/// Copies the frames.
///
/// # Safety
/// `at` is NULL, or begins `count` images as the header describes them, as far apart as the first states its size.
unsafe fn frames(at: *const parfocal_image, count: usize) -> Result<Vec<Frame>, Fault> {
    // SAFETY: the contract is the same.
    let step = unsafe { read(at) }?.size;
    // SAFETY: images of a caller of another version lie as far apart as that has them.
    let image = |n: usize| unsafe { frame(at.cast::<u8>().add(n * step).cast(), &format!("frame {}", n + 1)) };
    (0..count).map(image).collect()
}

/// # Safety
/// `options` is NULL, or as the header says.
unsafe fn positions(options: *const parfocal_sweep_options, count: usize) -> Result<Positions, Fault> {
    if options.is_null() {
        return Ok(Positions::Counted);
    }
    // SAFETY: the contract is the same.
    let asked = unsafe { read(options) }?;
    if asked.positions.is_null() {
        return Ok(Positions::Counted);
    }
    // SAFETY: the header asks for one a frame.
    let stated = unsafe { slice(asked.positions, count, "positions") }?.to_vec();
    match asked.unit {
        0 => Ok(Positions::Settings(stated)),
        1 => Ok(Positions::Distances(stated)),
        2 => Ok(Positions::Stage(stated)),
        n => Err(Fault::argument(format!("unit is {n}: give a parfocal_positions"))),
    }
}

/// # Safety
/// `options` is NULL, or as the header says.
unsafe fn reference(options: *const parfocal_sweep_options) -> Result<Option<usize>, Fault> {
    if options.is_null() {
        return Ok(None);
    }
    // SAFETY: the contract is the same.
    match unsafe { read(options) }?.reference {
        -1 => Ok(None),
        n => usize::try_from(n).map(Some).map_err(|_| Fault::argument(format!("there is no reference frame {n}"))),
    }
}

/// Fills in what was found; found->size must be set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_sweep_get(
    sweep: *const parfocal_sweep,
    found: *mut parfocal_sweep_found,
) -> parfocal_status {
    call(|| {
        // SAFETY: the contract is the same.
        let kept = unsafe { get(sweep, "sweep") }?;
        let sweep = &kept.sweep;
        let depth = sweep.depth.as_ref();
        let filled = parfocal_sweep_found {
            width: sweep.width,
            height: sweep.height,
            origin: [sweep.region.x, sweep.region.y],
            frames: sweep.transforms.len() as u32,
            reference: sweep.reference as u32,
            warnings: kept.warnings.len() as u32,
            fused_channels: sweep.fused_channels.count(),
            focus: sweep.focus.as_ptr(),
            uncertainty: sweep.uncertainty.as_ptr(),
            depth: depth.map_or(std::ptr::null(), |depth| depth.depth.as_ptr()),
            deviation: depth.map_or(std::ptr::null(), |depth| depth.deviation.as_ptr()),
            beyond: sweep.beyond.as_ptr(),
            fused: sweep.fused.as_ptr(),
            frame: sweep.frames.as_ptr(),
            blur_rate: sweep.blur_rate,
            ..parfocal_sweep_found::start()
        };
        // SAFETY: the contract is the same.
        unsafe { write(found, filled) }
    })
}

/// Where the pixels of the reference lie in a frame, counted from 0: T by rows, nine numbers, of points from the image centre, px.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_sweep_transform(
    sweep: *const parfocal_sweep,
    frame: u32,
    transform: *mut f64,
) -> parfocal_status {
    call(|| {
        // SAFETY: the contract is the same.
        let (sweep, out) = unsafe { (get(sweep, "sweep")?, slice_mut(transform, 9, "transform")?) };
        out.copy_from_slice(&flat(&sweep.sweep.transforms[nth_frame(sweep, frame)?]));
        Ok(())
    })
}

/// Brings another photograph of a frame, counted from 0, onto the pixels of the results, as parfocal_solution_apply does.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_sweep_apply(
    sweep: *const parfocal_sweep,
    frame: u32,
    image: *const parfocal_image,
    exposure: i32,
    out: *mut c_void,
    bytes: usize,
) -> parfocal_status {
    call(|| {
        // SAFETY: the contract is the same.
        let (kept, image) = unsafe { (get(sweep, "sweep")?, crate::image::frame(image, "image")?) };
        let (n, sweep) = (nth_frame(kept, frame)?, &kept.sweep);
        let moved = Moved {
            brightness: sweep.brightness[n],
            decode: sweep.decode,
            photograph: sweep.photograph,
            region: sweep.region,
        };
        // SAFETY: the contract is the same.
        unsafe { apply(&moved, &sweep.transforms[n], &image, exposure != 0, out, bytes) }
    })
}

fn nth_frame(sweep: &parfocal_sweep, frame: u32) -> Result<usize, Fault> {
    let (n, count) = (frame as usize, sweep.sweep.transforms.len());
    (n < count).then_some(n).ok_or_else(|| Fault::argument(format!("there is no frame {n}: there are {count}")))
}

/// A warning, counted from 0, a sentence of UTF-8; NULL where there is none. Valid until the sweep is freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_sweep_warning(sweep: *const parfocal_sweep, index: u32) -> *const c_char {
    // SAFETY: the contract is the same.
    unsafe { get(sweep, "sweep") }.map_or(std::ptr::null(), |sweep| nth(&sweep.warnings, index))
}

/// Frees a sweep, and the fields with it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_sweep_free(sweep: *mut parfocal_sweep) {
    // SAFETY: the contract is the same.
    unsafe { free(sweep) };
}
