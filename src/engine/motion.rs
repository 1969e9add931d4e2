//! Whether another motion model than the one solved for would do: section 5 of `docs/method.md`.
//!
//! The last sums are those of all eight unknowns, around the T that was found. Their quadratic form says where a richer
//! model would go, and a simpler one; how far the sums of one block of pixels differ from those of another, whether that is
//! more than chance.

use std::fmt;

use nalgebra::{DMatrix, DVector};

use super::stages::sums::{Sums, UNKNOWNS, displacements};
use crate::base::{Homography, Motion};

/// Models that put no corner further apart than this many pixels are the same: some times the error of a solve.
const SAME: f64 = 0.05;
/// How many times what chance gives on average what tells must be. Of two unknowns and many blocks chance reaches this once
/// in 1e5, of two and 12 blocks once in 500.
const TELLS: f64 = 12.0;

/// Another motion model than the one solved for.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OtherMotion {
    /// Which.
    pub motion: Motion,
    /// Whether it would explain more; otherwise it is simpler and explains as much.
    pub explains_more: bool,
    /// How far from T it would put the furthest corner, pixels, to first order.
    pub corner_px: f64,
}

impl fmt::Display for OtherMotion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let model = match self.motion {
            Motion::Affine => "an affine map",
            Motion::Translation => "a translation",
            Motion::Similarity => "a similarity",
            Motion::Homography => "a homography",
        };
        let what = if self.explains_more { "more" } else { "as much" };
        write!(f, "{model} would explain {what}; corners move by {:.2} px", self.corner_px)
    }
}

/// The quadratic form about T, in unknowns of [`sums`](super::stages::sums).
pub(crate) struct Form {
    /// N.
    normal: DMatrix<f64>,
    /// g of each block of pixels.
    gradients: Vec<DVector<f64>>,
    /// Over which places are stated, pixels.
    length: f64,
    /// A corner, from the centre over `length`.
    corner: [f64; 2],
}

impl Form {
    /// From the sums of blocks of pixels, places stated over `length`, corners at `half` from the centre, both pixels.
    pub(crate) fn new(blocks: Vec<Sums>, length: f64, half: [f64; 2]) -> Self {
        let normal = |i: usize, j: usize| blocks.iter().map(|block: &Sums| block.normal[i][j]).sum::<f64>();
        let seen = blocks.iter().filter(|block| block.valid > 0.0);
        Self {
            normal: DMatrix::from_fn(UNKNOWNS, UNKNOWNS, normal),
            gradients: seen.map(|block| DVector::from_row_slice(&block.gradient)).collect(),
            length,
            corner: half.map(|half| half / length),
        }
    }

    /// Which other model would do, of T found by `motion`: the richer one beyond which nothing more is explained, or else the
    /// simplest that explains as much.
    pub(crate) fn other(&self, motion: Motion, t: &Homography) -> Option<OtherMotion> {
        let own = self.best(motion, &DVector::zeros(UNKNOWNS))?;
        self.richer(motion, &own).or_else(|| self.simpler(motion, &own, t))
    }

    fn richer(&self, motion: Motion, own: &DVector<f64>) -> Option<OtherMotion> {
        let (mut found, mut fewer, mut last) = (None, motion, own.clone());
        for more in Motion::ALL.into_iter().filter(|&m| m > motion) {
            let best = self.best(more, &DVector::zeros(UNKNOWNS))?;
            if self.corner_distance(&last, &best) >= SAME && self.tells(fewer, more, &DVector::zeros(UNKNOWNS))? {
                let corner_px = self.corner_distance(own, &best);
                found = Some(OtherMotion { motion: more, explains_more: true, corner_px });
            }
            (fewer, last) = (more, best);
        }
        found
    }

    fn simpler(&self, motion: Motion, own: &DVector<f64>, t: &Homography) -> Option<OtherMotion> {
        Motion::ALL.into_iter().take_while(|&m| m < motion).find_map(|simpler| {
            let beyond = |i: usize| (simpler.unknowns()..motion.unknowns()).contains(&i);
            let excess = self.excess(t);
            let without = DVector::from_fn(UNKNOWNS, |i, _| if beyond(i) { excess[i] } else { 0.0 });
            let corner_px = self.corner_distance(own, &self.best(simpler, &without)?);
            let same = corner_px < SAME || !self.tells(simpler, motion, &without)?;
            same.then_some(OtherMotion { motion: simpler, explains_more: false, corner_px })
        })
    }

    /// The best step in a model's unknowns where the others are given; `None` where the images do not tell.
    fn best(&self, motion: Motion, given: &DVector<f64>) -> Option<DVector<f64>> {
        let count = motion.unknowns();
        let gradient: DVector<f64> = self.gradients.iter().sum();
        let right = -(gradient + &self.normal * given).rows(0, count);
        let solved = self.normal.view((0, 0), (count, count)).clone_owned().cholesky()?.solve(&right);
        let step = DVector::from_fn(UNKNOWNS, |i, _| if i < count { solved[i] } else { given[i] });
        step.iter().all(|v| v.is_finite()).then_some(step)
    }

    /// Whether the unknowns that one model has beyond another tell, `without` being what T loses where they are left out:
    /// Hotelling's test of their gradients, the other unknowns eliminated, over the blocks of pixels. What T does not explain
    /// at the edges of depth say is the same all over a block, and scatters from one to the next as a motion would not.
    fn tells(&self, fewer: Motion, more: Motion, without: &DVector<f64>) -> Option<bool> {
        let (kept, count) = (fewer.unknowns(), more.unknowns() - fewer.unknowns());
        let part = |i: usize, j: usize, rows: usize, columns: usize| self.normal.view((i, j), (rows, columns));
        let answer = part(0, 0, kept, kept).clone_owned().cholesky()?.solve(&part(0, kept, kept, count));
        let own = part(kept, kept, count, count) - part(kept, 0, count, kept) * &answer;
        let score = |g: &DVector<f64>| g.rows(kept, count) - answer.transpose() * g.rows(0, kept);
        let scores: Vec<DVector<f64>> = self.gradients.iter().map(score).collect();
        let (blocks, sum) = (scores.len() as f64, scores.iter().sum::<DVector<f64>>());
        let mean = &sum / blocks;
        let scatter: DMatrix<f64> = scores.iter().map(|s| (s - &mean) * (s - &mean).transpose()).sum();
        let tested = sum + own * without.rows(kept, count);
        let freedom = blocks - count as f64;
        let over_chance = tested.dot(&scatter.cholesky()?.solve(&tested)) / blocks * freedom / count as f64;
        Some(freedom >= 1.0 && over_chance > TELLS)
    }

    /// The step that takes out of T what each unknown stands for, to first order.
    fn excess(&self, t: &Homography) -> [f64; UNKNOWNS] {
        let ([[xx, xy, _], [yx, yy, _], [gx, gy, _]], l) = (t.matrix(), self.length);
        // The linear part as complex numbers: u to c u + k ū. What takes out k is -k/c, and what takes out c, 1/c - 1.
        let (c, k) = ([xx + yy, yx - xy].map(|v| 0.5 * v), [xx - yy, yx + xy].map(|v| 0.5 * v));
        let square = c[0] * c[0] + c[1] * c[1];
        let over_c = |[x, y]: [f64; 2]| [(x * c[0] + y * c[1]) / square, (y * c[0] - x * c[1]) / square];
        let ([zoom, turn], [stretch, shear]) = (over_c([1.0, 0.0]), over_c(k));
        [0.0, 0.0, l * (zoom - 1.0), l * turn, -l * stretch, -l * shear, -l * l * gx, -l * l * gy]
    }

    /// How far apart two steps put the furthest corner, pixels.
    fn corner_distance(&self, a: &DVector<f64>, b: &DVector<f64>) -> f64 {
        let [w, h] = self.corner;
        let moved = |corner: [f64; 2]| {
            let by = displacements(corner);
            let along = |axis: usize| (0..UNKNOWNS).map(|i| (a[i] - b[i]) * by[i][axis]).sum::<f64>();
            along(0).hypot(along(1))
        };
        [[w, h], [-w, h], [w, -h], [-w, -h]].map(moved).into_iter().fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Similarity;
    use crate::engine::stages::harness::random;

    const LENGTH: f64 = 64.0;

    /// The sums of residuals that a step would take away, but for noise: of an image of 200 x 150, random gradients.
    fn blocks(step: [f64; UNKNOWNS], noise: f64) -> Vec<Sums> {
        random(5 * 20_000, 7).chunks_exact(5 * 400).map(|numbers| sums(numbers, step, noise)).collect()
    }

    fn sums(numbers: &[f64], step: [f64; UNKNOWNS], noise: f64) -> Sums {
        let mut sums = Sums::default();
        for n in numbers.chunks_exact(5) {
            let (j, place) = ([n[0] - 0.5, n[1] - 0.5].map(|v| 0.1 * v), [200.0 * n[2] - 100.0, 150.0 * n[3] - 75.0]);
            let place = place.map(|p| p / LENGTH);
            let moved = |axis: usize| displacements(place).iter().zip(step).map(|(by, x)| by[axis] * x).sum::<f64>();
            let s = -j[0] * moved(0) - j[1] * moved(1) + noise * (n[4] - 0.5);
            let w = 1.0 / s.hypot(0.01);
            sums.add([w * j[0] * j[0], w * j[0] * j[1], w * j[1] * j[1]], [w * s * j[0], w * s * j[1]], place);
            sums.energy += 1.0 / w;
            sums.valid += 1.0;
        }
        sums
    }

    fn other(blocks: &[Sums], motion: Motion, t: impl Into<Homography>) -> Option<OtherMotion> {
        Form::new(blocks.to_vec(), LENGTH, [100.0, 75.0]).other(motion, &t.into())
    }

    #[test]
    fn a_richer_model_is_named_where_its_unknowns_would_move_a_corner() {
        let similarity = Similarity::new(1.0, 2.0, 0.3, 1.02);
        let sheared = blocks([0.0, 0.0, 0.0, 0.0, 0.0, 0.3, 0.0, 0.0], 0.004);
        let found = other(&sheared, Motion::Similarity, similarity).unwrap();
        assert_eq!((found.motion, found.explains_more), (Motion::Affine, true));
        // 0.3 px at 64 px from the centre, of a corner 125 px away; half the weighted noise's bias is allowed for.
        assert!((found.corner_px - 0.3 * 125.0 / 64.0).abs() < 0.05, "{found:?}");
        let keystone = blocks([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2, -0.1], 0.004);
        assert_eq!(other(&keystone, Motion::Translation, similarity).unwrap().motion, Motion::Homography);
        let text = found.to_string();
        assert!(text.starts_with("an affine map would explain more; corners move by 0.5"), "{text}");
    }

    #[test]
    fn what_noise_alone_would_do_is_not_said() {
        let still = blocks([0.0; UNKNOWNS], 0.1);
        assert_eq!(other(&still, Motion::Similarity, Similarity::new(1.0, 2.0, 0.3, 1.02)), None);
    }

    #[test]
    fn the_simplest_that_explains_as_much_is_named() {
        let still = blocks([0.0; UNKNOWNS], 0.004);
        let shift = Similarity::new(3.0, -2.0, 0.0, 1.0);
        let found = other(&still, Motion::Homography, shift).unwrap();
        assert_eq!((found.motion, found.explains_more), (Motion::Translation, false));
        let turned = other(&still, Motion::Homography, Similarity::new(3.0, -2.0, 0.2, 1.0)).unwrap();
        assert_eq!(turned.motion, Motion::Similarity);
        let steep = Homography::from_matrix([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [2e-5, 0.0, 1.0]]).unwrap();
        assert_eq!(other(&still, Motion::Homography, steep), None, "0.2 px at 100 px from the centre tell");
    }
}
