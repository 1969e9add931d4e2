//! The cascade: the linear system for dV on grids that are halved from the level down to a few cells.
//!
//! Relaxation on the level alone carries dV a few pixels per sweep, but V of weak areas is determined far away. Two by
//! two cells make one cell of the next grid. The system is summed up from grid to grid before anything is relaxed: dV
//! is 0, so that r itself is the residual. Then dV is relaxed on the coarsest grid, and a few times on each finer one,
//! starting from the coarser one's. Section 4 of `docs/method.md`; `glsl/include/grid.glsl`.

use super::Field;

/// A grid has at least this many cells along its short side, unless its level has fewer pixels than twice as many.
const LEAST_SIDE: u32 = 8;

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

/// The system of a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// D.
    pub d: Field,
    /// r.
    pub r: Field,
    /// Weights of the right neighbours, 0 in the last column.
    pub right: Field,
    /// Weights of the lower neighbours, 0 in the last row.
    pub below: Field,
}

impl Grid {
    /// From floats as they are stored.
    pub(crate) fn of(numbers: &[f64], [width, height]: [u32; 2]) -> Self {
        let (width, height) = (width as usize, height as usize);
        let field = |n: usize| Field::from_fn(width, height, |x, y| numbers[FLOATS * (y * width + x) + n]);
        Self { d: field(0), r: field(1), right: field(2), below: field(3) }
    }

    /// The floats that are stored.
    pub(crate) fn numbers(&self) -> Vec<f64> {
        let fields = [&self.d, &self.r, &self.right, &self.below];
        (0..self.d.data.len()).flat_map(|i| fields.map(|field| field.data[i])).collect()
    }

    /// Two by two cells make one. D and r add up. A link across the border is as wide as two, and twice as long.
    pub fn halved(&self) -> Self {
        let (width, height) = (self.d.width.div_ceil(2), self.d.height.div_ceil(2));
        let mut coarse = [(); FLOATS].map(|()| Field::zeros(width, height));
        for y in 0..self.d.height {
            for x in 0..self.d.width {
                let (i, k) = (y * self.d.width + x, y / 2 * width + x / 2);
                coarse[0].data[k] += self.d.data[i];
                coarse[1].data[k] += self.r.data[i];
                coarse[2].data[k] += if x % 2 == 1 { 0.5 * self.right.data[i] } else { 0.0 };
                coarse[3].data[k] += if y % 2 == 1 { 0.5 * self.below.data[i] } else { 0.0 };
            }
        }
        let [d, r, right, below] = coarse;
        Self { d, r, right, below }
    }

    /// Relaxes the cells of one color: 0 red, x + y even; 1 black.
    pub fn relax(&self, dv: &mut Field, color: usize, over_relaxation: f64) {
        let (width, height) = (dv.width, dv.height);
        for y in 0..height {
            for x in ((y + color) & 1..width).step_by(2) {
                let i = y * width + x;
                let (mut sum, mut diagonal) = (self.r.data[i], self.d.data[i]);
                let mut link = |weight: f64, n: usize| {
                    sum += weight * dv.data[n];
                    diagonal += weight;
                };
                if x + 1 < width {
                    link(self.right.data[i], i + 1);
                }
                if x > 0 {
                    link(self.right.data[i - 1], i - 1);
                }
                if y + 1 < height {
                    link(self.below.data[i], i + width);
                }
                if y > 0 {
                    link(self.below.data[i - width], i - width);
                }
                dv.data[i] += over_relaxation * (sum / diagonal.max(1e-12) - dv.data[i]);
            }
        }
    }
}

/// dV of a grid or level before its first relaxation sweep: that of the next coarser grid.
pub fn prolonged(coarse: &Field, width: usize, height: usize) -> Field {
    Field::from_fn(width, height, |x, y| coarse.get(x / 2, y / 2))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::super::harness::random_field;
    use super::*;

    /// A grid with random D, r and weights, and flat regions: half of the cells have no D.
    pub(crate) fn random_grid([width, height]: [u32; 2], seed: u64) -> Grid {
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
        Grid { d, r, right: inside(right, 1, 0), below: inside(below, 0, 1) }
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

    /// The sums of D and r stay. Links of 1 stay 1: two links of half the weight.
    #[test]
    fn a_halved_grid_keeps_sums_and_even_links() {
        let grid = random_grid([38, 21], 3);
        let coarse = grid.halved();
        let sum = |field: &Field| field.data.iter().sum::<f64>();
        assert!((sum(&grid.d) - sum(&coarse.d)).abs() < 1e-9 && (sum(&grid.r) - sum(&coarse.r)).abs() < 1e-9);
        let ones = Field::from_fn(32, 32, |x, _| if x < 31 { 1.0 } else { 0.0 });
        let even = Grid { right: ones, ..random_grid([32, 32], 1) };
        assert_eq!(even.halved().right.get(3, 3), 1.0);
    }
}
