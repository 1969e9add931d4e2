//! Discrete filters of continuous kernels, made by their transfer function instead of sampling.
//!
//! A sampled Gaussian of σ 0.25 px has variance 0.0007 px² instead of 0.0625, which makes relative blur near zero
//! wrong.

use std::f64::consts::PI;

use nalgebra::{DMatrix, Matrix6, Vector6};

use crate::base::Kernel;
use crate::base::kernel::Complex;

/// A filter over `2 r + 1` neighbours in one direction. The weight of neighbour `n - r` is at index `n`.
pub type Filter = Vec<f64>;

/// The cubic B-spline prefilter: maps samples to the coefficients of the spline through them.
///
/// The inverse of `(1/6, 4/6, 1/6)` is `√3 z^|n|` with `z = √3 - 2` (Unser 1999). At radius 9 the truncated tail is
/// 1e-5.
pub fn spline_prefilter() -> Filter {
    let (z, radius) = (3f64.sqrt() - 2.0, 9i32);
    let weights: Vec<f64> = (-radius..=radius).map(|n| 3f64.sqrt() * z.powi(n.abs())).collect();
    let sum: f64 = weights.iter().sum();
    weights.into_iter().map(|w| w / sum).collect()
}

/// A Gaussian of a variance in px², by its transfer function `exp(-v ω²/2)` up to the Nyquist frequency.
pub fn gaussian(variance: f64) -> Filter {
    // 4¼ σ leaves 2e-5 of the mass outside. Narrow Gaussians ring and need more neighbours.
    let reach = (4.25 * variance.sqrt()).ceil() as i32;
    let radius = if variance < 1.0 { (reach + 6).min(9) } else { reach };
    by_transfer(variance, radius, 4.0 * variance.sqrt() + 1.0, |w| (-variance * w * w / 2.0).exp())
}

/// A Gaussian from spline coefficients on every pixel to those on every other pixel. Its transfer function is `exp(-v
/// ω²/2) b(ω)/b(2ω)`, with b(ω) = (2 + cos ω)/3 that of the spline's samples.
///
/// Aliasing from beyond a quarter of the sampling frequency is at most `exp(-v π²/8)`, with v the total blur of spline
/// and filter. A spline of twice the spacing follows a wave of frequency ω to some `(ω/π)⁴` of it.
pub fn gaussian_halving(variance: f64) -> Filter {
    let samples = |w: f64| (2.0 + w.cos()) / 3.0;
    let transfer = |w: f64| (-variance * w * w / 2.0).exp() * samples(w) / samples(2.0 * w);
    // The wider spline adds 1 px² of variance, which a wider filter compensates by sharpening.
    let radius = (4.25 * variance.sqrt()).ceil() as i32 + 6;
    by_transfer(variance - 1.0, radius, f64::from(radius), transfer)
}

/// The filter of a real and even transfer function up to the Nyquist frequency.
///
/// A narrow Gaussian is cut off at Nyquist while still high, and rings. Beyond `start` px the ringing is tapered, which
/// changes the response only near Nyquist. Afterwards sum and variance are made exact, since the variance *is* the
/// measurement.
fn by_transfer(variance: f64, radius: i32, start: f64, transfer: impl Fn(f64) -> f64) -> Filter {
    // With 256 frequencies the filter repeats after 512; the widest is some 130, so that its periodic images do not
    // overlap.
    let steps = 256;
    let at = |n: i32| -> f64 {
        (0..steps)
            .map(|k| PI * (f64::from(k) + 0.5) / f64::from(steps))
            .map(|w| transfer(w) * (w * f64::from(n)).cos())
            .sum::<f64>()
            / f64::from(steps)
    };
    let start = start.min(f64::from(radius));
    let taper = |n: i32| {
        let out = (f64::from(n.abs()) - start) / (f64::from(radius + 1) - start);
        if out > 0.0 { (PI / 2.0 * out).cos().powi(2) } else { 1.0 }
    };
    let mut weights: Vec<f64> = (-radius..=radius).map(|n| at(n) * taper(n)).collect();
    let sum: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|w| *w /= sum);
    // (n² - m2) under a bell adds nothing to the sum and changes the variance, smoothly in frequency.
    let bell: Vec<f64> = (-radius..=radius).map(|n| (-f64::from(n * n) / (2.0 * variance + 1.0)).exp()).collect();
    let m2 = moment(&bell, 2) / moment(&bell, 0);
    let share = (variance - moment(&weights, 2)) / (moment(&bell, 4) - m2 * moment(&bell, 2));
    for ((w, q), n) in weights.iter_mut().zip(&bell).zip(-radius..) {
        *w += share * (f64::from(n * n) - m2) * q;
    }
    weights
}

/// `Σ n^power w(n)`.
fn moment(weights: &[f64], power: i32) -> f64 {
    let radius = (weights.len() / 2) as i32;
    weights.iter().zip(-radius..).map(|(w, n)| w * f64::from(n).powi(power)).sum()
}

/// A two-dimensional filter as a sum of separable filters, each along x and along y.
pub type Terms = Vec<[Filter; 2]>;

/// The share of a filter's norm that its terms may leave out. A disk of radius 26 px needs 20 terms, of 5 px 7.
const LEFT_OUT: f64 = 5e-4;

/// A centred kernel of scale v in px².
pub fn centred(kernel: &Kernel, v: f64) -> Terms {
    terms(kernel, v, |w| kernel.transfer(w, v), 1.0, kernel.covariance().map(|c| c * v))
}

/// The derivative of [`centred`] by v.
pub fn centred_slope(kernel: &Kernel, v: f64) -> Terms {
    let covariance @ [xx, xy, yy] = kernel.covariance();
    let transfer = |w: &[f64]| -> Vec<Complex> {
        if v > 0.0 {
            let [less, more] = [1.0 - 1e-4, 1.0 + 1e-4].map(|f| kernel.transfer(w, f * v));
            return less.iter().zip(more).map(|(a, b)| [0, 1].map(|n| (b[n] - a[n]) / (2e-4 * v))).collect();
        }
        let at = |x: f64, y: f64| -(xx * x * x + 2.0 * xy * x * y + yy * y * y) / 2.0;
        w.iter().flat_map(|y| w.iter().map(|x| [at(*x, *y), 0.0])).collect()
    };
    terms(kernel, v, transfer, 0.0, covariance)
}

/// The terms of a transfer function up to the Nyquist frequencies. Ringing beyond the kernel's own reach is tapered,
/// which changes the response only near Nyquist. Then sum, mean and second moments are made exact.
fn terms(
    kernel: &Kernel,
    v: f64,
    transfer: impl Fn(&[f64]) -> Vec<Complex>,
    sum: f64,
    [xx, xy, yy]: [f64; 3],
) -> Terms {
    let reach = kernel.reach() * v.sqrt();
    let radius = reach.ceil() as i32 + 6;
    let size = 2 * radius as usize + 1;
    let mut filter = inverse_transform(&transfer, radius);
    let taper = |n: i32| {
        let out = (f64::from(n.abs()) - reach - 1.0) / (f64::from(radius) - reach);
        if out > 0.0 { (PI / 2.0 * out).cos().powi(2) } else { 1.0 }
    };
    let place = |n: usize| n as i32 - radius;
    filter = DMatrix::from_fn(size, size, |y, x| filter[(y, x)] * taper(place(x)) * taper(place(y)));
    correct_moments(&mut filter, radius, v, Vector6::new(sum, 0.0, 0.0, xx, xy, yy));
    separate(filter)
}

/// The filter of a transfer function, sampled so densely that its periodic images do not overlap. A filter gives `Σ
/// f(n) I(x + n)` and a kernel `Σ h(u) I(x - u)`: the filter is the mirrored kernel.
fn inverse_transform(transfer: &impl Fn(&[f64]) -> Vec<Complex>, radius: i32) -> DMatrix<f64> {
    let size = 2 * radius as usize + 1;
    let count = 2 * size;
    let frequencies: Vec<f64> = (0..count).map(|k| PI * ((2 * k + 1) as f64 / count as f64 - 1.0)).collect();
    let values = transfer(&frequencies);
    let part = |n: usize| DMatrix::from_fn(count, count, |y, x| values[y * count + x][n]);
    let wave = |f: fn(f64) -> f64| {
        DMatrix::from_fn(size, count, |n, k| f(frequencies[k] * (n as f64 - f64::from(radius))) / count as f64)
    };
    let (re, im, cos, sin) = (part(0), part(1), wave(f64::cos), wave(f64::sin));
    // The real part of E H Eᵀ with E = cos - i sin, y before x.
    let (left_re, left_im) = (&cos * &re + &sin * &im, &cos * &im - &sin * &re);
    left_re * cos.transpose() + left_im * sin.transpose()
}

/// Adds the smallest polynomial of second degree, under a bell, that gives Σ, Σx, Σy, Σx², Σxy and Σy² the wanted
/// values.
fn correct_moments(filter: &mut DMatrix<f64>, radius: i32, v: f64, target: Vector6<f64>) {
    let size = filter.nrows();
    let powers = |n: usize, m: usize| {
        let (y, x) = (n as f64 - f64::from(radius), m as f64 - f64::from(radius));
        (Vector6::new(1.0, x, y, x * x, x * y, y * y), (-(x * x + y * y) / (2.0 * v + 1.0)).exp())
    };
    let (mut actual, mut normal) = (Vector6::zeros(), Matrix6::zeros());
    for (y, x) in (0..size).flat_map(|y| (0..size).map(move |x| (y, x))) {
        let (p, bell) = powers(y, x);
        actual += p * filter[(y, x)];
        normal += p * p.transpose() * bell;
    }
    let Some(share) = normal.lu().solve(&(target - actual)) else { return };
    for (y, x) in (0..size).flat_map(|y| (0..size).map(move |x| (y, x))) {
        let (p, bell) = powers(y, x);
        filter[(y, x)] += bell * p.dot(&share);
    }
}

/// Separable terms by singular values, the largest first.
fn separate(filter: DMatrix<f64>) -> Terms {
    let all = filter.norm_squared();
    let svd = filter.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Vec::new() };
    let mut order: Vec<usize> = (0..svd.singular_values.len()).collect();
    order.sort_by(|a, b| svd.singular_values[*b].total_cmp(&svd.singular_values[*a]));
    let mut left = all;
    let mut terms = Vec::new();
    for n in order {
        if left <= LEFT_OUT * LEFT_OUT * all {
            break;
        }
        let size = svd.singular_values[n];
        left -= size * size;
        let across = v_t.row(n).iter().map(|w| w * size.sqrt()).collect();
        terms.push([across, u.column(n).iter().map(|w| w * size.sqrt()).collect()]);
    }
    terms
}

#[cfg(test)]
mod tests {
    use super::*;

    fn response(weights: &[f64], w: f64) -> f64 {
        let radius = (weights.len() / 2) as i32;
        weights.iter().zip(-radius..).map(|(g, n)| g * (w * f64::from(n)).cos()).sum()
    }

    #[test]
    fn gaussian_has_its_variance_and_its_transfer_function() {
        for variance in [0.02, 0.0625, 0.25, 0.75, 1.0, 2.25, 6.25, 36.0] {
            let g = gaussian(variance);
            assert!((moment(&g, 0) - 1.0).abs() < 1e-12);
            assert!((moment(&g, 2) - variance).abs() < 1e-9, "{variance}: {}", moment(&g, 2));
            let mut worst: f64 = 0.0;
            for k in 0..=80 {
                let w = 0.8 * PI * f64::from(k) / 80.0;
                worst = worst.max((response(&g, w) - (-variance * w * w / 2.0).exp()).abs());
            }
            assert!(worst < 2e-3, "{variance}: {worst}");
        }
    }

    #[test]
    fn prefilter_inverts_the_spline() {
        let filter = spline_prefilter();
        for k in 0..=40 {
            let w = PI * f64::from(k) / 40.0;
            let through = response(&filter, w) * (2.0 / 3.0 + w.cos() / 3.0);
            assert!((through - 1.0).abs() < 2e-5, "{through} at {w}");
        }
    }

    fn kernels() -> [Kernel; 3] {
        let code: Vec<f64> = (0..49).map(|n| f64::from((n * n + n / 7 * 3) % 5 < 2)).collect();
        [
            Kernel::Pillbox,
            Kernel::HalfGaussian,
            Kernel::Measured(crate::base::Aperture::new("code", 7, 7, &code).unwrap()),
        ]
    }

    /// The transfer function of terms at one pair of frequencies.
    fn response_2d(terms: &Terms, wx: f64, wy: f64) -> Complex {
        let along = |filter: &Filter, w: f64| {
            let radius = (filter.len() / 2) as f64;
            let wave = |f: fn(f64) -> f64| filter.iter().enumerate().map(|(n, g)| g * f(w * (n as f64 - radius))).sum();
            let (cos, sin): (f64, f64) = (wave(f64::cos), wave(f64::sin));
            [cos, sin]
        };
        terms.iter().fold([0.0; 2], |[re, im], [x, y]| {
            let ([a, b], [c, d]) = (along(x, wx), along(y, wy));
            [re + a * c - b * d, im + a * d + b * c]
        })
    }

    #[test]
    fn kernels_have_their_transfer_functions() {
        for kernel in kernels() {
            for v in [0.25, 1.0, 6.25, 30.0] {
                let (terms, slope) = (centred(&kernel, v), centred_slope(&kernel, v));
                let frequencies: Vec<f64> = (0..12).map(|k| 0.7 * PI * (f64::from(k) / 5.5 - 1.0)).collect();
                let expected = kernel.transfer(&frequencies, v);
                let (less, more) = (kernel.transfer(&frequencies, 0.999 * v), kernel.transfer(&frequencies, 1.001 * v));
                for (n, at) in (0..144).map(|n| (n, [frequencies[n % 12], frequencies[n / 12]])) {
                    let actual = response_2d(&terms, at[0], at[1]);
                    let actual_slope = response_2d(&slope, at[0], at[1]);
                    for part in [0, 1] {
                        let error = (actual[part] - expected[n][part]).abs();
                        assert!(error < 6e-3, "{} of {v} at {at:?}: off by {error}", kernel.name());
                        let by_v = (more[n][part] - less[n][part]) / 0.002;
                        let error = (v * actual_slope[part] - by_v).abs();
                        assert!(error < 2e-2, "slope of {} of {v} at {at:?}: off by {error}", kernel.name());
                    }
                }
            }
        }
    }

    #[test]
    fn the_half_gaussian_smears_to_the_right() {
        // Behind an edge at 0 the blurred image is the kernel's integral from its left end, -mean, to x.
        let v: f64 = 9.0;
        let terms = centred(&Kernel::HalfGaussian, v);
        let mean = Kernel::HalfGaussian.mean()[0] * v.sqrt();
        let edge = |n: i32| 0.5 * (1.0 + (f64::from(n) / 0.8).tanh());
        let blurred = |x: i32| -> f64 {
            let [along_x, _] = &terms[0];
            let rows: f64 = terms[0][1].iter().sum();
            along_x.iter().zip(-((along_x.len() / 2) as i32)..).map(|(f, n)| rows * f * edge(x + n)).sum()
        };
        for x in [-6, -3, -1, 0, 1, 3, 6] {
            let steps = 4000;
            let expected: f64 = (0..steps)
                .map(|k| 15.0 * (f64::from(k) + 0.5) / f64::from(steps))
                .map(|u| {
                    let density = (2.0 / (PI * v)).sqrt() * (-u * u / (2.0 * v)).exp();
                    density * 0.5 * (1.0 + ((f64::from(x) - u + mean) / 0.8).tanh())
                })
                .sum::<f64>()
                * 15.0
                / f64::from(steps);
            assert!((blurred(x) - expected).abs() < 2e-3, "{x}: {} {expected}", blurred(x));
        }
    }

    #[test]
    fn terms_are_few() {
        for kernel in kernels() {
            let count = |v: f64| centred(&kernel, v).len();
            println!("{}: {} {} {}", kernel.name(), count(1.0), count(6.25), count(170.0));
            assert!(count(170.0) <= 20);
        }
        assert_eq!(centred(&Kernel::HalfGaussian, 6.25).len(), 1);
    }
}
