//! Computes the linear system for the step of the unknown: V of a pair, or u of a sweep.
//!
//! D and b are those of a [pair](super::linearise), or [summed over the pairs](super::half_pair) of a sweep, averaged
//! over a window. The system combines them with the smoothness of ρ: V, or √c u in px of blur. For a sweep the pass
//! also computes the step of c, with u eliminated as dV is from a pair's registration. Equations 26 to 28, sections 4
//! and 11 of `docs/method.md`.
//!
//! ```text
//! (D + Σ a_n) du = b + Σ a_n (u_n - u - g_n) + Σ a_n du_n,  a_n = α c (φ + φ_n)/2,  φ = 1/sqrt(c |∇u|² + η²)
//! ```
//!
//! For a pair c is 1. g_n is the rise of V to that neighbour by its slope over `REACH` pixels on either side, so that
//! smoothness does not flatten slopes. It is their harmonic mean, the limiter of van Leer (Journal of Computational
//! Physics 14, 1974), which is 0 at a jump. For a sweep it is 0.
//!
//! The system is stored divided by its diagonal, with weights in half precision, rounded to nearest. At the solution,
//! dV = 0, their rounding has no effect.

use super::grid::{Cell, FLOATS};
use super::links::Links;
use super::rows::{self, Rows};
use super::segments::vectorised;
use super::{Number, Raster};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

/// The equation's constants.
#[derive(Clone, Copy, Debug)]
pub struct Constants {
    /// Width of the level, pixels.
    pub width: u32,
    /// Height of the level, pixels.
    pub height: u32,
    /// α; for a pair the factor on the state's α.
    pub alpha: f32,
    /// c, px² of the level per squared setting; 1 for a pair.
    pub rate: f32,
    /// η of the smoothness term, px of blur per pixel; for a pair px² per pixel.
    pub smoothness_eta: f32,
}

/// The variant for a sweep.
pub(crate) const SWEEP: Variant = Variant::SWEEP;

/// Layers of the equations that a variant reads: D, b, and for a sweep q.
pub(crate) fn layers(variant: Variant) -> u32 {
    if variant == SWEEP { 3 } else { 2 }
}

/// Floats per workgroup.
pub(crate) const SUMS: usize = shaders::system::SUMS as usize;

/// Rows of the level that are computed one after the other. Adjacent rows share links.
const LINES: usize = 16;
// A cell of the coarse grid is of two rows.
const _: () = assert!(LINES.is_multiple_of(2));

/// Computes the system of each color: right side, then the weights of the right, left, lower and upper neighbour; the
/// [cells](super::grid::Cell) of the first coarse grid; and the sums, which it returns. `equations` holds D, b, and for a
/// sweep q. `rounds`: whether weights are rounded, as they are where a script runs. Reuses the memory of the rasters.
pub(super) fn compute<N: Number>(
    c: &Constants,
    alpha: f64,
    unknown: &Raster<N>,
    equations: &[Raster<N>],
    colors: &mut [[Raster<N>; 5]; 2],
    cells: &mut Vec<N>,
    rounds: bool,
) -> [f64; SUMS] {
    let strengths = [alpha, c.rate.into(), c.smoothness_eta.into()];
    let links = Links::new(unknown, strengths, equations.len() < layers(SWEEP) as usize);
    let (width, height, columns) = (unknown.width, unknown.height, unknown.width.div_ceil(2));
    for raster in colors.as_flattened_mut() {
        *raster = std::mem::take(raster).of_size([columns, height]);
    }
    let count = FLOATS * columns * height.div_ceil(2);
    cells.resize(cells.len().max(count), N::default());
    let [[r0, r1, r2, r3, r4], [b0, b1, b2, b3, b4]] = colors;
    let [r0, r1, r2, r3, r4, b0, b1, b2, b3, b4] =
        [r0, r1, r2, r3, r4, b0, b1, b2, b3, b4].map(|raster| Rows::from(raster).joined(LINES));
    let coarse = Rows { width: FLOATS * columns, numbers: &mut cells[..count] }.joined(LINES / 2);
    let rasters = [r0, r1, r2, r3, r4, b0, b1, b2, b3, b4, coarse];
    let sums = rows::map(rasters, |band, [r0, r1, r2, r3, r4, b0, b1, b2, b3, b4, cells]| {
        let mut colors = [[r0, r1, r2, r3, r4], [b0, b1, b2, b3, b4]];
        let mut sums = vec![[0.0; SUMS]; cells.len() / (FLOATS * columns)];
        let mut links = links.rows_from(band * LINES);
        let mut line = [(); 7].map(|()| vec![N::default(); width]);
        for (n, y) in (band * LINES..((band + 1) * LINES).min(height)).enumerate() {
            links.advance(y);
            let [own_d, own_b] = [0, 1].map(|n| equations[n].row(y));
            let [.., sums_of_weights, pulls] = &mut line;
            links.sums(0, [sums_of_weights, pulls]);
            let around = [&links.across, &links.down, &links.above].map(|links| &links.weights[..]);
            let cells = cells[n / 2 * FLOATS * columns..].as_chunks_mut().0;
            vectorised::<N, _>(
                #[inline(always)]
                || {
                    divided(own_d, own_b, around, &mut line);
                    if rounds {
                        line[1..WHOLE].iter_mut().for_each(|weights| round(weights));
                    }
                    for (color, own) in colors.iter_mut().enumerate() {
                        for part in 0..5 {
                            every_second(&line[part], (y + color) % 2, &mut own[part][n * columns..][..columns]);
                        }
                    }
                    let [across, down, _] = around;
                    add_to_cells([own_d, &line[RAW], across, down], y % 2 == 1, &mut cells[..columns]);
                },
            );
            if let Some(q) = equations.get(2) {
                for ((q, b), whole) in q.row(y).iter().zip(own_b).zip(&line[WHOLE]) {
                    let [q, b, whole]: [f64; 3] = [*q, *b, *whole].map(Into::into);
                    sums[n / 2][0] += q * b / whole;
                    sums[n / 2][1] += q * q / whole;
                }
            }
        }
        sums
    });
    sums.iter().flatten().fold([0.0; SUMS], |[a, b], [c, d]| [a + c, b + d])
}

/// The parts of a line of the system that follow the right side and the weights: the diagonal, and the right side
/// before it is divided by it.
const WHOLE: usize = 5;
const RAW: usize = 6;

/// Every second number from `first` on; 0 where none is left.
#[inline(always)]
fn every_second<N: Number>(numbers: &[N], first: usize, to: &mut [N]) {
    let (pairs, count) = (numbers.as_chunks::<2>().0, numbers.len() / 2);
    let (pairs, to_pairs) = (&pairs[..count], &mut to[..count]);
    for n in 0..count {
        to_pairs[n] = pairs[n][first];
    }
    if let [.., end] = to
        && numbers.len() % 2 == 1
    {
        *end = if first == 0 { numbers[2 * count] } else { N::default() };
    }
}

/// Adds D, r and the weights of the links of a row to the cells of the coarse grid: two by two pixels make one. A link
/// across the border of two is as wide as two, and twice as long. The first of two rows begins the cells.
#[inline(always)]
fn add_to_cells<N: Number>([d, r, across, down]: [&[N]; 4], is_second: bool, cells: &mut [Cell<N>]) {
    let (half, none, count) = (N::of(0.5), N::default(), d.len() / 2);
    let pairs = [d, r, across, down].map(|numbers| &numbers.as_chunks::<2>().0[..count]);
    let [d_pairs, r_pairs, across_pairs, down_pairs] = pairs;
    let lower = if is_second { half } else { none };
    if !is_second {
        cells.fill([none; FLOATS]);
    }
    let whole = &mut cells[..count];
    for n in 0..count {
        let [d0, r0, right, below] = whole[n];
        let ([d1, d2], [r1, r2], [below1, below2]) = (d_pairs[n], r_pairs[n], down_pairs[n]);
        let below = below + lower * below1 + lower * below2;
        whole[n] = [d0 + d1 + d2, r0 + r1 + r2, right + half * across_pairs[n][1], below];
    }
    if let [.., cell] = cells
        && d.len() % 2 == 1
    {
        let x = 2 * count;
        *cell = [cell[0] + d[x], cell[1] + r[x], cell[2], cell[3] + lower * down[x]];
    }
}

/// Divides a row of the system by its diagonal. `line` holds Σa and the pulls in its last two parts, which become the
/// diagonal and the right side before it is divided; its first five become the right side and the weights.
#[inline(always)]
fn divided<N: Number>(d: &[N], b: &[N], [across, down, above]: [&[N]; 3], line: &mut [Vec<N>; 7]) {
    let width = d.len();
    let [sides, rights, lefts, belows, aboves, wholes, raw] = line.each_mut().map(|part| &mut part[..width]);
    let (b, across, down, above) = (&b[..width], &across[..width], &down[..width], &above[..width]);
    for x in 0..width {
        wholes[x] = (d[x] + wholes[x]).max(N::of(1e-12));
        raw[x] += b[x];
        let over = N::of(1.0) / wholes[x];
        sides[x] = raw[x] * over;
        rights[x] = across[x] * over;
        belows[x] = down[x] * over;
        aboves[x] = above[x] * over;
        lefts[x] = over;
    }
    lefts[0] = N::default();
    let (lefts, across) = (&mut lefts[1..], &across[..width - 1]);
    for x in 0..width - 1 {
        lefts[x] = across[x] * lefts[x];
    }
}

/// Rounds weights to nearest with the 11 bits of half precision, as devices store them (T. J. Dekker's splitting,
/// Numerische Mathematik 18, 1971). Iterations end before dV is 0, so that V depends on the rounding: without it an
/// outline of the scene card moved, and V was 0.03 instead of 0.00003 px² rms off lavapipe's.
#[inline(always)]
fn round<N: Number>(weights: &mut [N]) {
    // 2^(p - 11) + 1 for numbers of p bits.
    let split = N::of(if size_of::<N>() == 4 { 8193.0 } else { 4_398_046_511_105.0 });
    for weight in weights {
        let wide = *weight * split;
        *weight = wide - (wide - *weight);
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::super::Field;
    use super::super::harness::random_field;
    use super::super::relax::both;
    use super::*;

    /// The system of each color.
    pub(crate) fn cpu_reference(
        c: &Constants,
        alpha: f64,
        unknown: &Field,
        equations: &[Field],
        rounds: bool,
    ) -> ([[Field; 5]; 2], [f64; SUMS], Vec<f64>) {
        let (mut colors, mut cells) = Default::default();
        let sums = compute(c, alpha, unknown, equations, &mut colors, &mut cells, rounds);
        (colors, sums, cells)
    }

    #[test]
    fn weights_are_rounded_to_half_precision() {
        let mut weights: Vec<f64> = random_field(100, 10, 3).data.iter().map(|weight| 1e-4 + 0.9 * weight).collect();
        let expected: Vec<f64> = weights.iter().map(|&weight| ::half::f16::from_f64(weight).to_f64()).collect();
        let mut single: Vec<f32> = weights.iter().map(|&weight| weight as f32).collect();
        round(&mut weights);
        round(&mut single);
        assert!(weights == expected && single.iter().zip(&expected).all(|(single, e)| f64::from(*single) == *e));
    }

    /// The right sides of the middle row of 121 x 5 pixels. The unknown depends on x alone, D is 1 and b is 0.
    fn pulls(unknown: impl Fn(f64) -> f64 + Sync) -> Vec<f64> {
        let c = Constants { width: 121, height: 5, alpha: 1.0, rate: 1.0, smoothness_eta: 0.1 };
        let unknown = Field::from_fn(121, 5, |x, _| unknown(x as f64));
        let [ones, zeros] = [1.0, 0.0].map(|value| Field::from_fn(121, 5, |_, _| value));
        let (colors, ..) = cpu_reference(&c, 0.1, &unknown, &[ones, zeros], true);
        both(colors.each_ref().map(|[right_side, ..]| right_side), 121).row(2).to_vec()
    }

    #[test]
    fn slopes_are_not_flattened() {
        let pulls = pulls(|x| 0.2 * x.min(80.0));
        // Both sides are on the slope.
        assert!(pulls[17..64].iter().all(|pull| pull.abs() < 1e-12), "{pulls:?}");
        // The end of the slope.
        assert!(pulls[80] < -1e-3, "{pulls:?}");
    }

    #[test]
    fn a_jump_does_not_count_as_slope() {
        // The pull on either side is that of the whole jump: a = α φ, with φ of a rise of 2 px² per pixel.
        let pulls = pulls(|x| if x < 30.0 { 1.0 } else { 5.0 });
        let (a, flat) = (0.1 / (2.0f64.powi(2) + 0.01).sqrt(), 0.1 / 0.1);
        let expected = 4.0 * a / (1.0 + 3.0 * a + 0.5 * (flat + a));
        assert!((pulls[29] - expected).abs() < 1e-6 && (pulls[30] + expected).abs() < 1e-6, "{pulls:?} {expected}");
    }

    /// Lemma 1 of the paper, which implies that relaxation converges for all photographs.
    #[test]
    fn is_diagonally_dominant() {
        let c = Constants { width: 41, height: 30, alpha: 1.0, rate: 1.0, smoothness_eta: 0.1 };
        for seed in 0..6 {
            let [mut v, d, b] = [1, 2, 3].map(|n| random_field(41, 30, 10 * seed + n));
            v.data.iter_mut().for_each(|v| *v = 12.0 * (*v - 0.5));
            for [_, weights @ ..] in cpu_reference(&c, 0.01, &v, &[d, b], false).0 {
                for i in 0..weights[0].data.len() {
                    let row = weights.each_ref().map(|weight| weight.data[i]);
                    assert!(row.iter().all(|w| *w >= 0.0) && row.iter().sum::<f64>() <= 1.0 + 1e-12, "{row:?} at {i}");
                }
            }
        }
    }
}
