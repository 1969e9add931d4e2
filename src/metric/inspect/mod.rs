//! Inspection of a part against a golden part: where the heights differ by more than the tolerance.
//!
//! Both are registered to the same pixels. The tilt of the part in its fixture, a plane, is subtracted first. A pixel
//! deviates if the remaining difference exceeds the tolerance and the uncertainty of both.

pub mod golden;
mod placement;
mod regions;

use self::regions::{Extent, connected_regions, label_regions, peak_of};
use super::plane::MIN_POINTS;
use super::response::Response;
use crate::base::statistics::median;
use crate::base::{Error, Region};

pub use self::placement::PlacementRange;
pub use self::regions::Deviation;
pub use super::{heights::Heights, plane::Plane};

/// The standard deviation of the registration error, px, which gives an error of height on slopes. Key-points of
/// photographs of one part agree to 0.1 to 0.2 px.
const REGISTRATION_SIGMA: f64 = 0.25;

/// The share of the tolerance from which a difference has no weight in the fit of the plane, where noise is less. With
/// all of the tolerance, a plane that halves a step of 1.5 tolerances over half of the part would fit better than one
/// that lies on a half of the part.
const FLAT: f64 = 1.0 / 3.0;

/// The default of [`Limits::max_tilt`], in tolerances. A part that is thicker at one side looks tilted, so that tilt
/// needs a bound, and only the user knows how well the fixture holds. Up to here the tilt itself leaves no difference:
/// good parts that lie tilted by 4 to 8 tolerances are found tilted by that, within 0.5 %, and nothing deviates.
const MAX_TILT: f64 = 10.0;

/// The least evidence of a height of the part: the texture must exceed the noise, and the evidence of both together is
/// then √2. Areas that show only noise have up to 1.06 in scenes of all noise levels, and the solve fills them in from
/// their surroundings. At 1.1 to 1.5, defects of 1.5 to 3 px² and 14 px across came out as a tenth to a third of their
/// height, with a standard deviation of a tenth of what was missing.
const LEAST_EVIDENCE: f32 = 1.5;

/// The least evidence of a height of the golden part: twice as much, so that a part in somewhat less light is measured
/// wherever the golden part is.
const GOLDEN_EVIDENCE: f32 = 2.0 * LEAST_EVIDENCE;

/// The largest evidence of a bare surface, as a share of what the rest of the part has over the golden part. A grey
/// area on a textured part has up to 0.05 in scenes, a good part of the same light from 0.75.
const BARE: f64 = 1.0 / 3.0;

/// By how much less evidence than good parts with texture of their own have at least is bare.
const BEYOND_SPREAD: f64 = 1.5;

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
    /// The width of the smallest defect that must be seen, px. Where one as high as the tolerance would not be, nothing
    /// is judged.
    pub smallest_px: Option<f64>,
}

impl Limits {
    /// Returns the default limits: 3 standard deviations, an area of 50 px, a quarter of the pixels without heights,
    /// and a tilt of ten tolerances from one corner of the picture to the opposite one. Noise that is correlated over 2
    /// px exceeds 3 standard deviations in regions of 5 px on average, and in one of 50 px once in twenty images of 2
    /// Mpx.
    pub fn new(tolerance: f64) -> Self {
        Self {
            tolerance,
            sigmas: 3.0,
            min_area_px: 50,
            max_unjudged: 0.25,
            max_tilt: MAX_TILT * tolerance,
            smallest_px: None,
        }
    }
}

/// Whether a part passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize), serde(rename_all = "kebab-case"))]
pub enum Verdict {
    /// No region deviates, enough pixels were judged, and all that were not are scattered.
    Go,
    /// A region deviates, or its surface is bare; or too many pixels have no height of the part.
    NoGo,
    /// The part is too uncertain for the tolerance, over all or in a region, lies more tilted than is allowed, or has the
    /// heights of the golden part with the other sign.
    CannotJudge,
}

impl Verdict {
    /// The verdict as one word, for files and programs.
    pub fn name(self) -> &'static str {
        match self {
            Self::Go => "go",
            Self::NoGo => "no-go",
            Self::CannotJudge => "cannot-judge",
        }
    }

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
    /// The number of pixels that were judged: both have a height, and the part's is certain enough for the tolerance,
    /// or deviates for certain.
    pub judged: usize,
    /// The number of other pixels at which only the golden part has a height that there is evidence for.
    pub unjudged: usize,
    /// The number of pixels at which the part is too uncertain for the tolerance, or has no height since all of it has
    /// as little evidence.
    pub uncertain: usize,
    /// The least tolerance that the part's uncertainty allows to judge; `None` if too many of its heights are missing, or
    /// with [`Limits::smallest_px`].
    pub least_tolerance: Option<f64>,
    /// Regions that are not judged although the golden part is certain there, the largest first. Pixels outside the
    /// picture of the part are not among them.
    pub gaps: Vec<Gap>,
    /// The row-major heights of the part minus those of the golden part and the plane. NaN where not judged.
    pub difference: Vec<f32>,
    /// The deviating regions, the largest first.
    pub regions: Vec<Deviation>,
    /// The number of each pixel's region, from 1, or 0.
    pub labels: Vec<u32>,
    /// Whether the heights of the part are those of the golden part with the other sign, far rather than its heights:
    /// the photographs were taken, or given, in the other order.
    pub is_negated: bool,
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
        let too_many = |share: f64| share > limits.max_unjudged;
        let is_bare = self.gaps.iter().any(|gap| gap.is_bare);
        if self.is_negated {
            Verdict::CannotJudge
        } else if !self.regions.is_empty() || is_bare || too_many(self.unjudged_share()) {
            Verdict::NoGo
        } else if too_many(self.unjudged_share() + self.uncertain_share())
            || !self.gaps.is_empty()
            || self.tilt > limits.max_tilt
        {
            Verdict::CannotJudge
        } else {
            Verdict::Go
        }
    }
}

/// Inspects a part that is registered to the pixels of a golden part.
///
/// Heights without evidence count as missing: on the golden part they are not compared, on the part they are not
/// judged.
///
/// With [`Limits::smallest_px`] what shows of a small defect is corrected by the response of V to its width. A region
/// deviates too if the corrected height of its peak exceeds the tolerance.
///
/// # Errors
/// [`Error::Mismatch`] if their sizes differ, the golden part has too few heights, or the detail that the part resolves is
/// not known and the limits ask for it.
pub fn inspect(part: &Heights, golden: &Heights, limits: &Limits) -> Result<Inspection, Error> {
    let least_of_golden = GOLDEN_EVIDENCE.max(LEAST_EVIDENCE * golden.spread);
    let (part, golden) = (&part.supported(LEAST_EVIDENCE), &golden.supported(least_of_golden));
    let valid = golden.values.iter().filter(|v| v.is_finite()).count();
    if valid < MIN_POINTS {
        let problem = "the golden part has a height at too few pixels: take one, and light, that show its texture";
        return Err(Error::Mismatch(problem.to_string()));
    }
    let (plane, mut difference) = difference(part, golden, limits)?;
    let small = limits.smallest_px.map(|smallest| Small::new(part, limits, smallest)).transpose()?;
    // The share of the tolerance that shows of the smallest defect.
    let shown = |i: usize| small.as_ref().map_or(1.0, |small| small.over_area(i));
    let noise = |i: usize| limits.sigmas * deviation(part, golden, i);
    let is_beyond = |i: usize| f64::from(difference[i].abs()) > limits.tolerance.max(noise(i));
    let sign = |(i, difference): (usize, &f32)| {
        let least = (shown(i) * limits.tolerance).max(noise(i));
        if f64::from(difference.abs()) > least { difference.signum() as i8 } else { 0 }
    };
    let signs: Vec<i8> = difference.iter().enumerate().map(sign).collect();
    let deviates = |pixels: &[usize]| match &small {
        None => true,
        Some(small) => {
            pixels.iter().filter(|i| is_beyond(**i)).count() >= limits.min_area_px
                || small.exceeds(pixels, golden.width, &difference)
        }
    };
    let (regions, labels) = label_regions(golden.width, &signs, &difference, limits.min_area_px, deviates);
    let is_negated = !regions.is_empty() && is_negated(part, golden, limits, &difference)?;
    let compared = difference.iter().filter(|v| v.is_finite()).count();
    // A deviation as large as the tolerance would be within this of a good part.
    let needed = |i: usize| limits.sigmas * f64::from(part.deviation[i].max(golden.deviation[i]));
    let is_unseen = |i: usize| needed(i) > shown(i) * limits.tolerance;
    let is_uncertain = |i: &usize| difference[*i].is_finite() && !is_beyond(*i) && labels[*i] == 0 && is_unseen(*i);
    let mut all: Vec<f64> = (0..difference.len()).filter(|i| difference[*i].is_finite()).map(needed).collect();
    all.sort_by(f64::total_cmp);
    let last = ((1.0 - limits.max_unjudged) * valid as f64).ceil() as usize;
    // What shows of a small defect depends on its height.
    let least_tolerance = all.get(last.saturating_sub(1)).copied().filter(|t| t.is_finite() && small.is_none());
    let too_uncertain: Vec<usize> = (0..difference.len()).filter(is_uncertain).collect();
    too_uncertain.iter().for_each(|i| difference[*i] = f32::NAN);
    let is_bare = bareness(part, golden);
    // Inside the picture of a part that is as dim all over.
    let is_dim = |i: usize| part.values[i].is_nan() && !part.evidence[i].is_nan() && !is_bare(i);
    let dim = (0..difference.len()).filter(|i| golden.values[*i].is_finite() && is_dim(*i)).count();
    let is_small = |i: usize| small.is_some() && part.values[i].is_finite() && is_unseen(i);
    let gaps = gaps(part, golden, &difference, limits, (&is_bare, &is_small));
    let (judged, unjudged) = (compared - too_uncertain.len(), valid - compared - dim);
    let uncertain = too_uncertain.len() + dim;
    let tilt = plane.tilt([golden.width, golden.height]);
    Ok(Inspection {
        plane,
        tilt,
        judged,
        unjudged,
        uncertain,
        least_tolerance,
        gaps,
        difference,
        regions,
        labels,
        is_negated,
    })
}

/// Returns the standard deviation of the difference at a pixel.
fn deviation(part: &Heights, golden: &Heights, i: usize) -> f64 {
    let sigma = f64::from(part.deviation[i]).hypot(f64::from(golden.deviation[i]));
    sigma.hypot(REGISTRATION_SIGMA * golden.slope(i))
}

/// A connected region that is not judged.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Gap {
    /// The number of pixels.
    pub area_px: usize,
    /// The centroid, px.
    pub centroid_px: [f64; 2],
    /// The bounding box.
    pub bounds_px: Region,
    /// Whether a quarter of it, and as much as the least region, has no height and far less texture than the rest of
    /// the part has, compared with the golden part: then the surface differs there, and not the light.
    pub is_bare: bool,
    /// Whether in most of it the smallest defect as high as the tolerance would not be seen.
    pub is_unseen: bool,
}

/// Returns whether a pixel of the part is bare: it has far less evidence than the rest of the part has, compared with
/// the golden part. What is not known does not excuse.
fn bareness<'a>(part: &'a Heights, golden: &'a Heights) -> impl Fn(usize) -> bool + 'a {
    let ratio = move |i: usize| f64::from(part.evidence[i]) / f64::from(golden.evidence[i]);
    let usual = median((0..golden.values.len()).filter(|i| golden.values[*i].is_finite()).map(ratio));
    let least = BARE.min(1.0 / (BEYOND_SPREAD * f64::from(golden.spread)));
    move |i| !usual.is_some_and(|usual| ratio(i) >= least * usual)
}

/// Returns the regions that are not judged, without those whose pixels a part like the golden one may miss by chance.
fn gaps(
    part: &Heights,
    golden: &Heights,
    difference: &[f32],
    limits: &Limits,
    (is_bare, is_unseen): (&impl Fn(usize) -> bool, &impl Fn(usize) -> bool),
) -> Vec<Gap> {
    let is_golden = |i: usize| golden.values[i].is_finite();
    let is_missing = |i: usize| is_golden(i) && difference[i].is_nan() && !part.evidence[i].is_nan();
    // A part with twice the standard deviation of one golden part, or of the mean of several with what they differ by,
    // would be judged. Where good parts have texture of their own, one with less has more.
    let more = f64::from(golden.spread).max(2.0);
    let of_golden = |i: usize| f64::from(golden.deviation[i].max(golden.part_deviation[i]));
    let is_certain = |i: usize| limits.sigmas * more * of_golden(i) <= limits.tolerance;
    let has_lost = |i: usize| golden.evidence[i].is_finite() && part.evidence[i] < LEAST_EVIDENCE && is_bare(i);
    let is_gap = |i: usize| is_missing(i) && (is_certain(i) || has_lost(i) || is_unseen(i));
    let marks: Vec<i8> = (0..difference.len()).map(|i| i8::from(is_gap(i))).collect();
    let gap = |pixels: Vec<usize>| {
        let bare = pixels.iter().filter(|i| part.values[**i].is_nan() && is_bare(**i)).count();
        let Extent { area_px, centroid_px, bounds_px } = Extent::of(&pixels, golden.width);
        // Around a bare area V is uncertain, which is two thirds of the region of a grey disk of 14 px radius. The
        // share is set by that scene alone.
        let is_bare = bare >= limits.min_area_px && 4 * bare > pixels.len();
        let is_unseen = 2 * pixels.iter().filter(|i| is_unseen(**i)).count() > pixels.len();
        Gap { area_px, centroid_px, bounds_px, is_bare, is_unseen }
    };
    connected_regions(golden.width, &marks, limits.min_area_px).into_iter().map(gap).collect()
}

/// What shows of small defects of a part.
struct Small<'a> {
    response: Response,
    sensitivity: &'a [f32],
    tolerance: f64,
}

impl<'a> Small<'a> {
    /// The widths of defects, in those of the smallest.
    const WIDTHS: [f64; 5] = [1.0, 1.5, 2.2, 3.3, 5.0];

    fn new(part: &'a Heights, limits: &Limits, smallest: f64) -> Result<Self, Error> {
        let detail = part.detail.as_ref().ok_or_else(|| {
            Error::Mismatch("of a sweep it is not known which small defects show; leave out the smallest".to_string())
        })?;
        let widths = Self::WIDTHS.map(|width| width * smallest);
        let response = Response::new(&detail.smoothing, &widths, limits.tolerance, limits.min_area_px);
        Ok(Self { response, sensitivity: &detail.sensitivity, tolerance: limits.tolerance })
    }

    /// The share of the height of the smallest defect that shows at a pixel over the least area.
    fn over_area(&self, i: usize) -> f64 {
        self.response.over_area(0, self.sensitivity[i])
    }

    /// Whether the corrected height of the peak among these pixels exceeds the tolerance.
    fn exceeds(&self, pixels: &[usize], width: u32, difference: &[f32]) -> bool {
        let Some((peak, seen_width)) = peak_of(pixels, width, difference) else { return false };
        f64::from(difference[peak].abs()) > self.response.top(seen_width, self.sensitivity[peak]) * self.tolerance
    }
}

/// Returns the plane of a part over another, and the differences of their heights without it. NaN where either has no
/// height, and everywhere if they have too few in common for a plane.
fn difference(part: &Heights, other: &Heights, limits: &Limits) -> Result<(Plane, Vec<f32>), Error> {
    let size = [other.width, other.height];
    if [part.width, part.height] != size {
        let sizes = format!("{}x{} and {}x{}", part.width, part.height, size[0], size[1]);
        return Err(Error::Mismatch(format!("heights of {sizes} pixels differ in size")));
    }
    let mut difference: Vec<f32> = part.values.iter().zip(&other.values).map(|(a, b)| a - b).collect();
    let cutoff = |i: usize| (limits.sigmas * deviation(part, other, i)).max(FLAT * limits.tolerance);
    let plane = Plane::fit(size, &difference, cutoff).unwrap_or_else(|| {
        difference.fill(f32::NAN);
        Plane::default()
    });
    plane.subtract_from(size, &mut difference);
    Ok((plane, difference))
}

/// Whether the heights of a part with the other sign differ from the golden part by less than half of this difference.
fn is_negated(part: &Heights, golden: &Heights, limits: &Limits, found: &[f32]) -> Result<bool, Error> {
    let negated = Heights { values: part.values.iter().map(|v| -v).collect(), ..part.clone() };
    let (_, other) = difference(&negated, golden, limits)?;
    let sum = |of: &[f32]| of.iter().filter(|v| v.is_finite()).map(|v| f64::from(*v).powi(2)).sum::<f64>();
    Ok(4.0 * sum(&other) < sum(found))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::base::statistics::tests::smooth_noise;
    use crate::base::{Similarity, centre};

    const SIZE: [u32; 2] = [120, 90];

    /// The height of a good part at a point.
    pub(crate) fn relief([x, y]: [f64; 2]) -> f64 {
        5.0 + 1.5 * (0.11 * x).sin() * (0.13 * y).cos()
    }

    pub(crate) fn heights(of: impl Fn(f64, f64) -> f64, sigma: f64) -> Heights {
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

    pub(crate) fn disk(x: f64, y: f64, [cx, cy]: [f64; 2], radius: f64) -> bool {
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
    fn a_small_defect_is_seen_by_what_shows_of_it_or_cannot_be_judged() {
        use crate::metric::response::{Detail, tests::SMOOTHING};
        let limits = Limits { smallest_px: Some(12.0), ..Limits::new(1.7) };
        let part = |height: f64, radius: f64, faint: f64| {
            let bump = move |x: f64, y: f64| if disk(x, y, [60.0, 45.0], radius) { height } else { 0.0 };
            let sensitivity = (0..120 * 90).map(|i| if f64::from(i % 120) < faint { 1e-4 } else { 0.006 }).collect();
            heights(bump, 0.02).with_detail(Detail { sensitivity, smoothing: SMOOTHING }).unwrap()
        };
        let golden = heights(|_, _| 0.0, 0.02);
        let of = |part: &Heights| inspect(part, &golden, &limits).unwrap();
        let shown = Response::new(&SMOOTHING, &[12.0, 18.0, 26.4, 39.6, 60.0], 1.7, 50).top(12.0, 0.006) * 1.7;
        assert!((0.4..1.3).contains(&shown), "{shown}");
        assert_eq!(of(&part(0.0, 6.0, 0.0)).verdict(&limits), Verdict::Go);
        assert_eq!(of(&part(1.1 * shown, 6.0, 0.0)).verdict(&limits), Verdict::NoGo);
        assert_eq!(of(&part(0.5 * shown, 6.0, 0.0)).verdict(&limits), Verdict::Go);
        assert_eq!(of(&part(1.1 * shown, 25.0, 0.0)).verdict(&limits), Verdict::Go, "of a wide one all shows");
        assert_eq!(of(&part(1.8, 25.0, 0.0)).verdict(&limits), Verdict::NoGo);
        let found = of(&part(0.0, 6.0, 10.0));
        assert!(found.verdict(&limits) == Verdict::CannotJudge && found.gaps[0].is_unseen, "{:?}", found.gaps);
        let plain = inspect(&part(1.1 * shown, 6.0, 10.0), &golden, &Limits::new(1.7)).unwrap();
        assert_eq!(plain.verdict(&limits), Verdict::Go, "nothing was asked for");
        assert!(inspect(&golden, &golden, &limits).is_err(), "no detail");
    }

    #[test]
    fn heights_of_the_other_sign_cannot_be_judged() {
        let limits = Limits::new(0.3);
        let found = inspect(&heights(|x, y| -relief([x, y]), 0.01), &good(0.01), &limits).unwrap();
        assert!(found.is_negated && found.verdict(&limits) == Verdict::CannotJudge);
        let flat = heights(|x, y| if disk(x, y, [60.0, 40.0], 30.0) { 1.0 } else { 0.0 }, 0.01);
        let found = inspect(&flat, &heights(|_, _| 0.0, 0.01), &limits).unwrap();
        assert!(!found.is_negated && found.verdict(&limits) == Verdict::NoGo);
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
        let found = inspect(&none, &good(0.1), &limits).unwrap();
        assert_eq!((found.verdict(&limits), found.unjudged), (Verdict::NoGo, 120 * 90));
        assert!(inspect(&good(0.1), &none, &limits).unwrap_err().to_string().contains("too few pixels"));
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
    fn a_region_that_is_missing_where_the_golden_part_is_certain_is_no_go() {
        let limits = Limits::new(0.1);
        let with_hole = |radius: f64| {
            let hole = |x: f64, y: f64| if disk(x, y, [40.0, 30.0], radius) { f64::NAN } else { relief([x, y]) };
            inspect(&heights(hole, 0.01), &good(0.01), &limits).unwrap()
        };
        assert_eq!(with_hole(3.0).verdict(&limits), Verdict::Go, "smaller than the least region that counts");
        let found = with_hole(6.0);
        assert_eq!((found.verdict(&limits), found.gaps.len()), (Verdict::NoGo, 1));
        let gap = found.gaps[0];
        assert!(gap.is_bare && gap.area_px.abs_diff(113) < 12 && gap.centroid_px == [40.0, 30.0], "{gap:?}");
        // Scattered pixels are missing by chance.
        let scattered = |x: f64, y: f64| if (x + 2.0 * y) % 5.0 == 0.0 { f64::NAN } else { relief([x, y]) };
        let found = inspect(&heights(scattered, 0.01), &good(0.01), &limits).unwrap();
        assert_eq!((found.verdict(&limits), found.unjudged), (Verdict::Go, 120 * 90 / 5));
        // So is what the part's noise hides in a region: it cannot be judged.
        let mut part = good(0.01);
        for i in (0..120 * 90).filter(|i| disk((i % 120) as f64, (i / 120) as f64, [40.0, 30.0], 6.0)) {
            part.deviation[i] = 0.05;
        }
        let found = inspect(&part, &good(0.01), &limits).unwrap();
        assert_eq!((found.verdict(&limits), found.gaps[0].is_bare), (Verdict::CannotJudge, false));
    }

    #[test]
    fn heights_without_texture_are_not_judged_and_bare_if_only_they_lack_it() {
        let limits = Limits::new(0.1);
        let evidence = |of: &dyn Fn(f64, f64) -> f32, sigma: f64| {
            let evidence = (0..120 * 90).map(|i| of((i % 120) as f64, (i / 120) as f64)).collect();
            good(sigma).with_evidence(evidence).unwrap()
        };
        let hole = |x: f64, y: f64| disk(x, y, [40.0, 30.0], 6.0);
        // The golden part has less evidence at the right; at the bottom it has none, and is not compared.
        let golden = |x: f64, y: f64| match () {
            () if y > 80.0 => 1.0,
            () if x > 60.0 => 3.0,
            () => 20.0,
        };
        let golden = evidence(&golden, 0.01);
        let of = |share: f32, in_hole: f32| {
            let part = |x: f64, y: f64| match () {
                () if hole(x, y) => in_hole,
                () if x > 60.0 => 3.0 * share,
                () => 20.0 * share,
            };
            inspect(&evidence(&part, 0.01), &golden, &limits).unwrap()
        };
        assert_eq!((of(1.0, 20.0).verdict(&limits), of(1.0, 20.0).judged), (Verdict::Go, 120 * 81));
        let bare = of(0.9, 0.9);
        assert_eq!((bare.verdict(&limits), bare.gaps.len(), bare.gaps[0].is_bare), (Verdict::NoGo, 1, true));
        assert!(bare.difference[30 * 120 + 40].is_nan());
        // Where the whole part has a third of the evidence, its light is at fault.
        let dark = of(0.33, 6.6);
        assert_eq!((dark.gaps.len(), dark.gaps[0].is_bare), (1, false), "{:?}", dark.gaps);
        assert!((dark.uncertain_share() - 59.0 / 120.0).abs() < 1e-9 && dark.unjudged == 0);
        assert_eq!(dark.verdict(&limits), Verdict::CannotJudge);
        let most = Limits { max_unjudged: 0.5, ..limits };
        assert_eq!(dark.verdict(&most), Verdict::CannotJudge, "as a region");
    }
}
