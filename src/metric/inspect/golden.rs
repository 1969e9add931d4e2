//! A golden part from several good ones.

use super::{Deviation, GOLDEN_EVIDENCE, Gap, Heights, Limits, Verdict, difference, inspect};
use crate::base::Error;

/// Returns by how much a scatter that is known with some degrees of freedom, from 1, is widened: the quantile of
/// Student's t distribution that 3 standard deviations are of a Gaussian, over 3. Of parts whose scatter is known from
/// few others, one would seem off too often.
pub(super) fn student(freedom: usize) -> f64 {
    const WIDER: [f64; 10] = [78.6, 6.4, 3.07, 2.21, 1.84, 1.63, 1.51, 1.43, 1.36, 1.32];
    WIDER[freedom.clamp(1, WIDER.len()) - 1]
}

/// Makes a golden part from several good parts that are registered to the pixels of the first.
///
/// The plane of each part over the first is subtracted, as [`inspect`] does with these limits. The height is the mean
/// where more than half of the parts have one. The standard deviation includes the scatter of good parts: with the
/// variance τ² between parts and σ² of the measurement, n heights have the variance τ² + σ², and a good part differs
/// from their mean by τ² + (τ² + σ²) / n, besides its own σ².
///
/// # Errors
/// As for [`inspect`].
pub fn golden(parts: &[Heights], limits: &Limits) -> Result<Heights, Error> {
    combined(&level(parts, limits)?.iter().collect::<Vec<_>>(), 1.0)
}

/// A golden part that disagrees with the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disagreement {
    /// Its index among the golden parts.
    pub part: usize,
    /// Its largest deviation from the others.
    pub deviation: Deviation,
}

/// Returns the golden part that deviates from the golden part of the others by the largest region, beyond what they
/// differ by. Of two, it is the second, and may as well be the first. `None` if none deviates. The parts are registered
/// to the pixels of the first.
///
/// # Errors
/// As for [`inspect`].
pub fn disagreement(parts: &[Heights], limits: &Limits) -> Result<Option<Disagreement>, Error> {
    let levelled = level(parts, limits)?;
    let first = if parts.len() == 2 { 1 } else { 0 };
    let mut found: Option<Disagreement> = None;
    for part in first..if parts.len() > 1 { parts.len() } else { 0 } {
        let wider = student(parts.len().saturating_sub(2));
        let off = inspect(&parts[part], &combined(&others(&levelled, part), wider)?, limits)?;
        let Some(deviation) = off.regions.first().copied() else { continue };
        if found.is_none_or(|found| deviation.area_px > found.deviation.area_px) {
            found = Some(Disagreement { part, deviation });
        }
    }
    Ok(found)
}

/// The factor by which [`least_tolerances`] raises a tolerance.
const STEP: f64 = 1.1;

/// The least tolerance that [`least_tolerances`] tries, as a share of the largest difference.
const LEAST_SHARE: f64 = 1e-4;

/// The least tolerance at which a good part is go against the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeastTolerance {
    /// The tolerance, within a tenth; infinite if there is none, since texture or heights are missing or too uncertain.
    pub tolerance: f64,
    /// The largest region that is not judged at any tolerance.
    pub gap: Option<Gap>,
}

/// By how much the tolerance that a region needs may exceed that of most of the pixels.
const UNCERTAIN: f64 = 20.0;

/// The factor by which the suggested tolerance exceeds what good parts need, since the next good part may need more
/// than all before.
const MARGIN: f64 = 1.25;

/// The factor by which the least tolerance of a good part may exceed the median of all before it is compared in detail.
const OUTLYING: f64 = 2.0;

/// The tolerance that good parts suggest, in the unit of the heights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Suggestion {
    /// A quarter more than what they need; infinite if most are go at no tolerance.
    pub tolerance: f64,
    /// The tolerance at which they must agree too, if one of them needs far more than is typical.
    pub doubtful: Option<f64>,
}

/// Returns the tolerance that good parts suggest by their [`least_tolerances`].
pub fn suggestion(least: &[LeastTolerance]) -> Suggestion {
    let mut sorted: Vec<f64> = least.iter().map(|least| least.tolerance).collect();
    sorted.sort_by(f64::total_cmp);
    let typical = sorted.get(sorted.len().saturating_sub(1) / 2).map_or(f64::INFINITY, |median| OUTLYING * median);
    let most = sorted.last().copied().unwrap_or(f64::INFINITY);
    let tolerance = MARGIN * if most.is_finite() { most } else { typical };
    Suggestion { tolerance, doubtful: (typical.is_finite() && most > typical).then_some(typical) }
}

/// Returns for each golden part the least tolerance at which it is go against the golden part of the others. A single
/// part is compared with itself, which shows its noise alone. The parts are registered to the pixels of the first; the tolerance and the
/// tilt of the limits do not count.
///
/// # Errors
/// As for [`inspect`].
pub fn least_tolerances(parts: &[Heights], limits: &Limits) -> Result<Vec<LeastTolerance>, Error> {
    let at = |tolerance: f64| Limits { tolerance, max_tilt: f64::INFINITY, ..*limits };
    let levelled = level(parts, &at(0.0))?;
    let least = |part: usize| {
        let others = combined(&others(&levelled, part), 1.0)?;
        let noise = inspect(&parts[part], &others, &at(0.0))?.least_tolerance;
        let differences = levelled[part].values.iter().zip(&others.values).map(|(own, other)| (own - other).abs());
        let largest = f64::from(differences.filter(|difference| difference.is_finite()).fold(0.0, f32::max));
        let none = LeastTolerance { tolerance: f64::INFINITY, gap: None };
        let Some(noise) = noise.filter(|noise| noise.is_finite()) else { return Ok(none) };
        let mut tolerance = noise.max(LEAST_SHARE * largest).max(f64::MIN_POSITIVE) * (1.0 + 1e-6);
        loop {
            let limits = at(tolerance);
            let found = inspect(&parts[part], &others, &limits)?;
            if found.verdict(&limits) == Verdict::Go {
                return Ok(LeastTolerance { tolerance, gap: None });
            }
            // The plane that is subtracted may double a difference. From there on, none is left. Of uncertain heights
            // none is left beyond the largest that count.
            if tolerance > 2.0 * largest && tolerance > UNCERTAIN * noise {
                return Ok(LeastTolerance { gap: found.gaps.first().copied(), ..none });
            }
            tolerance *= STEP;
        }
    };
    (0..parts.len()).map(least).collect()
}

/// Returns all parts except one, or that one if it is the only one.
fn others(parts: &[Heights], part: usize) -> Vec<&Heights> {
    parts.iter().enumerate().filter(|(n, _)| *n != part || parts.len() == 1).map(|(_, other)| other).collect()
}

/// Subtracts the plane of each part over the first, and leaves out heights without evidence.
fn level(parts: &[Heights], limits: &Limits) -> Result<Vec<Heights>, Error> {
    let first = parts.first().ok_or_else(|| Error::Mismatch("no golden part was given".to_string()))?;
    let level = |part: &Heights| {
        let mut part = part.supported(GOLDEN_EVIDENCE);
        difference(&part, first, limits)?.0.subtract_from([first.width, first.height], &mut part.values);
        Ok(part)
    };
    parts.iter().map(level).collect()
}

/// Returns the mean of levelled parts where more than half of them have a height, with what a good part may be off by:
/// the scatter between them is made `wider` by a factor.
fn combined(parts: &[&Heights], wider: f64) -> Result<Heights, Error> {
    let Some(first) = parts.first() else { return Err(Error::Mismatch("no golden part was given".to_string())) };
    let pixel = |i: usize| {
        let all = parts.iter().map(|part| (f64::from(part.values[i]), f64::from(part.deviation[i])));
        let valid: Vec<(f64, f64)> = all.filter(|(v, sigma)| v.is_finite() && sigma.is_finite()).collect();
        let (mean, sigma) = if 2 * valid.len() > parts.len() { combine(&valid, wider) } else { (f64::NAN, f64::NAN) };
        (mean as f32, sigma as f32)
    };
    let (values, deviation) = (0..first.values.len()).map(pixel).unzip::<f32, f32, Vec<_>, Vec<_>>();
    let part_deviation = |i: usize| {
        let valid = parts.iter().map(|part| part.part_deviation[i]).filter(|sigma| sigma.is_finite());
        let (sum, count) = valid.fold((0.0, 0.0), |(sum, count), sigma| (sum + sigma * sigma, count + 1.0f32));
        (sum / count).sqrt()
    };
    let evidence = |i: usize| {
        let valid = parts.iter().filter(|part| part.values[i].is_finite()).map(|part| part.evidence[i]);
        let (sum, count) = valid.fold((0.0, 0.0), |(sum, count), evidence| (sum + evidence, count + 1.0f32));
        sum / count
    };
    let all = 0..first.values.len();
    let (part_deviation, evidence) = (all.clone().map(part_deviation).collect(), all.map(evidence).collect());
    let heights = Heights::new([first.width, first.height], &values, &deviation)?;
    let heights = heights.with_part_deviation(part_deviation)?.with_evidence(evidence)?;
    let heights = Heights { spread: spread(parts), ..heights };
    // That of the first: good parts are alike.
    first.detail.clone().map_or(Ok(heights.clone()), |detail| heights.with_detail(detail))
}

/// Returns the factor by which the evidence of a good part may fall short of that of all at a pixel: three standard
/// deviations of its logarithm. One number for all pixels, so that few parts determine it.
fn spread(parts: &[&Heights]) -> f32 {
    let variance = |i: usize| {
        let all = parts.iter().map(|part| f64::from(part.evidence[i]).ln()).filter(|ln| ln.is_finite());
        let [count, sum, squares] = all.fold([0.0; 3], |[n, s, q], ln| [n + 1.0, s + ln, q + ln * ln]);
        if count > 1.0 { (squares - sum * sum / count) / (count - 1.0) } else { f64::NAN }
    };
    let all = (0..parts.first().map_or(0, |part| part.values.len())).map(variance).filter(|v| v.is_finite());
    let (sum, count) = all.fold((0.0, 0.0f64), |(sum, count), variance| (sum + variance, count + 1.0));
    (3.0 * (sum / count.max(1.0)).max(0.0).sqrt()).exp() as f32
}

/// Returns the mean of heights with their standard deviations, and the standard deviation of a good part from it,
/// without the measurement error of that part.
fn combine(heights: &[(f64, f64)], wider: f64) -> (f64, f64) {
    let count = heights.len() as f64;
    let mean = heights.iter().map(|(v, _)| v).sum::<f64>() / count;
    let measured = heights.iter().map(|(_, sigma)| sigma * sigma).sum::<f64>() / count;
    let spread = heights.iter().map(|(v, _)| (v - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
    let between = (spread - measured).max(0.0);
    (mean, (wider * wider * between + spread.max(measured) / count).sqrt())
}

#[cfg(test)]
mod tests {
    use super::super::tests::{disk, heights, relief};
    use super::*;
    use crate::base::random::Random;
    use crate::base::statistics::tests::smooth_noise;

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
    fn the_least_tolerance_of_a_golden_part_is_that_of_its_noise_or_of_its_defect() {
        let part = |n: u64, bump: f64, sigma: f64| {
            let noise = smooth_noise([120, 90], 2.0, n);
            let at = |x: f64, y: f64| {
                let bump = if disk(x, y, [40.0, 30.0], 8.0) { bump } else { 0.0 };
                relief([x, y]) + bump + sigma * noise[y as usize * 120 + x as usize]
            };
            heights(at, sigma)
        };
        let least = |parts: &[Heights]| -> Vec<f64> {
            least_tolerances(parts, &Limits::new(7.0)).unwrap().iter().map(|least| least.tolerance).collect()
        };
        let good = least(&[part(0, 0.0, 0.1), part(1, 0.0, 0.1), part(2, 0.0, 0.1)]);
        assert!(good.iter().all(|least| (0.25..0.45).contains(least)), "three standard deviations: {good:?}");
        let [bad, ..] = least(&[part(0, 2.0, 0.1), part(1, 0.0, 0.1), part(2, 0.0, 0.1)])[..] else { panic!() };
        assert!((1.8..2.4).contains(&bad), "{bad}");
        let [far, ..] = least(&[part(0, 2000.0, 0.1), part(1, 0.0, 0.1), part(2, 0.0, 0.1)])[..] else { panic!() };
        assert!((1800.0..2400.0).contains(&far), "{far}");
        let alone = least(&[part(0, 2.0, 0.1)]);
        assert!((0.29..0.31).contains(&alone[0]), "{alone:?}");
        let hole = heights(|x, y| if x < 60.0 { f64::NAN } else { relief([x, y]) }, 0.1);
        assert_eq!(least(&[hole, part(1, 0.0, 0.1), part(2, 0.0, 0.1)])[0], f64::INFINITY);
    }

    #[test]
    fn texture_of_the_single_part_is_noise_of_the_golden_part() {
        // Evidence and certainty change from place to place by up to a factor of two, otherwise on each part.
        let part = |n: u64| {
            let noise = smooth_noise([120, 90], 4.0, n);
            let texture = smooth_noise([120, 90], 6.0, 100 + n).iter().map(|v| 8.0 * (0.35 * v).exp() as f32).collect();
            let at = |x: f64, y: f64| relief([x, y]) + 0.05 * noise[y as usize * 120 + x as usize];
            heights(at, 0.05).with_evidence(texture).unwrap()
        };
        let parts: Vec<Heights> = (0..5).map(part).collect();
        let least = least_tolerances(&parts, &Limits::new(1.0)).unwrap();
        assert!(least.iter().all(|least| least.tolerance < 0.5), "{least:?}");
        let limits = Limits::new(0.5);
        let golden = golden(&parts, &limits).unwrap();
        assert!((1.5..6.0).contains(&golden.spread), "{}", golden.spread);
        assert_eq!(inspect(&part(9), &golden, &limits).unwrap().verdict(&limits), Verdict::Go);
        let bare =
            (0..120 * 90).map(|i| if disk((i % 120) as f64, (i / 120) as f64, [40.0, 30.0], 9.0) { 0.9 } else { 8.0 });
        let bare = heights(|x, y| relief([x, y]), 0.05).with_evidence(bare.collect()).unwrap();
        assert_eq!(inspect(&bare, &golden, &limits).unwrap().verdict(&limits), Verdict::NoGo);
    }

    #[test]
    fn one_bad_golden_part_is_named_and_good_ones_never_are() {
        let limits = Limits::new(1.0);
        for seed in 0..4 {
            for count in [2, 3, 4, 6] {
                let mut random = Random::new(seed, count as u64);
                let bad = (random.uniform() * count as f64) as usize;
                // Good parts lie tilted, and an edge of theirs varies by more than the tolerance.
                let parts = |bad: usize, edge: f64| -> Vec<Heights> {
                    let mut random = Random::new(seed, 99);
                    let part = |n: usize| {
                        let noise = smooth_noise([120, 90], 2.0, 20 * seed + n as u64);
                        let (tilt, edge) = (0.01 * random.normal(), edge * random.normal());
                        let at = |x: f64, y: f64| {
                            let bump = if n == bad && disk(x, y, [40.0, 30.0], 8.0) { 2.0 } else { 0.0 };
                            let edge = if x > 112.0 { edge } else { 0.0 };
                            let noise = 0.1 * noise[y as usize * 120 + x as usize];
                            relief([x, y]) + tilt * x + bump + edge + noise
                        };
                        heights(at, 0.1)
                    };
                    (0..count).map(part).collect()
                };
                let found = disagreement(&parts(bad, 0.0), &limits).unwrap().unwrap();
                let [x, y] = found.deviation.centroid_px;
                assert!((x - 40.0).hypot(y - 30.0) < 1.0, "{found:?}");
                assert!(found.part == bad || count == 2, "{seed} {count}: {found:?}");
                assert_eq!(disagreement(&parts(count, 0.0), &limits).unwrap(), None, "{seed} {count}");
                if count == 6 {
                    assert_eq!(disagreement(&parts(count, 1.0), &limits).unwrap(), None, "{seed} {count}");
                }
            }
        }
    }
}
