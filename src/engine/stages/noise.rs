//! The noise that remains in an image after a blur: the CPU reference of `glsl/include/noise.glsl`.
//!
//! S = h(V₂) * I1 - h(V₁) * J contains noise of both images, and the more an image is blurred, the less of its own.
//! Least squares would then prefer the blur with the least noise (errors in variables).
//!
//! Total least squares divide S² by n(V), the noise of both images in it at that V. The derivative of S/√n is, but for
//! a factor, `∂S/∂V - S n'/2n`, whose product with noise has zero mean. Without this, V of a plane between -0.8 and 0.8
//! px² came out as 0 at noise 0.03 (section 4 of `docs/method.md`).
//!
//! Noise that is white on the photograph decreases as
//!
//! ```text
//! N(v) = mean over frequencies k of exp(-v |k|²) ≈ 1/sqrt(1 + fall v + reach v²)
//! ```
//!
//! For wide kernels of any shape it approaches 1/(4πv). The slope at v = 0 is that of the spline's Laplacian, λ(k) = 6
//! (1 - cos k)/(2 + cos k) along each axis, and N(1) is exact. On coarser levels the pyramid has filtered the noise.

use std::f64::consts::PI;

use super::Real;
use super::law::Variances;

pub use crate::engine::shaders::noise::Noise;

/// Power relative to that of the image itself, and its derivative by V.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Power<R = f64> {
    /// Power.
    pub value: R,
    /// Derivative by V.
    pub slope: R,
}

impl Noise {
    /// The noise of a level. Each halving blurs by σ 1 px before it takes every other pixel: (1 - 4⁻ˡ)/3 px² of the
    /// level in total.
    pub fn new(level: usize) -> Self {
        let before = (1.0 - 0.25f64.powi(level as i32)) / 3.0;
        // Means along one axis, by the midpoint rule.
        let mean =
            |of: &dyn Fn(f64) -> f64| (0..256).map(|i| of(PI * (f64::from(i) + 0.5) / 256.0)).sum::<f64>() / 256.0;
        let laplacian = |k: f64| 6.0 * (1.0 - k.cos()) / (2.0 + k.cos());
        let power = |k: f64| (-before * k * k).exp();
        let whole = mean(&power);
        let first = mean(&|k| power(k) * laplacian(k)) / whole;
        let rise = 2.0 * first;
        let at_one = (mean(&|k| power(k) * (-k * k).exp()) / whole).powi(2);
        Self { fall: (2.0 * rise) as f32, reach: (1.0 / (at_one * at_one) - 1.0 - 2.0 * rise) as f32 }
    }

    /// The power after a blur of variance v >= 0 of an image whose power is `before`.
    #[inline(always)]
    pub fn blurred<R: Real>(&self, v: R, before: R) -> Power<R> {
        let (one, fall, reach) = (R::of(1.0), R::of(self.fall.into()) / before, R::of(self.reach.into()));
        let value = one / (one / (before * before) + (fall + reach * v) * v).sqrt();
        Power { value, slope: -(R::of(0.5) * fall + reach * v) * value * value * value }
    }

    /// The derivative of that power, `value`, by that before the blur.
    #[inline(always)]
    pub fn by_before<R: Real>(&self, v: R, before: R, value: R) -> R {
        let fall = R::of(self.fall.into()) / before;
        value * value * value * (R::of(1.0) / (before * before) + R::of(0.5) * fall * v) / before
    }

    /// The power of the noise of both images in S² at V, relative to that of one.
    pub(super) fn of_both(&self, of: &Variances<f64>) -> f64 {
        self.blurred(of.first, 1.0).value + self.blurred(of.second, 1.0).value
    }

    /// What noise alone adds to the curvature of the data term where the images are blurred by `of`, if the residuals
    /// are noise with the mean square `square`.
    ///
    /// For the power `N(v) = mean exp(-v |k|²)`, the variance of the derivative of a blurred image by its variance is
    /// N''/4. That by V is the sum over both images of `N'' V_k'²/4`. Less the part in S, and with n the sum of both
    /// powers, that of `∂S/∂V - S n'/2n` is this less `n'²/4n`, of noise of the variance S²/n. The curvature has the
    /// weight `η²/(S² + η²)^1.5`, in the mean over Gaussian S about `1/sqrt(η² + 1.57 S²)`.
    pub(super) fn curvature(&self, of: &Variances<f64>, square: f64, eta: f64) -> f64 {
        let (fall, reach) = (f64::from(self.fall), f64::from(self.reach));
        let both = [(of.first, of.first_by_v), (of.second, of.second_by_v)].map(|(v, by_v)| {
            let Power { value, slope } = self.blurred(v, 1.0);
            let bend = 0.75 * (fall + 2.0 * reach * v).powi(2) * value.powi(5) - reach * value.powi(3);
            [value, slope * by_v, bend * by_v * by_v]
        });
        let [n, slope, bend] = [0, 1, 2].map(|k| both[0][k] + both[1][k]);
        0.25 * (bend - slope * slope / n) * square / (n * (eta * eta + 1.57 * square).sqrt())
    }
}

/// The power of white noise that remains after interpolation at a displacement. For cubic splines it is three quarters
/// half way along an axis, and `1 - 0.244 (4 f (1 - f))²` to 0.013 at any fraction f.
#[inline(always)]
pub fn interpolated<R: Real>([dx, dy]: [R; 2]) -> R {
    along(dx)[0] * along(dy)[0]
}

/// Its derivatives by the displacement.
#[inline(always)]
pub fn interpolated_slope<R: Real>([dx, dy]: [R; 2]) -> [R; 2] {
    let ([x, by_x], [y, by_y]) = (along(dx), along(dy));
    [by_x * y, x * by_y]
}

/// The power along an axis, and its derivative.
#[inline(always)]
fn along<R: Real>(d: R) -> [R; 2] {
    let [one, two, four, depth] = R::all([1.0, 2.0, 4.0, 0.244]);
    let f = d - d.floor();
    let bump = four * f * (one - f);
    [one - depth * bump * bump, -(two * depth * bump * four * (one - two * f))]
}

#[cfg(test)]
mod tests {
    use super::super::Field;
    use super::super::harness::{build_stack, random_field};
    use super::super::stack::{self, node_count};
    use super::*;
    use crate::base::Kernel;
    use crate::engine::stages::spline;

    fn variance(values: impl Iterator<Item = f64>) -> f64 {
        let values: Vec<f64> = values.collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64
    }

    #[test]
    fn white_noise_falls_as_stated_under_blur_and_between_pixels() {
        let noise = Noise::new(0);
        let white = random_field(300, 300, 3);
        let whole = variance(white.data.iter().copied());
        for kernel in [Kernel::Gaussian, Kernel::Pillbox] {
            let slopes = stack::Slopes::of(&kernel);
            let stack = build_stack(&white, &kernel, node_count(9.0));
            let inner = || (30..270).flat_map(|y| (30..270).map(move |x| (x as f64, y as f64)));
            for v in [0.02, 0.1, 0.3, 0.6, 1.0, 3.0, 8.0] {
                let actual = variance(inner().map(|(x, y)| stack::read(&stack, slopes, v, x, y).value)) / whole;
                let stated = noise.blurred(v, 1.0).value;
                // A tenth, and for wide V the error of a sample of few independent pixels.
                assert!((actual / stated - 1.0).abs() < 0.16, "{kernel:?} {v}: {actual} {stated}");
            }
        }
        let spline = &build_stack(&white, &Kernel::Gaussian, 1)[0];
        for d in [[0.0, 0.0], [0.1, 0.5], [0.25, 0.7], [0.5, 0.5]] {
            let inner = (30..270).flat_map(|y| (30..270).map(move |x| (x, y)));
            let read = |(x, y)| spline::read(spline, f64::from(x) + d[0], f64::from(y) + d[1]).value;
            let actual = variance(inner.map(read)) / whole;
            assert!((actual - interpolated(d)).abs() < 0.03, "{d:?}: {actual} {}", interpolated(d));
            let slope = (interpolated([d[0], d[1] + 1e-5]) - interpolated([d[0], d[1] - 1e-5])) / 2e-5;
            assert!((slope - interpolated_slope(d)[1]).abs() < 1e-4, "{d:?}");
        }
    }

    /// Two images of independent noise: the mean square of the derivative, over an η that the residuals do not reach.
    #[test]
    fn the_curvature_of_white_noise_is_as_stated() {
        let (noise, eta) = (Noise::new(0), 100.0);
        let [own, other] = [3, 4].map(|seed| random_field(300, 300, seed));
        let mean = |field: &Field| field.data.iter().sum::<f64>() / field.data.len() as f64;
        let slopes = stack::Slopes::of(&Kernel::Gaussian);
        let (stack, apart) = (build_stack(&own, &Kernel::Gaussian, node_count(9.0)), mean(&own) - mean(&other));
        for v in [0.05, 0.1, 0.3, 0.5, 1.0, 2.0, 4.0] {
            let of = Variances { first: v, second: 0.0, first_by_v: 1.0, second_by_v: 0.0 };
            let along = 0.5 * noise.blurred(v, 1.0).slope / noise.of_both(&of);
            let inner = (30..270).flat_map(|y| (30..270).map(move |x| (x, y)));
            let terms = inner.map(|(x, y)| {
                let blurred = stack::read(&stack, slopes, v, x as f64, y as f64);
                let s = blurred.value - other.get(x, y) - apart;
                [s * s, (blurred.slope - along * s).powi(2)]
            });
            let [square, curvature] = terms.fold([0.0; 2], |[a, b], [c, d]| [a + c / 57_600.0, b + d / 57_600.0]);
            let stated = noise.curvature(&of, square, eta) * eta;
            // Between the nodes of the stack the slope is interpolated.
            let ratio = curvature / stated;
            assert!(ratio > 0.55 && ratio < 2.4, "{v}: {stated} {curvature}");
        }
    }

    #[test]
    fn slopes_are_those_of_the_powers() {
        for level in 0..4 {
            let noise = Noise::new(level);
            for before in [1.0, 0.6] {
                for v in [0.05, 0.3, 0.45, 2.0] {
                    let slope = |of: &dyn Fn(f64) -> Power| (of(v + 1e-5).value - of(v - 1e-5).value) / 2e-5;
                    let blurred = |v| noise.blurred(v, before);
                    assert!((slope(&blurred) - blurred(v).slope).abs() < 1e-4);
                    let by_before = [1e-5, -1e-5].map(|more| noise.blurred(v, before + more).value);
                    let stated = noise.by_before(v, before, blurred(v).value);
                    assert!(((by_before[0] - by_before[1]) / 2e-5 - stated).abs() < 1e-4);
                }
            }
        }
    }
}
