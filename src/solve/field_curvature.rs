//! A flat reference: V of a flat target shows the curvature of the field of focus, which is taken from V of other pairs.

use crate::base::Error;
use crate::engine::Solution;
use crate::solve::smooth_field::{Known, SmoothField, covers};

/// Fewest pixels of the reference that tell of V.
const LEAST_PIXELS: usize = 200;
/// About so many pixels of the reference are looked at: a smooth field needs no more.
const SAMPLES: usize = 1 << 16;
/// Standard deviation of V, px², below which a pixel weighs no more: what it states leaves out the model's own error.
const LEAST_DEVIATION: f32 = 0.1;

/// How V of a flat target deviates from its value at the image centre: the lens' field curvature, with whatever tilt the
/// target had.
///
/// A polynomial of fourth degree in the place, fitted to V by its uncertainty, so that neither the target's texture nor
/// its holes are carried over.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldCurvature {
    size: [u32; 2],
    field: SmoothField,
}

impl FieldCurvature {
    /// From V and its standard deviation, px², of a flat target that fills the image.
    ///
    /// # Errors
    /// [`Error::Region`]: too few pixels say anything of V.
    pub fn of_flat_target(size: [u32; 2], relative_blur: &[f32], uncertainty: &[f32]) -> Result<Self, Error> {
        let width = size[0] as usize;
        let stride = (relative_blur.len() / SAMPLES).max(1);
        let known: Vec<Known> = (0..relative_blur.len())
            .step_by(stride)
            .filter(|&i| relative_blur[i].is_finite() && uncertainty[i] < crate::engine::stages::uncertainty::LARGEST)
            .map(|i| Known {
                place: [(i % width) as f64, (i / width) as f64],
                value: relative_blur[i].into(),
                weight: f64::from(uncertainty[i].max(LEAST_DEVIATION)).powi(-2),
            })
            .collect();
        let enough = known.len() >= LEAST_PIXELS && covers(size, &known);
        let field = if enough { SmoothField::fit(size, &known) } else { None };
        match field {
            Some(field) => Ok(Self { size, field }),
            None => Err(Error::Region(format!(
                "the flat reference tells of V in {} of {} places, too few or not all over the frame: photograph a textured flat target that fills it",
                known.len(),
                relative_blur.len().div_ceil(stride)
            ))),
        }
    }

    /// Width and height of the photographs that it is of.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// What V of the target is at a pixel more than at the image centre, px².
    pub fn at(&self, place: [f64; 2]) -> f64 {
        self.field.above_centre(place)
    }

    /// Takes it from V of a solution whose photographs have its size, |V| limited to so many px². A pixel at the limit stays
    /// there, and no other comes there: it says that V is only a bound.
    pub fn flatten(&self, solution: &mut Solution, limit: f64) {
        let (reached, below) = (0.999 * limit as f32, 0.998 * limit as f32);
        self.change(solution, |v, curvature| if v.abs() >= reached { v } else { (v - curvature).clamp(-below, below) });
    }

    /// A flattened solution with V as it was, but for pixels near the limit.
    pub fn restored(&self, solution: &Solution) -> Solution {
        let mut restored = solution.clone();
        self.change(&mut restored, |v, curvature| v + curvature);
        restored
    }

    fn change(&self, solution: &mut Solution, change: impl Fn(f32, f32) -> f32) {
        let (width, [left, top]) = (solution.width as usize, solution.origin.map(f64::from));
        for (i, v) in solution.relative_blur.iter_mut().enumerate() {
            let place = [left + (i % width) as f64, top + (i / width) as f64];
            *v = if v.is_nan() { *v } else { change(*v, self.at(place) as f32) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curvature_is_found_through_noise_and_holes_and_its_value_in_the_middle_stays() {
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
