//! Regions and masks: the pixels of an image that a solve or a measurement uses.

use crate::base::color::LUMINANCE;
use crate::base::{Decode, Error, Frame, centre};

/// A rectangle of pixels of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Region {
    /// Left edge, px.
    pub x: u32,
    /// Upper edge, px.
    pub y: u32,
    /// Width, px.
    pub width: u32,
    /// Height, px.
    pub height: u32,
}

impl Region {
    /// Returns the region with a margin of `margin` px on each side, clamped to an image of the given size.
    pub fn expanded(self, margin: u32, [width, height]: [u32; 2]) -> Self {
        let (x, y) = (self.x.saturating_sub(margin), self.y.saturating_sub(margin));
        let end = |at: u32, length: u32, side: u32| at.saturating_add(length).saturating_add(margin).min(side);
        let (right, below) = (end(self.x, self.width, width), end(self.y, self.height, height));
        Self { x, y, width: right.saturating_sub(x), height: below.saturating_sub(y) }
    }

    /// Returns the centre, px.
    pub fn centre(&self) -> [f64; 2] {
        let [cx, cy] = centre(self.width, self.height);
        [f64::from(self.x) + cx, f64::from(self.y) + cy]
    }

    /// Returns the values in the region, of a row-major image of `width` pixels per row with interleaved channels.
    pub(crate) fn crop<T: Copy>(&self, values: &[T], width: usize, channels: usize) -> Vec<T> {
        let (x, y) = (self.x as usize * channels, self.y as usize);
        let (length, height) = (self.width as usize * channels, self.height as usize);
        let rows = values.chunks_exact(width * channels).skip(y).take(height);
        rows.flat_map(|row| &row[x..x + length]).copied().collect()
    }

    /// Returns the largest region of valid pixels only, of a row-major mask of `width` pixels per row. `None` if no
    /// pixel is valid.
    ///
    /// For each row it finds the largest rectangle under the histogram of valid pixels above it, in linear time.
    pub(crate) fn largest_valid(valid: &[bool], width: usize) -> Option<Self> {
        let mut heights = vec![0u32; width];
        let mut best: Option<Self> = None;
        for (y, row) in valid.chunks_exact(width).enumerate() {
            for (height, &valid) in heights.iter_mut().zip(row) {
                *height = if valid { *height + 1 } else { 0 };
            }
            let candidate = largest_under(&heights, y as u32);
            best = candidate.filter(|c| best.is_none_or(|b| c.area() > b.area())).or(best);
        }
        best
    }

    /// Checks that the region holds pixels, all of them within an image of this width and height.
    ///
    /// # Errors
    /// [`Error::Region`].
    pub(crate) fn check(&self, (image_width, image_height): (u32, u32)) -> Result<(), Error> {
        let Region { x, y, width, height } = *self;
        let is_within =
            |from: u32, length: u32, size: u32| length > 0 && from.checked_add(length).is_some_and(|to| to <= size);
        if is_within(x, width, image_width) && is_within(y, height, image_height) {
            return Ok(());
        }
        let problem = format!("is not within the image, {image_width}x{image_height}; give X,Y,WIDTH,HEIGHT in pixels");
        Err(Error::Region(format!("the region {x},{y},{width},{height} {problem}")))
    }

    fn area(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }
}

impl From<Region> for [u32; 4] {
    fn from(region: Region) -> Self {
        [region.x, region.y, region.width, region.height]
    }
}

/// Returns the largest rectangle under a histogram whose columns end at row `y`.
fn largest_under(heights: &[u32], y: u32) -> Option<Region> {
    // Starts and heights of open rectangles, in increasing height.
    let mut open: Vec<(usize, u32)> = Vec::new();
    let mut best: Option<Region> = None;
    for (x, height) in heights.iter().copied().chain([0]).enumerate() {
        let mut start = x;
        while let Some(&(from, high)) = open.last().filter(|(_, high)| *high > height) {
            let region = Region { x: from as u32, y: y + 1 - high, width: (x - from) as u32, height: high };
            if best.is_none_or(|b| region.area() > b.area()) {
                best = Some(region);
            }
            start = from;
            open.pop();
        }
        if open.last().is_none_or(|(_, high)| *high < height) && height > 0 {
            open.push((start, height));
        }
    }
    best
}

/// The pixels of I1 that a solve uses. Other pixels have no data term and do not contribute to the registration, and
/// their results are NaN.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    width: u32,
    height: u32,
    /// 1 for each pixel of the mask, else 0.
    bytes: Vec<u8>,
}

impl Mask {
    /// Makes a mask of the pixels of an image whose stored luminance is at least half of white.
    pub fn from_image(image: &Frame) -> Self {
        let channels = image.format().channels.count() as usize;
        let is_bright = |pixel: &[f32]| match *pixel {
            [r, g, b] => LUMINANCE[0] * r + LUMINANCE[1] * g + LUMINANCE[2] * b >= 0.5,
            _ => pixel[0] >= 0.5,
        };
        let intensities = image.intensities(Decode::None);
        let bytes = intensities.chunks_exact(channels).map(|pixel| u8::from(is_bright(pixel))).collect();
        Self { width: image.width(), height: image.height(), bytes }
    }

    /// Returns the mask of a region, which must lie within it.
    pub(crate) fn cropped(&self, region: Region) -> Self {
        Self { width: region.width, height: region.height, bytes: region.crop(&self.bytes, self.width as usize, 1) }
    }

    /// Returns every `step`-th pixel of every `step`-th row.
    pub(crate) fn subsampled(&self, step: u32) -> Self {
        let [width, height] = [self.width.div_ceil(step), self.height.div_ceil(step)];
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (step * y, step * x)));
        let bytes = pixels.map(|(y, x)| self.bytes[y as usize * self.width as usize + x as usize]).collect();
        Self { width, height, bytes }
    }

    /// Returns width and height, px.
    pub fn size(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// Whether the mask has the pixel nearest to a point, px.
    pub(crate) fn contains(&self, x: f64, y: f64) -> bool {
        let [column, row] = [(x, self.width), (y, self.height)]
            .map(|(at, side)| (at.round().clamp(0.0, f64::from(side) - 1.0)) as usize);
        self.bytes.get(row * self.width as usize + column) == Some(&1)
    }

    /// Returns the fraction of the pixels that the mask has.
    pub(crate) fn coverage(&self) -> f64 {
        let count = self.bytes.iter().filter(|byte| **byte != 0).count();
        count as f64 / self.bytes.len().max(1) as f64
    }

    /// Returns one byte per pixel, row-major: 1 for each pixel of the mask, else 0.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_region_is_that_of_a_search_of_all() {
        let (width, height) = (9usize, 7usize);
        for seed in 0..40usize {
            let valid: Vec<bool> =
                (0..width * height).map(|i| (i * i * 31 + seed * 977 + i * (seed + 3)) % 11 > 1).collect();
            let all = |r: &Region| r.crop(&valid, width, 1).iter().all(|v| *v);
            let mut area = 0;
            for (x, y) in (0..width).flat_map(|x| (0..height).map(move |y| (x, y))) {
                for (w, h) in (1..=width - x).flat_map(|w| (1..=height - y).map(move |h| (w, h))) {
                    let region = Region { x: x as u32, y: y as u32, width: w as u32, height: h as u32 };
                    if all(&region) {
                        area = area.max(region.area());
                    }
                }
            }
            let region = Region::largest_valid(&valid, width).unwrap();
            assert!(all(&region) && region.area() == area, "{region:?} of {} is not of {area}", region.area());
        }
        assert_eq!(Region::largest_valid(&[false; 12], 4), None);
    }

    #[test]
    fn a_margin_is_clamped_to_the_image() {
        let region = Region { x: 5, y: 50, width: 10, height: 20 };
        assert_eq!(region.expanded(8, [100, 75]), Region { x: 0, y: 42, width: 23, height: 33 });
        assert_eq!(region.centre(), [9.5, 59.5]);
    }
}
