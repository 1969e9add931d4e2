//! Connected pixels that deviate.

use crate::base::Region;

/// Connected pixels that deviate, all to one side.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Deviation {
    /// Pixels.
    pub area_px: usize,
    /// Mean height over the golden part, above 0 where it is nearer to the camera.
    pub mean: f64,
    /// The one that is furthest off.
    pub extreme: f64,
    /// Mean place, px.
    pub centroid_px: [f64; 2],
    /// The rectangle around it.
    pub bounds_px: Region,
}

/// Regions of so many pixels at least, the largest first, of pixels whose `sides`, -1 or 1, agree; each pixel has eight neighbours.
/// And of each pixel which region it is in, counted from 1, else 0.
pub(super) fn regions(width: u32, sides: &[i8], heights: &[f32], least: usize) -> (Vec<Deviation>, Vec<u32>) {
    let mut seen: Vec<bool> = sides.iter().map(|side| *side == 0).collect();
    let mut found: Vec<(Deviation, Vec<usize>)> = Vec::new();
    for first in 0..sides.len() {
        if seen[first] {
            continue;
        }
        let pixels = connected(first, width as usize, sides, &mut seen);
        if pixels.len() >= least.max(1) {
            found.push((described(&pixels, width as usize, heights), pixels));
        }
    }
    found.sort_by_key(|(region, _)| std::cmp::Reverse(region.area_px));
    let mut labels = vec![0; sides.len()];
    for (number, (_, pixels)) in (1..).zip(&found) {
        pixels.iter().for_each(|i| labels[*i] = number);
    }
    (found.into_iter().map(|(region, _)| region).collect(), labels)
}

/// The pixels of the same side that the first leads to.
fn connected(first: usize, width: usize, sides: &[i8], seen: &mut [bool]) -> Vec<usize> {
    let mut pixels = vec![first];
    seen[first] = true;
    let mut next = 0;
    while let Some(&i) = pixels.get(next) {
        next += 1;
        let (x, y) = (i % width, i / width);
        for y in y.saturating_sub(1)..=(y + 1).min(sides.len() / width - 1) {
            for x in x.saturating_sub(1)..=(x + 1).min(width - 1) {
                let other = y * width + x;
                if !seen[other] && sides[other] == sides[first] {
                    seen[other] = true;
                    pixels.push(other);
                }
            }
        }
    }
    pixels
}

fn described(pixels: &[usize], width: usize, heights: &[f32]) -> Deviation {
    let count = pixels.len() as f64;
    let mean = |of: &dyn Fn(usize) -> f64| pixels.iter().map(|i| of(*i)).sum::<f64>() / count;
    let ends = |of: &dyn Fn(usize) -> usize| {
        let ends = pixels.iter().map(|i| of(*i)).fold((usize::MAX, 0), |(a, b), p| (a.min(p), b.max(p)));
        (ends.0 as u32, (ends.1 + 1 - ends.0) as u32)
    };
    let ((x, wide), (y, high)) = (ends(&|i| i % width), ends(&|i| i / width));
    let heights = |i: usize| f64::from(heights[i]);
    Deviation {
        area_px: pixels.len(),
        mean: mean(&heights),
        extreme: pixels.iter().map(|i| heights(*i)).fold(0.0, |a, b| if b.abs() > f64::abs(a) { b } else { a }),
        centroid_px: [mean(&|i| (i % width) as f64), mean(&|i| (i / width) as f64)],
        bounds_px: Region { x, y, width: wide, height: high },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_that_touch_at_corners_are_one_region_and_sides_are_apart() {
        let drawn = "\
            +..-.\
            .+.-.\
            ..+..\
            -....";
        let side = |c: char| i8::from(c == '+') - i8::from(c == '-');
        let sides: Vec<i8> = drawn.chars().map(side).collect();
        let heights: Vec<f32> = sides.iter().enumerate().map(|(i, s)| f32::from(*s) * (1 + i) as f32).collect();
        let (found, labels) = regions(5, &sides, &heights, 2);
        assert_eq!(found.len(), 2);
        let bounds_px = Region { x: 0, y: 0, width: 3, height: 3 };
        let diagonal = Deviation { area_px: 3, mean: 7.0, extreme: 13.0, centroid_px: [1.0, 1.0], bounds_px };
        assert_eq!(found[0], diagonal);
        assert_eq!((found[1].area_px, found[1].mean, found[1].extreme), (2, -6.5, -9.0));
        assert_eq!((labels[0], labels[3], labels[15]), (1, 2, 0), "a single pixel is too small");
    }
}
