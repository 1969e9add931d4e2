//! Heights of the surface on a grid, for pictures and for the page.

use crate::files::export::Scale;

/// Nearness, 0 to 1, at the nodes of a grid; NaN at nodes without a valid pixel.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Heights {
    pub width: usize,
    pub height: usize,
    pub data: Vec<f32>,
}

impl Heights {
    /// Computes the mean nearness of square cells of pixels, about `nodes` along the longer side, smoothed over
    /// `radius` cells. The values are row-major, of at least one row.
    pub(crate) fn of(values: &[f32], width: usize, scale: &Scale, nodes: u32, radius: u32) -> Self {
        let longer = width.max(values.len() / width);
        let cell = ((longer as f64 / f64::from(nodes)).round() as usize).max(1);
        let bands: Vec<Vec<f32>> = values.chunks(width * cell).map(|rows| means(rows, width, cell, scale)).collect();
        let heights = Self { width: width.div_ceil(cell), height: bands.len(), data: bands.concat() };
        if radius == 0 { heights } else { heights.smoothed(radius as usize) }
    }

    /// Nearness at a node; NaN outside.
    fn get(&self, x: isize, y: isize) -> f32 {
        let inside = x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height;
        if inside { self.data[y as usize * self.width + x as usize] } else { f32::NAN }
    }

    /// Applies a median, which removes spikes and keeps steps, and then a mean of 3 x 3, which smooths its facets. The
    /// median uses 7 x 7 sampled nodes of the square of that radius: all nodes would take many times as long.
    fn smoothed(self, radius: usize) -> Self {
        let spread = radius.min(3) as isize;
        let offsets: Vec<isize> = (-spread..=spread).map(|k| k * radius as isize / spread.max(1)).collect();
        let median = |window: &mut [f32]| *window.select_nth_unstable_by(window.len() / 2, f32::total_cmp).1;
        let mean = |window: &mut [f32]| window.iter().sum::<f32>() / window.len() as f32;
        self.filtered(&offsets, median).filtered(&[-1, 0, 1], mean)
    }

    /// Combines each valid node with the valid nodes at these offsets in x and y, which include (0, 0).
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

/// Mean nearness of the cells of a band of rows.
fn means(rows: &[f32], width: usize, cell: usize, scale: &Scale) -> Vec<f32> {
    let mut sums = vec![(0.0, 0); width.div_ceil(cell)];
    for row in rows.chunks(width) {
        for (values, (sum, count)) in row.chunks(cell).zip(&mut sums) {
            for &v in values.iter().filter(|v| v.is_finite()) {
                *sum += scale.nearness(v);
                *count += 1;
            }
        }
    }
    sums.into_iter().map(|(sum, count)| if count == 0 { f32::NAN } else { (sum / f64::from(count)) as f32 }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::export::Nearer;

    fn heights(width: usize, blur: &[f32], nodes: u32, radius: u32) -> Heights {
        let scale = Scale { low: 0.0, high: 1.0, nearer: Nearer::First };
        Heights::of(blur, width, &scale, nodes, radius)
    }

    #[test]
    fn cells_are_the_mean_of_their_valid_pixels() {
        let nan = f32::NAN;
        let found = heights(5, &[0.25, 0.5, nan, nan, 1.0, 0.25, nan, nan, nan, 7.0], 3, 0);
        assert_eq!((found.width, found.height), (3, 1));
        assert!((found.data[0] - 1.0 / 3.0).abs() < 1e-6 && found.data[1].is_nan() && found.data[2] == 1.0);
        assert_eq!(heights(2, &[0.0, 1.0], 900, 0).data, [0.0, 1.0]);
    }

    #[test]
    fn smoothing_removes_spikes_and_keeps_steps_and_holes() {
        let mut blur: Vec<f32> = (0..81).map(|i| if i % 9 < 4 { 0.0 } else { 1.0 }).collect();
        (blur[20], blur[42], blur[80]) = (1.0, 0.0, f32::NAN);
        let found = heights(9, &blur, 9, 2);
        for (i, v) in found.data.iter().enumerate().filter(|(i, _)| *i != 80) {
            // The mean of 3 x 3 makes the step two nodes wide.
            let expected = [0.0, 0.0, 0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0, 1.0, 1.0, 1.0][i % 9];
            assert!((v - expected).abs() < 1e-6, "{i}: {v}");
        }
        assert!(found.data[80].is_nan());
    }
}
