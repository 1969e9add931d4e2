//! SIFT key-points and their descriptors, through the crate `sift-features`.

use image::{GrayImage, ImageBuffer, Luma};
use sift_features::{Processing, sift_with_processing};

use crate::engine::filter;
use crate::engine::stages::Field;
use crate::engine::stages::field::mirror;

/// The strongest key-points are kept, so that comparing all with all takes some 1e8 distances at most.
const MOST_KEY_POINTS: usize = 8000;
/// Larger images are halved first: the scale space takes some 350 bytes a pixel.
const MOST_PIXELS: usize = 1 << 22;

/// 128 numbers from 0 to 255.
pub(super) type Descriptor = [i16; 128];

/// Key-points: where they are, in pixels of the image, and what they look like.
pub(super) struct Features {
    pub(super) places: Vec<[f64; 2]>,
    pub(super) descriptors: Vec<Descriptor>,
}

impl Features {
    /// Keeps those at some places.
    pub(super) fn keep(&mut self, wanted: impl Fn([f64; 2]) -> bool) {
        let kept: Vec<bool> = self.places.iter().map(|&place| wanted(place)).collect();
        let (mut places, mut descriptors) = (kept.iter(), kept.iter());
        self.places.retain(|_| places.next().is_some_and(|kept| *kept));
        self.descriptors.retain(|_| descriptors.next().is_some_and(|kept| *kept));
    }
}

type Image = ImageBuffer<Luma<f32>, Vec<f32>>;

/// Finds the key-points of a luminance in [0, 1], which the detector takes as 8 bits.
pub(super) fn detect(luminance: &Field) -> Features {
    let values: Vec<f32> = luminance.to_f32();
    let mut image = from_values(luminance.width as u32, luminance.height as u32, values);
    let mut factor = 1.0;
    while image.len() > MOST_PIXELS {
        let (width, height) = image.dimensions();
        image = OnGrid::resize_nearest(&OnGrid::gaussian_blur(&image, 1.0), width.div_ceil(2), height.div_ceil(2));
        factor *= 2.0;
    }
    let quantised = GrayImage::from_fn(image.width(), image.height(), |x, y| {
        Luma([(255.0 * image.get_pixel(x, y).0[0]).round().clamp(0.0, 255.0) as u8])
    });
    let found = sift_with_processing::<OnGrid>(&quantised, Some(MOST_KEY_POINTS));
    Features {
        places: found.keypoints.iter().map(|k| [k.x, k.y].map(|p| factor * f64::from(p))).collect(),
        descriptors: found
            .descriptors
            .rows()
            .into_iter()
            .map(|row| {
                let mut descriptor = [0; 128];
                descriptor.iter_mut().zip(row).for_each(|(to, &from)| *to = from.into());
                descriptor
            })
            .collect(),
    }
}

/// Resizing that puts pixel i of the smaller image on pixel 2i of the larger, and exact Gaussians.
///
/// The crate's own resizing puts it between two, by more on each octave: key-points of one corner at two scales would lie
/// up to a pixel of the coarser apart.
struct OnGrid;

impl Processing for OnGrid {
    fn gaussian_blur(image: &Image, sigma: f64) -> Image {
        let filter: Vec<f32> = filter::gaussian(sigma * sigma).into_iter().map(|w| w as f32).collect();
        along_y(&along_x(image, &filter), &filter)
    }

    fn resize_linear(image: &Image, width: u32, height: u32) -> Image {
        let (last_x, last_y) = (image.width() - 1, image.height() - 1);
        Image::from_fn(width, height, |x, y| {
            let at = |dx: u32, dy: u32| {
                image.get_pixel((x / 2 + dx * (x % 2)).min(last_x), (y / 2 + dy * (y % 2)).min(last_y)).0[0]
            };
            Luma([(at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1)) / 4.0])
        })
    }

    fn resize_nearest(image: &Image, width: u32, height: u32) -> Image {
        Image::from_fn(width, height, |x, y| *image.get_pixel(2 * x, 2 * y))
    }
}

fn from_values(width: u32, height: u32, values: Vec<f32>) -> Image {
    Image::from_raw(width, height, values).unwrap_or_default()
}

/// Row by row, over a copy of the row with its mirrored ends.
fn along_x(image: &Image, filter: &[f32]) -> Image {
    let (width, radius) = (image.width() as usize, (filter.len() / 2) as isize);
    let mut values = Vec::with_capacity(image.len());
    for row in image.as_raw().chunks_exact(width.max(1)) {
        let padded: Vec<f32> = (-radius..width as isize + radius).map(|i| row[mirror(i, width)]).collect();
        let from = values.len();
        values.resize(from + width, 0.0);
        for (n, weight) in filter.iter().enumerate() {
            values[from..].iter_mut().zip(&padded[n..]).for_each(|(sum, value)| *sum += weight * value);
        }
    }
    from_values(image.width(), image.height(), values)
}

/// Whole rows at a time.
fn along_y(image: &Image, filter: &[f32]) -> Image {
    let (width, height, radius) = (image.width() as usize, image.height() as usize, (filter.len() / 2) as isize);
    let mut values = vec![0.0; image.len()];
    for (y, sums) in values.chunks_exact_mut(width.max(1)).enumerate() {
        for (weight, n) in filter.iter().zip(-radius..) {
            let row = &image.as_raw()[mirror(y as isize + n, height) * width..][..width];
            sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += weight * value);
        }
    }
    from_values(image.width(), image.height(), values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::stages::convolve;
    use crate::engine::stages::harness::random_field;

    #[test]
    fn blurs_as_the_stage_does() {
        for (width, height) in [(37, 21), (5, 40), (2, 1)] {
            let field = random_field(width, height, 3);
            let filter = filter::gaussian(4.0);
            let expected = convolve::twin(&convolve::twin(&field, &filter, 1, false), &filter, 1, true);
            let found = OnGrid::gaussian_blur(&from_values(width as u32, height as u32, field.to_f32()), 2.0);
            assert!(found.as_raw().iter().zip(&expected.data).all(|(f, e)| (f64::from(*f) - e).abs() < 1e-5));
        }
    }

    #[test]
    fn doubled_and_halved_is_the_same_image() {
        let image = from_values(5, 3, random_field(5, 3, 1).to_f32());
        let doubled = OnGrid::resize_linear(&image, 10, 6);
        assert_eq!(OnGrid::resize_nearest(&doubled, 5, 3), image);
        assert_eq!(doubled.get_pixel(1, 0).0[0], (image.get_pixel(0, 0).0[0] + image.get_pixel(1, 0).0[0]) / 2.0);
    }

    #[test]
    fn a_blob_is_found_where_it_is() {
        for (x0, y0, sigma) in [(40.0, 33.0, 2.0), (51.3, 36.6, 3.1), (37.7, 40.2, 6.0)] {
            let blob = Field::from_fn(97, 81, |x, y| {
                let (dx, dy) = (x as f64 - x0, y as f64 - y0);
                0.1 + 0.8 * (-(dx * dx + dy * dy) / (2.0 * sigma * sigma)).exp()
            });
            let found = detect(&blob);
            let nearest = found.places.iter().map(|p| (p[0] - x0).hypot(p[1] - y0)).fold(f64::MAX, f64::min);
            assert!(nearest < 0.1, "{nearest} px away, σ {sigma}");
        }
    }

    #[test]
    fn images_without_key_points_have_none() {
        assert!(detect(&Field::from_fn(64, 48, |_, _| 0.5)).places.is_empty());
        assert!(detect(&Field::from_fn(16, 16, |x, _| x as f64 / 16.0)).places.is_empty());
        // Stripes and a checkerboard have extrema without a place.
        for field in [
            Field::from_fn(64, 48, |x, _| (x / 3 % 2) as f64),
            Field::from_fn(64, 48, |x, y| ((x / 3 + y / 3) % 2) as f64),
            Field::from_fn(16, 700, |x, y| 0.5 + 0.5 * (x as f64).sin() * (y as f64 / 2.0).cos()),
        ] {
            assert!(detect(&field).places.iter().flatten().all(|p| p.is_finite()));
        }
    }
}
