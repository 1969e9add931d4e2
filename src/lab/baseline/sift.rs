//! SIFT key-points and their descriptors, through the crate `lowe-sift`.

use lowe_sift::{GrayImage, Sift, SiftConfig};

use crate::engine::filter;
use crate::engine::stages::{Field, convolve};

/// The strongest key-points are kept, so that comparing all with all takes some 1e8 distances at most.
const MOST_KEY_POINTS: usize = 8000;
/// Larger images are halved first: the scale space takes some 250 bytes a pixel.
const MOST_PIXELS: usize = 1 << 22;
/// Least response of a key-point, white being 1. Of Lowe's 0.03 too few in a blurred photograph come up to it; this is
/// what OpenCV takes.
const LEAST_RESPONSE: f32 = 0.04 / 3.0;
/// The length of a descriptor: its numbers, none above 0.2 before they are scaled to it again, then fit a byte.
const LENGTH: f32 = 512.0;

/// 128 numbers from 0 to 255.
pub(super) type Descriptor = [i16; 128];

/// Key-points: where they are, in pixels of the image, and what they look like.
#[derive(Default)]
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

/// Finds the key-points of a luminance in [0, 1].
pub(super) fn detect(luminance: &Field) -> Features {
    let (image, factor) = reduced(luminance.clone());
    let Ok(image) = GrayImage::new(image.width, image.height, image.to_f32()) else { return Features::default() };
    let sift = Sift::new(SiftConfig { contrast_threshold: LEAST_RESPONSE, ..SiftConfig::default() });
    let mut found = sift.unwrap_or_default().detect_and_compute(&image);
    found.sort_by(|a, b| b.keypoint.response.total_cmp(&a.keypoint.response));
    found.truncate(MOST_KEY_POINTS);
    Features {
        places: found.iter().map(|f| [f.keypoint.x, f.keypoint.y].map(|p| factor * f64::from(p))).collect(),
        descriptors: found.iter().map(|f| f.descriptor.as_slice().map(byte)).collect(),
    }
}

/// Halved until it is small enough, and the pixels of the image to one of its own; pixel i sits on pixel 2i.
fn reduced(mut image: Field) -> (Field, f64) {
    let (filter, mut factor) = (filter::gaussian(1.0), 1.0);
    while image.data.len() > MOST_PIXELS {
        image = convolve::cpu_reference(&convolve::cpu_reference(&image, &filter, 2, false), &filter, 2, true);
        factor *= 2.0;
    }
    (image, factor)
}

fn byte(value: f32) -> i16 {
    (LENGTH * value).round().min(255.0) as i16
}

#[cfg(test)]
mod tests {
    use super::*;

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
