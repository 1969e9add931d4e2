//! Fits a similarity to matched points that include outliers.
//!
//! RANSAC over pairs of matches (Fischler and Bolles 1981) finds the inliers. Least squares, reweighted by Tukey's
//! biweight, fits them. Points and displacements are complex numbers: T x - x = t + (a + ib) (x - c), as in
//! [`Similarity`].

use nalgebra::Complex;

use super::Match;
use crate::base::Similarity;

/// Number of tested pairs of matches. With half of the matches wrong, no tested pair is correct with a probability of
/// 1e-100.
const TRIALS: usize = 1000;
/// Distance within which a match is an inlier, px. Defocus moves key-points by one or two.
const TOLERANCE: f64 = 3.0;
/// Number of reweighted fits, a few more than convergence needs.
const FITS: usize = 20;
/// Tukey's constant: 95 % efficiency relative to least squares for normal errors.
const TUKEY: f64 = 4.685;

/// A position relative to the centre, and its displacement.
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
pub(super) fn fit(matches: &[Match], centre: [f64; 2]) -> (Similarity, usize) {
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
    use crate::engine::stages::harness::random;

    const CENTRE: [f64; 2] = [319.5, 239.5];

    fn truth() -> Similarity {
        Similarity::new(-12.3, 8.1, 1.7, 1.06)
    }

    /// Matches with a share of outliers. The others have errors up to `noise` px along each axis.
    fn matches(count: usize, wrong: f64, noise: f64) -> Vec<Match> {
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
            let (found, agreeing) = fit(&matches(count, wrong, 0.0), CENTRE);
            assert!(distance(&found) < 1e-9, "{found:?}");
            assert!(agreeing >= count - (wrong * count as f64) as usize && agreeing < count + 1);
        }
    }

    #[test]
    fn noise_averages_out() {
        let (found, agreeing) = fit(&matches(1000, 0.4, 1.0), CENTRE);
        assert!(distance(&found) < 0.1, "{}", distance(&found));
        assert!((600..620).contains(&agreeing), "{agreeing}");
    }

    #[test]
    fn no_matches_or_equal_positions_give_no_inliers() {
        assert_eq!(fit(&[], CENTRE).1, 0);
        assert_eq!(fit(&[[[10.0, 20.0], [11.0, 21.0]]; 9], CENTRE).1, 0);
        assert!(fit(&matches(60, 1.0, 0.0), CENTRE).1 < 6);
    }
}
