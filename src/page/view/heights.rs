//! Heights on a grid as fine as the picture needs, without spikes.

use super::Surface;

/// Nearness, 0 to 1, at the nodes of a grid; NaN where no pixel is valid.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Heights {
    pub width: usize,
    pub height: usize,
    pub data: Vec<f32>,
}

impl Heights {
    /// The mean nearness of square cells of pixels, about `nodes` of them across, smoothed over `radius` cells.
    pub(super) fn of(surface: &Surface, nodes: usize, radius: usize) -> Self {
        let longer = surface.width.max(surface.height);
        let cell = ((longer as f64 / nodes as f64).round() as usize).max(1);
        let (width, height) = (surface.width.div_ceil(cell), surface.height.div_ceil(cell));
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            data.extend((0..width).map(|x| mean(surface, x * cell, y * cell, cell)));
        }
        let heights = Self { width, height, data };
        if radius == 0 { heights } else { heights.smoothed(radius) }
    }

    /// At a node; NaN outside.
    pub(super) fn get(&self, x: isize, y: isize) -> f32 {
        let inside = x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height;
        if inside { self.data[y as usize * self.width + x as usize] } else { f32::NAN }
    }

    /// A median, which takes spikes away and keeps steps, then a mean of 3 x 3, which takes the median's facets off. The
    /// median is over 7 x 7 nodes spread over the square of that radius: all of them would take many times as long.
    fn smoothed(self, radius: usize) -> Self {
        let spread = radius.min(3) as isize;
        let offsets: Vec<isize> = (-spread..=spread).map(|k| k * radius as isize / spread.max(1)).collect();
        let median = |window: &mut [f32]| *window.select_nth_unstable_by(window.len() / 2, f32::total_cmp).1;
        let mean = |window: &mut [f32]| window.iter().sum::<f32>() / window.len() as f32;
        self.filtered(&offsets, median).filtered(&[-1, 0, 1], mean)
    }

    /// Combines each valid node with the valid ones at these offsets in x and y, which include 0.
    fn filtered(&self, offsets: &[isize], combine: impl Fn(&mut [f32]) -> f32) -> Self {
        let mut window = Vec::with_capacity(offsets.len().pow(2));
        let at = |i: usize| {
            if self.data[i].is_nan() {
                return f32::NAN;
            }
            let (x, y) = ((i % self.width) as isize, (i / self.width) as isize);
            window.clear();
            for dy in offsets {
                window.extend(offsets.iter().map(|dx| self.get(x + dx, y + dy)).filter(|v| !v.is_nan()));
            }
            combine(&mut window)
        };
        Self { data: (0..self.data.len()).map(at).collect(), ..*self }
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

#[cfg(test)]
mod tests {
    use image::RgbImage;

    use super::*;
    use crate::files::export::{Nearer, Scale};

    fn heights(width: usize, height: usize, blur: &[f32], nodes: usize, radius: usize) -> Heights {
        let scale = Scale { low: 0.0, high: 1.0, nearer: Nearer::First };
        let surface = Surface {
            width,
            height,
            relative_blur: blur,
            texture: RgbImage::new(1, 1),
            scale,
            names: [""; 2],
            to_scale: None,
        };
        Heights::of(&surface, nodes, radius)
    }

    #[test]
    fn cells_are_the_mean_of_their_valid_pixels() {
        let nan = f32::NAN;
        let found = heights(5, 2, &[0.25, 0.5, nan, nan, 1.0, 0.25, nan, nan, nan, 7.0], 3, 0);
        assert_eq!((found.width, found.height), (3, 1));
        assert!((found.data[0] - 1.0 / 3.0).abs() < 1e-6 && found.data[1].is_nan() && found.data[2] == 1.0);
        assert_eq!(heights(2, 1, &[0.0, 1.0], 900, 0).data, [0.0, 1.0]);
    }

    #[test]
    fn smoothing_takes_spikes_and_keeps_steps_and_holes() {
        let mut blur: Vec<f32> = (0..81).map(|i| if i % 9 < 4 { 0.0 } else { 1.0 }).collect();
        (blur[20], blur[42], blur[80]) = (1.0, 0.0, f32::NAN);
        let found = heights(9, 9, &blur, 9, 2);
        for (i, v) in found.data.iter().enumerate().filter(|(i, _)| *i != 80) {
            // The mean of 3 x 3 makes the step two nodes wide.
            let expected = [0.0, 0.0, 0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0, 1.0, 1.0, 1.0][i % 9];
            assert!((v - expected).abs() < 1e-6, "{i}: {v}");
        }
        assert!(found.data[80].is_nan());
    }
}
