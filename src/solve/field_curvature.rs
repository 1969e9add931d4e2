//! The field curvature of a lens, fitted to V of a flat target (the flat reference).

use nalgebra::DVector;

use crate::base::Error;
use crate::base::smooth_field::{Equation, RobustFit, TERMS, covers, sum, terms};
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
    coefficients: [f64; TERMS],
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
        let measured = |i: &usize| relative_blur[*i].is_finite() && uncertainty[*i] < LARGEST;
        let samples: Vec<usize> = (0..relative_blur.len()).step_by(stride).filter(measured).collect();
        let place = |i: usize| [(i % width) as f64, (i / width) as f64];
        let equation = |&i: &usize| Equation {
            terms: DVector::from_column_slice(&terms(size, place(i))),
            value: relative_blur[i].into(),
            weight: f64::from(uncertainty[i].max(LEAST_DEVIATION)).powi(-2),
        };
        let enough = samples.len() >= LEAST_PIXELS && covers(size, samples.iter().map(|&i| place(i)));
        let fit = enough.then(|| RobustFit::new(&samples.iter().map(equation).collect::<Vec<_>>())).flatten();
        match fit {
            Some(fit) => {
                let mut coefficients = [0.0; TERMS];
                coefficients.copy_from_slice(fit.coefficients.as_slice());
                Ok(Self { size, coefficients })
            }
            None => Err(Error::Region(format!(
                "the flat reference has V in {} of {} sampled pixels, too few or not all over the frame: photograph a textured flat target that fills it",
                samples.len(),
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
        sum(&terms(self.size, place), &self.coefficients) - self.coefficients[0]
    }

    /// Subtracts the field from V of a solution for photographs of its size. A pixel at the limit of |V| stays there,
    /// and no other pixel reaches it, because the limit marks V as a bound only.
    pub fn flatten(&self, solution: &mut Solution) {
        let limit = solution.max_relative_blur as f32;
        let (reached, below) = (0.999 * limit, 0.998 * limit);
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
}
