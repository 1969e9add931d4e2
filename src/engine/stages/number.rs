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
    ($($kind:ident,)*) => {$(
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
numbers!(f32, f64,);
