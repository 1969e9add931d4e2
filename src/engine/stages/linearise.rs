//! Computes D and b of each pixel's equation for dV, and the registration integrals.
//!
//! [`system`](super::system) makes the linear system of D and b. Equations 22 to 32 and 23 of the paper, sections 3 to
//! 5 of `docs/method.md`:
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

use super::blur::{NEAR, Stacks, heaviside, sample_pair, sample_segment};
use super::links::Links;
use super::mask::{self, Masks};
use super::noise;
use super::pass::{Bindings as _, Memory, Pass};
use super::rows::{self, Rows};
use super::segments::{SEGMENT, segment, vectorised};
use super::stack::Slopes;
use super::state::{Registration, margin};
use super::sums::{Layout, Line};
use super::update_transform;
use super::{Number, Raster, Real, WORKGROUP, pixels};
use crate::engine::shaders;
use crate::engine::slot::Bound;
use crate::engine::vulkan::Variant;

pub use super::interface::linearise::*;

/// The most lines of two pixels per invocation. Values that adjacent lines share are loaded once, and the sums of a
/// workgroup are reduced once for all lines.
const MOST_ROWS: u32 = 8;
/// Lines per invocation on a level, on a GPU: fewer on small levels, so that they do not leave most of it idle. With
/// one line there are enough waves to hide their latency.
pub(crate) fn rows_on_gpu([width, height]: [u32; 2]) -> u32 {
    match pixels(width, height) {
        ..0x8000 => 1,
        0x8000..0x8_0000 => MOST_ROWS / 4,
        _ => MOST_ROWS,
    }
}

/// Lines per invocation on a level, on a processor.
pub(crate) fn rows_on_processor([width, height]: [u32; 2]) -> u32 {
    if pixels(width, height) < 0x8000 { MOST_ROWS / 4 } else { MOST_ROWS }
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

/// Workgroups over a level of this size, with `rows` lines per invocation.
pub(crate) fn tiles([width, height]: [u32; 2], rows: u32) -> [u32; 3] {
    [width.div_ceil(2 * WORKGROUP[0]), height.div_ceil(WORKGROUP[1] * rows), 1]
}

/// The variant for a kernel, for a warped I2, for masked pixels, and for the sums of homographies.
pub(crate) fn variant(slopes: Slopes, warped: bool, masked: bool, projective: bool) -> Variant {
    Variant::ANY_KERNEL.when(slopes == Slopes::Layers)
        | Variant::WARPED.when(warped)
        | Variant::MASKED.when(masked)
        | Variant::PROJECTIVE.when(projective)
}

impl Pass for Bindings {
    /// Compulsory traffic: I1, V, the two nodes of the stacks about V and the other image, read once per pixel; D, b
    /// and a row of sums per workgroup written.
    fn bytes(c: &Constants, variant: Variant) -> u64 {
        let slopes = if variant.has(Variant::ANY_KERNEL) { Slopes::Layers } else { Slopes::Laplacian };
        let layers = 3 * slopes.layers() as u64;
        (8 + 4 * layers + 8) * pixels(c.width, c.height)
            + row_bytes([c.width, c.height], c.rows, Layout::of_variant(variant))
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let reused = [0, 1].map(|n| memory.take_layer(self.normal_equations, n));
        let state = memory.state(self.state);
        let stacks = Stacks::of(memory.layers(self.stacks), c.second_stack, c.nodes, variant.has(Variant::ANY_KERNEL));
        let warped = variant.has(Variant::WARPED).then_some(&state.warped);
        let masks = mask::of(memory, self.masks, variant);
        let [i1, v] = [memory.layer(self.image1, 0), memory.layer(self.relative_blur, 0)];
        let layout = Layout::of_variant(variant);
        let state = (&state.registration, state.alpha, state.spread);
        let Linearised { equations, partials } =
            cpu_reference(reused, c, layout, state, warped, [i1, v], (&stacks, masks));
        equations.into_iter().enumerate().for_each(|(n, field)| memory.set_layer(self.normal_equations, n, field));
        memory.set_numbers(self.partials, &partials);
        if c.t_step.is(update_transform::STEPS) {
            let Self { partials, updated, energies, arguments, start_arguments, .. } = self;
            let slots = [partials.slot(), updated.slot(), energies.slot(), arguments.slot(), start_arguments.slot()];
            update_transform::Bindings::of(&slots).run(&c.step_constants(), variant, memory);
        }
    }
}

impl Constants {
    /// The constants of [`update_transform`] after this pass.
    pub(crate) fn step_constants(&self) -> update_transform::Constants {
        let [columns, rows, _] = tiles([self.width, self.height], self.rows);
        let &Self { factor, scale_length, centre: half_size, t_step, .. } = self;
        update_transform::Constants { rows: columns * rows, factor, scale_length, half_size, t_step }
    }
}

/// Bytes of a level's partial sums.
pub(crate) fn row_bytes(size: [u32; 2], rows: u32, layout: Layout) -> u64 {
    let [columns, rows, _] = tiles(size, rows);
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

/// One pass over a level, with T, α and the spread of the previous iteration, in the memory of rasters. `warped` is T
/// when I2 was warped onto I1's pixels, if it was.
fn cpu_reference<N: Number>(
    equations: [Raster<N>; LAYERS as usize],
    c: &Constants,
    layout: Layout,
    (r, alpha, spread): (&Registration, f64, f64),
    warped: Option<&Registration>,
    [i1, v]: [&Raster<N>; 2],
    (stacks, masks): (&Stacks<N>, Option<&Masks<N>>),
) -> Linearised<N> {
    let size @ [width, height] = [v.width, v.height];
    let moved = warped.map(|before| r.moved_since(before));
    let [eta, continuation] = [c.smoothness_eta, c.continuation].map(f64::from);
    let links = Links::new(v, [continuation * alpha, 1.0, eta], false);
    let (scale, centre, spread) = (r.scale(), c.centre.map(f64::from), least_spread(c, spread));
    let [columns, ..] = tiles([c.width, c.height], c.rows);
    let lines = (WORKGROUP[1] * c.rows) as usize;
    let mut equations = equations.map(|raster| raster.of_size(size));
    let rasters = equations.each_mut().map(|raster| Rows::from(raster).joined(lines));
    let partials = rows::map(rasters, |row, [diagonals, sides]| {
        let mut partials = vec![0.0; columns as usize * layout.length];
        // Finite from the start: places without a pixel have no weight.
        let (mut pixels, mut terms) = ([[N::of(1.0); BLOCK]; PARTS], [[N::default(); BLOCK]; TERMS]);
        let [mut dx, mut dy, mut shift_x, mut shift_y] = [[N::default(); BLOCK]; 4];
        let steps: [N; BLOCK] = std::array::from_fn(|n| N::of(n as f64));
        let mut links = links.rows_from(row * lines);
        for y in row * lines..height.min((row + 1) * lines) {
            links.advance(y);
            for (tile, partials) in partials.chunks_exact_mut(layout.length).enumerate() {
                let xs = tile * BLOCK..width.min((tile + 1) * BLOCK);
                let (count, start) = (xs.len(), [xs.start, y]);
                let [.., smoothness, pulls, phis, _] = &mut pixels;
                links.sums(xs.start, [&mut smoothness[..count], &mut pulls[..count]]);
                phis[..count].copy_from_slice(&links.phi()[xs.clone()]);
                pixels[V][..count].copy_from_slice(&v.row(y)[xs.clone()]);
                pixels[V][count..].fill(v.row(y)[xs.end - 1]);
                let level = Level { c, gain: r.gain, offset: r.offset, alpha, spread };
                let line = vectorised(
                    #[inline(always)]
                    || {
                        r.displacements(start, c.factor.into(), centre, [&mut dx, &mut dy]);
                        if let Some(moved) = &moved {
                            moved.displacements(start, c.factor.into(), centre, [&mut shift_x, &mut shift_y]);
                        }
                        let [first, row, middle, length] =
                            N::all([xs.start as f64, y as f64, centre[0], c.scale_length.into()]);
                        for n in 0..BLOCK {
                            let (x, d) = (first + steps[n], [dx[n], dy[n]]);
                            pixels[SHARE][n] = margin([x, row], d, size, pixels[V][n], scale);
                            pixels[BETWEEN][n] = noise::interpolated(d);
                            pixels[PLACE][n] = (x - middle) / length;
                        }
                        for n in (0..count).step_by(SEGMENT) {
                            let (at, mut shares) = ([xs.start + n, y], [N::default(); SEGMENT]);
                            mask::counts_segment(masks, at, [&segment(&dx[n..]), &segment(&dy[n..])], &mut shares);
                            let inside = &mut pixels[SHARE][n..n + SEGMENT];
                            for n in 0..SEGMENT {
                                inside[n] = inside[n].choose(shares[n], N::default());
                            }
                            if moved.is_some() {
                                let shift = [&segment(&shift_x[n..]), &segment(&shift_y[n..])];
                                let samples = sample_segment(stacks, at, shift, &segment(&pixels[V][n..]));
                                for k in 0..samples.len() {
                                    pixels[FIRST + k][n..n + SEGMENT].copy_from_slice(&samples[k]);
                                }
                            }
                        }
                        // Places beyond the last pixel have no weight.
                        pixels[SHARE][count..].fill(N::default());
                        if moved.is_none() {
                            for n in 0..count {
                                if pixels[SHARE][n] == N::default() {
                                    continue;
                                }
                                let (lens, at, v) = ((c.mean, c.factor, c.centre), [xs.start + n, y], pixels[V][n]);
                                let numbers = sample_pair(lens, r, at, i1, v.into(), stacks).numbers();
                                for k in 0..numbers.len() {
                                    pixels[FIRST + k][n] = N::of(numbers[k]);
                                }
                            }
                        }
                        level.line(&pixels, &mut terms)
                    },
                );
                line.add_to(partials, (y as f64 - centre[1]) / f64::from(c.scale_length), layout);
                let first = (y - row * lines) * width + xs.start;
                diagonals[first..first + count].copy_from_slice(&terms[DIAGONAL][..count]);
                sides[first..first + count].copy_from_slice(&terms[SIDE][..count]);
            }
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
/// X, the last.
const PLACE: usize = PARTS - 1;
/// The pixels of a line of a tile.
const BLOCK: usize = 2 * WORKGROUP[0] as usize;
const _: () = assert!(BLOCK.is_multiple_of(SEGMENT));

/// The terms of each pixel: its part of N (xx, xy, yy) and of g, the energy, the roughness of b and of V, D, b, and the
/// signed residual.
const TERMS: usize = 11;
const ENERGY: usize = 5;
const ROUGHNESS: usize = 6;
const DIAGONAL: usize = 8;
const SIDE: usize = 9;
const SIGNED: usize = 10;

/// Partial sums of a line, which are added at its end.
const LANES: usize = 8;

/// The sums of numbers times powers of x.
#[inline(always)]
fn moments<N: Number, const COUNT: usize>(numbers: &[N; BLOCK], x: &[N; BLOCK]) -> [f64; COUNT] {
    let (mut lanes, mut sums) = ([[N::default(); LANES]; COUNT], [0.0; COUNT]);
    for (numbers, x) in numbers.as_chunks::<LANES>().0.iter().zip(x.as_chunks::<LANES>().0) {
        let mut term = *numbers;
        for k in 0..COUNT {
            for n in 0..LANES {
                lanes[k][n] += term[n];
                term[n] = term[n] * x[n];
            }
        }
    }
    for k in 0..COUNT {
        for n in 0..LANES {
            sums[k] += lanes[k][n].into();
        }
    }
    sums
}

/// What all pixels of a level share.
struct Level<'a> {
    c: &'a Constants,
    gain: f64,
    offset: f64,
    alpha: f64,
    spread: f64,
}

impl Level<'_> {
    /// The sums of the pixels of a line. Writes their terms.
    #[inline(always)]
    fn line<N: Number>(&self, pixels: &[[N; BLOCK]; PARTS], terms: &mut [[N; BLOCK]; TERMS]) -> Line {
        for n in 0..BLOCK {
            let mut pixel = [N::default(); PARTS];
            for part in 0..PARTS {
                pixel[part] = pixels[part][n];
            }
            let numbers = self.terms(&pixel);
            for term in 0..TERMS {
                terms[term][n] = numbers[term];
            }
        }
        let x = &pixels[PLACE];
        let sum = |numbers: &[N; BLOCK]| -> f64 { moments::<N, 1>(numbers, x)[0] };
        let mut line = Line {
            normal: [moments(&terms[0], x), moments(&terms[1], x), moments(&terms[2], x)],
            gradient: [moments(&terms[3], x), moments(&terms[4], x)],
            energy: sum(&terms[ENERGY]),
            valid: sum(&pixels[SHARE]),
            roughness: [sum(&terms[ROUGHNESS]), sum(&terms[ROUGHNESS + 1])],
            variance: [moments::<N, 2>(&terms[SIDE], &terms[SIDE])[1], sum(&terms[DIAGONAL])],
            ..Line::default()
        };
        // The first of two adjacent pixels is in an even column: tiles are even.
        let (signed, shares) = (terms[SIGNED].as_chunks::<2>().0, pixels[SHARE].as_chunks::<2>().0);
        for (s, share) in signed.iter().zip(shares) {
            let least: f64 = share[0].min(share[1]).into();
            if least > 0.0 {
                line.spread += least * spreads(self.spread, (s[1] - s[0]).into());
            }
        }
        line
    }

    /// The terms of a pixel.
    #[inline(always)]
    fn terms<R: Real>(&self, pixel: &[R; PARTS]) -> [R; TERMS] {
        let (&[_, share, .., smoothness, pull, phi, _], one, none) = (pixel, R::of(1.0), R::default());
        let [elimination, eta, alpha] = R::all([self.c.elimination.into(), self.c.smoothness_eta.into(), self.alpha]);
        let ([mut first, mut second], psi, signed) = self.data_term(pixel);
        (first.weight, second.weight) = (first.weight * share, second.weight * share);
        let diagonal = first.weight * first.by_v * first.by_v + second.weight * second.by_v * second.by_v;
        let b = -(first.weight * first.s * first.by_v + second.weight * second.s * second.by_v);
        let over = one / (diagonal + elimination * smoothness).max(R::of(1e-12));
        let (n, g) = self.registration([first, second], (b + pull) * over, over, self.broadened(psi));
        let steepness = one / phi;
        let energy = share * (psi + alpha * steepness);
        let rough = [b.abs(), (steepness * steepness - eta * eta).max(none)];
        let rough = [share * rough[0].sqrt(), share * rough[1].sqrt()];
        [n[0], n[1], n[2], g[0], g[1], energy, rough[0], rough[1], diagonal, b, signed]
    }

    /// S1 and S2 at a pixel, the energy of the data term, and the signed residual H S1 - (1 - H) S2.
    #[inline(always)]
    fn data_term<R: Real>(&self, pixel: &[R; PARTS]) -> ([Residual<R>; 2], R, R) {
        let &[v, _, between, i1, i2, dx, dy, b1, slope1, b2, slope2, dx2, dy2, ..] = pixel;
        let [gain, offset, eta, one] = R::all([self.gain, self.offset, self.c.eta.into(), 1.0]);
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
        let pick = |blurred: R, beyond: R| [v.choose(blurred, beyond), v.choose(beyond, blurred)];
        let ([n1, n2], [by1, by2]) = (pick(blurred.value, beyond.value), pick(blurred.slope, beyond.slope));
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
    fn registration<R: Real>(&self, [one, two]: [Residual<R>; 2], side: R, over: R, ratio: R) -> ([R; 3], [R; 2]) {
        let ([x1, y1], [x2, y2]) = (one.by_place, two.by_place);
        let sum = |first: R, second: R| one.weight * first + two.weight * second;
        let [qx, qy] = [sum(one.by_v * x1, two.by_v * x2), sum(one.by_v * y1, two.by_v * y2)];
        let g = [sum(one.s * x1, two.s * x2) + qx * side, sum(one.s * y1, two.s * y2) + qy * side];
        let n = [
            sum(x1 * x1, x2 * x2) - qx * qx * over,
            sum(x1 * y1, x2 * y2) - qx * qy * over,
            sum(y1 * y1, y2 * y2) - qy * qy * over,
        ];
        ([ratio * n[0], ratio * n[1], ratio * n[2]], [ratio * g[0], ratio * g[1]])
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
