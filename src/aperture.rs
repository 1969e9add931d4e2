//! A kernel given by its values on a grid, such as the picture of a coded aperture.

use serde::{Deserialize, Serialize};

use crate::Error;
use crate::kernel::Complex;

/// The most cells along a side; a larger picture is averaged down to it. Blur of σ 12 px is some 50 px wide, so no more
/// cells would show.
const MOST_CELLS: usize = 48;

/// A kernel on a grid of square cells, each of constant density.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Stored", into = "Stored")]
pub struct Aperture {
    stored: Stored,
    /// Side of a cell at scale 1, px.
    cell: f64,
    /// Mean about the middle of the grid at scale 1, px.
    mean: [f64; 2],
    /// Second central moments at scale 1, px²: xx, xy, yy.
    covariance: [f64; 3],
}

/// What is written to reports.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Stored {
    name: String,
    width: usize,
    height: usize,
    /// Row by row; they sum to one.
    weights: Vec<f64>,
}

impl Aperture {
    /// From a picture of `width` x `height` densities, row by row, y down; u = 0 is its middle. Their unit does not
    /// matter: they are made to sum to one. A picture of more than 48 cells a side is averaged down.
    ///
    /// # Errors
    /// [`Error::Kernel`] where it is not a kernel: of the wrong length, negative, not finite, or all in one cell's width.
    pub fn new(name: &str, width: usize, height: usize, densities: &[f64]) -> Result<Self, Error> {
        let bad = |problem: &str| Error::Kernel { name: name.to_string(), problem: problem.to_string() };
        if width == 0 || height == 0 || width.checked_mul(height) != Some(densities.len()) {
            return Err(bad("its size is not that of its values"));
        }
        if densities.iter().any(|d| !d.is_finite() || *d < 0.0) {
            return Err(bad("a kernel has finite values that are not negative"));
        }
        let sum: f64 = densities.iter().sum();
        if !(sum > 0.0 && sum.is_finite()) {
            return Err(bad("it is black all over: light must pass somewhere"));
        }
        let (width, height, densities) = reduce(width, height, densities);
        let sum: f64 = densities.iter().sum();
        let weights: Vec<f64> = densities.iter().map(|d| d / sum).collect();
        let stored = Stored { name: name.to_string(), width, height, weights };
        let moment = |f: &dyn Fn(f64, f64) -> f64| stored.cells().map(|(x, y, w)| w * f(x, y)).sum::<f64>();
        let [mx, my] = [moment(&|x, _| x), moment(&|_, y| y)];
        // A cell of constant density has a variance of its own, a twelfth.
        let xx = moment(&|x, _| (x - mx).powi(2)) + 1.0 / 12.0;
        let yy = moment(&|_, y| (y - my).powi(2)) + 1.0 / 12.0;
        let xy = moment(&|x, y| (x - mx) * (y - my));
        let cell = ((xx + yy) / 2.0).sqrt().recip();
        let (mean, covariance) = ([mx * cell, my * cell], [xx, xy, yy].map(|c| c * cell * cell));
        Ok(Self { stored, cell, mean, covariance })
    }

    /// Its name, as in messages and reports.
    pub fn name(&self) -> &str {
        &self.stored.name
    }

    pub(crate) fn mean(&self) -> [f64; 2] {
        self.mean
    }

    pub(crate) fn covariance(&self) -> [f64; 3] {
        self.covariance
    }

    /// From the mean to the farthest side of the grid at scale 1, px.
    pub(crate) fn reach(&self) -> f64 {
        let side = |cells: usize, mean: f64| cells as f64 * self.cell / 2.0 + mean.abs();
        side(self.stored.width, self.mean[0]).max(side(self.stored.height, self.mean[1]))
    }

    /// About the mean, at all pairs of frequencies, rad a pixel at scale 1; rows along y.
    pub(crate) fn transfer(&self, frequencies: &[f64]) -> Vec<Complex> {
        let Stored { width, height, weights, .. } = &self.stored;
        // exp(-i w u) for the cells along an axis, times the transfer function of a cell.
        let waves = |w: f64, cells: usize, mean: f64| -> Vec<Complex> {
            let half = w * self.cell / 2.0;
            let box_filter = if half.abs() < 1e-9 { 1.0 } else { half.sin() / half };
            (0..cells)
                .map(|n| -w * (middle(n, cells) * self.cell - mean))
                .map(|phase| [box_filter * phase.cos(), box_filter * phase.sin()])
                .collect()
        };
        let columns: Vec<_> = frequencies.iter().map(|&w| waves(w, *width, self.mean[0])).collect();
        let mut out = Vec::with_capacity(frequencies.len().pow(2));
        for &wy in frequencies {
            let rows = waves(wy, *height, self.mean[1]);
            let along_x: Vec<Complex> = (0..*width)
                .map(|x| sum((0..*height).map(|y| rows[y].map(|part| part * weights[y * width + x]))))
                .collect();
            out.extend(columns.iter().map(|column| sum(column.iter().zip(&along_x).map(|(a, b)| times(*a, *b)))));
        }
        out
    }
}

impl Stored {
    /// Place of each cell from the middle of the grid, in cells, and its weight.
    fn cells(&self) -> impl Iterator<Item = (f64, f64, f64)> {
        let Self { width, height, .. } = *self;
        let place = move |n: usize| (middle(n % width, width), middle(n / width, height));
        self.weights.iter().enumerate().map(move |(n, &w)| (place(n).0, place(n).1, w))
    }
}

impl TryFrom<Stored> for Aperture {
    type Error = Error;

    fn try_from(s: Stored) -> Result<Self, Error> {
        Self::new(&s.name, s.width, s.height, &s.weights)
    }
}

impl From<Aperture> for Stored {
    fn from(aperture: Aperture) -> Self {
        aperture.stored
    }
}

/// The middle of cell n of so many, from the middle of all.
fn middle(n: usize, cells: usize) -> f64 {
    n as f64 - (cells as f64 - 1.0) / 2.0
}

/// Averages over whole blocks until no side has more than [`MOST_CELLS`]; what is missing at the edges is black.
fn reduce(width: usize, height: usize, densities: &[f64]) -> (usize, usize, Vec<f64>) {
    let block = width.max(height).div_ceil(MOST_CELLS);
    // Padded evenly, so that the middle stays the middle up to half a cell of the picture.
    let [w, h] = [width, height].map(|side| side.div_ceil(block));
    let [left, top] = [(w * block - width) / 2, (h * block - height) / 2];
    let mut reduced = vec![0.0; w * h];
    for (n, d) in densities.iter().enumerate() {
        reduced[(n / width + top) / block * w + (n % width + left) / block] += d;
    }
    (w, h, reduced)
}

fn sum(terms: impl Iterator<Item = Complex>) -> Complex {
    terms.fold([0.0, 0.0], |[a, b], [c, d]| [a + c, b + d])
}

fn times([a, b]: Complex, [c, d]: Complex) -> Complex {
    [a * c - b * d, a * d + b * c]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_scaled_to_one() {
        let aperture = Aperture::new("square", 7, 7, &[1.0; 49]).unwrap();
        assert!(aperture.mean.iter().all(|m| m.abs() < 1e-12));
        assert!((aperture.covariance[0] - 1.0).abs() < 1e-12 && aperture.covariance[1].abs() < 1e-12);
        // A square of side a has variance a²/12.
        assert!((7.0 * aperture.cell - 12f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn large_pictures_are_averaged() {
        let picture: Vec<f64> = (0..200 * 100).map(|n| f64::from(n % 200 < 100)).collect();
        let aperture = Aperture::new("half", 200, 100, &picture).unwrap();
        assert_eq!((aperture.stored.width, aperture.stored.height), (40, 20));
        assert!(aperture.mean[0] < -0.5);
    }

    #[test]
    fn what_is_no_kernel_is_refused() {
        for (width, height, values) in [
            (0, 0, vec![]),
            (2, 2, vec![1.0; 3]),
            (2, 1, vec![1.0, -0.1]),
            (2, 1, vec![1.0, f64::NAN]),
            (2, 1, vec![0.0; 2]),
        ] {
            assert!(matches!(Aperture::new("k", width, height, &values), Err(Error::Kernel { .. })));
        }
    }
}
