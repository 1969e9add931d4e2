//! Both images blurred by the kernel of variance V, Î1 and Î2, and their derivatives by V.
//!
//! The CPU reference of `glsl/include/blur.glsl`. Equations 22 and 25 of the paper, section 3 of `docs/method.md`.

use super::segments::{SEGMENT, Segment, first_repeated, place, range, vectorised};
use super::spline::{self, Jet};
use super::stack::{self, Blurred, Slopes};
use super::state::{Registration, margin};
use super::{Number, Raster, Real};
use crate::engine::shaders;

/// Beyond V = 0 a blurred image is extrapolated linearly for this many px².
pub const NEAR: f64 = shaders::blur::NEAR;
/// Below this |V|, px², the kernel's mean moves linearly, so that its derivative stays finite.
const LEAST_ROOT: f64 = shaders::blur::LEAST_ROOT;

/// The blur stacks of I1 and I2.
pub struct Stacks<'a, N = f64> {
    /// The stack of I1.
    pub first: &'a [Raster<N>],
    /// The stack of I2.
    pub second: &'a [Raster<N>],
    /// How their slopes are computed.
    pub slopes: Slopes,
}

impl<'a, N: Number> Stacks<'a, N> {
    /// Stacks of `nodes` nodes each in the layers of one image. That of I2 begins at layer `second`.
    pub(super) fn of(layers: &'a [Raster<N>], second: u32, nodes: u32, any_kernel: bool) -> Self {
        let slopes = if any_kernel { Slopes::Layers } else { Slopes::Laplacian };
        let (second, count) = (second as usize, nodes as usize * slopes.layers());
        Self { first: &layers[..count], second: &layers[second..second + count], slopes }
    }
}

/// Î1 and Î2 at pixel (x, y), which T maps to (x, y) + d, before gain and offset, with their derivatives by V. `mean`
/// is that of the kernel at V = 1: the stacks hold centred kernels, and are read where the mean moves the pixel to.
/// Gradients are per pixel of I1.
pub fn read<N: Number>(
    &Stacks { first, second, slopes }: &Stacks<N>,
    r: &Registration,
    mean: [f64; 2],
    [x, y]: [f64; 2],
    d: [f64; 2],
    v: f64,
) -> [Blurred; 2] {
    let scale2 = r.scale().powi(2);
    let [[xx, xy], [yx, yy]] = r.transform.jacobian();
    let (mean, by_v) = mean_at(mean, r, v);
    let ahead = [xx * mean[0] + xy * mean[1], yx * mean[0] + yy * mean[1]];
    let (p, q) = ([x - mean[0], y - mean[1]], [x + d[0] + ahead[0], y + d[1] + ahead[1]]);
    // The image that is not blurred is extrapolated linearly through V = 0.
    let beyond = |stack: &[Raster<N>], [x, y]: [f64; 2], factor: f64| {
        let (jet, slope) = stack::node(stack, slopes, 0, x, y);
        let slope = factor * slope;
        let still = if v.abs() < NEAR { slope } else { 0.0 };
        Blurred { value: jet.value + slope * v.clamp(-NEAR, NEAR), slope: still, dx: jet.dx, dy: jet.dy }
    };
    let (mut b1, mut b2);
    if v >= 0.0 {
        b1 = stack::read(first, slopes, v, p[0], p[1]);
        b2 = beyond(second, q, -scale2);
    } else {
        b1 = beyond(first, p, 1.0);
        b2 = stack::read(second, slopes, -v * scale2, q[0], q[1]);
        b2.slope *= -scale2;
    }
    b1.slope -= b1.dx * by_v[0] + b1.dy * by_v[1];
    [b2.dx, b2.dy] = r.in_first([b2.dx, b2.dy]);
    b2.slope += b2.dx * by_v[0] + b2.dy * by_v[1];
    [b1, b2]
}

/// The image that is not blurred, extrapolated linearly through V = 0. `factor`: the slope over the Laplacian.
#[inline(always)]
fn beyond<R: Real>(jet: Jet<R>, v: R, factor: f64) -> Blurred<R> {
    let (slope, near) = (R::of(factor) * jet.laplacian, R::of(NEAR));
    let still = (v.abs() - near).choose(R::default(), slope);
    Blurred { value: jet.value + slope * v.max(-near).min(near), slope: still, dx: jet.dx, dy: jet.dy }
}

/// The mean of the kernel at V, and its derivative by V, in I1's pixels. The kernel rotates with the sensor of the
/// blurred image, which is I2 for V > 0: by the rotation nearest to T's Jacobian.
fn mean_at(mut mean: [f64; 2], r: &Registration, v: f64) -> ([f64; 2], [f64; 2]) {
    if v > 0.0 {
        let (sin, cos) = r.transform.rotation().sin_cos();
        mean = [cos * mean[0] + sin * mean[1], cos * mean[1] - sin * mean[0]];
    }
    let root = v.abs().max(LEAST_ROOT).sqrt();
    let by_v = if v.abs() > LEAST_ROOT { 0.5 / root } else { 1.0 / root };
    (mean.map(|m| v / root * m), mean.map(|m| by_v * m))
}

/// Smooth Heaviside, equation 35.
#[inline(always)]
pub fn heaviside<R: Real>(v: R, epsilon: f64) -> R {
    R::of(0.5) + (v / R::of(epsilon)).atan() * R::of(std::f64::consts::FRAC_1_PI)
}

/// Both images at a pixel: I1, J before gain and offset, Î1 and Î2. Gradients are per pixel of I1.
pub(super) struct PairSample {
    pub(super) i1: f64,
    pub(super) i2: Jet,
    pub(super) blurred: [Blurred; 2],
}

impl PairSample {
    /// I1, J and its gradient, Î1 and its slope, Î2, its slope and its gradient.
    #[inline(always)]
    pub(super) fn numbers(self) -> [f64; 10] {
        let (j, [b1, b2]) = (self.i2, self.blurred);
        [self.i1, j.value, j.dx, j.dy, b1.value, b1.slope, b2.value, b2.slope, b2.dx, b2.dy]
    }
}

/// The [numbers](PairSample::numbers) of the pixels of the segment from (x, y) to the right, which T has moved by
/// `shift` since I2 was warped. For a Gaussian.
#[inline(always)]
pub(super) fn sample_segment<N: Number>(
    stacks: &Stacks<N>,
    at: [usize; 2],
    shift: [&Segment<N>; 2],
    v: &Segment<N>,
) -> [Segment<N>; 10] {
    let (none, [least, most]) = (N::default(), range(v));
    let mut samples = [[none; SEGMENT]; 10];
    let [i1, j, dx, dy, b1, slope1, b2, slope2, dx2, dy2] = &mut samples;
    spline::near_segment(
        &stacks.first[0],
        at,
        #[inline(always)]
        |n, jet| {
            let beyond = beyond(jet, v[n], 0.5);
            (i1[n], b1[n], slope1[n]) = (jet.value, beyond.value, beyond.slope);
        },
    );
    spline::near_segment(
        &stacks.second[0],
        at,
        #[inline(always)]
        |n, jet| {
            let jet = jet.moved([shift[0][n], shift[1][n]]);
            let beyond = beyond(jet, v[n], -0.5);
            (j[n], dx[n], dy[n]) = (jet.value, jet.dx, jet.dy);
            (b2[n], slope2[n], dx2[n], dy2[n]) = (beyond.value, beyond.slope, jet.dx, jet.dy);
        },
    );
    let mut size = [none; SEGMENT];
    if most >= 0.0 {
        for n in 0..SEGMENT {
            size[n] = v[n].max(none);
        }
        let [value, slope, ..] = stack::between_segment(
            &size,
            stacks.first.len(),
            #[inline(always)]
            |k, [value, slope, ..]| {
                spline::near_segment(
                    &stacks.first[k],
                    at,
                    #[inline(always)]
                    |n, jet| (value[n], slope[n]) = (jet.value, jet.node().1),
                );
            },
        );
        for n in 0..SEGMENT {
            (b1[n], slope1[n]) = (v[n].choose(value[n], b1[n]), v[n].choose(slope[n], slope1[n]));
        }
    }
    if least < 0.0 {
        for n in 0..SEGMENT {
            size[n] = (-v[n]).max(none);
        }
        let blurred = stack::between_segment(
            &size,
            stacks.second.len(),
            #[inline(always)]
            |k, node| stack::node_segment(&stacks.second[k], at, shift, node),
        );
        for n in 0..SEGMENT {
            b2[n] = v[n].choose(b2[n], blurred[0][n]);
            slope2[n] = v[n].choose(slope2[n], -blurred[1][n]);
            dx2[n] = v[n].choose(dx2[n], blurred[2][n]);
            dy2[n] = v[n].choose(dy2[n], blurred[3][n]);
        }
    }
    samples
}

/// Both photographs and their blur stacks, for passes over some of the pixels of a level.
pub(super) struct Samples<'a, N> {
    /// Mean of the kernel at V = 1, width of a pixel, and image centre.
    pub(super) lens: ([f32; 2], f32, [f32; 2]),
    pub(super) r: &'a Registration,
    /// T when I2 was warped onto I1's pixels, if it was.
    pub(super) warped: Option<&'a Registration>,
    pub(super) i1: &'a Raster<N>,
    pub(super) stacks: Stacks<'a, N>,
}

/// A pixel of [`Samples`].
pub(super) struct Sample {
    pub(super) x: usize,
    /// Its displacement by T, px.
    pub(super) d: [f64; 2],
    pub(super) v: f64,
    /// I1, and J before gain and offset.
    pub(super) sharp: [f64; 2],
    /// Î1, and Î2 before gain and offset.
    pub(super) blurred: [f64; 2],
}

impl<N: Number> Samples<'_, N> {
    /// Calls `visit` with every `step`-th pixel of row y whose blur is inside both photographs. `v` returns the V of the
    /// pixels from the first of a segment on.
    #[inline(always)]
    pub(super) fn visit_row<'v>(
        &self,
        y: usize,
        step: usize,
        v: impl Fn(usize) -> &'v [N],
        mut visit: impl FnMut(Sample),
    ) {
        let ((_, factor, centre), r, size) = (self.lens, self.r, [self.i1.width, self.i1.height]);
        let (factor, centre, moved) = (factor.into(), centre.map(f64::from), self.warped.map(|t| r.moved_since(t)));
        let [mut d, mut shift] = [[[N::default(); SEGMENT]; 2]; 2];
        for first in (0..size[0]).step_by(SEGMENT) {
            // So that no node of the stack is read for places beyond the image.
            let (v, mut margins) =
                (first_repeated(&v(first)[..(size[0] - first).min(SEGMENT)]), [N::default(); SEGMENT]);
            let numbers = vectorised(
                #[inline(always)]
                || {
                    let ([dx, dy], row) = (&mut d, N::of(y as f64));
                    r.displacements([first, y], factor, centre, [dx, dy]);
                    for n in 0..SEGMENT {
                        margins[n] = margin([place(first, n), row], [dx[n], dy[n]], size, v[n], r.scale());
                    }
                    let [dx, dy] = &mut shift;
                    let moved = moved.as_ref()?;
                    moved.displacements([first, y], factor, centre, [dx, dy]);
                    let [i1, j, _, _, b1, _, b2, ..] = sample_segment(&self.stacks, [first, y], [dx, dy], &v);
                    Some([i1, j, b1, b2])
                },
            );
            for n in (0..SEGMENT.min(size[0] - first)).step_by(step).filter(|&n| margins[n] >= N::default()) {
                let (x, v, d) = (first + n, v[n].into(), d.map(|d| d[n].into()));
                let [i1, j, b1, b2] = match &numbers {
                    Some(numbers) => numbers.each_ref().map(|numbers| numbers[n].into()),
                    None => {
                        let sample = sample_pair(self.lens, r, [x, y], self.i1, v, &self.stacks);
                        let [b1, b2] = sample.blurred;
                        [sample.i1, sample.i2.value, b1.value, b2.value]
                    }
                };
                visit(Sample { x, d, v, sharp: [i1, j], blurred: [b1, b2] });
            }
        }
    }
}

/// Samples both images at a pixel, on a level whose pixels are `factor` wide. `mean` is that of the kernel at V = 1.
#[inline(always)]
pub(super) fn sample_pair<N: Number>(
    (mean, factor, centre): ([f32; 2], f32, [f32; 2]),
    r: &Registration,
    [x, y]: [usize; 2],
    i1: &Raster<N>,
    v: f64,
    stacks: &Stacks<N>,
) -> PairSample {
    let (factor, centre) = (factor.into(), centre.map(f64::from));
    let (p, d) = ([x as f64, y as f64], r.displacement(x, y, factor, centre));
    let mut i2 = spline::read(&stacks.second[0], p[0] + d[0], p[1] + d[1]);
    [i2.dx, i2.dy] = r.in_first([i2.dx, i2.dy]);
    PairSample { i1: i1.get(x, y), i2, blurred: read(stacks, r, mean.map(f64::from), p, d, v) }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::super::Field;
    use super::super::stack::node_count;
    use super::*;
    use crate::base::{Kernel, Photometric, Similarity};
    use crate::engine::stages::harness::build_stack;

    /// The wave cos(k x) blurred by the half-Gaussian of variance v, by the midpoint rule.
    fn blurred_wave(k: f64, v: f64, x: f64) -> f64 {
        let steps = 4000;
        let density = |u: f64| (2.0 / PI).sqrt() * (-u * u / 2.0).exp();
        let step = 7.0 / f64::from(steps);
        (0..steps)
            .map(|n| (f64::from(n) + 0.5) * step)
            .map(|u| density(u) * (k * (x - u * v.sqrt())).cos())
            .sum::<f64>()
            * step
    }

    #[test]
    fn a_wave_under_the_half_gaussian_is_shifted_and_damped_as_in_closed_form() {
        let (width, k) = (128, 2.0 * PI * 13.0 / 127.0);
        let wave = Field::from_fn(width, 9, |x, _| (k * x as f64).cos());
        let stack = build_stack(&wave, &Kernel::HalfGaussian, node_count(12.0));
        let stacks = Stacks { first: &stack, second: &stack, slopes: Slopes::Layers };
        let mean = Kernel::HalfGaussian.mean();
        let identity = Registration::new(Similarity::IDENTITY, &Photometric::IDENTITY);
        for v in [0.3, 1.0, 2.25, 6.25, 9.0] {
            // Far from the borders, where the wave is mirrored.
            for x in [50.0, 57.0, 63.0] {
                let [b1, _] = read(&stacks, &identity, mean, [x, 4.0], [0.0, 0.0], v);
                let [_, b2] = read(&stacks, &identity, mean, [x, 4.0], [0.0, 0.0], -v);
                let expected = blurred_wave(k, v, x);
                let slope = (blurred_wave(k, v + 1e-3, x) - blurred_wave(k, v - 1e-3, x)) / 2e-3;
                // 3e-3 of the contrast: the error of the cubic between the nodes.
                assert!((b1.value - expected).abs() < 3e-3, "v {v}, x {x}: {} {expected}", b1.value);
                assert!((b2.value - expected).abs() < 3e-3, "v {v}, x {x}: {} {expected}", b2.value);
                assert!((b1.slope - slope).abs() < 1e-2, "v {v}, x {x}: slope {} {slope}", b1.slope);
                assert!((b2.slope + slope).abs() < 1e-2, "v {v}, x {x}: slope {} {slope}", b2.slope);
            }
        }
    }
}
