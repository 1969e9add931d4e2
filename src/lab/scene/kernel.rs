//! The kernels of the scenes: exact transfer functions, and quadrature for radiance without a closed form.

use std::f64::consts::{FRAC_2_SQRT_PI, PI, TAU};

use serde::Serialize;

/// The blur kernel of a scene: a family h(u; v) with the variance v per axis, px².
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "program", derive(clap::ValueEnum))]
pub enum Kernel {
    /// Gaussian of variance v
    #[default]
    Gaussian,
    /// Disk of radius 2 √v, which has variance v along each axis
    Pillbox,
    /// Gaussian of variance v without its left half
    ///
    /// The half u_x < 0 is removed and the rest doubled: the mean is √(2v/π) along x. v is the variance of the whole
    /// Gaussian. The axes are those of the sensor that blurs.
    HalfGaussian,
}

/// A node of a quadrature rule of a unit kernel (v = 1). The weights of a rule add up to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Node {
    pub(super) u: [f64; 2],
    pub(super) weight: f64,
}

/// Distance at which a Gaussian is cut off, in standard deviations: 3e-7 of its mass remain.
const REACH: f64 = 5.5;

/// Largest angular frequency of radiance under quadrature, rad/px. Nyquist is π, but the edges of dots and the spline
/// between noisy pixels have higher frequencies. With 7, noise had an error of 1.3e-4.
const BANDWIDTH: f64 = 9.0;

impl Kernel {
    /// The transfer function `ĥ(ω; v) = ∫ h(u; v) exp(-i ω·u) du` as real and imaginary part; ω in rad/px, v in px².
    pub(super) fn transfer(self, [wx, wy]: [f64; 2], v: f64) -> [f64; 2] {
        let w2 = wx * wx + wy * wy;
        match self {
            Kernel::Gaussian => [(-v * w2 / 2.0).exp(), 0.0],
            Kernel::Pillbox => {
                let z = 2.0 * (v * w2).sqrt();
                [if z < 1e-4 { 1.0 - z * z / 8.0 } else { 2.0 * libm::j1(z) / z }, 0.0]
            }
            Kernel::HalfGaussian => {
                let odd = FRAC_2_SQRT_PI * dawson(wx * (v / 2.0).sqrt());
                [(-v * w2 / 2.0).exp(), -odd * (-v * wy * wy / 2.0).exp()]
            }
        }
    }

    /// The radius beyond which all rules of the unit kernel are zero.
    pub(super) fn reach(self) -> f64 {
        if self == Kernel::Pillbox { 2.0 } else { REACH }
    }

    /// Makes a rule for the unit kernel with an error of at most 1e-5 for standard deviations up to `sigma` px.
    fn rule(self, sigma: f64) -> Vec<Node> {
        // Phase of the radiance per unit of the kernel, radians.
        let turns = BANDWIDTH * sigma;
        let nodes = match self {
            Kernel::Gaussian => {
                let line = gaussian_line(turns);
                product(&line, &line)
            }
            Kernel::HalfGaussian => product(&half_line(turns), &gaussian_line(turns)),
            Kernel::Pillbox => disk(turns),
        };
        let sum: f64 = nodes.iter().map(|n| n.weight).sum();
        nodes.into_iter().map(|n| Node { weight: n.weight / sum, ..n }).collect()
    }
}

/// Makes a rule for the Gaussian of standard deviation `sigma` px along one axis. The weights add up to 1.
pub(super) fn gaussian_rule(sigma: f64) -> Vec<(f64, f64)> {
    let line = gaussian_line(BANDWIDTH * sigma);
    let sum: f64 = line.iter().map(|n| n.1).sum();
    line.into_iter().map(|(u, weight)| (sigma * u, weight / sum)).collect()
}

/// Rules of one kernel for all standard deviations of an image: wide blur needs more nodes.
pub(super) struct Rules(Vec<Vec<Node>>);

/// Width of the classes of standard deviations, px.
const CLASS: f64 = 0.5;

impl Rules {
    /// Makes rules for standard deviations up to `largest` px.
    pub(super) fn new(kernel: Kernel, largest: f64) -> Self {
        let classes = (largest / CLASS).ceil().max(1.0) as usize;
        Self((1..=classes).map(|i| kernel.rule(i as f64 * CLASS)).collect())
    }

    /// The rule for a standard deviation.
    pub(super) fn of(&self, sigma: f64) -> &[Node] {
        let class = (sigma / CLASS).ceil().max(1.0) as usize;
        &self.0[class.min(self.0.len()) - 1]
    }
}

/// The trapezoidal rule. Its error for a Gaussian decreases faster than any power of the step.
fn gaussian_line(turns: f64) -> Vec<(f64, f64)> {
    let step = TAU / (turns + 6.0);
    let count = (REACH / step).floor() as i32;
    (-count..=count).map(|i| f64::from(i) * step).map(|u| (u, (-u * u / 2.0).exp())).collect()
}

/// Gauss-Legendre from the jump at 0: a rule across the jump would misplace the centroid.
fn half_line(turns: f64) -> Vec<(f64, f64)> {
    let nodes = gauss_legendre((REACH * turns / 4.0) as usize + 16).into_iter();
    nodes.map(|(x, w)| (REACH / 2.0 * (1.0 + x), w)).map(|(u, w)| (u, w * (-u * u / 2.0).exp())).collect()
}

fn product(xs: &[(f64, f64)], ys: &[(f64, f64)]) -> Vec<Node> {
    let pairs = xs.iter().flat_map(|x| ys.iter().map(move |y| (x, y)));
    let nodes = pairs.map(|(x, y)| Node { u: [x.0, y.0], weight: x.1 * y.1 });
    nodes.filter(|n| n.u[0].hypot(n.u[1]) <= REACH).collect()
}

/// Gauss-Legendre along the radius, which is 2, and equal steps around.
fn disk(turns: f64) -> Vec<Node> {
    let radii = gauss_legendre((turns / 2.0) as usize + 10).into_iter();
    let around = (2.0 * turns) as usize + 16;
    let rings = radii.map(|(x, w)| (1.0 + x, w)).flat_map(|(r, w)| {
        (0..around).map(move |i| (r, w * r, TAU * (i as f64 + 0.5) / around as f64)).collect::<Vec<_>>()
    });
    rings.map(|(r, weight, angle)| Node { u: [r * angle.cos(), r * angle.sin()], weight }).collect()
}

/// Nodes in (-1, 1) and weights of the rule that is exact up to degree 2n - 1 (Newton's method on the Legendre
/// polynomial).
fn gauss_legendre(n: usize) -> Vec<(f64, f64)> {
    let root = |i: usize| {
        let mut x = (PI * (i as f64 + 0.75) / (n as f64 + 0.5)).cos();
        let mut slope = 1.0;
        for _ in 0..100 {
            let (mut p, mut before) = (1.0, 0.0);
            for k in 1..=n {
                let k = k as f64;
                (p, before) = (((2.0 * k - 1.0) * x * p - (k - 1.0) * before) / k, p);
            }
            slope = n as f64 * (x * p - before) / (x * x - 1.0);
            let step = p / slope;
            x -= step;
            if step.abs() < 1e-15 {
                break;
            }
        }
        (x, 2.0 / ((1.0 - x * x) * slope * slope))
    };
    (0..n).map(root).collect()
}

/// Dawson's integral, `exp(-x²) ∫₀ˣ exp(t²) dt`, to about 1e-11 (Rybicki 1989).
fn dawson(x: f64) -> f64 {
    const STEP: f64 = 0.3;
    const TERMS: i32 = 10;
    // The sum is centred on the even multiple of the step nearest to x, where its largest terms are.
    let centre = 2.0 * (x / (2.0 * STEP)).round();
    let rest = x - centre * STEP;
    let term = |k: i32| {
        let n = f64::from(2 * k + 1);
        let bell = |d: f64| (-d * d).exp();
        bell(rest - n * STEP) / (centre + n) + bell(rest + n * STEP) / (centre - n)
    };
    (0..TERMS).map(term).sum::<f64>() / PI.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    const KERNELS: [Kernel; 3] = [Kernel::Gaussian, Kernel::Pillbox, Kernel::HalfGaussian];

    #[test]
    fn dawson_has_its_tabulated_values() {
        // Abramowitz and Stegun, table 7.5.
        let table = [(0.5, 0.424_436_383_5), (1.0, 0.538_079_506_9), (2.0, 0.301_340_388_9), (10.0, 0.050_253_847_2)];
        for (x, expected) in table {
            assert!((dawson(x) - expected).abs() < 1e-9, "{x}: {}", dawson(x));
            assert!((dawson(-x) + expected).abs() < 1e-9);
        }
        assert!((dawson(1e-6) - 1e-6).abs() < 1e-12);
    }

    #[test]
    fn gauss_legendre_is_exact_for_polynomials() {
        for n in [2, 5, 16, 61] {
            let rule = gauss_legendre(n);
            let moment = |power: i32| rule.iter().map(|(x, w)| w * x.powi(power)).sum::<f64>();
            let even = 2 * n as i32 - 2;
            assert!((moment(0) - 2.0).abs() < 1e-12 && moment(1).abs() < 1e-12);
            assert!((moment(even) - 2.0 / f64::from(even + 1)).abs() < 1e-12);
        }
    }

    #[test]
    fn rules_have_the_moments_of_the_kernels() {
        for kernel in KERNELS {
            for sigma in [0.2, 1.0, 2.5, 6.0] {
                let rule = kernel.rule(sigma);
                let moment = |f: &dyn Fn([f64; 2]) -> f64| rule.iter().map(|n| n.weight * f(n.u)).sum::<f64>();
                let mean = if kernel == Kernel::HalfGaussian { (2.0 / PI).sqrt() } else { 0.0 };
                assert!((moment(&|u| u[0]) - mean).abs() < 2e-6, "{kernel:?} {sigma}");
                assert!(moment(&|u| u[1]).abs() < 1e-12);
                for axis in 0..2 {
                    // Around the origin, half of a Gaussian has the second moment of the whole.
                    let second = moment(&|u| u[axis] * u[axis]);
                    assert!((second - 1.0).abs() < 2e-5, "{kernel:?} {sigma}: {second}");
                }
            }
        }
    }

    #[test]
    fn transfer_functions_are_the_integrals_of_the_kernels() {
        for kernel in KERNELS {
            for sigma in [0.3, 1.0, 2.5, 6.0] {
                let rule = kernel.rule(sigma);
                for w in [[0.0, 0.0], [0.3, 0.0], [0.0, -1.1], [0.9, 0.7], [-2.6, 1.0], [4.0, -4.0]] {
                    let angle = |n: &Node| sigma * (w[0] * n.u[0] + w[1] * n.u[1]);
                    let real: f64 = rule.iter().map(|n| n.weight * angle(n).cos()).sum();
                    let imaginary: f64 = rule.iter().map(|n| -n.weight * angle(n).sin()).sum();
                    let [a, b] = kernel.transfer(w, sigma * sigma);
                    let error = (a - real).hypot(b - imaginary);
                    assert!(error < 1e-5, "{kernel:?} σ {sigma} ω {w:?}: {error}");
                }
            }
        }
    }
}
