//! CPU methods for comparison: registration by SIFT key-points, and shape from focus.
//!
//! Key-points of both images (crate `lowe-sift`, after Lowe 2004) are matched by the ratio test, and a robust
//! least-squares fit determines a similarity.

mod shape_from_focus;
mod similarity_fit;

pub use shape_from_focus::shape_from_focus;

use lowe_sift::{GrayImage, Sift, SiftConfig};

use crate::base::color::LUMINANCE;
use crate::base::{Decode, Error, Frame, Mask, Similarity, centre};
use crate::engine::filter;
use crate::engine::stages::{Field, convolve, ingest};

/// Least number of key-points, matches and inliers. A similarity needs two, and a third may agree by chance.
const LEAST: usize = 6;

/// Registers by SIFT key-points, without key-points of I1 that a mask excludes. It is a function for
/// [`EngineOptions::key_points`](crate::EngineOptions).
///
/// # Errors
/// [`Error::TooFewKeyPoints`].
pub fn key_points([i1, i2]: [&Frame; 2], decode: Decode, mask: Option<&Mask>) -> Result<Similarity, Error> {
    let [mut a, b] = [i1, i2].map(|frame| detect(&ingest::cpu_reference(frame, decode, LUMINANCE)));
    if let Some(mask) = mask {
        a.retain(|[x, y]| mask.contains(x, y));
    }
    enough("key-points in I1", a.places.len())?;
    enough("key-points in I2", b.places.len())?;
    let matches = matches(&a, &b);
    enough("matches of key-points", matches.len())?;
    let (transform, agreeing) = similarity_fit::fit(&matches, centre(i1.width(), i1.height()));
    enough("matches that agree on a similarity", agreeing)?;
    Ok(transform)
}

fn enough(what: &'static str, found: usize) -> Result<(), Error> {
    if found < LEAST { Err(Error::TooFewKeyPoints { what, found, least: LEAST }) } else { Ok(()) }
}

/// Greatest number of key-points; the strongest are kept. Comparing all with all then computes at most some 1e8
/// distances.
const MOST_KEY_POINTS: usize = 8000;
/// Number of pixels above which images are halved first. The scale space takes some 250 bytes per pixel.
const MOST_PIXELS: usize = 1 << 22;
/// Least response of a key-point, white = 1, as in OpenCV. In a blurred photograph few key-points reach Lowe's 0.03.
const LEAST_RESPONSE: f32 = 0.04 / 3.0;
/// Length to which descriptors are scaled. Their components, at most 0.2 before, then fit a byte.
const LENGTH: f32 = 512.0;

/// A descriptor: 128 numbers from 0 to 255.
type Descriptor = [i16; 128];

/// Key-points: positions in pixels of the image, and descriptors.
#[derive(Default)]
struct Features {
    places: Vec<[f64; 2]>,
    descriptors: Vec<Descriptor>,
}

impl Features {
    /// Removes the key-points at positions that a mask excludes.
    fn retain(&mut self, counts: impl Fn([f64; 2]) -> bool) {
        let flags: Vec<bool> = self.places.iter().map(|&place| counts(place)).collect();
        let (mut places, mut descriptors) = (flags.iter(), flags.iter());
        self.places.retain(|_| places.next().is_some_and(|flag| *flag));
        self.descriptors.retain(|_| descriptors.next().is_some_and(|flag| *flag));
    }
}

/// Detects the key-points in a luminance image in [0, 1].
fn detect(luminance: &Field) -> Features {
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

/// Halves the image until it is small enough. Returns it and the factor. Pixel i corresponds to pixel 2i before a
/// halving.
fn reduced(mut image: Field) -> (Field, f64) {
    let (filter, mut factor) = (filter::gaussian(1.0), 1.0);
    while image.data.len() > MOST_PIXELS {
        image = convolve::filtered(&image, [&filter; 2], 2);
        factor *= 2.0;
    }
    (image, factor)
}

fn byte(value: f32) -> i16 {
    (LENGTH * value).round().min(255.0) as i16
}

/// Greatest ratio of the distance of a match to that of the second nearest key-point (Lowe 2004, section 7.1).
const RATIO: f64 = 0.8;

/// A position in I1 and its position in I2, px.
type Match = [[f64; 2]; 2];

/// The nearest and the second nearest key-point so far.
#[derive(Clone, Copy)]
struct Nearest {
    index: usize,
    squared: i32,
    second: i32,
}

impl Nearest {
    const NONE: Self = Self { index: usize::MAX, squared: i32::MAX, second: i32::MAX };

    fn update(&mut self, index: usize, squared: i32) {
        if squared < self.squared {
            *self = Self { index, squared, second: self.squared };
        } else {
            self.second = self.second.min(squared);
        }
    }

    fn is_distinct(&self) -> bool {
        f64::from(self.squared) < RATIO * RATIO * f64::from(self.second)
    }
}

/// Matches the key-points that are mutually nearest and pass the ratio test in I2. Compares all with all.
///
/// A position that matches with several orientations counts several times. When it counted once, five of six real pairs
/// were further from another program's estimate.
fn matches(a: &Features, b: &Features) -> Vec<Match> {
    let mut of_a = vec![Nearest::NONE; a.descriptors.len()];
    let mut of_b = vec![Nearest::NONE; b.descriptors.len()];
    for (i, (da, of_a)) in a.descriptors.iter().zip(&mut of_a).enumerate() {
        for (j, (db, of_b)) in b.descriptors.iter().zip(&mut of_b).enumerate() {
            let squared = squared_distance(da, db);
            of_a.update(j, squared);
            of_b.update(i, squared);
        }
    }
    let mutual = of_a.iter().enumerate().filter(|(i, n)| n.is_distinct() && of_b[n.index].index == *i);
    mutual.map(|(i, n)| [a.places[i], b.places[n.index]]).collect()
}

/// The squared distance of two descriptors. Their numbers are at most 255, so the sum does not overflow.
fn squared_distance(a: &Descriptor, b: &Descriptor) -> i32 {
    a.iter().zip(b).map(|(a, b)| i32::from(a - b) * i32::from(a - b)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blob_is_detected_at_its_position() {
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
        // Stripes and a checkerboard have extrema without a distinct position.
        for field in [
            Field::from_fn(64, 48, |x, _| (x / 3 % 2) as f64),
            Field::from_fn(64, 48, |x, y| ((x / 3 + y / 3) % 2) as f64),
            Field::from_fn(16, 700, |x, y| 0.5 + 0.5 * (x as f64).sin() * (y as f64 / 2.0).cos()),
        ] {
            assert!(detect(&field).places.iter().flatten().all(|p| p.is_finite()));
        }
    }

    fn features(values: &[i16]) -> Features {
        Features {
            places: (0..values.len()).map(|i| [i as f64, 0.0]).collect(),
            descriptors: values.iter().map(|&v| [v; 128]).collect(),
        }
    }

    #[test]
    fn matches_are_mutual_and_distinct() {
        let a = features(&[10, 100, 201, 203]);
        // 12 matches the first. 98 and 102 are equally near to the second. 202 is near to two, and one of them is its
        // own.
        let found = matches(&a, &features(&[98, 102, 12, 202]));
        assert_eq!(found, [[[0.0, 0.0], [2.0, 0.0]], [[2.0, 0.0], [3.0, 0.0]]]);
        assert_eq!(squared_distance(&[255; 128], &[0; 128]), 128 * 255 * 255);
    }

    #[test]
    fn nothing_matches_nothing() {
        assert!(matches(&features(&[]), &features(&[1])).is_empty());
        assert!(matches(&features(&[1]), &features(&[])).is_empty());
    }
}
