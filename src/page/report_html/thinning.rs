//! Which pixels a page holds.

use image::RgbImage;

use crate::page::figure::resized;

/// The most pixels that a page holds. Of larger images it has every second pixel of every second row, or every third
/// and so on, so that a browser can still open it; each value is still that of its pixel.
const MOST_PIXELS: usize = 1 << 22;

/// Pixels at `step / 2 + k step` of both axes, k = 0, 1 and so on.
pub(super) struct Thinning {
    full: (usize, usize),
    pub(super) step: usize,
    pub(super) width: usize,
    pub(super) height: usize,
}

impl Thinning {
    /// Of images of this size.
    pub(super) fn of(full: (u32, u32)) -> Self {
        Self::within(full, MOST_PIXELS)
    }

    /// With at most so many pixels.
    pub(super) fn within((width, height): (u32, u32), most: usize) -> Self {
        let full = (width as usize, height as usize);
        let count = |side: usize, step: usize| (side - step / 2).div_ceil(step);
        let mut step = 1;
        while count(full.0, step) * count(full.1, step) > most && step < full.0.min(full.1) {
            step += 1;
        }
        Self { full, step, width: count(full.0, step), height: count(full.1, step) }
    }

    pub(super) fn values(&self, values: &[f32]) -> Vec<f32> {
        let (first, step) = (self.step / 2, self.step);
        let rows = values.chunks_exact(self.full.0).skip(first).step_by(step);
        rows.flat_map(|row| row.iter().skip(first).step_by(step)).copied().collect()
    }

    pub(super) fn picture(&self, image: RgbImage) -> RgbImage {
        if self.step == 1 { image } else { resized(&image, (self.width as u32, self.height as u32)) }
    }
}
