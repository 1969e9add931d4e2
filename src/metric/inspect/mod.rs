//! A part against a golden one: where its heights deviate by more than they may.
//!
//! Both lie on the same pixels. How the part lies in its fixture, a plane, is taken out first; then a pixel deviates where the
//! difference is larger than the tolerance, and than what both are uncertain by.

mod heights;
mod plane;
mod regions;
#[cfg(test)]
mod tests;

pub use heights::Heights;
pub use plane::Plane;
pub use regions::Deviation;

use crate::base::Error;

/// How far a registration may be off, px, one standard deviation: on a slope so much of it is a difference of height.
/// Key-points of pictures of one part agree to a tenth or two.
const MISPLACED: f64 = 0.25;

/// What a part may do.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Limits {
    /// The difference of heights that is allowed, in their unit.
    pub tolerance: f64,
    /// Standard deviations that a difference must be larger than.
    pub sigmas: f64,
    /// Pixels of the smallest region that counts.
    pub min_area_px: usize,
    /// The share of the golden part's pixels that may be without a height of the part, 0 to 1.
    pub max_unjudged: f64,
}

impl Limits {
    /// Three standard deviations; 50 px, since noise that is alike over some 2 px stands above three standard deviations in
    /// patches of 5 px on average, and of 50 px once in twenty pictures of 2 Mpx; a quarter without heights.
    pub fn new(tolerance: f64) -> Self {
        Self { tolerance, sigmas: 3.0, min_area_px: 50, max_unjudged: 0.25 }
    }
}

/// What came of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Inspection {
    /// How the part lies against the golden one.
    pub plane: Plane,
    /// Pixels of which both have a height.
    pub judged: usize,
    /// Pixels of which only the golden part has one.
    pub unjudged: usize,
    /// The part's height less the golden one's, without the plane, row-major; NaN where not judged.
    pub difference: Vec<f32>,
    /// Where it deviates, the largest first.
    pub regions: Vec<Deviation>,
    /// Which of them each pixel is in, counted from 1, else 0.
    pub labels: Vec<u32>,
}

impl Inspection {
    /// The share of the golden part's pixels that could not be judged.
    pub fn unjudged_share(&self) -> f64 {
        self.unjudged as f64 / (self.judged + self.unjudged).max(1) as f64
    }

    /// Whether it is as it should be.
    pub fn is_go(&self, limits: &Limits) -> bool {
        self.regions.is_empty() && self.unjudged_share() <= limits.max_unjudged
    }
}

/// Inspects a part that lies on the pixels of a golden one.
///
/// # Errors
/// [`Error::Mismatch`]: they are not of one size, or have too few pixels in common.
pub fn inspect(part: &Heights, golden: &Heights, limits: &Limits) -> Result<Inspection, Error> {
    let size = [golden.width, golden.height];
    let (plane, difference) = levelled(part, golden)?;
    let allowed = |i: usize| {
        let sigma = f64::from(part.deviation[i]).hypot(f64::from(golden.deviation[i]));
        limits.tolerance.max(limits.sigmas * sigma.hypot(MISPLACED * golden.slope(i)))
    };
    let side = |(i, off): (usize, &f32)| match f64::from(*off) {
        off if off > allowed(i) => 1,
        off if off < -allowed(i) => -1,
        _ => 0,
    };
    let sides: Vec<i8> = difference.iter().enumerate().map(side).collect();
    let (regions, labels) = regions::regions(size[0], &sides, &difference, limits.min_area_px);
    let judged = difference.iter().filter(|off| off.is_finite()).count();
    let known = golden.values.iter().filter(|v| v.is_finite()).count();
    Ok(Inspection { plane, judged, unjudged: known - judged, difference, regions, labels })
}

/// One golden part from several that lie on the pixels of the first, each levelled against it: the mean where more than half
/// of them have a height. What it is uncertain by holds how good parts spread.
///
/// With τ² the variance from part to part and σ² that of the measurement, the variance of n heights at a pixel is τ² + σ²,
/// and a good part is off their mean by τ² + (τ² + σ²) / n, beside its own σ².
///
/// # Errors
/// As [`inspect`].
pub fn golden(parts: &[Heights]) -> Result<Heights, Error> {
    let Some((first, others)) = parts.split_first() else {
        return Err(Error::Mismatch("no golden part was given".to_string()));
    };
    let size = [first.width, first.height];
    let mut on_first = vec![first.values.clone()];
    for other in others {
        let mut values = other.values.clone();
        levelled(other, first)?.0.off(size, &mut values);
        on_first.push(values);
    }
    let pixel = |i: usize| {
        let all = on_first.iter().zip(parts).map(|(v, part)| (f64::from(v[i]), f64::from(part.deviation[i])));
        let known: Vec<(f64, f64)> = all.filter(|(v, sigma)| v.is_finite() && sigma.is_finite()).collect();
        let (mean, sigma) = if 2 * known.len() > parts.len() { middle(&known) } else { (f64::NAN, f64::NAN) };
        (mean as f32, sigma as f32)
    };
    let (values, deviation) = (0..first.values.len()).map(pixel).unzip::<f32, f32, Vec<_>, Vec<_>>();
    Heights::new(size, &values, &deviation)
}

/// The mean of heights with their standard deviations, and by what a good part is off it, without its own.
fn middle(known: &[(f64, f64)]) -> (f64, f64) {
    let count = known.len() as f64;
    let mean = known.iter().map(|(v, _)| v).sum::<f64>() / count;
    let measured = known.iter().map(|(_, sigma)| sigma * sigma).sum::<f64>() / count;
    let spread = known.iter().map(|(v, _)| (v - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
    let between = (spread - measured).max(0.0);
    (mean, (between + spread.max(measured) / count).sqrt())
}

/// The plane of a part over another, and its heights less those of the other without it; NaN where either has none.
fn levelled(part: &Heights, other: &Heights) -> Result<(Plane, Vec<f32>), Error> {
    let size = [other.width, other.height];
    if [part.width, part.height] != size {
        let found = format!("{}x{} and {}x{}", part.width, part.height, size[0], size[1]);
        return Err(Error::Mismatch(format!("heights of {found} pixels do not lie on one another")));
    }
    let mut difference: Vec<f32> = part.values.iter().zip(&other.values).map(|(a, b)| a - b).collect();
    let plane = Plane::through(size, &difference).ok_or_else(|| {
        Error::Mismatch("both have a height at too few pixels: is it the same part, and in the picture?".to_string())
    })?;
    plane.off(size, &mut difference);
    Ok((plane, difference))
}
