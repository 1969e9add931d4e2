//! The types of numbers that formulas are written for.

use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

/// A number that formulas are written for.
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
    /// The nearest numbers. `map` of an array is not compiled into vectorised loops.
    #[inline(always)]
    fn all<const COUNT: usize>(values: [f64; COUNT]) -> [Self; COUNT] {
        let mut numbers = [Self::default(); COUNT];
        for n in 0..COUNT {
            numbers[n] = Self::of(values[n]);
        }
        numbers
    }
    /// The square root.
    fn sqrt(self) -> Self;
    /// The magnitude.
    fn abs(self) -> Self;
    /// The largest integer that is not larger.
    fn floor(self) -> Self;
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
            fn floor(self) -> Self {
                $kind::floor(self)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arc_tangent_is_that_of_the_standard_library() {
        for n in -4000..=4000 {
            let x = (f64::from(n) / 200.0).powi(3) as f32;
            assert!((f64::from(arc_tangent(x)) - f64::from(x).atan()).abs() < 2e-7, "{x}");
        }
        assert_eq!(arc_tangent(f32::INFINITY), std::f32::consts::FRAC_PI_2);
    }
}
