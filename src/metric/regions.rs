//! Connected regions of marked pixels.

use crate::base::Region;

/// The extent of a connected region.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Extent {
    /// The number of pixels.
    pub(super) area_px: usize,
    /// The centroid, px.
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
