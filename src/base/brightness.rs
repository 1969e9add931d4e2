//! The brightness match of two photographs: gain, offset, and a smooth shading.

use std::ops::{Add, Mul, Sub};

use crate::base::{Photometric, Region, centre};

/// The brightness match of a pair: `gain · shading(x) · I2(x) + offset` has the brightness of I1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Brightness {
    /// Gain and offset, in intensities.
    pub photometric: Photometric,
    /// The variation of the gain over `part`.
    pub shading: Shading,
    /// The region of I2 over which the shading is defined, px: the whole frame unless a region was solved.
    pub part: Region,
}

impl Brightness {
    /// The identity, for a photograph of `size` pixels.
    pub fn identity(size: [u32; 2]) -> Self {
        Self {
            photometric: Photometric::IDENTITY,
            shading: Shading::NONE,
            part: Region { x: 0, y: 0, width: size[0], height: size[1] },
        }
    }

    /// Returns the factor of the shading at a point of I2, px. Points outside of `part` have that of the nearest point
    /// of it.
    pub fn factor(&self, point: [f64; 2]) -> f64 {
        self.shading.at([self.normalized(0, point[0]), self.normalized(1, point[1])])
    }

    /// Returns a coordinate along x (0) or y (1) relative to `part`, -1 to 1.
    fn normalized(&self, axis: usize, coordinate: f64) -> f64 {
        let (first, half) = ([self.part.x, self.part.y], centre(self.part.width, self.part.height));
        // A part one pixel wide has only its centre, 0.
        let from_centre = (coordinate - f64::from(first[axis]) - half[axis]) / half[axis].max(0.5);
        from_centre.clamp(-1.0, 1.0)
    }

    /// Returns an intensity at a point of I2, px, with the brightness of I1.
    pub fn apply(&self, intensity: f64, point: [f64; 2]) -> f64 {
        self.photometric.gain * self.factor(point) * intensity + self.photometric.offset
    }

    /// Applies the match to a row of I2 with interleaved channels, in place. It is several times faster than
    /// [`apply`](Self::apply), and equal except for rounding.
    pub(crate) fn apply_to_row(&self, row: &mut [f32], channels: usize, y: usize) {
        self.apply_along(row, channels, y as f64, |x| x as f64);
    }

    /// Applies the match to values at y of I2, interleaved, in place. `x` returns the coordinate of the n-th pixel.
    pub(crate) fn apply_along(&self, row: &mut [f32], channels: usize, y: f64, x: impl Fn(usize) -> f64) {
        let factor = self.shading.along_row(self.normalized(1, y));
        let Photometric { gain, offset } = self.photometric;
        for (n, pixel) in row.chunks_exact_mut(channels).enumerate() {
            let gain = gain * factor(self.normalized(0, x(n)));
            pixel.iter_mut().for_each(|value| *value = (gain * f64::from(*value) + offset) as f32);
        }
    }
}

/// The largest sum of the degrees along x and y.
const DEGREE: usize = 4;

/// Positive nodes and weights of the Gauss-Legendre rule with 8 nodes. It is exact to degree 15; a term times the
/// product of two shadings has degree 12.
const NODES: [[f64; 2]; 4] = [
    [0.183_434_642_495_649_8, 0.362_683_783_378_362],
    [0.525_532_409_916_329, 0.313_706_645_877_887_3],
    [0.796_666_477_413_626_7, 0.222_381_034_453_374_5],
    [0.960_289_856_497_536_3, 0.101_228_536_290_376_3],
];

/// A smooth factor on I2: a polynomial of degree 4 in the position, with mean 1.
///
/// The paper assumes equal exposures. In practice vignetting changes with focus, and a lamp may move with the stage.
/// Without the factor such gradients appear as motion or blur. `glsl/include/shading.glsl` computes the same.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Shading {
    /// Coefficients of the products P_i(x) P_j(y) of Legendre polynomials, positions from -1 to 1 along each side, in
    /// the order x, y, xx, xy, yy, xxx, ... The constant term is 1 and omitted.
    pub coefficients: [f64; Shading::TERMS],
}

impl Shading {
    /// The number of coefficients.
    pub const TERMS: usize = (DEGREE + 1) * (DEGREE + 2) / 2 - 1;
    /// The factor 1 everywhere.
    pub const NONE: Self = Self { coefficients: [0.0; Self::TERMS] };

    /// Returns the factor at a position from -1 to 1 along each side, clamped to 1/4 to 4.
    pub fn at(&self, position: [f64; 2]) -> f64 {
        self.factor(position, |c| c).clamp(0.25, 4.0)
    }

    /// Returns the factor before it is clamped, in numbers of any type. `of` converts to them.
    #[inline(always)]
    pub(crate) fn factor<T: Arithmetic>(&self, position: [T; 2], of: impl Fn(f64) -> T) -> T {
        let (terms, mut sum) = (terms_of(position, &of), of(1.0));
        for n in 0..Self::TERMS {
            sum = sum + of(self.coefficients[n]) * terms[n + 1];
        }
        sum
    }

    /// Returns the factors of a row at y, -1 to 1, as a function of x. They equal [`at`](Self::at) except for rounding.
    pub(crate) fn along_row(&self, y: f64) -> impl Fn(f64) -> f64 + use<> {
        let py = legendre(y, &|c| c);
        let mut a = [0.0; DEGREE + 1];
        for (c, (i, j)) in std::iter::once(&1.0).chain(&self.coefficients).zip(degrees()) {
            a[i] += c * py[j];
        }
        // The coefficients of the powers of x.
        let powers =
            [a[0] - 0.5 * a[2] + 0.375 * a[4], a[1] - 1.5 * a[3], 1.5 * a[2] - 3.75 * a[4], 2.5 * a[3], 4.375 * a[4]];
        move |x| powers.iter().rev().fold(0.0, |sum, power| sum * x + power).clamp(0.25, 4.0)
    }

    /// Returns the mean of a smooth function of the position, -1 to 1 along each side, and the shading whose product
    /// with the mean is the least-squares fit to the function. The shading is [`NONE`](Self::NONE) if the mean is not
    /// positive.
    pub fn fit(function: impl Fn([f64; 2]) -> f64) -> (f64, Self) {
        let nodes = || NODES.iter().flat_map(|&[x, weight]| [[x, weight], [-x, weight]]);
        let mut sums = [0.0; Self::TERMS + 1];
        for [y, down] in nodes() {
            for [x, across] in nodes() {
                let weighted = 0.25 * across * down * function([x, y]);
                let terms = terms([x, y]);
                sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += weighted * term);
            }
        }
        let mean = sums[0];
        if mean <= 0.0 {
            return (mean, Self::NONE);
        }
        // The mean square of P_i is 1/(2i + 1).
        let norms = degrees().map(|(i, j)| ((2 * i + 1) * (2 * j + 1)) as f64);
        let coefficients: Vec<f64> = sums.iter().zip(norms).skip(1).map(|(sum, norm)| sum * norm / mean).collect();
        (mean, Self { coefficients: std::array::from_fn(|n| coefficients[n]) })
    }

    /// Returns the least and the greatest factor, on a grid of 33 x 33 positions.
    pub fn range(&self) -> [f64; 2] {
        let steps = || (-16..=16).map(|i| f64::from(i) / 16.0);
        let all = steps().flat_map(|y| steps().map(move |x| [x, y]));
        all.map(|position| self.at(position)).fold([f64::INFINITY, 0.0], |[low, high], f| [low.min(f), high.max(f)])
    }
}

/// Returns the terms of the polynomial at a position, the constant one first.
pub(crate) fn terms(position: [f64; 2]) -> [f64; Shading::TERMS + 1] {
    terms_of(position, &|c| c)
}

/// Numbers that polynomials are computed of.
pub(crate) trait Arithmetic: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {}
impl<T: Copy + Add<Output = T> + Sub<Output = T> + Mul<Output = T>> Arithmetic for T {}

#[inline(always)]
fn terms_of<T: Arithmetic>(position: [T; 2], of: &impl Fn(f64) -> T) -> [T; Shading::TERMS + 1] {
    let (px, py) = (legendre(position[0], of), legendre(position[1], of));
    let (mut terms, mut n) = ([px[0]; Shading::TERMS + 1], 0);
    for sum in 0..DEGREE + 1 {
        for j in 0..sum + 1 {
            terms[n] = px[sum - j] * py[j];
            n += 1;
        }
    }
    terms
}

/// The degrees along x and y of each term.
fn degrees() -> impl Iterator<Item = (usize, usize)> {
    (0..=DEGREE).flat_map(|sum| (0..=sum).map(move |j| (sum - j, j)))
}

/// Returns the Legendre polynomials of degree 0 to 4 at x.
#[inline(always)]
fn legendre<T: Arithmetic>(x: T, of: &impl Fn(f64) -> T) -> [T; DEGREE + 1] {
    let s = x * x;
    let cubic = (of(2.5) * s - of(1.5)) * x;
    [of(1.0), x, of(1.5) * s - of(0.5), cubic, (of(4.375) * s - of(3.75)) * s + of(0.375)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_covers_its_part_and_is_constant_beyond() {
        let mut shading = Shading::NONE;
        shading.coefficients[0] = 0.1;
        let part = Region { x: 10, y: 20, width: 5, height: 3 };
        let brightness = Brightness { photometric: Photometric { gain: 2.0, offset: 0.5 }, shading, part };
        for (x, factor) in [(0.0, 0.9), (10.0, 0.9), (12.0, 1.0), (13.0, 1.05), (14.0, 1.1), (99.0, 1.1)] {
            assert!((brightness.factor([x, 7.0]) - factor).abs() < 1e-12, "{x}");
            assert!((brightness.apply(0.25, [x, 7.0]) - (0.5 * factor + 0.5)).abs() < 1e-12);
        }
        let mut row = [0.25f32; 40];
        brightness.apply_to_row(&mut row, 2, 7);
        for (i, value) in row.into_iter().enumerate() {
            assert!((f64::from(value) - brightness.apply(0.25, [(i / 2) as f64, 7.0])).abs() < 1e-7, "{i}");
        }
        assert_eq!(Brightness::identity([1, 1]).apply(0.3, [0.0, 0.0]), 0.3);
    }

    #[test]
    fn terms_are_orthogonal_with_mean_zero() {
        let steps = || (0..200).map(|i| (f64::from(i) + 0.5) / 100.0 - 1.0);
        for i in 0..=Shading::TERMS {
            for j in 0..i {
                let all = steps().flat_map(|y| steps().map(move |x| terms([x, y])));
                let mean = all.map(|t| t[i] * t[j]).sum::<f64>() / 4e4;
                // The midpoint rule with 200 nodes per side.
                assert!(mean.abs() < 1e-3, "{i}, {j}: {mean}");
            }
        }
    }

    #[test]
    fn the_fit_to_a_scaled_shading_is_its_mean_and_the_shading() {
        let shading = Shading { coefficients: std::array::from_fn(|n| 0.02 * (1.7 * n as f64).sin()) };
        let (mean, found) = Shading::fit(|place| 1.5 * shading.at(place));
        assert!((mean - 1.5).abs() < 1e-12);
        for (found, expected) in found.coefficients.iter().zip(shading.coefficients) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
    }

    #[test]
    fn the_factors_along_a_row_are_those_at_its_positions() {
        let shading = Shading { coefficients: std::array::from_fn(|n| 0.1 * (1.7 * n as f64).sin()) };
        for (x, y) in [(-1.0, 0.3), (-0.4, -1.0), (0.0, 0.0), (0.7, 0.9), (1.0, 1.0)] {
            assert!((shading.along_row(y)(x) - shading.at([x, y])).abs() < 1e-12, "{x} {y}");
        }
    }

    #[test]
    fn a_ramp_ranges_from_side_to_side() {
        let mut ramp = Shading::NONE;
        ramp.coefficients[0] = 0.1;
        assert_eq!(ramp.range(), [0.9, 1.1]);
        assert_eq!(Shading::NONE.range(), [1.0, 1.0]);
    }
}
