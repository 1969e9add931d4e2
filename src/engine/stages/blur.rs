//! Both images blurred until they look alike, Î1 and Î2, and their derivatives by V.
//!
//! The CPU reference of `glsl/include/blur.glsl`. Equations 22 and 25 of the paper, sections 2 and 3 of
//! `docs/method.md`.

use super::law::Variances;
use super::segments::{SEGMENT, Segment, first_repeated, place, vectorised};
use super::spline;
use super::stack::{self, Blurred, Slopes};
use super::state::{Displacement, DoubleState, Registration, margin};
use super::{Number, Raster};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

/// Below this variance, px², the kernel's mean moves linearly, so that its derivative stays finite. The derivative jumps
/// there. At V = 0 the relative law has variances of 0.05, so 0.04 keeps rounding from choosing the side.
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

/// Î1 and Î2 at pixel (x, y), which is displaced by d, before gain and offset, with their derivatives by V; the parallax
/// moves by `parallax` with V. `mean`
/// is that of the kernel at variance 1: the stacks hold centred kernels, and are read where the mean moves the pixel
/// to. Gradients are per pixel of I1.
pub fn read<N: Number>(
    &Stacks { first, second, slopes }: &Stacks<N>,
    r: &Registration,
    mean: [f64; 2],
    [x, y]: [f64; 2],
    d: [f64; 2],
    (v, parallax): (f64, [f64; 2]),
    separation: f64,
) -> [Blurred; 2] {
    let scale2 = r.scale().powi(2);
    let [[xx, xy], [yx, yy]] = r.transform.jacobian();
    let variances = Variances::new(v, separation);
    // The kernel rotates with the sensor of the blurred image: that of I1's blur is I2's.
    let (sin, cos) = r.transform.rotation().sin_cos();
    let turned = [cos * mean[0] + sin * mean[1], cos * mean[1] - sin * mean[0]];
    let [(mean1, by1), (mean2, by2)] = [mean_at(turned, variances.first), mean_at(mean, variances.second)];
    let ahead = [xx * mean2[0] + xy * mean2[1], yx * mean2[0] + yy * mean2[1]];
    let mut b1 = stack::read(first, slopes, variances.first, x - mean1[0], y - mean1[1]);
    let mut b2 = stack::read(second, slopes, scale2 * variances.second, x + d[0] - ahead[0], y + d[1] - ahead[1]);
    [b2.dx, b2.dy] = r.in_first([b2.dx, b2.dy]);
    b1.slope = variances.first_by_v * (b1.slope - b1.dx * by1[0] - b1.dy * by1[1]);
    b2.slope = variances.second_by_v * (scale2 * b2.slope - b2.dx * by2[0] - b2.dy * by2[1])
        + b2.dx * parallax[0]
        + b2.dy * parallax[1];
    [b1, b2]
}

/// The mean of a kernel of this variance, and its derivative by the variance.
fn mean_at(mean: [f64; 2], variance: f64) -> ([f64; 2], [f64; 2]) {
    let root = variance.max(LEAST_ROOT).sqrt();
    let by_variance = if variance > LEAST_ROOT { 0.5 / root } else { 1.0 / root };
    (mean.map(|m| variance / root * m), mean.map(|m| by_variance * m))
}

/// The numbers of the pixels of a segment: Î1 and its slope by V, Î2, its slope and its gradient, before gain and
/// offset. Gradients are per pixel of I1.
pub(super) type PairSegment<N> = [Segment<N>; 6];

/// The pixels of the segment from (x, y) to the right, which T has moved by `shift` since I2 was warped. For
/// kernels without a mean.
#[inline(always)]
pub(super) fn sample_segment<N: Number>(
    stacks: &Stacks<N>,
    separation: f64,
    at: [usize; 2],
    shift: [&Segment<N>; 2],
    v: &Segment<N>,
) -> PairSegment<N> {
    let none = [N::default(); SEGMENT];
    let [mut first, mut second, mut first_by_v, mut second_by_v] = [none; 4];
    for n in 0..SEGMENT {
        let variances = Variances::new(v[n], separation);
        (first[n], second[n]) = (variances.first, variances.second);
        (first_by_v[n], second_by_v[n]) = (variances.first_by_v, variances.second_by_v);
    }
    let [b1, mut slope1, ..] = stack::between_segment(
        &first,
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
    let [b2, mut slope2, dx2, dy2] = stack::between_segment(
        &second,
        stacks.second.len(),
        #[inline(always)]
        |k, node| stack::node_segment(&stacks.second[k], at, shift, node),
    );
    for n in 0..SEGMENT {
        slope1[n] = first_by_v[n] * slope1[n];
        slope2[n] = second_by_v[n] * slope2[n];
    }
    [b1, slope1, b2, slope2, dx2, dy2]
}

/// Both photographs and their blur stacks, for passes over some of the pixels of a level.
pub(super) struct Samples<'a, N> {
    /// Mean of the kernel at V = 1.
    pub(super) mean: [f64; 2],
    pub(super) displacement: Displacement<'a>,
    /// T when I2 was warped onto I1's pixels, if it was.
    pub(super) warped: Option<&'a Registration>,
    /// Of the focus settings, px² of the level.
    pub(super) separation: f64,
    pub(super) stacks: Stacks<'a, N>,
}

/// A pixel of [`Samples`].
pub(super) struct Sample {
    pub(super) x: usize,
    /// Its displacement by T, px.
    pub(super) d: [f64; 2],
    pub(super) v: f64,
    /// Î1, and Î2 before gain and offset.
    pub(super) blurred: [f64; 2],
}

impl<'a, N: Number> Samples<'a, N> {
    /// Samples of the stacks in `layers`: that of I2 begins at the layer `second`, and each has `nodes` nodes. Mean of
    /// the kernel at V = 1, width of a pixel, and image centre.
    pub(super) fn of(
        state: &'a DoubleState,
        layers: &'a [Raster<N>],
        [second, nodes]: [u32; 2],
        (mean, factor, centre): ([f32; 2], f32, [f32; 2]),
        variant: Variant,
    ) -> Self {
        Self {
            mean: mean.map(f64::from),
            displacement: state.displacement(factor, centre),
            warped: state.warped_by(variant),
            separation: state.separation_on(factor),
            stacks: Stacks::of(layers, second, nodes, variant.has(Variant::ANY_KERNEL)),
        }
    }

    /// Î1 and Î2 at a pixel with its displacement, before gain and offset, with their derivatives by V.
    pub(super) fn read(&self, at: [usize; 2], d: [f64; 2], v: f64) -> [Blurred; 2] {
        let (Displacement { r, factor, centre, .. }, place) = (self.displacement, at.map(|x| x as f64));
        let Some(warped) = self.warped else {
            let parallax = self.displacement.by_v(place);
            return read(&self.stacks, r, self.mean, place, d, (v, parallax), self.separation);
        };
        let shift = r.moved_since(warped).displacement(at[0], at[1], factor, centre);
        let of = Variances::new(v, self.separation);
        let near = |stack: &[Raster<N>], variance, shift| {
            stack::between(variance, stack.len(), |k| spline::near(&stack[k], at[0], at[1]).moved(shift).node())
        };
        let mut both = [near(self.stacks.first, of.first, [0.0; 2]), near(self.stacks.second, of.second, shift)];
        both[0].slope *= of.first_by_v;
        both[1].slope *= of.second_by_v;
        both
    }

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
        let Displacement { r, factor, centre, .. } = self.displacement;
        let size = [self.stacks.first[0].width, self.stacks.first[0].height];
        let moved = self.warped.map(|t| r.moved_since(t));
        let [mut d, mut shift] = [[[N::default(); SEGMENT]; 2]; 2];
        for first in (0..size[0]).step_by(SEGMENT) {
            // So that no node of the stack is read for places beyond the image.
            let (v, mut margins) =
                (first_repeated(&v(first)[..(size[0] - first).min(SEGMENT)]), [N::default(); SEGMENT]);
            let numbers = vectorised::<N, _>(
                #[inline(always)]
                || {
                    let ([dx, dy], row) = (&mut d, N::of(y as f64));
                    self.displacement.of_row([first, y], &v, [dx, dy]);
                    for n in 0..SEGMENT {
                        let variances = Variances::new(v[n], self.separation);
                        margins[n] = margin([place(first, n), row], [dx[n], dy[n]], size, variances.both(), r.scale());
                    }
                    let [dx, dy] = &mut shift;
                    let moved = moved.as_ref()?;
                    moved.displacements([first, y], factor, centre, [dx, dy]);
                    let [b1, _, b2, ..] = sample_segment(&self.stacks, self.separation, [first, y], [dx, dy], &v);
                    Some([b1, b2])
                },
            );
            for n in (0..SEGMENT.min(size[0] - first)).step_by(step).filter(|&n| margins[n] >= N::default()) {
                let (x, v, d) = (first + n, v[n].into(), d.map(|d| d[n].into()));
                let blurred = match &numbers {
                    Some(numbers) => numbers.each_ref().map(|numbers| numbers[n].into()),
                    None => {
                        // The slope by V is not used.
                        let (at, v) = ([x as f64, y as f64], (v, [0.0; 2]));
                        read(&self.stacks, r, self.mean, at, d, v, self.separation).map(|image| image.value)
                    }
                };
                visit(Sample { x, d, v, blurred });
            }
        }
    }
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
                let [b1, _] = read(&stacks, &identity, mean, [x, 4.0], [0.0, 0.0], (v, [0.0; 2]), 0.0);
                let [_, b2] = read(&stacks, &identity, mean, [x, 4.0], [0.0, 0.0], (-v, [0.0; 2]), 0.0);
                // Both images are blurred by as much more as the other one is.
                let Variances { first, first_by_v, .. } = Variances::new(v, 0.0);
                let wave = |variance: f64| blurred_wave(k, variance, x);
                let (expected, slope) = (wave(first), first_by_v * (wave(first + 1e-3) - wave(first - 1e-3)) / 2e-3);
                // 3e-3 of the contrast: the error of the cubic between the nodes.
                assert!((b1.value - expected).abs() < 3e-3, "v {v}, x {x}: {} {expected}", b1.value);
                assert!((b2.value - expected).abs() < 3e-3, "v {v}, x {x}: {} {expected}", b2.value);
                assert!((b1.slope - slope).abs() < 1e-2, "v {v}, x {x}: slope {} {slope}", b1.slope);
                assert!((b2.slope + slope).abs() < 1e-2, "v {v}, x {x}: slope {} {slope}", b2.slope);
            }
        }
    }
}
