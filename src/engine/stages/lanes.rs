//! Several numbers that are computed with at once.

use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

use super::{Number, Real};

/// The number of lanes: two registers of AVX2 in double precision, one in single.
pub(super) const LANES: usize = 8;

/// A number in each lane.
#[derive(Clone, Copy)]
pub(super) struct Lanes<N>([N; LANES]);

/// Runs a loop with the widest instructions that the processor has. The closure must be `#[inline(always)]`, as must be
/// what it calls. Results do not depend on the instructions: none fuses operations.
#[inline]
pub(super) fn vectorised<T>(compute: impl FnOnce() -> T) -> T {
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    if let Some(avx2) = fearless_simd::Level::new().as_avx2() {
        return fearless_simd::Simd::vectorize(avx2, compute);
    }
    compute()
}

impl<N: Number> Lanes<N> {
    /// Numbers from a place of a slice on.
    #[inline(always)]
    pub(super) fn load(numbers: &[N], place: usize) -> Self {
        let mut lanes = [N::default(); LANES];
        lanes.copy_from_slice(&numbers[place..place + LANES]);
        Self(lanes)
    }

    /// Writes the numbers to a slice, from a place on.
    #[inline(always)]
    pub(super) fn store(self, numbers: &mut [N], place: usize) {
        numbers[place..place + LANES].copy_from_slice(&self.0);
    }

    /// The sum of all lanes.
    #[inline(always)]
    pub(super) fn sum(self) -> f64 {
        self.0.iter().map(|&number| -> f64 { number.into() }).sum()
    }

    #[inline(always)]
    fn each(self, other: Self, compute: impl Fn(N, N) -> N) -> Self {
        let mut lanes = self.0;
        for (lane, other) in lanes.iter_mut().zip(other.0) {
            *lane = compute(*lane, other);
        }
        Self(lanes)
    }
}

macro_rules! operations {
    ($($operation:ident $function:ident,)*) => {$(
        impl<N: Number> $operation for Lanes<N> {
            type Output = Self;
            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                self.each(other, |a, b| a.$function(b))
            }
        }
    )*};
}
operations!(Add add, Sub sub, Mul mul, Div div,);

impl<N: Number> Neg for Lanes<N> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.each(self, |a, _| -a)
    }
}

impl<N: Number> AddAssign for Lanes<N> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<N: Number> Default for Lanes<N> {
    #[inline(always)]
    fn default() -> Self {
        Self([N::default(); LANES])
    }
}

impl<N: Number> Real for Lanes<N> {
    #[inline(always)]
    fn of(value: f64) -> Self {
        Self([N::of(value); LANES])
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.each(self, |a, _| a.sqrt())
    }
    #[inline(always)]
    fn abs(self) -> Self {
        self.each(self, |a, _| a.abs())
    }
    #[inline(always)]
    fn atan(self) -> Self {
        self.each(self, |a, _| a.atan())
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.each(other, N::max)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.each(other, N::min)
    }
    #[inline(always)]
    fn choose(self, if_positive: Self, otherwise: Self) -> Self {
        let mut lanes = otherwise.0;
        for (lane, (sign, value)) in lanes.iter_mut().zip(self.0.into_iter().zip(if_positive.0)) {
            *lane = sign.choose(value, *lane);
        }
        Self(lanes)
    }
}
