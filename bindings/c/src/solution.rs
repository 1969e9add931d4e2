//! Results of a pair: fields, numbers, depth, and resampling of other photographs.

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
use crate::image::{bytes_per_sample, frame, parfocal_image};
use crate::settings::matrix_rows;
use crate::sized::{Versioned, read, write};

/// The result of a solve or registration of a pair.
pub struct parfocal_solution {
    view: parfocal_solution_view,
    fields: Option<Solution>,
    warnings: Vec<CString>,
    transform: Homography,
    resampling: Resampling,
}

/// The parameters that resample other photographs onto the results.
pub(crate) struct Resampling {
    pub(crate) brightness: Brightness,
    pub(crate) decode: Decode,
    /// Width and height of the photographs, px.
    pub(crate) photograph: [u32; 2],
    /// The part of the photographs that the results cover.
    pub(crate) region: Region,
}

/// The numbers and fields of a solution. Fields have width x height values, row by row without gaps. They live as long as
/// the solution.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_solution_view {
    /// sizeof(parfocal_solution_view).
    pub size: usize,
    /// Pixels per row of the fields; of a registration, of the photographs.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// Pixel x, y of I1 at the first value of the fields; (0, 0) unless they are cropped.
    pub origin: [u32; 2],
    /// 1 if the solve converged to a solution that the images support, else 0.
    pub converged: u32,
    /// Number of warnings.
    pub warnings: u32,
    /// V, px² of I1, positive where I2 is more blurred than I1; NaN where not valid. This and the next four fields are NULL for
    /// a registration.
    pub relative_blur: *const f32,
    /// Standard deviation of V, px²; 1000 where the images do not determine V or it is at its limit, NaN where V is NaN.
    pub uncertainty: *const f32,
    /// Confidence in V, 0 to 1.
    pub confidence: *const f32,
    /// The difference that neither blur nor T explains, intensities.
    pub residual: *const f32,
    /// At each pixel the sharper photograph, intensities, interleaved.
    pub fused: *const f32,
    /// Channels of fused, 1 or 3. 0 if fused is NULL: for a registration, or if settings.fused is 0.
    pub fused_channels: u32,
    /// Always 0.
    pub reserved: u32,
    /// T, row by row, for points in px from the image centre; I2(T x) matches I1(x).
    pub transform: [f64; 9],
    /// Gain of I2.
    pub gain: f64,
    /// Offset of I2 after the gain, intensities.
    pub offset: f64,
    /// Smoothness weight of the finest level, stated or estimated. This and the next four are NaN for a registration.
    pub regularization: f64,
    /// Shape of the estimated kernel: 0 is a Gaussian, 1 a disk. NaN if the kernel was stated.
    pub kernel_shape: f64,
    /// Fraction of the pixels that are valid.
    pub valid_fraction: f64,
    /// Mean confidence of the valid pixels.
    pub mean_confidence: f64,
    /// Fraction of the valid pixels at the limit of |V|.
    pub saturated_fraction: f64,
    /// Fraction of the valid pixels below the limit of |V| that the last step moved by more than a tenth of their
    /// standard deviation.
    pub unsettled_fraction: f64,
    /// Fraction of the valid pixels that are not measured because the photographs differ by more than noise and blur.
    pub unexplained_fraction: f64,
    /// Time from call to return, ms.
    pub total_ms: f64,
    /// Time on the device, ms.
    pub gpu_ms: f64,
    /// Fraction of the pixels of I1 and of I2 that are clipped, of those that no mask excludes.
    pub clipped_fractions: [f64; 2],
    /// Standard deviation of T at the corner that is determined worst, px, and the direction in which it is, in degrees
    /// from the rows. NaN if it is not known.
    pub transform_deviation: [f64; 2],
    /// Standard deviation of the scale of V, as a share of V, which the uncertainty includes. NaN for a registration.
    pub scale_deviation: f64,
    /// How far the two focus settings are apart: the variance of the blur in one photograph of what is in focus in the
    /// other, px². NaN if it was not found.
    pub separation: f64,
    /// Parallax of a camera that moved: a pixel x is displaced by ((parallax[0], parallax[1]) + parallax[2] (x - c)) V before
    /// T maps it, c being the image centre. 0 if none was found, NaN for a registration.
    pub parallax: [f64; 3],
    /// Standard deviations of these numbers.
    pub parallax_deviation: [f64; 3],
    /// Limit of |V|, px², as set or as found. NaN for a registration.
    pub max_relative_blur: f64,
}

// SAFETY: `repr(C)`, numbers and pointers, the size first.
unsafe impl Versioned for parfocal_solution_view {
    const NAME: &'static str = "parfocal_solution_view";

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
            unsettled_fraction: nan,
            unexplained_fraction: nan,
            total_ms: nan,
            gpu_ms: nan,
            clipped_fractions: [nan; 2],
            transform_deviation: [nan; 2],
            scale_deviation: nan,
            separation: nan,
            parallax: [nan; 3],
            parallax_deviation: [nan; 3],
            max_relative_blur: nan,
        }
    }
}

// SAFETY: the pointers in `view` point into `fields`, which nothing changes.
unsafe impl Send for parfocal_solution {}
// SAFETY: as for `Send`; all functions except the one that frees it only read.
unsafe impl Sync for parfocal_solution {}

/// Converts warnings to C strings.
pub(crate) fn c_strings(warnings: &[String]) -> Vec<CString> {
    warnings.iter().map(|warning| text(warning)).collect()
}

impl parfocal_solution {
    pub(crate) fn solved(fields: Solution, settings: &Settings) -> Self {
        let (warnings, is_fused) = (c_strings(&fields.warnings), settings.fused);
        let view = parfocal_solution_view {
            width: fields.width,
            height: fields.height,
            origin: fields.origin,
            converged: fields.converged.into(),
            warnings: warnings.len() as u32,
            // Pointers to the vectors' memory, which stays in place when the vectors move.
            relative_blur: fields.relative_blur.as_ptr(),
            uncertainty: fields.uncertainty.as_ptr(),
            confidence: fields.confidence.as_ptr(),
            residual: fields.residual.as_ptr(),
            fused: if is_fused { fields.fused.as_ptr() } else { std::ptr::null() },
            fused_channels: if is_fused { fields.fused_channels.count() } else { 0 },
            transform: matrix_rows(&fields.transform),
            gain: fields.photometric.gain,
            offset: fields.photometric.offset,
            regularization: fields.regularization,
            kernel_shape: fields.kernel_shape.unwrap_or(f64::NAN),
            valid_fraction: fields.valid_fraction,
            mean_confidence: fields.mean_confidence,
            saturated_fraction: fields.saturated_fraction,
            unsettled_fraction: fields.unsettled_fraction,
            unexplained_fraction: fields.unexplained_fraction,
            total_ms: fields.timings.total_ms,
            gpu_ms: fields.timings.gpu_ms,
            clipped_fractions: fields.clipped_fractions,
            transform_deviation: fields.transform_deviation.map_or([f64::NAN; 2], |d| [d.corner_px, d.direction_deg]),
            scale_deviation: fields.scale_deviation,
            separation: fields.separation.unwrap_or(f64::NAN),
            parallax: fields.parallax.numbers(),
            parallax_deviation: fields.parallax_deviation.numbers(),
            max_relative_blur: fields.max_relative_blur,
            ..parfocal_solution_view::start()
        };
        let (photograph, region) = (fields.photograph, fields.region());
        let resampling = Resampling { brightness: fields.brightness(), decode: settings.decode, photograph, region };
        let transform = fields.transform;
        Self { view, fields: Some(fields), warnings, transform, resampling }
    }

    pub(crate) fn registered(registration: Registered, settings: &Settings) -> Self {
        let warnings = c_strings(&registration.warnings);
        let view = parfocal_solution_view {
            width: registration.width,
            height: registration.height,
            converged: registration.converged.into(),
            warnings: warnings.len() as u32,
            transform: matrix_rows(&registration.transform),
            gain: registration.photometric.gain,
            offset: registration.photometric.offset,
            total_ms: registration.timings.total_ms,
            gpu_ms: registration.timings.gpu_ms,
            clipped_fractions: registration.clipped_fractions,
            ..parfocal_solution_view::start()
        };
        let region = Region { x: 0, y: 0, width: registration.width, height: registration.height };
        let photograph = [registration.width, registration.height];
        let resampling =
            Resampling { brightness: registration.brightness(), decode: settings.decode, photograph, region };
        Self { view, fields: None, warnings, transform: registration.transform, resampling }
    }
}

/// Fills in the view of a solution. view->size must be set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_solution_get(
    solution: *const parfocal_solution,
    view: *mut parfocal_solution_view,
) -> parfocal_status {
    // SAFETY: by the C contract.
    call(|| unsafe { write(view, get(solution, "solution")?.view) })
}

/// Returns a warning, counted from 0, as a UTF-8 sentence; NULL beyond the last. Valid until the solution is freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_solution_warning(solution: *const parfocal_solution, index: u32) -> *const c_char {
    // SAFETY: by the C contract.
    let solution = unsafe { get(solution, "solution") };
    solution.map_or(std::ptr::null(), |solution| nth(&solution.warnings, index))
}

/// Returns string `index`, or NULL.
pub(crate) fn nth(strings: &[CString], index: u32) -> *const c_char {
    strings.get(index as usize).map_or(std::ptr::null(), |string| string.as_ptr())
}

/// A lens that is focused at one distance for each photograph of a pair. It has no field: V is taken as
/// if the lens were the same at every place.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_lens {
    /// sizeof(parfocal_lens).
    pub size: usize,
    /// Focal length, mm.
    pub focal_length: f64,
    /// F-number; the aperture is focal_length / f_number wide.
    pub f_number: f64,
    /// Distance between pixel centres, mm.
    pub pixel_pitch: f64,
    /// Focus distances of I1 and I2 from the lens, mm.
    pub focus: [f64; 2],
    /// Standard deviation of the blur over its radius. 0 means 0.5, a disk.
    pub kappa: f64,
    /// Not 0 if the lens is telecentric on the image side.
    pub telecentric: i32,
}

// SAFETY: `repr(C)`, numbers, the size first.
unsafe impl Versioned for parfocal_lens {
    const NAME: &'static str = "parfocal_lens";

    fn start() -> Self {
        let size = size_of::<Self>();
        Self { size, focal_length: 0.0, f_number: 0.0, pixel_pitch: 0.0, focus: [0.0; 2], kappa: 0.0, telecentric: 0 }
    }
}

/// Computes depth from the lens and its standard deviation, mm, NaN where there is none. Both fields have count floats,
/// width x height of the solution. deviation may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_solution_depth(
    solution: *const parfocal_solution,
    lens: *const parfocal_lens,
    depth: *mut f32,
    deviation: *mut f32,
    count: usize,
) -> parfocal_status {
    call(|| {
        // SAFETY: by the C contract.
        let (solution, stated) = unsafe { (get(solution, "solution")?, read(lens)?) };
        let fields = solution.fields.as_ref().ok_or_else(|| Fault::argument("a registration has no depth"))?;
        let kappa = if stated.kappa == 0.0 { Lens::DISK } else { stated.kappa };
        let parfocal_lens { focal_length, f_number, pixel_pitch, focus, .. } = stated;
        let telecentric = stated.telecentric != 0;
        let lens = Lens { focal_length, f_number, pixel_pitch, focus, kappa, telecentric, field: None };
        lens.check()?;
        check_count("depth", count, fields.relative_blur.len())?;
        let (scale, blur) = (fields.transform.scale(), &fields.relative_blur);
        let metric = MetricDepth::new(&lens, scale, fields.max_relative_blur, fields.width, blur, &fields.uncertainty);
        // SAFETY: by the C contract `depth` has room for `count` floats.
        unsafe { slice_mut(depth, count, "depth") }?.copy_from_slice(&metric.depth);
        if !deviation.is_null() {
            // SAFETY: by the C contract `deviation` has room for `count` floats.
            unsafe { slice_mut(deviation, count, "deviation") }?.copy_from_slice(&metric.deviation);
        }
        Ok(())
    })
}

/// Checks the length that the caller states for an array.
pub(crate) fn check_count(name: &str, stated: usize, needed: usize) -> Result<(), Fault> {
    (stated == needed)
        .then_some(())
        .ok_or_else(|| Fault::argument(format!("{name} has a length of {stated}: give {needed}")))
}

/// Resamples another photograph, taken like I2, onto the pixels of the results. out receives width x height pixels of the
/// solution without gaps, with the image's channels and sample type; bytes is its size. Pixels beyond the photograph are
/// black. exposure not 0 also matches the brightness of I1.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_solution_apply(
    solution: *const parfocal_solution,
    image: *const parfocal_image,
    exposure: i32,
    out: *mut c_void,
    bytes: usize,
) -> parfocal_status {
    call(|| {
        // SAFETY: by the C contract.
        let (solution, image) = unsafe { (get(solution, "solution")?, frame(image, "image")?) };
        // SAFETY: by the C contract.
        unsafe { apply(&solution.resampling, &solution.transform, &image, exposure != 0, out, bytes) }
    })
}

/// Writes a photograph resampled onto the results.
///
/// # Safety
/// `out` is NULL, or has room for `bytes` bytes, aligned for the image's samples.
pub(crate) unsafe fn apply(
    resampling: &Resampling,
    transform: &Homography,
    image: &Frame,
    exposure: bool,
    out: *mut c_void,
    bytes: usize,
) -> Result<(), Fault> {
    let (size, [width, height]) = ([image.width(), image.height()], resampling.photograph);
    if size != resampling.photograph {
        let problem = format!("the image is {}x{}; the registered photographs are {width}x{height}", size[0], size[1]);
        return Err(parfocal::Error::Mismatch(problem).into());
    }
    let brightness = if exposure { resampling.brightness } else { Brightness::identity(size) };
    let resampled = resample::registered(image, transform, &brightness, resampling.decode);
    let resampled = resampled.cropped(resampling.region).map_err(Fault::argument)?;
    check_count("out", bytes, resampled.bytes().len())?;
    let count = bytes / bytes_per_sample(&resampled);
    // SAFETY: `count` samples fit into the caller's `bytes` bytes.
    unsafe {
        match resampled.samples() {
            Samples::U8(s) => slice_mut(out.cast(), count, "out")?.copy_from_slice(s),
            Samples::U16(s) => slice_mut(out.cast(), count, "out")?.copy_from_slice(s),
            Samples::F32(s) => slice_mut(out.cast(), count, "out")?.copy_from_slice(s),
        }
    }
    Ok(())
}

/// Frees a solution and its fields.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_solution_free(solution: *mut parfocal_solution) {
    // SAFETY: by the C contract.
    unsafe { free(solution) };
}
