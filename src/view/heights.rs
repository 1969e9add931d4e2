//! Heights on a grid as fine as the picture needs, without spikes.

use super::Surface;

/// Nearness, 0 to 1, at the nodes of a grid; NaN where no pixel is valid.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Heights {
    pub width: usize,
    pub height: usize,
    pub data: Vec<f32>,
    /// Pixels of V from one node to the next.
    pub cell: usize,
}

impl Heights {
    /// The mean nearness of square cells of pixels, about `nodes` of them across, then a median of `radius` cells.
    pub(super) fn of(surface: &Surface, nodes: usize, radius: usize) -> Self {
        let longer = surface.width.max(surface.height);
        let cell = ((longer as f64 / nodes as f64).round() as usize).max(1);
        let (width, height) = (surface.width.div_ceil(cell), surface.height.div_ceil(cell));
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            data.extend((0..width).map(|x| mean(surface, x * cell, y * cell, cell)));
        }
        let heights = Self { width, height, data, cell };
        if radius == 0 { heights } else { heights.median(radius) }
    }

    /// At a node; NaN outside.
    pub(super) fn get(&self, x: isize, y: isize) -> f32 {
        let inside = x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height;
        if inside { self.data[y as usize * self.width + x as usize] } else { f32::NAN }
    }

    /// The median of the valid nodes within a square; nodes that are not valid stay so. Takes spikes away and keeps steps.
    fn median(&self, radius: usize) -> Self {
        let r = radius as isize;
        let mut window = Vec::with_capacity((2 * radius + 1).pow(2));
        let mut at = |x: isize, y: isize| {
            if self.get(x, y).is_nan() {
                return f32::NAN;
            }
            window.clear();
            let square = (y - r..=y + r).flat_map(|y| (x - r..=x + r).map(move |x| (x, y)));
            window.extend(square.map(|(x, y)| self.get(x, y)).filter(|v| !v.is_nan()));
            let middle = window.len() / 2;
            *window.select_nth_unstable_by(middle, f32::total_cmp).1
        };
        let mut data = Vec::with_capacity(self.data.len());
        for y in 0..self.height as isize {
            data.extend((0..self.width as isize).map(|x| at(x, y)));
        }
        Self { data, ..*self }
    }
}

fn mean(surface: &Surface, left: usize, top: usize, cell: usize) -> f32 {
    let (right, bottom) = ((left + cell).min(surface.width), (top + cell).min(surface.height));
    let (mut sum, mut count) = (0.0, 0);
    for y in top..bottom {
        for &v in &surface.relative_blur[y * surface.width + left..y * surface.width + right] {
            if v.is_finite() {
                sum += surface.scale.nearness(v);
                count += 1;
            }
        }
    }
    if count == 0 { f32::NAN } else { (sum / f64::from(count)) as f32 }
}
