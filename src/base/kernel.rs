//! Defocus kernels: families h(u; v) with Σh = 1 and the variance per axis v, px².
//!
//! A kernel scales as `h(u; v) = k(u/√v)/v`, so that its mean is proportional to √v and its covariance to v. Both are
//! separated: a *centred* kernel is applied at a position displaced by `mean √v`. The image blurred by the centred
//! kernel has a finite derivative by v at v = 0, half of `C : ∇²`. Only the displacement varies as √v there, and the
//! spline that samples the image has an exact derivative. Sections 2.1 to 2.3 of the paper, section 3 of
//! `docs/method.md`.

use std::f64::consts::PI;

use crate::base::Error;

/// The shape of the defocus blur.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "kebab-case"))]
pub enum Kernel {
    /// Estimated from the photographs, between a Gaussian and slightly beyond a disk.
    #[default]
    Auto,
    /// A Gaussian of variance v.
    Gaussian,
    /// A disk of radius 2√v, which has the variance v along each axis: an ideal lens with a circular aperture.
    Pillbox,
    /// The half `u_x > 0` of a Gaussian of variance v, renormalised: the paper's asymmetric kernel.
    HalfGaussian,
    /// A measured kernel on a grid, scaled so that its mean variance along the axes is v.
    Measured(Aperture),
}

impl Kernel {
    /// The kernels other than [`Measured`](Self::Measured).
    pub const NAMED: [Self; 4] = [Self::Auto, Self::Gaussian, Self::Pillbox, Self::HalfGaussian];

    /// Returns "auto", "gaussian", "pillbox", "half-gaussian", or the name of the aperture.
    pub fn name(&self) -> &str {
        match self {
            Kernel::Auto => "auto",
            Kernel::Gaussian => "gaussian",
            Kernel::Pillbox => "pillbox",
            Kernel::HalfGaussian => "half-gaussian",
            Kernel::Measured(aperture) => aperture.name(),
        }
    }

    /// Returns the mean at v = 1, px. The mean is proportional to √v.
    pub fn mean(&self) -> [f64; 2] {
        match self {
            Kernel::Auto | Kernel::Gaussian | Kernel::Pillbox => [0.0, 0.0],
            Kernel::HalfGaussian => [(2.0 / PI).sqrt(), 0.0],
            Kernel::Measured(aperture) => aperture.mean(),
        }
    }

    /// Returns the second central moments xx, xy, yy at v = 1, px². They are proportional to v.
    pub fn covariance(&self) -> [f64; 3] {
        match self {
            Kernel::Auto | Kernel::Gaussian | Kernel::Pillbox => [1.0, 0.0, 1.0],
            Kernel::HalfGaussian => [1.0 - 2.0 / PI, 0.0, 1.0],
            Kernel::Measured(aperture) => aperture.covariance(),
        }
    }

    /// Returns the radius of the centred kernel at v = 1, px.
    pub(crate) fn reach(&self) -> f64 {
        match self {
            // 7e-6 of the mass of a Gaussian lies outside.
            Kernel::Auto | Kernel::Gaussian | Kernel::HalfGaussian => 4.5,
            Kernel::Pillbox => 2.0,
            Kernel::Measured(aperture) => aperture.reach(),
        }
    }

    /// Returns the transfer function `Σ h(u + mean) exp(-i w u)` of the centred kernel of variance v at all pairs of
    /// the frequencies, rad per pixel, row-major with rows along x.
    pub(crate) fn transfer(&self, frequencies: &[f64], v: f64) -> Vec<Complex> {
        let scaled: Vec<f64> = frequencies.iter().map(|w| w * v.sqrt()).collect();
        match self {
            Kernel::Measured(aperture) => aperture.transfer(&scaled),
            // The estimated kernel is a combination of Gaussians.
            Kernel::Auto | Kernel::Gaussian => product(&scaled, |x| [(-x * x / 2.0).exp(), 0.0]),
            Kernel::HalfGaussian => product(&scaled, half_gaussian),
            Kernel::Pillbox => {
                let at = |w: f64| if w > 0.0 { libm::j1(2.0 * w) / w } else { 1.0 };
                scaled.iter().flat_map(|y| scaled.iter().map(|x| [at(x.hypot(*y)), 0.0])).collect()
            }
        }
    }
}

/// Returns the products of a function of w_x and a Gaussian of w_y.
fn product(scaled: &[f64], along_x: impl Fn(f64) -> Complex) -> Vec<Complex> {
    let row: Vec<Complex> = scaled.iter().map(|&x| along_x(x)).collect();
    let along_y = scaled.iter().map(|y| (-y * y / 2.0).exp());
    along_y.flat_map(|g| row.iter().map(move |h| h.map(|part| part * g))).collect()
}

/// Returns the transfer function of √(2/π) exp(-u²/2) on u > 0 about its mean:
/// `(exp(-w²/2) - 2i/√π D(w/√2)) exp(i w √(2/π))` with Dawson's function D.
fn half_gaussian(w: f64) -> Complex {
    let (re, im) = ((-w * w / 2.0).exp(), -2.0 / PI.sqrt() * dawson(w / 2f64.sqrt()));
    let (sin, cos) = (w * (2.0 / PI).sqrt()).sin_cos();
    [re * cos - im * sin, re * sin + im * cos]
}

/// Dawson's function `exp(-x²) ∫ exp(t²) dt`, by Rybicki's method with a step of 0.2, exact to 1e-15 (Numerical
/// Recipes, 6.10).
fn dawson(x: f64) -> f64 {
    let step = 0.2;
    let nearest = (x / step / 2.0).round() as i64;
    let terms = (nearest - 16..=nearest + 16).map(|n| {
        let odd = (2 * n + 1) as f64;
        (-(x - odd * step).powi(2)).exp() / odd
    });
    terms.sum::<f64>() / PI.sqrt()
}

/// A complex number: real and imaginary part.
pub(crate) type Complex = [f64; 2];

/// The largest number of cells along a side; larger images are averaged. Blur with σ = 12 px is about 50 px wide, so
/// that more cells have no effect.
const MAX_CELLS: usize = 48;

/// The largest extent of a kernel from u = 0 at scale 1, px. A Gaussian is cut off at 4.5. Values beyond the limit are
/// stray light, which would only widen all filters.
const MAX_EXTENT: f64 = 6.0;

/// A measured kernel: densities on a grid of square cells, such as an image of a coded aperture.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "KernelGrid", into = "KernelGrid")
)]
pub struct Aperture {
    grid: KernelGrid,
    /// The side of a cell at scale 1, px.
    cell: f64,
    /// The mean relative to the centre of the grid at scale 1, px.
    mean: [f64; 2],
    /// The second central moments xx, xy, yy at scale 1, px².
    covariance: [f64; 3],
}

/// The serialized form of an aperture, as in reports.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct KernelGrid {
    name: String,
    width: usize,
    height: usize,
    /// The centre of the grid relative to u = 0, cells.
    #[cfg_attr(feature = "serde", serde(default))]
    offset: [f64; 2],
    /// Row-major weights, which sum to one.
    weights: Vec<f64>,
}

impl Aperture {
    /// Makes a kernel from `width` x `height` row-major densities, y down, with u = 0 at the centre. The densities are
    /// normalised to a sum of one. Black margins are removed. More than 48 cells per side are averaged to fewer.
    ///
    /// # Errors
    /// [`Error::Kernel`] if the length is not `width * height`, a value is negative or not finite, all values are zero,
    /// or a value lies farther from the centre than 6 standard deviations.
    pub fn new(name: &str, width: usize, height: usize, densities: &[f64]) -> Result<Self, Error> {
        Self::with_offset(name, width, height, [0.0, 0.0], densities)
    }

    /// Makes a kernel whose centre is displaced from u = 0, in cells.
    fn with_offset(
        name: &str,
        width: usize,
        height: usize,
        [right, down]: [f64; 2],
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
            return Err(bad("all its values are 0"));
        }
        let Cells { width, height, offset: [x, y], densities, block } =
            reduce(without_margins(width, height, densities));
        let offset = [(right + x) / block, (down + y) / block];
        let sum: f64 = densities.iter().sum();
        let weights: Vec<f64> = densities.iter().map(|d| d / sum).collect();
        let grid = KernelGrid { name: name.to_string(), width, height, offset, weights };
        let moment = |f: &dyn Fn(f64, f64) -> f64| grid.cells().map(|(x, y, w)| w * f(x, y)).sum::<f64>();
        let [mx, my] = [moment(&|x, _| x), moment(&|_, y| y)];
        // The variance of a cell of constant density is 1/12.
        let xx = moment(&|x, _| (x - mx).powi(2)) + 1.0 / 12.0;
        let yy = moment(&|_, y| (y - my).powi(2)) + 1.0 / 12.0;
        let xy = moment(&|x, y| (x - mx) * (y - my));
        let cell = ((xx + yy) / 2.0).sqrt().recip();
        let (mean, covariance) = ([mx * cell, my * cell], [xx, xy, yy].map(|c| c * cell * cell));
        let aperture = Self { grid, cell, mean, covariance };
        if aperture.reach() + mean[0].hypot(mean[1]) > MAX_EXTENT {
            return Err(bad("it has light far from its middle: crop the image, and subtract the background"));
        }
        Ok(aperture)
    }

    /// Returns the name for messages and reports.
    pub fn name(&self) -> &str {
        &self.grid.name
    }

    pub(crate) fn mean(&self) -> [f64; 2] {
        self.mean
    }

    pub(crate) fn covariance(&self) -> [f64; 3] {
        self.covariance
    }

    /// Returns the distance from the mean to the farthest side of the grid at scale 1, px.
    pub(crate) fn reach(&self) -> f64 {
        let KernelGrid { width, height, offset, .. } = self.grid;
        let side =
            |cells: usize, n: usize| cells as f64 * self.cell / 2.0 + (self.mean[n] - offset[n] * self.cell).abs();
        side(width, 0).max(side(height, 1))
    }

    /// Returns the transfer function about the mean at all pairs of frequencies, rad per pixel at scale 1, row-major
    /// with rows along x.
    pub(crate) fn transfer(&self, frequencies: &[f64]) -> Vec<Complex> {
        let KernelGrid { width, height, weights, offset, .. } = &self.grid;
        // exp(-i w u) for the cells along an axis, times the transfer function of one cell.
        let waves = |w: f64, cells: usize, n: usize| -> Vec<Complex> {
            let mean = self.mean[n] - offset[n] * self.cell;
            let half = w * self.cell / 2.0;
            let box_filter = if half.abs() < 1e-9 { 1.0 } else { half.sin() / half };
            (0..cells)
                .map(|n| -w * (cell_centre(n, cells) * self.cell - mean))
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

impl KernelGrid {
    /// Returns the position of each cell relative to u = 0, in cells, and its weight.
    fn cells(&self) -> impl Iterator<Item = (f64, f64, f64)> {
        let Self { width, height, offset: [x, y], .. } = *self;
        let position = move |n: usize| (x + cell_centre(n % width, width), y + cell_centre(n / width, height));
        self.weights.iter().enumerate().map(move |(n, &w)| (position(n).0, position(n).1, w))
    }
}

impl TryFrom<KernelGrid> for Aperture {
    type Error = Error;

    fn try_from(s: KernelGrid) -> Result<Self, Error> {
        Self::with_offset(&s.name, s.width, s.height, s.offset, &s.weights)
    }
}

impl From<Aperture> for KernelGrid {
    fn from(aperture: Aperture) -> Self {
        aperture.grid
    }
}

/// Returns the centre of cell `n` relative to the centre of `cells` cells.
fn cell_centre(n: usize, cells: usize) -> f64 {
    n as f64 - (cells as f64 - 1.0) / 2.0
}

/// A grid of densities. `offset` is its centre relative to that of the image, and `block` the side of a cell, both in
/// cells of the image.
struct Cells {
    width: usize,
    height: usize,
    offset: [f64; 2],
    densities: Vec<f64>,
    block: f64,
}

/// Removes black margins.
fn without_margins(width: usize, height: usize, densities: &[f64]) -> Cells {
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

/// Sums square blocks so that no side has more than [`MAX_CELLS`]. Missing cells at the edges are black.
fn reduce(grid: Cells) -> Cells {
    let Cells { width, height, offset, densities, .. } = grid;
    let block = width.max(height).div_ceil(MAX_CELLS);
    let [w, h] = [width, height].map(|side| side.div_ceil(block));
    let [left, top] = [(w * block - width) / 2, (h * block - height) / 2];
    // Uneven padding displaces the centre.
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
    fn dawsons_function_agrees_with_tables() {
        // Abramowitz and Stegun, table 7.5.
        for (x, d) in [(0.0, 0.0), (0.5, 0.424_436_383_5), (1.0, 0.538_079_506_9), (2.0, 0.301_340_388_9)] {
            assert!((dawson(x) - d).abs() < 1e-9 && (dawson(-x) + d).abs() < 1e-9, "{x}: {}", dawson(x));
        }
        assert!((dawson(40.0) * 80.0 - 1.0).abs() < 1e-3);
    }

    #[test]
    fn the_transfer_function_of_the_half_gaussian_is_its_integral() {
        let n = 200_000;
        for w in [0.3, 1.0, 3.0, 8.0] {
            let mut sum = [0.0, 0.0];
            for k in 0..n {
                let u = (f64::from(k) + 0.5) * 8.0 / f64::from(n);
                let density = (2.0 / PI).sqrt() * (-u * u / 2.0).exp() * 8.0 / f64::from(n);
                let phase = -w * (u - (2.0 / PI).sqrt());
                sum = [sum[0] + density * phase.cos(), sum[1] + density * phase.sin()];
            }
            let transfer = half_gaussian(w);
            assert!(
                (transfer[0] - sum[0]).abs() < 1e-6 && (transfer[1] - sum[1]).abs() < 1e-6,
                "{w}: {transfer:?} {sum:?}"
            );
        }
    }

    #[test]
    fn the_curvature_of_a_transfer_function_is_the_covariance() {
        let aperture = Aperture::new("code", 3, 2, &[1.0, 0.0, 2.0, 0.0, 1.0, 1.0]).unwrap();
        for kernel in [Kernel::Gaussian, Kernel::Pillbox, Kernel::HalfGaussian, Kernel::Measured(aperture)] {
            let (w, v) = (1e-3, 2.5);
            let h = kernel.transfer(&[0.0, w], v);
            let [xx, xy, yy] = kernel.covariance();
            for (at, c) in [(1, xx), (2, yy), (3, xx + 2.0 * xy + yy)] {
                let curvature = 2.0 * (1.0 - h[at][0]) / (w * w);
                assert!((curvature - c * v).abs() < 1e-4, "{}: {curvature} {}", kernel.name(), c * v);
                assert!(h[at][1].abs() < 1e-8, "{} is not centred", kernel.name());
            }
        }
    }

    #[test]
    fn moments_are_scaled_to_variance_one() {
        let aperture = Aperture::new("square", 7, 7, &[1.0; 49]).unwrap();
        assert!(aperture.mean.iter().all(|m| m.abs() < 1e-12));
        assert!((aperture.covariance[0] - 1.0).abs() < 1e-12 && aperture.covariance[1].abs() < 1e-12);
        // A square of side a has the variance a²/12.
        assert!((7.0 * aperture.cell - 12f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn large_images_are_averaged_without_their_margins() {
        let picture = |width: usize, lit: std::ops::Range<usize>| -> Vec<f64> {
            (0..width * 100).map(|n| f64::from(lit.contains(&(n % width)))).collect()
        };
        let aperture = Aperture::new("left half", 200, 100, &picture(200, 0..100)).unwrap();
        assert_eq!((aperture.grid.width, aperture.grid.height), (34, 34));
        // A square beside u = 0: its mean is half its side away, √3 standard deviations.
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
    fn invalid_densities_are_refused() {
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
