//! Robust statistics of fields with correlated values.

/// A value with its standard error.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// The standard error, in the unit of the value.
    pub standard_error: f64,
}

/// The ratio of the standard deviation of a Gaussian to its median absolute deviation.
const MAD: f64 = 1.4826;
/// The cutoff of Tukey's biweight in standard deviations, for 95 % efficiency under Gaussian noise.
pub(crate) const TUKEY: f64 = 4.685;

/// Returns the median of the finite values. `None` if there are none.
pub fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut finite: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
    let middle = finite.len() / 2;
    (!finite.is_empty()).then(|| *finite.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Returns the robust standard deviation of residuals, from their median absolute value. 0 if none is finite.
pub(crate) fn deviation(residuals: &[f64]) -> f64 {
    MAD * median(residuals.iter().map(|r| r.abs())).unwrap_or(0.0)
}

/// Returns Tukey's biweight of a residual in standard deviations.
pub(crate) fn tukey(r: f64) -> f64 {
    if r.abs() < TUKEY { (1.0 - (r / TUKEY).powi(2)).powi(2) } else { 0.0 }
}

/// Returns the level of a rectangle of row-major values: the median after the subtraction of the tilt about the centre.
/// NaN values are ignored. `None` if there are no others.
///
/// The standard error is `√(π/2) σ / √n`, that of the median of n Gaussian values. σ comes from the median absolute
/// deviation, and n is the number of values divided by the [`correlation_area`].
pub(crate) fn level(values: &[f64], width: usize) -> Option<Estimate> {
    let values = without_tilt(values, width);
    let value = median(values.iter().copied())?;
    let residuals: Vec<f64> = values.iter().map(|v| v - value).collect();
    let count = values.iter().filter(|v| v.is_finite()).count() as f64;
    let independent = (count / correlation_area(&residuals, width)).max(1.0);
    let standard_error = (std::f64::consts::FRAC_PI_2 / independent).sqrt() * deviation(&residuals);
    Some(Estimate { value, standard_error })
}

/// Subtracts the tilt of a least-squares plane about the centroid of the finite values. Values more than 3 standard
/// deviations from the median are excluded from the fit.
fn without_tilt(values: &[f64], width: usize) -> Vec<f64> {
    let position = |i: usize| [(i % width.max(1)) as f64, (i / width.max(1)) as f64];
    let mut levelled = values.to_vec();
    // Repeated, since large outliers hide smaller ones at first.
    for _ in 0..5 {
        let Some(middle) = median(levelled.iter().copied()) else { return levelled };
        let limit = 3.0 * deviation(&levelled.iter().map(|v| v - middle).collect::<Vec<_>>());
        let inliers = || levelled.iter().enumerate().filter(|(_, v)| (*v - middle).abs() <= limit);
        let count = inliers().count() as f64;
        let mean = |f: &dyn Fn([f64; 2], f64) -> f64| inliers().map(|(i, &v)| f(position(i), v)).sum::<f64>() / count;
        let [cx, cy] = [mean(&|[x, _], _| x), mean(&|[_, y], _| y)];
        let (xx, yy) = (mean(&|[x, _], _| (x - cx).powi(2)), mean(&|[_, y], _| (y - cy).powi(2)));
        let xy = mean(&|[x, y], _| (x - cx) * (y - cy));
        let (xv, yv) = (mean(&|[x, _], v| (x - cx) * (v - middle)), mean(&|[_, y], v| (y - cy) * (v - middle)));
        let determinant = xx * yy - xy * xy;
        if determinant < 1e-6 {
            // A single row or column has no tilt across it.
            return levelled;
        }
        let (right, down) = ((yy * xv - xy * yv) / determinant, (xx * yv - xy * xv) / determinant);
        for (i, v) in levelled.iter_mut().enumerate() {
            let [x, y] = position(i);
            *v -= right * (x - cx) + down * (y - cy);
        }
    }
    levelled
}

/// Returns the number of values of a row-major field that carry the information of one independent value.
///
/// It is the product of `1 + 2 Σ ρ(k)` along rows and columns, with the autocorrelation ρ of the residuals. The sum
/// ends at the first ρ that is not positive (initial positive sequence, Geyer 1992). Residuals are clamped to 3
/// standard deviations, and NaN values are ignored.
pub(crate) fn correlation_area(residuals: &[f64], width: usize) -> f64 {
    let limit = 3.0 * deviation(residuals);
    let clipped: Vec<f64> = residuals.iter().map(|r| r.clamp(-limit, limit)).collect();
    let height = residuals.len() / width.max(1);
    let across = correlation_length(width, |k| products(&clipped, k, |i| i % width + k < width));
    let down = correlation_length(height, |k| products(&clipped, k * width, |_| true));
    across * down
}

/// Returns `1 + 2 Σ ρ(k)`, where `mean(k)` is the mean product of values at distance k.
fn correlation_length(size: usize, mean: impl Fn(usize) -> Option<f64>) -> f64 {
    let Some(variance) = mean(0).filter(|&v| v > 0.0) else { return 1.0 };
    let correlations = (1..size).map_while(|k| mean(k).map(|product| product / variance).filter(|&rho| rho > 0.0));
    1.0 + 2.0 * correlations.sum::<f64>()
}

/// Returns the mean product of pairs of finite values at the distance `offset`.
fn products(values: &[f64], offset: usize, same_line: impl Fn(usize) -> bool) -> Option<f64> {
    let pairs = values.iter().zip(values.get(offset..)?).enumerate();
    let (sum, count) = pairs
        .filter(|&(i, (a, b))| same_line(i) && a.is_finite() && b.is_finite())
        .fold((0.0, 0usize), |(sum, count), (_, (a, b))| (sum + a * b, count + 1));
    (count > 0).then(|| sum / count as f64)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::base::random::Random;

    /// Returns noise of standard deviation 1, smoothed by a Gaussian of `sigma` px.
    pub(crate) fn smooth_noise([width, height]: [usize; 2], sigma: f64, seed: u64) -> Vec<f64> {
        let mut random = Random::new(seed, 77);
        let radius = (3.0 * sigma).ceil() as usize;
        let taps: Vec<f64> =
            (0..=2 * radius).map(|i| (i as f64 - radius as f64) / sigma).map(|d| (-d * d / 2.0).exp()).collect();
        let norm = taps.iter().map(|t| t * t).sum::<f64>();
        let wide = width + 2 * radius;
        let white: Vec<f64> = (0..wide * (height + 2 * radius)).map(|_| random.normal()).collect();
        let rows: Vec<f64> = (0..height + 2 * radius)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .map(|(x, y)| taps.iter().enumerate().map(|(i, t)| t * white[y * wide + x + i]).sum())
            .collect();
        (0..height)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .map(|(x, y)| taps.iter().enumerate().map(|(i, t)| t * rows[(y + i) * width + x]).sum::<f64>() / norm)
            .collect()
    }

    /// Adds a tilt to the right, 0 in the middle of 48 columns.
    fn tilted(mut values: Vec<f64>, tilt: f64) -> Vec<f64> {
        values.iter_mut().enumerate().for_each(|(i, v)| *v += tilt * ((i % 48) as f64 - 23.5));
        values
    }

    #[test]
    fn the_standard_error_is_the_scatter_of_the_level() {
        for (sigma, tilt) in [(0.3, 0.0), (1.0, 0.0), (3.0, 0.0), (1.0, 0.2)] {
            let trials: Vec<Estimate> =
                (0..60).map(|seed| level(&tilted(smooth_noise([48, 32], sigma, seed), tilt), 48).unwrap()).collect();
            let scatter = (trials.iter().map(|t| t.value * t.value).sum::<f64>() / trials.len() as f64).sqrt();
            let claimed = (trials.iter().map(|t| t.standard_error.powi(2)).sum::<f64>() / trials.len() as f64).sqrt();
            println!("σ {sigma}: scatter {scatter:.4}, standard error {claimed:.4}");
            assert!((0.7..1.5).contains(&(claimed / scatter)), "σ {sigma}: {claimed}, and the scatter is {scatter}");
        }
    }

    #[test]
    fn nan_values_are_ignored() {
        let estimate = level(&[2.0, f64::NAN, 2.0, 2.0], 2).unwrap();
        assert_eq!((estimate.value, estimate.standard_error), (2.0, 0.0));
        assert_eq!(level(&[f64::NAN; 4], 2), None);
        assert_eq!(level(&[], 0), None);
    }
}
