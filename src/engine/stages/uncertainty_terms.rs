//! Computes the terms of the uncertainty, on every other pixel: the curvature of the data term, b² and (∇²V)² after the
//! last step.
//!
//! Section 7 of `docs/method.md`.
//!
//! The curvature is D times `η²/(S² + η²)`: D has the weight `1/ψ(S)`, and the second derivative of ψ is less by this
//! factor. S² follows from D and b, since `b²/D = S²/ψ(S)`.
//!
//! V depends on all pixels within reach of the smoothness, so that a single pixel says little. Averaged over a
//! [window](fn@window), the terms give V's standard deviation (see [`uncertainty`](mod@super::uncertainty)).

use super::pass::{Memory, Pass, bindings, push_constants};
use super::{Number, Raster, pixels};
use crate::engine::filter::{self, Filter};
use crate::engine::vulkan::Variant;

/// Layers: curvature, b², (∇²V)²; then the squared [residual](mod@super::residual).
pub const LAYERS: usize = 4;
/// The layer of the residual.
pub const RESIDUAL: usize = 3;
/// σ of the window in px of the image.
pub const WINDOW: f64 = 4.0;
/// Least standard deviation of a residual, intensities: rounding to 8 bits has 0.0011.
pub const NOISE: f32 = 1e-3;
/// D below which it is rounding: derivatives of 1e-5 intensities per px², where single precision has errors of some
/// 1e-6.
pub const LEAST: f32 = 1e-8;

push_constants! {
    /// Width of the image, pixels.
    width: u32,
    /// Height of the image, pixels.
    height: u32,
    /// η of the data term, intensities.
    eta: f32,
    /// Least standard deviation of a residual, intensities.
    noise: f32,
    /// D below which it is rounding; [`LEAST`].
    least: f32,
}

bindings! {
    UNCERTAINTY_TERMS:
    v: Reads<RelativeBlur>,
    /// D, b.
    equations: Reads<Plane>,
    /// The first three layers of the terms.
    terms: Writes<UncertaintyTerms>,
}

impl Pass for Bindings {
    /// Compulsory traffic: V read; on every fourth pixel D and b read, three values written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        let [width, height] = size([c.width, c.height]);
        4 * pixels(c.width, c.height) + 20 * pixels(width, height)
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let [d, b] = [0, 1].map(|n| memory.layer(self.equations, n));
        let terms = cpu_reference(c, memory.layer(self.v, 0), [d, b]);
        terms.into_iter().enumerate().for_each(|(n, field)| memory.set_layer(self.terms, n, field));
    }
}

/// Width and height of the terms.
pub(crate) fn size([width, height]: [u32; 2]) -> [u32; 2] {
    [width.div_ceil(2), height.div_ceil(2)]
}

/// The filter along x and y of the window, on every other pixel.
pub fn window() -> Filter {
    filter::gaussian((WINDOW / 2.0).powi(2))
}

/// The curvature, b² (of residuals of at least `noise`) and (∇²V)² on every other pixel. The Laplacian is the divergence of central
/// differences, which is insensitive to noise of single pixels.
pub fn cpu_reference<N: Number>(c: &Constants, v: &Raster<N>, [d, b]: [&Raster<N>; 2]) -> [Raster<N>; 3] {
    let [eta, noise, least] = [c.eta, c.noise, c.least].map(f64::from);
    let of = |x: usize, y: usize| {
        let beside = [(2, 0), (-2, 0), (0, 2), (0, -2)].map(|(i, j)| v.clamped(x as isize + i, y as isize + j));
        let bend = 0.25 * beside.iter().sum::<f64>() - v.get(x, y);
        let (d, b) = (d.get(x, y), b.get(x, y));
        if d <= least {
            return [0.0, 0.0, bend * bend];
        }
        let pull = b * b / d;
        let square = 0.5 * pull * (pull + (pull * pull + 4.0 * eta * eta).sqrt());
        [d * eta * eta / (square + eta * eta), b * b + noise * noise / eta * d, bend * bend]
    };
    let (width, height) = (v.width.div_ceil(2), v.height.div_ceil(2));
    Raster::several([width, height], |x, y| of(2 * x, 2 * y))
}

#[cfg(test)]
mod tests {
    use super::super::Field;
    use super::super::harness::{Input, Trial, random_field};
    use super::*;
    use crate::engine::stages::NO_VARIANT;

    fn constants(v: &Field) -> Constants {
        let (width, height) = (v.width as u32, v.height as u32);
        Constants { width, height, eta: 0.01, noise: NOISE, least: 0.2 }
    }

    #[test]
    fn matches_the_cpu_reference() {
        for (width, height) in [(37, 21), (64, 16), (1, 2)] {
            let [v, d, b] = [1, 2, 3].map(|seed| random_field(width, height, seed));
            let (c, v, equations) = (constants(&v), [v], [d, b]);
            let inputs = [Input::Image(&v), Input::Image(&equations), Input::Unread];
            let groups = STAGE.groups(size([c.width, c.height]));
            Trial::run::<Bindings>(&inputs, &c, NO_VARIANT, groups).assert_within(1e-6);
        }
    }

    /// ψ(S) = sqrt(S² + η²) has the second derivative η²/ψ³. A residual S of slope g has D = g²/ψ and b = -g S/ψ.
    #[test]
    fn the_curvature_is_the_second_derivative_of_the_norm() {
        let (slope, eta) = (0.7f64, 0.01f64);
        for residual in [0.0, 0.001, 0.01, 0.1, -0.5] {
            let norm = f64::hypot(residual, eta);
            let flat = |value: f64| Field::from_fn(4, 4, |_, _| value);
            let equations = [&flat(slope * slope / norm), &flat(-slope * residual / norm)];
            let c = Constants { width: 4, height: 4, eta: eta as f32, noise: 0.0, least: LEAST };
            let curvature = cpu_reference(&c, &flat(1.0), equations)[0].get(1, 1);
            let expected = slope * slope * eta * eta / norm.powi(3);
            assert!((curvature / expected - 1.0).abs() < 1e-6, "{curvature} {expected}");
        }
    }

    #[test]
    fn a_parabola_bends_by_its_second_derivative() {
        let v = Field::from_fn(16, 16, |x, _| 0.3 * (x * x) as f64);
        let flat = |value: f64| Field::from_fn(16, 16, |_, _| value);
        assert_eq!(cpu_reference(&constants(&v), &v, [&flat(0.1), &flat(1.0)])[1].get(3, 3), 0.0, "of rounding");
        let [_, b2, bend] = cpu_reference(&constants(&v), &v, [&flat(5.0), &flat(-0.2)]);
        // Residuals of 0.001 with weight 1/η are added.
        assert!((b2.get(3, 3) - (0.04 + 5e-4)).abs() < 1e-9, "{}", b2.get(3, 3));
        assert!((bend.get(3, 3) - 0.36).abs() < 1e-12, "{}", bend.get(3, 3));
    }
}
