//! Random dots: the paper's second test.

use super::view::split;
use crate::base::random::Random;

/// Squares of 4 px, black (0) or white (1) at random, softened by a Gaussian of σ 0.6 px. The pattern repeats beyond a
/// margin around the image.
pub(super) struct Dots {
    cells: Vec<f64>,
    columns: usize,
    rows: usize,
    edge: Vec<f64>,
}

/// Side of a dot, px.
const SIDE: f64 = 4.0;

/// σ of the softening, px. Beyond a dot's neighbours it reaches 1e-11.
const SOFTNESS: f64 = 0.6;

/// Dots around the image before the pattern repeats.
const MARGIN: usize = 32;

/// Entries of the table of an edge; read linearly, it is within 1e-7.
const ENTRIES: usize = 4096;

impl Dots {
    pub(super) fn new(seed: u64, [width, height]: [u32; 2]) -> Self {
        let mut random = Random::new(seed, 2);
        let count = |length: u32| (f64::from(length) / SIDE).ceil() as usize + 2 * MARGIN;
        let (columns, rows) = (count(width), count(height));
        let cells = (0..columns * rows).map(|_| if random.uniform() < 0.5 { 0.0 } else { 1.0 }).collect();
        // What a neighbour counts at a distance from the edge that it shares.
        let tail = |d: f64| libm::erfc(d / (2f64.sqrt() * SOFTNESS)) / 2.0;
        let edge = (0..ENTRIES + 2).map(|i| tail(SIDE * i as f64 / ENTRIES as f64)).collect();
        Self { cells, columns, rows, edge }
    }

    /// The pattern at a place, px, in [0, 1].
    pub(super) fn at(&self, [x, y]: [f64; 2]) -> f64 {
        // Dots are aligned so that edges fall between pixels.
        let (xs, wx) = self.neighbours((x + 0.5) / SIDE, self.columns);
        let (ys, wy) = self.neighbours((y + 0.5) / SIDE, self.rows);
        let row = |j: usize| (0..3).map(|i| wx[i] * self.cells[ys[j] * self.columns + xs[i]]).sum::<f64>();
        (0..3).map(|j| wy[j] * row(j)).sum()
    }

    /// The three dots around a position, counted in dots, and their weights.
    fn neighbours(&self, position: f64, count: usize) -> ([usize; 3], [f64; 3]) {
        let (whole, part) = split(position);
        let (before, after) = (self.tail(part), self.tail(1.0 - part));
        let (i, count) = (whole + MARGIN as i64, count as i64);
        // Division only where the pattern repeats: it would take longer than all the rest.
        let wrap = |i: i64| if (0..count).contains(&i) { i as usize } else { i.rem_euclid(count) as usize };
        ([wrap(i - 1), wrap(i), wrap(i + 1)], [before, 1.0 - before - after, after])
    }

    /// Reads the table at a distance in [0, 1] dots.
    fn tail(&self, distance: f64) -> f64 {
        let position = distance * ENTRIES as f64;
        let i = position as usize;
        self.edge[i] + (position - i as f64) * (self.edge[i + 1] - self.edge[i])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_edge_is_an_error_function() {
        let mut dots = Dots::new(1, [16, 16]);
        // A vertical edge between the dots at 4 to 8 and at 8 to 12, which lies at x = 7.5.
        for (i, cell) in dots.cells.iter_mut().enumerate() {
            *cell = if i % dots.columns < MARGIN + 2 { 0.0 } else { 1.0 };
        }
        for i in -60..=60 {
            let d = f64::from(i) / 20.0;
            let expected = libm::erfc(-d / (2f64.sqrt() * SOFTNESS)) / 2.0;
            assert!((dots.at([7.5 + d, 5.3]) - expected).abs() < 2e-7);
        }
    }
}
