//! Which frames of a sweep are paired, and the registration of all frames from the sums of all pairs.

use nalgebra::{Cholesky, DMatrix, DVector};

use crate::engine::stages::sums::{Sums, UNKNOWNS};

/// The largest V of a pair that counts, px² of a level. Other pairs determine wider blur.
pub const MAX_RELATIVE_BLUR: f64 = 10.0;
/// Distance of the frames of a pair, about, px of blur: if they are closer, noise outweighs the difference.
const PAIR_BLUR: f64 = 0.75;

/// The number of frames that are [`PAIR_BLUR`] together.
pub(super) fn stride(settings: &[f64], rate: f64) -> f64 {
    let last = (settings.len() - 1) as f64;
    let mean = (settings[settings.len() - 1] - settings[0]) / last;
    (PAIR_BLUR / (rate.sqrt() * mean)).round().clamp(1.0, last)
}

/// Pairs of frames at ascending focus settings where c is `rate`: those about [`PAIR_BLUR`] apart, and those about
/// twice as far.
///
/// For even settings these are strides s and 2 s + 1 (2 if s is 1). They have no common divisor, so the pairs link all
/// frames. For uneven settings the nearest frames are taken, and neighbours link what is still unlinked.
pub(super) fn choose(settings: &[f64], rate: f64) -> Vec<[usize; 2]> {
    let last = settings.len() - 1;
    let mean = (settings[last] - settings[0]) / last as f64;
    let stride = stride(settings, rate);
    let wider = 2.0 * stride + if stride > 1.0 { 1.0 } else { 0.0 };
    let mut pairs = Vec::new();
    for stride in [stride, wider] {
        for i in 0..last {
            let target = settings[i] + stride * mean;
            if target > settings[last] + 0.5 * mean {
                continue;
            }
            let distance = |j: &usize| (settings[*j] - target).abs();
            pairs.extend((i + 1..=last).min_by(|a, b| distance(a).total_cmp(&distance(b))).map(|j| [i, j]));
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    link(&mut pairs, settings.len());
    pairs
}

/// Adds neighbours until all frames are linked.
fn link(pairs: &mut Vec<[usize; 2]>, frames: usize) {
    let mut group: Vec<usize> = (0..frames).collect();
    let join = |group: &mut Vec<usize>, [i, j]: [usize; 2]| {
        let (from, to) = (group[j], group[i]);
        group.iter_mut().filter(|g| **g == from).for_each(|g| *g = to);
    };
    pairs.iter().for_each(|pair| join(&mut group, *pair));
    for i in 1..frames {
        if group[i - 1] != group[i] {
            pairs.push([i - 1, i]);
            join(&mut group, [i - 1, i]);
        }
    }
}

/// The sums of one pair by the displacement of its second frame; the first is the sharper one.
pub(super) struct PairSums {
    pub(super) frames: [usize; 2],
    pub(super) sums: Sums,
    /// The sums of a step of parallax: N and g of w u, and of w u² in the place of the roughness and the spread. u is in
    /// halves of the range of settings.
    pub(super) by_u: Option<Sums>,
    /// The same of each tile of the level; none without parallax.
    pub(super) tiles: Vec<PairSums>,
}

impl PairSums {
    /// N of two unknowns. The first `unknowns` are those of T, the next two those of parallax.
    fn normal(&self, unknowns: usize, [a, b]: [usize; 2]) -> f64 {
        let Some(by_u) = &self.by_u else { return self.sums.normal[a][b] };
        match [a, b].map(|n| n.checked_sub(unknowns)) {
            [None, None] => self.sums.normal[a][b],
            [None, Some(b)] => by_u.normal[a][b],
            [Some(a), None] => by_u.normal[b][a],
            [Some(0), Some(0)] => by_u.roughness[0],
            [Some(1), Some(1)] => by_u.spread,
            _ => by_u.roughness[1],
        }
    }

    /// The evidence that displacement by u gives for the scale of u, with these parallaxes of the frames.
    pub(super) fn displaced(&self, parallax: &[[f64; 2]]) -> f64 {
        let [x, y] = [0, 1].map(|c| parallax[self.frames[1]][c] - parallax[self.frames[0]][c]);
        let Some(Sums { roughness: [xx, xy], spread: yy, .. }) = &self.by_u else { return 0.0 };
        x * x * xx + 2.0 * x * y * xy + y * y * yy
    }

    fn gradient(&self, unknowns: usize, a: usize) -> f64 {
        match (&self.by_u, a.checked_sub(unknowns)) {
            (Some(by_u), Some(a)) => by_u.gradient[a],
            _ => self.sums.gradient[a],
        }
    }
}

/// The step of a frame: T by its unknowns, and parallax, pixels of the level at half the range of settings.
#[derive(Clone, Copy, Default)]
pub(super) struct Step {
    pub(super) transform: [f64; UNKNOWNS],
    pub(super) parallax: [f64; 2],
}

/// Damping of each step, in shares of the median information about a T. Frames that the pairs hardly determine stay
/// where coarser levels put them: one far out of focus, or determined in a corner only, would follow what the model
/// does not explain. Without damping the second of the heat sink's seven frames came out 2.3 px off, and in a part of
/// it the last one turned by 160°.
const DAMPING: f64 = 0.05;

/// The step of each frame's T by its first `unknowns` parameters, with the reference held; zero if the pairs do not
/// determine it. And with parallax, what each tile alone would move that of each frame by at the step: their scatter is its
/// deviation.
///
/// A pair determines how its two frames lie to each other, so the normal equations are the Laplacian of a graph whose
/// nodes are frames.
pub(super) fn registration_steps(
    pairs: &[PairSums],
    frames: usize,
    reference: usize,
    unknowns: usize,
) -> (Vec<Step>, Vec<Vec<[f64; 2]>>) {
    let all = unknowns + if pairs.iter().any(|pair| pair.by_u.is_some()) { 2 } else { 0 };
    let mut normal = DMatrix::<f64>::zeros(frames * all, frames * all);
    let mut right = DVector::<f64>::zeros(frames * all);
    for pair in pairs {
        let [i, j] = pair.frames;
        for (a, b) in (0..all).flat_map(|a| (0..all).map(move |b| (a, b))) {
            for (n, m, sign) in [(i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)] {
                normal[(n * all + a, m * all + b)] += sign * pair.normal(unknowns, [a, b]);
            }
        }
        for a in 0..all {
            right[j * all + a] -= pair.gradient(unknowns, a);
            right[i * all + a] += pair.gradient(unknowns, a);
        }
    }
    for n in reference * all..(reference + 1) * all {
        normal.row_mut(n).fill(0.0);
        normal.column_mut(n).fill(0.0);
        (normal[(n, n)], right[n]) = (1.0, 0.0);
    }
    let mut information: Vec<f64> = normal.diagonal().iter().copied().filter(|entry| *entry > 0.0).collect();
    information.sort_by(f64::total_cmp);
    let damping = DAMPING * information.get(information.len() / 2).copied().unwrap_or(1.0);
    (0..frames * all).for_each(|n| normal[(n, n)] += damping);
    let Some(cholesky) = Cholesky::new(normal) else { return (vec![Step::default(); frames], Vec::new()) };
    let solved = cholesky.solve(&right);
    let step = |frame: usize, solved: &DVector<f64>| {
        let mut step = Step::default();
        (0..unknowns).for_each(|a| step.transform[a] = solved[frame * all + a]);
        (unknowns..all).for_each(|a| step.parallax[a - unknowns] = solved[frame * all + a]);
        step
    };
    let of_tile = |tile: usize| {
        let mut right = DVector::<f64>::zeros(frames * all);
        for pair in pairs {
            let ([i, j], tile) = (pair.frames, &pair.tiles[tile]);
            for a in 0..all {
                let moved = |b: usize| tile.normal(unknowns, [a, b]) * (solved[j * all + b] - solved[i * all + b]);
                let left = tile.gradient(unknowns, a) + (0..all).map(moved).sum::<f64>();
                right[j * all + a] -= left;
                right[i * all + a] += left;
            }
        }
        right.rows_mut(reference * all, all).fill(0.0);
        let moved = cholesky.solve(&right);
        (0..frames).map(|frame| step(frame, &moved).parallax).collect()
    };
    let tiles = pairs.first().map_or(0, |pair| pair.tiles.len());
    ((0..frames).map(|frame| step(frame, &solved)).collect(), (0..tiles).map(of_tile).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strides_follow_the_blur_and_link_all_frames() {
        let even: Vec<f64> = (0..9).map(f64::from).collect();
        // 0.25 px a step: strides of 3 and 7.
        let pairs = choose(&even, 0.0625);
        assert!(pairs.contains(&[0, 3]) && pairs.contains(&[5, 8]) && pairs.contains(&[1, 8]), "{pairs:?}");
        assert!(pairs.iter().all(|[i, j]| [1, 3, 7].contains(&(j - i))));
        assert!(choose(&even, 4.0).iter().all(|[i, j]| j - i <= 2));
        for settings in [even, vec![0.0, 0.1, 0.2, 5.0, 9.0], vec![0.0, 1.0]] {
            for rate in [1e-4, 0.03, 1.0, 50.0] {
                let mut reached = vec![0];
                let pairs = choose(&settings, rate);
                for _ in 0..settings.len() {
                    let next = pairs.iter().flat_map(|&[i, j]| [(i, j), (j, i)]).filter(|(i, _)| reached.contains(i));
                    reached = next.map(|(_, j)| j).chain(reached.iter().copied()).collect();
                    reached.sort_unstable();
                    reached.dedup();
                }
                assert_eq!(reached.len(), settings.len(), "{settings:?} {rate}");
            }
        }
    }

    #[test]
    fn steps_lead_to_the_registration_that_the_pairs_state() {
        let truth = [[0.5, -0.2], [0.0, 0.0], [-0.3, 0.8], [1.0, 0.1]];
        let mut moved = [[0.0; 2]; 4];
        let pair = |moved: &[[f64; 2]; 4], frames: [usize; 2], weight: f64| {
            let mut sums = Sums::default();
            let [own, other] = frames;
            let error = [0, 1].map(|a| truth[other][a] - truth[own][a] - (moved[other][a] - moved[own][a]));
            // w (d_j - d_i - error)², along x and along y.
            for (a, error) in error.into_iter().enumerate() {
                sums.normal[a][a] = weight;
                sums.gradient[a] = -weight * error;
            }
            PairSums { frames, sums, by_u: None, tiles: Vec::new() }
        };
        // Steps are damped, so it takes many.
        for _ in 0..100 {
            let weights = [([0, 2], 1.0), ([3, 0], 5.0), ([1, 3], 0.2), ([2, 1], 3.0)];
            let pairs = weights.map(|(frames, weight)| pair(&moved, frames, weight));
            let (steps, _) = registration_steps(&pairs, 4, 1, 2);
            moved.iter_mut().zip(steps).for_each(|(moved, step)| (0..2).for_each(|a| moved[a] += step.transform[a]));
        }
        for (moved, expected) in moved.iter().zip(truth) {
            (0..2).for_each(|a| assert!((moved[a] - expected[a]).abs() < 1e-6, "{moved:?} {expected:?}"));
        }
    }
}
