//! A kernel given by its values on a grid, such as the picture of a coded aperture.

use crate::base::Error;

/// A value of a transfer function: real and imaginary part.
pub(crate) type Complex = [f64; 2];

/// The most cells along a side; a larger picture is averaged down to it. Blur of σ 12 px is some 50 px wide, so no more
/// cells would show.
const MOST_CELLS: usize = 48;

/// The farthest that a kernel may reach from u = 0 at scale 1, px: a Gaussian is cut off at 4.5. Beyond it stands stray
/// light that widens every filter and nothing else.
const FARTHEST: f64 = 6.0;

/// A kernel on a grid of square cells, each of constant density.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "Stored", into = "Stored")
)]
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
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Stored {
    name: String,
    width: usize,
    height: usize,
    /// The middle of the grid from u = 0, cells.
    #[cfg_attr(feature = "serde", serde(default))]
    offset: [f64; 2],
    /// Row by row; they sum to one.
    weights: Vec<f64>,
}

impl Aperture {
    /// From a picture of `width` x `height` densities, row by row, y down; u = 0 is its middle. Their unit does not
    /// matter: they are made to sum to one. Black margins are cut off, and what is left, if more than 48 cells a side,
    /// is averaged down.
    ///
    /// # Errors
    /// [`Error::Kernel`] where it is not a kernel: of the wrong length, negative, not finite, black, or with light
    /// further from its middle than 6 times its deviation.
    pub fn new(name: &str, width: usize, height: usize, densities: &[f64]) -> Result<Self, Error> {
        Self::about(name, width, height, [0.0, 0.0], densities)
    }

    /// The same with the middle of the picture off u = 0, in its cells.
    fn about(
        name: &str,
        width: usize,
        height: usize,
        [left, down]: [f64; 2],
        densities: &[f64],
    ) -> Result<Self, Error> {
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
        let Cells { width, height, offset: [x, y], densities, block } = reduce(lit(width, height, densities));
        let offset = [(left + x) / block, (down + y) / block];
        let sum: f64 = densities.iter().sum();
        let weights: Vec<f64> = densities.iter().map(|d| d / sum).collect();
        let stored = Stored { name: name.to_string(), width, height, offset, weights };
        let moment = |f: &dyn Fn(f64, f64) -> f64| stored.cells().map(|(x, y, w)| w * f(x, y)).sum::<f64>();
        let [mx, my] = [moment(&|x, _| x), moment(&|_, y| y)];
        // A cell of constant density has a variance of its own, a twelfth.
        let xx = moment(&|x, _| (x - mx).powi(2)) + 1.0 / 12.0;
        let yy = moment(&|_, y| (y - my).powi(2)) + 1.0 / 12.0;
        let xy = moment(&|x, y| (x - mx) * (y - my));
        let cell = ((xx + yy) / 2.0).sqrt().recip();
        let (mean, covariance) = ([mx * cell, my * cell], [xx, xy, yy].map(|c| c * cell * cell));
        let aperture = Self { stored, cell, mean, covariance };
        if aperture.reach() + mean[0].hypot(mean[1]) > FARTHEST {
            return Err(bad("it has light far from its middle: cut it out, and subtract what is not the kernel"));
        }
        Ok(aperture)
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
        let Stored { width, height, offset, .. } = self.stored;
        let side =
            |cells: usize, n: usize| cells as f64 * self.cell / 2.0 + (self.mean[n] - offset[n] * self.cell).abs();
        side(width, 0).max(side(height, 1))
    }

    /// About the mean, at all pairs of frequencies, rad a pixel at scale 1; rows along y.
    pub(crate) fn transfer(&self, frequencies: &[f64]) -> Vec<Complex> {
        let Stored { width, height, weights, offset, .. } = &self.stored;
        // exp(-i w u) for the cells along an axis, times the transfer function of a cell.
        let waves = |w: f64, cells: usize, n: usize| -> Vec<Complex> {
            let mean = self.mean[n] - offset[n] * self.cell;
            let half = w * self.cell / 2.0;
            let box_filter = if half.abs() < 1e-9 { 1.0 } else { half.sin() / half };
            (0..cells)
                .map(|n| -w * (middle(n, cells) * self.cell - mean))
                .map(|phase| [box_filter * phase.cos(), box_filter * phase.sin()])
                .collect()
        };
        let columns: Vec<_> = frequencies.iter().map(|&w| waves(w, *width, 0)).collect();
        let mut out = Vec::with_capacity(frequencies.len().pow(2));
        for &wy in frequencies {
            let rows = waves(wy, *height, 1);
            let along_x: Vec<Complex> = (0..*width)
                .map(|x| sum((0..*height).map(|y| rows[y].map(|part| part * weights[y * width + x]))))
                .collect();
            out.extend(columns.iter().map(|column| sum(column.iter().zip(&along_x).map(|(a, b)| times(*a, *b)))));
        }
        out
    }
}

impl Stored {
    /// Place of each cell from u = 0, in cells, and its weight.
    fn cells(&self) -> impl Iterator<Item = (f64, f64, f64)> {
        let Self { width, height, offset: [x, y], .. } = *self;
        let place = move |n: usize| (x + middle(n % width, width), y + middle(n / width, height));
        self.weights.iter().enumerate().map(move |(n, &w)| (place(n).0, place(n).1, w))
    }
}

impl TryFrom<Stored> for Aperture {
    type Error = Error;

    fn try_from(s: Stored) -> Result<Self, Error> {
        Self::about(&s.name, s.width, s.height, s.offset, &s.weights)
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

/// Densities on a grid, its middle from that of the picture in the picture's cells, and the cells of the picture along a
/// side of one of its own.
struct Cells {
    width: usize,
    height: usize,
    offset: [f64; 2],
    densities: Vec<f64>,
    block: f64,
}

/// Without black margins.
fn lit(width: usize, height: usize, densities: &[f64]) -> Cells {
    let column = |x: usize| (0..height).any(|y| densities[y * width + x] > 0.0);
    let row = |y: usize| densities[y * width..][..width].iter().any(|d| *d > 0.0);
    let span = |lit: &dyn Fn(usize) -> bool, count: usize| {
        let first = (0..count).find(|&n| lit(n)).unwrap_or(0);
        let last = (0..count).rfind(|&n| lit(n)).unwrap_or(count - 1);
        (first, last + 1, (first + last) as f64 / 2.0 - (count as f64 - 1.0) / 2.0)
    };
    let ((left, right, x), (top, bottom, y)) = (span(&column, width), span(&row, height));
    let densities = (top..bottom).flat_map(|y| densities[y * width..][left..right].iter().copied()).collect();
    Cells { width: right - left, height: bottom - top, offset: [x, y], densities, block: 1.0 }
}

/// Averages over whole blocks until no side has more than [`MOST_CELLS`]; what is missing at the edges is black.
fn reduce(grid: Cells) -> Cells {
    let Cells { width, height, offset, densities, .. } = grid;
    let block = width.max(height).div_ceil(MOST_CELLS);
    let [w, h] = [width, height].map(|side| side.div_ceil(block));
    let [left, top] = [(w * block - width) / 2, (h * block - height) / 2];
    // Padding that is not even on both sides moves the middle.
    let [x, y] = [(w * block - width - 2 * left) as f64 / 2.0, (h * block - height - 2 * top) as f64 / 2.0];
    let mut reduced = vec![0.0; w * h];
    for (n, d) in densities.iter().enumerate() {
        reduced[(n / width + top) / block * w + (n % width + left) / block] += d;
    }
    Cells { width: w, height: h, offset: [offset[0] + x, offset[1] + y], densities: reduced, block: block as f64 }
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
    fn large_pictures_are_averaged_and_margins_cut_off() {
        let picture = |width: usize, lit: std::ops::Range<usize>| -> Vec<f64> {
            (0..width * 100).map(|n| f64::from(lit.contains(&(n % width)))).collect()
        };
        let aperture = Aperture::new("left half", 200, 100, &picture(200, 0..100)).unwrap();
        assert_eq!((aperture.stored.width, aperture.stored.height), (34, 34));
        // A square beside u = 0: its mean is half its side away, √3 deviations.
        assert!((aperture.mean[0] + 3f64.sqrt()).abs() < 0.02 && aperture.mean[1].abs() < 0.02, "{:?}", aperture.mean);
        let within = Aperture::new("the same in a wider picture", 400, 100, &picture(400, 100..200)).unwrap();
        assert!((within.mean[0] - aperture.mean[0]).abs() < 1e-12 && within.cell == aperture.cell);
        let again: Aperture = serde_json::from_str(&serde_json::to_string(&aperture).unwrap()).unwrap();
        assert!((again.mean[0] - aperture.mean[0]).abs() < 1e-9 && (again.cell - aperture.cell).abs() < 1e-9);
    }

    #[test]
    fn stray_light_is_refused() {
        let mut picture = vec![0.0; 41 * 41];
        (picture[20 * 41 + 20], picture[0]) = (1.0, 1e-3);
        assert!(Aperture::new("stray", 41, 41, &picture).unwrap_err().to_string().contains("far from its middle"));
        picture[0] = 0.0;
        assert!(Aperture::new("one cell", 41, 41, &picture).unwrap().reach() < 2.0);
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
