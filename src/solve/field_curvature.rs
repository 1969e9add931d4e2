//! The field curvature of a lens, fitted to V of a flat target (the flat reference).

use nalgebra::{DMatrix, DVector};

use crate::base::statistics::{deviation, tukey};
use crate::base::{Error, centre};
use crate::engine::Solution;
use crate::engine::stages::uncertainty::LARGEST;

/// Least number of samples of the reference with a measured V.
const LEAST_PIXELS: usize = 200;
/// The approximate number of pixels of the reference that are sampled: a smooth field needs no more.
const SAMPLES: usize = 1 << 16;
/// Least standard deviation of V in the weights, px²: V is not more exact than this by its model.
const LEAST_DEVIATION: f32 = 0.1;

/// The field curvature of a lens and the tilt of the target: V of a flat target minus its value at the image centre.
///
/// It is a polynomial of fourth degree in the position, fitted to V with weights from the standard deviation. So
/// texture and holes of the target have no effect.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldCurvature {
    size: [u32; 2],
    field: SmoothField,
}

impl FieldCurvature {
    /// Fits V of a flat target that fills the image. The weights are from its standard deviation without that of V's
    /// scale. Both are in px².
    ///
    /// # Errors
    /// [`Error::Region`]: V is measured in too few pixels.
    pub fn of_flat_target(size: [u32; 2], relative_blur: &[f32], uncertainty: &[f32]) -> Result<Self, Error> {
        let width = size[0] as usize;
        let stride = (relative_blur.len() / SAMPLES).max(1);
        let measured: Vec<Measured> = (0..relative_blur.len())
            .step_by(stride)
            .filter(|&i| relative_blur[i].is_finite() && uncertainty[i] < LARGEST)
            .map(|i| Measured {
                place: [(i % width) as f64, (i / width) as f64],
                value: relative_blur[i].into(),
                weight: f64::from(uncertainty[i].max(LEAST_DEVIATION)).powi(-2),
            })
            .collect();
        let enough = measured.len() >= LEAST_PIXELS && covers(size, &measured);
        let field = if enough { SmoothField::fit(size, &measured) } else { None };
        match field {
            Some(field) => Ok(Self { size, field }),
            None => Err(Error::Region(format!(
                "the flat reference has V in {} of {} sampled pixels, too few or not all over the frame: photograph a textured flat target that fills it",
                measured.len(),
                relative_blur.len().div_ceil(stride)
            ))),
        }
    }

    /// Width and height of the photographs, px.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// V of the target at a pixel minus V at the image centre, px².
    pub fn at(&self, place: [f64; 2]) -> f64 {
        self.field.above_centre(place)
    }

    /// Subtracts the field from V of a solution for photographs of its size, with |V| limited to `limit` px². A pixel
    /// at the limit stays there, and no other pixel reaches it, because the limit marks V as a bound only.
    pub fn flatten(&self, solution: &mut Solution, limit: f64) {
        let (reached, below) = (0.999 * limit as f32, 0.998 * limit as f32);
        self.change(solution, |v, curvature| if v.abs() >= reached { v } else { (v - curvature).clamp(-below, below) });
    }

    /// Adds the field to a flattened solution. This restores V, except for pixels near the limit of |V|.
    pub fn restored(&self, solution: &Solution) -> Solution {
        let mut restored = solution.clone();
        self.change(&mut restored, |v, curvature| v + curvature);
        restored
    }

    fn change(&self, solution: &mut Solution, change: impl Fn(f32, f32) -> f32) {
        let (width, [left, top]) = (solution.width as usize, solution.origin.map(f64::from));
        let own = solution.uncertainty_without_scale();
        for (i, v) in solution.relative_blur.iter_mut().enumerate() {
            let place = [left + (i % width) as f64, top + (i / width) as f64];
            *v = if v.is_nan() { *v } else { change(*v, self.at(place) as f32) };
        }
        // An error of the scale is a share of the V that is left.
        solution.uncertainty = own;
        solution.add_scale(solution.scale_deviation);
    }
}

/// Largest sum of the exponents of x and y.
const DEGREE: usize = 4;
/// Number of coefficients.
const TERMS: usize = (DEGREE + 1) * (DEGREE + 2) / 2;
/// Rounds of reweighting: after the first few the weights hardly change.
const ROUNDS: usize = 8;

/// A polynomial of fourth degree in the position, which is relative to the image centre, in half diagonals.
#[derive(Clone, Debug, PartialEq)]
struct SmoothField {
    centre: [f64; 2],
    length: f64,
    coefficients: [f64; TERMS],
}

/// A measured value at a position, px, and its weight.
#[derive(Clone, Copy, Debug)]
struct Measured {
    place: [f64; 2],
    value: f64,
    weight: f64,
}

/// Returns whether each ninth of an image has a measured value. Elsewhere the polynomial would extrapolate, which is
/// inaccurate.
fn covers([width, height]: [u32; 2], measured: &[Measured]) -> bool {
    let mut ninths = [false; 9];
    for k in measured.iter().filter(|k| k.weight > 0.0) {
        let third = |at: f64, side: u32| ((3.0 * at / f64::from(side.max(1))) as usize).min(2);
        ninths[3 * third(k.place[1], height) + third(k.place[0], width)] = true;
    }
    ninths.iter().all(|measured| *measured)
}

impl SmoothField {
    /// Fits values over an image of `width` x `height` pixels by least squares, reweighted by Tukey's function against
    /// outliers. `None` if the positions do not determine the polynomial.
    fn fit([width, height]: [u32; 2], measured: &[Measured]) -> Option<Self> {
        let centre = centre(width, height);
        let length = (f64::from(width).hypot(height.into()) / 2.0).max(1.0);
        let mut field = Self { centre, length, coefficients: [0.0; TERMS] };
        let terms: Vec<[f64; TERMS]> = measured.iter().map(|k| field.terms(k.place)).collect();
        let mut robust = vec![1.0; measured.len()];
        for _ in 0..ROUNDS {
            field.coefficients = least_squares(&terms, measured, &robust)?;
            let residuals: Vec<f64> = measured.iter().map(|k| k.value - field.at(k.place)).collect();
            let deviation = deviation(&residuals).max(1e-12);
            robust = residuals.into_iter().map(|r| tukey(r / deviation)).collect();
        }
        Some(field)
    }

    /// The value at a position, px.
    fn at(&self, place: [f64; 2]) -> f64 {
        self.terms(place).iter().zip(&self.coefficients).map(|(term, c)| term * c).sum()
    }

    /// The value at a position minus that at the image centre.
    fn above_centre(&self, place: [f64; 2]) -> f64 {
        self.at(place) - self.coefficients[0]
    }

    fn terms(&self, [x, y]: [f64; 2]) -> [f64; TERMS] {
        let (x, y) = ((x - self.centre[0]) / self.length, (y - self.centre[1]) / self.length);
        let mut terms = [0.0; TERMS];
        let powers = (0..=DEGREE).flat_map(|degree| (0..=degree).map(move |j| (degree - j, j)));
        for (term, (i, j)) in terms.iter_mut().zip(powers) {
            *term = x.powi(i as i32) * y.powi(j as i32);
        }
        terms
    }
}

fn least_squares(terms: &[[f64; TERMS]], measured: &[Measured], robust: &[f64]) -> Option<[f64; TERMS]> {
    let (mut normal, mut right) = (DMatrix::zeros(TERMS, TERMS), DVector::zeros(TERMS));
    for ((term, measured), robust) in terms.iter().zip(measured).zip(robust) {
        let term = DVector::from_column_slice(term);
        let weight = measured.weight * robust;
        normal.ger(weight, &term, &term, 1.0);
        right.axpy(weight * measured.value, &term, 1.0);
    }
    // A diagonal that is larger by a millionth limits the terms that the positions of the samples hardly determine.
    for i in 0..TERMS {
        normal[(i, i)] *= 1.0 + 1e-6;
    }
    let solved = normal.cholesky()?.solve(&right);
    let mut coefficients = [0.0; TERMS];
    coefficients.copy_from_slice(solved.as_slice());
    coefficients.iter().all(|c: &f64| c.is_finite()).then_some(coefficients)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curvature_is_fitted_through_noise_and_holes() {
        let size = [120u32, 90];
        let bowl = |x: f64, y: f64| 3.0 + 4e-4 * ((x - 59.5).powi(2) + (y - 44.5).powi(2));
        let mut v = Vec::new();
        for y in 0..90 {
            for x in 0..120 {
                let noise = 0.3 * f64::from((x * 7919 + y * 104_729) % 13 - 6) / 6.0;
                v.push(if x < 9 { f32::NAN } else { (bowl(x.into(), y.into()) + noise) as f32 });
            }
        }
        let curvature = FieldCurvature::of_flat_target(size, &v, &vec![0.2; v.len()]).unwrap();
        for [x, y] in [[20.0, 10.0], [110.0, 80.0], [59.5, 44.5]] {
            assert!((curvature.at([x, y]) - (bowl(x, y) - 3.0)).abs() < 0.1, "{}", curvature.at([x, y]));
        }
        let nothing = FieldCurvature::of_flat_target(size, &v, &vec![1000.0; v.len()]);
        assert!(nothing.unwrap_err().to_string().contains("textured"));
    }

    fn places() -> impl Iterator<Item = [f64; 2]> {
        (0..20).flat_map(|y| (0..30).map(move |x| [10.0 * f64::from(x), 10.0 * f64::from(y)]))
    }

    #[test]
    fn a_bowl_is_fitted_despite_outliers() {
        let bowl = |[x, y]: [f64; 2]| 2.0 + 1e-4 * ((x - 120.0).powi(2) + (y - 90.0).powi(2)) + 1e-9 * x.powi(4);
        let measured: Vec<Measured> = places()
            .enumerate()
            .map(|(i, place)| Measured { place, value: bowl(place) + if i % 7 == 0 { 50.0 } else { 0.0 }, weight: 1.0 })
            .collect();
        let field = SmoothField::fit([300, 200], &measured).unwrap();
        for place in places() {
            assert!((field.at(place) - bowl(place)).abs() < 0.02, "{place:?}: {} {}", field.at(place), bowl(place));
        }
        let centre = centre(300, 200);
        assert!(field.above_centre(centre).abs() < 1e-12);
    }

    #[test]
    fn values_in_a_third_of_the_frame_do_not_cover_it() {
        let measured = |places: Vec<[f64; 2]>| -> Vec<Measured> {
            places.into_iter().map(|place| Measured { place, value: 1.0, weight: 1.0 }).collect()
        };
        assert!(covers([300, 200], &measured(places().collect())));
        assert!(!covers([300, 200], &measured(places().filter(|[x, _]| (100.0..200.0).contains(x)).collect())));
    }

    #[test]
    fn too_few_values_have_no_fit() {
        let one = Measured { place: [3.0, 4.0], value: 1.0, weight: 1.0 };
        assert_eq!(SmoothField::fit([300, 200], &[]), None);
        assert_eq!(SmoothField::fit([300, 200], &[Measured { weight: 0.0, ..one }; 30]), None);
    }
}
