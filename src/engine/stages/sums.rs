//! The registration integrals, and how a workgroup's row of them lies in memory: the twin of `glsl/include/sums.glsl`.

/// Unknowns of the registration step: a L, b L, t_x, t_y (pixels of the level), gain, offset at intensity ½.
pub const UNKNOWNS: usize = 6;
/// Floats in a row of partial sums.
pub const SUMS: usize = 32;
/// Where g, the energy and the number of valid pixels stand among them.
pub const GRADIENT: usize = 21;
/// See [`GRADIENT`].
pub const ENERGY: usize = 27;
/// See [`GRADIENT`].
pub const VALID: usize = 28;
/// What the registration step sums over the valid pixels.
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
}

impl Sums {
    /// From rows of partial sums as the device keeps them: the upper triangle of N row by row, g, energy, valid pixels
    /// (`glsl/include/sums.glsl`).
    pub fn from_partials(partials: &[f32]) -> Self {
        let total = |n: usize| partials.chunks_exact(SUMS).map(|row| f64::from(row[n])).sum::<f64>();
        let mut sums = Self { energy: total(ENERGY), valid: total(VALID), ..Self::default() };
        for i in 0..UNKNOWNS {
            for j in i..UNKNOWNS {
                sums.normal[i][j] = total(normal_place(i, j));
                sums.normal[j][i] = sums.normal[i][j];
            }
        }
        sums.gradient = std::array::from_fn(|i| total(GRADIENT + i));
        sums
    }
}

/// Where a row of partial sums keeps N between unknowns i and j >= i.
pub(crate) fn normal_place(i: usize, j: usize) -> usize {
    i * UNKNOWNS - i * i.saturating_sub(1) / 2 + j - i
}
