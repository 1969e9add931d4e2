//! Compares candidates for the law and the kernel by what they leave of the residual in windows of the photographs.
//!
//! A window has 24 x 24 px. Every other pixel along x and along y is a sample. S is computed with the V, T and brightness
//! found so far. A wrong law or kernel has made V wrong, so S is fitted by changes of the window's own V, translation,
//! offset and gain. What is left tells the candidates apart: a Gaussian and a disk, each by the relative law and by that of
//! [a lens](super::law) with several separations of the focus settings.
//!
//! A candidate that blurs both photographs more leaves less of anything. So two are compared with both photographs of
//! the less blurred one blurred more, by a Gaussian of the difference: V₂ - V₁ is V for all laws, and the variances are
//! then the same under either candidate. Their noise is nearly the same, but under a disk it is up to 15 % less than under
//! a Gaussian of the same variance. So S is divided by the deviation of [white noise](super::noise) in it. Without that,
//! larger disks were preferred, the more the noise: p of a card was 7.9 and 10.0 px² at noise 0.003 and 0.01 (true: 6.4).

use super::blur::Stacks;
use super::law::Variances;
use super::mask::{self, Masks};
use super::noise::{Noise, Power};
use super::pass::{Memory, Pass};
use super::stack::{self, Blurred, MOST_NODES};
use super::state::{DoubleState, Registration, inside};
use super::{Number, Raster, spline};
use crate::base::{Kernel, Parallax, workers};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

pub use super::interface::lens_windows::*;

/// Side of a window, pixels: wide compared with the blur of most pairs, narrow compared with areas in focus at one
/// distance.
const SIDE: usize = shaders::lens_windows::SIDE as usize;
/// From a sample to the next, pixels.
const STEP: usize = shaders::lens_windows::STEP as usize;
/// Samples along the side of a window.
const ALONG: usize = SIDE / STEP;
/// The least share by which a pixel of a window counts. The averaged mask of a pixel far from masked ones differs from
/// 1 by rounding, which the share multiplies by 25.
const COUNTED: f64 = shaders::lens_windows::COUNTED;
/// Windows with a larger mean |V| than this, px² of the level, do not count: their own terms explain most of what is so
/// blurred. Coarser levels have determined the separation by them.
const WIDEST: f64 = shaders::lens_windows::WIDEST;
/// The least square of S over the power of its noise: a fifth of that of rounding to 256 values.
const LEAST_SQUARE: f64 = shaders::lens_windows::LEAST_SQUARE;
/// The noise under a disk of variance v and then a Gaussian of variance w, as a share of that under a Gaussian of both:
/// 1 - FLAT x² + FLATTER x⁴ with x = v/(v + w + PIXEL). It agrees with the sum over the nodes, on pixels, to 0.06, and to 0.02
/// for v of 1 px² and more.
const FLAT: f64 = shaders::lens_windows::FLAT;
const FLATTER: f64 = shaders::lens_windows::FLATTER;
const PIXEL: f64 = shaders::lens_windows::PIXEL;
/// The most windows along a side of the level. A hundred windows told the candidates apart in trials; more take longer.
const MOST_ALONG: u32 = 10;

/// The places of a lens's numbers.
pub(super) const CHAIN: usize = shaders::lens::CHAIN as usize;
pub(super) const KERNEL: usize = shaders::lens::KERNEL as usize;
pub(super) const LAW: usize = shaders::lens::LAW as usize;
pub(super) const OF_LENS: usize = shaders::lens::OF_LENS as usize;
/// The place of the mean of |V|.
pub(super) const MEAN: usize = 1 + OF_LENS * shaders::lens::MOST_LENSES as usize;

/// The separations of the lenses that are candidates, px² of the full-size image: about the one that was `found`, or
/// over all that pairs have if none was. Each is the same multiple of the one before.
pub(super) fn separations(found: f64) -> Vec<f64> {
    use shaders::lens::{FIRST_RATIO, FIRST_SEPARATION, LATER_LENSES, MOST_LENSES, RATIO};
    let (first, ratio, count) = if found > 0.0 {
        (found * RATIO.powi(-(LATER_LENSES as i32) / 2), RATIO, LATER_LENSES)
    } else {
        (FIRST_SEPARATION, FIRST_RATIO, MOST_LENSES)
    };
    (0..count).map(|n| first * ratio.powi(n as i32)).collect()
}

/// Columns and rows of windows on a level.
pub(crate) fn grid(size: [u32; 2]) -> [u32; 2] {
    size.map(|side| (side / SIDE as u32).clamp(1, MOST_ALONG))
}

/// The most floats of all windows of a level.
pub(crate) const FLOATS: u64 = (MEAN as u64 + 1) * (MOST_ALONG * MOST_ALONG) as u64;

/// Whether a level is large enough for a window.
pub(crate) fn fits([width, height]: [u32; 2]) -> bool {
    width.min(height) >= SIDE as u32
}

impl Pass for Bindings {
    /// Compulsory traffic: V and all nodes of both stacks at the samples.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        4 * u64::from(1 + 2 * c.nodes) * u64::from(c.grid[0] * c.grid[1]) * (ALONG * ALONG) as u64
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let state = memory.state(self.state);
        let is_gaussian = c.are_gaussian != 0 || state.kernel_shape == 0.0;
        if state.levels[c.level as usize].settled != 0 || !is_gaussian {
            return;
        }
        let known = 1 + OF_LENS * separations(state.separation).len();
        let stacks = Stacks::of(memory.layers(self.stacks), c.second_stack, c.nodes, false);
        let masks = mask::of(memory, self.masks, variant);
        let windows = cpu_reference(c, state, memory.layer(self.relative_blur, 0), &stacks, masks);
        let numbers = memory.numbers_mut(self.partials, FLOATS as usize);
        for (numbers, window) in numbers.chunks_mut(MEAN + 1).zip(windows) {
            numbers[MEAN] = N::of(window[MEAN]);
            let known = if window[MEAN] < 0.0 { 0 } else { known };
            (0..known).for_each(|n| numbers[n] = N::of(window[n]));
        }
    }
}

/// The terms of S: the window's own V, t_x, t_y, offset and gain; and S itself.
const TERMS: usize = shaders::lens_windows::TERMS_OF_S as usize;
const LEFT: usize = shaders::lens_windows::LEFT as usize;

/// The numbers of a window, logarithms of ratios of residuals: a Gaussian's over a disk's, by the relative law; then of
/// each lens the next lens's over this one's, a Gaussian's over a disk's, and the relative law's over this one's; then
/// the mean of |V| in px² of the full-size image, or -1 if the window does not count.
type Window = [f64; MEAN + 1];

/// The numbers of all windows, row by row.
fn cpu_reference<N: Number>(
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
        let mut unknown = [0.0; MEAN + 1];
        unknown[MEAN] = -1.0;
        of_window(c, state, v, (stacks, masks), corner).unwrap_or(unknown)
    })
}

/// The numbers of the window with this corner; `None` if it does not count.
fn of_window<N: Number>(
    c: &Constants,
    state: &DoubleState,
    v: &Raster<N>,
    (stacks, masks): (&Stacks<N>, Option<&Masks<N>>),
    corner: [usize; 2],
) -> Option<Window> {
    let (r, moved) = (&state.registration, state.registration.moved_since(&state.warped));
    let displacement = state.displacement(c.factor, c.centre);
    let (size, factor, centre) = ([v.width, v.height], f64::from(c.factor), c.centre.map(f64::from));
    // The values less that of one pixel: their squares in single precision would be those of the mean.
    let around = stacks.second[0].get(corner[0] + SIDE / 2, corner[1] + SIDE / 2);
    let (mut samples, mut sum) = (Vec::with_capacity(ALONG * ALONG), 0.0);
    for n in 0..ALONG * ALONG {
        let at @ [x, y] = [corner[0] + STEP * (n % ALONG), corner[1] + STEP * (n / ALONG)];
        let (place, v) = (at.map(|x| x as f64), v.get(x, y));
        let d = displacement.of(place, v);
        let is_inside = inside(at, d, size, Variances::new(v, 0.0).both(), r.scale());
        if !(is_inside && mask::counts(masks, at, d) >= COUNTED) {
            return None;
        }
        sum += v.abs();
        let second = match state.parallax {
            Parallax::NONE => Second::Near(moved.displacement(x, y, factor, centre)),
            _ => Second::Apart { d, scale: r.scale(), parallax: r.in_second(displacement.by_v(place)) },
        };
        samples.push(PixelNodes::of(stacks, at, second, v));
    }
    let mean = sum / (ALONG * ALONG) as f64;
    if mean >= WIDEST {
        return None;
    }
    // Of the law with separation p, with both images blurred further until V₁ is at least that of the law with q.
    let left = |kernel, p: f64, q: f64| left(&samples, (r, &c.noise), around, kernel, [p, q]);
    let separations = separations(state.separation);
    let ratio = separations[1] / separations[0];
    let mut window = [0.0; MEAN + 1];
    window[MEAN] = factor * factor * mean;
    window[0] = left(&Kernel::Gaussian, 0.0, 0.0) - left(&Kernel::Pillbox, 0.0, 0.0);
    for (numbers, p) in window[1..MEAN].chunks_mut(OF_LENS).zip(separations) {
        let [p, next] = [p, p * ratio].map(|p| p / (factor * factor));
        let own = left(&Kernel::Pillbox, p, p);
        numbers[KERNEL] = left(&Kernel::Gaussian, p, p) - own;
        numbers[LAW] = left(&Kernel::Pillbox, 0.0, p) - own;
        numbers[CHAIN] = left(&Kernel::Pillbox, next, p) - left(&Kernel::Pillbox, p, next);
    }
    Some(window)
}

/// Where the stack of I2 is read for a pixel.
enum Second {
    /// I2 is on I1's pixels, but for a small shift.
    Near([f64; 2]),
    /// With parallax it is not. `d`: the pixel's displacement. `scale`: the width of I1's pixels in I2's. `parallax`: its
    /// derivative by V in I2's pixels.
    Apart { d: [f64; 2], scale: f64, parallax: [f64; 2] },
}

/// V of a pixel, and all nodes of both stacks there.
struct PixelNodes {
    v: f64,
    /// The derivative of the parallax by V, in I2's pixels.
    parallax: [f64; 2],
    /// The variance in the pixels of I2's stack of a blur of 1 px² in those of I1.
    square_scale: f64,
    count: usize,
    first: [spline::Jet; MOST_NODES],
    second: [spline::Jet; MOST_NODES],
}

impl PixelNodes {
    fn of<N: Number>(stacks: &Stacks<N>, [x, y]: [usize; 2], place: Second, v: f64) -> Self {
        let [mut first, mut second] = [[spline::Jet::default(); MOST_NODES]; 2];
        for (jet, layer) in first.iter_mut().zip(stacks.first) {
            *jet = spline::near(layer, x, y);
        }
        for (jet, layer) in second.iter_mut().zip(stacks.second) {
            *jet = match place {
                Second::Near(shift) => spline::near(layer, x, y).moved(shift),
                Second::Apart { d, .. } => spline::read(layer, x as f64 + d[0], y as f64 + d[1]),
            };
        }
        let (parallax, square_scale) = match place {
            Second::Near(_) => ([0.0; 2], 1.0),
            Second::Apart { scale, parallax, .. } => (parallax, scale * scale),
        };
        Self { v, parallax, square_scale, count: stacks.first.len(), first, second }
    }

    /// An image under a kernel of some variance, and then under a Gaussian of `more`.
    fn blurred(&self, nodes: &[spline::Jet; MOST_NODES], kernel: &Kernel, variance: f64, more: f64) -> Blurred {
        let gaussian = |v: f64| stack::between(v, self.count, |k| nodes[k].node());
        let mut blurred = gaussian(variance + more);
        if *kernel == Kernel::Pillbox {
            let k = stack::node_below(variance, self.count);
            let [v0, v1] = [k, k + 1].map(stack::node_variance);
            let value = |n: usize| gaussian(stack::node_variance(n) + more).value;
            let [d0, d1] = [k, k + 1].map(|k| stack::departure_of(k, self.count, value));
            blurred.value += d0 + ((variance - v0) / (v1 - v0)).min(1.0) * (d1 - d0);
        }
        blurred
    }
}

/// The power of white noise under a kernel of some variance and then a Gaussian of variance `more`.
fn noise_under(noise: &Noise, kernel: &Kernel, variance: f64, more: f64) -> Power {
    let Power { value, slope } = noise.blurred(variance + more, 1.0);
    let x = if *kernel == Kernel::Pillbox { variance / (variance + more + PIXEL) } else { 0.0 };
    let share = 1.0 - (FLAT - FLATTER * x * x) * x * x;
    Power { value: share * value, slope: share * slope }
}

/// The logarithm of the mean square of what the window's own V, t, offset and gain leave of S, over the power of white
/// noise in it. By the law of a lens with the separation p, or the relative one if it is 0; where the law of q blurs the
/// sharper image more, both images are blurred more by as much.
fn left(
    samples: &[PixelNodes],
    (r, noise): (&Registration, &Noise),
    around: f64,
    kernel: &Kernel,
    [p, q]: [f64; 2],
) -> f64 {
    let mut m = [[0.0; TERMS]; TERMS];
    for sample in samples {
        let of = Variances::new(sample.v, p);
        let more = (Variances::new(sample.v, q).second - of.second).max(0.0);
        let first = sample.blurred(&sample.first, kernel, of.first, more);
        let square = sample.square_scale;
        let mut second = sample.blurred(&sample.second, kernel, square * of.second, square * more);
        second.slope *= square;
        let s = first.value - (r.gain * second.value + r.offset);
        let [one, two] = of.both().map(|variance| noise_under(noise, kernel, variance, more));
        let power = one.value + two.value;
        let along = 0.5 * (one.slope * of.first_by_v + two.slope * of.second_by_v) / power;
        let displaced = second.dx * sample.parallax[0] + second.dy * sample.parallax[1];
        let by_v = of.first_by_v * first.slope - r.gain * (of.second_by_v * second.slope + displaced) - along * s;
        let terms: [f64; TERMS] = [by_v, second.dx, second.dy, 1.0, second.value - around, s];
        for i in 0..TERMS {
            (i..TERMS).for_each(|j| m[i][j] += terms[i] * terms[j] / power);
        }
    }
    let whole: [f64; TERMS] = std::array::from_fn(|i| m[i][i]);
    for p in 0..LEFT {
        // A term that depends on the others is left with rounding errors.
        if m[p][p] > 1e-5 * whole[p] {
            for i in p + 1..TERMS {
                (i..TERMS).for_each(|j| m[i][j] -= m[p][i] * m[p][j] / m[p][p]);
            }
        }
    }
    (m[LEFT][LEFT].max(0.0) / samples.len() as f64 + LEAST_SQUARE).ln()
}

#[cfg(test)]
mod tests {
    use super::super::harness::{build_stack, random, random_field, smooth_field};
    use super::super::{Field, lens, separable};
    use super::*;
    use crate::engine::filter;

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
            level: 1,
            are_gaussian: 1,
            noise: Noise::new(0),
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
        assert!(open.iter().any(|window| window[MEAN] >= 0.0));
        assert_eq!(open, masked);
    }

    /// The kernel and the separation that are found for a texture under a kernel, at V of 3 to 5 px² that is stated 5 %
    /// too large, with noise of 0.003. I1 is blurred by the variance `sharper`.
    fn found(kernel: &Kernel, sharper: f64) -> [f64; 2] {
        let (size, nodes, v) = (260, stack::node_count(20.0), 4.0);
        let texture = smooth_field(size, size, 7);
        let under = |variance: f64| {
            let mut blurred = Field::zeros(size, size);
            for [x, y] in filter::centred(kernel, variance) {
                let term = separable::filtered(&texture, [&x, &y], 1);
                blurred.data.iter_mut().zip(term.data).for_each(|(sum, t)| *sum += t);
            }
            blurred
        };
        let noisy = |mut image: Field, seed| {
            let noises = random(12 * size * size, seed);
            let normal = |n: usize| noises[12 * n..12 * n + 12].iter().sum::<f64>() - 6.0;
            image.data.iter_mut().enumerate().for_each(|(n, value)| *value += 0.003 * normal(n));
            image
        };
        let first = if sharper > 0.0 { under(sharper) } else { texture.clone() };
        let stacks = [noisy(first, 8), noisy(under(sharper + v), 9)];
        let stacks = stacks.map(|i| build_stack(&i, &Kernel::Gaussian, nodes));
        let c = Constants { factor: 1.0, ..constants([size, size], nodes) };
        let read = Stacks { first: &stacks[0], second: &stacks[1], slopes: stack::Slopes::Laplacian };
        let mut state = DoubleState::default();
        for _ in 0..2 {
            let windows = cpu_reference(&c, &state, &Field::from_fn(size, size, |_, _| 1.05 * v), &read, None);
            lens::adopt(&mut state, windows.as_flattened());
        }
        [state.kernel_shape, state.separation]
    }

    #[test]
    fn kernel_and_separation_are_found_whatever_the_blur_of_the_sharper_photograph() {
        for sharper in [0.0, 1.0, 3.0] {
            assert_eq!(found(&Kernel::Gaussian, sharper)[0], 0.0, "Gaussians");
        }
        // V1 = (V - p)²/4p.
        for sharper in [1.0, 3.0f64] {
            let v = 4.0;
            let separations = [-1.0, 1.0].map(|sign| v + 2.0 * sharper + sign * 2.0 * (sharper * (sharper + v)).sqrt());
            let [shape, separation] = found(&Kernel::Pillbox, sharper);
            println!("{sharper}: {separation:.2} of {separations:.2?}");
            // The share by which V is off goes into the separation more than once.
            let is_near = |p: f64| (separation / p).ln().abs() < 0.2;
            assert!(shape == 1.0 && separations.into_iter().any(is_near), "{separation}, not {separations:?}");
        }
        assert_eq!(found(&Kernel::Pillbox, 0.0)[0], 1.0, "a disk of one photograph");
    }
}
