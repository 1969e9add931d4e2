//! The cascade: the linear system for dV on grids that are halved from the level down to a few cells.
//!
//! Relaxation on the level alone carries dV a few pixels per sweep, but V of weak areas is determined far away. Two by
//! two cells make one cell of the next grid. The system is summed up from grid to grid before anything is relaxed: dV
//! is 0, so that r itself is the residual. Then dV is relaxed on the coarsest grid, and a few times on each finer one,
//! starting from the coarser one's. Section 4 of `docs/method.md`; `glsl/include/grid.glsl`.

use std::borrow::Cow;
use std::ops::Range;

use super::Number;
use super::rows::{self, Rows};
use super::segments::vectorised;

/// A grid has at least this many cells along its short side, unless its level has fewer pixels than twice as many.
const LEAST_SIDE: u32 = 8;

/// Rows of a band: all half-sweeps of a band are computed while it is in the cache. Rows around it are computed with
/// it, one fewer in each half: 16 % more for three sweeps, at most 25 %.
pub(super) fn band(halves: usize) -> usize {
    (4 * halves).max(32)
}

/// Floats of a cell's equation: D, r, and the weights of the right and of the lower neighbour.
pub(crate) const FLOATS: usize = 4;

/// Width and height of the next coarser grid.
pub(crate) fn halved([width, height]: [u32; 2]) -> [u32; 2] {
    [width.div_ceil(2), height.div_ceil(2)]
}

/// A grid of a level: its size and its first cell in the buffers of all grids.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Place {
    pub(crate) size: [u32; 2],
    pub(crate) first: u32,
}

/// The grids of a level of this size, the finest first: at least one.
pub(crate) fn grids(level: [u32; 2]) -> Vec<Place> {
    let mut grids = vec![Place { size: halved(level), first: 0 }];
    loop {
        let Place { size, first } = grids[grids.len() - 1];
        if size[0].min(size[1]) < 2 * LEAST_SIDE {
            return grids;
        }
        grids.push(Place { size: halved(size), first: first + size[0] * size[1] });
    }
}

/// Cells of all grids of a level of this size.
pub(crate) fn cells(level: [u32; 2]) -> u64 {
    grids(level).iter().map(|grid| super::pixels(grid.size[0], grid.size[1])).sum()
}

/// The numbers of a cell: D, r, and the weights of the right and of the lower neighbour. Weights of neighbours beyond
/// the border are 0.
pub type Cell<N> = [N; FLOATS];

/// The system of a grid, as it is stored.
#[derive(Clone, Debug)]
pub struct Grid<'a, N: Number = f64> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row.
    pub cells: Cow<'a, [Cell<N>]>,
}

impl<'a, N: Number> Grid<'a, N> {
    /// The grid whose numbers begin at cell `first`.
    pub(crate) fn of(numbers: &'a [N], first: usize, [width, height]: [u32; 2]) -> Self {
        let (width, height) = (width as usize, height as usize);
        Self { width, height, cells: numbers.as_chunks().0[first..][..width * height].into() }
    }

    /// Two by two cells make one. D and r add up. A link across the border is as wide as two, and twice as long.
    pub fn halved(&self) -> Grid<'static, N> {
        let (width, height, half) = (self.width.div_ceil(2), self.height.div_ceil(2), N::of(0.5));
        let mut coarse = vec![[N::default(); FLOATS]; width * height];
        rows::map([Rows { width, numbers: &mut coarse }], |row, [coarse]| {
            for y in 2 * row..(2 * row + 2).min(self.height) {
                for (x, [d, r, right, below]) in self.cells[y * self.width..][..self.width].iter().enumerate() {
                    let cell = &mut coarse[x / 2];
                    cell[0] += *d;
                    cell[1] += *r;
                    cell[2] += if x % 2 == 1 { half * *right } else { N::default() };
                    cell[3] += if y % 2 == 1 { half * *below } else { N::default() };
                }
            }
        });
        Grid { width, height, cells: coarse.into() }
    }

    /// All relaxation sweeps of dV.
    pub(crate) fn relax_all(&self, dv: &mut [N], sweeps: u32, over_relaxation: f32) {
        let start = dv.to_vec();
        self.relax(&start, 0..2 * sweeps as usize, over_relaxation.into(), dv);
    }

    /// Halves of relaxation sweeps from a start. Even halves relax the red cells, where x + y is even, odd ones the
    /// black ones. Bands of rows are computed one after the other, while they are in the cache, and with them the rows
    /// around that they depend on: the same numbers as by one half after the other.
    pub fn relax(&self, start: &[N], halves: Range<usize>, over_relaxation: f64, dv: &mut [N]) {
        let (width, height) = (self.width, self.height);
        debug_assert!(
            self.cells.chunks(width).all(|row| row[width - 1][2] == N::default())
                && self.cells[(height - 1) * width..].iter().all(|cell| cell[3] == N::default()),
            "neighbours beyond the border have weights"
        );
        let lines = band(halves.len());
        rows::map([Rows { width, numbers: dv }.joined(lines)], |band, [result]| {
            let rows = band * lines..(band * lines + lines).min(height);
            let around = |reach: usize| rows.start.saturating_sub(reach)..(rows.end + reach).min(height);
            let Range { start: top, end } = around(halves.len());
            let (mut dv, mut here) = (start[top * width..end * width].to_vec(), vec![N::default(); width]);
            for half in halves.clone() {
                for y in around(halves.end - 1 - half) {
                    let (before, rest) = dv.split_at_mut((y - top) * width);
                    let (own, behind) = rest.split_at_mut(width);
                    here.copy_from_slice(own);
                    // Rows beyond the border are never weighted.
                    let up = if y > 0 { &before[before.len() - width..] } else { &here };
                    let down = if y + 1 < height { &behind[..width] } else { &here };
                    let cells = [y.saturating_sub(1), y].map(|y| &self.cells[y * width..][..width]);
                    let linked = N::of(if y > 0 { 1.0 } else { 0.0 });
                    vectorised::<N, _>(
                        #[inline(always)]
                        || relax_row(cells, [up, &here, down], (y + half) & 1, linked, N::of(over_relaxation), own),
                    );
                }
            }
            result.copy_from_slice(&dv[(rows.start - top) * width..][..result.len()]);
        });
    }
}

/// Relaxes every second cell of a row from `first` on, by the equations of the row above and of the row, and by dV of
/// the rows above, here and below. `linked`: 1, or 0 where there is no row above.
#[inline(always)]
fn relax_row<N: Number>(
    cells: [&[Cell<N>]; 2],
    changes: [&[N]; 3],
    first: usize,
    linked: N,
    over_relaxation: N,
    dv: &mut [N],
) {
    let ([above, cells], [up, here, down], width) = (cells, changes, dv.len());
    let relaxed =
        |[before, own, behind]: [N; 3], left: N, [d, r, right, below]: Cell<N>, above: N, [up, down]: [N; 2]| {
            let above = linked * above;
            let sum = r + right * behind + left * before + below * down + above * up;
            let diagonal = d + right + left + below + above;
            own + over_relaxation * (sum / diagonal.max(N::of(1e-12)) - own)
        };
    // Cells with one before and one behind: pairs of adjacent cells. The second cell of each pair is relaxed.
    let start = 2 - first;
    let count = width.saturating_sub(start) / 2;
    if count > 0 {
        let pairs = &cells[start - 1..].as_chunks::<2>().0[..count];
        let above = &above[start..].as_chunks::<2>().0[..count];
        let [before, up, down] =
            [&here[start - 1..], &up[start..], &down[start..]].map(|row| &row.as_chunks::<2>().0[..count]);
        let dv = &mut dv[start..].as_chunks_mut::<2>().0[..count];
        for n in 0..count {
            let ([left, cell], [before, own], behind) = (pairs[n], before[n], dv[n][1]);
            let own = relaxed([before, own, behind], left[2], cell, above[n][0][3], [up[n][0], down[n][0]]);
            dv[n] = [own, behind];
        }
    }
    for x in [0, width - 1].into_iter().take(width).filter(|x| x % 2 == first) {
        let (before, left) = if x > 0 { (here[x - 1], cells[x - 1][2]) } else { Default::default() };
        let behind = if x + 1 < width { here[x + 1] } else { N::default() };
        dv[x] = relaxed([before, here[x], behind], left, cells[x], above[x][3], [up[x], down[x]]);
    }
}

/// dV of a grid before its first relaxation sweep: that of the next coarser grid.
pub fn prolonged<N: Number>(coarse: &[N], [width, height]: [usize; 2]) -> Vec<N> {
    let (columns, mut fine) = (width.div_ceil(2), vec![N::default(); width * height]);
    rows::map([Rows { width, numbers: &mut fine }], |y, [fine]| {
        fine.chunks_mut(2).zip(&coarse[y / 2 * columns..]).for_each(|(pair, dv)| pair.fill(*dv));
    });
    fine
}

#[cfg(test)]
pub(crate) mod tests {
    use super::super::Field;
    use super::super::harness::random_field;
    use super::*;

    /// A grid with random D, r and weights, and flat regions: half of the cells have no D.
    pub(crate) fn random_grid([width, height]: [u32; 2], seed: u64) -> Grid<'static> {
        let (width, height) = (width as usize, height as usize);
        let [mut d, mut r, right, below] = [1, 2, 3, 4].map(|n| random_field(width, height, 10 * seed + n));
        d.data.iter_mut().for_each(|d| *d = if *d < 0.5 { 0.0 } else { *d });
        r.data.iter_mut().for_each(|r| *r -= 0.5);
        let inside =
            |field: Field, dx: usize, dy: usize| {
                Field::from_fn(width, height, |x, y| {
                    if x + dx < width && y + dy < height { 0.1 + field.get(x, y) } else { 0.0 }
                })
            };
        of_parts([&d, &r, &inside(right, 1, 0), &inside(below, 0, 1)])
    }

    /// A grid by D, r, and the weights of the right and of the lower neighbours.
    pub(crate) fn of_parts(parts: [&Field; FLOATS]) -> Grid<'static> {
        let cells = (0..parts[0].data.len()).map(|i| parts.map(|part| part.data[i])).collect::<Vec<_>>();
        Grid { width: parts[0].width, height: parts[0].height, cells: cells.into() }
    }

    #[test]
    fn grids_end_at_a_short_side_of_8_to_15_cells() {
        let sizes = |level| grids(level).iter().map(|grid| grid.size).collect::<Vec<_>>();
        assert_eq!(sizes([100, 67]), [[50, 34], [25, 17], [13, 9]]);
        assert_eq!(sizes([16, 40]), [[8, 20]]);
        assert_eq!(sizes([8, 8]), [[4, 4]]);
        assert_eq!(grids([100, 67])[2].first, 50 * 34 + 25 * 17);
        assert_eq!(cells([100, 67]), 50 * 34 + 25 * 17 + 13 * 9);
    }

    #[test]
    fn all_sweeps_at_once_are_one_half_after_the_other() {
        for size in [[38, 21], [17, 133], [1, 70], [2, 2]] {
            let (grid, start) = (random_grid(size, 3), random_field(size[0] as usize, size[1] as usize, 4).data);
            let mut expected = start.clone();
            (0..6).for_each(|half| grid.relax(&expected.clone(), half..half + 1, 1.3, &mut expected));
            let mut actual = start.clone();
            grid.relax(&start, 0..6, 1.3, &mut actual);
            assert!(actual == expected, "{size:?}");
        }
    }

    /// The sums of D and r stay. Links of 1 stay 1: two links of half the weight.
    #[test]
    fn a_halved_grid_keeps_sums_and_even_links() {
        let grid = random_grid([38, 21], 3);
        let coarse = grid.halved();
        let sum = |grid: &Grid, n: usize| grid.cells.iter().map(|cell| cell[n]).sum::<f64>();
        assert!((0..2).all(|n| (sum(&grid, n) - sum(&coarse, n)).abs() < 1e-9));
        let mut even = random_grid([32, 32], 1);
        even.cells.to_mut().iter_mut().enumerate().for_each(|(i, cell)| cell[2] = if i % 32 < 31 { 1.0 } else { 0.0 });
        assert_eq!(even.halved().cells[3 * 16 + 3][2], 1.0);
    }
}
