//! Loops over adjacent pixels that are compiled to vector instructions.

#[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
use std::sync::LazyLock;

use super::Number;

/// Adjacent pixels that are computed together. Loops over them are short enough for the cache, and several vectors
/// long.
pub(super) const SEGMENT: usize = 32;

/// A number for each pixel of a segment.
pub(super) type Segment<N> = [N; SEGMENT];

/// Runs a loop over numbers of type N with the widest instructions that the processor has. The closure must be
/// `#[inline(always)]`, as must be what it calls. Results do not depend on the instructions: none fuses operations.
/// Double precision, which no solve uses, is compiled once only.
#[inline]
pub(super) fn vectorised<N, T>(compute: impl FnOnce() -> T) -> T {
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    if size_of::<N>() == 4
        && let Some(avx512) = LEVEL.as_avx512().filter(|_| allows(512))
    {
        return fearless_simd::Simd::vectorize(avx512, compute);
    }
    streamed::<N, T>(compute)
}

/// As [`vectorised`], for a loop that computes little for what it reads and writes: with vectors of 256 bits at most.
/// Rows are not aligned, and each vector of 512 bits would be in two lines of the cache.
#[inline]
pub(super) fn streamed<N, T>(compute: impl FnOnce() -> T) -> T {
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    if size_of::<N>() == 4
        && let Some(avx2) = LEVEL.as_avx2().filter(|_| allows(256))
    {
        return fearless_simd::Simd::vectorize(avx2, compute);
    }
    compute()
}

/// The instructions of the processor. To look for them takes as long as a short row.
#[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
static LEVEL: LazyLock<fearless_simd::Level> = LazyLock::new(fearless_simd::Level::new);

/// Whether vectors may have this many bits. Tests restrict their thread.
#[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
#[inline(always)]
fn allows(_bits: u32) -> bool {
    #[cfg(test)]
    return _bits <= WIDEST.get();
    #[cfg(not(test))]
    true
}

#[cfg(test)]
thread_local! {
    /// The most bits of a vector on this thread.
    pub(crate) static WIDEST: std::cell::Cell<u32> = const { std::cell::Cell::new(512) };
}

/// The first numbers of a slice, with zeros where it has fewer.
#[inline(always)]
pub(super) fn segment<N: Number>(numbers: &[N]) -> Segment<N> {
    let mut segment = [N::default(); SEGMENT];
    let count = numbers.len().min(SEGMENT);
    segment[..count].copy_from_slice(&numbers[..count]);
    segment
}

/// The first numbers of a slice that has some. Where it has fewer than a segment, the last is repeated.
#[inline(always)]
pub(super) fn first_repeated<N: Number>(numbers: &[N]) -> Segment<N> {
    let (mut segment, count) = (segment(numbers), numbers.len().min(SEGMENT));
    let last = segment[count - 1];
    segment[count..].fill(last);
    segment
}

/// The n-th pixel after the first, as a number.
#[inline(always)]
pub(super) fn place<N: Number>(first: usize, n: usize) -> N {
    N::of(first as f64) + N::of(f64::from(n as i32))
}

/// The least and the greatest number.
#[inline(always)]
pub(super) fn range<N: Number>(numbers: &Segment<N>) -> [f64; 2] {
    let [mut least, mut most] = [*numbers; 2];
    let mut half = SEGMENT / 2;
    while half > 0 {
        for n in 0..half {
            least[n] = least[n].min(least[n + half]);
            most[n] = most[n].max(most[n + half]);
        }
        half /= 2;
    }
    [least[0].into(), most[0].into()]
}
