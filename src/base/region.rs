//! Regions: rectangles of pixels of an image.

use crate::base::{Error, centre};

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
