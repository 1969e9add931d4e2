//! Where the photographs say nothing of V: marked, so that what is filled in there is not taken for a measurement.

use super::ranks::Ranks;
use crate::engine::Solution;

/// A standard deviation of V that is never too large, px².
const ALWAYS_ENOUGH: f32 = 1.0;

/// Which pixels of a solution have enough texture to tell V, and by what measure.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// Standard deviation of V beyond which a pixel is marked, px².
    pub max_uncertainty: f32,
    /// Of each pixel whether V is valid but its standard deviation beyond that.
    pub marked: Vec<bool>,
}

impl Texture {
    /// Marks by the standard deviation given, px²; `None` takes half of the range from the 1st to the 99th percentile of V,
    /// and 1 px² at least: a pixel that cannot tell which half of the range it is in.
    pub fn of(solution: &Solution, max_uncertainty: Option<f32>) -> Self {
        let max_uncertainty = max_uncertainty.unwrap_or_else(|| {
            let mut ranks = Ranks::of(&solution.relative_blur);
            let range = [0.01, 0.99].map(|p| ranks.quantile(p));
            let [Some(low), Some(high)] = range else { return ALWAYS_ENOUGH };
            (0.5 * (high - low)).max(ALWAYS_ENOUGH)
        });
        Self::beyond(max_uncertainty, &solution.uncertainty)
    }

    /// Marks by the standard deviation given, px², of a field of them.
    pub(super) fn beyond(max_uncertainty: f32, uncertainty: &[f32]) -> Self {
        Self { max_uncertainty, marked: uncertainty.iter().map(|&deviation| deviation > max_uncertainty).collect() }
    }

    /// Fraction of all pixels that are marked.
    pub fn marked_fraction(&self) -> f64 {
        self.marked.iter().filter(|&&marked| marked).count() as f64 / self.marked.len().max(1) as f64
    }

    /// A field with NaN at the marked pixels.
    pub fn without(&self, field: &[f32]) -> Vec<f32> {
        field.iter().zip(&self.marked).map(|(&value, &marked)| if marked { f32::NAN } else { value }).collect()
    }
}
