//! Computes D and b of each pixel's equation for dV, and the registration integrals.
//!
//! [`system`](super::system) makes the linear system of D and b. Equations 22 to 32 and 23 of the paper, sections 3 to 5 of `docs/method.md`:
//!
//! ```text
//! S1 = G(V) * I1 - J,  S2 = G(-V) * J - I1,  w1 = H ψ'(S1²),  w2 = (1-H) ψ'(S2²)
//! Î1v less S1 n1'/2n1, Î2v less S2 n2'/2n2: without the part of noise (noise.rs)
//! D = w1 Î1v² + w2 Î2v²,  b = -(w1 S1 Î1v + w2 S2 Î2v),  a_n = α (φ + φ_n)/2
//! r = b + Σ a_n (V_n - V)
//! N = Σ w j jᵀ - q qᵀ/(D + λ Σa),  g = Σ w j S + q r/(D + λ Σa),  q = w1 Î1v j1 + w2 Î2v j2,  j = ∂S/∂ζ
//! ```
//!
//! The terms in q eliminate each pixel's dV from the registration step (Schur complement), so that T steps as if V had
//! already responded. A neighbourhood moves together and is held less by the smoothness than a single pixel: λ = 0.25
//! accounts for that. On the slanted plane with 15 iterations per level, V rms was 0.032 px² without elimination, 0.026
//! with λ = 1 and 0.007 with 0.1; but with 0.1, black and white dots under a half-Gaussian do not settle.

use super::blur::{NEAR, PairSample, Stacks, heaviside, sample_pair};
use super::lanes::{LANES, Lanes, vectorised};
use super::links::{self, LinkRow, Links};
use super::mask::{self, Masks};
use super::near_line::NearLine;
use super::noise::{self, Noise, Power};
use super::pass::{Memory, Pass, bindings, push_constants};
use super::rows::{self, Rows};
use super::stack::Slopes;
use super::state::{Registration, inside};
use super::sums::{Layout, Line};
use super::{Number, Raster, Real, WORKGROUP, pixels};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

/// The most lines of two pixels per invocation. Values that adjacent lines share are loaded once, and the sums of a
/// workgroup are reduced once for all lines.
const MOST_ROWS: u32 = 8;
/// Levels with fewer pixels use more workgroups, so that small levels do not leave most of a device idle.
const SPREAD: u64 = 1 << 15;

/// Lines per invocation on a level.
pub(crate) fn rows([width, height]: [u32; 2]) -> u32 {
    if pixels(width, height) < SPREAD { MOST_ROWS / 4 } else { MOST_ROWS }
}

/// Layers of the equations: D, b.
pub const LAYERS: u32 = 2;
/// In T's step, residuals within this many spreads (σ of noise) count by their squares: with Gaussian noise least
/// squares are best. V, which depends on few pixels at each place, keeps η.
pub const BROAD: f64 = shaders::linearise::BROAD;
/// The spread s is an M-estimate of scale of x = ΔS/√2 between adjacent pixels. Such differences show the noise, and
/// little of the model's errors; half of them may be outliers. The mean of x²/(x² + `BOUND`² s²) is a half, as for
/// Gaussian x of deviation s.
pub const BOUND: f64 = shaders::linearise::BOUND;
/// λ.
pub const ELIMINATION: f32 = 0.25;

push_constants! {
    /// Width of the level, pixels.
    width: u32,
    /// Height of the level, pixels.
    height: u32,
    /// Nodes of the stacks.
    nodes: u32,
    /// First layer of the stack of I2.
    second_stack: u32,
    /// Lines per invocation.
    rows: u32,
    /// Pixels of the full-size image per pixel of this level.
    factor: f32,
    /// The image centre in pixels of this level.
    centre: [f32; 2],
    /// L, the length that places are divided by: a quarter of the diagonal, pixels.
    length: f32,
    /// Factor by which α is larger than its final value.
    continuation: f32,
    /// η of the data term, intensities.
    eta: f32,
    /// η of the smoothness term, px² per pixel.
    smoothness_eta: f32,
    /// ε of the Heaviside, px².
    epsilon: f32,
    /// λ; [`ELIMINATION`].
    elimination: f32,
    /// Mean of the kernel at V = 1, px.
    mean: [f32; 2],
    /// Noise of either image.
    noise: Noise,
}

/// Workgroups over a level.
pub(crate) fn tiles([width, height]: [u32; 2]) -> [u32; 3] {
    [width.div_ceil(2 * WORKGROUP[0]), height.div_ceil(WORKGROUP[1] * rows([width, height])), 1]
}

/// The variant for a kernel, for a warped I2, for masked pixels, and for the sums of homographies.
pub(crate) fn variant(slopes: Slopes, warped: bool, masked: bool, projective: bool) -> Variant {
    [slopes == Slopes::Layers, warped, masked, projective]
}

bindings! {
    LINEARISE:
    /// I1.
    i1: Reads<I1>,
    /// V.
    v: Reads<RelativeBlur>,
    /// Stacks of I1 and I2.
    stacks: Reads<Stacks>,
    /// D, b.
    equations: Writes<Plane>,
    /// State.
    state: Reads<State>,
    /// A row of sums for each workgroup.
    partials: Writes<Partials>,
    /// Masks of I1 and I2.
    masks: Reads<Masks>,
}

impl Pass for Bindings {
    /// Compulsory traffic: I1, V, the two nodes of the stacks about V and the other image, read once per pixel; D, b
    /// and a row of sums per workgroup written.
    fn bytes(c: &Constants, variant: Variant) -> u64 {
        let slopes = if variant[0] { Slopes::Layers } else { Slopes::Laplacian };
        let layers = 3 * slopes.layers() as u64;
        (8 + 4 * layers + 8) * pixels(c.width, c.height) + row_bytes([c.width, c.height], Layout::of_variant(variant))
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let state = memory.state(self.state);
        let stacks = Stacks::of(memory.layers(self.stacks), c.second_stack, c.nodes, variant[0]);
        let warped = variant[1].then_some(&state.warped);
        let masks = mask::of(memory, self.masks, variant);
        let [i1, v] = [memory.layer(self.i1, 0), memory.layer(self.v, 0)];
        let layout = Layout::of_variant(variant);
        let Linearised { equations, partials } =
            cpu_reference(c, layout, (&state.registration, state.alpha, state.spread), warped, [i1, v], &stacks, masks);
        equations.into_iter().enumerate().for_each(|(n, field)| memory.set_layer(self.equations, n, field));
        memory.set_numbers(self.partials, &partials);
    }
}

/// Bytes of a level's partial sums.
pub(crate) fn row_bytes(size: [u32; 2], layout: Layout) -> u64 {
    let [columns, rows, _] = tiles(size);
    4 * layout.length as u64 * pixels(columns, rows)
}

/// The results of the pass.
pub struct Linearised<N> {
    /// D, b.
    pub equations: [Raster<N>; LAYERS as usize],
    /// A row of partial sums for each tile.
    pub partials: Vec<f64>,
}

/// A residual: S, its derivative by V, its weight, and its derivatives by T's displacement in I1's pixels.
#[derive(Clone, Copy)]
struct Residual<R> {
    s: R,
    by_v: R,
    weight: R,
    by_place: [R; 2],
}

/// One pass over a level, with T, α and the spread of the previous iteration. `warped` is T when I2 was warped onto
/// I1's pixels, if it was.
pub fn cpu_reference<N: Number>(
    c: &Constants,
    layout: Layout,
    (r, alpha, spread): (&Registration, f64, f64),
    warped: Option<&Registration>,
    [i1, v]: [&Raster<N>; 2],
    stacks: &Stacks<N>,
    masks: Option<&Masks<N>>,
) -> Linearised<N> {
    let size @ [width, height] = [v.width, v.height];
    let moved = warped.map(|before| r.moved_since(before));
    let [eta, continuation] = [c.smoothness_eta, c.continuation].map(f64::from);
    let links = Links::new(v, [continuation * alpha, 1.0, eta], false);
    let (scale, centre, spread) = (r.scale(), c.centre.map(f64::from), least_spread(c, spread));
    let [columns, ..] = tiles([c.width, c.height]);
    let [block, lines] = [2 * WORKGROUP[0], WORKGROUP[1] * c.rows].map(|side| side as usize);
    let mut equations = [(); LAYERS as usize].map(|()| Raster::zeros(width, height));
    let rasters = equations.each_mut().map(|raster| Rows::from(raster).joined(lines));
    let partials = rows::map(rasters, |row, [diagonals, sides]| {
        let mut partials = vec![0.0; columns as usize * layout.length];
        // Finite from the start: places without a pixel have no weight.
        let (mut near, mut pixels) = (NearLine::default(), [(); PARTS].map(|()| vec![N::of(1.0); block]));
        let [mut across, mut down, mut above] = [(); 3].map(|()| LinkRow::default());
        links.downwards((row * lines) as isize - 1, &mut above);
        for y in row * lines..height.min((row + 1) * lines) {
            links.across(y, &mut across);
            links.downwards(y as isize, &mut down);
            for (tile, partials) in partials.chunks_exact_mut(layout.length).enumerate() {
                let xs = tile * block..width.min((tile + 1) * block);
                if moved.is_some() {
                    near.load(stacks, v, y, xs.clone());
                }
                let (values, phi) = (v.row(y), links.phi().row(y));
                let count = xs.len();
                let [.., smoothness, pulls, phis, places] = &mut pixels;
                links::sums([&across, &down, &above], xs.start, [&mut smoothness[..count], &mut pulls[..count]]);
                phis[..count].copy_from_slice(&phi[xs.clone()]);
                for (place, x) in places.iter_mut().zip(xs.clone()) {
                    *place = N::of((x as f64 - centre[0]) / f64::from(c.length));
                }
                for (n, x) in xs.clone().enumerate() {
                    let (d, own) = (r.displacement(x, y, c.factor.into(), centre), values[x]);
                    if !inside([x, y], d, size, own.into(), scale) {
                        pixels[SHARE][n] = N::default();
                        continue;
                    }
                    pixels[SHARE][n] = N::of(mask::counts(masks, [x, y], d));
                    let PairSample { i1, i2, blurred: [b1, b2] } = match &moved {
                        Some(moved) => near.sample(x, own, moved.displacement(x, y, c.factor.into(), centre)),
                        None => {
                            sample_pair((c.mean, c.factor, c.centre), r, None, [x, y], i1, own.into(), stacks).rounded()
                        }
                    };
                    let numbers = [i1, i2.value, i2.dx, i2.dy, b1.value, b1.slope, b2.value, b2.slope, b2.dx, b2.dy];
                    (pixels[V][n], pixels[BETWEEN][n]) = (own, N::of(noise::interpolated(d)));
                    pixels[FIRST..].iter_mut().zip(numbers).for_each(|(part, number)| part[n] = number);
                }
                // Lanes beyond the last pixel have no weight.
                pixels[SHARE][count..].fill(N::default());
                let level = Level { c, gain: r.gain, offset: r.offset, alpha, spread };
                let line = vectorised(
                    #[inline(always)]
                    || level.line(&mut pixels, count),
                );
                line.add_to(partials, (y as f64 - centre[1]) / f64::from(c.length), layout);
                let first = (y - row * lines) * width + xs.start;
                diagonals[first..first + count].copy_from_slice(&pixels[DIAGONAL][..count]);
                sides[first..first + count].copy_from_slice(&pixels[SIDE][..count]);
            }
            std::mem::swap(&mut above, &mut down);
        }
        partials
    });
    Linearised { equations, partials: partials.concat() }
}

/// The numbers of each pixel of a line, in the order in which they are gathered: V, share, noise of I2 between pixels,
/// I1, I2 and its gradient, Î1 and its slope, Î2, its slope and its gradient, Σa, Σ a (V_n - V), φ, X.
const PARTS: usize = 17;
const V: usize = 0;
const SHARE: usize = 1;
const BETWEEN: usize = 2;
/// I1, the first of the samples.
const FIRST: usize = 3;
/// Σa, the first of the parts that do not depend on the photographs.
const LINKS: usize = 13;
/// The places of D, b and the signed residual, which overwrite V, the noise and I1.
const DIAGONAL: usize = V;
const SIDE: usize = BETWEEN;
const SIGNED: usize = FIRST;

/// What all pixels of a level share.
struct Level<'a> {
    c: &'a Constants,
    gain: f64,
    offset: f64,
    alpha: f64,
    spread: f64,
}

impl Level<'_> {
    /// The sums of `count` pixels of a line. Writes D, b and the signed residual.
    #[inline(always)]
    fn line<N: Number>(&self, pixels: &mut [Vec<N>; PARTS], count: usize) -> Line {
        let (c, of) = (self.c, |value: f64| Lanes::<N>::of(value));
        let [elimination, eta2] = [c.elimination.into(), f64::from(c.smoothness_eta).powi(2)].map(of);
        let alpha = of(self.alpha);
        let (mut normal, mut gradient) = ([[Lanes::default(); 5]; 3], [[Lanes::default(); 3]; 2]);
        let (mut energy, mut valid, mut roughness, mut variance) = (of(0.0), of(0.0), [of(0.0); 2], [of(0.0); 2]);
        for place in (0..count).step_by(LANES) {
            let at = |part: usize| Lanes::load(&pixels[part], place);
            let share = at(SHARE);
            let [smoothness, pull, phi, x] = [0, 1, 2, 3].map(|n| at(LINKS + n));
            let (mut residuals, psi, signed) = self.data_term(std::array::from_fn(at));
            residuals.iter_mut().for_each(|t| t.weight = t.weight * share);
            let [one, two] = residuals;
            let diagonal = one.weight * one.by_v * one.by_v + two.weight * two.by_v * two.by_v;
            let b = -(one.weight * one.s * one.by_v + two.weight * two.s * two.by_v);
            let over = of(1.0) / (diagonal + elimination * smoothness).max(of(1e-12));
            let (n, g) = self.registration(&residuals, (b + pull) * over, over, self.broadened(psi));
            let x2 = x * x;
            let powers = [of(1.0), x, x2, x2 * x, x2 * x2];
            for (k, power) in powers.into_iter().enumerate() {
                (0..3).for_each(|i| normal[i][k] += n[i] * power);
                if k < 3 {
                    (0..2).for_each(|i| gradient[i][k] += g[i] * power);
                }
            }
            let steepness = of(1.0) / phi;
            energy += share * (psi + alpha * steepness);
            valid += share;
            variance[0] += b * b;
            variance[1] += diagonal;
            roughness[0] += share * b.abs().sqrt();
            roughness[1] += share * (steepness * steepness - eta2).max(of(0.0)).sqrt();
            for (part, lanes) in [(DIAGONAL, diagonal), (SIDE, b), (SIGNED, signed)] {
                lanes.store(&mut pixels[part], place);
            }
        }
        // The first of two adjacent pixels is in an even column: tiles are even.
        let (signed, shares) = (pixels[SIGNED][..count].as_chunks::<2>().0, pixels[SHARE][..count].as_chunks::<2>().0);
        let pair = |(s, share): (&[N; 2], &[N; 2])| -> f64 {
            let least: f64 = share[0].min(share[1]).into();
            if least > 0.0 { least * spreads(self.spread, (s[1] - s[0]).into()) } else { 0.0 }
        };
        Line {
            normal: normal.map(|sums| sums.map(Lanes::sum)),
            gradient: gradient.map(|sums| sums.map(Lanes::sum)),
            energy: energy.sum(),
            valid: valid.sum(),
            roughness: roughness.map(Lanes::sum),
            spread: signed.iter().zip(shares).map(pair).sum(),
            variance: variance.map(Lanes::sum),
        }
    }

    /// S1 and S2 at a pixel, the energy of the data term, and the signed residual H S1 - (1 - H) S2.
    #[inline(always)]
    fn data_term<R: Real>(&self, pixel: [R; LINKS]) -> ([Residual<R>; 2], R, R) {
        let [v, _, between, i1, i2, dx, dy, b1, slope1, b2, slope2, dx2, dy2] = pixel;
        let [gain, offset, eta, one] = [self.gain, self.offset, self.c.eta.into(), 1.0].map(R::of);
        let (s1, s2) = (b1 - (gain * i2 + offset), gain * b2 + offset - i1);
        let (psi1, psi2) = ((s1 * s1 + eta * eta).sqrt(), (s2 * s2 + eta * eta).sqrt());
        let h = heaviside(v, self.c.epsilon.into());
        let [along1, along2] = self.noise_slopes(v, between);
        let residuals = [
            Residual { s: s1, by_v: slope1 - along1 * s1, weight: h / psi1, by_place: [-gain * dx, -gain * dy] },
            Residual {
                s: s2,
                by_v: gain * slope2 - along2 * s2,
                weight: (one - h) / psi2,
                by_place: [gain * dx2, gain * dy2],
            },
        ];
        (residuals, h * psi1 + (one - h) * psi2, h * s1 - (one - h) * s2)
    }

    /// Half the derivative by V of the logarithm of the noise of both images in S1² and S2². `between` is the noise of
    /// I2 between pixels.
    #[inline(always)]
    fn noise_slopes<R: Real>(&self, v: R, between: R) -> [R; 2] {
        let (one, square, noise) = (R::of(1.0), R::of(self.gain * self.gain), &self.c.noise);
        let blurred = noise.blurred(v.abs(), v.choose(one, between));
        let beyond = noise.beyond(v.abs(), v.choose(between, one), R::of(NEAR));
        let pick = |of: fn(Power<R>) -> R| {
            let [blurred, beyond] = [blurred, beyond].map(of);
            [v.choose(blurred, beyond), v.choose(beyond, blurred)]
        };
        let ([n1, n2], [by1, by2]) = (pick(|power| power.value), pick(|power| power.slope));
        let sign = v.choose(R::of(0.5), R::of(-0.5));
        [sign * by1 / (n1 + square * between), sign * square * by2 / (square * n2 + one)]
    }

    /// The factor on a pixel's weight in T's step that broadens η to [`BROAD`] spreads.
    #[inline(always)]
    fn broadened<R: Real>(&self, psi: R) -> R {
        psi / (psi * psi + R::of((BROAD * self.spread).powi(2) - f64::from(self.c.eta).powi(2))).sqrt()
    }

    /// A pixel's part of N (xx, xy, yy) and g, with its dV eliminated, times `ratio`.
    #[inline(always)]
    fn registration<R: Real>(&self, residuals: &[Residual<R>; 2], side: R, over: R, ratio: R) -> ([R; 3], [R; 2]) {
        let [one, two] = residuals;
        let sum = |of: &dyn Fn(&Residual<R>) -> R| one.weight * of(one) + two.weight * of(two);
        let q = [0, 1].map(|i| sum(&|t| t.by_v * t.by_place[i]));
        let g = [0, 1].map(|i| ratio * (sum(&|t| t.s * t.by_place[i]) + q[i] * side));
        let n = [[0, 0], [0, 1], [1, 1]]
            .map(|[i, j]| ratio * (sum(&|t| t.by_place[i] * t.by_place[j]) - q[i] * q[j] * over));
        (n, g)
    }
}

/// The spread of the previous iteration, at least that of η.
fn least_spread(c: &Constants, spread: f64) -> f64 {
    spread.max(f64::from(c.eta) / BROAD)
}

/// The contribution of two adjacent pixels to the spread: a bounded square, whose mean is a half where the spread is
/// right.
#[inline(always)]
fn spreads(spread: f64, difference: f64) -> f64 {
    let square = 0.5 * difference * difference;
    2.0 * square / (square + (BOUND * spread).powi(2))
}

#[cfg(test)]
mod tests {
    use super::super::Field;
    use super::super::harness::{Rig, random_field};
    use super::super::stack::{self, Slopes};
    use super::super::state::State;
    use super::super::sums::{Sums, assert_close};
    use super::*;
    use crate::base::{Aperture, Homography, Kernel, Photometric, Similarity};
    use crate::engine::stages::harness::build_stack;
    use crate::engine::vulkan::Resource;

    fn constants(width: usize, height: usize, nodes: usize, kernel: &Kernel) -> Constants {
        Constants {
            width: width as u32,
            height: height as u32,
            nodes: nodes as u32,
            second_stack: (nodes * Slopes::of(kernel).layers()) as u32,
            rows: MOST_ROWS,
            factor: 2.0,
            centre: [(width as f32 - 1.0) / 2.0, (height as f32 - 0.5) / 2.0],
            length: 20.0,
            continuation: 2.0,
            eta: 0.01,
            smoothness_eta: 0.1,
            epsilon: 0.1,
            elimination: ELIMINATION,
            mean: kernel.mean().map(|m| m as f32),
            noise: Noise::new(1),
        }
    }

    /// Compares with the CPU reference. `moved` is how T has moved since I2 was warped, if it was.
    fn check(i1: &Field, i2: &Field, v: &Field, transform: Similarity, kernel: &Kernel, moved: Option<Similarity>) {
        let masks = [7, 8].map(|seed| mask::shares(v.width, v.height, seed));
        let (transform, moved) = (transform.into(), moved.map(Homography::from));
        for (rows, projective) in [(2, false), (MOST_ROWS, true)] {
            check_rows((rows, projective), [i1, i2, v], transform, kernel, moved, None);
            check_rows((rows, projective), [i1, i2, v], transform, kernel, moved, Some(&masks));
        }
    }

    fn check_rows(
        (rows, projective): (u32, bool),
        [i1, i2, v]: [&Field; 3],
        transform: Homography,
        kernel: &Kernel,
        moved: Option<Homography>,
        masks: Option<&Masks>,
    ) {
        let ((width, height), layout) = ((v.width, v.height), Layout::of(projective));
        let nodes = stack::node_count(6.0);
        let slopes = Slopes::of(kernel);
        let stacks = [i1, i2].map(|i| build_stack(i, kernel, nodes));
        let c = Constants { rows, ..constants(width, height, nodes, kernel) };
        let registration = Registration::new(transform, &Photometric { gain: 1.1, offset: -0.03 });
        let mut state = State { spread: 0.01, ..State::new(&registration) };
        let before = moved.map(|by| Registration::new(by.after(&transform), &registration.photometric()));
        if let Some(before) = &before {
            state.warped = before.into();
        }
        let warped = Registration::from(state.warped);
        let read = Stacks { first: &stacks[0], second: &stacks[1], slopes };
        let expected = cpu_reference(
            &c,
            layout,
            (&state.registration(), state.alpha.into(), state.spread.into()),
            moved.map(|_| &warped),
            [i1, v],
            &read,
            masks,
        );

        let rig = Rig::new();
        let inputs = [rig.field(i1), rig.field(v), rig.image(&stacks.concat())];
        let equations = rig.empty([c.width, c.height], LAYERS as usize);
        let state = rig.upload(bytemuck::bytes_of(&state));
        let none = [Field::zeros(width, height), Field::zeros(width, height)];
        let (masked, masks) = (masks.is_some(), rig.image(masks.unwrap_or(&none)));
        let groups = [c.width.div_ceil(2 * WORKGROUP[0]), c.height.div_ceil(WORKGROUP[1] * rows), 1];
        let partials = rig.upload(&vec![0; 4 * layout.length * (groups[0] * groups[1]) as usize]);
        let mut resources: Vec<_> = inputs.iter().chain([&equations]).map(Resource::Image).collect();
        resources.extend([Resource::Buffer(&state), Resource::Buffer(&partials), Resource::Image(&masks)]);
        rig.run_variant(&STAGE, variant(slopes, moved.is_some(), masked, projective), &resources, &c, groups);

        // Single precision, relative to the largest.
        let most = expected.equations.iter().flat_map(|f| &f.data).fold(1.0, |most: f64, v| most.max(v.abs()));
        rig.assert_close(&equations, &expected.equations, 1e-4 * most);
        let actual = Sums::from_partials(&rig.floats(&partials), layout);
        assert_close(&actual, &Sums::from_partials(&expected.partials, layout), layout, 1e-4);
    }

    #[test]
    fn matches_the_cpu_reference() {
        for (width, height) in [(67usize, 43usize), (33, 32), (40, 17)] {
            let smooth = |seed| super::super::harness::smooth_field(width, height, seed);
            let mut v = smooth(3);
            v.data.iter_mut().for_each(|v| *v = 8.0 * (*v - 0.5));
            let aperture = Aperture::new("code", 3, 2, &[1.0, 0.0, 2.0, 0.0, 1.0, 1.0]).unwrap();
            for kernel in [Kernel::Gaussian, Kernel::HalfGaussian, Kernel::Measured(aperture)] {
                check(&smooth(1), &smooth(2), &v, Similarity::new(0.7, -1.1, 0.4, 1.02), &kernel, None);
                check(
                    &random_field(width, height, 5),
                    &random_field(width, height, 6),
                    &v,
                    Similarity::new(0.0, 0.0, 3.0, 0.97),
                    &kernel,
                    None,
                );
            }
            let moved = Some(Similarity::new(0.02, -0.03, 0.01, 1.001));
            check(&smooth(1), &smooth(2), &v, Similarity::new(0.7, -1.1, 0.4, 1.02), &Kernel::Gaussian, moved);
            let steep = Homography::from_matrix([[1.02, 0.01, 0.7], [-0.02, 0.99, -1.1], [1e-4, -2e-4, 1.0]]).unwrap();
            for (kernel, moved) in [(Kernel::HalfGaussian, None), (Kernel::Gaussian, moved.map(Homography::from))] {
                check_rows((2, true), [&smooth(1), &smooth(2), &v], steep, &kernel, moved, None);
            }
        }
    }

    #[test]
    fn flat_images_give_numbers_and_no_overlap_gives_no_weight() {
        let (width, height) = (35, 20);
        let flat = Field::from_fn(width, height, |_, _| 0.5);
        check(&flat, &flat, &Field::zeros(width, height), Similarity::IDENTITY, &Kernel::Gaussian, None);
        check(&flat, &flat, &Field::zeros(width, height), Similarity::IDENTITY, &Kernel::HalfGaussian, None);
        check(
            &flat,
            &random_field(width, height, 1),
            &random_field(width, height, 2),
            Similarity::new(1e4, 0.0, 0.0, 1.0),
            &Kernel::Gaussian,
            None,
        );
        let still = Some(Similarity::IDENTITY);
        check(&flat, &flat, &Field::zeros(width, height), Similarity::IDENTITY, &Kernel::Gaussian, still);
    }
}
