//! A rectangle of pixels.

/// A rectangle in the pixels of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Region {
    /// Left edge, px.
    pub x: u32,
    /// Upper edge, px.
    pub y: u32,
    /// Px.
    pub width: u32,
    /// Px.
    pub height: u32,
}

impl Region {
    /// The same with a margin on each side, as far as an image of this size has one.
    pub fn grown(self, margin: u32, [width, height]: [u32; 2]) -> Self {
        let (x, y) = (self.x.saturating_sub(margin), self.y.saturating_sub(margin));
        let end = |at: u32, length: u32, side: u32| at.saturating_add(length).saturating_add(margin).min(side);
        let (right, below) = (end(self.x, self.width, width), end(self.y, self.height, height));
        Self { x, y, width: right.saturating_sub(x), height: below.saturating_sub(y) }
    }

    /// Its centre, px.
    pub fn centre(&self) -> [f64; 2] {
        let [cx, cy] = crate::base::centre(self.width, self.height);
        [f64::from(self.x) + cx, f64::from(self.y) + cy]
    }

    /// The values of rows of so many pixels that lie in it; each pixel has so many.
    pub(crate) fn of<T: Copy>(&self, values: &[T], row: usize, channels: usize) -> Vec<T> {
        let (x, y) = (self.x as usize * channels, self.y as usize);
        let (width, height) = (self.width as usize * channels, self.height as usize);
        let rows = values.chunks_exact(row * channels).skip(y).take(height);
        rows.flat_map(|row| &row[x..x + width]).copied().collect()
    }

    /// The largest rectangle all of whose pixels are valid, in rows of so many; `None` where none is.
    ///
    /// Row by row, over the histogram of how many valid pixels end in each column: time in proportion to the pixels.
    pub(crate) fn largest(valid: &[bool], width: usize) -> Option<Self> {
        let mut heights = vec![0u32; width];
        let mut best: Option<Self> = None;
        for (y, row) in valid.chunks_exact(width).enumerate() {
            for (height, &valid) in heights.iter_mut().zip(row) {
                *height = if valid { *height + 1 } else { 0 };
            }
            let found = widest(&heights, y as u32);
            if let Some(found) = found.filter(|f| best.is_none_or(|b| f.area() > b.area())) {
                best = Some(found);
            }
        }
        best
    }

    fn area(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }
}

/// The largest rectangle under a histogram whose columns end at row `y`.
fn widest(heights: &[u32], y: u32) -> Option<Region> {
    // Starts of rectangles that go on, each higher than the one before.
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
    fn the_largest_rectangle_is_that_of_trying_all() {
        let (width, height) = (9usize, 7usize);
        for seed in 0..40usize {
            let valid: Vec<bool> =
                (0..width * height).map(|i| (i * i * 31 + seed * 977 + i * (seed + 3)) % 11 > 1).collect();
            let all = |r: &Region| r.of(&valid, width, 1).iter().all(|v| *v);
            let mut area = 0;
            for (x, y) in (0..width).flat_map(|x| (0..height).map(move |y| (x, y))) {
                for (w, h) in (1..=width - x).flat_map(|w| (1..=height - y).map(move |h| (w, h))) {
                    let region = Region { x: x as u32, y: y as u32, width: w as u32, height: h as u32 };
                    if all(&region) {
                        area = area.max(region.area());
                    }
                }
            }
            let found = Region::largest(&valid, width).unwrap();
            assert!(all(&found) && found.area() == area, "{found:?} of {} is not of {area}", found.area());
        }
        assert_eq!(Region::largest(&[false; 12], 4), None);
    }

    #[test]
    fn it_grows_as_far_as_the_image_goes() {
        let region = Region { x: 5, y: 50, width: 10, height: 20 };
        assert_eq!(region.grown(8, [100, 75]), Region { x: 0, y: 42, width: 23, height: 33 });
        assert_eq!(region.centre(), [9.5, 59.5]);
    }
}
