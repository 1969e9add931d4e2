//! Estimates gain, offset and shading from [samples](super::pair_samples) of the
//! [blur-matched pair](super::blur_matched_pair).
//!
//! Gain and offset map mean and deviation of I2 to those of I1. As an unknown of the energy, the gain would be biased
//! by noise: it lowers the correlation of J and thereby the gain (at noise 0.03 to 0.93 instead of 1; V rises by 0.37
//! px²). After smoothing, noise is a hundredth of the contrast, and lowers a ratio of deviations by less than a
//! thousandth.
//!
//! Each sample counts by its weight, one over the square that its residual is expected to have. What blur, T and
//! shading do not explain is a share of the light, so that equal weights would fit bright places alone and leave a
//! mismatch in the dark that is most of the signal there. A dark cloth at 0.005 of full scale, off by an offset of
//! 0.003, had V = -0.1 ± 0.1 px² instead of 150.
//!
//! The shading is fitted by least squares, reweighted by Cauchy's function against outliers: I1 minus the offset is a
//! polynomial times I2. Then the share that chance explains with as many terms is subtracted (James and Stein):
//! photographs that need no shading get none.

use nalgebra::{SMatrix, SVector};

use super::blur_matched_pair::LAYERS;
use super::pass::{Memory, Pass};
use super::state::{DoubleState, from_centre};
use super::{Number, pixels};
use crate::base::{Shading, brightness};
use crate::engine::shaders;
use crate::engine::vulkan::{LEAST_WORKGROUP, Variant};

pub use super::interface::exposure::*;

/// Which estimates are adopted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Adopt {
    /// None: only the correlation is measured.
    Nothing,
    /// Gain and offset.
    Exposure,
    /// Gain, offset and shading.
    Shading,
}

/// The variant that matches the shading too. It takes ten times as many instructions.
pub(crate) fn variant(adopt: Adopt) -> Variant {
    Variant::SHADES.when(adopt == Adopt::Shading)
}

/// The most samples, for one workgroup.
const MOST_SAMPLES: f64 = 4096.0;
/// The least distance of samples, pixels of the pair, if there are enough: under the window, closer samples are
/// correlated.
const LEAST_EVERY: f64 = 4.0;
/// Samples below which the distance is reduced further.
const LEAST_SAMPLES: f64 = 128.0;
/// Pixels of the pair that a window of σ 2 px averages: 4π σ².
const WINDOW: f64 = 50.0;

impl Constants {
    /// The constants of a level.
    pub(crate) fn new([width, height]: [u32; 2], factor: f64, centre: [f64; 2], adopt: Adopt) -> Self {
        let all = pixels(width, height) as f64 / 4.0;
        let least = (all / LEAST_SAMPLES).sqrt().floor().clamp(1.0, LEAST_EVERY);
        let every = (all / MOST_SAMPLES).sqrt().ceil().max(least);
        Self {
            width,
            height,
            factor: factor as f32,
            centre: centre.map(|c| c as f32),
            every: every as u32,
            adopt: u32::from(adopt != Adopt::Nothing),
            dependent: (WINDOW / (every * every)).max(1.0) as f32,
        }
    }

    /// The number of samples.
    pub(crate) fn samples(&self) -> usize {
        let [columns, rows] = [self.width, self.height].map(|side| side.div_ceil(2 * self.every) as usize);
        columns * rows
    }
}

/// Bytes of the samples on a level.
pub(crate) fn bytes_of_samples(size: [u32; 2]) -> u64 {
    let c = Constants::new(size, 1.0, [0.0; 2], Adopt::Nothing);
    4 * u64::from(LAYERS) * c.samples() as u64
}

/// Whether a level has enough pixels for 14 terms of shading: 60 independent samples.
pub(crate) fn shows_shading([width, height]: [u32; 2]) -> bool {
    pixels(width, height) as f64 >= 4.0 * WINDOW * 60.0
}

// An invocation for each element of the normal equations and of their right side.
const _: () = assert!((Shading::TERMS + 1) * (Shading::TERMS + 2) <= LEAST_WORKGROUP as usize);

impl Pass for Bindings {
    /// Compulsory traffic: the samples, once.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        4 * u64::from(LAYERS) * c.samples() as u64
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let mut state = memory.state(self.state).clone();
        cpu_reference(c, variant.has(Variant::SHADES), &mut state, memory.numbers(self.means));
        *memory.state_mut(self.state) = state;
    }
}

/// A sample of both images, its share, its weight (1 in the dark), and its place on I2, -1 to 1 along either side.
struct Sample {
    u: f64,
    v: f64,
    share: f64,
    weight: f64,
    place: [f64; 2],
}

/// Matches gain and offset in place, with `shades` also the shading, and measures the correlation.
pub fn cpu_reference<N: Number>(c: &Constants, shades: bool, state: &mut DoubleState, samples: &[N]) {
    let samples = counting(c, state, samples);
    match_moments(c, state, &samples);
    if shades && state.correlation > 0.5 {
        match_shading(c, state, &samples);
    }
}

/// The samples that count, of the means of all three layers.
fn counting<N: Number>(c: &Constants, state: &DoubleState, means: &[N]) -> Vec<Sample> {
    let (centre, spacing) = (c.centre.map(f64::from), 2 * c.every as usize);
    let (count, columns) = (c.samples(), (c.width as usize).div_ceil(spacing));
    let mean = |layer: usize, n: usize| means[layer * count + n].into();
    let counting = (0..count).filter(|&n| mean(2, n) > 0.5);
    counting
        .map(|n| {
            let ([x, y], share) = ([n % columns, n / columns].map(|place| place * spacing), mean(2, n));
            let d = state.registration.displacement(x, y, c.factor.into(), centre);
            let place = from_centre([x as f64 + d[0], y as f64 + d[1]], centre);
            let [u, v] = [0, 1].map(|side| mean(side, n) / share);
            let weight = DARK * DARK / (DARK * DARK + (0.5 * (u + v)).powi(2));
            Sample { u, v, share, weight, place }
        })
        .collect()
}

/// Gain and offset from mean and deviation of both images.
fn match_moments(c: &Constants, state: &mut DoubleState, samples: &[Sample]) {
    let mean = |term: &dyn Fn(f64, f64) -> f64| {
        let sum: f64 = samples.iter().map(|s| s.share * s.weight * term(s.u, s.v)).sum();
        sum / samples.iter().map(|s| s.share * s.weight).sum::<f64>().max(1e-12)
    };
    let (mean1, mean2) = (mean(&|u, _| u), mean(&|_, v| v));
    let variance1 = mean(&|u, _| (u - mean1).powi(2));
    let variance2 = mean(&|_, v| (v - mean2).powi(2));
    let covariance = mean(&|u, v| (u - mean1) * (v - mean2));
    let contrast = variance1.min(variance2) > 1e-6;
    state.correlation = if contrast { covariance / (variance1 * variance2).sqrt() } else { 0.0 };
    if c.adopt == 1 {
        let gain = if state.correlation > 0.5 { (variance1 / variance2).sqrt() } else { 1.0 };
        state.registration.gain = gain;
        state.registration.offset = mean1 - gain * mean2;
    }
}

/// Intensity below which a residual is expected to be as large as at zero: there noise and black level count more than
/// the light.
const DARK: f64 = shaders::exposure::DARK;

/// Rounds of least squares.
const ROUNDS: usize = shaders::exposure::ROUNDS as usize;

fn match_shading(c: &Constants, state: &mut DoubleState, samples: &[Sample]) {
    // I2 without its shading, and the target of its polynomial.
    let known: Vec<[f64; 2]> =
        samples.iter().map(|s| [s.v / state.applied_shading.at(s.place), s.u - state.registration.offset]).collect();
    let (mut constant, mut scale) = (state.registration.gain, f64::INFINITY);
    for round in 0.. {
        let left = |(sample, [second, target]): (&Sample, &[f64; 2])| {
            target - constant * second * state.shading.at(sample.place)
        };
        let left: Vec<f64> = samples.iter().zip(&known).map(left).collect();
        let shares = samples.iter().zip(&left);
        let counts: Vec<f64> = shares.map(|(s, left)| s.share / (1.0 + s.weight * (left / scale).powi(2))).collect();
        let weights: Vec<f64> = samples.iter().zip(&counts).map(|(s, count)| s.weight * count).collect();
        let squares = weights.iter().zip(&left).map(|(w, left)| w * left * left).sum::<f64>();
        let count = counts.iter().sum::<f64>().max(1.0);
        if round == ROUNDS {
            let alone =
                known.iter().zip(&weights).map(|([second, target], w)| w * (target - constant * second).powi(2));
            let explained = alone.sum::<f64>() - squares;
            let chance = squares * Shading::TERMS as f64 * f64::from(c.dependent) / count;
            let significant = if explained > chance { 1.0 - chance / explained } else { 0.0 };
            state.shading.coefficients.iter_mut().for_each(|c| *c *= significant);
            return;
        }
        let coefficients = least_squares(samples, &known, &weights);
        constant = coefficients[0];
        state.shading.coefficients = std::array::from_fn(|n| coefficients[n + 1] / constant.max(1e-3));
        scale = 2.0 * (squares / count).sqrt() + 1e-6;
    }
}

/// The terms of that polynomial.
const ALL: usize = Shading::TERMS + 1;

/// The coefficients of the polynomial that maps I2 to I1 minus the offset, the constant one first.
fn least_squares(samples: &[Sample], known: &[[f64; 2]], weights: &[f64]) -> SVector<f64, ALL> {
    let (mut normal, mut right) = (SMatrix::<f64, ALL, ALL>::zeros(), SVector::<f64, ALL>::zeros());
    for ((sample, [second, target]), &weight) in samples.iter().zip(known).zip(weights) {
        let terms = SVector::from(brightness::terms(sample.place)) * *second;
        normal.ger(weight, &terms, &terms, 1.0);
        right.axpy(weight * target, &terms, 1.0);
    }
    for i in 0..ALL {
        normal[(i, i)] = normal[(i, i)] * (1.0 + 1e-5) + 1e-12;
    }
    normal.cholesky().map_or_else(SVector::zeros, |root| root.solve(&right))
}

#[cfg(test)]
mod tests {
    use super::super::Field;
    use super::super::harness::smooth_field;
    use super::super::state::{Registration, State};
    use super::*;
    use crate::base::{Photometric, Similarity};
    use crate::engine::slot::Slot;

    /// The state after `exposure` of a pair for a level twice as large.
    fn matched(sides: [&Field; 2], applied_shading: Shading, adopt: Adopt) -> DoubleState {
        let (width, height) = (sides[0].width, sides[0].height);
        let share = Field::from_fn(width, height, |x, y| if x < 3 { 0.0 } else { 0.8 + 0.2 * (y as f64).sin().abs() });
        let of = |side: &Field| Field::from_fn(width, height, |x, y| share.get(x, y) * side.get(x, y));
        let layers = [of(sides[0]), of(sides[1]), share];
        let mut state = State::new(&Registration::new(Similarity::IDENTITY, &Photometric::IDENTITY));
        state.applied_shading = applied_shading.coefficients.map(|c| c as f32);
        let centre = [width as f64 - 0.5, height as f64 - 0.7];
        let c = Constants::new([2 * width as u32 - 1, 2 * height as u32], 4.0, centre, adopt);
        let along = |side: usize| (0..side).step_by(c.every as usize);
        let sampled = |layer: &Field| {
            along(height)
                .flat_map(|y| along(width).map(move |x| [x, y]))
                .map(|[x, y]| layer.get(x, y))
                .collect::<Vec<f64>>()
        };
        let samples: Vec<f64> = layers.iter().flat_map(sampled).collect();
        let mut memory = Memory::<f64>::new();
        memory.numbers.insert(Slot::Partials, samples);
        memory.states.insert(Slot::State, (&state).into());
        Bindings::on(0).run(&c, variant(adopt), &mut memory);
        memory.state_in(Slot::State).clone()
    }

    #[test]
    fn a_known_exposure_is_found() {
        for (width, height) in [(41, 23), (16, 9), (160, 120)] {
            let i1 = smooth_field(width, height, 1);
            let i2 = Field::from_fn(width, height, |x, y| (i1.get(x, y) - 0.05) / 0.8);
            let actual = matched([&i1, &i2], Shading::NONE, Adopt::Exposure).registration;
            assert!((actual.gain - 0.8).abs() < 1e-9 && (actual.offset - 0.05).abs() < 1e-9, "{actual:?}");
        }
    }

    #[test]
    fn a_known_shading_is_found_after_any_applied_shading() {
        let (width, height) = (90, 70);
        let i1 = smooth_field(width, height, 1);
        let truth = Shading { coefficients: std::array::from_fn(|n| 0.06 * (1.3 * n as f64).sin() / (1.0 + n as f64)) };
        let place = |x, y| from_centre([2.0 * x as f64, 2.0 * y as f64], [width as f64 - 0.5, height as f64 - 0.7]);
        let mut first = Shading::NONE;
        first.coefficients[1] = 0.05;
        for applied_shading in [Shading::NONE, first] {
            let by = |x, y| applied_shading.at(place(x, y)) / truth.at(place(x, y));
            let i2 = Field::from_fn(width, height, |x, y| by(x, y) * i1.get(x, y) / 1.1);
            let actual = matched([&i1, &i2], applied_shading, Adopt::Shading);
            for (actual, truth) in actual.shading.coefficients.iter().zip(truth.coefficients) {
                // The match of deviations before takes some of the shading for an offset.
                assert!((actual - truth).abs() < 0.01, "{actual} {truth}");
            }
        }
    }

    #[test]
    fn images_without_shading_get_none() {
        let (i1, noise) = (smooth_field(120, 90, 1), smooth_field(120, 90, 7));
        let i2 = Field::from_fn(120, 90, |x, y| i1.get(x, y) + 0.01 * (noise.get(x, y) - 0.5));
        let actual = matched([&i1, &i2], Shading::NONE, Adopt::Shading);
        let [low, high] = actual.shading.range();
        assert!(high - low < 0.01, "{low} {high}");
    }

    #[test]
    fn flat_images_match_in_the_mean() {
        let flat = |v| Field::from_fn(20, 10, |_, _| v);
        let actual = matched([&flat(0.5), &flat(0.4)], Shading::NONE, Adopt::Shading).registration;
        assert!((actual.gain - 1.0).abs() < 1e-9 && (actual.offset - 0.1).abs() < 1e-9, "{actual:?}");
    }
}
