//! `V ← V + share clamp(dV)`, and the count of the pixels that still move.
//!
//! A whole step may be kept. The next step is then extrapolated from both, in each block of 2 x 2 pixels.
//! Sections 4 and 6 of `docs/method.md`.

use super::rows::{self, Rows};
use super::segments::vectorised;
use super::{Number, Raster, pixels, uncertainty_terms};
use crate::engine::shaders;

/// The constants of the update.
#[derive(Clone, Copy, Debug)]
pub struct Constants {
    /// Width of the level, pixels.
    pub width: u32,
    /// Height of the level, pixels.
    pub height: u32,
    /// Largest |dV|, px² of the level,
    pub largest_step: f32,
    /// or this share of |V|, if that is more.
    pub relative_step: f32,
    /// Largest |V|, px² of the level.
    pub limit: f32,
    /// Share of dV that is added.
    pub share: f32,
    /// 1 keeps the step, 2 extrapolates it from the kept one, 0 does neither.
    pub extrapolation: u32,
}

/// [`Constants::extrapolation`]: keeps the step.
pub(crate) const KEEP: u32 = shaders::update::KEEP;
/// [`Constants::extrapolation`]: multiplies the step by the [factor] that follows from it and from the kept one.
pub(crate) const EXTRAPOLATE: u32 = shaders::update::EXTRAPOLATE;
/// The layer of the kept step, after the blur-matched pair: sums over blocks of 2 x 2 pixels.
pub(crate) const KEPT: usize = shaders::update::KEPT as usize;
/// Bounds of the factor. Twice and half were enough on real pairs; with three times the coarsest level took 20 instead
/// of 16 iterations.
const FACTORS: [f64; 2] = [shaders::update::LEAST_FACTOR, shaders::update::MOST_FACTOR];

/// Compulsory traffic: dV, V and D read, V written; on every fourth pixel the kept step read or written.
pub(crate) fn bytes(c: &Constants) -> u64 {
    let [width, height] = uncertainty_terms::size([c.width, c.height]);
    let kept = if c.extrapolation == 0 { 0 } else { 4 };
    16 * pixels(c.width, c.height) + kept * pixels(width, height)
}

/// A pixel moves if its step is more than a tenth of its standard deviation (section 7 of `docs/method.md`), and far if
/// it is more than half of it.
const STEPS: [f64; 2] = [shaders::update::STILL, shaders::update::FAR];
/// One over the pixels that say as much as one independent pixel, 4π 4² of the window.
const INDEPENDENT: f64 = shaders::update::INDEPENDENT;
/// The square of 1.8, by which D exceeds the curvature of the robust norm at strong noise: 1.4 at 0.01, 2.0 at 0.03 on
/// generated scenes. On photographs it is not measured.
const WIDER: f64 = shaders::update::WIDER;

/// The factor that extrapolates a step. Where steps change in proportion to what is left, the remaining distance is the
/// step divided by 1 - change/before (Aitken, 1926). 1 if there was no step before.
#[inline(always)]
fn factor<N: Number>(change: N, before: N) -> N {
    let [none, one, most, least] = [N::default(), N::of(1.0), N::of(FACTORS[1]), N::of(FACTORS[0])];
    let factor = (one / (one - change / before).max(one / most)).max(least);
    if before == none { one } else { factor }
}

#[inline(always)]
fn within<N: Number>(value: N, most: N) -> N {
    value.max(-most).min(most)
}

/// What all steps of a pass share.
struct Steps<N> {
    largest: N,
    relative: N,
    limit: N,
    share: N,
    /// D dV² beyond which a pixel moves, and moves far.
    bounds: [N; 2],
    extrapolation: u32,
}

impl<N: Number> Steps<N> {
    /// V of a block after its step by `change`, the sum of the step that is kept, and the counts of pixels that move,
    /// that move far, and that are at the limit. Pixels beyond the border are 0, and are not counted.
    #[inline(always)]
    fn step(&self, mut v: [N; 4], change: [N; 4], d: [N; 4], kept: N) -> ([N; 4], N, [u32; 3]) {
        let mut changes = [N::default(); 4];
        for n in 0..4 {
            changes[n] = within(change[n], self.largest.max(self.relative * v[n].abs()));
        }
        let sum = changes[0] + changes[1] + changes[2] + changes[3];
        let share = if self.extrapolation == EXTRAPOLATE { factor(sum, kept) * self.share } else { self.share };
        let mut counts = [0; 3];
        for n in 0..4 {
            let whole = within(v[n] + changes[n], self.limit) - v[n];
            v[n] = within(v[n] + share * changes[n], self.limit);
            let energy = d[n] * whole * whole;
            counts[0] += u32::from(energy > self.bounds[0]);
            counts[1] += u32::from(energy > self.bounds[1]);
            counts[2] += u32::from(d[n] > N::default()) & u32::from(v[n].abs() == self.limit);
        }
        (v, if self.extrapolation == KEEP { sum } else { kept }, counts)
    }
}

/// Adds dV, of the red and of the black pixels, to V, and keeps or extrapolates the step. Returns the numbers of pixels
/// that a whole step moves, of those it moves far, and of those with data that are at the limit. `variance` is Σ b² /
/// Σ D, `kept` the sums of the kept step over blocks.
pub fn cpu_reference<N: Number>(
    c: &Constants,
    change: [&Raster<N>; 2],
    d: &Raster<N>,
    variance: f64,
    kept: &mut Raster<N>,
    v: &mut Raster<N>,
) -> [u32; 3] {
    let [largest, relative, limit, share] =
        [c.largest_step, c.relative_step, c.limit, c.share].map(|n| N::of(n.into()));
    let bounds = STEPS.map(|step| N::of(step * step * WIDER * INDEPENDENT * variance));
    let steps = Steps { largest, relative, limit, share, bounds, extrapolation: c.extrapolation };
    let (width, height, blocks) = (v.width, v.height, [v.width.div_ceil(2), v.height.div_ceil(2)]);
    if [kept.width, kept.height] != blocks {
        *kept = Raster::zeros(blocks[0], blocks[1]);
    }
    let moving = rows::map([Rows::from(v).joined(2), kept.into()], |row, [lines, kept]| {
        let (top, bottom) = lines.split_at_mut(width);
        let ([first, second], has_both) = ([2 * row, (2 * row + 1).min(height - 1)], 2 * row + 1 < height);
        // Of row y the even pixels have the color of y, the odd ones the other.
        let colors = |y: usize| [change[y % 2].row(y), change[(y + 1) % 2].row(y)];
        let (changes, d, mut moving) = ([colors(first), colors(second)], [d.row(first), d.row(second)], [0; 3]);
        let whole = if has_both { width / 2 } else { 0 };
        vectorised::<N, _>(
            #[inline(always)]
            || {
                let [[even, odd], [even2, odd2]] = changes.map(|colors| colors.map(|row| &row[..whole]));
                let [d, d2] = d.map(|row| &row.as_chunks::<2>().0[..whole]);
                let [v, v2] = [&mut *top, &mut *bottom].map(|row| &mut row.as_chunks_mut::<2>().0[..whole]);
                let kept = &mut kept[..whole];
                for n in 0..whole {
                    let change = [even[n], odd[n], even2[n], odd2[n]];
                    let before = [v[n][0], v[n][1], v2[n][0], v2[n][1]];
                    let (after, sum, counts) =
                        steps.step(before, change, [d[n][0], d[n][1], d2[n][0], d2[n][1]], kept[n]);
                    (v[n], v2[n], kept[n]) = ([after[0], after[1]], [after[2], after[3]], sum);
                    for k in 0..3 {
                        moving[k] += counts[k];
                    }
                }
            },
        );
        for (block, kept) in kept.iter_mut().enumerate().skip(whole) {
            let places = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| (2 * block + i, j));
            let exists = |(x, j): (usize, usize)| x < width && (j == 0 || has_both);
            let of = |numbers: &dyn Fn(usize, usize) -> N| {
                places.map(|(x, j)| if exists((x, j)) { numbers(x, j) } else { N::default() })
            };
            let before = of(&|x, j| if j == 0 { top[x] } else { bottom[x] });
            let change = of(&|x, j| changes[j][x % 2][x / 2]);
            let (after, sum, counts) = steps.step(before, change, of(&|x, j| d[j][x]), *kept);
            for ((x, j), after) in places.into_iter().zip(after).filter(|(place, _)| exists(*place)) {
                if j == 0 { top[x] = after } else { bottom[x] = after }
            }
            *kept = sum;
            moving.iter_mut().zip(counts).for_each(|(sum, count)| *sum += count);
        }
        moving
    });
    moving.iter().fold([0; 3], |sums, counts| std::array::from_fn(|n| sums[n] + counts[n]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_extrapolated_to_where_a_geometric_series_ends() {
        for (ratio, expected) in [(0.3, 1.0 / 0.7), (-0.5, 1.0 / 1.5), (0.0, 1.0), (0.9, 2.0), (2.0, 2.0), (-3.0, 0.5)]
        {
            let found: f64 = factor(ratio * 0.4, 0.4);
            assert!((found - expected).abs() < 1e-12, "{ratio}: {found}");
        }
        assert_eq!((factor(0.1, 0.0), factor(0.0, 0.0)), (1.0, 1.0));
    }
}
