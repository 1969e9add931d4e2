//! The settings of a solve, and their conversion from C.

use parfocal::{
    Frame, Settings,
    frame::Depth,
    settings::{Decode, Kernel, Method, Motion, ParallaxSearch, Photometric, RegistrationStep},
    transform::Homography,
};

use crate::fault::{Fault, call, parfocal_status};
use crate::sized::{Versioned, read, write};

/// The order of registration and blur estimation.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub enum parfocal_method {
    /// Both jointly.
    PARFOCAL_UNIFIED = 0,
    /// Relative blur only; T stays at its start.
    PARFOCAL_ALIGNED = 1,
    /// Registration first, from the image difference; then relative blur.
    PARFOCAL_APPEARANCE = 2,
}

/// The motion model of T. Each is a special case of the next.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub enum parfocal_motion {
    /// Translation.
    PARFOCAL_TRANSLATION = 0,
    /// Translation, rotation and scale.
    PARFOCAL_SIMILARITY = 1,
    /// Similarity, stretch and shear.
    PARFOCAL_AFFINE = 2,
    /// Affine and perspective.
    PARFOCAL_HOMOGRAPHY = 3,
}

/// The optimiser of T.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub enum parfocal_registration_step {
    /// Gauss-Newton, with each pixel's change of V eliminated.
    PARFOCAL_GAUSS_NEWTON = 0,
    /// The paper's explicit scheme, for comparison.
    PARFOCAL_GRADIENT_DESCENT = 1,
}

/// Whether parallax is found, of a camera that moved.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub enum parfocal_parallax_search {
    /// Where the photographs show it beyond doubt.
    PARFOCAL_PARALLAX_AUTO = 0,
    /// Of a pair wherever it explains something.
    PARFOCAL_PARALLAX_ON = 1,
    /// Never.
    PARFOCAL_PARALLAX_OFF = 2,
}

/// The shape of the blur kernel.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub enum parfocal_kernel {
    /// Estimated from the photographs, between Gaussian and disk.
    PARFOCAL_KERNEL_AUTO = 0,
    /// Gaussian.
    PARFOCAL_GAUSSIAN = 1,
    /// Disk.
    PARFOCAL_PILLBOX = 2,
    /// Half-Gaussian, the paper's asymmetric kernel.
    PARFOCAL_HALF_GAUSSIAN = 3,
}

/// How stored values become intensities.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub enum parfocal_decode {
    /// 8 bits of I1 or of I2 are taken for sRGB, all else for linear: as the program takes files that say nothing of it.
    PARFOCAL_DECODE_AUTO = 0,
    /// As stored.
    PARFOCAL_DECODE_NONE = 1,
    /// The sRGB curve is undone first.
    PARFOCAL_DECODE_SRGB = 2,
}

/// The settings of a solve. docs/method.md, section 8, describes each. parfocal_settings_init fills in the defaults.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_settings {
    /// sizeof(parfocal_settings).
    pub size: usize,
    /// A parfocal_method.
    pub method: u32,
    /// A parfocal_motion.
    pub motion: u32,
    /// A parfocal_kernel.
    pub kernel: u32,
    /// A parfocal_registration_step.
    pub registration_step: u32,
    /// A parfocal_decode.
    pub decode: u32,
    /// 1: match gain, offset and shading. 0: keep them.
    pub photometric: u32,
    /// Pyramid levels, 1 to 12. 0: as many as the image size allows.
    pub levels: u32,
    /// Maximum iterations per level, 5 to 1000.
    pub outer_iterations: u32,
    /// Relaxation sweeps per outer iteration on each grid but the coarsest, 1 to 100.
    pub relaxation_sweeps: u32,
    /// Over-relaxation, 0.01 to 1.99.
    pub over_relaxation: f64,
    /// Smoothness weight, 1e-6 to 10. 0: estimated on each level.
    pub regularization: f64,
    /// The smoothness weight of the coarsest level starts larger by the factor 1 + continuation, 0 to 1000.
    pub continuation: f64,
    /// Robustness scale of the data term, units of intensity (a power of two near the brightest parts), 1e-4 to 1.
    pub data_eta: f64,
    /// Robustness scale of the smoothness term, px² per pixel, 1e-4 to 100.
    pub smoothness_eta: f64,
    /// Limit of |V|, px², 1 to 1024. 0: 144, and for a pair that reaches it 1024.
    pub max_relative_blur: f64,
    /// Limit of the change of V per step, px² of the level, 0.01 to 100; a quarter of |V| where that is more.
    pub largest_step: f64,
    /// Samples up to this stored value count as clipped at black. NaN: 0 for integers, none for floats.
    pub black_level: f64,
    /// Samples from this stored value on count as clipped at white. NaN: the largest integer, none for floats.
    pub white_level: f64,
    /// Start of T, row by row, for points in px from the image centre.
    pub start: [f64; 9],
    /// Start of the gain of I2; it stays if photometric is 0.
    pub start_gain: f64,
    /// Start of the offset after the gain, intensities; it stays if photometric is 0.
    pub start_offset: f64,
    /// 1: also compute the fused image of a pair. Depth and registration do not need it.
    pub fused: u32,
    /// 1: keep the frames of a sweep that do not show the scene of the others. 0: leave them out.
    pub keep_frames: u32,
    /// 1: depth edges are as sharp as the scene's, where two layers explain the photographs better.
    pub edges: u32,
    /// A parfocal_parallax_search: whether the parallax of a camera that moved between the photographs is found.
    pub parallax: u32,
}

// SAFETY: `repr(C)`, numbers, the size first.
unsafe impl Versioned for parfocal_settings {
    const NAME: &'static str = "parfocal_settings";

    fn start() -> Self {
        let s = Settings::default();
        Self {
            size: size_of::<Self>(),
            method: parfocal_method::PARFOCAL_UNIFIED as u32,
            motion: s.motion as u32,
            kernel: parfocal_kernel::PARFOCAL_KERNEL_AUTO as u32,
            registration_step: s.registration_step as u32,
            decode: parfocal_decode::PARFOCAL_DECODE_AUTO as u32,
            photometric: s.photometric.into(),
            levels: s.levels.unwrap_or(0),
            outer_iterations: s.outer_iterations,
            relaxation_sweeps: s.relaxation_sweeps,
            over_relaxation: s.over_relaxation,
            regularization: s.regularization.unwrap_or(0.0),
            continuation: s.continuation,
            data_eta: s.data_eta,
            smoothness_eta: s.smoothness_eta,
            max_relative_blur: s.max_relative_blur.unwrap_or(0.0),
            largest_step: s.largest_step,
            black_level: f64::NAN,
            white_level: f64::NAN,
            start: matrix_rows(&s.start),
            start_gain: s.start_photometric.gain,
            start_offset: s.start_photometric.offset,
            fused: s.fused.into(),
            edges: s.edges.into(),
            parallax: s.parallax as u32,
            keep_frames: s.keep_frames.into(),
        }
    }
}

/// Fills in the defaults. settings->size must be set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_settings_init(settings: *mut parfocal_settings) -> parfocal_status {
    // SAFETY: by the C contract.
    call(|| unsafe { write(settings, parfocal_settings::start()) })
}

/// The settings of a caller, checked.
#[derive(Clone)]
pub(crate) struct CallerSettings {
    settings: Settings,
}

impl CallerSettings {
    /// Reads the settings of the caller; the defaults if `from` is NULL.
    ///
    /// # Safety
    /// The C contract holds for `from`.
    pub(crate) unsafe fn read(from: *const parfocal_settings) -> Result<Self, Fault> {
        let stated = match from.is_null() {
            true => parfocal_settings::start(),
            // SAFETY: by the C contract.
            false => unsafe { read(from) }?,
        };
        let settings = settings(&stated)?;
        settings.check()?;
        Ok(Self { settings })
    }

    /// The settings for these frames, with [`Decode::Auto`] resolved.
    pub(crate) fn resolved_for(&self, frames: &[&Frame]) -> Settings {
        self.resolved_for_depths(frames.iter().map(|frame| frame.format().depth))
    }

    /// The settings for frames of these samples, with [`Decode::Auto`] resolved.
    pub(crate) fn resolved_for_depths(&self, depths: impl Iterator<Item = Depth>) -> Settings {
        Settings { decode: self.settings.decode.resolved(depths), ..self.settings.clone() }
    }
}

fn settings(stated: &parfocal_settings) -> Result<Settings, Fault> {
    let level = |level: f64| Some(level).filter(|level| !level.is_nan());
    Ok(Settings {
        method: one_of("method", stated.method, &[Method::Unified, Method::Aligned, Method::Appearance])?,
        levels: Some(stated.levels).filter(|&levels| levels != 0),
        outer_iterations: stated.outer_iterations,
        relaxation_sweeps: stated.relaxation_sweeps,
        over_relaxation: stated.over_relaxation,
        regularization: Some(stated.regularization).filter(|&alpha| alpha != 0.0),
        continuation: stated.continuation,
        data_eta: stated.data_eta,
        smoothness_eta: stated.smoothness_eta,
        max_relative_blur: Some(stated.max_relative_blur).filter(|&limit| limit != 0.0),
        largest_step: stated.largest_step,
        kernel: one_of("kernel", stated.kernel, &Kernel::NAMED)?,
        motion: one_of("motion", stated.motion, &Motion::ALL)?,
        registration_step: one_of("registration_step", stated.registration_step, &RegistrationStep::ALL)?,
        photometric: one_of("photometric", stated.photometric, &[false, true])?,
        decode: one_of("decode", stated.decode, &Decode::ALL)?,
        black_level: level(stated.black_level),
        white_level: level(stated.white_level),
        start: homography(&stated.start)?,
        start_photometric: Photometric { gain: stated.start_gain, offset: stated.start_offset },
        fused: one_of("fused", stated.fused, &[false, true])?,
        edges: one_of("edges", stated.edges, &[false, true])?,
        parallax: one_of("parallax", stated.parallax, &ParallaxSearch::ALL)?,
        keep_frames: one_of("keep_frames", stated.keep_frames, &[false, true])?,
    })
}

/// Returns the value of a number of an enumeration.
pub(crate) fn one_of<T: Clone>(name: &str, number: u32, values: &[T]) -> Result<T, Fault> {
    let value = usize::try_from(number).ok().and_then(|n| values.get(n)).cloned();
    value.ok_or_else(|| Fault::argument(format!("{name} is {number}: give 0 to {}", values.len() - 1)))
}

/// Makes T from a matrix, row by row.
pub(crate) fn homography(rows: &[f64; 9]) -> Result<Homography, Fault> {
    let matrix = std::array::from_fn(|i| std::array::from_fn(|j| rows[3 * i + j]));
    Homography::from_matrix(matrix)
        .ok_or_else(|| Fault::argument("a transform is not invertible, mirrors, or is not finite"))
}

/// Returns T as a matrix, row by row.
pub(crate) fn matrix_rows(t: &Homography) -> [f64; 9] {
    let matrix = t.matrix();
    std::array::from_fn(|i| matrix[i / 3][i % 3])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_those_of_rust_and_invalid_settings_are_refused() {
        let start = parfocal_settings::start();
        assert_eq!(settings(&start).ok(), Some(Settings::default()));
        for bad in [
            parfocal_settings { method: 3, ..start },
            parfocal_settings { kernel: u32::MAX, ..start },
            parfocal_settings { photometric: 2, ..start },
            parfocal_settings { start: [0.0; 9], ..start },
            parfocal_settings { levels: 99, ..start },
            parfocal_settings { regularization: f64::NAN, ..start },
        ] {
            // SAFETY: a complete struct.
            assert!(unsafe { CallerSettings::read(&raw const bad) }.is_err(), "{bad:?}");
        }
    }
}
