//! What a solve gives back.

use std::ops::{Deref, DerefMut};

use crate::base::{Brightness, Channels, Error, Homography, Photometric, Region, Settings, Shading, centre, workers};
use crate::engine::stages::state::State;
use crate::engine::stages::uncertainty::LARGEST;
use crate::engine::{OtherMotion, Registered};

/// What a solve found out, but for the fields.
#[derive(Clone, Debug, PartialEq)]
pub struct Findings {
    /// Pixels a row, of every field.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The pixel of I1 that is the first of every field: (0, 0) unless the solution was cropped.
    pub origin: [u32; 2],
    /// Width and height of the photographs, about whose centre T is stated.
    pub photograph: [u32; 2],
    /// Channels of the fused image: grey only if both inputs are.
    pub fused_channels: Channels,
    /// T, for full-size pixels.
    pub transform: Homography,
    /// Gain and offset of I2.
    pub photometric: Photometric,
    /// How the gain varies over the part of I2 that was solved.
    pub shading: Shading,
    /// That part, px of the photographs: larger than the fields' where these were cropped.
    pub solved: Region,
    /// α of the finest level, stated or found.
    pub regularization: f64,
    /// Where the kernel was to be found: 0 is a Gaussian, 1 a disk, up to 1.5.
    pub kernel_shape: Option<f64>,
    /// Another motion model that would do, where there is one; only with the method unified, which judges T by its energy.
    pub other_motion: Option<OtherMotion>,
    /// Coarse to fine.
    pub levels: Vec<LevelHistory>,
    /// Whether the finest level settled on an answer that the images support.
    pub converged: bool,
    /// Why not, or what else the user should know; a sentence each.
    pub warnings: Vec<String>,
    /// Fraction of pixels whose whole blur window lies inside both images, and that no mask leaves out.
    pub valid_fraction: f64,
    /// Mean confidence of the valid pixels.
    pub mean_confidence: f64,
    /// Fraction of the valid pixels at the limit of |V|.
    pub saturated_fraction: f64,
    /// Where the time went.
    pub timings: Timings,
}

/// The result of one [`PairSolver::solve`](crate::PairSolver::solve).
#[derive(Clone, Debug)]
pub struct Solution {
    /// V, px² of I1, row-major; positive where I2 is the more blurred. NaN outside the valid region.
    pub relative_blur: Vec<f32>,
    /// Standard deviation of V, px², by what the images say around each pixel (`docs/method.md`, section 7). NaN outside the
    /// valid region; 1000 where nothing holds V but the smoothness.
    pub uncertainty: Vec<f32>,
    /// The same on a scale from 0 to 1, `1/(1 + σ²)` with σ in px²; 0 where the images say nothing.
    pub confidence: Vec<f32>,
    /// Root mean square, around each pixel, of what neither blur nor T explains, intensities: large where something moved
    /// between the photographs or shone differently. NaN outside the valid region.
    pub residual: Vec<f32>,
    /// Pseudo-radiance, equation 37, interleaved, in the values of I1 with white at 1; I1 itself
    /// where I2 does not reach. Empty where [`Settings::fused`] is false.
    pub fused: Vec<f32>,
    /// Everything else, whose fields are as good as the solution's own.
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

/// What one pyramid level did.
#[derive(Clone, Debug, PartialEq)]
pub struct LevelHistory {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// E of section 2 of docs/method.md per valid pixel, one for each outer iteration done.
    pub energy: Vec<f64>,
}

/// Milliseconds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Timings {
    /// From the call to the answer.
    pub total_ms: f64,
    /// On the device, from the first pass to the last; where its clock is not read, from submitting to the last answer.
    pub gpu_ms: f64,
    /// On the device by named pass, in order of first use; empty where they are not timed ([`EngineOptions::timed`](crate::EngineOptions::timed)) or the device
    /// has no clock.
    pub passes_ms: Vec<(&'static str, f64)>,
}

/// Less of the frame than this is no overlap to speak of.
const LEAST_VALID: f64 = 0.01;
/// Less mean confidence than this, an uncertainty of 14 px² all over: V is filled in by the smoothness nearly everywhere.
///
/// Of real pairs the widest blurred, a macro photograph half of whose pixels are at the limit of |V|, has 0.02.
const LEAST_CONFIDENCE: f64 = 0.005;
/// Images of one scene correlate better than this at low pass.
const LEAST_CORRELATION: f32 = 0.5;
/// More valid pixels at the limit of |V| than this are worth a word.
const MOST_SATURATED: f64 = 0.1;

/// More shading than this, either way, is worth a word: lenses that vignette differ by less.
const MOST_SHADING: f64 = 0.2;

/// `1/(1 + σ²)` of a standard deviation in px²: ½ at 1 px²; 0 where the images say nothing, and where it is NaN.
pub fn confidence(deviation: f32) -> f32 {
    if deviation < LARGEST { 1.0 / (1.0 + deviation * deviation) } else { 0.0 }
}

impl Solution {
    /// Keeps a region of the fields, in their pixels; what was judged of the whole stays.
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

    /// The largest rectangle of the fields in which V is valid everywhere; `None` where no pixel is.
    pub fn largest_valid(&self) -> Option<Region> {
        let valid: Vec<bool> = self.relative_blur.iter().map(|v| v.is_finite()).collect();
        Region::largest_valid(&valid, self.width as usize)
    }

    /// Fills in what the fields say of themselves, |V| limited to so many px².
    pub(crate) fn count(&mut self, max_relative_blur: f64) {
        let counts = Counts::of(&self.relative_blur, &self.uncertainty, max_relative_blur);
        self.findings.tell(&counts);
    }
}

impl Findings {
    /// The part of I1 that the fields are of.
    pub fn region(&self) -> Region {
        Region { x: self.origin[0], y: self.origin[1], width: self.width, height: self.height }
    }

    /// What brings I2 to the brightness of I1.
    pub fn brightness(&self) -> Brightness {
        Brightness { photometric: self.photometric, shading: self.shading, part: self.solved }
    }

    /// Says that what was solved is a part of larger photographs, and states T about their centre.
    pub(crate) fn place_in(&mut self, part: Region, photograph: [u32; 2]) {
        self.transform = self.transform.about(part.centre(), centre(photograph[0], photograph[1]));
        (self.origin, self.photograph, self.solved) = ([part.x, part.y], photograph, part);
    }

    /// Takes over what the fields say of themselves.
    pub(crate) fn tell(&mut self, counts: &Counts) {
        let valid = counts.valid.max(1) as f64;
        self.valid_fraction = counts.valid as f64 / counts.pixels.max(1) as f64;
        self.saturated_fraction = counts.saturated as f64 / valid;
        self.mean_confidence = counts.confidence / valid;
    }

    /// Fills in whether to believe it, where a mask leaves this share of the pixels.
    pub(crate) fn judge(&mut self, state: &State, settings: &Settings, counted: f64) {
        let mut doubts = Vec::new();
        if let Some(doubt) = numbers_doubt(state) {
            doubts.push(doubt);
        } else if self.valid_fraction < LEAST_VALID * counted {
            doubts.push(
                "the images do not overlap: see whether they belong together, or start from a nearer transform"
                    .to_string(),
            );
        } else if self.mean_confidence < LEAST_CONFIDENCE {
            doubts.push(
                "there is too little texture, or too much blur, to measure blur by: light or focus the scene so that texture shows"
                    .to_string(),
            );
        } else {
            doubts.extend(registration_doubt(state));
        }
        self.converged = doubts.is_empty();
        self.warnings = doubts;
        self.warnings.extend(shading_warning(&self.shading));
        self.warnings.extend(self.saturation(settings.max_relative_blur));
    }

    /// A sentence, where many pixels are at the limit of |V|, px².
    pub(crate) fn saturation(&self, max_relative_blur: f64) -> Option<String> {
        (self.saturated_fraction > MOST_SATURATED).then(|| {
            format!(
                "{:.0} % of the valid pixels are at the limit of |V|, {max_relative_blur} px²: raise the largest relative blur (256 px² at most), or focus the two nearer to each other",
                100.0 * self.saturated_fraction
            )
        })
    }

    /// Takes over what speaks against the registration that came first.
    pub(crate) fn doubt(&mut self, registered: &Registered) {
        self.converged &= registered.converged;
        for warning in &registered.warnings {
            if !self.warnings.contains(warning) {
                self.warnings.insert(0, format!("registration: {warning}"));
            }
        }
    }
}

/// What the fields say of themselves.
#[derive(Clone, Copy, Default)]
pub(crate) struct Counts {
    pixels: usize,
    valid: usize,
    /// At the limit of |V|.
    saturated: usize,
    /// Sum of those of the valid pixels.
    confidence: f64,
}

/// Pixels that are counted in one go.
const CHUNK: usize = 1 << 16;

impl Counts {
    /// Of V, |V| limited to so many px², and its standard deviation. In pieces whose sums are added up in their order, so that they are the
    /// same whatever the number of threads.
    pub(crate) fn of(relative_blur: &[f32], uncertainty: &[f32], max_relative_blur: f64) -> Self {
        // The limit is reached by clamping, so a thousandth below it is room for rounding alone.
        let limit = 0.999 * max_relative_blur as f32;
        let chunk = |n: usize| {
            let part = n * CHUNK..((n + 1) * CHUNK).min(relative_blur.len());
            let mut counts = Self { pixels: part.len(), ..Self::default() };
            for (v, deviation) in relative_blur[part.clone()].iter().zip(&uncertainty[part]) {
                counts.valid += usize::from(!v.is_nan());
                counts.saturated += usize::from(v.abs() >= limit);
                counts.confidence += f64::from(confidence(*deviation));
            }
            counts
        };
        let add = |sum: Self, part: Self| Self {
            pixels: sum.pixels + part.pixels,
            valid: sum.valid + part.valid,
            saturated: sum.saturated + part.saturated,
            confidence: sum.confidence + part.confidence,
        };
        let chunks = workers::map(relative_blur.len().div_ceil(CHUNK), chunk);
        chunks.into_iter().fold(Self::default(), add)
    }
}

/// A sentence, where the light differs much over the frame.
pub(crate) fn shading_warning(shading: &Shading) -> Option<String> {
    let [low, high] = shading.range();
    (low < 1.0 - MOST_SHADING || high > 1.0 + MOST_SHADING).then(|| {
        format!(
            "I2 was made {:+.0} to {:+.0} % brighter from place to place to shine as I1 does: keep lamp and aperture as they are between the photographs",
            100.0 * (low - 1.0),
            100.0 * (high - 1.0)
        )
    })
}

/// Whether the state holds numbers at all.
pub(crate) fn numbers_doubt(state: &State) -> Option<String> {
    let single = state.registration;
    let numbers = [&single.linear[..], &single.t, &single.g, &[single.gain, single.offset]].concat();
    let finite = numbers.iter().all(|v| v.is_finite());
    (!finite).then(|| "the solve ran out of numbers: bring the images nearer to 0 to 1".to_string())
}

/// What speaks against the registration, if anything does.
pub(crate) fn registration_doubt(state: &State) -> Option<String> {
    let finest = &state.levels[0];
    if state.degenerate == 1 {
        Some(
            "the images do not determine the registration: hold what is known, or see that texture shows all over"
                .to_string(),
        )
    } else if state.correlation < LEAST_CORRELATION {
        Some(format!(
            "the registered images hardly correlate ({:.2}): see whether they belong together, or start from a nearer transform",
            state.correlation
        ))
    } else if finest.iterations > 0 && finest.converged == 0 {
        Some(format!(
            "the finest level had not converged after {} outer iterations: allow more, or more levels if fewer than auto were asked for",
            finest.iterations
        ))
    } else {
        None
    }
}
