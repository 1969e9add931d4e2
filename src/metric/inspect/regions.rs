//! Connected regions of marked pixels, and the regions in which a part deviates.

use crate::base::Region;

/// The extent of a connected region.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Extent {
    /// The number of pixels.
    pub(super) area_px: usize,
    pub(super) centroid_px: [f64; 2],
    /// The bounding box.
    pub(super) bounds_px: Region,
}

/// Returns the 8-connected regions of pixels with the same sign, -1 or 1, and at least `min_area` pixels, the largest
/// first.
pub(super) fn connected_regions(width: u32, signs: &[i8], min_area: usize) -> Vec<Vec<usize>> {
    let mut visited: Vec<bool> = signs.iter().map(|sign| *sign == 0).collect();
    let mut regions: Vec<Vec<usize>> = Vec::new();
    for first in 0..signs.len() {
        if !visited[first] {
            regions.push(connected_pixels(first, width as usize, signs, &mut visited));
        }
    }
    regions.retain(|pixels| pixels.len() >= min_area.max(1));
    regions.sort_by_key(|pixels| std::cmp::Reverse(pixels.len()));
    regions
}

/// Returns the pixels connected with `first` that have its sign.
fn connected_pixels(first: usize, width: usize, signs: &[i8], visited: &mut [bool]) -> Vec<usize> {
    let mut pixels = vec![first];
    visited[first] = true;
    let mut next = 0;
    while let Some(&i) = pixels.get(next) {
        next += 1;
        let (x, y) = (i % width, i / width);
        for y in y.saturating_sub(1)..=(y + 1).min(signs.len() / width - 1) {
            for x in x.saturating_sub(1)..=(x + 1).min(width - 1) {
                let other = y * width + x;
                if !visited[other] && signs[other] == signs[first] {
                    visited[other] = true;
                    pixels.push(other);
                }
            }
        }
    }
    pixels
}

impl Extent {
    /// Returns the extent of these pixels of an image.
    pub(super) fn of(pixels: &[usize], width: u32) -> Self {
        let width = width as usize;
        let mean = |of: &dyn Fn(usize) -> usize| {
            pixels.iter().map(|i| of(*i) as f64).sum::<f64>() / pixels.len().max(1) as f64
        };
        let span = |of: &dyn Fn(usize) -> usize| {
            let (first, last) = pixels.iter().map(|i| of(*i)).fold((usize::MAX, 0), |(a, b), p| (a.min(p), b.max(p)));
            (first as u32, (last + 1 - first) as u32)
        };
        let ((x, columns), (y, rows)) = (span(&|i| i % width), span(&|i| i / width));
        Self {
            area_px: pixels.len(),
            centroid_px: [mean(&|i| i % width), mean(&|i| i / width)],
            bounds_px: Region { x, y, width: columns, height: rows },
        }
    }
}

/// A connected region of pixels that deviate with the same sign.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Deviation {
    /// The number of pixels.
    pub area_px: usize,
    /// The mean height over the golden part, above 0 towards the camera.
    pub mean: f64,
    /// The height of the largest magnitude.
    pub extreme: f64,
    /// The centroid, px.
    pub centroid_px: [f64; 2],
    /// The bounding box.
    pub bounds_px: Region,
}

/// Returns the pixel of the largest magnitude among some that are connected, and how wide it is at half of that, across
/// the longer side, px: what is around it may reach beyond these pixels.
pub(super) fn peak_of(pixels: &[usize], width: u32, heights: &[f32]) -> Option<(usize, f64)> {
    let peak = pixels.iter().copied().max_by(|a, b| heights[*a].abs().total_cmp(&heights[*b].abs()))?;
    let half = 0.5 * heights[peak];
    let signs: Vec<i8> = heights.iter().map(|height| i8::from(height * half.signum() >= half.abs())).collect();
    let mut visited: Vec<bool> = signs.iter().map(|sign| *sign == 0).collect();
    let around = connected_pixels(peak, width as usize, &signs, &mut visited);
    let count = around.len() as f64;
    let at = |i: &usize| [(i % width as usize) as f64, (i / width as usize) as f64];
    let middle = [0, 1].map(|n| around.iter().map(|i| at(i)[n]).sum::<f64>() / count);
    let moment = |a: usize, b: usize| {
        around.iter().map(|i| (at(i)[a] - middle[a]) * (at(i)[b] - middle[b])).sum::<f64>() / count
    };
    let (mean, half) = ((moment(0, 0) + moment(1, 1)) / 2.0, (moment(0, 0) - moment(1, 1)) / 2.0);
    // A row of n pixels has the variance (n² - 1)/12.
    let across = (mean - half.hypot(moment(0, 1))).max(0.0);
    Some((peak, (12.0 * across + 1.0).sqrt()))
}

/// Labels the 8-connected regions of pixels with the same sign, -1 or 1, that have at least `min_area` pixels and are to
/// be kept. Returns them, the largest first, with the number of each pixel's region, from 1, or 0.
pub(super) fn label_regions(
    width: u32,
    signs: &[i8],
    heights: &[f32],
    min_area: usize,
    keep: impl Fn(&[usize]) -> bool,
) -> (Vec<Deviation>, Vec<u32>) {
    let mut regions = connected_regions(width, signs, min_area);
    regions.retain(|pixels| keep(pixels));
    let mut labels = vec![0; signs.len()];
    for (number, pixels) in (1..).zip(&regions) {
        pixels.iter().for_each(|i| labels[*i] = number);
    }
    (regions.iter().map(|pixels| Deviation::of(pixels, width, heights)).collect(), labels)
}

impl Deviation {
    fn of(pixels: &[usize], width: u32, heights: &[f32]) -> Self {
        let Extent { area_px, centroid_px, bounds_px } = Extent::of(pixels, width);
        let heights = || pixels.iter().map(|i| f64::from(heights[*i]));
        Self {
            area_px,
            mean: heights().sum::<f64>() / area_px as f64,
            extreme: heights().fold(0.0, |a, b| if b.abs() > f64::abs(a) { b } else { a }),
            centroid_px,
            bounds_px,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn diagonal_pixels_are_one_region_and_signs_are_separate() {
        let pattern = "\
            +..-.\
            .+.-.\
            ..+..\
            -....";
        let sign = |c: char| i8::from(c == '+') - i8::from(c == '-');
        let signs: Vec<i8> = pattern.chars().map(sign).collect();
        let heights: Vec<f32> = signs.iter().enumerate().map(|(i, s)| f32::from(*s) * (1 + i) as f32).collect();
        let (regions, labels) = label_regions(5, &signs, &heights, 2, |_| true);
        assert_eq!(regions.len(), 2);
        let bounds_px = Region { x: 0, y: 0, width: 3, height: 3 };
        let diagonal = Deviation { area_px: 3, mean: 7.0, extreme: 13.0, centroid_px: [1.0, 1.0], bounds_px };
        assert_eq!(regions[0], diagonal);
        assert_eq!((regions[1].area_px, regions[1].mean, regions[1].extreme), (2, -6.5, -9.0));
        assert_eq!((labels[0], labels[3], labels[15]), (1, 2, 0), "a single pixel is too small");
    }
}
