//! Determines which pixels count, and by what share, and counts the clipped pixels.
//!
//! A clipped pixel (one channel white, or all black) only bounds the light, and a masked pixel is not part of the
//! scene. Neither has a data term or contributes to the registration. Nor do pixels close by, since blur spreads what
//! clipped and masked pixels show.
//!
//! The mask is therefore averaged over the [window](super::uncertainty_terms::window()) of each pixel, σ 2 px of the
//! finest level, then filtered and halved like the images. With the mean m, a pixel counts by `1 - 25 (1 - m)`, at
//! least 0. A single clipped pixel lowers its own m by 0.04: it counts by nothing and its neighbours by little. Around
//! a large clipped area nothing counts within 3.5 px.
//!
//! The counts of clipped pixels leave out those that the mask of I1 excludes, in I2 those at the same place: T is not
//! known yet, and a mask is large beside the displacement.

use super::pass::{Memory, Pass};
use super::segments::{Segment, segment};
use super::{Number, Raster, Real, ingest, pixels, spline};
use crate::base::Frame;
use crate::engine::slot::Reads;
use crate::engine::vulkan::Variant;

pub use super::interface::mask::*;

/// The averaged masks of I1 and I2 on a level.
pub type Masks<N = f64> = [Raster<N>; 2];

impl Pass for Bindings {
    /// Compulsory traffic: every sample and the mask read, a number a pixel written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        u64::from(c.channels * c.bytes + 5) * pixels(c.width, c.height)
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let (frame, second) = (memory.photograph(self.samples), c.second as usize);
        let mask = memory.mask_bytes();
        let mut counts = cpu_reference(frame, c.clipped, None);
        let clipped = count_clipped(&counts, mask);
        if second == 0 && mask.is_some() {
            counts = cpu_reference(frame, c.clipped, mask);
        }
        memory.set_layer(self.counts, second, counts);
        memory.state_mut(self.state).clipped[second] += clipped;
    }
}

/// The mask of a frame on the finest level: 1 where a pixel counts. `mask` has a byte per pixel, 0 where it is left
/// out.
pub fn cpu_reference<N: Number>(frame: &Frame, [black, white]: [f32; 2], mask: Option<&[u8]>) -> Raster<N> {
    let channels = frame.format().channels.count() as usize;
    let width = frame.width() as usize;
    Raster::from_fn(width, frame.height() as usize, |x, y| {
        let pixel = y * width + x;
        let samples = || (0..channels).map(|c| ingest::stored(frame, pixel * channels + c));
        let clipped = samples().any(|s| s >= f64::from(white)) || samples().all(|s| s <= f64::from(black));
        if clipped || mask.is_some_and(|mask| mask[pixel] == 0) { 0.0 } else { 1.0 }
    })
}

/// The number of clipped pixels, 0 in `counts`, that `mask` does not exclude.
pub fn count_clipped<N: Number>(counts: &Raster<N>, mask: Option<&[u8]>) -> u32 {
    let is_open = |n: usize| mask.is_none_or(|mask| mask[n] != 0);
    counts.data.iter().enumerate().filter(|(n, counts)| **counts == N::default() && is_open(*n)).count() as u32
}

/// The masks of a variant with masked pixels; `None` for other variants.
pub(super) fn of<N: Number>(memory: &Memory<N>, masks: Reads, variant: Variant) -> Option<&Masks<N>> {
    variant.has(Variant::MASKED).then(|| memory.layers(masks).first_chunk()).flatten()
}

/// The share by which pixel (x, y), which T displaces by d, counts; 1 without masks. The CPU reference of
/// `glsl/include/mask.glsl`.
pub fn counts<N: Number>(masks: Option<&Masks<N>>, [x, y]: [usize; 2], d: [f64; 2]) -> f64 {
    let Some([first, second]) = masks else { return 1.0 };
    let place = |x: usize, d: f64, size: usize| (x as f64 + d).clamp(0.0, size as f64 - 1.0);
    let (px, py) = (place(x, d[0], second.width), place(y, d[1], second.height));
    let (column, row) = (px as usize, py as usize);
    let (next, below) = ((column + 1).min(second.width - 1), (row + 1).min(second.height - 1));
    let taps = [[second.get(column, row), second.get(next, row)], [second.get(column, below), second.get(next, below)]];
    both(first.get(x, y), taps, [px - column as f64, py - row as f64])
}

/// Sets the shares by which the pixels of the segment from (x, y) to the right count, as [`counts`].
#[inline(always)]
pub(super) fn counts_segment<N: Number>(
    masks: Option<&Masks<N>>,
    at: [usize; 2],
    d: [&Segment<N>; 2],
    shares: &mut Segment<N>,
) {
    let Some([first, second]) = masks else { return shares.fill(N::of(1.0)) };
    let first = segment(&first.row(at[1])[at[0]..]);
    spline::displaced_taps(
        second,
        at,
        d,
        0,
        |last| [0.0, last],
        #[inline(always)]
        |n, taps, fractions| shares[n] = both(first[n], taps, fractions),
    );
}

/// The share by the averaged masks of I1 at a pixel and of I2 about the displaced pixel.
#[inline(always)]
fn both<R: Real>(first: R, taps: [[R; 2]; 2], [fx, fy]: [R; 2]) -> R {
    let one = R::of(1.0);
    let along = |[here, next]: [R; 2]| (one - fx) * here + fx * next;
    from_share(first) * from_share((one - fy) * along(taps[0]) + fy * along(taps[1]))
}

/// The share of a pixel with this averaged mask.
#[inline(always)]
fn from_share<R: Real>(share: R) -> R {
    (R::of(25.0) * share - R::of(24.0)).max(R::default()).min(R::of(1.0))
}

#[cfg(test)]
mod tests {
    use super::super::Field;

    use super::*;

    #[test]
    fn the_mask_of_i2_is_read_at_the_displaced_pixel() {
        let mut masks = [(); 2].map(|()| Field::from_fn(8, 6, |_, _| 1.0));
        masks[1].data[2 * 8 + 5] = 0.0;
        assert_eq!(counts(Some(&masks), [3, 1], [2.0, 1.0]), 0.0);
        assert!((counts(Some(&masks), [3, 1], [1.02, 1.0]) - 0.5).abs() < 1e-9);
        assert_eq!(counts(Some(&masks), [3, 1], [0.9, 0.7]), 1.0);
        assert_eq!(counts(Some(&masks), [3, 1], [100.0, -100.0]), 1.0);
        assert_eq!(counts::<f64>(None, [3, 1], [2.0, 1.0]), 1.0);
    }
}
