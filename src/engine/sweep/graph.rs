//! The registration of all frames of a sweep at once: each pair tells how its two frames lie to each other, so that the normal
//! equations are the Laplacian of a graph, whose nodes are frames and one of which is held.

use nalgebra::{Cholesky, DMatrix, DVector};

use crate::engine::stages::sums::{Sums, UNKNOWNS};

/// What a pair tells of its frames, the sharper first: sums by the displacement of the second.
pub(super) struct Link {
    pub(super) frames: [usize; 2],
    pub(super) sums: Sums,
}

/// By how much of what the pairs tell of a frame's T in the median each step is held. What they hardly tell stays where coarser levels have
/// put it: a frame far out of focus, or one of which a corner alone tells, takes what the model does not explain for motion. Without, the
/// second frame of the heat sink's seven came out 2.3 px off, and of a part of it the last one turned by 160°.
const HELD: f64 = 0.05;

/// The step of each frame's T by the first so many unknowns, the reference held; none where the links do not determine it.
pub(super) fn step(links: &[Link], frames: usize, reference: usize, unknowns: usize) -> Vec<[f64; UNKNOWNS]> {
    let mut normal = DMatrix::<f64>::zeros(frames * unknowns, frames * unknowns);
    let mut right = DVector::<f64>::zeros(frames * unknowns);
    for Link { frames: [i, j], sums } in links {
        for (a, b) in (0..unknowns).flat_map(|a| (0..unknowns).map(move |b| (a, b))) {
            for (n, m, sign) in [(i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)] {
                normal[(n * unknowns + a, m * unknowns + b)] += sign * sums.normal[a][b];
            }
        }
        for a in 0..unknowns {
            right[j * unknowns + a] -= sums.gradient[a];
            right[i * unknowns + a] += sums.gradient[a];
        }
    }
    for n in reference * unknowns..(reference + 1) * unknowns {
        normal.row_mut(n).fill(0.0);
        normal.column_mut(n).fill(0.0);
        (normal[(n, n)], right[n]) = (1.0, 0.0);
    }
    let mut told: Vec<f64> = normal.diagonal().iter().copied().filter(|told| *told > 0.0).collect();
    told.sort_by(f64::total_cmp);
    let held = HELD * told.get(told.len() / 2).copied().unwrap_or(1.0);
    (0..frames * unknowns).for_each(|n| normal[(n, n)] += held);
    let solved = Cholesky::new(normal).map(|cholesky| cholesky.solve(&right));
    let of = |frame: usize, a: usize| solved.as_ref().map_or(0.0, |x| x[frame * unknowns + a]);
    (0..frames).map(|frame| std::array::from_fn(|a| if a < unknowns { of(frame, a) } else { 0.0 })).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_come_to_where_the_pairs_put_them() {
        let truth = [[0.5, -0.2], [0.0, 0.0], [-0.3, 0.8], [1.0, 0.1]];
        let mut found = [[0.0; 2]; 4];
        let link = |found: &[[f64; 2]; 4], frames: [usize; 2], weight: f64| {
            let mut sums = Sums::default();
            let [own, other] = frames;
            let apart = [0, 1].map(|a| truth[other][a] - truth[own][a] - (found[other][a] - found[own][a]));
            // w (d_j - d_i - apart)², along x and along y.
            for (a, apart) in apart.into_iter().enumerate() {
                sums.normal[a][a] = weight;
                sums.gradient[a] = -weight * apart;
            }
            Link { frames, sums }
        };
        // Steps are held, so that it takes some.
        for _ in 0..100 {
            let told = [([0, 2], 1.0), ([3, 0], 5.0), ([1, 3], 0.2), ([2, 1], 3.0)];
            let links = told.map(|(frames, weight)| link(&found, frames, weight));
            let steps = step(&links, 4, 1, 2);
            found.iter_mut().zip(steps).for_each(|(found, step)| (0..2).for_each(|a| found[a] += step[a]));
        }
        for (found, expected) in found.iter().zip(truth) {
            (0..2).for_each(|a| assert!((found[a] - expected[a]).abs() < 1e-6, "{found:?} {expected:?}"));
        }
    }
}
