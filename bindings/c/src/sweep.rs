//! Focus sweeps: options, solve, results.

use std::ffi::{CString, c_char, c_void};

use parfocal::sweep::{Positions, Sweep, SweepOptions};
use parfocal::{Frame, SweepSolver};

use crate::engine::parfocal_engine;
use crate::fault::{Fault, call, parfocal_status};
use crate::handle::{free, get, give, slice, slice_mut};
use crate::image::{frame, parfocal_image};
use crate::settings::{CallerSettings, matrix_rows, parfocal_settings};
use crate::sized::{Versioned, read, write};
use crate::solution::{Resampling, apply, c_strings, nth};
use crate::solver::{parfocal_solve_options, solve_options};

/// The result of a focus sweep.
pub struct parfocal_sweep {
    sweep: Sweep,
    warnings: Vec<CString>,
}

/// The unit of focus positions.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub enum parfocal_position_unit {
    /// Steps of the focus setting, in any unit that is linear in 1/distance.
    PARFOCAL_UNIT_STEPS = 0,
    /// Focus distances from the lens, mm.
    PARFOCAL_UNIT_DISTANCES = 1,
    /// Positions of the plane in focus on a stage, mm from any origin.
    PARFOCAL_UNIT_STAGE = 2,
}

/// The options of a focus sweep.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_sweep_options {
    /// sizeof(parfocal_sweep_options).
    pub size: usize,
    /// Focus position of each frame, ascending or descending. NULL: 0, 1, 2, ..., corrected if the frames show uneven steps.
    pub positions: *const f64,
    /// A parfocal_position_unit.
    pub unit: u32,
    /// The frame whose pixels the results have, counted from 0. -1: the middle frame.
    pub reference: i32,
}

// SAFETY: `repr(C)`, integers and a pointer, the size first.
unsafe impl Versioned for parfocal_sweep_options {
    const NAME: &'static str = "parfocal_sweep_options";

    fn start() -> Self {
        Self { size: size_of::<Self>(), positions: std::ptr::null(), unit: 0, reference: -1 }
    }
}

/// The numbers and fields of a sweep. Fields have width x height values, row by row without gaps. They live as long as the
/// sweep.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_sweep_view {
    /// sizeof(parfocal_sweep_view).
    pub size: usize,
    /// Pixels per row.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// Pixel x, y of the reference at the first value of the fields.
    pub origin: [u32; 2],
    /// Number of solved frames. A frame that occurs twice is left out.
    pub frames: u32,
    /// Index of the reference among the solved frames, from 0.
    pub reference: u32,
    /// Number of warnings.
    pub warnings: u32,
    /// Channels of fused, 1 or 3.
    pub fused_channels: u32,
    /// The focus setting at which each pixel is sharp, for distances in 1/m; NaN where it is not measured.
    pub focus: *const f32,
    /// Standard deviation of focus.
    pub uncertainty: *const f32,
    /// Depth, mm; NULL unless positions are in mm.
    pub depth: *const f32,
    /// Standard deviation of depth, mm.
    pub deviation: *const f32,
    /// -1 where the focus is before the first frame, 1 where it is beyond the last, else 0.
    pub beyond: *const i8,
    /// The all-in-focus image, intensities, interleaved.
    pub fused: *const f32,
    /// The frame that each pixel of fused comes from, counted from 1.
    pub frame: *const u16,
    /// Growth of the blur variance, px², with the squared distance from focus in settings.
    pub blur_rate: f64,
}

// SAFETY: `repr(C)`, numbers and pointers, the size first.
unsafe impl Versioned for parfocal_sweep_view {
    const NAME: &'static str = "parfocal_sweep_view";

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

/// Solves a focus sweep: three or more frames of one size and format, in the order of their focus. settings, options and solve
/// may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_sweep_solve(
    engine: *const parfocal_engine,
    frames: *const parfocal_image,
    count: usize,
    settings: *const parfocal_settings,
    options: *const parfocal_sweep_options,
    solve: *const parfocal_solve_options,
    sweep: *mut *mut parfocal_sweep,
) -> parfocal_status {
    let make = || {
        // SAFETY: by the C contract.
        let (engine, caller_settings) = unsafe { (get(engine, "engine")?, CallerSettings::read(settings)?) };
        // SAFETY: by the C contract there are `count` images.
        let frames = unsafe { self::frames(frames, count) }?;
        let first = frames.first().ok_or_else(|| Fault::argument("there are no frames: give three or more"))?;
        let all: Vec<&Frame> = frames.iter().collect();
        // SAFETY: by the C contract.
        let (positions, reference, solve) =
            unsafe { (positions(options, count)?, reference(options)?, solve_options(solve, first)?) };
        let options = SweepOptions { settings: caller_settings.resolved_for(&all), positions, reference };
        let sweep = SweepSolver::new(&engine.engine, &options)?.solve(&frames, &solve)?;
        Ok(parfocal_sweep { warnings: c_strings(&sweep.warnings), sweep })
    };
    // SAFETY: by the C contract.
    call(|| unsafe { give(sweep, make) })
}

/// Copies the frames of a sweep.
///
/// # Safety
/// `at` is NULL, or points to `count` images, which are as far apart as the first states its size.
unsafe fn frames(at: *const parfocal_image, count: usize) -> Result<Vec<Frame>, Fault> {
    // SAFETY: by the C contract.
    let step = unsafe { read(at) }?.size;
    // SAFETY: the images are as far apart as the caller's version of the struct is large.
    let image = |n: usize| unsafe { frame(at.cast::<u8>().add(n * step).cast(), &format!("frame {}", n + 1)) };
    (0..count).map(image).collect()
}

/// # Safety
/// The C contract holds for `options`.
unsafe fn positions(options: *const parfocal_sweep_options, count: usize) -> Result<Positions, Fault> {
    if options.is_null() {
        return Ok(Positions::Counted);
    }
    // SAFETY: by the C contract.
    let stated = unsafe { read(options) }?;
    if stated.positions.is_null() {
        return Ok(Positions::Counted);
    }
    // SAFETY: by the C contract there is one position per frame.
    let positions = unsafe { slice(stated.positions, count, "positions") }?.to_vec();
    match stated.unit {
        0 => Ok(Positions::Settings(positions)),
        1 => Ok(Positions::Distances(positions)),
        2 => Ok(Positions::Stage(positions)),
        n => Err(Fault::argument(format!("unit is {n}: give a parfocal_position_unit"))),
    }
}

/// # Safety
/// The C contract holds for `options`.
unsafe fn reference(options: *const parfocal_sweep_options) -> Result<Option<usize>, Fault> {
    if options.is_null() {
        return Ok(None);
    }
    // SAFETY: by the C contract.
    match unsafe { read(options) }?.reference {
        -1 => Ok(None),
        n => usize::try_from(n)
            .map(Some)
            .map_err(|_| Fault::argument(format!("reference is {n}: give -1 or the index of a frame"))),
    }
}

/// Fills in the view of a sweep. view->size must be set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_sweep_get(
    sweep: *const parfocal_sweep,
    view: *mut parfocal_sweep_view,
) -> parfocal_status {
    call(|| {
        // SAFETY: by the C contract.
        let handle = unsafe { get(sweep, "sweep") }?;
        let sweep = &handle.sweep;
        let depth = sweep.depth.as_ref();
        let filled = parfocal_sweep_view {
            width: sweep.width,
            height: sweep.height,
            origin: [sweep.region.x, sweep.region.y],
            frames: sweep.transforms.len() as u32,
            reference: sweep.reference as u32,
            warnings: handle.warnings.len() as u32,
            fused_channels: sweep.fused_channels.count(),
            focus: sweep.focus.as_ptr(),
            uncertainty: sweep.uncertainty.as_ptr(),
            depth: depth.map_or(std::ptr::null(), |depth| depth.depth.as_ptr()),
            deviation: depth.map_or(std::ptr::null(), |depth| depth.deviation.as_ptr()),
            beyond: sweep.beyond.as_ptr(),
            fused: sweep.fused.as_ptr(),
            frame: sweep.frames.as_ptr(),
            blur_rate: sweep.blur_rate,
            ..parfocal_sweep_view::start()
        };
        // SAFETY: by the C contract.
        unsafe { write(view, filled) }
    })
}

/// Writes T of a frame, counted from 0: nine numbers, row by row, for points in px from the image centre. T maps pixels of the
/// reference to the frame.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_sweep_transform(
    sweep: *const parfocal_sweep,
    frame: u32,
    transform: *mut f64,
) -> parfocal_status {
    call(|| {
        // SAFETY: by the C contract.
        let (sweep, out) = unsafe { (get(sweep, "sweep")?, slice_mut(transform, 9, "transform")?) };
        out.copy_from_slice(&matrix_rows(&sweep.sweep.transforms[nth_frame(sweep, frame)?]));
        Ok(())
    })
}

/// Writes the parallax of a frame, counted from 0, of a camera that moved: two numbers, to the right and downwards, px per setting.
/// What is in focus at u is displaced by (u - m) times this before T, m being the middle between the first and the last position.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_sweep_parallax(
    sweep: *const parfocal_sweep,
    frame: u32,
    parallax: *mut f64,
) -> parfocal_status {
    call(|| {
        // SAFETY: by the C contract.
        let (sweep, out) = unsafe { (get(sweep, "sweep")?, slice_mut(parallax, 2, "parallax")?) };
        out.copy_from_slice(&sweep.sweep.parallax[nth_frame(sweep, frame)?]);
        Ok(())
    })
}

/// Resamples another photograph, taken like one frame, onto the pixels of the results, as parfocal_solution_apply. frame counts
/// from 0.
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
        // SAFETY: by the C contract.
        let (handle, image) = unsafe { (get(sweep, "sweep")?, crate::image::frame(image, "image")?) };
        let (n, sweep) = (nth_frame(handle, frame)?, &handle.sweep);
        let resampling = Resampling {
            brightness: sweep.brightness[n],
            decode: sweep.decode,
            photograph: sweep.photograph,
            region: sweep.region,
        };
        // SAFETY: by the C contract.
        unsafe { apply(&resampling, &sweep.transforms[n], &image, exposure != 0, out, bytes) }
    })
}

fn nth_frame(sweep: &parfocal_sweep, frame: u32) -> Result<usize, Fault> {
    let (n, count) = (frame as usize, sweep.sweep.transforms.len());
    (n < count)
        .then_some(n)
        .ok_or_else(|| Fault::argument(format!("frame is {n}, and there are {count} frames, counted from 0")))
}

/// Returns a warning, counted from 0, as a UTF-8 sentence; NULL beyond the last. Valid until the sweep is freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_sweep_warning(sweep: *const parfocal_sweep, index: u32) -> *const c_char {
    // SAFETY: by the C contract.
    unsafe { get(sweep, "sweep") }.map_or(std::ptr::null(), |sweep| nth(&sweep.warnings, index))
}

/// Frees a sweep and its fields.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_sweep_free(sweep: *mut parfocal_sweep) {
    // SAFETY: by the C contract.
    unsafe { free(sweep) };
}
