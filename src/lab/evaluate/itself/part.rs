//! The ray-traced part: disk blur, occlusion, noise and exposure, with its depth.

use std::path::Path;

use nalgebra::{DMatrix, DVector};

use super::scenes::against;
use super::truth::by_itself;
use super::weight::best_weight;
use crate::base::statistics::median;
use crate::base::{Frame, Homography, Kernel, Settings};
use crate::engine::Solution;
use crate::files::export::Registration;
use crate::files::image_io;
use crate::lab::evaluate::bench::Bench;
use crate::lab::evaluate::errors::inside;
use crate::lab::evaluate::section::Case;
use crate::lab::evaluate::sigma::Sigma;

/// Its folder within the data.
pub(super) const FOLDER: &str = "part/57";
/// Left out along the border, px.
const BORDER: usize = 24;
/// Its noise, white = 1.
const NOISE: f64 = 0.002;

/// A row of the sections "Part", "Smoothness" and "Sigma" each.
pub(super) struct Rows {
    pub accuracy: Case,
    /// Left out of a quick run.
    pub smoothness: Option<Case>,
    pub sigma: Case,
}

/// Solves the part, by default settings and by every fixed α; a quick run by default settings alone.
pub(super) fn rows(bench: &mut Bench, data: &Path) -> Rows {
    bench.say("itself: part 57");
    match Part::read(&data.join(FOLDER)).and_then(|part| part.rows(bench)) {
        Ok(rows) => rows,
        Err(e) => {
            let failed = || Case::failed(NAME, e.clone());
            Rows { accuracy: failed(), smoothness: Some(failed()), sigma: failed() }
        }
    }
}

const NAME: &str = "part 57";

struct Part {
    images: [Frame; 2],
    transform: Homography,
    depth: Vec<f32>,
}

impl Part {
    fn read(folder: &Path) -> Result<Self, String> {
        let read = || {
            let (i1, i2) = image_io::read_pair(&folder.join("I1.png"), &folder.join("I2.png"))?;
            let truth = Registration::read(&folder.join("truth.json"))?;
            let transform = truth.second().map_or(Homography::IDENTITY, |frame| frame.transform);
            let (width, height, depth) = image_io::read_field(&folder.join("depth.exr"))?;
            Ok::<_, crate::base::Error>((Self { images: [i1, i2], transform, depth }, [width, height]))
        };
        let (part, size) = read().map_err(|e| e.to_string())?;
        let images = [part.images[0].width(), part.images[0].height()];
        if size == images { Ok(part) } else { Err(format!("depth.exr is {size:?} and the images {images:?} px")) }
    }

    fn solve(&self, bench: &mut Bench, settings: &Settings) -> Result<Solution, String> {
        let [i1, i2] = &self.images;
        bench.solve([i1, i2], settings)
    }

    fn rows(&self, bench: &mut Bench) -> Result<Rows, String> {
        let (settings, quick) = (by_itself(&Kernel::Gaussian), bench.quick);
        let solution = self.solve(bench, &settings)?;
        let depth = Curve::fit(&self.pixels(&solution)).ok_or(FEW)?;
        let corner = solution.transform.corner_distance(self.transform, solution.width, solution.height);
        let accuracy = Case::new(NAME).at_most("corner, px", corner, 0.004);
        let accuracy = accuracy.at_most("depth rms, % of range", depth.rms, 2.5);
        let accuracy = accuracy.at_most("depth MAD, % of range", depth.mad, 0.8);
        let mut rms = |settings: &Settings| {
            let solution = self.solve(bench, settings).ok();
            solution.and_then(|s| Curve::fit(&self.pixels(&s))).map_or(f64::INFINITY, |curve| curve.rms)
        };
        let best = || best_weight(&settings, NOISE, &mut rms);
        let smoothness = (!quick).then(best).map(|best| against(format!("{NAME}: depth rms, %"), depth.rms, best));
        Ok(Rows { accuracy, smoothness, sigma: self.sigma(&solution)?.case(NAME) })
    }

    /// V and depth of the pixels that count.
    fn pixels(&self, solution: &Solution) -> Vec<[f64; 2]> {
        let both = |i: usize| [solution.relative_blur[i], self.depth[i]].map(f64::from);
        let pixels = inside(solution.width, solution.height, BORDER).map(both);
        pixels.filter(|both| both.iter().all(|v| v.is_finite())).collect()
    }

    /// Through V as a cubic of depth.
    fn sigma(&self, solution: &Solution) -> Result<Sigma, String> {
        let turned: Vec<[f64; 2]> = self.pixels(solution).into_iter().map(|[v, z]| [z, v]).collect();
        let curve = Curve::fit(&turned).ok_or(FEW)?;
        let error = |i: usize| f64::from(solution.relative_blur[i]) - curve.at(f64::from(self.depth[i]));
        let pixels = inside(solution.width, solution.height, BORDER);
        Ok(Sigma::of(pixels.map(|i| (error(i), f64::from(solution.uncertainty[i])))))
    }
}

const FEW: &str = "too few pixels are valid to compare depth with V";

/// A cubic through points (x, y), by least squares.
struct Curve {
    /// Of powers of (x - middle)/spread.
    coefficients: [f64; 4],
    middle: f64,
    spread: f64,
    /// What y is off from it, root mean square and median of the absolute, in % of y's range.
    rms: f64,
    mad: f64,
}

impl Curve {
    fn fit(points: &[[f64; 2]]) -> Option<Self> {
        let count = points.len() as f64;
        let middle = points.iter().map(|p| p[0]).sum::<f64>() / count;
        let spread = (points.iter().map(|p| (p[0] - middle).powi(2)).sum::<f64>() / count).sqrt();
        let powers = |x: f64| [0, 1, 2, 3].map(|n| ((x - middle) / spread).powi(n));
        let (mut normal, mut right) = (DMatrix::zeros(4, 4), DVector::zeros(4));
        for [x, y] in points {
            let row = DVector::from_row_slice(&powers(*x));
            right += *y * &row;
            normal += &row * row.transpose();
        }
        let solved = normal.cholesky()?.solve(&right);
        let coefficients = std::array::from_fn(|n| solved[n]);
        let mut curve = Self { coefficients, middle, spread, rms: 0.0, mad: 0.0 };
        let (low, high) = points.iter().fold((f64::MAX, f64::MIN), |(a, b), p| (a.min(p[1]), b.max(p[1])));
        let off: Vec<f64> = points.iter().map(|p| 100.0 * (p[1] - curve.at(p[0])).abs() / (high - low)).collect();
        curve.rms = (off.iter().map(|r| r * r).sum::<f64>() / count).sqrt();
        curve.mad = median(off)?;
        Some(curve)
    }

    fn at(&self, x: f64) -> f64 {
        let x = (x - self.middle) / self.spread;
        self.coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_comes_back_and_what_is_off_it_is_a_share_of_the_range() {
        let cubic = |x: f64| 2.0 - x + 0.5 * x * x - 0.25 * x * x * x;
        let exact: Vec<[f64; 2]> = (0..101).map(|i| f64::from(i) / 50.0 - 1.0).map(|x| [x, cubic(x)]).collect();
        let curve = Curve::fit(&exact).unwrap();
        assert!((curve.at(0.3) - cubic(0.3)).abs() < 1e-12 && curve.rms < 1e-9);
        let one_off = exact.iter().enumerate().map(|(i, [x, y])| [*x, y + if i == 50 { 1.0 } else { 0.0 }]);
        let curve = Curve::fit(&one_off.collect::<Vec<_>>()).unwrap();
        assert!(curve.rms > 2.0 && curve.mad < 1.0, "{} {}", curve.rms, curve.mad);
        assert!(Curve::fit(&[]).is_none());
    }
}
