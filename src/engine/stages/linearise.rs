//! Computes D and b of each pixel's equation for dV, and the registration integrals.
//!
//! [`system`](super::system) makes the linear system of D and b. Equations 22 to 32 and 23 of the paper, sections 3 to
//! 5 of `docs/method.md`:
//!
//! ```text
//! S = h(V₂) * I1 - h(V₁) * J,  w = ψ'(S²),  Sv = ∂S/∂V less S n'/2n: without the part of noise (noise.rs)
//! D = w Sv²,  b = -w S Sv,  a_n = α (φ + φ_n)/2,  r = b + Σ a_n (V_n - V)
//! N = Σ w j jᵀ - q qᵀ/(D + λ Σa),  g = Σ w j S + q r/(D + λ Σa),  q = w Sv j,  j = ∂S/∂ζ
//! ```
//!
//! The terms in q eliminate each pixel's dV from the registration step (Schur complement), so that T steps as if V had
//! already responded. A neighbourhood moves together and is held less by the smoothness than a single pixel: λ = 0.25
//! accounts for that. On the slanted plane with 15 iterations per level, V rms was 0.032 px² without elimination, 0.026
//! with λ = 1 and 0.007 with 0.1; but with 0.1, black and white dots under a half-Gaussian do not settle.

use super::blur::{self, Stacks, sample_segment};
use super::law::Variances;
use super::links::Links;
use super::mask::{self, Masks};
use super::noise;
use super::pass::{Bindings as _, Memory, Pass};
use super::rows::{self, Rows};
use super::segments::{SEGMENT, segment, vectorised};
use super::stack::Slopes;
use super::state::{DoubleState, Registration, margin};
use super::sums::{Layout, Line};
use super::update_transform;
use super::{Number, Raster, Real, WORKGROUP, pixels};
use crate::base::Parallax;
use crate::engine::shaders;
use crate::engine::slot::Bound;
use crate::engine::vulkan::Variant;

pub use super::interface::linearise::*;

/// The most lines per invocation. Values that adjacent lines share are loaded once, and the sums of a workgroup are
/// reduced once for all lines.
const MOST_ROWS: u32 = 16;
/// Lines per invocation on a level, on a GPU: fewer on small levels, so that they do not leave most of it idle. Two is
/// the least, since pairs of pixels in a column state the spread.
pub(crate) fn rows_on_gpu([width, height]: [u32; 2]) -> u32 {
    match pixels(width, height) {
        ..0x8000 => MOST_ROWS / 8,
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
pub const BROAD: f64 = shaders::data::BROAD;
/// The spread s is an M-estimate of scale of x = ΔS/√2 between adjacent pixels of a column. Such differences show the
/// noise, and little of the model's errors; half of them may be outliers. The mean of x²/(x² + `BOUND`² s²) is a half,
/// as for Gaussian x of deviation s.
pub const BOUND: f64 = shaders::linearise::BOUND;
/// λ.
pub const ELIMINATION: f32 = 0.25;

/// Workgroups over a level of this size, with `rows` lines per invocation.
pub(crate) fn tiles([width, height]: [u32; 2], rows: u32) -> [u32; 3] {
    [width.div_ceil(WORKGROUP[0]), height.div_ceil(WORKGROUP[1] * rows), 1]
}

/// The variant for a kernel, for a warped I2, for masked pixels, and for the sums of homographies.
pub(crate) fn variant(slopes: Slopes, warped: bool, masked: bool, projective: bool) -> Variant {
    Variant::ANY_KERNEL.when(slopes == Slopes::Layers)
        | Variant::WARPED.when(warped)
        | Variant::MASKED.when(masked)
        | Variant::PROJECTIVE.when(projective)
}

impl Pass for Bindings {
    /// Compulsory traffic: V, and of either stack the two nodes about its variance, read once per pixel; D, b and a row
    /// of sums per workgroup written.
    fn bytes(c: &Constants, variant: Variant) -> u64 {
        let slopes = if variant.has(Variant::ANY_KERNEL) { Slopes::Layers } else { Slopes::Laplacian };
        let layers = 4 * slopes.layers() as u64;
        (4 + 4 * layers + 8) * pixels(c.width, c.height)
            + row_bytes([c.width, c.height], c.rows, Layout::of_variant(variant))
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let reused = [0, 1].map(|n| memory.take_layer(self.normal_equations, n));
        let state = memory.state(self.state);
        let stacks = Stacks::of(memory.layers(self.stacks), c.second_stack, c.nodes, variant.has(Variant::ANY_KERNEL));
        let warped = state.warped_by(variant);
        let masks = mask::of(memory, self.masks, variant);
        let v = memory.layer(self.relative_blur, 0);
        let layout = Layout::of_variant(variant);
        let Linearised { equations, partials } = cpu_reference(reused, c, layout, state, warped, v, (&stacks, masks));
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

/// One pass over a level, with the state of the previous iteration, in the memory of rasters. `warped` is T
/// when I2 was warped onto I1's pixels, if it was.
fn cpu_reference<N: Number>(
    equations: [Raster<N>; LAYERS as usize],
    c: &Constants,
    layout: Layout,
    state: &DoubleState,
    warped: Option<&Registration>,
    v: &Raster<N>,
    (stacks, masks): (&Stacks<N>, Option<&Masks<N>>),
) -> Linearised<N> {
    let (r, alpha, size @ [width, height]) = (&state.registration, state.alpha, [v.width, v.height]);
    let moved = warped.map(|before| r.moved_since(before));
    let [eta, continuation] = [c.smoothness_eta, c.continuation].map(f64::from);
    let links = Links::new(v, [continuation * alpha, 1.0, eta], false);
    let (scale, centre, spread) = (r.scale(), c.centre.map(f64::from), spread(c.eta, state.spread));
    let (separation, displacement) = (state.separation_on(c.factor), state.displacement(c.factor, c.centre));
    let has_parallax = state.parallax != Parallax::NONE;
    let [columns, ..] = tiles([c.width, c.height], c.rows);
    // Parts of a row of tiles, for more threads; of an even number of lines, since the spread is of pairs of lines.
    let lines = (WORKGROUP[1] * c.rows).min(MOST_ROWS) as usize;
    let mut equations = equations.map(|raster| raster.of_size(size));
    let rasters = equations.each_mut().map(|raster| Rows::from(raster).joined(lines));
    let parts = rows::map(rasters, |row, [diagonals, sides]| {
        let mut partials = vec![0.0; columns as usize * layout.length];
        // Finite from the start: places without a pixel have no weight.
        let (mut pixels, mut terms) = ([[N::of(1.0); BLOCK]; PARTS], [[N::default(); BLOCK]; TERMS]);
        (MOVES..PLACE).for_each(|k| pixels[k].fill(N::default()));
        let [mut dx, mut dy, mut shift_x, mut shift_y] = [[N::default(); BLOCK]; 4];
        let steps: [N; BLOCK] = std::array::from_fn(|n| N::of(n as f64));
        let mut links = links.rows_from(row * lines);
        let mut before = vec![[[N::default(); BLOCK]; 2]; columns as usize];
        for y in row * lines..height.min((row + 1) * lines) {
            links.advance(y);
            for (tile, (partials, before)) in partials.chunks_exact_mut(layout.length).zip(&mut before).enumerate() {
                let xs = tile * BLOCK..width.min((tile + 1) * BLOCK);
                let (count, start) = (xs.len(), [xs.start, y]);
                let [.., smoothness, pulls, phis, _, _, _, _, _] = &mut pixels;
                links.sums(xs.start, [&mut smoothness[..count], &mut pulls[..count]]);
                phis[..count].copy_from_slice(&links.phi()[xs.clone()]);
                pixels[V][..count].copy_from_slice(&v.row(y)[xs.clone()]);
                pixels[V][count..].fill(v.row(y)[xs.end - 1]);
                let (gain, offset, eta, noise) = (r.gain, r.offset, c.eta.into(), &c.noise);
                let level = Level { c, alpha, datum: Datum { gain, offset, eta, separation, spread, noise } };
                let mut line = vectorised::<N, _>(
                    #[inline(always)]
                    || {
                        displacement.of_row(start, &pixels[V], [&mut dx, &mut dy]);
                        if let Some(moved) = &moved {
                            moved.displacements(start, c.factor.into(), centre, [&mut shift_x, &mut shift_y]);
                        }
                        let [first, row, middle, length] =
                            N::all([xs.start as f64, y as f64, centre[0], c.scale_length.into()]);
                        for n in 0..BLOCK {
                            let (x, d) = (first + steps[n], [dx[n], dy[n]]);
                            let variances = Variances::new(pixels[V][n], separation);
                            pixels[SHARE][n] = margin([x, row], d, size, variances.both(), scale);
                            pixels[BETWEEN][n] = noise::interpolated(d);
                            pixels[PLACE][n] = (x - middle) / length;
                            if has_parallax {
                                let moves = displacement.by_v([x.into(), y as f64]);
                                (0..2).for_each(|k| pixels[MOVES + k][n] = N::of(moves[k]));
                                let slope = noise::interpolated_slope(d);
                                (0..2).for_each(|k| pixels[BETWEEN_SLOPE + k][n] = slope[k]);
                            }
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
                                let v = segment(&pixels[V][n..]);
                                let samples = sample_segment(stacks, separation, at, shift, &v);
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
                                let (at, d) = ([(xs.start + n) as f64, y as f64], [dx[n].into(), dy[n].into()]);
                                let (mean, v) = (c.mean.map(f64::from), pixels[V][n].into());
                                let parallax = displacement.by_v(at);
                                let [b1, b2] = blur::read(stacks, r, mean, at, d, (v, parallax), separation);
                                let numbers = [b1.value, b1.slope, b2.value, b2.slope, b2.dx, b2.dy];
                                for k in 0..numbers.len() {
                                    pixels[FIRST + k][n] = N::of(numbers[k]);
                                }
                            }
                        }
                        level.line(&pixels, &mut terms)
                    },
                );
                let now = [terms[SIGNED], pixels[SHARE]];
                if (y - row * lines) % 2 == 1 {
                    line.spread = spreads_between(spread, before, &now);
                }
                *before = now;
                line.add_to(partials, (y as f64 - centre[1]) / f64::from(c.scale_length), layout);
                let first = (y - row * lines) * width + xs.start;
                diagonals[first..first + count].copy_from_slice(&terms[DIAGONAL][..count]);
                sides[first..first + count].copy_from_slice(&terms[SIDE][..count]);
            }
        }
        partials
    });
    let row_of_tiles = |parts: &[Vec<f64>]| {
        let add = |mut sums: Vec<f64>, part: &Vec<f64>| {
            sums.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
            sums
        };
        parts[1..].iter().fold(parts[0].clone(), add)
    };
    let partials = parts.chunks((WORKGROUP[1] * c.rows) as usize / lines).flat_map(row_of_tiles).collect();
    Linearised { equations, partials }
}

/// The numbers of each pixel of a line, in the order in which they are gathered: V, share, noise of I2 between pixels,
/// Î1 and its slope, Î2, its slope and its gradient, Σa, Σ a (V_n - V), φ, the parallax by V, the slope of the noise between
/// pixels if there is parallax, X.
const PARTS: usize = 17;
const V: usize = 0;
const SHARE: usize = 1;
const BETWEEN: usize = 2;
/// Î1, the first of the samples.
const FIRST: usize = 3;
/// The parallax by V, along x and y.
const MOVES: usize = PARTS - 5;
const BETWEEN_SLOPE: usize = PARTS - 3;
/// X, the last.
const PLACE: usize = PARTS - 1;
/// The pixels of a line of a tile.
const BLOCK: usize = WORKGROUP[0] as usize;
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
    alpha: f64,
    datum: Datum<'a>,
}

/// The data terms of a level. The CPU reference of `glsl/include/data.glsl`.
pub(super) struct Datum<'a> {
    pub(super) gain: f64,
    pub(super) offset: f64,
    /// η.
    pub(super) eta: f64,
    /// Of the focus settings, px² of the level.
    pub(super) separation: f64,
    /// At least that of η.
    pub(super) spread: f64,
    pub(super) noise: &'a noise::Noise,
}

/// The data term of a pixel.
pub(super) struct Data<R> {
    /// Residual.
    pub(super) s: R,
    /// Its derivative by V, without the part of noise.
    pub(super) by_v: R,
    /// ψ' times the share by which the pixel counts.
    pub(super) weight: R,
    /// ψ(S²).
    pub(super) psi: R,
    /// The derivative of S by a displacement of I2, also without the part of noise.
    pub(super) by_place: [R; 2],
}

impl Datum<'_> {
    /// The data term of a pixel: of V, the share and the noise of I2 between pixels; of Î1 and its slope, Î2, its slope and
    /// its gradient. With parallax, of what V displaces I2 by, and the slope of that noise.
    #[inline(always)]
    pub(super) fn of<R: Real>(
        &self,
        [v, share, between]: [R; 3],
        [b1, slope1]: [R; 2],
        [b2, slope2, dx, dy]: [R; 4],
        [moves, between_slope]: [[R; 2]; 2],
    ) -> Data<R> {
        let [gain, offset, eta] = R::all([self.gain, self.offset, self.eta]);
        let s = b1 - (gain * b2 + offset);
        let psi = (s * s + eta * eta).sqrt();
        let [by_v, between] = self.noise_slopes(v, between);
        let [x, y] = [between * between_slope[0] * s, between * between_slope[1] * s];
        let by_v = slope1 - gain * slope2 - by_v * s - (x * moves[0] + y * moves[1]);
        Data { s, by_v, weight: share / psi, psi, by_place: [-gain * dx - x, -gain * dy - y] }
    }

    /// Half the derivatives of the logarithm of the noise of both images in S², by V and by `between`, the noise of I2
    /// between pixels.
    #[inline(always)]
    fn noise_slopes<R: Real>(&self, v: R, between: R) -> [R; 2] {
        let (one, square) = (R::of(1.0), R::of(self.gain * self.gain));
        let of = Variances::new(v, self.separation);
        let (n1, n2) = (self.noise.blurred(of.first, one), self.noise.blurred(of.second, between));
        let slope = n1.slope * of.first_by_v + square * n2.slope * of.second_by_v;
        let by_between = square * self.noise.by_before(of.second, between, n2.value);
        let (half, both) = (R::of(0.5), n1.value + square * n2.value);
        [half * slope / both, half * by_between / both]
    }

    /// The factor on a pixel's weight in T's step that broadens η to [`BROAD`] spreads.
    #[inline(always)]
    pub(super) fn broadened<R: Real>(&self, psi: R) -> R {
        psi / (psi * psi + R::of((BROAD * self.spread).powi(2) - self.eta.powi(2))).sqrt()
    }
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
        Line {
            normal: [moments(&terms[0], x), moments(&terms[1], x), moments(&terms[2], x)],
            gradient: [moments(&terms[3], x), moments(&terms[4], x)],
            energy: sum(&terms[ENERGY]),
            valid: sum(&pixels[SHARE]),
            roughness: [sum(&terms[ROUGHNESS]), sum(&terms[ROUGHNESS + 1])],
            variance: [moments::<N, 2>(&terms[SIDE], &terms[SIDE])[1], sum(&terms[DIAGONAL])],
            ..Line::default()
        }
    }

    /// The terms of a pixel.
    #[inline(always)]
    fn terms<R: Real>(&self, pixel: &[R; PARTS]) -> [R; TERMS] {
        let &[v, share, between, b1, slope1, b2, slope2, dx, dy, smoothness, pull, phi, moves @ .., _] = pixel;
        let [moves_x, moves_y, slope_x, slope_y] = moves;
        let [one, none] = R::all([1.0, 0.0]);
        let [elimination, eta, alpha] = R::all([self.c.elimination.into(), self.c.smoothness_eta.into(), self.alpha]);
        let displaced = [[moves_x, moves_y], [slope_x, slope_y]];
        let Data { s, by_v, weight, psi, by_place: [x, y] } =
            self.datum.of([v, share, between], [b1, slope1], [b2, slope2, dx, dy], displaced);
        let (diagonal, b) = (weight * by_v * by_v, -(weight * s * by_v));
        let over = one / (diagonal + elimination * smoothness).max(R::of(1e-12));
        let (side, ratio) = ((b + pull) * over, self.datum.broadened(psi));
        let [qx, qy] = [weight * by_v * x, weight * by_v * y];
        let g = [weight * s * x + qx * side, weight * s * y + qy * side];
        let n = [weight * x * x - qx * qx * over, weight * x * y - qx * qy * over, weight * y * y - qy * qy * over];
        let steepness = one / phi;
        let energy = share * (psi + alpha * steepness);
        // α is estimated without the part of parallax: with it a larger parallax raises α, and a larger α shrinks V.
        let by_blur = weight * s * (by_v - (x * moves_x + y * moves_y));
        let rough = [by_blur.abs(), (steepness * steepness - eta * eta).max(none)];
        let rough = [share * rough[0].sqrt(), share * rough[1].sqrt()];
        [
            ratio * n[0],
            ratio * n[1],
            ratio * n[2],
            ratio * g[0],
            ratio * g[1],
            energy,
            rough[0],
            rough[1],
            diagonal,
            b,
            s,
        ]
    }
}

/// The spread of the previous iteration, at least that of η.
pub(super) fn spread(eta: f32, before: f64) -> f64 {
    before.max(f64::from(eta) / BROAD)
}

/// The sum for the spread of a line and the one before, by the signed residuals and the shares of their pixels.
fn spreads_between<N: Number>(spread: f64, before: &[[N; BLOCK]; 2], now: &[[N; BLOCK]; 2]) -> f64 {
    let pixel = |n: usize| {
        let least: f64 = before[1][n].min(now[1][n]).into();
        if least > 0.0 { least * spreads(spread, (now[0][n] - before[0][n]).into()) } else { 0.0 }
    };
    (0..BLOCK).map(pixel).sum()
}

/// The contribution of two adjacent pixels of a column to the spread: a bounded square, whose mean is a half where the
/// spread is right.
#[inline(always)]
fn spreads(spread: f64, difference: f64) -> f64 {
    let square = 0.5 * difference * difference;
    2.0 * square / (square + (BOUND * spread).powi(2))
}
