//! Whether the lens focuses red, green and blue at one distance: how much more V each channel asks for than the sum of
//! them that was solved. Section 5 of `docs/method.md`.

use nalgebra::SMatrix;

use super::stages::uncertainty::LARGEST;
use crate::base::color::LUMINANCE;
use crate::base::statistics::median;

/// Changes of a channel at a pixel: by 1 px² of V, by displacements along x and y, by a gain, by an offset.
pub(super) const CHANGES: usize = 5;
/// The fewest windows that have a standard error.
pub(super) const FEWEST: usize = 8;
/// The least shift in standard errors. Real pairs have up to 3.4.
const CERTAIN: f64 = 4.0;
/// The least standard deviation of V over the channels that counts, px².
const LEAST: f64 = 0.1;
/// About how many deviations of V have the median of all.
const SAMPLES: usize = 10_000;

/// Sums over a window of the products of what changes one channel with what changes another, and with the residual.
///
/// The noise of channels is independent, so that none of it is in the products of two.
#[derive(Clone, Debug, Default)]
pub(crate) struct ChannelSums {
    products: [SMatrix<f64, CHANGES, CHANGES>; 3],
    residuals: [SMatrix<f64, CHANGES, 1>; 3],
    /// The squares of what changes the other channel by V.
    squares: [f64; 3],
}

impl ChannelSums {
    /// Adds a pixel: what changes red, green and blue, and the differences of their sides.
    pub(super) fn add_pixel(&mut self, changes: [[f64; CHANGES]; 3], differences: [f64; 3]) {
        let [red, green, blue] = changes.map(SMatrix::<f64, CHANGES, 1>::from);
        for (c, other) in [green, red + blue, green].iter().enumerate() {
            self.products[c] += other * SMatrix::<f64, CHANGES, 1>::from(changes[c]).transpose();
            self.residuals[c] += other * differences[c];
            self.squares[c] += other[0] * other[0];
        }
    }

    /// The V that a channel lacks, px², times its weight, and the weight; with displacement and brightness eliminated.
    fn lack(&self, c: usize) -> Option<[f64; 2]> {
        const REST: usize = CHANGES - 1;
        let (m, r) = (&self.products[c], &self.residuals[c]);
        let rest = m.fixed_view::<REST, REST>(1, 1).try_inverse()?;
        let row = m.fixed_view::<1, REST>(0, 1) * rest;
        let slope = m[0] - (row * m.fixed_view::<REST, 1>(1, 0))[0];
        let moment = r[0] - (row * r.fixed_view::<REST, 1>(1, 0))[0];
        let sums = [-slope * moment / self.squares[c], slope * slope / self.squares[c]];
        sums.iter().all(|v| v.is_finite()).then_some(sums)
    }
}

/// By how much V of a pair, px², or u of a sweep, settings, differs between the channels of the photographs. By the law of
/// a lens it is the same at all depths.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ColorShift {
    /// V or u by red less that by green.
    pub red: f64,
    /// V or u by blue less that by green.
    pub blue: f64,
    /// The standard errors of both.
    pub deviation: [f64; 2],
    /// The standard deviation of V or u that the uncertainty of the result includes for it: V then depends on the color of
    /// the texture. 0 if the shift may be chance, or is less than that uncertainty.
    pub included: f64,
}

impl ColorShift {
    /// From windows of the photographs after the sharper is blurred by V, and the standard deviations of V. The standard
    /// errors of the shift are those of the jackknife.
    pub(crate) fn of(windows: &[ChannelSums], uncertainty: &[f32]) -> Option<Self> {
        let lacks = windows.iter().filter_map(|window| Some([window.lack(0)?, window.lack(1)?, window.lack(2)?]));
        let lacks: Vec<[[f64; 2]; 3]> = lacks.collect();
        let count = lacks.len();
        let differences = |left_out: usize| {
            let [red, green, blue] = [0, 1, 2].map(|c| {
                let counted = lacks.iter().enumerate().filter(|(n, _)| *n != left_out);
                let [sum, weight] = counted.fold([0.0; 2], |[a, b], (_, lack)| [a + lack[c][0], b + lack[c][1]]);
                sum / weight
            });
            [red - green, blue - green]
        };
        let [red, blue] = differences(count);
        let without: Vec<[f64; 2]> = (0..count).map(differences).collect();
        let deviation = [0, 1].map(|n| {
            let mean = without.iter().map(|v| v[n]).sum::<f64>() / count as f64;
            let squares: f64 = without.iter().map(|v| (v[n] - mean).powi(2)).sum();
            ((count as f64 - 1.0) / count as f64 * squares).sqrt()
        });
        let is_finite = [red, blue, deviation[0], deviation[1]].iter().all(|v| v.is_finite());
        let shift = Self::judged([red, blue], deviation, LEAST.max(median_of(uncertainty)));
        (count >= FEWEST && is_finite).then_some(shift)
    }

    /// A shift that is included if it is certain, and its standard deviation over the channels more than `least`.
    pub(super) fn judged([red, blue]: [f64; 2], deviation: [f64; 2], least: f64) -> Self {
        let mut shift = Self { red, blue, deviation, included: 0.0 };
        if shift.is_certain() && shift.spread() > least {
            shift.included = shift.spread();
        }
        shift
    }

    fn is_certain(&self) -> bool {
        self.red.abs() > CERTAIN * self.deviation[0] || self.blue.abs() > CERTAIN * self.deviation[1]
    }

    /// The standard deviation of V over the channels, by their weights in luminance.
    fn spread(&self) -> f64 {
        let mean =
            |values: [f64; 3]| values.iter().zip(LUMINANCE).map(|(v, weight)| v * f64::from(weight)).sum::<f64>();
        let v = [self.red, 0.0, self.blue];
        (mean(v.map(|v| v * v)) - mean(v).powi(2)).sqrt()
    }

    /// The same shift in photographs of twice the size.
    pub(super) fn doubled(self) -> Self {
        let deviation = self.deviation.map(|v| 4.0 * v);
        Self { red: 4.0 * self.red, blue: 4.0 * self.blue, deviation, included: 4.0 * self.included }
    }

    /// The warning if V depends on the color of the texture.
    pub(crate) fn warning(&self) -> Option<String> {
        let Self { red, blue, .. } = self;
        (self.included > 0.0).then(|| {
            format!(
                "the lens focuses colours apart: V by red is {red:+.2} px² and by blue {blue:+.2} px² from V by green, so that V of their sum depends on the colour of the texture, by {:.2} px² (in σ): solve the green channel alone, or photograph in light of one colour",
                self.included
            )
        })
    }
}

/// The median of the standard deviations of V where it is measured; 0 if there are none.
fn median_of(uncertainty: &[f32]) -> f64 {
    let samples = uncertainty.iter().step_by(uncertainty.len() / SAMPLES + 1);
    median(samples.filter(|deviation| **deviation < LARGEST).map(|deviation| f64::from(*deviation))).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::Random;

    /// Windows that show one texture in red, green and blue. Each channel lacks some V. Every channel of either photograph
    /// has its own noise.
    fn windows(lacks: [f64; 3], noise: f64, seed: u64) -> Vec<ChannelSums> {
        let mut random = Random::new(seed, 4);
        let mut window = || {
            let mut sums = ChannelSums::default();
            for _ in 0..512 {
                let texture: [f64; CHANGES] = std::array::from_fn(|n| if n == 4 { 1.0 } else { random.normal() });
                let differences = lacks.map(|v| -v * texture[0] + 0.1 * texture[1] + 0.02 + noise * random.normal());
                sums.add_pixel([(); 3].map(|()| texture.map(|v| v + 0.5 * noise * random.normal())), differences);
            }
            sums
        };
        (0..16).map(|_| window()).collect()
    }

    #[test]
    fn channels_that_lack_v_differ_by_it_whatever_the_noise() {
        for seed in 1..6 {
            for noise in [0.01, 0.3] {
                let of = |lacks, uncertainty: f32| {
                    ColorShift::of(&windows(lacks, noise, seed), &[uncertainty, 2e3]).unwrap()
                };
                let found = of([1.2, -0.2, -1.0], 0.1);
                let errors = [(found.red - 1.4) / found.deviation[0], (found.blue + 0.8) / found.deviation[1]];
                assert!(errors.iter().all(|error| error.abs() < 4.0), "{found:?}");
                assert!((found.included - 0.79).abs() < 0.05 && found.warning().is_some(), "{found:?}");
                // Less than V is uncertain by, or none.
                assert_eq!(of([1.2, -0.2, -1.0], 2.0).warning(), None);
                assert_eq!(of([0.7; 3], 0.0).warning(), None);
            }
        }
        assert_eq!(ColorShift::of(&windows([1.0, 0.0, 0.0], 0.01, 1)[..7], &[]), None);
    }
}
