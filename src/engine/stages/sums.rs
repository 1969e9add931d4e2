//! The sums of the registration step, and the layout of a row of partial sums.
//!
//! The CPU reference of `glsl/include/sums.glsl`.
//!
//! ```text
//! unknown        t_x     t_y     zoom    turn     stretch  shear   g_x          g_y
//! displaces by   (1, 0)  (0, 1)  (x, y)  (-y, x)  (x, -y)  (y, x)  (-xx, -xy)   (-xy, -yy)
//! ```
//!
//! (x, y) is from the centre, divided by L. Motion models use the first 2, 4, 6 or 8 unknowns.

use super::Number;
use crate::engine::vulkan::Variant;

/// Unknowns of the registration step, each in pixels of the level.
pub const UNKNOWNS: usize = 8;

/// The displacement by one pixel of each unknown, at a place from the centre divided by L.
pub fn displacements([x, y]: [f64; 2]) -> [[f64; 2]; UNKNOWNS] {
    [[1.0, 0.0], [0.0, 1.0], [x, y], [-y, x], [x, -y], [y, x], [-x * x, -x * y], [-x * y, -y * y]]
}

/// The sums of the registration step over the valid pixels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sums {
    /// N.
    pub normal: [[f64; UNKNOWNS]; UNKNOWNS],
    /// g.
    pub gradient: [f64; UNKNOWNS],
    /// Energy.
    pub energy: f64,
    /// Valid pixels.
    pub valid: f64,
    /// Sums of √|b| and of |∇V|.
    pub roughness: [f64; 2],
    /// Sum of bounded squares of differences of S between adjacent pixels.
    pub spread: f64,
    /// Sums of b² and of D.
    pub variance: [f64; 2],
    /// The number of rows: workgroups, each of a tile of pixels.
    pub tiles: f64,
    /// The variance of g of t_x plus that of t_y, by the scatter over the tiles; 0 of one tile.
    pub scatter: f64,
}

/// The layout of a row of partial sums.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Unknowns that N has sums for.
    pub unknowns: usize,
    /// First of the sums of w ∇J S, after those of w ∇J ∇Jᵀ.
    pub gradient: usize,
    /// Place of the energy. The valid pixels follow, then √|b|, |∇V|, the spread, b² and D.
    pub energy: usize,
    /// Floats per row.
    pub length: usize,
}

impl Layout {
    /// The layout for affine maps or homographies.
    pub const fn of(projective: bool) -> Self {
        if projective {
            Self { unknowns: 8, gradient: 45, energy: 57, length: 64 }
        } else {
            Self { unknowns: 6, gradient: 18, energy: 24, length: 32 }
        }
    }

    /// The layout of a variant of a stage.
    pub(crate) fn of_variant(variant: Variant) -> Self {
        Self::of(variant.has(Variant::PROJECTIVE))
    }
}

/// The monomial that an unknown displaces by along one axis: its sign and its powers of x and y.
type Along = (f64, [usize; 2]);

const ALONG: [[Along; 2]; UNKNOWNS] = [
    [(1.0, [0, 0]), (0.0, [0, 0])],
    [(0.0, [0, 0]), (1.0, [0, 0])],
    [(1.0, [1, 0]), (1.0, [0, 1])],
    [(-1.0, [0, 1]), (1.0, [1, 0])],
    [(1.0, [1, 0]), (-1.0, [0, 1])],
    [(1.0, [0, 1]), (1.0, [1, 0])],
    [(-1.0, [2, 0]), (-1.0, [1, 1])],
    [(-1.0, [1, 1]), (-1.0, [0, 2])],
];

/// The index of a monomial.
fn monomial([x, y]: [usize; 2]) -> usize {
    (x + y) * (x + y + 1) / 2 + y
}

impl Sums {
    /// From rows of partial sums. Sums that the layout lacks are 0.
    pub fn from_partials<N: Number>(partials: &[N], layout: Layout) -> Self {
        let total = |n: usize| partials.chunks_exact(layout.length).map(|row| row[n].into()).sum::<f64>();
        let row: Vec<f64> = (0..layout.length).map(total).collect();
        let mut sums = Self {
            energy: row[layout.energy],
            valid: row[layout.energy + 1],
            roughness: [row[layout.energy + 2], row[layout.energy + 3]],
            spread: row[layout.energy + 4],
            variance: [row[layout.energy + 5], row[layout.energy + 6]],
            tiles: (partials.len() / layout.length) as f64,
            ..Self::default()
        };
        for n in [layout.gradient, layout.gradient + 1] {
            let squares: f64 = partials.chunks_exact(layout.length).map(|row| row[n].into().powi(2)).sum();
            let about_mean = (squares - row[n] * row[n] / sums.tiles.max(1.0)).max(0.0);
            sums.scatter += about_mean * sums.tiles / (sums.tiles - 1.0).max(1.0);
        }
        for (i, a) in ALONG[..layout.unknowns].iter().enumerate() {
            for (c, (sign, powers)) in a.iter().enumerate() {
                sums.gradient[i] += sign * row[layout.gradient + 2 * monomial(*powers) + c];
            }
            for (j, b) in ALONG[..layout.unknowns].iter().enumerate() {
                for (c, d) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    let ((sign, p), (other, q)) = (a[c], b[d]);
                    let place = 3 * monomial([p[0] + q[0], p[1] + q[1]]) + c + d;
                    sums.normal[i][j] += sign * other * row[place];
                }
            }
        }
        sums
    }
}

/// Sums over pixels of one line, by the powers of X: Y is the same for all. The others are as in [`Sums`].
#[derive(Default)]
pub(super) struct Line {
    /// w ∇J ∇Jᵀ: xx, xy, yy.
    pub(super) normal: [[f64; 5]; 3],
    /// w ∇J S.
    pub(super) gradient: [[f64; 3]; 2],
    pub(super) energy: f64,
    pub(super) valid: f64,
    pub(super) roughness: [f64; 2],
    pub(super) spread: f64,
    pub(super) variance: [f64; 2],
}

impl Line {
    /// Adds a pixel at X, from the centre divided by L: w ∇J ∇Jᵀ and w ∇J S.
    pub(super) fn add(&mut self, normal: [f64; 3], gradient: [f64; 2], x: f64) {
        let powers = [1.0, x, x * x, x * x * x, x * x * x * x];
        for (sums, n) in self.normal.iter_mut().zip(normal) {
            sums.iter_mut().zip(powers).for_each(|(sum, power)| *sum += n * power);
        }
        for (sums, g) in self.gradient.iter_mut().zip(gradient) {
            sums.iter_mut().zip(powers).for_each(|(sum, power)| *sum += g * power);
        }
    }

    /// Adds the line at Y to a row of partial sums.
    pub(super) fn add_to(&self, row: &mut [f64], y: f64, layout: Layout) {
        let degree = if layout.unknowns == UNKNOWNS { 4 } else { 2 };
        for (j, power) in (0..=degree).zip([1.0, y, y * y, y * y * y, y * y * y * y]) {
            for i in 0..=degree - j {
                let place = monomial([i, j]);
                (0..3).for_each(|c| row[3 * place + c] += self.normal[c][i] * power);
                if i + j <= degree / 2 {
                    (0..2).for_each(|c| row[layout.gradient + 2 * place + c] += self.gradient[c][i] * power);
                }
            }
        }
        let [[r0, r1], [b2, d]] = [self.roughness, self.variance];
        let rest = [self.energy, self.valid, r0, r1, self.spread, b2, d];
        row[layout.energy..].iter_mut().zip(rest).for_each(|(sum, own)| *sum += own);
    }
}

#[cfg(test)]
impl Sums {
    /// Adds a pixel at a place from the centre divided by L: w ∇J ∇Jᵀ (xx, xy, yy) and w ∇J S.
    pub(crate) fn add(&mut self, [xx, xy, yy]: [f64; 3], g: [f64; 2], place: [f64; 2]) {
        let by = displacements(place);
        for (i, a) in by.iter().enumerate() {
            self.gradient[i] += a[0] * g[0] + a[1] * g[1];
            for (j, b) in by.iter().enumerate() {
                self.normal[i][j] += xx * a[0] * b[0] + xy * (a[0] * b[1] + a[1] * b[0]) + yy * a[1] * b[1];
            }
        }
    }
}

/// A row of partial sums of residuals of weight 1: ∇J, S and place.
#[cfg(test)]
pub(crate) fn row(residuals: &[([f64; 2], f64, [f64; 2])], layout: Layout) -> Vec<f32> {
    let mut row = vec![0.0; layout.length];
    let most = if layout.unknowns == 8 { 4 } else { 2 };
    for ([jx, jy], s, [x, y]) in residuals {
        let powers = (0..=most).flat_map(|d| (0..=d).map(move |k| [d - k, k]));
        for powers in powers {
            let term = x.powi(powers[0] as i32) * y.powi(powers[1] as i32);
            let n = monomial(powers);
            for (c, product) in [jx * jx, jx * jy, jy * jy].into_iter().enumerate() {
                row[3 * n + c] += product * term;
            }
            if powers[0] + powers[1] <= most / 2 {
                row[layout.gradient + 2 * n] += jx * s * term;
                row[layout.gradient + 2 * n + 1] += jy * s * term;
            }
        }
        row[layout.energy] += s.abs();
        row[layout.energy + 1] += 1.0;
    }
    row.into_iter().map(|v: f64| v as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_over_monomials_are_those_over_unknowns() {
        let numbers = crate::engine::stages::harness::random(5 * 20, 3);
        let residuals: Vec<_> = numbers
            .chunks_exact(5)
            .map(|n| ([n[0] - 0.5, n[1] - 0.5], n[2] - 0.5, [4.0 * n[3] - 2.0, 4.0 * n[4] - 2.0]))
            .collect();
        let mut expected = Sums::default();
        for ([jx, jy], s, place) in &residuals {
            expected.add([jx * jx, jx * jy, jy * jy], [jx * s, jy * s], *place);
        }
        for projective in [false, true] {
            let layout = Layout::of(projective);
            let mut line_by_line = vec![0.0; layout.length];
            for ([jx, jy], s, [x, y]) in &residuals {
                let mut line = Line { energy: s.abs(), valid: 1.0, ..Line::default() };
                line.add([jx * jx, jx * jy, jy * jy], [jx * s, jy * s], *x);
                line.add_to(&mut line_by_line, *y, layout);
            }
            let of_device = row(&residuals, layout);
            let same = line_by_line.iter().zip(&of_device).all(|(a, e)| (a - f64::from(*e)).abs() < 1e-4);
            assert!(same, "{line_by_line:?} {of_device:?}");
            let actual = Sums::from_partials(&of_device, layout);
            for i in 0..layout.unknowns {
                assert!((actual.gradient[i] - expected.gradient[i]).abs() < 1e-4, "{i}");
                for j in 0..layout.unknowns {
                    // Sums of 20 terms of up to 16, in single precision.
                    assert!((actual.normal[i][j] - expected.normal[i][j]).abs() < 1e-4, "{i} {j}");
                }
            }
        }
    }
}
