//! Fields of numbers with the border rule of the shaders, and cubic B-splines over them.
//!
//! The CPU reference of `glsl/include/border.glsl` and `glsl/include/spline.glsl`.

use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

use super::rows::{self, Rows};

/// A number, or several that are computed with at once.
pub trait Real:
    Copy
    + Default
    + Add<Output = Self>
    + AddAssign
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// The nearest number of this type.
    fn of(value: f64) -> Self;
    /// The square root.
    fn sqrt(self) -> Self;
    /// The magnitude.
    fn abs(self) -> Self;
    /// The arc tangent.
    fn atan(self) -> Self;
    /// The larger of both; `other` if either is not a number.
    fn max(self, other: Self) -> Self;
    /// The smaller of both; `other` if either is not a number.
    fn min(self, other: Self) -> Self;
    /// The first if this is 0 or more, else the second.
    fn choose(self, if_positive: Self, otherwise: Self) -> Self;
}

/// The type of a stored number: `f64` in tests and on the host, `f32` on the CPU device. Passes compute in double
/// precision unless they say otherwise.
pub trait Number: Real + Send + Sync + PartialOrd + Into<f64> + 'static {}

macro_rules! numbers {
    ($($kind:ident: $atan:expr,)*) => {$(
        impl Number for $kind {}
        impl Real for $kind {
            #[inline(always)]
            fn of(value: f64) -> Self {
                value as $kind
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                $kind::sqrt(self)
            }
            #[inline(always)]
            fn abs(self) -> Self {
                $kind::abs(self)
            }
            #[inline(always)]
            fn atan(self) -> Self {
                $atan(self)
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                if self > other { self } else { other }
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                if self < other { self } else { other }
            }
            #[inline(always)]
            fn choose(self, if_positive: Self, otherwise: Self) -> Self {
                if self >= 0.0 { if_positive } else { otherwise }
            }
        }
    )*};
}
numbers!(f32: arc_tangent, f64: f64::atan,);

/// The arc tangent without a branch, so that several are computed at once: reduced to at most tan(π/8), then a
/// polynomial with an error of 2e-8 (S. L. Moshier, Cephes, `atanf`).
#[inline(always)]
fn arc_tangent(x: f32) -> f32 {
    use std::f32::consts::{FRAC_PI_2, FRAC_PI_4};
    let a = x.abs();
    let inverted = if a > 1.0 { 1.0 / a } else { a };
    let is_wide = inverted > 0.414_213_57;
    let t = if is_wide { (inverted - 1.0) / (inverted + 1.0) } else { inverted };
    let z = t * t;
    let series = ((8.053_744_5e-2 * z - 1.387_768_6e-1) * z + 1.997_771_1e-1) * z - 3.333_295e-1;
    let reduced = series * z * t + t + if is_wide { FRAC_PI_4 } else { 0.0 };
    let angle = if a > 1.0 { FRAC_PI_2 - reduced } else { reduced };
    if x < 0.0 { -angle } else { angle }
}

/// `height` rows of `width` numbers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Raster<N> {
    /// Numbers per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row-major.
    pub data: Vec<N>,
}

/// A raster in double precision.
pub type Field = Raster<f64>;

impl<N: Number> Raster<N> {
    /// A raster with `value(x, y)` at each place. Rows are computed in parallel.
    pub fn from_fn(width: usize, height: usize, value: impl Fn(usize, usize) -> f64 + Sync) -> Self {
        let mut raster = Self::zeros(width, height);
        raster.fill_rows(|y, row| row.iter_mut().enumerate().for_each(|(x, v)| *v = N::of(value(x, y))));
        raster
    }

    /// Rasters with the numbers of `values(x, y)` at each place, one each. Rows are computed in parallel.
    pub(crate) fn several<const COUNT: usize>(
        [width, height]: [usize; 2],
        values: impl Fn(usize, usize) -> [f64; COUNT] + Sync,
    ) -> [Self; COUNT] {
        let mut rasters = [(); COUNT].map(|()| Self::zeros(width, height));
        rows::map(rasters.each_mut().map(Rows::from), |y, mut rows| {
            for x in 0..width {
                rows.iter_mut().zip(values(x, y)).for_each(|(row, value)| row[x] = N::of(value));
            }
        });
        rasters
    }

    /// Calls `fill(y, row)` for each row, in parallel if there are many pixels.
    pub(crate) fn fill_rows(&mut self, fill: impl Fn(usize, &mut [N]) + Sync) {
        rows::map([self.into()], |y, [row]| fill(y, row));
    }

    /// A raster of zeros.
    pub fn zeros(width: usize, height: usize) -> Self {
        Self { width, height, data: vec![N::default(); width * height] }
    }

    /// The number at a place inside.
    pub fn get(&self, x: usize, y: usize) -> f64 {
        self.data[y * self.width + x].into()
    }

    /// The number at a place, mirrored about the border pixels.
    pub fn mirrored(&self, x: isize, y: isize) -> f64 {
        self.get(mirror(x, self.width), mirror(y, self.height))
    }

    /// The number at the nearest place inside.
    pub fn clamped(&self, x: isize, y: isize) -> f64 {
        self.get(x.clamp(0, self.width as isize - 1) as usize, y.clamp(0, self.height as isize - 1) as usize)
    }

    /// Sets the number at a place inside.
    pub fn set(&mut self, x: usize, y: usize, value: f64) {
        self.data[y * self.width + x] = N::of(value);
    }

    /// A row.
    pub(crate) fn row(&self, y: usize) -> &[N] {
        &self.data[y * self.width..][..self.width]
    }
}

impl<'a, N: Number> From<&'a mut Raster<N>> for Rows<'a, N> {
    fn from(raster: &'a mut Raster<N>) -> Self {
        Self { width: raster.width, numbers: &mut raster.data }
    }
}

impl Field {
    /// From the numbers of an image on the device.
    pub fn from_f32(width: usize, height: usize, data: &[f32]) -> Self {
        Self { width, height, data: data.iter().map(|&v| f64::from(v)).collect() }
    }

    /// The corner of a wider image on the device with `row` numbers per row.
    pub(crate) fn corner(data: &[f32], row: usize, [width, height]: [usize; 2]) -> Self {
        let mut corner = Self { width, height, data: Vec::with_capacity(width * height) };
        for row in data.chunks_exact(row).take(height) {
            corner.data.extend(row[..width].iter().map(|&v| f64::from(v)));
        }
        corner
    }

    /// As numbers of an image on the device.
    pub fn to_f32(&self) -> Vec<f32> {
        self.data.iter().map(|&v| v as f32).collect()
    }
}

/// Reflects about 0 and `size - 1`, repeatedly.
pub fn mirror(i: isize, size: usize) -> usize {
    fold(i, 2 * (size - 1))
}

/// Reflects about 0 and half a period, repeatedly.
pub fn fold(i: isize, period: usize) -> usize {
    let j = i.unsigned_abs() % period.max(1);
    j.min(period.max(1) - j)
}

/// Value, gradient and Laplacian of a spline at one place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Jet<R = f64> {
    /// Value.
    pub value: R,
    /// Derivative to the right.
    pub dx: R,
    /// Derivative downwards.
    pub dy: R,
    /// Second derivatives, added.
    pub laplacian: R,
}

/// Weights of four coefficients at a fraction `t` after the second, with their first and second derivatives.
#[inline]
pub(crate) fn weights(t: f64) -> [[f64; 4]; 3] {
    let u = 1.0 - t;
    [
        [u * u * u / 6.0, 2.0 / 3.0 - t * t + t * t * t / 2.0, 2.0 / 3.0 - u * u + u * u * u / 2.0, t * t * t / 6.0],
        [-u * u / 2.0, 1.5 * t * t - 2.0 * t, 2.0 * u - 1.5 * u * u, t * t / 2.0],
        [u, 3.0 * t - 2.0, 3.0 * u - 2.0, t],
    ]
}

impl<R: Real> Jet<R> {
    /// The spline at a small shift, to first order.
    ///
    /// Not to second order: at frequency ω the second derivative of a cubic spline on the pixels, `-6 (1 - cos ω)/(2 +
    /// cos ω)`, outweighs the square of its first. Noise would then fall with the shift, all over the image, and T
    /// would drift from where I2 was last warped: by 0.2 px on the dimple pair, whose texture is weak.
    #[inline(always)]
    pub fn moved(self, [x, y]: [R; 2]) -> Self {
        Self { value: self.value + self.dx * x + self.dy * y, ..self }
    }

    /// A Gaussian's node, and its slope by the variance: half the Laplacian.
    #[inline(always)]
    pub(super) fn node(self) -> (Self, R) {
        (self, R::of(0.5) * self.laplacian)
    }
}

/// The spline at pixel (x, y), from nine coefficients instead of sixteen.
pub fn near<N: Number>(coefficients: &Raster<N>, x: usize, y: usize) -> Jet {
    let (width, height) = (coefficients.width, coefficients.height);
    let beside = |i: usize, size: usize| match i {
        _ if i > 0 && i + 1 < size => [i - 1, i, i + 1],
        _ => [-1, 0, 1].map(|n| mirror(i as isize + n, size)),
    };
    let (columns, rows) = (beside(x, width), beside(y, height));
    // Along x of each row: value, slope and bend.
    let along = rows.map(|row| {
        let row = coefficients.row(row);
        let [before, here, behind]: [f64; 3] = columns.map(|column| row[column].into());
        [(before + 4.0 * here + behind) / 6.0, (behind - before) / 2.0, before - 2.0 * here + behind]
    });
    let value = |n: usize| (along[0][n] + 4.0 * along[1][n] + along[2][n]) / 6.0;
    let (dx, dy) = (value(1), (along[2][0] - along[0][0]) / 2.0);
    let laplacian = value(2) + along[0][0] - 2.0 * along[1][0] + along[2][0];
    Jet { value: value(0), dx, dy, laplacian }
}

/// The spline of these coefficients at (x, y), pixels.
#[inline]
pub fn read<N: Number>(coefficients: &Raster<N>, x: f64, y: f64) -> Jet {
    // Clamped, so that the index stays within an integer.
    let x = x.clamp(-1.0, coefficients.width as f64);
    let y = y.clamp(-1.0, coefficients.height as f64);
    let (column, row) = (x.floor(), y.floor());
    let (wx, wy) = (weights(x - column), weights(y - row));
    let near = |first: f64, size: usize| {
        let first = first as isize - 1;
        if first >= 0 && first as usize + 3 < size {
            return [0, 1, 2, 3].map(|i| first as usize + i);
        }
        [0, 1, 2, 3].map(|i| mirror(first + i, size))
    };
    let (columns, rows) = (near(column, coefficients.width), near(row, coefficients.height));
    let mut jet = Jet::default();
    for j in 0..4 {
        let [weight, slope, bend] = wy.map(|w| w[j]);
        let coefficients = coefficients.row(rows[j]);
        let mut line = [0.0; 3];
        for i in 0..4 {
            let c: f64 = coefficients[columns[i]].into();
            for (sum, w) in line.iter_mut().zip(&wx) {
                *sum += w[i] * c;
            }
        }
        jet.value += weight * line[0];
        jet.dx += weight * line[1];
        jet.dy += slope * line[0];
        jet.laplacian += weight * line[2] + bend * line[0];
    }
    jet
}

#[cfg(test)]
mod tests {
    use super::super::harness::smooth_field;
    use super::*;

    #[test]
    fn near_a_pixel_the_first_order_is_exact_enough() {
        let coefficients = smooth_field(24, 17, 1);
        for (x, y) in [(0, 0), (5, 7), (23, 16), (23, 3)] {
            let on = near(&coefficients, x, y);
            let there = read(&coefficients, x as f64, y as f64);
            for (actual, expected) in
                [(on.value, there.value), (on.dx, there.dx), (on.dy, there.dy), (on.laplacian, there.laplacian)]
            {
                assert!((actual - expected).abs() < 1e-12, "({x}, {y}): {actual} {expected}");
            }
            // Second derivatives of up to 0.5 per squared pixel leave 0.5 · 0.02²/2.
            let actual = near(&coefficients, x, y).moved([0.02, -0.01]).value;
            let expected = read(&coefficients, x as f64 + 0.02, y as f64 - 0.01).value;
            assert!((actual - expected).abs() < 1e-4, "({x}, {y}): {actual} {expected}");
        }
    }

    #[test]
    fn the_arc_tangent_is_that_of_the_standard_library() {
        for n in -4000..=4000 {
            let x = (f64::from(n) / 200.0).powi(3) as f32;
            assert!((f64::from(arc_tangent(x)) - f64::from(x).atan()).abs() < 2e-7, "{x}");
        }
        assert_eq!(arc_tangent(f32::INFINITY), std::f32::consts::FRAC_PI_2);
    }

    #[test]
    fn mirror_reflects_about_the_border_pixels() {
        let expected = [1, 0, 1, 2, 1, 0, 1, 2, 1, 0];
        let actual: Vec<usize> = (-5..5).map(|i| mirror(i, 3)).collect();
        assert_eq!(actual, expected);
        assert_eq!(mirror(-7, 1), 0);
    }
}
