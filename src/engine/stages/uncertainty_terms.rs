//! Computes the terms of the uncertainty, on every other pixel: the curvature of the data term, b², (∇²V)², and b times
//! the sum of b around it, after the last step.
//!
//! Section 7 of `docs/method.md`.
//!
//! The curvature is D times `η²/(S² + η²)`: D has the weight `1/ψ(S)`, and the second derivative of ψ is less by this
//! factor. S² follows from D and b, since `b²/D = S²/ψ(S)`.
//!
//! b² is the variance of the pull of one pixel. If neighbouring residuals are correlated, the variance of a mean
//! follows from b times the sum of b around it, which includes the covariances.
//!
//! V depends on all pixels within reach of the smoothness, so that a single pixel says little. Averaged over a
//! [window](fn@window), the terms give V's standard deviation (see [`uncertainty`](mod@super::uncertainty)).

use super::pass::{Memory, Pass};
use super::rows::{self, Rows};
use super::segments::{SEGMENT, Segment, streamed};
use super::{Number, Raster, pixels};
use crate::engine::filter::{self, Filter};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

pub use super::interface::uncertainty_terms::*;

/// Layers: curvature, b², (∇²V)², b Σb; then the squared [residual](mod@super::residual).
pub const LAYERS: usize = 5;
/// The layers in which they are stored: each is averaged into the layer before.
pub const STORED: usize = LAYERS + 1;
/// The layer of the residual.
pub const RESIDUAL: usize = 4;
/// Pixels on either side over which b is summed. Noise of photographs is alike over 2 px, what a kernel leaves over a
/// feature of the texture, some 5 px. V follows residuals that are correlated over its own window, σ 2 px.
const REACH: usize = shaders::uncertainty_terms::REACH as usize;
/// σ of the window in px of the image.
pub const WINDOW: f64 = 4.0;
/// Least standard deviation of a residual, intensities: rounding to 8 bits has 0.0011.
pub const NOISE: f32 = 1e-3;
/// D below which it is rounding: derivatives of 1e-5 intensities per px², where single precision has errors of some
/// 1e-6.
pub const LEAST: f32 = 1e-8;

impl Pass for Bindings {
    /// Compulsory traffic: V and b read; on every fourth pixel D read, four values written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        let [width, height] = size([c.width, c.height]);
        8 * pixels(c.width, c.height) + 20 * pixels(width, height)
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let [d, b] = [0, 1].map(|n| memory.layer(self.normal_equations, n));
        let terms = cpu_reference(c, memory.layer(self.relative_blur, 0), [d, b]);
        terms.into_iter().zip(1..).for_each(|(field, n)| memory.set_layer(self.terms, n, field));
    }
}

/// Width and height of the terms.
pub(crate) fn size([width, height]: [u32; 2]) -> [u32; 2] {
    [width.div_ceil(2), height.div_ceil(2)]
}

/// A term at each pixel of the segment from (x, y) to the right, from the term on every other pixel. x is even.
#[inline(always)]
pub(super) fn at_pixels<N: Number>(term: &Raster<N>, [x, y]: [usize; 2]) -> Segment<f64> {
    const HALF: usize = SEGMENT / 2 + 1;
    let rows = [y / 2, y.div_ceil(2).min(term.height - 1)].map(|y| &term.row(y)[x / 2..]);
    let mut halves = [[0.0; HALF]; 2];
    for (half, row) in halves.iter_mut().zip(rows) {
        let count = row.len().min(HALF);
        for n in 0..count {
            half[n] = row[n].into();
        }
        let last = half[count - 1];
        half[count..].fill(last);
    }
    let ([above, below], mut terms) = (halves, [0.0; SEGMENT]);
    for n in 0..SEGMENT / 2 {
        let (here, right) = (n, n + 1);
        terms[2 * n] = (above[here] + above[here] + below[here] + below[here]) / 4.0;
        terms[2 * n + 1] = (above[here] + above[right] + below[here] + below[right]) / 4.0;
    }
    terms
}

/// The filter along x and y of the window, on every other pixel.
pub fn window() -> Filter {
    filter::gaussian((WINDOW / 2.0).powi(2))
}

/// The curvature, b², (∇²V)² and b Σb on every other pixel. b² and b Σb include rounding: residuals of at least `noise`
/// that are not alike. The Laplacian is the divergence of central differences, which is insensitive to noise of single
/// pixels.
pub fn cpu_reference<N: Number>(c: &Constants, v: &Raster<N>, [d, b]: [&Raster<N>; 2]) -> [Raster<N>; RESIDUAL] {
    let [eta, noise, least] = [c.eta, c.noise, c.least].map(f64::from);
    let of = |x: usize, y: usize, around: f64| {
        let beside = [(2, 0), (-2, 0), (0, 2), (0, -2)].map(|(i, j)| v.clamped(x as isize + i, y as isize + j));
        let bend = 0.25 * beside.iter().sum::<f64>() - v.get(x, y);
        let (d, own) = (d.get(x, y), b.get(x, y));
        if d <= least {
            return [0.0, 0.0, bend * bend, 0.0];
        }
        let pull = own * own / d;
        let square = 0.5 * pull * (pull + (pull * pull + 4.0 * eta * eta).sqrt());
        let (curvature, rounding) = (d * eta * eta / (square + eta * eta), noise * noise / eta * d);
        [curvature, own * own + rounding, bend * bend, own * around + rounding]
    };
    let mut terms = [(); RESIDUAL].map(|()| Raster::zeros(v.width.div_ceil(2), v.height.div_ceil(2)));
    rows::map(terms.each_mut().map(Rows::from), |y, mut rows| {
        let y = 2 * y;
        // b summed down each column.
        let mut columns = vec![0.0; b.width];
        for y in y.saturating_sub(REACH)..b.height.min(y + REACH + 1) {
            let b = &b.row(y)[..columns.len()];
            streamed::<N, _>(
                #[inline(always)]
                || {
                    for x in 0..columns.len() {
                        columns[x] += b[x].into();
                    }
                },
            );
        }
        for x in (0..v.width).step_by(2) {
            let around = columns[x.saturating_sub(REACH)..b.width.min(x + REACH + 1)].iter().sum();
            rows.iter_mut().zip(of(x, y, around)).for_each(|(row, term)| row[x / 2] = N::of(term));
        }
    });
    terms
}

#[cfg(test)]
mod tests {
    use super::super::Field;

    use super::*;

    fn constants(v: &Field) -> Constants {
        let (width, height) = (v.width as u32, v.height as u32);
        Constants { width, height, eta: 0.01, noise: NOISE, least: 0.2 }
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
        let [_, b2, bend, alike] = cpu_reference(&constants(&v), &v, [&flat(5.0), &flat(-0.2)]);
        // Residuals of 0.001 with weight 1/η are added.
        assert!((b2.get(3, 3) - (0.04 + 5e-4)).abs() < 1e-9, "{}", b2.get(3, 3));
        // 49 pixels inside, 16 in a corner, are alike.
        assert!((alike.get(3, 3) - (49.0 * 0.04 + 5e-4)).abs() < 1e-9, "{}", alike.get(3, 3));
        assert!((alike.get(0, 0) - (16.0 * 0.04 + 5e-4)).abs() < 1e-9, "{}", alike.get(0, 0));
        assert!((bend.get(3, 3) - 0.36).abs() < 1e-12, "{}", bend.get(3, 3));
    }
}
