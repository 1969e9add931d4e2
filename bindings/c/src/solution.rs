//! What a solve gives back.

use std::ffi::{CString, c_char, c_void};

use parfocal::{
    Frame, Lens, Region, Settings, Solution,
    frame::Samples,
    metric::MetricDepth,
    resample,
    results::Registered,
    settings::Decode,
    transform::{Brightness, Homography},
};

use crate::fault::{Fault, call, parfocal_status, text};
use crate::handle::{free, get, slice_mut};
use crate::image::{bytes_a_sample, frame, parfocal_image};
use crate::settings::flat;
use crate::sized::{Versioned, read, write};

/// What was found of a pair.
pub struct parfocal_solution {
    found: parfocal_found,
    fields: Option<Solution>,
    warnings: Vec<CString>,
    transform: Homography,
    moved: Moved,
    /// Largest |V|, px².
    limit: f64,
}

/// How other photographs are brought onto results.
pub(crate) struct Moved {
    pub(crate) brightness: Brightness,
    pub(crate) decode: Decode,
    /// Width and height of the photographs.
    pub(crate) photograph: [u32; 2],
    /// The part of them that results are of.
    pub(crate) region: Region,
}

/// What was found of a pair: fields are row by row without gaps, width x height, and live as long as the solution.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_found {
    /// sizeof(parfocal_found).
    pub size: usize,
    /// Pixels a row of the fields; of a registration, of the photographs.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The pixel of I1 that is the first of the fields: (0, 0) unless they were cropped.
    pub origin: [u32; 2],
    /// Whether the solve settled on an answer that the images support: 1 or 0.
    pub converged: u32,
    /// How many warnings there are.
    pub warnings: u32,
    /// V, px² of I1, positive where I2 is the more blurred; NaN where not valid. NULL of a registration, as the next four.
    pub relative_blur: *const f32,
    /// Standard deviation of V, px²; 1000 where the images say nothing, NaN where V is.
    pub uncertainty: *const f32,
    /// 0 to 1.
    pub confidence: *const f32,
    /// What neither blur nor T explains, intensities.
    pub residual: *const f32,
    /// Of each pixel the sharper photograph, intensities, interleaved.
    pub fused: *const f32,
    /// Channels of fused, 1 or 3; 0 of a registration, and where none was asked for: then fused is NULL.
    pub fused_channels: u32,
    /// 0.
    pub reserved: u32,
    /// T by rows: of points from the image centre, px; I2(T x) lines up with I1(x).
    pub transform: [f64; 9],
    /// Factor on I2.
    pub gain: f64,
    /// Added after it, intensities.
    pub offset: f64,
    /// Smoothness of the finest level, stated or found; NaN of a registration, as the next four.
    pub regularization: f64,
    /// Where the kernel was to be found: 0 is a Gaussian, 1 a disk; NaN where it was stated.
    pub kernel_shape: f64,
    /// Fraction of pixels that are valid.
    pub valid_fraction: f64,
    /// Mean confidence of the valid pixels.
    pub mean_confidence: f64,
    /// Fraction of the valid pixels at the limit of |V|.
    pub saturated_fraction: f64,
    /// From the call to the answer, ms.
    pub total_ms: f64,
    /// On the device, ms.
    pub gpu_ms: f64,
}

// SAFETY: numbers and pointers, the size first.
unsafe impl Versioned for parfocal_found {
    const NAME: &'static str = "parfocal_found";

    fn start() -> Self {
        let (none, nan) = (std::ptr::null(), f64::NAN);
        Self {
            size: size_of::<Self>(),
            width: 0,
            height: 0,
            origin: [0; 2],
            converged: 0,
            warnings: 0,
            relative_blur: none,
            uncertainty: none,
            confidence: none,
            residual: none,
            fused: none,
            fused_channels: 0,
            reserved: 0,
            transform: [0.0; 9],
            gain: 1.0,
            offset: 0.0,
            regularization: nan,
            kernel_shape: nan,
            valid_fraction: nan,
            mean_confidence: nan,
            saturated_fraction: nan,
            total_ms: nan,
            gpu_ms: nan,
        }
    }
}

// SAFETY: the pointers in `found` are to what `fields` owns, which nothing changes.
unsafe impl Send for parfocal_solution {}
// SAFETY: likewise; all functions but that which frees it only read.
unsafe impl Sync for parfocal_solution {}

/// Warnings for C.
pub(crate) fn sentences(warnings: &[String]) -> Vec<CString> {
    warnings.iter().map(|warning| text(warning)).collect()
}

impl parfocal_solution {
    pub(crate) fn solved(fields: Solution, settings: &Settings) -> Self {
        let (warnings, is_fused) = (sentences(&fields.warnings), settings.fused);
        let found = parfocal_found {
            width: fields.width,
            height: fields.height,
            origin: fields.origin,
            converged: fields.converged.into(),
            warnings: warnings.len() as u32,
            // Of the vectors' memory, which stays where it is when the vectors move.
            relative_blur: fields.relative_blur.as_ptr(),
            uncertainty: fields.uncertainty.as_ptr(),
            confidence: fields.confidence.as_ptr(),
            residual: fields.residual.as_ptr(),
            fused: if is_fused { fields.fused.as_ptr() } else { std::ptr::null() },
            fused_channels: if is_fused { fields.fused_channels.count() } else { 0 },
            transform: flat(&fields.transform),
            gain: fields.photometric.gain,
            offset: fields.photometric.offset,
            regularization: fields.regularization,
            kernel_shape: fields.kernel_shape.unwrap_or(f64::NAN),
            valid_fraction: fields.valid_fraction,
            mean_confidence: fields.mean_confidence,
            saturated_fraction: fields.saturated_fraction,
            total_ms: fields.timings.total_ms,
            gpu_ms: fields.timings.gpu_ms,
            ..parfocal_found::start()
        };
        let (photograph, region) = (fields.photograph, fields.region());
        let moved = Moved { brightness: fields.brightness(), decode: settings.decode, photograph, region };
        let (transform, limit) = (fields.transform, settings.max_relative_blur);
        Self { found, fields: Some(fields), warnings, transform, moved, limit }
    }

    pub(crate) fn registered(of: Registered, settings: &Settings) -> Self {
        let warnings = sentences(&of.warnings);
        let found = parfocal_found {
            width: of.width,
            height: of.height,
            converged: of.converged.into(),
            warnings: warnings.len() as u32,
            transform: flat(&of.transform),
            gain: of.photometric.gain,
            offset: of.photometric.offset,
            total_ms: of.timings.total_ms,
            gpu_ms: of.timings.gpu_ms,
            ..parfocal_found::start()
        };
        let region = Region { x: 0, y: 0, width: of.width, height: of.height };
        let photograph = [of.width, of.height];
        let moved = Moved { brightness: of.brightness(), decode: settings.decode, photograph, region };
        Self { found, fields: None, warnings, transform: of.transform, moved, limit: settings.max_relative_blur }
    }
}

/// Fills in what was found; found->size must be set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_solution_get(
    solution: *const parfocal_solution,
    found: *mut parfocal_found,
) -> parfocal_status {
    // SAFETY: the contract is the same.
    call(|| unsafe { write(found, get(solution, "solution")?.found) })
}

/// A warning, counted from 0, a sentence of UTF-8; NULL where there is none. Valid until the solution is freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_solution_warning(solution: *const parfocal_solution, index: u32) -> *const c_char {
    // SAFETY: the contract is the same.
    let solution = unsafe { get(solution, "solution") };
    solution.map_or(std::ptr::null(), |solution| nth(&solution.warnings, index))
}

pub(crate) fn nth(sentences: &[CString], index: u32) -> *const c_char {
    sentences.get(index as usize).map_or(std::ptr::null(), |sentence| sentence.as_ptr())
}

/// A lens in front of the sensor, focused at one distance for each of the two photographs.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_lens {
    /// sizeof(parfocal_lens).
    pub size: usize,
    /// Mm.
    pub focal_length: f64,
    /// The aperture is focal_length / f_number wide.
    pub f_number: f64,
    /// Between the centres of neighbouring pixels, mm.
    pub pixel_pitch: f64,
    /// At which I1 and I2 are focused, mm from the lens.
    pub focus: [f64; 2],
    /// Deviation of the blur over its radius; 0 takes that of a disk, 0.5.
    pub kappa: f64,
    /// Not 0 where the lens is telecentric on the image side.
    pub telecentric: i32,
}

// SAFETY: numbers, the size first.
unsafe impl Versioned for parfocal_lens {
    const NAME: &'static str = "parfocal_lens";

    fn start() -> Self {
        let size = size_of::<Self>();
        Self { size, focal_length: 0.0, f_number: 0.0, pixel_pitch: 0.0, focus: [0.0; 2], kappa: 0.0, telecentric: 0 }
    }
}

/// Depth from the lens and its standard deviation, mm, into two fields of count floats each, width x height of the solution;
/// NaN where there is none. deviation may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_solution_depth(
    solution: *const parfocal_solution,
    lens: *const parfocal_lens,
    depth: *mut f32,
    deviation: *mut f32,
    count: usize,
) -> parfocal_status {
    call(|| {
        // SAFETY: the contract is the same.
        let (solution, told) = unsafe { (get(solution, "solution")?, read(lens)?) };
        let fields = solution.fields.as_ref().ok_or_else(|| Fault::argument("a registration has no depth"))?;
        let kappa = if told.kappa == 0.0 { Lens::DISK } else { told.kappa };
        let parfocal_lens { focal_length, f_number, pixel_pitch, focus, .. } = told;
        let lens = Lens { focal_length, f_number, pixel_pitch, focus, kappa, telecentric: told.telecentric != 0 };
        lens.check()?;
        check_count("depth", count, fields.relative_blur.len())?;
        let (scale, blur) = (fields.transform.scale(), &fields.relative_blur);
        let metric = MetricDepth::new(&lens, scale, solution.limit, fields.width, blur, &fields.uncertainty);
        // SAFETY: the header asks for so many floats.
        unsafe { slice_mut(depth, count, "depth") }?.copy_from_slice(&metric.depth);
        if !deviation.is_null() {
            // SAFETY: likewise.
            unsafe { slice_mut(deviation, count, "deviation") }?.copy_from_slice(&metric.deviation);
        }
        Ok(())
    })
}

pub(crate) fn check_count(name: &str, found: usize, needed: usize) -> Result<(), Fault> {
    (found == needed)
        .then_some(())
        .ok_or_else(|| Fault::argument(format!("{name} has room for {found}, and {needed} is what it takes")))
}

/// Brings another photograph of I2's camera onto the pixels of the results: width x height of the solution, in the image's own
/// samples, without gaps, into as many bytes; black beyond the photograph. With exposure not 0, as bright as I1.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_solution_apply(
    solution: *const parfocal_solution,
    image: *const parfocal_image,
    exposure: i32,
    out: *mut c_void,
    bytes: usize,
) -> parfocal_status {
    call(|| {
        // SAFETY: the contract is the same.
        let (solution, image) = unsafe { (get(solution, "solution")?, frame(image, "image")?) };
        // SAFETY: the contract is the same.
        unsafe { apply(&solution.moved, &solution.transform, &image, exposure != 0, out, bytes) }
    })
}

/// Writes a photograph as it lies on the results.
///
/// # Safety
/// `out` is NULL, or has room for as many bytes, aligned as the image's samples are.
pub(crate) unsafe fn apply(
    moved: &Moved,
    transform: &Homography,
    image: &Frame,
    exposure: bool,
    out: *mut c_void,
    bytes: usize,
) -> Result<(), Fault> {
    let (size, [width, height]) = ([image.width(), image.height()], moved.photograph);
    if size != moved.photograph {
        let problem = format!("the image is {}x{}, and {width}x{height} were registered", size[0], size[1]);
        return Err(parfocal::Error::Mismatch(problem).into());
    }
    let brightness = if exposure { moved.brightness } else { Brightness::identity(size) };
    let found = resample::registered(image, transform, &brightness, moved.decode);
    let found = found.cropped(moved.region).map_err(Fault::argument)?;
    check_count("out", bytes, found.bytes().len())?;
    let count = bytes / bytes_a_sample(&found);
    // SAFETY: so many samples fit into the bytes that the caller has.
    unsafe {
        match found.samples() {
            Samples::U8(s) => slice_mut(out.cast(), count, "out")?.copy_from_slice(s),
            Samples::U16(s) => slice_mut(out.cast(), count, "out")?.copy_from_slice(s),
            Samples::F32(s) => slice_mut(out.cast(), count, "out")?.copy_from_slice(s),
        }
    }
    Ok(())
}

/// Frees a solution, and the fields with it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_solution_free(solution: *mut parfocal_solution) {
    // SAFETY: the contract is the same.
    unsafe { free(solution) };
}
