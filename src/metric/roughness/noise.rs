//! Seeded realizations of the noise of heights, which is alike at adjacent pixels.

use super::areal::Surface;
use super::filter::Gaussian;
use crate::base::random::Random;

/// Noise with the standard deviations of the heights.
pub(super) struct Noise<'a> {
    /// Standard deviations, row-major.
    pub(super) deviation: &'a [f64],
    /// Standard deviation of the Gaussian window over which a solve averages, px; 0 for independent pixels.
    pub(super) window: f64,
}

impl Noise<'_> {
    /// Returns the surface with one realization of the noise. The same number gives the same noise.
    ///
    /// It is white noise under the window, scaled to the standard deviation at each pixel.
    pub(super) fn add_to(&self, surface: &Surface, realization: u64) -> Surface {
        let (mut random, width, height) = (Random::new(realization, STREAM), surface.width, surface.height());
        let window = (self.window > 0.0).then(|| Gaussian::of_unit_variance(self.window));
        // Noise from outside, so that the variance at the borders is the same.
        let margin = window.as_ref().map_or(0, Gaussian::radius);
        let wide = width + 2 * margin;
        let white: Vec<f64> = (0..wide * (height + 2 * margin)).map(|_| random.normal()).collect();
        let noise = match &window {
            // A single row has no window across it.
            Some(window) => window.sum(white, wide),
            None => white,
        };
        let at = |i: usize| noise[(i / width + margin) * wide + i % width + margin];
        let values = surface.values.iter().zip(self.deviation).enumerate().map(|(i, (z, sigma))| z + sigma * at(i));
        Surface { width, values: values.collect() }
    }
}

/// The stream of random numbers, apart from those of scenes.
const STREAM: u64 = 25178;

/// Returns the standard deviation of values about their mean, and the mean. NaN with fewer than two finite values.
pub(super) fn scatter(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let finite: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    let count = finite.len() as f64;
    let mean = finite.iter().sum::<f64>() / count;
    let sum = finite.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
    if finite.len() < 2 { (f64::NAN, f64::NAN) } else { ((sum / (count - 1.0)).sqrt(), mean) }
}

#[cfg(test)]
mod tests {
    use super::super::areal::tests::{close, surface};
    use super::*;

    #[test]
    fn noise_has_the_stated_deviation_and_length() {
        let size = [120, 100];
        let flat = surface(size, |_, _| 5.0);
        let deviation: Vec<f64> = (0..12_000).map(|i| if i % 120 < 60 { 0.1 } else { 0.4 }).collect();
        for window in [0.0, 2.0] {
            let noise = Noise { deviation: &deviation, window };
            let fields: Vec<Surface> = (0..40).map(|n| noise.add_to(&flat, n)).collect();
            for (columns, sigma) in [(0..60, 0.1), (60..120, 0.4)] {
                let inside = fields.iter().flat_map(|f| f.values.iter().enumerate());
                let (found, mean) = scatter(inside.filter(|(i, _)| columns.contains(&(i % 120))).map(|(_, z)| *z));
                println!("window {window}: {found:.4} of {sigma}, mean {mean:.4}");
                close(found, sigma, 0.03);
                assert!((mean - 5.0).abs() < 0.02);
            }
            // The autocorrelation is exp(-d²/(4 window²)).
            let pairs = fields.iter().flat_map(|f| f.values.chunks_exact(120).map(|r| (r[20] - 5.0) * (r[22] - 5.0)));
            let product = pairs.sum::<f64>() / 4000.0 / 0.01;
            let expected = if window > 0.0 { (-1.0 / window / window).exp() } else { 0.0 };
            assert!((product - expected).abs() < 0.08, "{product}, expected {expected}");
        }
        let noise = Noise { deviation: &deviation, window: 2.0 };
        assert_eq!(noise.add_to(&flat, 3).values, noise.add_to(&flat, 3).values);
        assert_ne!(noise.add_to(&flat, 3).values, noise.add_to(&flat, 4).values);
    }
}
