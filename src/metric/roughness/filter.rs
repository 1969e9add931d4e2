//! The areal Gaussian filter of ISO 16610-61, for profiles ISO 16610-21, and the robust one of ISO 16610-71.

use std::f64::consts::{LN_2, PI};

use super::areal::Surface;
use crate::base::statistics::median;
use crate::base::weighted;

/// The shortest cutoff, px. The weights of a shorter one are too few samples of the Gaussian: at 3 px they pass 12 %
/// more than half of the cutoff's amplitude, at 4 px 0.4 %.
pub const LEAST_CUTOFF: f64 = 4.0;

/// Cutoff of the biweight in median absolute deviations: three standard deviations of Gaussian heights (ISO 16610-71).
const BIWEIGHT: f64 = 4.4478;
/// The relative change of the biweight's cutoff at which the robust filter has settled, and the limit of iterations.
const SETTLED: f64 = 1e-3;
const MAX_ITERATIONS: usize = 30;

/// A Gaussian weighting function of one direction, which passes half of the amplitude at its cutoff wavelength.
pub(super) struct Gaussian {
    /// The weights from -radius to radius.
    weights: Vec<f64>,
}

impl Gaussian {
    /// Makes the filter of a cutoff wavelength, px.
    pub(super) fn new(cutoff: f64) -> Self {
        // The standard's exp(-π (x/(α λ))²) with α = sqrt(ln 2/π). At one cutoff from the centre it is 7e-7.
        Self::sampled(cutoff.ceil() as usize, |x| (-PI * PI / LN_2 * (x / cutoff).powi(2)).exp())
    }

    /// Makes the weights of a Gaussian of this standard deviation, px, whose squares have the sum 1 in two directions.
    pub(super) fn of_unit_variance(sigma: f64) -> Self {
        let mut made = Self::sampled((4.0 * sigma).ceil() as usize, |x| (-0.5 * (x / sigma).powi(2)).exp());
        let norm = made.weights.iter().map(|w| w * w).sum::<f64>().sqrt();
        made.weights.iter_mut().for_each(|w| *w /= norm);
        made
    }

    fn sampled(radius: usize, of: impl Fn(f64) -> f64) -> Self {
        let weights: Vec<f64> = (0..=2 * radius).map(|i| of(i as f64 - radius as f64)).collect();
        let sum: f64 = weights.iter().sum();
        Self { weights: weights.into_iter().map(|w| w / sum).collect() }
    }

    /// Returns the number of pixels on each side that the filter reaches.
    pub(super) fn radius(&self) -> usize {
        self.weights.len() / 2
    }

    /// Returns the mean line or surface: the weighted mean of the measured pixels around each measured pixel.
    ///
    /// Missing pixels and those outside have no weight, and the others' weights are normalised. Nothing is filled in.
    pub(super) fn smooth(&self, surface: &Surface) -> Surface {
        self.smooth_weighted(surface, None)
    }

    /// Returns the mean with additional weights of the pixels.
    fn smooth_weighted(&self, surface: &Surface, additional: Option<&[f64]>) -> Surface {
        let weight = |i: usize| match surface.values[i].is_finite() {
            true => additional.map_or(1.0, |weights| weights[i]),
            false => 0.0,
        };
        let weights: Vec<f64> = (0..surface.values.len()).map(weight).collect();
        let products = surface.values.iter().zip(&weights).map(|(z, w)| if *w > 0.0 { w * z } else { 0.0 }).collect();
        let [sums, norms] = [products, weights].map(|values| self.sum(values, surface.width));
        let means = sums.iter().zip(&norms).zip(&surface.values);
        let values = means.map(|((sum, norm), z)| if z.is_finite() && *norm > 0.0 { sum / norm } else { f64::NAN });
        Surface { width: surface.width, values: values.collect() }
    }

    /// Returns the weighted sums along rows and columns. A single row is summed along its length only.
    pub(super) fn sum(&self, values: Vec<f64>, width: usize) -> Vec<f64> {
        let along = self.sum_rows(&values, width);
        if values.len() <= width { along } else { self.sum_columns(&along, width) }
    }

    fn sum_rows(&self, values: &[f64], width: usize) -> Vec<f64> {
        let radius = self.radius();
        let mut sums = vec![0.0; values.len()];
        let mut padded = vec![0.0; width + 2 * radius];
        for (row, sums) in values.chunks_exact(width).zip(sums.chunks_exact_mut(width)) {
            padded[radius..radius + width].copy_from_slice(row);
            let shifted: Vec<&[f64]> = (0..self.weights.len()).map(|n| &padded[n..n + width]).collect();
            weighted::sum(sums, &self.weights, &shifted);
        }
        sums
    }

    fn sum_columns(&self, values: &[f64], width: usize) -> Vec<f64> {
        let (radius, rows) = (self.radius(), values.chunks_exact(width).collect::<Vec<_>>());
        let mut sums = vec![0.0; values.len()];
        for (y, sums) in sums.chunks_exact_mut(width).enumerate() {
            // Rows outside count as zero.
            let (first, last) = (y.saturating_sub(radius), (y + radius).min(rows.len() - 1));
            let from = first + radius - y;
            weighted::sum(sums, &self.weights[from..=from + last - first], &rows[first..=last]);
        }
        sums
    }

    /// Returns the robust mean: pixels far from it have less weight, by Tukey's biweight.
    ///
    /// It is the regression filter of ISO 16610-71 of order 0, since the form has been removed. The cutoff of the
    /// biweight is 4.4478 times the median absolute deviation of all measured pixels from the mean.
    pub(super) fn smooth_robustly(&self, surface: &Surface) -> Surface {
        let mut mean = self.smooth(surface);
        let mut cutoff = f64::MAX;
        for _ in 0..MAX_ITERATIONS {
            let residuals: Vec<f64> = surface.values.iter().zip(&mean.values).map(|(z, w)| (z - w).abs()).collect();
            let next = BIWEIGHT * median(residuals.iter().copied()).unwrap_or(0.0);
            if next <= 0.0 || (next - cutoff).abs() <= SETTLED * cutoff {
                break;
            }
            cutoff = next;
            let biweight = |r: &f64| if *r < cutoff { (1.0 - (r / cutoff).powi(2)).powi(2) } else { 0.0 };
            let weights: Vec<f64> = residuals.iter().map(biweight).collect();
            let refined = self.smooth_weighted(surface, Some(&weights));
            // A pixel without any of weight around it keeps its mean.
            for (mean, refined) in mean.values.iter_mut().zip(refined.values) {
                *mean = if refined.is_finite() { refined } else { *mean };
            }
        }
        mean
    }
}

/// The filters of an evaluation.
#[derive(Default)]
pub(super) struct Filters {
    s_filter: Option<Gaussian>,
    l_filter: Option<Gaussian>,
    pub(super) l_cutoff: Option<f64>,
    pub(super) is_robust: bool,
}

impl Filters {
    /// Makes filters of cutoff wavelengths in px, which are not robust.
    pub(super) fn new(s_cutoff: Option<f64>, l_cutoff: Option<f64>) -> Self {
        let [s_filter, l_filter] = [s_cutoff, l_cutoff].map(|cutoff| cutoff.map(Gaussian::new));
        Self { s_filter, l_filter, l_cutoff, is_robust: false }
    }

    /// Applies the S-filter, then the L-filter.
    pub(super) fn apply(&self, surface: Surface) -> Surface {
        let mut surface = self.s_filter.as_ref().map(|filter| filter.smooth(&surface)).unwrap_or(surface);
        let waviness = self.l_filter.as_ref().map(|filter| match self.is_robust {
            true => filter.smooth_robustly(&surface),
            false => filter.smooth(&surface),
        });
        if let Some(waviness) = waviness {
            surface.values.iter_mut().zip(waviness.values).for_each(|(z, mean)| *z -= mean);
        }
        surface
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::super::areal::tests::{close, surface};
    use super::*;

    /// Amplitude of a sine of this wavelength after the filter, as a share, away from the borders.
    fn passed(cutoff: f64, wavelength: f64) -> f64 {
        let size = [(6.0 * wavelength) as usize, 3];
        let sine = surface(size, |x, _| (TAU * x / wavelength).sin());
        let smooth = Gaussian::new(cutoff).smooth(&sine);
        let inner = |s: &Surface| {
            let row = &s.values[size[0]..2 * size[0]];
            row[size[0] / 3..size[0] / 3 + wavelength as usize].iter().map(|z| z * z).sum::<f64>().sqrt()
        };
        inner(&smooth) / inner(&sine)
    }

    #[test]
    fn half_of_a_sine_passes_at_the_cutoff() {
        for cutoff in [8.0, 20.0, 80.0] {
            close(passed(cutoff, cutoff), 0.5, 1e-5);
            // The transmission is 2^-(cutoff/wavelength)².
            close(passed(cutoff, 2.0 * cutoff), 0.5f64.powf(0.25), 1e-5);
        }
        close(passed(LEAST_CUTOFF, LEAST_CUTOFF), 0.5, 0.005);
    }

    #[test]
    fn the_weights_are_those_of_a_direct_sum_with_missing_pixels() {
        let mut bumpy = surface([23, 17], |x, y| (0.7 * x).sin() + 0.1 * y * y);
        for i in [0, 50, 51, 52, 200, 390] {
            bumpy.values[i] = f64::NAN;
        }
        let cutoff = 6.0;
        let smooth = Gaussian::new(cutoff).smooth(&bumpy);
        for i in [1, 49, 53, 180, 389] {
            let ([x, y], mut sums) = ([(i % 23) as f64, (i / 23) as f64], [0.0; 2]);
            for (j, z) in bumpy.values.iter().enumerate().filter(|(_, z)| z.is_finite()) {
                let [dx, dy] = [(j % 23) as f64 - x, (j / 23) as f64 - y];
                let sigma = cutoff * (LN_2 / 2.0).sqrt() / PI;
                let w = (-(dx * dx + dy * dy) / (2.0 * sigma * sigma)).exp();
                sums = [sums[0] + w * z, sums[1] + w];
            }
            close(smooth.values[i], sums[0] / sums[1], 2e-6);
        }
        assert!(smooth.values[50].is_nan() && smooth.values[0].is_nan());
        let flat = surface([23, 17], |_, _| 3.5);
        assert!(Gaussian::new(9.0).smooth(&flat).values.iter().all(|z| (z - 3.5).abs() < 1e-12));
    }

    #[test]
    fn the_robust_filter_does_not_follow_a_scratch() {
        let waves = |x: f64, y: f64| 0.05 * ((1.9 * x).sin() + (2.3 * y).cos()) + (TAU * x / 120.0).sin();
        let clean = surface([120, 60], waves);
        let scratched = surface([120, 60], |x, y| waves(x, y) - if (58.0..62.0).contains(&x) { 20.0 } else { 0.0 });
        let (filter, inner) =
            (Gaussian::new(40.0), |i: &usize| (20..100).contains(&(i % 120)) && (20..40).contains(&(i / 120)));
        // Away from the border, where the mean is one-sided.
        let off = |of: Surface| {
            let expected = filter.smooth(&clean);
            let apart = |i: usize| (of.values[i] - expected.values[i]).abs();
            (0..of.values.len()).filter(inner).map(apart).fold(0.0, f64::max)
        };
        let [linear, robust] = [off(filter.smooth(&scratched)), off(filter.smooth_robustly(&scratched))];
        let same = off(filter.smooth_robustly(&clean));
        println!("off by {linear:.3} linear, {robust:.3} robust, of a scratch of 20; {same:.3} without one");
        assert!(linear > 3.0 && robust < 0.15 && same < 0.1, "{linear} {robust} {same}");
    }

    #[test]
    fn a_unit_variance_filter_keeps_the_variance_of_noise() {
        let filter = Gaussian::of_unit_variance(3.0);
        let one = filter.weights.iter().map(|w| w * w).sum::<f64>();
        close(one, 1.0, 1e-12);
    }
}
