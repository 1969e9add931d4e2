//! The links of neighbouring pixels by the smoothness term: weights, and pulls on V or u.

use super::segments::vectorised;
use super::{Number, Raster};
use crate::engine::shaders;

/// Pixels over which slopes on either side of two neighbours are computed. Over fewer, noise counts as slope; over
/// more, bends of V are straightened.
const REACH: isize = shaders::links::REACH as isize;

/// Links from each pixel of a row to the next pixel along x or y.
#[derive(Default)]
pub(super) struct LinkRow<N> {
    /// a, 0 across the border.
    pub(super) weights: Vec<N>,
    /// a times the rise of the unknown to the next pixel, less that by its slope.
    pub(super) pulls: Vec<N>,
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
    /// Half of α c.
    strength: N,
    rate: N,
    /// η².
    eta2: N,
    has_slopes: bool,
}

/// The links of adjacent rows of a level, one row after the other.
pub(super) struct LinkRows<'a, N> {
    links: &'a Links<'a, N>,
    /// φ of the row and of the next.
    phi: [Vec<N>; 2],
    /// The links of the row to the right.
    pub(super) across: LinkRow<N>,
    /// The links of the row downwards.
    pub(super) down: LinkRow<N>,
    /// The links of the row above downwards.
    pub(super) above: LinkRow<N>,
}

impl<N: Number> LinkRows<'_, N> {
    /// φ of the row.
    pub(super) fn phi(&self) -> &[N] {
        &self.phi[0]
    }

    /// Σa of each pixel of the row from `start` on, and the sum of the pulls on it.
    pub(super) fn sums(&self, start: usize, [weights, pulls]: [&mut [N]; 2]) {
        let Self { across, down, above, .. } = self;
        vectorised::<N, _>(
            #[inline(always)]
            || {
                add(N::of(1.0), [&across.weights, &down.weights, &above.weights], start, weights);
                add(N::of(-1.0), [&across.pulls, &down.pulls, &above.pulls], start, pulls);
            },
        );
    }

    /// Half of the sum of the pulls on a pixel of the row times the rises to its neighbours.
    pub(super) fn roughness(&self, unknown: &Raster<N>, [x, y]: [usize; 2]) -> f64 {
        let (last, here) = (unknown.width - 1, unknown.get(x, y));
        let [left, right] = [x.max(1) - 1, (x + 1).min(last)].map(|x| unknown.get(x, y));
        let [above, below] = [y.max(1) - 1, (y + 1).min(unknown.height - 1)].map(|y| unknown.get(x, y));
        let [across, before] = [x, x.max(1) - 1].map(|x| self.across.pulls[x].into());
        let sides = across * (right - here) + before * (here - left);
        0.5 * (sides + self.down.pulls[x].into() * (below - here) + self.above.pulls[x].into() * (here - above))
    }

    /// Goes on to row y, which follows the row before.
    pub(super) fn advance(&mut self, y: usize) {
        std::mem::swap(&mut self.above, &mut self.down);
        self.phi.swap(0, 1);
        if y + 1 < self.links.unknown.height {
            self.links.phi(y + 1, &mut self.phi[1]);
        }
        self.links.across(y, &self.phi[0], &mut self.across);
        self.links.downwards(y, &self.phi, &mut self.down);
    }
}

impl<'a, N: Number> Links<'a, N> {
    /// With `φ = 1/√(rate |∇u|² + η²)`. Without slopes, pulls are those of the whole rises.
    pub(super) fn new(unknown: &'a Raster<N>, [alpha, rate, eta]: [f64; 3], has_slopes: bool) -> Self {
        let [strength, rate, eta2] = [0.5 * alpha * rate, rate, eta * eta].map(N::of);
        Self { unknown, strength, rate, eta2, has_slopes }
    }

    /// The links of the rows from y on, before the first.
    pub(super) fn rows_from(&self, y: usize) -> LinkRows<'_, N> {
        let [across, mut down, above] = [(); 3].map(|()| LinkRow::default());
        let mut phi = [(); 2].map(|()| Vec::new());
        self.phi(y, &mut phi[1]);
        if y > 0 {
            self.phi(y - 1, &mut phi[0]);
            self.downwards(y - 1, &phi, &mut down);
        } else {
            down.clear(self.unknown.width);
        }
        LinkRows { links: self, phi, across, down, above }
    }

    /// φ of a row.
    fn phi(&self, y: usize, phi: &mut Vec<N>) {
        let [width, last] = [self.unknown.width, self.unknown.height - 1];
        let [above, here, below] = [y.saturating_sub(1), y, (y + 1).min(last)].map(|y| self.unknown.row(y));
        phi.resize(width, N::default());
        vectorised::<N, _>(
            #[inline(always)]
            || {
                for x in [0, width - 1] {
                    let [before, behind] = [here[x.saturating_sub(1)], here[(x + 1).min(width - 1)]];
                    phi[x] = self.phi_of([before, behind, above[x], below[x]]);
                }
                let inner = width.max(2) - 2;
                let (before, behind, phi) = (&here[..inner], &here[width - inner..], &mut phi[1..][..inner]);
                let (above, below) = (&above[1..][..inner], &below[1..][..inner]);
                for x in 0..inner {
                    phi[x] = self.phi_of([before[x], behind[x], above[x], below[x]]);
                }
            },
        );
    }

    /// φ of a pixel, by the unknown to its left and right, above and below.
    #[inline(always)]
    fn phi_of(&self, [left, right, above, below]: [N; 4]) -> N {
        let (across, down) = (N::of(0.5) * (right - left), N::of(0.5) * (below - above));
        N::of(1.0) / (self.rate * (across * across + down * down) + self.eta2).sqrt()
    }

    /// The links of a row to the right.
    fn across(&self, y: usize, phi: &[N], links: &mut LinkRow<N>) {
        let (v, last) = (self.unknown.row(y), self.unknown.width - 1);
        links.clear(last + 1);
        vectorised::<N, _>(
            #[inline(always)]
            || {
                let (weights, pulls) = (&mut links.weights[..last], &mut links.pulls[..last]);
                self.load([weights, pulls], [phi, &phi[1..]], [v, &v[1..]]);
                if self.has_slopes {
                    let at = |x: isize| v[x.clamp(0, last as isize) as usize];
                    let reach = REACH as usize;
                    let inner = reach.min(last)..last.saturating_sub(reach).max(reach.min(last));
                    for x in (0..inner.start).chain(inner.end..last) {
                        let n = x as isize;
                        let rises = [at(n) - at(n - REACH), at(n + REACH + 1) - at(n + 1)];
                        pulls[x] = lessened(pulls[x], weights[x], rises);
                    }
                    let rows = [0, reach, reach + 1, 2 * reach + 1].map(|n| &v[n.min(last)..]);
                    lessen([&mut weights[inner.clone()], &mut pulls[inner]], rows);
                }
            },
        );
    }

    /// The links from a row to the next, which may be outside, by φ of both.
    fn downwards(&self, y: usize, phi: &[Vec<N>; 2], links: &mut LinkRow<N>) {
        let Raster { width, height, .. } = *self.unknown;
        links.clear(width);
        if y + 1 == height {
            return;
        }
        let (y, last) = (y as isize, height as isize - 1);
        let row = |y: isize| self.unknown.row(y.clamp(0, last) as usize);
        let [far_above, here, below, far_below] = [y - REACH, y, y + 1, y + REACH + 1].map(row);
        vectorised::<N, _>(
            #[inline(always)]
            || {
                let (weights, pulls) = (&mut links.weights[..width], &mut links.pulls[..width]);
                self.load([weights, pulls], [&phi[0], &phi[1]], [here, below]);
                if self.has_slopes {
                    lessen([weights, pulls], [far_above, here, below, far_below]);
                }
            },
        );
    }

    /// The links of pixels, by φ and the unknown of both pixels, with the pulls of the whole rises.
    #[inline(always)]
    fn load(&self, [weights, pulls]: [&mut [N]; 2], [phi, next_phi]: [&[N]; 2], [here, next]: [&[N]; 2]) {
        let count = weights.len();
        let (phi, next_phi, pulls) = (&phi[..count], &next_phi[..count], &mut pulls[..count]);
        let (here, next) = (&here[..count], &next[..count]);
        for x in 0..count {
            weights[x] = self.strength * (phi[x] + next_phi[x]);
            pulls[x] = weights[x] * (next[x] - here[x]);
        }
    }
}

impl<N: Number> LinkRow<N> {
    /// Sets the size. Links beyond the border have no weight.
    fn clear(&mut self, width: usize) {
        for numbers in [&mut self.weights, &mut self.pulls] {
            numbers.clear();
            numbers.resize(width, N::default());
        }
    }
}

/// Lessens the pulls of links by the slopes on either side: of the unknown from the first row to the second and from
/// the third to the fourth.
#[inline(always)]
fn lessen<N: Number>([weights, pulls]: [&mut [N]; 2], rows: [&[N]; 4]) {
    let count = pulls.len();
    let (weights, pulls) = (&weights[..count], &mut pulls[..count]);
    let [far_before, before, behind, far_behind] = rows.map(|row| &row[..count]);
    for x in 0..count {
        pulls[x] = lessened(pulls[x], weights[x], [before[x] - far_before[x], far_behind[x] - behind[x]]);
    }
}

/// A pull, less the weight times the harmonic mean of the rises before and behind, if both have one sign.
#[inline(always)]
fn lessened<N: Number>(pull: N, weight: N, [before, behind]: [N; 2]) -> N {
    let product = before * behind;
    let slope = N::of(2.0 / REACH as f64) * product / (before + behind);
    pull - weight * if product > N::default() { slope } else { N::default() }
}
