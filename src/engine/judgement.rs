//! Whether the results of a solve and of a registration can be believed: the checks that set convergence and warnings.

use super::channels::ColorShift;
use super::contrast::{OneFocus, Shaken};
use super::effects::determine_v;
use super::motion::TransformDeviation;
use super::processing::{blocks_warning, filtered_warning};
use super::script::MOST_MOVING;
use super::solution::{Findings, Registered, Solution, confidence};
use super::stages::scale_deviation::without_scale;
use super::stages::state::State;
use super::stages::uncertainty::{LARGEST, UNEXPLAINED, at_limit};
use super::windows::Gradients;
use crate::base::{Kernel, Settings, Shading, workers};

/// Least valid share of the frame: photographs with less do not overlap.
const LEAST_VALID: f64 = 0.01;
/// Least mean confidence of the pixels below the limit of |V|, an uncertainty of 14 px² all over: below it smoothness
/// fills in V nearly everywhere.
///
/// Of real pairs the widest blurred, a macro photograph with 89 % of its pixels at the limit of |V|, has 0.02.
const LEAST_CONFIDENCE: f64 = 0.005;
/// Least low-pass correlation of images of one scene.
const LEAST_CORRELATION: f32 = 0.5;
/// Largest share of valid pixels at the limit of |V| without a warning.
const MOST_SATURATED: f64 = 0.1;
/// Largest share of such pixels without a warning. Real pairs have 0.01 to 0.08, and 0.22 with highlights that move;
/// 0.2 to 0.7 if a quarter or a half of the scene moved or is another.
const MOST_UNEXPLAINED: f64 = 0.15;
/// Largest standard deviation of T at a corner without a warning, px: twice the error that counts as a failed
/// registration. Real pairs have 0.01 to 0.3, and 0.8 of 2048 px where the blur is too wide to be measured.
const MOST_DEVIATION: f64 = 0.5;
/// How the doubt about a level that has not settled begins.
const STOPPED: &str = "stopped after";
/// The warning that V is not determined.
const UNDETERMINED: &str = "the photographs do not determine V, because brightness changes them as blur does or noise hides what blur changes: see that texture of several sizes shows, and that it is in focus in one of the two";
/// Largest shading without a warning: lenses that vignette differ by less.
const MOST_SHADING: f64 = 0.2;

impl Solution {
    /// Counts valid, saturated and confident pixels again.
    pub(crate) fn recount(&mut self) {
        let maps = [&self.relative_blur[..], &self.uncertainty, &self.residual];
        let counts = Counts::new(maps, &self.findings);
        self.findings.set_counts(&counts);
    }
}

impl Findings {
    pub(crate) fn set_counts(&mut self, counts: &Counts) {
        let valid = counts.valid.max(1) as f64;
        self.valid_fraction = counts.valid as f64 / counts.pixels.max(1) as f64;
        self.saturated_fraction = counts.saturated as f64 / valid;
        self.unexplained_fraction = counts.unexplained as f64 / valid;
        self.mean_confidence = counts.confidence / valid;
    }

    /// Judges whether the result can be believed. A mask leaves the share `counted` of the pixels; `texture` is the
    /// mean confidence without the deviation of V's scale.
    pub(crate) fn judge(&mut self, state: &State, counted: f64, texture: f64) {
        let pixels = f64::from(self.width) * f64::from(self.height);
        let clipping = Clipping::new(state, pixels * counted, pixels * self.valid_fraction);
        self.clipped_fractions = clipping.fractions;
        let doubt = numbers_doubt(state).or_else(|| {
            if self.valid_fraction < LEAST_VALID * counted {
                Some(
                    "the images do not overlap: see whether they belong together, or start from a nearer transform"
                        .to_string(),
                )
            } else if texture <= LEAST_CONFIDENCE * (1.0 - self.saturated_fraction) {
                Some(
                    "there is too little texture, or too much blur, to measure blur by: light or focus the scene so that texture shows"
                        .to_string(),
                )
            } else {
                registration_doubt(state)
            }
        });
        self.converged = doubt.is_none() && clipping.is_determined();
        let saturation = self.saturation();
        let warnings =
            [clipping.warning(), doubt, shading_warning(&self.shading), saturation, self.unexplained_warning()];
        self.warnings = warnings.into_iter().flatten().collect();
    }

    /// Whether the finest level was stopped before it settled.
    pub(crate) fn is_stopped(&self) -> bool {
        self.warnings.iter().any(|warning| warning.starts_with(STOPPED))
    }

    /// Judges whether the images determine T; `undetermined` is the direction in which they do not.
    pub(crate) fn determine(&mut self, undetermined: Option<f64>) {
        let directions = "(0° is along rows, 90° along columns)";
        if let Some(direction) = undetermined {
            // More iterations would not help.
            self.warnings.retain(|warning| !warning.starts_with(STOPPED));
            self.warnings.insert(
                0,
                format!(
                    "the images do not determine the registration along {direction:.0}° {directions}: see that texture shows in every direction, or hold what is known"
                ),
            );
            (self.converged, self.transform_deviation) = (false, None);
        } else if let Some(TransformDeviation { corner_px, direction_deg }) = self.transform_deviation
            && corner_px > MOST_DEVIATION
        {
            self.warnings.push(format!(
                "the images determine the registration to {corner_px:.1} px only, along {direction_deg:.0}° {directions}: mask what moved between the photographs, or see that texture shows in every direction"
            ));
        }
    }

    /// Judges whether the contrasts of the photographs differ as by defocus; from V and its standard deviation.
    pub(crate) fn compare_contrasts(
        &mut self,
        gradients: &Gradients,
        settings: &Settings,
        [v, deviation]: [&[f32]; 2],
    ) {
        let unmatched = gradients.unmatched.as_ref();
        if let Some(found) = unmatched.and_then(|windows| OneFocus::of(windows, v, deviation, self.scale_deviation)) {
            self.converged &= !found.is_noise();
            self.warnings.push(found.warning());
        }
        let valid = self.valid_fraction * f64::from(self.width) * f64::from(self.height);
        if !determine_v(&gradients.effects, settings.photometric, valid, self.noise) {
            self.converged = false;
            self.warnings.push(UNDETERMINED.to_string());
        }
        // A kernel that is not round blurs by direction.
        let is_round = matches!(settings.kernel, Kernel::Auto | Kernel::Gaussian | Kernel::Pillbox);
        if let Some(found) = Shaken::of(&gradients.matched).filter(|_| is_round) {
            self.converged = false;
            self.warnings.push(found.warning());
        }
        self.color_shift = ColorShift::of(&gradients.channels, deviation);
        self.warnings.extend(self.color_shift.and_then(|shift| shift.warning()));
        self.warnings.extend(blocks_warning(&gradients.steps));
        self.warnings.extend(filtered_warning(&gradients.noise));
    }

    /// A warning, if many pixels are at the limit of |V|.
    pub(crate) fn saturation(&self) -> Option<String> {
        (self.saturated_fraction > MOST_SATURATED).then(|| {
            let (share, limit) = (100.0 * self.saturated_fraction, self.max_relative_blur);
            let advice = match limit < Settings::WIDEST_BLUR {
                true => format!("raise max_relative_blur, up to {} px²", Settings::WIDEST_BLUR),
                false => "close the aperture, take a sweep".to_string(),
            };
            format!(
                "{share:.0} % of the valid pixels are at the limit of |V|, {limit} px², and count as not measured: {advice}, or focus the two nearer to each other"
            )
        })
    }

    /// A warning, if much of the scene moved, or is not the same.
    pub(crate) fn unexplained_warning(&self) -> Option<String> {
        (self.unexplained_fraction > MOST_UNEXPLAINED).then(|| {
            format!(
                "the photographs differ on {:.0} % of the valid pixels by more than noise and blur explain, and V is not measured there: see residual.exr for what moved, shone or changed, and mask it",
                100.0 * self.unexplained_fraction
            )
        })
    }

    /// Adds the warnings of a registration that preceded the solve.
    pub(crate) fn doubt(&mut self, registered: &Registered) {
        self.converged &= registered.converged;
        for warning in &registered.warnings {
            if !self.warnings.contains(warning) {
                self.warnings.insert(0, format!("registration: {warning}"));
            }
        }
    }
}

impl Registered {
    /// Judges whether the registration can be believed. A mask leaves the share `counted` of the pixels.
    pub(crate) fn judge(&mut self, state: &State, counted: f64) {
        let counted = counted * f64::from(self.width) * f64::from(self.height);
        let clipping = Clipping::new(state, counted, counted * self.transform.overlap([self.width, self.height]));
        self.clipped_fractions = clipping.fractions;
        let doubt = numbers_doubt(state).or_else(|| registration_doubt(state));
        self.converged = doubt.is_none() && clipping.is_determined();
        self.warnings = [clipping.warning(), doubt, shading_warning(&self.shading)].into_iter().flatten().collect();
    }
}

/// Least share of the valid pixels that count, away from clipped pixels, for T to be determined; and without a warning.
///
/// Reliefs and terraces of 256 x 192 px were clipped at 5 to 90 % of their pixels: the bright ones, which are spread
/// all over, or all around a disk. While more than 0.3 of the valid pixels counted, the corners moved by at most 0.06
/// px. At 0.2 to 0.3 they moved by up to 2.5 px, below by up to 24 px, half of it with the solve at rest.
const LEAST_COUNTED: f64 = 0.25;
const LEAST_COUNTED_UNWARNED: f64 = 0.5;
/// The most pixels that a clipped one keeps from counting, itself included: it lowers the mean mask m around it by 1 in
/// all, and a pixel counts by 1 - 25 (1 - m).
const PIXELS_OF_A_CLIPPED_ONE: f64 = 25.0;

/// The clipped pixels of a pair, and what they leave.
struct Clipping {
    /// Of I1 and I2.
    fractions: [f64; 2],
    /// The share of the valid pixels that counts; 1 if clipped pixels do not explain what is missing.
    counted: f64,
}

impl Clipping {
    /// From the state, the number of pixels that no mask excludes, and the number of valid pixels.
    fn new(state: &State, pixels: f64, valid: f64) -> Self {
        let fractions = state.clipped.map(|count| f64::from(count) / pixels.max(1.0));
        let counted =
            if state.levels[0].iterations > 0 { f64::from(state.levels[0].valid) / valid.max(1.0) } else { 1.0 };
        let explained = 1.0 - PIXELS_OF_A_CLIPPED_ONE * (fractions[0] + fractions[1]);
        Self { fractions, counted: counted.max(explained) }
    }

    /// Whether enough pixels count to determine T.
    fn is_determined(&self) -> bool {
        self.counted >= LEAST_COUNTED
    }

    /// A warning, if few pixels count.
    fn warning(&self) -> Option<String> {
        let [first, second] = self.fractions.map(|fraction| 100.0 * fraction);
        let what = if self.is_determined() { "" } else { ", too few to determine the registration" };
        (self.counted < LEAST_COUNTED_UNWARNED).then(|| {
            format!(
                "{first:.0} % of the pixels of I1 and {second:.0} % of I2 are clipped, so that {:.0} % of the valid pixels count{what}: expose so that neither light nor dark areas are clipped, or mask them",
                100.0 * self.counted
            )
        })
    }
}

/// Counts of pixels by their V and its uncertainty.
#[derive(Clone, Copy, Default)]
pub(crate) struct Counts {
    pixels: usize,
    valid: usize,
    /// Pixels at the limit of |V|.
    saturated: usize,
    /// Pixels that are not measured because of what noise and blur do not explain.
    unexplained: usize,
    /// Sum of the confidence of the valid pixels.
    confidence: f64,
    /// Sum of the confidence without the deviation of V's scale.
    without_scale: f64,
}

/// Pixels that one thread counts at a time.
const CHUNK: usize = 1 << 16;

impl Counts {
    /// Counts fields. Sums of chunks are added in order, so that they do not depend on the number of threads.
    pub(crate) fn new([relative_blur, uncertainty, residual]: [&[f32]; 3], of: &Findings) -> Self {
        let (limit, explained) = (at_limit(of.max_relative_blur), (UNEXPLAINED * of.noise) as f32);
        let scale = of.scale_deviation as f32;
        let chunk = |n: usize| {
            let part = n * CHUNK..((n + 1) * CHUNK).min(relative_blur.len());
            let mut counts = Self { pixels: part.len(), ..Self::default() };
            let pixels = relative_blur[part.clone()].iter().zip(&uncertainty[part.clone()]).zip(&residual[part]);
            for ((v, deviation), residual) in pixels {
                counts.valid += usize::from(!v.is_nan());
                counts.saturated += usize::from(v.abs() >= limit);
                counts.unexplained += usize::from(*residual > explained && *deviation >= LARGEST && v.abs() < limit);
                counts.confidence += f64::from(confidence(*deviation));
                counts.without_scale += f64::from(confidence(without_scale(*deviation, scale * v)));
            }
            counts
        };
        let add = |sum: Self, part: Self| Self {
            pixels: sum.pixels + part.pixels,
            valid: sum.valid + part.valid,
            saturated: sum.saturated + part.saturated,
            unexplained: sum.unexplained + part.unexplained,
            confidence: sum.confidence + part.confidence,
            without_scale: sum.without_scale + part.without_scale,
        };
        let chunks = workers::map(relative_blur.len().div_ceil(CHUNK), chunk);
        chunks.into_iter().fold(Self::default(), add)
    }

    /// Mean confidence of the valid pixels without the deviation of V's scale: how well texture determines V.
    pub(crate) fn texture(&self) -> f64 {
        self.without_scale / self.valid.max(1) as f64
    }
}

/// A warning, if the light differs much over the frame.
fn shading_warning(shading: &Shading) -> Option<String> {
    let [low, high] = shading.range();
    (low < 1.0 - MOST_SHADING || high > 1.0 + MOST_SHADING).then(|| {
        format!(
            "I2 was made {:+.0} to {:+.0} % brighter from place to place to shine as I1 does: keep lamp and aperture as they are between the photographs",
            100.0 * (low - 1.0),
            100.0 * (high - 1.0)
        )
    })
}

/// A doubt, if the state does not hold finite numbers.
fn numbers_doubt(state: &State) -> Option<String> {
    let numbers: [f32; 10] = bytemuck::cast(state.registration);
    let finite = numbers.iter().all(|v| v.is_finite());
    let doubt = "the solve ran out of numbers: some samples are far brighter than the rest; mask them or state a white \
                 level";
    (!finite).then(|| doubt.to_string())
}

/// What moves when a level is stopped, by the share of the pixels that the last step moved.
fn still_moving(share: f32) -> String {
    if share > MOST_MOVING {
        format!("{:.0} % of the pixels still changing", 100.0 * share.min(1.0))
    } else {
        "the registration or depth edges still changing".to_string()
    }
}

/// A doubt about the registration, if there is one.
fn registration_doubt(state: &State) -> Option<String> {
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
    } else if finest.iterations > 0 && finest.settled == 0 {
        Some(format!(
            "{STOPPED} {} outer iterations on the finest level, with {}: allow more iterations, or more levels if fewer than auto were asked for",
            finest.iterations,
            still_moving(finest.moving)
        ))
    } else {
        None
    }
}
