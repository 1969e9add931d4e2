//! Everything that a solve can be told, with defaults and checked ranges.

use crate::base::color::Decode;
use crate::base::{Depth, Error, Homography, Kernel};

/// Which of the systems of the paper runs: registration and relative blur together, or one before the other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "lowercase"))]
pub enum Method {
    /// Relative blur and registration together, sections 2 to 4 of the paper.
    #[default]
    Unified,
    /// Relative blur alone: T is held at the start.
    Aligned,
    /// Registration first, by the difference of the images without a blur model (equation 36); then aligned.
    Appearance,
    /// Registration first, by SIFT key-points, which need no start; then aligned.
    Sift,
}

impl Method {
    /// "unified", "aligned", "appearance" or "sift".
    pub fn name(self) -> &'static str {
        match self {
            Method::Unified => "unified",
            Method::Aligned => "aligned",
            Method::Appearance => "appearance",
            Method::Sift => "sift",
        }
    }
}

/// What T may be: each of these is a special case of the next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "lowercase"))]
pub enum Motion {
    /// A shift along x and y.
    Translation,
    /// Besides, rotation and scale: what refocusing and a hand or a stage do in the plane of the image.
    #[default]
    Similarity,
    /// Besides, stretch and shear.
    Affine,
    /// Besides, perspective: a camera that turned, or a plane that was tilted.
    Homography,
}

impl Motion {
    /// All of them, the simplest first.
    pub const ALL: [Self; 4] = [Motion::Translation, Motion::Similarity, Motion::Affine, Motion::Homography];

    /// Its numbers.
    pub fn unknowns(self) -> usize {
        match self {
            Motion::Translation => 2,
            Motion::Similarity => 4,
            Motion::Affine => 6,
            Motion::Homography => 8,
        }
    }

    /// "translation", "similarity", "affine" or "homography".
    pub fn name(self) -> &'static str {
        match self {
            Motion::Translation => "translation",
            Motion::Similarity => "similarity",
            Motion::Affine => "affine",
            Motion::Homography => "homography",
        }
    }
}

/// How T steps once an outer iteration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "kebab-case"))]
pub enum RegistrationStep {
    /// Gauss-Newton on the energy, each pixel's change of V eliminated.
    #[default]
    GaussNewton,
    /// Gradient descent beside a V that stands still: the paper's explicit scheme, to compare with.
    GradientDescent,
}

/// Gain and offset that map I2 onto I1: `J = gain I2(T x) + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Photometric {
    /// Factor on I2.
    pub gain: f64,
    /// Added after the gain, in intensities of [0, 1].
    pub offset: f64,
}

impl Photometric {
    /// Equal exposures.
    pub const IDENTITY: Self = Self { gain: 1.0, offset: 0.0 };
}

impl Default for Photometric {
    fn default() -> Self {
        Self::IDENTITY
    }
}

/// The settings of a [`PairSolver`](crate::PairSolver).
///
/// The defaults and what each does: the table in `docs/method.md`. Intensities are in [0, 1], blur in px².
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Settings {
    /// How registration and relative blur go together. Default unified.
    pub method: Method,
    /// Pyramid levels, 1 to 12; `None` halves while the short side stays at least 32 px. Default `None`.
    pub levels: Option<u32>,
    /// Outer iterations on each level at most, 5 to 1000; a level stops as soon as it has settled, after 5 to 20 as a rule.
    /// Default 100.
    pub outer_iterations: u32,
    /// Red-black sweeps an outer iteration, 1 to 100. Default 5.
    pub sweeps: u32,
    /// Over-relaxation ω of a sweep, 0.01 to 1.99. Default 1.8.
    pub over_relaxation: f64,
    /// Smoothness α, equation 17; 1e-6 to 10. `None`: found on each level, by what the data say against V and how steep it is
    /// (`docs/method.md`, section 6). Default `None`.
    pub regularization: Option<f64>,
    /// On each level α starts `1 + continuation` times too large; 0 to 1000. Default 10.
    pub continuation: f64,
    /// η of the data term's modified L1 norm, intensities; 1e-4 to 1. Default 0.01.
    pub data_eta: f64,
    /// η of the smoothness term's modified L1 norm, px² a pixel; 1e-4 to 100. Default 0.1.
    pub smoothness_eta: f64,
    /// ε of the smooth Heaviside, px²; 1e-3 to 10. Default 0.1.
    pub heaviside_epsilon: f64,
    /// Largest |V|, px² of the full-size image, 1 to 256. Default 144: at 36, a third of the heat sink's pixels and two
    /// thirds of the circuit board's were at the limit; at 144, 0 and 1 %.
    pub max_relative_blur: f64,
    /// Largest change of V in one outer iteration, px² of the level, 0.01 to 100. Default 1.
    pub largest_step: f64,
    /// Shape of the blur. Default what the photographs say.
    pub kernel: Kernel,
    /// What T may be, beyond where it starts. SIFT finds a similarity at most. Default a similarity.
    pub motion: Motion,
    /// How T steps. Default Gauss-Newton.
    pub registration: RegistrationStep,
    /// Whether gain and offset are matched. Default true.
    pub photometric: bool,
    /// Whether the fused image of a pair is made too, of which depth and registration need nothing. Its pass takes a twentieth
    /// of a grey solve of 1 Mpx (`parfocal bench`, lavapipe); without it a quarter less comes down, in colour half. Default true.
    #[cfg_attr(feature = "serde", serde(default = "yes"))]
    pub fused: bool,
    /// How stored values become intensities. Default auto, by the pixel formats of both photographs.
    pub decode: Decode,
    /// Stored value up to which a sample is clipped at black; `None` is 0 of integers, and nothing of floats. A pixel all of
    /// whose channels are has no weight. Default `None`.
    pub black_level: Option<f64>,
    /// Stored value from which on a sample is clipped at white; `None` is the greatest of integers, 255 or 65535, and
    /// nothing of floats. A pixel one of whose channels is has no weight. Default `None`.
    pub white_level: Option<f64>,
    /// Where T starts (and stays, when the method is aligned).
    pub start: Homography,
    /// Where gain and offset start (and stay, when `photometric` is false).
    pub start_photometric: Photometric,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            method: Method::Unified,
            levels: None,
            outer_iterations: 100,
            sweeps: 5,
            over_relaxation: 1.8,
            regularization: None,
            continuation: 10.0,
            data_eta: 0.01,
            smoothness_eta: 0.1,
            heaviside_epsilon: 0.1,
            max_relative_blur: 144.0,
            largest_step: 1.0,
            kernel: Kernel::Auto,
            motion: Motion::Similarity,
            registration: RegistrationStep::GaussNewton,
            photometric: true,
            fused: true,
            decode: Decode::Auto,
            black_level: None,
            white_level: None,
            start: Homography::IDENTITY,
            start_photometric: Photometric::IDENTITY,
        }
    }
}

/// Of reports that were written before there was a choice.
#[cfg(feature = "serde")]
fn yes() -> bool {
    true
}

impl Settings {
    /// Black and white level of samples of this kind, integers on a scale from 0 to 1.
    pub(crate) fn clipped(&self, depth: Depth) -> [f32; 2] {
        let greatest = match depth {
            Depth::U8 => 255.0,
            Depth::U16 => 65535.0,
            Depth::F32 => {
                let level = |stated: Option<f64>, none: f32| stated.map_or(none, |level| level as f32);
                return [level(self.black_level, f32::NEG_INFINITY), level(self.white_level, f32::INFINITY)];
            }
        };
        // Half a step from the next value, since a device may round a quotient either way.
        let black = (self.black_level.unwrap_or(0.0) + 0.5) / greatest;
        let white = (self.white_level.unwrap_or(greatest) - 0.5) / greatest;
        [black as f32, white as f32]
    }

    /// Checks every range.
    ///
    /// # Errors
    /// [`Error::Setting`] with the name, the value and the range of the first setting that is out of range.
    pub fn check(&self) -> Result<(), Error> {
        let range = |name, value: f64, low: f64, high: f64| {
            if value >= low && value <= high {
                Ok(())
            } else {
                Err(Error::Setting { name, value, range: format!("{low} to {high}") })
            }
        };
        range("levels", f64::from(self.levels.unwrap_or(1)), 1.0, 12.0)?;
        range("outer iterations", f64::from(self.outer_iterations), 5.0, 1000.0)?;
        range("sweeps", f64::from(self.sweeps), 1.0, 100.0)?;
        range(
            "the product of outer iterations and sweeps",
            f64::from(self.outer_iterations) * f64::from(self.sweeps),
            1.0,
            10000.0,
        )?;
        range("over-relaxation", self.over_relaxation, 0.01, 1.99)?;
        range("regularization", self.regularization.unwrap_or(1.0), 1e-6, 10.0)?;
        range("continuation", self.continuation, 0.0, 1000.0)?;
        range("data eta", self.data_eta, 1e-4, 1.0)?;
        range("smoothness eta", self.smoothness_eta, 1e-4, 100.0)?;
        range("heaviside epsilon", self.heaviside_epsilon, 1e-3, 10.0)?;
        range("max relative blur", self.max_relative_blur, 1.0, 256.0)?;
        range("largest step", self.largest_step, 0.01, 100.0)?;
        range("black level", self.black_level.unwrap_or(0.0), -1e6, 1e6)?;
        range("white level", self.white_level.unwrap_or(0.0), -1e6, 1e6)?;
        let ([tx, ty], [gx, gy]) = (self.start.translation(), self.start.perspective());
        range("start translation x", tx, -1e5, 1e5)?;
        range("start translation y", ty, -1e5, 1e5)?;
        range("start scale", self.start.scale(), 0.1, 10.0)?;
        // The horizon 10 px from the centre: what is meant are pixels, not shares of the image.
        range("start perspective along x", gx, -0.1, 0.1)?;
        range("start perspective along y", gy, -0.1, 0.1)?;
        range("start gain", self.start_photometric.gain, 1e-3, 1e3)?;
        range("start offset", self.start_photometric.offset, -1e3, 1e3)
    }
}
