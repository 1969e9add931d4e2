//! How well T is determined, and whether another motion model would do: section 5 of `docs/method.md`.

use std::fmt;

use nalgebra::{DMatrix, DVector};

use super::stages::sums::{Sums, UNKNOWNS, displacements};
use super::windows::Gradients;
use crate::base::{Homography, Motion};

/// The largest distance between corners, px, at which two models are the same: several times the error of a solve.
const SAME_CORNERS: f64 = 0.05;
/// The least test statistic, over its mean by chance, of significant unknowns. For two unknowns and many blocks chance
/// reaches this once in 1e5, for two and 12 blocks once in 500.
const SIGNIFICANT: f64 = 12.0;

/// What a registration without noise is off by, px: the interpolation of I2, and the slope of V at the borders. On
/// planes, reliefs and cylinders of 192 to 256 px it is 0.003 to 0.0085.
const WITHOUT_NOISE: f64 = 0.006;
/// The least share of the gradients along an unknown that is not noise. T is less certain than this allows to say.
const LEAST_SHARED: f64 = 0.02;
/// The two photographs must share gradients along every unknown, relative to those that they share most.
///
/// Along stripes, and where stripes were taken for their neighbours, 0.04 to 0.35 are shared. Pairs that fit have 0.8
/// and more; with a quarter or a half of another scene, or moved, 0.45 to 0.75.
const LEAST_SHARED_RATIO: f64 = 0.3;

/// The standard deviation of T.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TransformDeviation {
    /// Of the displacement of the corner of the solved part that is determined worst, px.
    pub corner_px: f64,
    /// The direction in which that corner is determined worst, 0 to 180: 0 is along rows, 90 along columns.
    pub direction_deg: f64,
}

/// Another motion model than the one solved for.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OtherMotion {
    /// The model.
    pub motion: Motion,
    /// Whether it explains more. If not, it is simpler and explains as much.
    pub explains_more: bool,
    /// The largest distance by which it moves a corner, px, to first order.
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

/// The quadratic form of the energy about T, in the eight unknowns of [`sums`](super::stages::sums).
pub(crate) struct QuadraticForm {
    /// N.
    normal: DMatrix<f64>,
    /// g of each block of pixels.
    gradients: Vec<DVector<f64>>,
    /// The unit of places, px.
    length: f64,
    /// A corner, from the centre in units of `length`.
    corner: [f64; 2],
}

impl QuadraticForm {
    /// Adds up the sums of blocks of pixels. Places are in units of `length` px; corners are `half` px from the centre.
    pub(crate) fn new(blocks: Vec<Sums>, length: f64, half: [f64; 2]) -> Self {
        let normal = |i: usize, j: usize| blocks.iter().map(|block: &Sums| block.normal[i][j]).sum::<f64>();
        let valid = blocks.iter().filter(|block| block.valid > 0.0);
        Self {
            normal: DMatrix::from_fn(UNKNOWNS, UNKNOWNS, normal),
            gradients: valid.map(|block| DVector::from_row_slice(&block.gradient)).collect(),
            length,
            corner: half.map(|half| half / length),
        }
    }

    /// The standard deviation of T; `None` if the images do not determine it, or if there are too few blocks to tell.
    ///
    /// It is the deviation of an M-estimate, H⁻¹ B H⁻¹, with B the scatter of the gradients over blocks, within which residuals may be
    /// alike. H is N without the share that noise has in its gradients.
    pub(crate) fn deviation(&self, motion: Motion, gradients: &Gradients) -> Option<TransformDeviation> {
        let count = motion.unknowns();
        let (shared, _) = gradients.sharp.shared(count)?;
        let shared = shared.symmetric_eigen();
        let over = shared.eigenvalues.map(|share| 1.0 / share.max(LEAST_SHARED));
        let over = &shared.eigenvectors * DMatrix::from_diagonal(&over) * shared.eigenvectors.transpose();
        let inverse = self.normal.view((0, 0), (count, count)).clone_owned().cholesky()?.l().try_inverse()?;
        let inverse = inverse.transpose() * over * inverse;
        let covariance = &inverse * self.scatter(count)? * &inverse;
        let corner = |corner: [f64; 2]| {
            let by = displacements(corner);
            let by = DMatrix::from_fn(2, count, |axis, i| by[i][axis]);
            let [xx, xy, yy] = {
                let c = &by * &covariance * by.transpose();
                [c[(0, 0)], c[(0, 1)], c[(1, 1)]]
            };
            ((xx + yy), 0.5 * (2.0 * xy).atan2(xx - yy).to_degrees())
        };
        let (square, direction) = self.corners().map(corner).into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
        let corner_px = square.max(0.0).sqrt().hypot(WITHOUT_NOISE);
        corner_px.is_finite().then(|| TransformDeviation { corner_px, direction_deg: direction.rem_euclid(180.0) })
    }

    /// The scatter of the gradients of a model, of their sum over the blocks.
    fn scatter(&self, count: usize) -> Option<DMatrix<f64>> {
        let blocks = self.gradients.len();
        let mean = self.gradients.iter().sum::<DVector<f64>>() / blocks as f64;
        let centred = self.gradients.iter().map(|g| (g - &mean).rows(0, count).clone_owned());
        let sum: DMatrix<f64> = centred.map(|g| &g * g.transpose()).fold(DMatrix::zeros(count, count), |a, b| a + b);
        if blocks > 2 * count {
            // T was fitted to the same blocks.
            return Some(sum * (blocks as f64 / (blocks - count) as f64));
        }
        // Few blocks determine one factor on N.
        let normal = self.normal.view((0, 0), (count, count)).clone_owned();
        let factor = normal.clone().cholesky()?.solve(&sum).trace() / count as f64;
        (blocks > 1).then(|| normal * (factor * blocks as f64 / (blocks - 1) as f64))
    }

    /// The direction, 0 to 180°, in which the images do not determine the displacement of a corner.
    pub(crate) fn undetermined(&self, motion: Motion, gradients: &Gradients) -> Option<f64> {
        let count = motion.unknowns();
        let (shared, unknowns) = gradients.smooth.shared(count)?;
        let shared = shared.symmetric_eigen();
        let (least, share) = shared.eigenvalues.argmin();
        if share >= LEAST_SHARED_RATIO * shared.eigenvalues.max() {
            return None;
        }
        let step = unknowns * shared.eigenvectors.column(least);
        let moved = |corner: [f64; 2]| {
            let by = displacements(corner);
            [0, 1].map(|axis| (0..count).map(|i| by[i][axis] * step[i]).sum::<f64>())
        };
        let length = |d: &[f64; 2]| d[0].hypot(d[1]);
        let farthest = self.corners().map(moved).into_iter().max_by(|a, b| length(a).total_cmp(&length(b)))?;
        Some(farthest[1].atan2(farthest[0]).to_degrees().rem_euclid(180.0))
    }

    fn corners(&self) -> [[f64; 2]; 4] {
        let [w, h] = self.corner;
        [[w, h], [-w, h], [w, -h], [-w, -h]]
    }

    /// The model that would do instead of `motion`: the richest that explains more than those below it, or else the
    /// simplest that explains as much.
    pub(crate) fn other_motion(&self, motion: Motion, t: &Homography) -> Option<OtherMotion> {
        let own = self.best(motion, &DVector::zeros(UNKNOWNS))?;
        self.richer(motion, &own).or_else(|| self.simpler(motion, &own, t))
    }

    fn richer(&self, motion: Motion, own: &DVector<f64>) -> Option<OtherMotion> {
        let (mut richer, mut fewer, mut last) = (None, motion, own.clone());
        for more in Motion::ALL.into_iter().filter(|&m| m > motion) {
            let best = self.best(more, &DVector::zeros(UNKNOWNS))?;
            if self.corner_distance(&last, &best) >= SAME_CORNERS
                && self.is_significant(fewer, more, &DVector::zeros(UNKNOWNS))?
            {
                let corner_px = self.corner_distance(own, &best);
                richer = Some(OtherMotion { motion: more, explains_more: true, corner_px });
            }
            (fewer, last) = (more, best);
        }
        richer
    }

    fn simpler(&self, motion: Motion, own: &DVector<f64>, t: &Homography) -> Option<OtherMotion> {
        Motion::ALL.into_iter().take_while(|&m| m < motion).find_map(|simpler| {
            let beyond = |i: usize| (simpler.unknowns()..motion.unknowns()).contains(&i);
            let excess = self.excess(t);
            let without = DVector::from_fn(UNKNOWNS, |i, _| if beyond(i) { excess[i] } else { 0.0 });
            let corner_px = self.corner_distance(own, &self.best(simpler, &without)?);
            let same = corner_px < SAME_CORNERS || !self.is_significant(simpler, motion, &without)?;
            same.then_some(OtherMotion { motion: simpler, explains_more: false, corner_px })
        })
    }

    /// The best step in a model's unknowns with the others given; `None` if the images do not determine it.
    fn best(&self, motion: Motion, given: &DVector<f64>) -> Option<DVector<f64>> {
        let count = motion.unknowns();
        let gradient: DVector<f64> = self.gradients.iter().sum();
        let right = -(gradient + &self.normal * given).rows(0, count);
        let solved = self.normal.view((0, 0), (count, count)).clone_owned().cholesky()?.solve(&right);
        let step = DVector::from_fn(UNKNOWNS, |i, _| if i < count { solved[i] } else { given[i] });
        step.iter().all(|v| v.is_finite()).then_some(step)
    }

    /// Tests whether the unknowns that `more` has beyond `fewer` are significant. `without` is the step by which T
    /// loses them.
    ///
    /// Hotelling's test of their gradients over the blocks of pixels, with the other unknowns eliminated. Residuals at
    /// edges of depth are alike within a block and scatter from block to block, as those of a motion do not.
    fn is_significant(&self, fewer: Motion, more: Motion, without: &DVector<f64>) -> Option<bool> {
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
        Some(freedom >= 1.0 && over_chance > SIGNIFICANT)
    }

    /// The step that removes each unknown's share from T, to first order.
    fn excess(&self, t: &Homography) -> [f64; UNKNOWNS] {
        let ([[xx, xy, _], [yx, yy, _], [gx, gy, _]], l) = (t.matrix(), self.length);
        // The linear part as complex numbers: u to c u + k ū. The step -k/c removes k, and 1/c - 1 removes c.
        let (c, k) = ([xx + yy, yx - xy].map(|v| 0.5 * v), [xx - yy, yx + xy].map(|v| 0.5 * v));
        let square = c[0] * c[0] + c[1] * c[1];
        let over_c = |[x, y]: [f64; 2]| [(x * c[0] + y * c[1]) / square, (y * c[0] - x * c[1]) / square];
        let ([zoom, turn], [stretch, shear]) = (over_c([1.0, 0.0]), over_c(k));
        [0.0, 0.0, l * (zoom - 1.0), l * turn, -l * stretch, -l * shear, -l * l * gx, -l * l * gy]
    }

    /// The largest distance between the corners that two steps give, px.
    fn corner_distance(&self, a: &DVector<f64>, b: &DVector<f64>) -> f64 {
        let moved = |corner: [f64; 2]| {
            let by = displacements(corner);
            let along = |axis: usize| (0..UNKNOWNS).map(|i| (a[i] - b[i]) * by[i][axis]).sum::<f64>();
            along(0).hypot(along(1))
        };
        self.corners().map(moved).into_iter().fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::super::windows::Agreement;
    use super::*;
    use crate::base::Similarity;
    use crate::engine::stages::harness::random;

    const LENGTH: f64 = 64.0;

    /// The sums of an image of 200 x 150 px with random gradients, whose residuals a step removes except for noise.
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
        QuadraticForm::new(blocks.to_vec(), LENGTH, [100.0, 75.0]).other_motion(motion, &t.into())
    }

    #[test]
    fn a_richer_model_is_reported_if_it_moves_a_corner() {
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
    fn noise_alone_reports_no_model() {
        let still = blocks([0.0; UNKNOWNS], 0.1);
        assert_eq!(other(&still, Motion::Similarity, Similarity::new(1.0, 2.0, 0.3, 1.02)), None);
    }

    /// Gradients of which a share is the scene and the rest noise, along the unknown `weak` another share.
    fn gradients(share: f64, weak: usize, of_weak: f64) -> Gradients {
        let diagonal = |of: &dyn Fn(usize) -> f64| {
            std::array::from_fn(|i| std::array::from_fn(|j| if i == j { of(i) } else { 0.0 }))
        };
        let (own, both) = (diagonal(&|_| 1.0), diagonal(&|i| if i == weak { of_weak } else { share }));
        let agreement = Agreement { own, both };
        Gradients {
            sharp: agreement.clone(),
            smooth: agreement,
            effects: [[0.0; UNKNOWNS]; UNKNOWNS],
            matched: Vec::new(),
            unmatched: None,
            steps: Default::default(),
            noise: [Vec::new(), Vec::new()],
            channels: Vec::new(),
        }
    }

    #[test]
    fn steps_of_many_seeds_scatter_by_the_standard_deviation() {
        // The noise of the residuals, some of which has 5 times the deviation of the rest.
        let motion = Motion::Similarity;
        let one = |seed: u64| {
            let random = random(5 * 20_000, seed);
            let part = |numbers: &[f64]| sums(numbers, [0.0; UNKNOWNS], if numbers[0] < 0.2 { 0.5 } else { 0.1 });
            let form = QuadraticForm::new(random.chunks_exact(5 * 400).map(part).collect(), LENGTH, [100.0, 75.0]);
            let step = form.best(motion, &DVector::zeros(UNKNOWNS)).unwrap();
            let deviation = form.deviation(motion, &gradients(1.0, 0, 1.0)).unwrap();
            form.corner_distance(&step, &DVector::zeros(UNKNOWNS)) / deviation.corner_px
        };
        let ratios: Vec<f64> = (0..200).map(one).collect();
        let share = |most: f64| ratios.iter().filter(|ratio| **ratio <= most).count() as f64 / ratios.len() as f64;
        // The farthest of four corners. For one corner, displaced alike along x and y, these are 0.63 and 0.98.
        assert!(
            (0.3..0.65).contains(&share(1.0)) && (0.9..0.99).contains(&share(2.0)),
            "{} {}",
            share(1.0),
            share(2.0)
        );
    }

    #[test]
    fn noise_in_the_gradients_makes_t_less_certain() {
        let form = QuadraticForm::new(blocks([0.0; UNKNOWNS], 0.1), LENGTH, [100.0, 75.0]);
        let deviation = |share| form.deviation(Motion::Translation, &gradients(share, 0, share)).unwrap().corner_px;
        let [clean, half] = [deviation(1.0), deviation(0.5)].map(|d| (d * d - WITHOUT_NOISE * WITHOUT_NOISE).sqrt());
        assert!((half / clean - 2.0).abs() < 1e-6, "{clean} {half}");
    }

    #[test]
    fn the_direction_without_shared_gradients_is_not_determined() {
        let form = QuadraticForm::new(blocks([0.0; UNKNOWNS], 0.1), LENGTH, [100.0, 75.0]);
        let along = |weak, share| form.undetermined(Motion::Similarity, &gradients(0.9, weak, share));
        assert_eq!((along(0, 0.1), along(0, 0.5)), (Some(0.0), None));
        assert!((along(1, 0.0).unwrap() - 90.0).abs() < 1e-6);
        // A turn moves a corner at right angles to its place.
        let turn = along(3, -0.1).unwrap();
        let expected = [75f64, -75.0].map(|y| 100f64.atan2(-y).to_degrees().rem_euclid(180.0));
        assert!(expected.iter().any(|e| (turn - e).abs() < 1e-6), "{turn} {expected:?}");
    }

    #[test]
    fn the_simplest_model_that_explains_as_much_is_reported() {
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
