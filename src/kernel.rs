//! Discrete filters: continuous kernels made discrete by their transfer function, never by sampling at integers.
//!
//! Sampled, a Gaussian of σ 0.25 has variance 0.0007 px² instead of 0.0625, and relative blur near zero comes out wrong.

use std::f64::consts::PI;

/// A filter over `2 r + 1` neighbours in one direction; the weight of neighbour `n - r` stands at `n`.
pub type Filter = Vec<f64>;

/// Cubic B-spline prefilter: turns samples into the coefficients whose spline goes through them.
///
/// The inverse of `(1/6, 4/6, 1/6)` is `√3 z^|n|` with `z = √3 - 2` (Unser 1999); at radius 12 the tail left out is 1e-7.
pub fn spline_prefilter() -> Filter {
    let (z, radius) = (3f64.sqrt() - 2.0, 12i32);
    let weights: Vec<f64> = (-radius..=radius).map(|n| 3f64.sqrt() * z.powi(n.abs())).collect();
    let sum: f64 = weights.iter().sum();
    weights.into_iter().map(|w| w / sum).collect()
}

/// Gaussian of a variance in px², through its transfer function `exp(-v ω²/2)` up to the Nyquist frequency.
///
/// A narrow Gaussian is cut off at Nyquist while still high, and rings; beyond 4 σ + 1 px the ringing is tapered, which
/// bends the response only near Nyquist. Afterwards sum and variance are made exact, since the variance *is* the measurement.
pub fn gaussian(variance: f64) -> Filter {
    // 4.5 σ leaves 7e-6 of the mass outside; six more neighbours carry the ringing of the narrow ones.
    let radius = (4.5 * variance.sqrt()).ceil() as i32 + if variance < 1.0 { 6 } else { 1 };
    // 256 frequencies repeat the filter every 512; the widest is some 130, so its periodic images stay apart.
    let steps = 256;
    let at = |n: i32| -> f64 {
        (0..steps)
            .map(|k| PI * (f64::from(k) + 0.5) / f64::from(steps))
            .map(|w| (-variance * w * w / 2.0).exp() * (w * f64::from(n)).cos())
            .sum::<f64>()
            / f64::from(steps)
    };
    let start = (4.0 * variance.sqrt() + 1.0).min(f64::from(radius));
    let taper = |n: i32| {
        let out = (f64::from(n.abs()) - start) / (f64::from(radius + 1) - start);
        if out > 0.0 { (PI / 2.0 * out).cos().powi(2) } else { 1.0 }
    };
    let mut weights: Vec<f64> = (-radius..=radius).map(|n| at(n) * taper(n)).collect();
    let sum: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|w| *w /= sum);
    // (n² - m2) under a bell adds nothing to the sum and moves the variance, smoothly in frequency.
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
            assert!((through - 1.0).abs() < 1e-6, "{through} at {w}");
        }
    }
}
