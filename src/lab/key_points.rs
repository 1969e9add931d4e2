//! Registration by SIFT key-points.
//!
//! Key-points of both images (crate `lowe-sift`, after Lowe 2004) are matched by the ratio test. RANSAC over pairs of
//! matches (Fischler and Bolles 1981) finds the inliers. Least squares, reweighted by Tukey's biweight, fits them.

use lowe_sift::{GrayImage, Sift, SiftConfig};
use nalgebra::Complex;

use crate::base::color::LUMINANCE;
use crate::base::{Decode, Error, Frame, Mask, Similarity, centre};
use crate::engine::filter;
use crate::engine::stages::{Field, ingest, separable, unit};

/// Least number of key-points, matches and inliers. A similarity needs two, and a third may agree by chance.
const LEAST: usize = 6;

/// Registers by SIFT key-points, without key-points of I1 that a mask excludes. It is a function for
/// [`EngineOptions::key_points`](crate::EngineOptions).
///
/// # Errors
/// [`Error::TooFewKeyPoints`].
pub fn key_points([i1, i2]: [&Frame; 2], decode: Decode, mask: Option<&Mask>) -> Result<Similarity, Error> {
    let unit = unit::cpu_reference([i1, i2], decode, LUMINANCE);
    let images = [i1, i2].map(|frame| ingest::in_units(Field::default(), frame, decode, LUMINANCE, unit));
    let register =
        |least: f32| register(images.each_ref().map(|image| detect(image, least)), [i1.width(), i1.height()], mask);
    register(LEAST_RESPONSE).or_else(|problem| register(WEAK * LEAST_RESPONSE).map_err(|_| problem))
}

/// Registers by key-points. The mask is on the pixels of I1.
fn register([mut a, b]: [Features; 2], size: [u32; 2], mask: Option<&Mask>) -> Result<Similarity, Error> {
    if let Some(mask) = mask {
        a.retain(|[x, y]| mask.contains(x, y));
    }
    enough("key-points in I1", a.places.len())?;
    enough("key-points in I2", b.places.len())?;
    let matches = matches(&a, &b);
    enough("matches of key-points", matches.len())?;
    let (transform, agreeing) = fit(&matches, centre(size[0], size[1]));
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
/// Least response of a key-point, in [units](unit) of intensity, as in OpenCV. In a blurred photograph few key-points
/// reach Lowe's 0.03.
const LEAST_RESPONSE: f32 = 0.04 / 3.0;
/// The share of it that key-points have at least if there are too few of the others: of texture of little contrast.
const WEAK: f32 = 0.2;
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

/// Detects the key-points in a luminance image in units, of at least this response.
fn detect(luminance: &Field, response: f32) -> Features {
    let (image, factor) = reduced(luminance.clone());
    let Ok(image) = GrayImage::new(image.width, image.height, image.to_f32()) else { return Features::default() };
    let sift = Sift::new(SiftConfig { contrast_threshold: response, ..SiftConfig::default() });
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
        image = separable::filtered(&image, [&filter; 2], 2);
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

/// Number of tested pairs of matches. With half of the matches wrong, no tested pair is correct with a probability of
/// 1e-100.
const TRIALS: usize = 1000;
/// Distance within which a match is an inlier, px. Defocus moves key-points by one or two.
const TOLERANCE: f64 = 3.0;
/// Number of reweighted fits, a few more than convergence needs.
const FITS: usize = 20;
/// Tukey's constant: 95 % efficiency relative to least squares for normal errors.
const TUKEY: f64 = 4.685;

/// A position relative to the centre, and its displacement, as complex numbers: T x - x = t + (a + ib) (x - c).
#[derive(Clone, Copy)]
struct Displaced {
    place: Complex<f64>,
    by: Complex<f64>,
}

/// A linear displacement field: the point at `place` moves by `t + m place`.
#[derive(Clone, Copy)]
struct Linear {
    t: Complex<f64>,
    m: Complex<f64>,
}

impl Linear {
    fn error(&self, d: &Displaced) -> f64 {
        (self.t + self.m * d.place - d.by).norm()
    }

    fn agreeing(&self, all: &[Displaced]) -> usize {
        all.iter().filter(|d| self.error(d) < TOLERANCE).count()
    }

    /// Fits by weighted least squares; `None` if all positions are equal.
    fn fit(all: &[Displaced], weights: &[f64]) -> Option<Self> {
        let total: f64 = weights.iter().sum();
        let mean = |value: &dyn Fn(&Displaced) -> Complex<f64>| {
            all.iter().zip(weights).map(|(d, w)| value(d) * *w).sum::<Complex<f64>>() / total
        };
        let (place, by) = (mean(&|d| d.place), mean(&|d| d.by));
        let spread = mean(&|d| (d.place - place).norm_sqr().into()).re;
        // NaN if the total is zero.
        if spread.is_nan() || spread < 1e-6 {
            return None;
        }
        let m = mean(&|d| (d.place - place).conj() * (d.by - by)) / spread;
        Some(Self { t: by - m * place, m })
    }
}

/// Returns the similarity about `centre` with the most inliers, within 3 px, and their number. The number is 0 if all
/// positions are equal.
fn fit(matches: &[Match], centre: [f64; 2]) -> (Similarity, usize) {
    let all: Vec<Displaced> = matches
        .iter()
        .map(|[p, q]| Displaced {
            place: Complex::new(p[0] - centre[0], p[1] - centre[1]),
            by: Complex::new(q[0] - p[0], q[1] - p[1]),
        })
        .collect();
    let Some(mut found) = consensus(&all) else { return (Similarity::IDENTITY, 0) };
    for _ in 0..FITS {
        match Linear::fit(&all, &weights(&all, &found)) {
            Some(next) => found = next,
            None => break,
        }
    }
    (Similarity::from_displacement([found.m.re, found.m.im, found.t.re, found.t.im]), found.agreeing(&all))
}

/// Returns the map through a pair of matches with the most inliers. Equal matches give equal pairs.
fn consensus(all: &[Displaced]) -> Option<Linear> {
    let mut state = 1u64;
    // The multiplier is that of Knuth's MMIX. Its high bits are random enough.
    let mut any = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        all[(state >> 33) as usize % all.len()]
    };
    let mut best = None;
    let mut most = 0;
    for _ in 0..if all.is_empty() { 0 } else { TRIALS } {
        let pair = [any(), any()];
        // A scale outside this range does not occur between photographs.
        let possible = |l: &Linear| (0.1..10.0).contains(&(l.m + 1.0).norm());
        if let Some(linear) = Linear::fit(&pair, &[1.0, 1.0]).filter(possible) {
            let agreeing = linear.agreeing(all);
            if agreeing > most {
                (most, best) = (agreeing, Some(linear));
            }
        }
    }
    best
}

/// Tukey's weights of the matches, scaled by the median error of the inliers.
fn weights(all: &[Displaced], linear: &Linear) -> Vec<f64> {
    let errors: Vec<f64> = all.iter().map(|d| linear.error(d)).collect();
    let mut near: Vec<f64> = errors.iter().copied().filter(|e| *e < TOLERANCE).collect();
    near.sort_unstable_by(f64::total_cmp);
    // A two-dimensional normal error of standard deviation σ per axis has the median length 1.1774 σ.
    let sigma = near.get(near.len() / 2).map_or(0.0, |median| median / 1.1774);
    let reach = (TUKEY * sigma).clamp(1e-6, TOLERANCE);
    errors.iter().map(|e| (1.0 - (e / reach).powi(2)).max(0.0).powi(2)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Settings;
    use crate::engine::stages::harness::random;
    use crate::engine::{Engine, EngineOptions};
    use crate::solve::{PairSolver, SolveOptions};

    #[test]
    fn a_blob_is_detected_at_its_position() {
        for (x0, y0, sigma) in [(40.0, 33.0, 2.0), (51.3, 36.6, 3.1), (37.7, 40.2, 6.0)] {
            let blob = Field::from_fn(97, 81, |x, y| {
                let (dx, dy) = (x as f64 - x0, y as f64 - y0);
                0.1 + 0.8 * (-(dx * dx + dy * dy) / (2.0 * sigma * sigma)).exp()
            });
            let found = detect(&blob, LEAST_RESPONSE);
            let nearest = found.places.iter().map(|p| (p[0] - x0).hypot(p[1] - y0)).fold(f64::MAX, f64::min);
            assert!(nearest < 0.1, "{nearest} px away, σ {sigma}");
        }
    }

    /// Noise of wavelengths about 5 px, moved by 9 and -7 px: coarse levels show nothing of it.
    #[test]
    fn key_points_start_a_registration_that_is_in_doubt() {
        let noise = Field { data: random(180 * 140, 3), ..Field::zeros(180, 140) };
        let [fine, coarse] = [1.0, 1.8].map(|sigma| separable::smoothed(&noise, sigma));
        let frames = [[10, 10], [1, 17]].map(|[x, y]| {
            let value = |i: usize| {
                let at = (i / 160 + y) * 180 + i % 160 + x;
                (0.4 + fine.data[at] - coarse.data[at]) as f32
            };
            Frame::gray(160, 120, (0..160 * 120).map(value).collect()).unwrap()
        });
        let register = |key_points| {
            let device = Some("CPU".into());
            let engine = Engine::new(&EngineOptions { device, key_points, ..EngineOptions::default() }).unwrap();
            let mut solver = PairSolver::new(&engine, &Settings::default()).unwrap();
            solver.register(frames.each_ref(), &SolveOptions::default()).unwrap()
        };
        let found = register(Some(key_points));
        let truth = Similarity { tx: 9.0, ty: -7.0, ..Similarity::IDENTITY };
        let error = found.transform.corner_distance(truth, 160, 120);
        assert!(error < 0.1 && found.converged, "{error} {:?}", found.warnings);
        assert!(!register(None).converged);
    }

    #[test]
    fn images_without_key_points_have_none() {
        assert!(detect(&Field::from_fn(64, 48, |_, _| 0.5), LEAST_RESPONSE).places.is_empty());
        assert!(detect(&Field::from_fn(16, 16, |x, _| x as f64 / 16.0), LEAST_RESPONSE).places.is_empty());
        // Stripes and a checkerboard have extrema without a distinct position.
        for field in [
            Field::from_fn(64, 48, |x, _| (x / 3 % 2) as f64),
            Field::from_fn(64, 48, |x, y| ((x / 3 + y / 3) % 2) as f64),
            Field::from_fn(16, 700, |x, y| 0.5 + 0.5 * (x as f64).sin() * (y as f64 / 2.0).cos()),
        ] {
            assert!(detect(&field, LEAST_RESPONSE).places.iter().flatten().all(|p| p.is_finite()));
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

    const CENTRE: [f64; 2] = [319.5, 239.5];

    fn truth() -> Similarity {
        Similarity::new(-12.3, 8.1, 1.7, 1.06)
    }

    /// Matches with a share of outliers. The others have errors up to `noise` px along each axis.
    fn matched(count: usize, wrong: f64, noise: f64) -> Vec<Match> {
        let numbers = random(6 * count, 5);
        let place = |n: &[f64]| [640.0 * n[0], 480.0 * n[1]];
        numbers
            .chunks_exact(6)
            .enumerate()
            .map(|(i, n)| {
                let p = place(n);
                let q = truth().apply(p, CENTRE);
                let right = [q[0] + noise * (2.0 * n[4] - 1.0), q[1] + noise * (2.0 * n[5] - 1.0)];
                [p, if (i as f64) < wrong * count as f64 { place(&n[2..]) } else { right }]
            })
            .collect()
    }

    fn distance(found: &Similarity) -> f64 {
        found.corner_distance(&truth(), 640, 480)
    }

    #[test]
    fn exact_matches_give_the_exact_similarity() {
        for (count, wrong) in [(2, 0.0), (6, 0.0), (200, 0.0), (200, 0.6)] {
            let (found, agreeing) = fit(&matched(count, wrong, 0.0), CENTRE);
            assert!(distance(&found) < 1e-9, "{found:?}");
            assert!(agreeing >= count - (wrong * count as f64) as usize && agreeing < count + 1);
        }
    }

    #[test]
    fn noise_averages_out() {
        let (found, agreeing) = fit(&matched(1000, 0.4, 1.0), CENTRE);
        assert!(distance(&found) < 0.1, "{}", distance(&found));
        assert!((600..620).contains(&agreeing), "{agreeing}");
    }

    #[test]
    fn no_matches_or_equal_positions_give_no_inliers() {
        assert_eq!(fit(&[], CENTRE).1, 0);
        assert_eq!(fit(&[[[10.0, 20.0], [11.0, 21.0]]; 9], CENTRE).1, 0);
        assert!(fit(&matched(60, 1.0, 0.0), CENTRE).1 < 6);
    }
}
