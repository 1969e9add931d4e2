//! Inspection of a part against a golden part: where the heights differ by more than the tolerance.
//!
//! Both are registered to the same pixels. The tilt of the part in its fixture, a plane, is subtracted first. A pixel
//! deviates if the remaining difference exceeds the tolerance and the uncertainty of both.

use crate::base::{Error, Region};

pub use super::{heights::Heights, plane::Plane};

/// The standard deviation of the registration error, px, which gives an error of height on slopes. Key-points of
/// photographs of one part agree to 0.1 to 0.2 px.
const REGISTRATION_SIGMA: f64 = 0.25;

/// The share of the tolerance from which a difference has no weight in the fit of the plane, where noise is less. With
/// all of the tolerance, a plane that halves a step of 1.5 tolerances over half of the part would fit better than one
/// that lies on a half of the part.
const FLAT: f64 = 1.0 / 3.0;

/// The default of [`Limits::max_tilt`], in tolerances. A part that is thicker at one side looks tilted, so that tilt needs
/// a bound, and only the user knows how well the fixture holds. Up to here the tilt itself leaves no difference: good
/// parts that lie tilted by 4 to 8 tolerances are found tilted by that, within 0.5 %, and nothing deviates.
const MAX_TILT: f64 = 10.0;

/// The limits of an inspection.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Limits {
    /// The allowed difference of heights, in their unit.
    pub tolerance: f64,
    /// The number of standard deviations that a difference must exceed.
    pub sigmas: f64,
    /// The smallest area of a deviating region, px.
    pub min_area_px: usize,
    /// The largest fraction of the golden part's pixels that may stay without a judgement, 0 to 1: pixels without a
    /// height of the part, or with one too uncertain for the tolerance.
    pub max_unjudged: f64,
    /// The largest tilt of the part over the golden part, [`Plane::tilt`], in the unit of the heights.
    pub max_tilt: f64,
}

impl Limits {
    /// Returns the default limits: 3 standard deviations, an area of 50 px, a quarter of the pixels without heights, and
    /// a tilt of ten tolerances from one corner of the picture to the opposite one. Noise that is correlated over 2 px exceeds 3 standard deviations in regions of 5 px on average, and in
    /// one of 50 px once in twenty images of 2 Mpx.
    pub fn new(tolerance: f64) -> Self {
        Self { tolerance, sigmas: 3.0, min_area_px: 50, max_unjudged: 0.25, max_tilt: MAX_TILT * tolerance }
    }
}

/// Whether a part passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize), serde(rename_all = "kebab-case"))]
pub enum Verdict {
    /// No region deviates, and enough pixels were judged.
    Go,
    /// A region deviates, or too many pixels have no height of the part.
    NoGo,
    /// The part is too uncertain for the tolerance, or lies more tilted than is allowed.
    CannotJudge,
}

impl Verdict {
    /// The verdict in words.
    pub fn text(self) -> &'static str {
        match self {
            Self::Go => "go",
            Self::NoGo => "no-go",
            Self::CannotJudge => "cannot judge",
        }
    }
}

/// The result of an inspection.
#[derive(Clone, Debug, PartialEq)]
pub struct Inspection {
    /// The plane of the part over the golden part.
    pub plane: Plane,
    /// The tilt of the plane over the picture.
    pub tilt: f64,
    /// The number of pixels that were judged: both have a height, and the part's is certain enough for the tolerance, or
    /// deviates for certain.
    pub judged: usize,
    /// The number of pixels at which only the golden part has a height.
    pub unjudged: usize,
    /// The number of pixels at which both have a height, but the part's is too uncertain for the tolerance.
    pub uncertain: usize,
    /// The least tolerance that the part's uncertainty allows to judge; `None` if too many of its heights are missing.
    pub least_tolerance: Option<f64>,
    /// The row-major heights of the part minus those of the golden part and the plane. NaN where not judged.
    pub difference: Vec<f32>,
    /// The deviating regions, the largest first.
    pub regions: Vec<Deviation>,
    /// The number of each pixel's region, from 1, or 0.
    pub labels: Vec<u32>,
}

impl Inspection {
    /// Returns the fraction of the golden part's pixels at which the part has no height.
    pub fn unjudged_share(&self) -> f64 {
        self.share(self.unjudged)
    }

    /// Returns the fraction of the golden part's pixels at which the part's height is too uncertain for the tolerance.
    pub fn uncertain_share(&self) -> f64 {
        self.share(self.uncertain)
    }

    fn share(&self, pixels: usize) -> f64 {
        pixels as f64 / (self.judged + self.unjudged + self.uncertain).max(1) as f64
    }

    /// Returns the verdict.
    pub fn verdict(&self, limits: &Limits) -> Verdict {
        if !self.regions.is_empty() || self.unjudged_share() > limits.max_unjudged {
            Verdict::NoGo
        } else if self.unjudged_share() + self.uncertain_share() > limits.max_unjudged || self.tilt > limits.max_tilt {
            Verdict::CannotJudge
        } else {
            Verdict::Go
        }
    }
}

/// Inspects a part that is registered to the pixels of a golden part.
///
/// # Errors
/// [`Error::Mismatch`] if their sizes differ, or too few pixels have both heights.
pub fn inspect(part: &Heights, golden: &Heights, limits: &Limits) -> Result<Inspection, Error> {
    let (plane, difference) = difference(part, golden, limits)?;
    let allowed = |i: usize| {
        let sigma = f64::from(part.deviation[i]).hypot(f64::from(golden.deviation[i]));
        limits.tolerance.max(limits.sigmas * sigma.hypot(REGISTRATION_SIGMA * golden.slope(i)))
    };
    let sign = |(i, difference): (usize, &f32)| match f64::from(*difference) {
        above if above > allowed(i) => 1,
        below if below < -allowed(i) => -1,
        _ => 0,
    };
    let signs: Vec<i8> = difference.iter().enumerate().map(sign).collect();
    let (regions, labels) = label_regions(golden.width, &signs, &difference, limits.min_area_px);
    let compared = difference.iter().filter(|v| v.is_finite()).count();
    let valid = golden.values.iter().filter(|v| v.is_finite()).count();
    // A deviation as large as the tolerance would be within this of a good part.
    let needed = |i: usize| limits.sigmas * f64::from(part.deviation[i]);
    let is_uncertain = |i: &usize| difference[*i].is_finite() && signs[*i] == 0 && needed(*i) > limits.tolerance;
    let uncertain = (0..difference.len()).filter(is_uncertain).count();
    let mut all: Vec<f64> = (0..difference.len()).filter(|i| difference[*i].is_finite()).map(needed).collect();
    all.sort_by(f64::total_cmp);
    let last = ((1.0 - limits.max_unjudged) * valid as f64).ceil() as usize;
    let least_tolerance = all.get(last.saturating_sub(1)).copied().filter(|t| t.is_finite());
    let (judged, unjudged) = (compared - uncertain, valid - compared);
    let tilt = plane.tilt([golden.width, golden.height]);
    Ok(Inspection { plane, tilt, judged, unjudged, uncertain, least_tolerance, difference, regions, labels })
}

/// Makes a golden part from several good parts that are registered to the pixels of the first.
///
/// The plane of each part over the first is subtracted, as [`inspect`] does with these limits. The height is the mean where more than half of the parts have
/// one. The standard deviation includes the scatter of good parts: with the variance τ² between parts and σ² of the
/// measurement, n heights have the variance τ² + σ², and a good part differs from their mean by τ² + (τ² + σ²) / n,
/// besides its own σ².
///
/// # Errors
/// As for [`inspect`].
pub fn golden(parts: &[Heights], limits: &Limits) -> Result<Heights, Error> {
    let Some((first, others)) = parts.split_first() else {
        return Err(Error::Mismatch("no golden part was given".to_string()));
    };
    let size = [first.width, first.height];
    let mut on_first = vec![first.values.clone()];
    for other in others {
        let mut values = other.values.clone();
        difference(other, first, limits)?.0.subtract_from(size, &mut values);
        on_first.push(values);
    }
    let pixel = |i: usize| {
        let all = on_first.iter().zip(parts).map(|(v, part)| (f64::from(v[i]), f64::from(part.deviation[i])));
        let valid: Vec<(f64, f64)> = all.filter(|(v, sigma)| v.is_finite() && sigma.is_finite()).collect();
        let (mean, sigma) = if 2 * valid.len() > parts.len() { combine(&valid) } else { (f64::NAN, f64::NAN) };
        (mean as f32, sigma as f32)
    };
    let (values, deviation) = (0..first.values.len()).map(pixel).unzip::<f32, f32, Vec<_>, Vec<_>>();
    Heights::new(size, &values, &deviation)
}

/// Returns the mean of heights with their standard deviations, and the standard deviation of a good part from it,
/// without the measurement error of that part.
fn combine(heights: &[(f64, f64)]) -> (f64, f64) {
    let count = heights.len() as f64;
    let mean = heights.iter().map(|(v, _)| v).sum::<f64>() / count;
    let measured = heights.iter().map(|(_, sigma)| sigma * sigma).sum::<f64>() / count;
    let spread = heights.iter().map(|(v, _)| (v - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
    let between = (spread - measured).max(0.0);
    (mean, (between + spread.max(measured) / count).sqrt())
}

/// Returns the plane of a part over another, and the differences of their heights without it. NaN where either has no
/// height.
fn difference(part: &Heights, other: &Heights, limits: &Limits) -> Result<(Plane, Vec<f32>), Error> {
    let size = [other.width, other.height];
    if [part.width, part.height] != size {
        let sizes = format!("{}x{} and {}x{}", part.width, part.height, size[0], size[1]);
        return Err(Error::Mismatch(format!("heights of {sizes} pixels differ in size")));
    }
    let mut difference: Vec<f32> = part.values.iter().zip(&other.values).map(|(a, b)| a - b).collect();
    let noise = |i: usize| {
        let sigma = f64::from(part.deviation[i]).hypot(f64::from(other.deviation[i]));
        limits.sigmas * sigma.hypot(REGISTRATION_SIGMA * other.slope(i))
    };
    let plane = Plane::fit(size, &difference, |i| noise(i).max(FLAT * limits.tolerance)).ok_or_else(|| {
        Error::Mismatch("both have a height at too few pixels: is it the same part, and in the picture?".to_string())
    })?;
    plane.subtract_from(size, &mut difference);
    Ok((plane, difference))
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

/// Labels the 8-connected regions of pixels with the same sign, -1 or 1, and at least `min_area` pixels. Returns them,
/// the largest first, with the number of each pixel's region, from 1, or 0.
fn label_regions(width: u32, signs: &[i8], heights: &[f32], min_area: usize) -> (Vec<Deviation>, Vec<u32>) {
    let mut visited: Vec<bool> = signs.iter().map(|sign| *sign == 0).collect();
    let mut regions: Vec<(Deviation, Vec<usize>)> = Vec::new();
    for first in 0..signs.len() {
        if visited[first] {
            continue;
        }
        let pixels = connected_pixels(first, width as usize, signs, &mut visited);
        if pixels.len() >= min_area.max(1) {
            regions.push((describe(&pixels, width as usize, heights), pixels));
        }
    }
    regions.sort_by_key(|(region, _)| std::cmp::Reverse(region.area_px));
    let mut labels = vec![0; signs.len()];
    for (number, (_, pixels)) in (1..).zip(&regions) {
        pixels.iter().for_each(|i| labels[*i] = number);
    }
    (regions.into_iter().map(|(region, _)| region).collect(), labels)
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

fn describe(pixels: &[usize], width: usize, heights: &[f32]) -> Deviation {
    let count = pixels.len() as f64;
    let mean = |of: &dyn Fn(usize) -> f64| pixels.iter().map(|i| of(*i)).sum::<f64>() / count;
    let span = |of: &dyn Fn(usize) -> usize| {
        let (first, last) = pixels.iter().map(|i| of(*i)).fold((usize::MAX, 0), |(a, b), p| (a.min(p), b.max(p)));
        (first as u32, (last + 1 - first) as u32)
    };
    let ((x, columns), (y, rows)) = (span(&|i| i % width), span(&|i| i / width));
    let heights = |i: usize| f64::from(heights[i]);
    Deviation {
        area_px: pixels.len(),
        mean: mean(&heights),
        extreme: pixels.iter().map(|i| heights(*i)).fold(0.0, |a, b| if b.abs() > f64::abs(a) { b } else { a }),
        centroid_px: [mean(&|i| (i % width) as f64), mean(&|i| (i / width) as f64)],
        bounds_px: Region { x, y, width: columns, height: rows },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::Random;
    use crate::base::statistics::tests::smooth_noise;
    use crate::base::{Similarity, centre};

    const SIZE: [u32; 2] = [120, 90];

    /// The height of a good part at a point.
    fn relief([x, y]: [f64; 2]) -> f64 {
        5.0 + 1.5 * (0.11 * x).sin() * (0.13 * y).cos()
    }

    fn heights(of: impl Fn(f64, f64) -> f64, sigma: f64) -> Heights {
        let width = SIZE[0] as usize;
        let pixels = width * SIZE[1] as usize;
        let values: Vec<f32> = (0..pixels).map(|i| of((i % width) as f64, (i / width) as f64) as f32).collect();
        Heights::new(SIZE, &values, &vec![sigma as f32; pixels]).unwrap()
    }

    fn good(sigma: f64) -> Heights {
        heights(|x, y| relief([x, y]), sigma)
    }

    /// The transform from the golden part's pixels to the part's image.
    fn shift() -> Similarity {
        Similarity::new(3.4, -2.7, 2.0, 1.01)
    }

    /// A tilted part with an added relief, registered to the golden part's pixels.
    fn part(added: impl Fn(f64, f64) -> f64, sigma: f64) -> Heights {
        let (t, middle) = (shift(), centre(SIZE[0], SIZE[1]));
        let at = |x: f64, y: f64| {
            let place = t.inverse().apply([x, y], middle);
            relief(place) + added(place[0], place[1]) + 0.7 + 0.02 * x - 0.015 * y
        };
        heights(at, sigma).resample(SIZE, &t)
    }

    fn disk(x: f64, y: f64, [cx, cy]: [f64; 2], radius: f64) -> bool {
        (x - cx).hypot(y - cy) < radius
    }

    #[test]
    fn tilt_and_shift_alone_pass() {
        let limits = Limits { max_tilt: 4.0, ..Limits::new(0.1) };
        let found = inspect(&part(|_, _| 0.0, 0.01), &good(0.01), &limits).unwrap();
        assert_eq!(found.verdict(&limits), Verdict::Go, "{:?}", found.regions);
        let most = found.difference.iter().filter(|off| off.is_finite()).fold(0.0f32, |a, b| a.max(b.abs()));
        assert!(most < 0.02, "bilinear in the relief: {most}");
        // What left the picture.
        let share = found.unjudged_share();
        assert!(share > 0.02 && share < 0.15, "{share}");
        // The tilt in the part's pixels, turned by 2° and scaled.
        let [a, b] = found.plane.slope;
        assert!((a.hypot(b) - 1.01 * 0.02f64.hypot(0.015)).abs() < 1e-3, "{:?}", found.plane);
        assert!((found.tilt - (a.abs() * 119.0 + b.abs() * 89.0)).abs() < 1e-9 && found.tilt > 3.5);
        // More than ten tolerances.
        assert_eq!(found.verdict(&Limits::new(0.1)), Verdict::CannotJudge);
        assert_eq!(found.verdict(&Limits { max_tilt: 3.5, ..limits }), Verdict::CannotJudge);
    }

    #[test]
    fn a_step_over_up_to_half_of_a_tilted_part_is_no_go() {
        for (n, share) in [0.3, 0.4, 0.5].into_iter().enumerate() {
            for (seed, height) in [(0, 1.5), (1, -1.5), (2, 3.0)] {
                let noise = smooth_noise([120, 90], 2.0, 3 * n as u64 + seed);
                let at = |x: f64, y: f64| {
                    let step = if x < 119.0 * share { height } else { 0.0 };
                    relief([x, y]) + step + 0.01 * x - 0.02 * y + 0.05 * noise[y as usize * 120 + x as usize]
                };
                let limits = Limits::new(1.0);
                let found = inspect(&heights(at, 0.05), &good(0.05), &limits).unwrap();
                assert_eq!(found.verdict(&limits), Verdict::NoGo, "{share} {height}: {:?}", found.plane);
                let area = found.regions[0].area_px as f64 / (120.0 * 90.0);
                // Of two halves either may be the part.
                assert!((area - share).abs() < 0.02, "{share} {height}: {area}");
                assert!((found.tilt - (1.19 + 1.78)).abs() < 0.1, "{share} {height}: {}", found.tilt);
            }
        }
    }

    #[test]
    fn a_bump_and_a_pit_are_located() {
        let (bump, pit) = ([40.0, 30.0], [85.0, 60.0]);
        let added = |x: f64, y: f64| match () {
            () if disk(x, y, bump, 8.0) => 1.0,
            () if disk(x, y, pit, 5.0) => -0.6,
            () => 0.0,
        };
        let limits = Limits::new(0.3);
        let found = inspect(&part(added, 0.01), &good(0.01), &limits).unwrap();
        assert!(found.verdict(&limits) == Verdict::NoGo && found.regions.len() == 2, "{:?}", found.regions);
        for (region, place, radius, height) in [(found.regions[0], bump, 8.0, 1.0), (found.regions[1], pit, 5.0, -0.6)]
        {
            let area = std::f64::consts::PI * radius * radius;
            // The rim is half a pixel wide on each side.
            assert!((region.area_px as f64 - area).abs() < std::f64::consts::PI * radius, "{region:?}");
            let [x, y] = region.centroid_px;
            // Pixels at the rim may be inside or outside.
            assert!((x - place[0]).hypot(y - place[1]) < 0.5, "{region:?}");
            // Interpolation lowers the rim, and not the extreme.
            assert!((region.extreme - height).abs() < 0.03 && (region.mean / height - 0.95).abs() < 0.06, "{region:?}");
            let bounds = region.bounds_px;
            assert!(bounds.width.abs_diff(2 * radius as u32) <= 2, "{bounds:?}");
            assert!((f64::from(bounds.x) + radius - place[0]).abs() < 1.6, "{bounds:?}");
        }
        let within = found.labels[30 * 120 + 40];
        assert_eq!((within, found.labels[60 * 120 + 85], found.labels[0]), (1, 2, 0));
        let wide = Limits { min_area_px: 100, ..limits };
        assert_eq!(inspect(&part(added, 0.01), &good(0.01), &wide).unwrap().regions.len(), 1);
        assert!(inspect(&part(added, 0.01), &good(0.01), &Limits::new(1.2)).unwrap().regions.is_empty());
        assert!(inspect(&part(added, 0.3), &good(0.3), &limits).unwrap().regions.is_empty(), "within three deviations");
    }

    #[test]
    fn noise_at_its_stated_deviation_gives_no_region() {
        let (sigma, limits) = (0.2, Limits::new(0.0));
        for seed in 0..4 {
            let noise = [2 * seed, 2 * seed + 1].map(|seed| smooth_noise([120, 90], 2.0, seed));
            let [part, golden] =
                noise.map(|noise| heights(|x, y| relief([x, y]) + sigma * noise[y as usize * 120 + x as usize], sigma));
            let found = inspect(&part, &golden, &limits).unwrap();
            // No pixel can be judged by a tolerance of zero.
            assert_eq!(found.verdict(&limits), Verdict::CannotJudge, "{:?}", found.regions);
        }
    }

    #[test]
    fn missing_heights_are_not_judged_and_too_many_fail() {
        let nan = f64::NAN;
        let hole = |x: f64, y: f64| if x < 40.0 && y < 45.0 { nan } else { relief([x, y]) };
        // Pixels without a golden height are not missing.
        let found = inspect(&good(0.03), &heights(hole, 0.03), &Limits::new(0.1)).unwrap();
        assert_eq!((found.unjudged, found.judged), (0, 120 * 90 - 40 * 45));
        let limits = Limits::new(0.1);
        let found = inspect(&heights(hole, 0.03), &good(0.03), &limits).unwrap();
        assert_eq!((found.unjudged, found.regions.len()), (40 * 45, 0));
        assert!(found.difference[0].is_nan() && found.verdict(&limits) == Verdict::Go);
        let strict = Limits { max_unjudged: 0.16, ..limits };
        assert_eq!(found.verdict(&strict), Verdict::NoGo, "a sixth, {}", found.unjudged_share());
        let none = heights(|_, _| nan, 0.1);
        assert!(inspect(&none, &good(0.1), &limits).unwrap_err().to_string().contains("too few pixels"));
    }

    #[test]
    fn a_part_too_uncertain_for_the_tolerance_cannot_be_judged() {
        let limits = Limits::new(0.1);
        // Three standard deviations are 0.15 in a third of the picture.
        let mut part = good(0.02);
        part.deviation.iter_mut().step_by(3).for_each(|sigma| *sigma = 0.05);
        let found = inspect(&part, &good(0.02), &limits).unwrap();
        assert_eq!((found.verdict(&limits), found.uncertain), (Verdict::CannotJudge, 120 * 90 / 3));
        let least = found.least_tolerance.unwrap();
        assert!((least - 0.15).abs() < 1e-6, "{least}");
        let wider = Limits { tolerance: least + 1e-6, ..limits };
        assert_eq!(inspect(&part, &good(0.02), &wider).unwrap().verdict(&wider), Verdict::Go);
        // A defect that is certain is one all the same.
        let bump = |x: f64, y: f64| relief([x, y]) + if disk(x, y, [40.0, 30.0], 8.0) { 1.0 } else { 0.0 };
        let found = inspect(&heights(bump, 0.05), &good(0.02), &limits).unwrap();
        assert_eq!(found.verdict(&limits), Verdict::NoGo);
    }

    #[test]
    fn a_golden_part_allows_the_scatter_of_good_parts() {
        // Good parts scatter by 0.3 at the left, each has another tilt, and two of eight have a hole.
        let mut random = Random::new(7, 0);
        let mut one = |n: usize| {
            let bow = 0.3 * random.normal();
            heights(
                move |x, y| match () {
                    () if n < 2 && disk(x, y, [90.0, 20.0], 6.0) => f64::NAN,
                    () => relief([x, y]) + 0.4 * n as f64 + 0.01 * x + if x < 25.0 { bow } else { 0.0 },
                },
                0.02,
            )
        };
        let parts: Vec<Heights> = (0..8).map(&mut one).collect();
        let golden = golden(&parts, &Limits::new(0.1)).unwrap();
        assert!(golden.values.iter().all(|v| v.is_finite()), "six of eight parts have a height");
        let at = |x: usize| f64::from(golden.deviation[45 * 120 + x]);
        assert!(at(12) > 0.15 && at(12) < 0.6, "{}", at(12));
        // σ / √8, without the error of the plane.
        assert!((at(80) - 0.02 / 8f64.sqrt()).abs() < 2e-3, "{}", at(80));
        let of = |left: f64, right: f64| {
            let added = |x: f64| match () {
                () if x < 12.0 => left,
                () if x > 105.0 => right,
                () => 0.0,
            };
            let part = heights(|x, y| relief([x, y]) + added(x), 0.02);
            inspect(&part, &golden, &Limits::new(0.1)).unwrap().regions.len()
        };
        assert_eq!((of(0.3, 0.0), of(0.0, 0.3)), (0, 1));
    }

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
        let (regions, labels) = label_regions(5, &signs, &heights, 2);
        assert_eq!(regions.len(), 2);
        let bounds_px = Region { x: 0, y: 0, width: 3, height: 3 };
        let diagonal = Deviation { area_px: 3, mean: 7.0, extreme: 13.0, centroid_px: [1.0, 1.0], bounds_px };
        assert_eq!(regions[0], diagonal);
        assert_eq!((regions[1].area_px, regions[1].mean, regions[1].extreme), (2, -6.5, -9.0));
        assert_eq!((labels[0], labels[3], labels[15]), (1, 2, 0), "a single pixel is too small");
    }
}
