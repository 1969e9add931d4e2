//! The shape of the defocus blur: a family of kernels h(u; v) with Σh = 1 and per-axis scale v in px².
//!
//! A kernel is scaled, `h(u; v) = k(u/√v)/v`, so its mean moves as √v and its covariance as v. The two are kept apart:
//! every kernel is a *centred* one, read at a place displaced by `mean √v`. Centred, the blurred image has a finite
//! derivative by v at v = 0, half of `C : ∇²`; the displacement alone goes as √v there, and the spline that reads the
//! image knows its derivative. Sections 2.1 to 2.3 of the paper, section 3 of `docs/method.md`.

use std::f64::consts::PI;

use crate::base::aperture::{Aperture, Complex};

/// Shape of the blur.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "kebab-case"))]
pub enum Kernel {
    /// Whatever the photographs say, from a Gaussian to a disk and a little beyond.
    #[default]
    Auto,
    /// Gaussian of variance v.
    Gaussian,
    /// Disk of radius 2√v, so of variance v along each axis: an ideal lens with a round aperture.
    Pillbox,
    /// Gaussian of variance v without its half `u_x < 0`, renormalised: the paper's asymmetric kernel.
    HalfGaussian,
    /// A kernel given by its values on a grid, scaled so that its variance along the axes is v on average.
    Measured(Aperture),
}

impl Kernel {
    /// Those that have a name of their own.
    pub const NAMED: [Self; 4] = [Self::Auto, Self::Gaussian, Self::Pillbox, Self::HalfGaussian];

    /// "auto", "gaussian", "pillbox", "half-gaussian", or the name of the aperture.
    pub fn name(&self) -> &str {
        match self {
            Kernel::Auto => "auto",
            Kernel::Gaussian => "gaussian",
            Kernel::Pillbox => "pillbox",
            Kernel::HalfGaussian => "half-gaussian",
            Kernel::Measured(aperture) => aperture.name(),
        }
    }

    /// Mean at v = 1, px: the mean at v is √v times it.
    pub fn mean(&self) -> [f64; 2] {
        match self {
            Kernel::Auto | Kernel::Gaussian | Kernel::Pillbox => [0.0, 0.0],
            Kernel::HalfGaussian => [(2.0 / PI).sqrt(), 0.0],
            Kernel::Measured(aperture) => aperture.mean(),
        }
    }

    /// Second central moments at v = 1, px²: xx, xy, yy. At v they are v times these.
    pub fn covariance(&self) -> [f64; 3] {
        match self {
            Kernel::Auto | Kernel::Gaussian | Kernel::Pillbox => [1.0, 0.0, 1.0],
            Kernel::HalfGaussian => [1.0 - 2.0 / PI, 0.0, 1.0],
            Kernel::Measured(aperture) => aperture.covariance(),
        }
    }

    /// How far the centred kernel reaches at v = 1, px.
    pub(crate) fn reach(&self) -> f64 {
        match self {
            // Leaves 7e-6 of the mass of a Gaussian outside.
            Kernel::Auto | Kernel::Gaussian | Kernel::HalfGaussian => 4.5,
            Kernel::Pillbox => 2.0,
            Kernel::Measured(aperture) => aperture.reach(),
        }
    }

    /// Transfer function `Σ h(u + mean) exp(-i w u)` of the centred kernel of scale v at all pairs of the given
    /// frequencies, rad a pixel, rows along y.
    pub(crate) fn transfer(&self, frequencies: &[f64], v: f64) -> Vec<Complex> {
        let scaled: Vec<f64> = frequencies.iter().map(|w| w * v.sqrt()).collect();
        match self {
            Kernel::Measured(aperture) => aperture.transfer(&scaled),
            // What is found is made of Gaussians.
            Kernel::Auto | Kernel::Gaussian => product(&scaled, |x| [(-x * x / 2.0).exp(), 0.0]),
            Kernel::HalfGaussian => product(&scaled, half_gaussian),
            Kernel::Pillbox => {
                let at = |w: f64| if w > 0.0 { libm::j1(2.0 * w) / w } else { 1.0 };
                scaled.iter().flat_map(|y| scaled.iter().map(|x| [at(x.hypot(*y)), 0.0])).collect()
            }
        }
    }
}

/// A function of w_x times a Gaussian of w_y.
fn product(scaled: &[f64], along_x: impl Fn(f64) -> Complex) -> Vec<Complex> {
    let row: Vec<Complex> = scaled.iter().map(|&x| along_x(x)).collect();
    let along_y = scaled.iter().map(|y| (-y * y / 2.0).exp());
    along_y.flat_map(|g| row.iter().map(move |h| h.map(|part| part * g))).collect()
}

/// Of √(2/π) exp(-u²/2) on u > 0 about its mean: `(exp(-w²/2) - 2i/√π D(w/√2)) exp(i w √(2/π))`, D Dawson's function.
fn half_gaussian(w: f64) -> Complex {
    let (re, im) = ((-w * w / 2.0).exp(), -2.0 / PI.sqrt() * dawson(w / 2f64.sqrt()));
    let (sin, cos) = (w * (2.0 / PI).sqrt()).sin_cos();
    [re * cos - im * sin, re * sin + im * cos]
}

/// Dawson's function `exp(-x²) ∫ exp(t²) dt`, by Rybicki's sum with a step of 0.2, exact to 1e-15 (Numerical Recipes, 6.10).
fn dawson(x: f64) -> f64 {
    let step = 0.2;
    let nearest = (x / step / 2.0).round() as i64;
    let terms = (nearest - 16..=nearest + 16).map(|n| {
        let odd = (2 * n + 1) as f64;
        (-(x - odd * step).powi(2)).exp() / odd
    });
    terms.sum::<f64>() / PI.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dawson_is_what_the_tables_say() {
        // Abramowitz and Stegun, table 7.5.
        for (x, d) in [(0.0, 0.0), (0.5, 0.424_436_383_5), (1.0, 0.538_079_506_9), (2.0, 0.301_340_388_9)] {
            assert!((dawson(x) - d).abs() < 1e-9 && (dawson(-x) + d).abs() < 1e-9, "{x}: {}", dawson(x));
        }
        assert!((dawson(40.0) * 80.0 - 1.0).abs() < 1e-3);
    }

    #[test]
    fn half_gaussian_is_the_integral_over_its_density() {
        let n = 200_000;
        for w in [0.3, 1.0, 3.0, 8.0] {
            let mut sum = [0.0, 0.0];
            for k in 0..n {
                let u = (f64::from(k) + 0.5) * 8.0 / f64::from(n);
                let density = (2.0 / PI).sqrt() * (-u * u / 2.0).exp() * 8.0 / f64::from(n);
                let phase = -w * (u - (2.0 / PI).sqrt());
                sum = [sum[0] + density * phase.cos(), sum[1] + density * phase.sin()];
            }
            let found = half_gaussian(w);
            assert!((found[0] - sum[0]).abs() < 1e-6 && (found[1] - sum[1]).abs() < 1e-6, "{w}: {found:?} {sum:?}");
        }
    }

    #[test]
    fn transfer_functions_curve_as_the_covariance() {
        let aperture = Aperture::new("code", 3, 2, &[1.0, 0.0, 2.0, 0.0, 1.0, 1.0]).unwrap();
        for kernel in [Kernel::Gaussian, Kernel::Pillbox, Kernel::HalfGaussian, Kernel::Measured(aperture)] {
            let (w, v) = (1e-3, 2.5);
            let h = kernel.transfer(&[0.0, w], v);
            let [xx, xy, yy] = kernel.covariance();
            for (at, c) in [(1, xx), (2, yy), (3, xx + 2.0 * xy + yy)] {
                let curvature = 2.0 * (1.0 - h[at][0]) / (w * w);
                assert!((curvature - c * v).abs() < 1e-4, "{}: {curvature} {}", kernel.name(), c * v);
                assert!(h[at][1].abs() < 1e-8, "{} is not centred", kernel.name());
            }
        }
    }
}
