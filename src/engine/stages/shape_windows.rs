//! Estimates the kernel's shape in windows of the photographs.
//!
//! With V, T and brightness of the coarser level, S of a window of 24 x 24 px is fitted by six terms: the window's own
//! V, translation, offset and gain, and the [departure](super::stack::departure) of a disk from a Gaussian. The part
//! that only the departure explains determines the shape. Without the window's own terms, errors of V, which a wrong
//! shape causes, would be taken for shape. Noise of the sharper image is in both S and the departure; its part of their
//! product is subtracted. Its power is taken from mixed differences of S. The residuals of the fit are larger than
//! noise on photographs: with their power the median shape was -16 where |V| was 1 to 2 px² (heat sink, coarser levels)
//! and -2 at 4 to 8 px², with that of the differences -5 and 0.2.
//!
//! On renderings the shape is 0.0 for Gaussians and 0.9 to 1.4 for disks, and larger the blurrier the sharper image is.

use std::f64::consts::FRAC_PI_2;

use super::blur::Stacks;
use super::mask::{self, Masks};
use super::noise::{self, Noise};
use super::pass::{Memory, Pass};
use super::segments::{SEGMENT, Segment, first_repeated, place, range, vectorised};
use super::stack::{self, BlurredSegment};
use super::state::{DoubleState, margin};
use super::{Number, Raster, spline};
use crate::base::workers;
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

pub use super::interface::shape_windows::*;

/// Side of a window, pixels: wide compared with the blur of most pairs, narrow compared with areas in focus at one
/// distance.
const SIDE: usize = shaders::shape_windows::SIDE as usize;
/// The least share by which a pixel of a window counts. The averaged mask of a pixel far from masked ones differs from
/// 1 by rounding, which the share multiplies by 25.
const COUNTED: f64 = shaders::shape_windows::COUNTED;
/// The most windows along a side of the level: together a seventh of 1 Mpx.
const MOST_ALONG: u32 = 16;

/// Columns and rows of windows on a level.
pub(crate) fn grid(size: [u32; 2]) -> [u32; 2] {
    size.map(|side| (side / SIDE as u32).clamp(1, MOST_ALONG))
}

/// The most floats of all windows of a level.
pub(crate) const FLOATS: u64 = 2 * (MOST_ALONG * MOST_ALONG) as u64;
const _: () = assert!(MOST_ALONG * MOST_ALONG == shaders::shape_median::MOST_WINDOWS);

/// Whether a level is large enough for a window.
pub(crate) fn fits([width, height]: [u32; 2]) -> bool {
    width.min(height) >= SIDE as u32
}

/// The estimate of a window.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Window {
    /// Shape of the kernel minus the current shape; 1 is the departure of a disk.
    pub shape: f64,
    /// The inverse of the variance of `shape`.
    pub weight: f64,
}

impl Pass for Bindings {
    /// Compulsory traffic: V, the sharp images and four nodes of the windows' pixels.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        4 * 7 * u64::from(c.grid[0] * c.grid[1]) * (SIDE * SIDE) as u64
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let stacks = Stacks::of(memory.layers(self.stacks), c.second_stack, c.nodes, false);
        let masks = mask::of(memory, self.masks, variant);
        let windows = cpu_reference(c, memory.state(self.state), memory.layer(self.relative_blur, 0), &stacks, masks);
        let numbers = memory.numbers_mut(self.partials, FLOATS as usize);
        for (n, window) in windows.iter().enumerate() {
            [numbers[2 * n], numbers[2 * n + 1]] = [window.shape, window.weight].map(N::of);
        }
    }
}

/// The terms of S: the window's own V, t_x, t_y, offset and gain; the kernel's shape; and S itself.
const TERMS: usize = shaders::shape_windows::TERMS_OF_S as usize;
const SHAPE: usize = shaders::shape_windows::SHAPE as usize;
const LEFT: usize = shaders::shape_windows::LEFT as usize;
/// Ratio of the variances of neighbouring nodes.
const RATIO: f64 = 16.0 / 9.0;

/// The estimates of all windows, row by row.
pub fn cpu_reference<N: Number>(
    c: &Constants,
    state: &DoubleState,
    v: &Raster<N>,
    stacks: &Stacks<N>,
    masks: Option<&Masks<N>>,
) -> Vec<Window> {
    let [columns, rows] = c.grid.map(|n| n as usize);
    let size = [c.width, c.height].map(|side| side as usize);
    let corner = |n: usize, of: usize, side: usize| (2 * n + 1) * side / (2 * of) - SIDE / 2;
    workers::map(columns * rows, |n| {
        let corner = [corner(n % columns, columns, size[0]), corner(n / columns, rows, size[1])];
        of_window(c, state, v, (stacks, masks), corner).unwrap_or_default()
    })
}

/// The estimate of the window with this corner; `None` if a pixel does not count.
fn of_window<N: Number>(
    c: &Constants,
    state: &DoubleState,
    v: &Raster<N>,
    (stacks, masks): (&Stacks<N>, Option<&Masks<N>>),
    corner: [usize; 2],
) -> Option<Window> {
    let (r, moved) = (&state.registration, state.registration.moved_since(&state.warped));
    let (size, factor, centre) = ([v.width, v.height], f64::from(c.factor), c.centre.map(f64::from));
    let (mut m, mut means) = ([[0.0; TERMS]; TERMS], Means::default());
    let (mut above, whole) = (None, (SIDE * SIDE) as f64);
    // The values less that of one pixel: their squares in single precision would be those of the mean.
    let around = N::of(stacks.second[0].get(corner[0] + SIDE / 2, corner[1] + SIDE / 2));
    for y in corner[1]..corner[1] + SIDE {
        let (at, none) = ([corner[0], y], N::default());
        // So that no node is read for places beyond the window.
        let v = first_repeated(&v.row(y)[at[0]..][..SIDE]);
        let [mut dx, mut dy, mut shift_x, mut shift_y, mut shares, mut margins] = [[none; SEGMENT]; 6];
        let (terms, sums) = vectorised(
            #[inline(always)]
            || {
                r.displacements(at, factor, centre, [&mut dx, &mut dy]);
                moved.displacements(at, factor, centre, [&mut shift_x, &mut shift_y]);
                mask::counts_segment(masks, at, [&dx, &dy], &mut shares);
                let mut sums = [0.0; 3];
                for n in 0..SIDE {
                    margins[n] = margin([place(at[0], n), N::of(y as f64)], [dx[n], dy[n]], size, v[n], r.scale());
                    sums[0] += v[n].abs().into();
                    sums[1] += v[n].choose(N::of(1.0), none).into();
                    sums[2] += noise::interpolated([dx[n], dy[n]]).into();
                }
                if (0..SIDE).any(|n| !(margins[n] >= none && shares[n] >= N::of(COUNTED))) {
                    return None;
                }
                let terms = terms(state, (stacks, around), at, [&shift_x, &shift_y], &v);
                // `estimate` reads no others.
                for i in 0..TERMS {
                    for j in i..TERMS {
                        m[i][j] += product(&terms[i], &terms[j]);
                    }
                }
                Some((terms, sums))
            },
        )?;
        means.variance += sums[0] / whole;
        means.first += sums[1] / whole;
        means.between += sums[2] / whole;
        let below: [f64; SIDE] = std::array::from_fn(|n| terms[LEFT][n].into());
        if let Some(above) = above.replace(below) {
            let mixed = |x: usize| 0.5 * (above[x] - above[x + 1] - below[x] + below[x + 1]).abs();
            means.mixed += (0..SIDE - 1).map(mixed).sum::<f64>() / ((SIDE - 1) * (SIDE - 1)) as f64;
        }
    }
    Some(estimate(m, &means, state.registration.gain, &c.noise))
}

/// Partial sums of a row, which are added at its end.
const LANES: usize = 8;
const _: () = assert!(SIDE.is_multiple_of(LANES) && SIDE <= SEGMENT);

/// The sum of a times b over the pixels of a row of a window.
#[inline(always)]
fn product<N: Number>(a: &Segment<N>, b: &Segment<N>) -> f64 {
    let mut lanes = [N::default(); LANES];
    for first in (0..SIDE).step_by(LANES) {
        for n in 0..LANES {
            lanes[n] += a[first + n] * b[first + n];
        }
    }
    lanes.into_iter().map(Into::into).sum()
}

/// The terms at the pixels of the segment from (x, y) to the right: derivatives of S, and S. T has moved the pixels by
/// `shift` since I2 was warped. `around` is subtracted from the term of the gain, as that of the offset allows.
#[inline(always)]
fn terms<N: Number>(
    state: &DoubleState,
    (stacks, around): (&Stacks<N>, N),
    at: [usize; 2],
    shift: [&Segment<N>; 2],
    v: &Segment<N>,
) -> [Segment<N>; TERMS] {
    let none = [N::default(); SEGMENT];
    let [gain, offset, shape, one] =
        N::all([state.registration.gain, state.registration.offset, state.kernel_shape, 1.0]);
    let ([mut i1, mut j], [least, most]) = ([none; 2], range(v));
    spline::near_segment(
        &stacks.first[0],
        at,
        #[inline(always)]
        |n, jet| i1[n] = jet.value,
    );
    spline::near_segment(
        &stacks.second[0],
        at,
        #[inline(always)]
        |n, jet| j[n] = jet.moved([shift[0][n], shift[1][n]]).value,
    );
    let (mut terms, mut size) = ([none; TERMS], none);
    terms[3] = [one; SEGMENT];
    // Terms of the sharper image, blurred by V: noise of the other is in S, and must not be in the terms.
    if most >= 0.0 {
        for n in 0..SEGMENT {
            size[n] = v[n].max(N::default());
        }
        let ([value, slope, dx, dy], departure) = sharper(stacks.first, at, [&none; 2], &size);
        for n in 0..SEGMENT {
            (terms[0][n], terms[1][n], terms[2][n], terms[4][n]) = (slope[n], dx[n], dy[n], value[n] - around);
            (terms[SHAPE][n], terms[LEFT][n]) = (departure[n], value[n] - (gain * j[n] + offset));
        }
    }
    if least < 0.0 {
        for n in 0..SEGMENT {
            size[n] = (-v[n]).max(N::default());
        }
        let ([value, slope, dx, dy], departure) = sharper(stacks.second, at, shift, &size);
        for n in 0..SEGMENT {
            let (departs, s) = (-gain * departure[n], i1[n] - (gain * value[n] + offset));
            let numbers = [-slope[n], dx[n], dy[n], one, value[n] - around, departs, s];
            for (term, number) in terms.iter_mut().zip(numbers) {
                term[n] = v[n].choose(term[n], number);
            }
        }
    }
    for n in 0..SEGMENT {
        terms[LEFT][n] += shape * terms[SHAPE][n];
    }
    terms
}

/// An image blurred by `size`, |V| of each pixel, and the departure of a disk there, both interpolated between nodes.
#[inline(always)]
fn sharper<N: Number>(
    stack: &[Raster<N>],
    at: [usize; 2],
    shift: [&Segment<N>; 2],
    size: &Segment<N>,
) -> (BlurredSegment<N>, Segment<N>) {
    let mut values = [[N::default(); SEGMENT]; stack::MOST_NODES];
    let blurred = stack::between_segment(
        size,
        stack.len(),
        #[inline(always)]
        |k, node| {
            stack::node_segment(&stack[k], at, shift, node);
            values[k] = node[0];
        },
    );
    // Departures need one more node on either side of those that V is between.
    let [first, last] = range(size).map(|v| stack::node_below(v, stack.len()));
    let ([lowest, ..], [.., highest]) =
        (stack::departure_nodes(first, stack.len()), stack::departure_nodes(last + 1, stack.len()));
    for k in (lowest..first).chain(last + 2..highest + 1) {
        let values = &mut values[k];
        spline::near_segment(
            &stack[k],
            at,
            #[inline(always)]
            |n, jet| values[n] = jet.moved([shift[0][n], shift[1][n]]).value,
        );
    }
    let mut departure = [N::default(); SEGMENT];
    for k in first..=last {
        let [v0, v1] = [k, k + 1].map(stack::node_variance);
        let start = if k == first { N::default() } else { N::of(v0) };
        for n in 0..SEGMENT {
            let at = |k| stack::departure_of(k, stack.len(), |n_node: usize| values[n_node][n]);
            let t = ((size[n] - N::of(v0)) / N::of(v1 - v0)).min(N::of(1.0));
            let here = (N::of(1.0) - t) * at(k) + t * at(k + 1);
            departure[n] = (size[n] - start).choose(here, departure[n]);
        }
    }
    (blurred, departure)
}

/// Means over a window.
#[derive(Default)]
struct Means {
    /// Of |V|.
    variance: f64,
    /// The share of the pixels with V ≥ 0.
    first: f64,
    /// Of the power of I2's noise on I1's pixels.
    between: f64,
    /// Of the magnitudes of the mixed differences of S over 2: √(2/π) deviations of white noise in S. Errors of the fit
    /// are smooth and hardly contribute.
    mixed: f64,
}

/// Eliminates the window's own terms, and fits the rest of S by the rest of the departure.
fn estimate(mut m: [[f64; TERMS]; TERMS], means: &Means, gain: f64, noise: &Noise) -> Window {
    let whole: [f64; TERMS] = std::array::from_fn(|i| m[i][i]);
    for p in 0..SHAPE {
        if m[p][p] > 1e-5 * whole[p] {
            for i in p + 1..TERMS {
                (i..TERMS).for_each(|j| m[i][j] -= m[p][i] * m[p][j] / m[p][p]);
            }
        }
    }
    let (information, product) = (m[SHAPE][SHAPE], m[SHAPE][LEFT]);
    if !(information > 1e-4 * whole[SHAPE] && information > 1e-9) {
        return Window::default();
    }
    let left = (m[LEFT][LEFT] - product * product / information).max(0.0) / (SIDE * SIDE - TERMS) as f64;
    let v = means.variance.max(0.1);
    let variances = [v / RATIO, v, v * RATIO];
    // Noise of the sharper image; that of I2 is interpolated, and has the gain.
    let mix = |of_second: f64, of_first: f64| of_second + means.first * (of_first - of_second);
    let (before, own) = (mix(means.between, 1.0), mix(gain * gain, 1.0));
    let other = mix(1.0, gain * gain * means.between);
    let powers = variances.map(|other| own * noise.blurred(0.5 * (v + other), before).value);
    let noise_power = FRAC_PI_2 * means.mixed.powi(2) / other;
    let shared = (SIDE * SIDE) as f64 * noise_power * stack::departure(v, variances, powers);
    Window { shape: -(product - shared) / information, weight: information / (left + 2.5e-7) }
}

#[cfg(test)]
mod tests {
    use super::super::Field;
    use super::super::harness::{build_stack, random, random_field, smooth_field};

    use super::*;
    use crate::base::Kernel;
    use crate::engine::filter;
    use crate::engine::stages::separable;

    fn constants([width, height]: [usize; 2], nodes: usize) -> Constants {
        let size = [width as u32, height as u32];
        Constants {
            width: size[0],
            height: size[1],
            nodes: nodes as u32,
            second_stack: nodes as u32,
            grid: grid(size),
            factor: 2.0,
            centre: [(width as f32 - 0.5) / 2.0, (height as f32 - 1.0) / 2.0],
            noise: Noise::new(1),
        }
    }

    #[test]
    fn a_mask_that_excludes_nothing_changes_nothing() {
        let images = [1, 2].map(|seed| random_field(90, 60, seed));
        let stacks = images.map(|i| build_stack(&i, &Kernel::Gaussian, stack::node_count(6.0)));
        let read = Stacks { first: &stacks[0], second: &stacks[1], slopes: stack::Slopes::Laplacian };
        let (c, state) = (constants([90, 60], stacks[0].len()), DoubleState::default());
        let v = smooth_field(90, 60, 3);
        // As averaged in single precision.
        let masks = [0; 2].map(|_| Field::from_fn(90, 60, |_, _| 1.0 - 2.0 * f64::from(f32::EPSILON)));
        let [open, masked] = [None, Some(&masks)].map(|masks| cpu_reference(&c, &state, &v, &read, masks));
        assert!(open.iter().any(|window| window.weight > 0.0));
        assert_eq!(open, masked);
    }

    /// The median of the windows' shapes of a texture under a kernel of two variances 4 px² apart, with V off by 0.2
    /// px²: with the more blurred one as I2, and as I1.
    fn median_shapes(kernel: &Kernel, base: f64, noise: f64) -> [f64; 2] {
        let (size, nodes, v) = (220, stack::node_count(9.0), 4.0);
        let texture = smooth_field(size, size, 7);
        let under = |variance: f64| {
            let mut blurred = Field::zeros(size, size);
            for [x, y] in filter::centred(kernel, variance) {
                let term = separable::filtered(&texture, [&x, &y], 1);
                blurred.data.iter_mut().zip(term.data).for_each(|(sum, t)| *sum += t);
            }
            blurred
        };
        let (sharp, blurred) = (if base > 0.0 { under(base) } else { texture.clone() }, under(base + v));
        let noisy = |mut image: Field, seed| {
            let noises = random(12 * size * size, seed);
            let normal = |n: usize| noises[12 * n..12 * n + 12].iter().sum::<f64>() - 6.0;
            image.data.iter_mut().enumerate().for_each(|(n, value)| *value += noise * normal(n));
            image
        };
        let stacks = [noisy(sharp, 8), noisy(blurred, 9)].map(|i| build_stack(&i, &Kernel::Gaussian, nodes));
        let c = Constants { factor: 1.0, noise: Noise::new(0), ..constants([size, size], nodes) };
        [[0, 1], [1, 0]].map(|[first, second]| {
            let read = Stacks { first: &stacks[first], second: &stacks[second], slopes: stack::Slopes::Laplacian };
            let v = Field::from_fn(size, size, |_, _| if first == 0 { v + 0.2 } else { -v - 0.2 });
            let windows = cpu_reference(&c, &DoubleState::default(), &v, &read, None);
            super::super::shape_median::cpu_reference(0.0, &windows)
        })
    }

    #[test]
    fn a_disk_is_distinguished_from_a_gaussian_whichever_photograph_is_sharper() {
        for noise in [0.0, 0.002, 0.01] {
            let [gaussian, disk] = [Kernel::Gaussian, Kernel::Pillbox].map(|kernel| median_shapes(&kernel, 0.0, noise));
            println!("noise {noise}: gaussian {gaussian:.2?}, disk {disk:.2?}");
            for n in 0..2 {
                assert!(
                    gaussian[n].abs() < 0.2 && (disk[n] - 1.0).abs() < 0.35,
                    "noise {noise}: {gaussian:?} {disk:?}"
                );
            }
        }
    }

    #[test]
    fn the_relative_blur_of_two_disks_is_flatter_than_a_disk() {
        let shapes = [0.0, 2.0, 4.0].map(|base| median_shapes(&Kernel::Pillbox, base, 0.001));
        println!("{shapes:.2?}");
        // 1 + 2b/V is 1, 2 and 3 by the fourth cumulants; higher ones make the departure that fits larger.
        for (n, expected) in [1.0, 2.0, 3.0].into_iter().enumerate() {
            assert!(shapes[n].iter().all(|shape| (shape / expected - 1.0).abs() < 0.45), "{n}: {:?}", shapes[n]);
        }
    }
}
