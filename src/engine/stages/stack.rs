//! Blur stacks: uniformly blurred images as spline coefficients. The CPU reference of `glsl/include/stack.glsl`.
//!
//! `Î(x; V)` is the image blurred uniformly by V, read at x. Between two nodes of the stack it is a cubic in V with
//! known slopes at the nodes. For a Gaussian dÎ/dV is half the Laplacian (heat equation); for any other kernel it is a
//! layer beside each node. Kernels are centred (`src/base/kernel.rs`): the caller moves x by the kernel's mean.

use super::number::{Number, Real};
use super::segments::{SEGMENT, Segment, range};
use super::spline::{self, Jet, Raster};
use crate::base::Kernel;
use crate::engine::filter::{self, Terms};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

/// How the slopes at the nodes are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slopes {
    /// Half the Laplacian: layer k is node k.
    Laplacian,
    /// Layers 2k and 2k + 1 are node k and its slope.
    Layers,
}

impl Slopes {
    /// The slopes of a kernel's stack.
    pub fn of(kernel: &Kernel) -> Self {
        if matches!(kernel, Kernel::Gaussian | Kernel::Auto) { Self::Laplacian } else { Self::Layers }
    }

    /// Layers per node.
    pub fn layers(self) -> usize {
        match self {
            Self::Laplacian => 1,
            Self::Layers => 2,
        }
    }
}

/// The pixels on which a layer is computed, and those of its source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sampling {
    /// Every pixel, from every pixel.
    Every,
    /// Every other pixel, from every pixel.
    Halving,
    /// Every other pixel, from the layer before at the same resolution.
    Half,
}

/// How a layer other than the first is computed. A layer on every other pixel is then [subdivided](super::subdivide).
pub struct Layer {
    /// The source layer.
    pub from: usize,
    /// The pixels of the layer and of its source.
    pub sampling: Sampling,
    /// The filter, a sum of separable ones.
    pub terms: Terms,
}

/// The first node of a Gaussian's stack that is computed on every other pixel: σ 3.56 px. For white noise in [0, 1] it
/// differs from the node computed on every pixel by 5e-5 rms and at most 2.2e-4; the next node by a fifth of that.
const FIRST_HALF: usize = 6;

/// How layer n > 0 of a kernel's stack is computed: a Gaussian's from the node before it, any other from the first.
pub fn layer(kernel: &Kernel, n: usize) -> Layer {
    if Slopes::of(kernel) == Slopes::Laplacian {
        let variance = node_sigma(n).powi(2) - node_sigma(n - 1).powi(2);
        let (sampling, gaussian) = match n {
            ..FIRST_HALF => (Sampling::Every, filter::gaussian(variance)),
            FIRST_HALF => (Sampling::Halving, filter::gaussian_halving(variance)),
            _ => (Sampling::Half, filter::gaussian(variance / 4.0)),
        };
        return Layer { from: n - 1, sampling, terms: vec![[gaussian.clone(), gaussian]] };
    }
    let v = node_sigma(n / 2).powi(2);
    let terms = if n.is_multiple_of(2) { filter::centred(kernel, v) } else { filter::centred_slope(kernel, v) };
    Layer { from: 0, sampling: Sampling::Every, terms }
}

/// σ of a node in px: 0, ½, 1, 1½, then a third more from each to the next.
///
/// From σ 1½ on the error of the cubic is at most `0.012 (h/v)⁴`, 0.0045 of the contrast at the worst frequency, with h
/// the step in variance from the node at v. Equal steps of σ would waste nodes on wide blur. Steps of ¼ px instead of ½
/// changed V rms of the slanted plane by 0.0015 px² and T by 0.0001 px.
pub fn node_sigma(k: usize) -> f64 {
    if k <= 3 { 0.5 * k as f64 } else { 1.5 * (4.0f64 / 3.0).powi(k as i32 - 3) }
}

/// The departure of a disk from a Gaussian of the same variance as a sum over the nodes k - 2 to k + 2: at node 1, 2, 3,
/// 4, any later one, the last but one and the last.
///
/// A least-squares fit of the disk's transfer function `2 J1(2s)/(2s)`, s the frequency times √v, by those of the
/// nodes. Sum and variance are exact. The weight is `(|2 J1(2s)/(2s)|^½ + 0.02)/√s`: S holds the
/// product of the transfer functions of two disks, so that errors near their zeros do not count. With three nodes 35 % of the
/// difference is left. In a trial on texture and text under disks 10.3 px² apart, S over white noise was then least at 13
/// of 8, 10.3, 13 and 20 px², where V is 3 and 6 % too small; with five nodes at 10.3 of 8, 10.3, 12 and 14 px², where it
/// is 1 and 4 % too small.
const DEPARTURES: [[f64; 5]; 7] = [
    [0.0, -0.0932, 0.0895, 0.0245, -0.0208],
    [0.05, -0.5331, 0.891, -0.4994, 0.0916],
    [0.1433, -1.5272, 2.8203, -1.7229, 0.2865],
    [0.2179, -2.4981, 4.1224, -2.2063, 0.3641],
    [0.3287, -2.6290, 4.1263, -2.1839, 0.3579],
    [-0.4549, -0.0792, 0.9783, -0.4442, 0.0],
    [-1.2787, 1.998, -0.7193, 0.0, 0.0],
];

/// The departure of node k of `count` from the values of the nodes. Node 0 has none.
#[inline(always)]
pub(super) fn departure_of<R: Real>(k: usize, count: usize, node: impl Fn(usize) -> R) -> R {
    let mut departure = R::default();
    if k > 0 {
        let row = if k + 2 < count { k.min(5) - 1 } else { DEPARTURES.len() + k - count };
        for (n, &weight) in DEPARTURES[row].iter().enumerate().filter(|(_, weight)| **weight != 0.0) {
            departure += R::of(weight) * node(k + n - 2);
        }
    }
    departure
}

/// The most nodes of a stack.
pub(super) const MOST_NODES: usize = 24;
/// Variances of the nodes, px²: as [`node_sigma`], up to σ 470 px.
static NODES: [f64; MOST_NODES] = {
    let (mut nodes, mut k, mut sigma) = ([0.0; MOST_NODES], 0, 0.0);
    while k < nodes.len() {
        nodes[k] = sigma * sigma;
        sigma = if k < 3 { sigma + 0.5 } else { sigma * 4.0 / 3.0 };
        k += 1;
    }
    nodes
};

/// The variance of a node, px².
pub(super) fn node_variance(k: usize) -> f64 {
    NODES[k]
}

/// The number of nodes that reach a variance in px².
pub fn node_count(limit: f64) -> usize {
    let mut count = 2;
    while node_sigma(count - 1).powi(2) < limit {
        count += 1;
    }
    count
}

/// The last node whose variance is at most v, but not the last of all.
#[inline(always)]
pub(super) fn node_below(v: f64, count: usize) -> usize {
    NODES[1..count - 1].iter().take_while(|&&node| node <= v).count()
}

/// The largest magnitude of a packed coefficient, in whites. A white pixel on black has 3, a black one on white -2, and
/// a step at most 1.4. Larger ones have contrasts of both signs from pixel to pixel along both axes, which lenses do
/// not show; they are clamped.
const FIXED_MOST: f64 = shaders::stacks::FIXED_MOST;
/// The steps of the root of a packed coefficient from zero to there.
const FIXED_STEPS: f64 = shaders::stacks::FIXED_STEPS;

/// A variant for packed stacks, if they are.
pub(crate) fn packed(variant: Variant, is_packed: bool) -> Variant {
    variant | Variant::PACKED.when(is_packed)
}

/// Whether a variant is for packed stacks.
pub(crate) fn is_packed(variant: Variant) -> bool {
    variant.has(Variant::PACKED)
}

/// Bytes per pixel of layers of `count` stacks.
pub(crate) fn bytes(count: u32, is_packed: bool) -> u64 {
    if is_packed { 4 } else { 4 * u64::from(count) }
}

/// The unit of the coefficients of packed stacks: the largest intensity of both photographs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct White(f64);

impl White {
    /// The unit for photographs with this largest intensity; `None` if the variant does not pack its stacks.
    pub(crate) fn of(variant: Variant, largest: f64) -> Option<Self> {
        is_packed(variant).then_some(Self(largest.max(shaders::stacks::LEAST_WHITE)))
    }

    /// The root of a coefficient, in steps.
    pub(crate) fn root(self, coefficient: f64) -> i16 {
        let root = (coefficient.abs() / self.0 / FIXED_MOST).sqrt().min(1.0);
        (FIXED_STEPS * root).round().copysign(coefficient) as i16
    }

    /// The coefficient of a root in steps.
    pub(crate) fn coefficient(self, root: i16) -> f64 {
        let root = f64::from(root) / FIXED_STEPS;
        self.0 * FIXED_MOST * root * root.abs()
    }
}

/// Coefficients as the stacks store them: rounded if they are packed.
pub(crate) fn stored<N: Number>(mut layer: Raster<N>, white: Option<White>) -> Raster<N> {
    if let Some(white) = white {
        layer.data.iter_mut().for_each(|c| *c = N::of(white.coefficient(white.root((*c).into()))));
    }
    layer
}

/// An image blurred by one variance, at one place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Blurred<R = f64> {
    /// Value.
    pub value: R,
    /// Derivative by the variance.
    pub slope: R,
    /// Derivative to the right.
    pub dx: R,
    /// Derivative downwards.
    pub dy: R,
}

/// A node at (x, y), and its slope by the variance.
pub fn node<N: Number>(stack: &[Raster<N>], slopes: Slopes, k: usize, x: f64, y: f64) -> (Jet, f64) {
    let jet = spline::read(&stack[k * slopes.layers()], x, y);
    let slope = match slopes {
        Slopes::Laplacian => jet.laplacian / 2.0,
        Slopes::Layers => spline::read(&stack[2 * k + 1], x, y).value,
    };
    (jet, slope)
}

/// The blur stack at variance v in px² and place (x, y).
pub fn read<N: Number>(stack: &[Raster<N>], slopes: Slopes, v: f64, x: f64, y: f64) -> Blurred {
    between(v, stack.len() / slopes.layers(), |k| node(stack, slopes, k, x, y))
}

/// A Gaussian's blur stack at pixel (x, y).
pub fn read_near<N: Number>(stack: &[Raster<N>], v: f64, [x, y]: [usize; 2]) -> Blurred {
    between(v, stack.len(), |k| spline::near(&stack[k], x, y).node())
}

/// Cubic Hermite interpolation between the two nodes around v >= 0.
#[inline(always)]
pub(super) fn between(v: f64, count: usize, node: impl Fn(usize) -> (Jet, f64)) -> Blurred {
    let k = node_below(v, count);
    between_nodes(v, k, node(k), node(k + 1))
}

/// The pixels of a segment of a blurred image, or of a node of its stack: value, slope by the variance, derivatives
/// along x and y.
pub(super) type BlurredSegment<N> = [Segment<N>; 4];

/// The blur stack at the variances of a segment of pixels. `node` sets a node of the stack: from the first to the one
/// after the last that is needed, each once, in order.
#[inline(always)]
pub(super) fn between_segment<N: Number>(
    v: &Segment<N>,
    count: usize,
    mut node: impl FnMut(usize, &mut BlurredSegment<N>),
) -> BlurredSegment<N> {
    let [first, last] = range(v).map(|v| node_below(v, count));
    let [mut lower, mut upper, mut blurred] = [[[N::default(); SEGMENT]; 4]; 3];
    node(first, &mut lower);
    for k in first..=last {
        node(k + 1, &mut upper);
        // Pixels beyond the next node are overwritten.
        let start = if k == first { N::default() } else { N::of(NODES[k]) };
        for n in 0..SEGMENT {
            let (p, q) = (at(&lower, n), at(&upper, n));
            let here = between_nodes(v[n], k, (p, lower[1][n]), (q, upper[1][n]));
            let numbers = [here.value, here.slope, here.dx, here.dy];
            for part in 0..4 {
                blurred[part][n] = (v[n] - start).choose(numbers[part], blurred[part][n]);
            }
        }
        std::mem::swap(&mut lower, &mut upper);
    }
    blurred
}

/// Sets a node of a Gaussian's stack at the pixels of the segment from (x, y) to the right, moved by small shifts.
#[inline(always)]
pub(super) fn node_segment<N: Number>(
    node: &Raster<N>,
    at: [usize; 2],
    shift: [&Segment<N>; 2],
    [value, slope, dx, dy]: &mut BlurredSegment<N>,
) {
    spline::near_segment(
        node,
        at,
        #[inline(always)]
        |n, jet| {
            let (jet, by_v) = jet.moved([shift[0][n], shift[1][n]]).node();
            (value[n], slope[n], dx[n], dy[n]) = (jet.value, by_v, jet.dx, jet.dy);
        },
    );
}

/// A pixel of a node.
#[inline(always)]
fn at<N: Number>([value, _, dx, dy]: &BlurredSegment<N>, n: usize) -> Jet<N> {
    Jet { value: value[n], dx: dx[n], dy: dy[n], laplacian: N::default() }
}

/// The interpolation from node k to the next.
#[inline(always)]
fn between_nodes<R: Real>(v: R, k: usize, (p, m): (Jet<R>, R), (q, n): (Jet<R>, R)) -> Blurred<R> {
    let (v0, h) = (R::of(NODES[k]), R::of(NODES[k + 1] - NODES[k]));
    let [one, two, three, four, six] = R::all([1.0, 2.0, 3.0, 4.0, 6.0]);
    // Beyond the last node the value is constant.
    let (whole, m, n) = ((v - v0) / h, h * m, h * n);
    let t = whole.min(one);
    let (t2, t3) = (t * t, t * t * t);
    let rise = q.value - p.value;
    let slope = six * (t - t2) * rise + (three * t2 - four * t + one) * m + (three * t2 - two * t) * n;
    Blurred {
        value: p.value + (three * t2 - two * t3) * rise + (t3 - two * t2 + t) * m + (t3 - t2) * n,
        slope: (one - whole).choose(slope / h, R::default()),
        dx: p.dx + t * (q.dx - p.dx),
        dy: p.dy + t * (q.dy - p.dy),
    }
}

#[cfg(test)]
mod tests {
    use super::super::Field;
    use super::super::harness::random_field;
    use super::*;
    use crate::engine::stages::harness::build_stack;
    use crate::engine::stages::separable;

    #[test]
    fn blurred_images_obey_the_heat_equation() {
        // The wave exp(-v k²/2) cos(k x): value and slope between the nodes are compared with the closed form. Waves
        // are even about the border, so that mirroring is exact.
        let (n, k) = (129, std::f64::consts::PI * 20.0 / 128.0);
        let wave = Field::from_fn(n, 9, |x, _| (k * x as f64).cos());
        let stack = build_stack(&wave, &Kernel::Gaussian, node_count(36.0));
        for step in 0..=360 {
            let v = 0.1 * f64::from(step);
            let decay = (-v * k * k / 2.0).exp();
            for x in [3.0, 40.37, 101.5] {
                let actual = read(&stack, Slopes::Laplacian, v, x, 4.0);
                let expected = decay * (k * x).cos();
                // 2e-3 of the contrast, between the two widest nodes; see `node_sigma`.
                assert!((actual.value - expected).abs() < 2e-3, "v {v}: {} {expected}", actual.value);
                let slope = -k * k / 2.0 * expected;
                assert!((actual.slope - slope).abs() < 4e-3, "v {v}: slope {} {slope}", actual.slope);
            }
        }
    }

    /// The root is off by 1/√12 of a step rms. So c is off by √(white c)/32767, since `FIXED_MOST` is 3.
    #[test]
    fn packing_errs_by_a_hundredth_of_photon_noise_at_any_brightness() {
        let (largest, electrons) = (0.7, 1e5);
        let white = White::of(Variant::PACKED, largest).unwrap();
        for brightness in [2.0, 1.0, 0.1, 0.01, 1e-4] {
            let c = |n: i32| (if n % 2 == 0 { 1.0 } else { -1.0 }) * brightness * largest * (1.0 + 1e-4 * f64::from(n));
            let square = |n| (white.coefficient(white.root(c(n))) - c(n)).powi(2);
            let error = ((-1000..1000).map(square).sum::<f64>() / 2000.0).sqrt();
            let closed = largest * f64::sqrt(brightness) / FIXED_STEPS;
            assert!((error / closed - 1.0).abs() < 0.05, "{brightness}: {error:e}, not {closed:e}");
            let photon_noise = largest * (brightness / electrons).sqrt();
            assert!(error < 0.0102 * photon_noise, "{brightness}: {}", error / photon_noise);
        }
        assert_eq!([4.0, -4.0].map(|c| white.root(c)), [32767, -32767], "larger ones are clamped");
        assert_eq!(White::of(Variant::PACKED, 0.0).unwrap().root(0.0), 0, "black photographs");
    }

    #[test]
    fn nodes_computed_on_every_other_pixel_match_those_on_every_pixel() {
        for (width, height) in [(90, 71), (77, 64)] {
            let texture = random_field(width, height, 4);
            let stack = build_stack(&texture, &Kernel::Gaussian, node_count(150.0));
            for (n, layer) in stack.iter().enumerate().skip(FIRST_HALF) {
                let from = FIRST_HALF - 1;
                let filter = filter::gaussian(node_sigma(n).powi(2) - node_sigma(from).powi(2));
                let direct = separable::filtered(&stack[from], [&filter; 2], 1);
                let apart: Vec<f64> = layer.data.iter().zip(&direct.data).map(|(a, b)| (a - b).abs()).collect();
                let rms = (apart.iter().map(|a| a * a).sum::<f64>() / apart.len() as f64).sqrt();
                let most = apart.into_iter().fold(0.0, f64::max);
                println!("{width}x{height}, node {n}: rms {rms:.1e}, at most {most:.1e}");
                assert!(rms < 1e-4 && most < 3e-4, "{width}x{height}, node {n}: {rms} {most}");
            }
        }
    }
}
