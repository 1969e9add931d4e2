//! The links of neighbouring pixels by the smoothness term: weights, and pulls on V or u.

use super::lanes::vectorised;
use super::{Number, Raster};
use crate::engine::shaders;

/// Pixels over which slopes on either side of two neighbours are computed. Over fewer, noise counts as slope; over
/// more, bends of V are straightened.
const REACH: isize = shaders::system::REACH as isize;

/// Links from each pixel of a row to the next pixel along x or y.
#[derive(Default)]
pub(super) struct LinkRow<N> {
    /// a, 0 across the border.
    pub(super) weights: Vec<N>,
    /// a times the rise of the unknown to the next pixel, less that by its slope.
    pub(super) pulls: Vec<N>,
}

/// Σa of each pixel from `start` on, and the sum of the pulls on it: of the links of its row, downwards, and of the row
/// above.
pub(super) fn sums<N: Number>([across, down, above]: [&LinkRow<N>; 3], start: usize, [weights, pulls]: [&mut [N]; 2]) {
    vectorised(
        #[inline(always)]
        || {
            add(N::of(1.0), [&across.weights, &down.weights, &above.weights], start, weights);
            add(N::of(-1.0), [&across.pulls, &down.pulls, &above.pulls], start, pulls);
        },
    );
}

/// The links to the right and downwards, plus `sign` times those from the left and from above.
#[inline(always)]
fn add<N: Number>(sign: N, [across, down, above]: [&[N]; 3], start: usize, sums: &mut [N]) {
    let count = sums.len();
    let (right, down, above) = (&across[start..][..count], &down[start..][..count], &above[start..][..count]);
    if start > 0 {
        let left = &across[start - 1..][..count];
        for n in 0..count {
            sums[n] = right[n] + sign * left[n] + down[n] + sign * above[n];
        }
        return;
    }
    sums[0] = right[0] + down[0] + sign * above[0];
    for n in 1..count {
        sums[n] = right[n] + sign * right[n - 1] + down[n] + sign * above[n];
    }
}

/// The links of a level.
pub(super) struct Links<'a, N> {
    unknown: &'a Raster<N>,
    /// φ.
    phi: Raster<N>,
    /// Half of α c.
    strength: N,
    has_slopes: bool,
}

impl<'a, N: Number> Links<'a, N> {
    /// With `φ = 1/√(rate |∇u|² + η²)`. Without slopes, pulls are those of the whole rises.
    pub(super) fn new(unknown: &'a Raster<N>, [alpha, rate, eta]: [f64; 3], has_slopes: bool) -> Self {
        let strength = N::of(0.5 * alpha * rate);
        let [rate, eta2, half] = [rate, eta * eta, 0.5].map(N::of);
        let last = [unknown.width - 1, unknown.height - 1];
        let mut phi = Raster::zeros(unknown.width, unknown.height);
        phi.fill_rows(|y, phi| {
            let [above, here, below] = [y.saturating_sub(1), y, (y + 1).min(last[1])].map(|y| unknown.row(y));
            let of = |x: usize, [before, behind]: [usize; 2]| {
                let (across, down) = (half * (here[behind] - here[before]), half * (below[x] - above[x]));
                N::of(1.0) / (rate * (across * across + down * down) + eta2).sqrt()
            };
            phi[0] = of(0, [0, last[0].min(1)]);
            (1..last[0]).for_each(|x| phi[x] = of(x, [x - 1, x + 1]));
            phi[last[0]] = of(last[0], [last[0].saturating_sub(1), last[0]]);
        });
        Self { unknown, phi, strength, has_slopes }
    }

    /// φ.
    pub(super) fn phi(&self) -> &Raster<N> {
        &self.phi
    }

    /// The links of a row to the right.
    pub(super) fn across(&self, y: usize, links: &mut LinkRow<N>) {
        let (v, phi, last) = (self.unknown.row(y), self.phi.row(y), self.phi.width - 1);
        vectorised(
            #[inline(always)]
            || {
                self.load(links, last, [&phi[..last], &phi[1..]], [&v[..last], &v[1..]]);
                if self.has_slopes {
                    let at = |x: isize| v[x.clamp(0, last as isize) as usize];
                    let reach = REACH as usize;
                    let inner = reach.min(last)..last.saturating_sub(reach).max(reach.min(last));
                    for x in (0..inner.start).chain(inner.end..last) {
                        let n = x as isize;
                        self.lessen(links, x, at(n) - at(n - REACH), at(n + REACH + 1) - at(n + 1));
                    }
                    let rows = [0, reach, reach + 1, 2 * reach + 1]
                        .map(|n| &v[(inner.start - reach.min(last) + n).min(last)..]);
                    for (n, x) in inner.enumerate() {
                        self.lessen(links, x, rows[1][n] - rows[0][n], rows[3][n] - rows[2][n]);
                    }
                }
            },
        );
        links.weights.push(N::default());
        links.pulls.push(N::default());
    }

    /// The links from a row to the next, which either may be outside.
    pub(super) fn downwards(&self, y: isize, links: &mut LinkRow<N>) {
        let (width, height) = (self.phi.width, self.phi.height as isize);
        if y < 0 || y + 1 == height {
            for numbers in [&mut links.weights, &mut links.pulls] {
                numbers.clear();
                numbers.resize(width, N::default());
            }
            return;
        }
        let row = |y: isize| self.unknown.row(y.clamp(0, height - 1) as usize);
        let phi = [y, y + 1].map(|y| self.phi.row(y as usize));
        let [far_above, here, below, far_below] = [y - REACH, y, y + 1, y + REACH + 1].map(row);
        vectorised(
            #[inline(always)]
            || {
                self.load(links, width, phi, [here, below]);
                if self.has_slopes {
                    for x in 0..width {
                        self.lessen(links, x, here[x] - far_above[x], far_below[x] - below[x]);
                    }
                }
            },
        );
    }

    /// The links of `count` pixels, by φ and the unknown of both pixels, with the pulls of the whole rises.
    #[inline(always)]
    fn load(&self, links: &mut LinkRow<N>, count: usize, phi: [&[N]; 2], unknown: [&[N]; 2]) {
        let LinkRow { weights, pulls } = links;
        weights.resize(count, N::default());
        pulls.resize(count, N::default());
        let ([phi, next_phi], [here, next]) = (phi.map(|row| &row[..count]), unknown.map(|row| &row[..count]));
        let (weights, pulls) = (&mut weights[..count], &mut pulls[..count]);
        for x in 0..count {
            weights[x] = self.strength * (phi[x] + next_phi[x]);
            pulls[x] = weights[x] * (next[x] - here[x]);
        }
    }

    /// Subtracts the rise by the slope, which follows from the rises over `REACH` pixels before and behind.
    #[inline(always)]
    fn lessen(&self, links: &mut LinkRow<N>, x: usize, before: N, behind: N) {
        let product = before * behind;
        let slope = N::of(2.0 / REACH as f64) * product / (before + behind);
        links.pulls[x] = links.pulls[x] - links.weights[x] * if product > N::default() { slope } else { N::default() };
    }
}
