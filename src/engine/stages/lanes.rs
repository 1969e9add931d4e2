//! Several numbers that are computed with at once.

use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};
#[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
use std::sync::LazyLock;

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
    {
        // Looking for all features takes as long as a short row.
        static LEVEL: LazyLock<fearless_simd::Level> = LazyLock::new(fearless_simd::Level::new);
        let level = *LEVEL;
        if let Some(avx512) = level.as_avx512() {
            return fearless_simd::Simd::vectorize(avx512, compute);
        }
        if let Some(avx2) = level.as_avx2() {
            return fearless_simd::Simd::vectorize(avx2, compute);
        }
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

    /// The first numbers of a slice, which may have fewer.
    #[inline(always)]
    pub(super) fn first_of(numbers: &[N]) -> Self {
        if numbers.len() >= LANES {
            return Self::load(numbers, 0);
        }
        let mut lanes = [N::default(); LANES];
        lanes[..numbers.len()].copy_from_slice(numbers);
        Self(lanes)
    }

    /// The integers from `first` on.
    #[inline(always)]
    pub(super) fn ramp(first: usize) -> Self {
        let mut lanes = [N::default(); LANES];
        for (n, lane) in lanes.iter_mut().enumerate() {
            *lane = N::of(first as f64) + N::of(n as f64);
        }
        Self(lanes)
    }

    /// The numbers, which are whole and of at most 31 bits, as integers.
    #[inline(always)]
    pub(super) fn integers(self) -> [isize; LANES] {
        // Numbers of this size end with their ones. A conversion would not be vectorised, since it has to saturate.
        const WHOLE: f64 = 1.5 * (1u64 << 52) as f64;
        let mut integers = [0; LANES];
        for n in 0..LANES {
            let number: f64 = self.0[n].into();
            integers[n] = (number + WHOLE).to_bits() as i32 as isize;
        }
        integers
    }

    /// Sets a lane.
    #[inline(always)]
    pub(super) fn set(&mut self, n: usize, number: N) {
        self.0[n] = number;
    }

    /// Writes the first numbers to all of a slice, if it has fewer.
    #[inline(always)]
    pub(super) fn store_first(self, numbers: &mut [N]) {
        let count = numbers.len().min(LANES);
        numbers[..count].copy_from_slice(&self.0[..count]);
    }

    /// Writes the numbers to a slice, from a place on.
    #[inline(always)]
    pub(super) fn store(self, numbers: &mut [N], place: usize) {
        numbers[place..place + LANES].copy_from_slice(&self.0);
    }

    /// The sum of all lanes.
    #[inline(always)]
    pub(super) fn sum(self) -> f64 {
        let mut sum = 0.0;
        for number in self.0 {
            sum += number.into();
        }
        sum
    }

    #[inline(always)]
    fn each(self, other: Self, compute: impl Fn(N, N) -> N) -> Self {
        let mut lanes = self.0;
        for n in 0..LANES {
            lanes[n] = compute(lanes[n], other.0[n]);
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
    fn floor(self) -> Self {
        self.each(self, |a, _| a.floor())
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
        for n in 0..LANES {
            lanes[n] = self.0[n].choose(if_positive.0[n], lanes[n]);
        }
        Self(lanes)
    }
    #[inline(always)]
    fn range(self) -> [f64; 2] {
        let [mut least, mut most] = [self.0; 2];
        let mut half = LANES / 2;
        while half > 0 {
            for n in 0..half {
                least[n] = least[n].min(least[n + half]);
                most[n] = most[n].max(most[n + half]);
            }
            half /= 2;
        }
        [least[0].into(), most[0].into()]
    }
}
