//! The settings of a solve.

use parfocal::{
    Frame, Settings,
    frame::Depth,
    settings::{Decode, Kernel, Method, Motion, Photometric, RegistrationStep},
    transform::Homography,
};

use crate::fault::{Fault, call, parfocal_status};
use crate::sized::{Versioned, read, write};

/// How registration and relative blur go together.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub enum parfocal_method {
    /// Together.
    PARFOCAL_UNIFIED = 0,
    /// Relative blur alone: T is held at the start.
    PARFOCAL_ALIGNED = 1,
    /// Registration first, by the difference of the images; then relative blur.
    PARFOCAL_APPEARANCE = 2,
}

/// What T may be: each is a special case of the next.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub enum parfocal_motion {
    /// A shift.
    PARFOCAL_TRANSLATION = 0,
    /// Besides, rotation and scale.
    PARFOCAL_SIMILARITY = 1,
    /// Besides, stretch and shear.
    PARFOCAL_AFFINE = 2,
    /// Besides, perspective.
    PARFOCAL_HOMOGRAPHY = 3,
}

/// How T steps.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub enum parfocal_registration_step {
    /// Gauss-Newton, each pixel's change of V eliminated.
    PARFOCAL_GAUSS_NEWTON = 0,
    /// The paper's explicit scheme, to compare with.
    PARFOCAL_GRADIENT_DESCENT = 1,
}

/// Shape of the blur.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub enum parfocal_kernel {
    /// What the photographs say, from a Gaussian to a disk and a little beyond.
    PARFOCAL_KERNEL_AUTO = 0,
    /// Gaussian.
    PARFOCAL_GAUSSIAN = 1,
    /// Disk.
    PARFOCAL_PILLBOX = 2,
    /// Half a Gaussian: the paper's asymmetric kernel.
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

/// The settings; docs/method.md, section 8, says what each does. parfocal_settings_init fills in the defaults.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_settings {
    /// sizeof(parfocal_settings).
    pub size: usize,
    /// A parfocal_method.
    pub method: u32,
    /// A parfocal_motion: what T may be, beyond where it starts.
    pub motion: u32,
    /// A parfocal_kernel.
    pub kernel: u32,
    /// A parfocal_registration_step.
    pub registration_step: u32,
    /// A parfocal_decode.
    pub decode: u32,
    /// Whether gain, offset and shading are matched: 1 or 0.
    pub photometric: u32,
    /// Pyramid levels, 1 to 12; 0: as many as the images have.
    pub levels: u32,
    /// Iterations a level at most, 5 to 1000.
    pub outer_iterations: u32,
    /// Relaxation sweeps per outer iteration, 1 to 100.
    pub relaxation_sweeps: u32,
    /// Over-relaxation, 0.01 to 1.99.
    pub over_relaxation: f64,
    /// Smoothness, 1e-6 to 10; 0: found on each level.
    pub regularization: f64,
    /// The smoothness starts 1 + this times too large, 0 to 1000.
    pub continuation: f64,
    /// Of the data term, intensities, 1e-4 to 1.
    pub data_eta: f64,
    /// Of the smoothness, px² a pixel, 1e-4 to 100.
    pub smoothness_eta: f64,
    /// Px², 1e-3 to 10.
    pub heaviside_epsilon: f64,
    /// Largest |V|, px², 1 to 256.
    pub max_relative_blur: f64,
    /// Largest change of V an iteration, px² of the level, 0.01 to 100.
    pub largest_step: f64,
    /// Stored value up to which a sample is clipped at black; NaN: 0 of integers, nothing of floats.
    pub black_level: f64,
    /// Stored value from which on a sample is clipped at white; NaN: the greatest of integers, nothing of floats.
    pub white_level: f64,
    /// Where T starts, by rows: of points from the image centre, px.
    pub start: [f64; 9],
    /// Where the factor on I2 starts; it stays where photometric is 0.
    pub start_gain: f64,
    /// Where what is added after it starts, intensities.
    pub start_offset: f64,
    /// Whether the fused image of a pair is made, of which depth and registration need nothing: 1 or 0.
    pub fused: u32,
    /// 0.
    pub reserved: u32,
}

// SAFETY: numbers, the size first.
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
            heaviside_epsilon: s.heaviside_epsilon,
            max_relative_blur: s.max_relative_blur,
            largest_step: s.largest_step,
            black_level: f64::NAN,
            white_level: f64::NAN,
            start: flat(&s.start),
            start_gain: s.start_photometric.gain,
            start_offset: s.start_photometric.offset,
            fused: s.fused.into(),
            reserved: 0,
        }
    }
}

/// Fills in the defaults; settings->size must be set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_settings_init(settings: *mut parfocal_settings) -> parfocal_status {
    // SAFETY: the contract is the same.
    call(|| unsafe { write(settings, parfocal_settings::start()) })
}

/// The settings of a caller.
#[derive(Clone)]
pub(crate) struct Told {
    settings: Settings,
}

impl Told {
    /// What the caller set; the defaults of NULL.
    ///
    /// # Safety
    /// `from` is NULL, or as the header says.
    pub(crate) unsafe fn read(from: *const parfocal_settings) -> Result<Self, Fault> {
        let asked = match from.is_null() {
            true => parfocal_settings::start(),
            // SAFETY: the contract is the same.
            false => unsafe { read(from) }?,
        };
        let settings = settings(&asked)?;
        settings.check()?;
        Ok(Self { settings })
    }

    /// The settings for these frames, with [`Decode::Auto`] resolved.
    pub(crate) fn of(&self, frames: &[&Frame]) -> Settings {
        self.of_depths(frames.iter().map(|frame| frame.format().depth))
    }

    /// The settings for frames of these samples, with [`Decode::Auto`] resolved.
    pub(crate) fn of_depths(&self, depths: impl Iterator<Item = Depth>) -> Settings {
        Settings { decode: self.settings.decode.resolved(depths), ..self.settings.clone() }
    }
}

fn settings(asked: &parfocal_settings) -> Result<Settings, Fault> {
    let level = |level: f64| Some(level).filter(|level| !level.is_nan());
    Ok(Settings {
        method: one_of("method", asked.method, &[Method::Unified, Method::Aligned, Method::Appearance])?,
        levels: Some(asked.levels).filter(|&levels| levels != 0),
        outer_iterations: asked.outer_iterations,
        relaxation_sweeps: asked.relaxation_sweeps,
        over_relaxation: asked.over_relaxation,
        regularization: Some(asked.regularization).filter(|&alpha| alpha != 0.0),
        continuation: asked.continuation,
        data_eta: asked.data_eta,
        smoothness_eta: asked.smoothness_eta,
        heaviside_epsilon: asked.heaviside_epsilon,
        max_relative_blur: asked.max_relative_blur,
        largest_step: asked.largest_step,
        kernel: one_of("kernel", asked.kernel, &Kernel::NAMED)?,
        motion: one_of("motion", asked.motion, &Motion::ALL)?,
        registration_step: one_of("registration_step", asked.registration_step, &RegistrationStep::ALL)?,
        photometric: one_of("photometric", asked.photometric, &[false, true])?,
        decode: one_of("decode", asked.decode, &Decode::ALL)?,
        black_level: level(asked.black_level),
        white_level: level(asked.white_level),
        start: homography(&asked.start)?,
        start_photometric: Photometric { gain: asked.start_gain, offset: asked.start_offset },
        fused: one_of("fused", asked.fused, &[false, true])?,
    })
}

/// The value that a number of an enumeration stands for.
pub(crate) fn one_of<T: Clone>(name: &str, number: u32, values: &[T]) -> Result<T, Fault> {
    let value = usize::try_from(number).ok().and_then(|n| values.get(n)).cloned();
    value.ok_or_else(|| Fault::argument(format!("{name} is {number}: give 0 to {}", values.len() - 1)))
}

/// T from a matrix by rows.
pub(crate) fn homography(rows: &[f64; 9]) -> Result<Homography, Fault> {
    let matrix = std::array::from_fn(|i| std::array::from_fn(|j| rows[3 * i + j]));
    Homography::from_matrix(matrix)
        .ok_or_else(|| Fault::argument("a transform has no inverse, mirrors, or is not of numbers"))
}

/// T as a matrix by rows.
pub(crate) fn flat(t: &Homography) -> [f64; 9] {
    let matrix = t.matrix();
    std::array::from_fn(|i| matrix[i / 3][i % 3])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_those_of_rust_and_what_is_no_setting_is_refused() {
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
            // SAFETY: a whole struct.
            assert!(unsafe { Told::read(&raw const bad) }.is_err(), "{bad:?}");
        }
    }
}
