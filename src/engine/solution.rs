//! The results of a solve and of a registration.

use std::ops::{Deref, DerefMut};

use super::channels::ColorShift;
use super::motion::{OtherMotion, TransformDeviation};
use super::stages::scale_deviation::without_scale;
use super::stages::uncertainty::LARGEST;
use crate::base::{Brightness, Channels, Error, Homography, Parallax, Photometric, Region, Shading, centre, workers};

/// The results of a solve without the fields.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Findings {
    /// Width of every field, px.
    pub width: u32,
    /// Height of every field, px.
    pub height: u32,
    /// The pixel of I1 that is the first of every field: (0, 0) unless the solution was cropped.
    pub origin: [u32; 2],
    /// Width and height of the photographs, px. T is stated about their centre.
    pub photograph: [u32; 2],
    /// Channels of the fused image: grey only if both inputs are.
    pub fused_channels: Channels,
    /// T, for full-size pixels.
    pub transform: Homography,
    /// Gain and offset of I2.
    pub photometric: Photometric,
    /// The variation of the gain over the solved part of I2.
    pub shading: Shading,
    /// The solved part, px of the photographs. It is larger than the fields if these were cropped.
    pub solved: Region,
    /// α of the finest level, stated or found.
    pub regularization: f64,
    /// The limit of |V|, px², stated or found.
    pub max_relative_blur: f64,
    /// Shape of the kernel, if it was to be found: 0 is a Gaussian, 1 a disk.
    pub kernel_shape: Option<f64>,
    /// How far the two focus settings are apart, if it was found: the variance of the blur in one photograph of what is
    /// in focus in the other, px². `None` if the blur is Gaussian, which does not show it.
    pub separation: Option<f64>,
    /// The parallax of a camera that moved between the photographs: 0 if none was found.
    pub parallax: Parallax,
    /// The standard deviations of its numbers, by the scatter over the photograph.
    pub parallax_deviation: Parallax,
    /// The standard deviation of the scale of V, as a share of V. A kernel that does not describe the blur makes all of
    /// V too large or too small. [`Solution::uncertainty`] includes it. Results of one lens and setup share it.
    pub scale_deviation: f64,
    /// By how much V differs between the channels of color photographs. `None` if it is not known: of grey ones, of a
    /// transform that is not solved for, and of a solve that has not converged.
    pub color_shift: Option<ColorShift>,
    /// The standard deviation of T. `None` if it is not solved for, or not known: of photographs in a packed pixel
    /// format, of a solve that has not converged, and of photographs of one or two blocks of 128 x 32 px.
    pub transform_deviation: Option<TransformDeviation>,
    /// A motion model that explains more, or a simpler one that explains as much. Only the method unified tests for it.
    pub other_motion: Option<OtherMotion>,
    /// The levels, coarse to fine.
    pub levels: Vec<LevelHistory>,
    /// Whether the finest level converged, and the images overlap, correlate, have enough texture, and determine T.
    pub converged: bool,
    /// Reasons why `converged` is false, and other conditions under which the result may be wrong; one sentence each.
    pub warnings: Vec<String>,
    /// Fraction of pixels whose whole blur window lies inside both images and that no mask excludes.
    pub valid_fraction: f64,
    /// Mean confidence of the valid pixels.
    pub mean_confidence: f64,
    /// Fraction of the valid pixels at the limit of |V|.
    pub saturated_fraction: f64,
    /// Fraction of the pixels of I1 and of I2 that are clipped, of those that no mask excludes. For a pair that is
    /// solved in parts, of the halved photographs.
    pub clipped_fractions: [f64; 2],
    /// Fraction of the valid pixels below the limit of |V| that the last step moved by more than a tenth of their
    /// standard deviation.
    pub unsettled_fraction: f64,
    /// Fraction of the valid pixels that are not measured because the photographs differ there by more than noise and
    /// blur explain: residuals beyond ten times `noise` and a standard deviation of V beyond 1 px².
    pub unexplained_fraction: f64,
    /// Standard deviation of the noise in the difference of the two photographs, intensities: at least a quarter of η
    /// times the unit of intensity (`docs/method.md`, section 1).
    pub noise: f64,
    /// The time that the solve took.
    pub timings: Timings,
}

/// The result of one [`PairSolver::solve`](crate::PairSolver::solve).
#[derive(Clone, Debug, Default)]
pub struct Solution {
    /// V, px² of I1, row-major; positive where I2 is the more blurred. NaN outside the valid region.
    pub relative_blur: Vec<f32>,
    /// Standard deviation of V, px², from the images around each pixel (`docs/method.md`, section 7). NaN outside the
    /// valid region; 1000 where V is not measured: where only the smoothness determines it, and at the limit of |V|,
    /// which is a bound.
    pub uncertainty: Vec<f32>,
    /// `1/(1 + σ²)` of the standard deviation σ in px², from 0 to 1; 0 where the images do not determine V.
    pub confidence: Vec<f32>,
    /// Root mean square of the residual in a window around each pixel, intensities. It is large where something moved
    /// or the light changed between the photographs. NaN outside the valid region.
    pub residual: Vec<f32>,
    /// The fused image (pseudo-radiance, equation 37): interleaved channels in the values of I1, with white at 1.
    /// Pixels that I2 does not show are those of I1. Empty if [`Settings::fused`](crate::Settings::fused)
    /// is false.
    pub fused: Vec<f32>,
    /// Everything else. Its fields are also fields of the solution by `Deref`.
    pub findings: Findings,
}

impl Deref for Solution {
    type Target = Findings;

    fn deref(&self) -> &Findings {
        &self.findings
    }
}

impl DerefMut for Solution {
    fn deref_mut(&mut self) -> &mut Findings {
        &mut self.findings
    }
}

/// The results of a solve in the solver's mapped memory, borrowed from a [`Pending`](crate::Pending) without a copy.
///
/// ```
/// # use parfocal::{Engine, EngineOptions, Error, Frame, PairSolver, Settings, SolveOptions};
/// # fn photograph(soft: f32) -> Frame {
/// #     let value = |i: usize| 0.5 + soft * ((i % 64) as f32 * 1.1).sin() * ((i / 64) as f32 * 0.9).cos();
/// #     Frame::gray(64, 48, (0..64 * 48).map(value).collect()).unwrap()
/// # }
/// # fn main() -> Result<(), Error> {
/// # let (i1, i2) = (photograph(0.4), photograph(0.3));
/// let engine = Engine::new(&EngineOptions::default())?;
/// let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default())?;
/// let mut pending = solver.submit([&i1, &i2], &[], &SolveOptions::default())?;
/// let solution = pending.wait()?;
/// println!("V {:.2} px², {:?}", solution.relative_blur()[64 * 24], solution.transform);
/// # assert_eq!(solution.to_owned().relative_blur.len(), solution.relative_blur().len());
/// # Ok(())
/// # }
/// ```
pub struct SolutionRef<'a> {
    findings: Findings,
    /// Planes: V, its standard deviation, the residual, the fused channels.
    maps: &'a [f32],
    /// The standard deviation of V, if it includes more than the solve knew.
    uncertainty: Option<Vec<f32>>,
}

impl<'a> SolutionRef<'a> {
    pub(super) fn new(findings: Findings, maps: &'a [f32], uncertainty: Option<Vec<f32>>) -> Self {
        Self { findings, maps, uncertainty }
    }

    fn pixels(&self) -> usize {
        self.findings.width as usize * self.findings.height as usize
    }

    fn map(&self, n: usize) -> &'a [f32] {
        &self.maps[n * self.pixels()..(n + 1) * self.pixels()]
    }

    /// V, px², as [`Solution::relative_blur`].
    pub fn relative_blur(&self) -> &'a [f32] {
        self.map(0)
    }

    /// Standard deviation of V, px², as [`Solution::uncertainty`].
    pub fn uncertainty(&self) -> &[f32] {
        self.uncertainty.as_deref().unwrap_or_else(|| self.map(1))
    }

    /// The residual, intensities, as [`Solution::residual`].
    pub fn residual(&self) -> &'a [f32] {
        self.map(2)
    }

    /// A channel of the fused image, counted from 0. `None` if it has fewer channels or was not requested.
    pub fn fused(&self, channel: usize) -> Option<&'a [f32]> {
        (channel < self.maps.len() / self.pixels() - 3).then(|| self.map(3 + channel))
    }

    /// Copies the results.
    pub fn to_owned(&self) -> Solution {
        let channels: Vec<&[f32]> = (0..).map_while(|channel| self.fused(channel)).collect();
        let mut fused = vec![0.0; channels.len() * self.relative_blur().len()];
        let (chunk, count) = (1 << 14, channels.len());
        workers::for_each(fused.chunks_mut((chunk * count).max(1)).enumerate(), |(n, pixels)| {
            for (i, pixel) in pixels.chunks_exact_mut(count).enumerate() {
                pixel.iter_mut().zip(&channels).for_each(|(value, channel)| *value = channel[n * chunk + i]);
            }
        });
        Solution {
            relative_blur: self.relative_blur().to_vec(),
            uncertainty: self.uncertainty().to_vec(),
            confidence: self.uncertainty().iter().map(|&deviation| confidence(deviation)).collect(),
            residual: self.residual().to_vec(),
            fused,
            findings: self.findings.clone(),
        }
    }
}

impl Deref for SolutionRef<'_> {
    type Target = Findings;

    fn deref(&self) -> &Findings {
        &self.findings
    }
}

/// The result of one [`PairSolver::register`](crate::PairSolver::register).
#[derive(Clone, Debug, PartialEq)]
pub struct Registered {
    /// Width of the images, px.
    pub width: u32,
    /// Height of the images, px.
    pub height: u32,
    /// T, for full-size pixels.
    pub transform: Homography,
    /// Gain and offset of I2. If the method does not solve for them, the match of mean and deviation at low pass.
    pub photometric: Photometric,
    /// How the gain varies over I2; none if the method finds T without V.
    pub shading: Shading,
    /// A motion model that explains more, or a simpler one that explains as much. Only the method unified tests for it.
    pub other_motion: Option<OtherMotion>,
    /// The levels, coarse to fine; without energies if the method has no iterations.
    pub levels: Vec<LevelHistory>,
    /// Fraction of the pixels of I1 and of I2 that are clipped, of those that no mask excludes.
    pub clipped_fractions: [f64; 2],
    /// Whether the registration settled on an answer that the images support.
    pub converged: bool,
    /// Why not; a sentence each.
    pub warnings: Vec<String>,
    /// The time that the registration took.
    pub timings: Timings,
}

/// The history of one pyramid level.
#[derive(Clone, Debug, PartialEq)]
pub struct LevelHistory {
    /// Width, px.
    pub width: u32,
    /// Height, px.
    pub height: u32,
    /// E of section 2 of docs/method.md per valid pixel after each outer iteration.
    pub energy: Vec<f64>,
}

/// Durations, ms.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Timings {
    /// From the call to the answer.
    pub total_ms: f64,
    /// On the device, from the first pass to the last. Without device clock: from the submission to the end of the
    /// wait.
    pub gpu_ms: f64,
    /// On the device by named pass, in order of first use. Empty unless passes are timed
    /// ([`EngineOptions::timed`](crate::EngineOptions::timed)) and the device has a clock.
    pub passes_ms: Vec<(&'static str, f64)>,
}

/// Standard deviations with another of each V added. They stay where V is not measured.
pub(super) fn widened(deviations: &[f32], relative_blur: &[f32], by: impl Fn(f32) -> f32) -> Vec<f32> {
    let all = |(&own, &v): (&f32, &f32)| if own < LARGEST { own.hypot(by(v)).min(LARGEST) } else { own };
    deviations.iter().zip(relative_blur).map(all).collect()
}

/// `1/(1 + σ²)` of a standard deviation in px²: ½ at 1 px²; 0 where the images do not determine V, and for NaN.
pub fn confidence(deviation: f32) -> f32 {
    if deviation < LARGEST { 1.0 / (1.0 + deviation * deviation) } else { 0.0 }
}

impl Solution {
    /// The standard deviation of V without that of V's scale, px²: the errors that differ from place to place, and
    /// between results of one lens and setup.
    pub fn uncertainty_without_scale(&self) -> Vec<f32> {
        let scale = self.scale_deviation as f32;
        let pixels = self.uncertainty.iter().zip(&self.relative_blur);
        pixels.map(|(deviation, v)| without_scale(*deviation, scale * v)).collect()
    }

    /// Adds the deviation of V's scale to standard deviations of V that do not include it.
    pub(crate) fn add_scale(&mut self, scale_deviation: f64) {
        self.findings.scale_deviation = scale_deviation;
        self.widen(|v| scale_deviation as f32 * v);
    }

    /// Adds another standard deviation of each V.
    pub(super) fn widen(&mut self, by: impl Fn(f32) -> f32) {
        self.uncertainty = widened(&self.uncertainty, &self.relative_blur, by);
        self.confidence = self.uncertainty.iter().map(|&deviation| confidence(deviation)).collect();
    }

    /// Crops the fields to a region, in their pixels. The judgement of the whole stays.
    ///
    /// # Errors
    /// [`Error::Region`]: it is not within the solution.
    pub fn crop(&mut self, region: Region) -> Result<(), Error> {
        region.check((self.width, self.height))?;
        let (row, channels) = (self.width as usize, self.fused_channels.count() as usize);
        for field in [&mut self.relative_blur, &mut self.uncertainty, &mut self.confidence, &mut self.residual] {
            *field = region.crop(field, row, 1);
        }
        self.fused = region.crop(&self.fused, row, channels);
        self.origin = [self.origin[0] + region.x, self.origin[1] + region.y];
        (self.width, self.height) = (region.width, region.height);
        Ok(())
    }

    /// The largest rectangle of the fields in which V is valid everywhere; `None` if no pixel is.
    pub fn largest_valid(&self) -> Option<Region> {
        let valid: Vec<bool> = self.relative_blur.iter().map(|v| v.is_finite()).collect();
        Region::largest_valid(&valid, self.width as usize)
    }
}

impl Findings {
    /// The part of I1 that the fields cover.
    pub fn region(&self) -> Region {
        Region { x: self.origin[0], y: self.origin[1], width: self.width, height: self.height }
    }

    /// The map from the brightness of I2 to that of I1.
    pub fn brightness(&self) -> Brightness {
        Brightness { photometric: self.photometric, shading: self.shading, part: self.solved }
    }

    /// States the results as those of a part of larger photographs, T about their centre.
    pub(crate) fn place_in(&mut self, part: Region, photograph: [u32; 2]) {
        let (from, to) = (part.centre(), centre(photograph[0], photograph[1]));
        self.transform = self.transform.about(from, to);
        self.parallax = self.parallax.about(from, to);
        (self.origin, self.photograph, self.solved) = ([part.x, part.y], photograph, part);
    }
}

impl Registered {
    /// The map from the brightness of I2 to that of I1.
    pub fn brightness(&self) -> Brightness {
        let unchanged = Brightness::identity([self.width, self.height]);
        Brightness { photometric: self.photometric, shading: self.shading, ..unchanged }
    }
}
