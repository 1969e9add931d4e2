//! Errors of registration and V, and the coverage of these errors by σ.

use parfocal::{Settings, Solution, internals::median, internals::stages::uncertainty::LARGEST};

use crate::pairs::KnownPair;
use crate::section::{Case, Runner};

/// Width of the border that is left out of all errors of V, px.
pub(crate) const BORDER: usize = 16;

/// The indices of the pixels at least `border` px inside the frame.
pub(crate) fn inside(width: u32, height: u32, border: usize) -> impl Iterator<Item = usize> {
    let (width, height) = (width as usize, height as usize);
    let rows = border..height.saturating_sub(border);
    rows.flat_map(move |y| (border..width.saturating_sub(border)).map(move |x| y * width + x))
}

/// Root mean square of the finite values of a field, [`BORDER`] px inside the frame; `None` if there is none.
pub(crate) fn rms(width: u32, height: u32, value: impl Fn(usize) -> f64) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0usize);
    for v in inside(width, height, BORDER).map(value).filter(|v| v.is_finite()) {
        sum += v * v;
        count += 1;
    }
    (count > 0).then(|| (sum / count as f64).sqrt())
}

/// Errors of a solution with known truth; V in px², [`BORDER`] px inside the frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Errors {
    /// The largest distance of a corner from its true position, px.
    pub corner: f64,
    /// Root mean square of V minus the true V.
    pub rms: f64,
    /// Mean of V minus the true V.
    pub bias: f64,
    pub coverage: Coverage,
}

impl Errors {
    pub(crate) fn of(solution: &Solution, pair: &KnownPair) -> Self {
        let error = |i: usize| f64::from(solution.relative_blur[i]) - f64::from(pair.relative_blur[i]);
        let pixels = || inside(solution.width, solution.height, BORDER);
        let errors: Vec<f64> = pixels().map(error).filter(|e| e.is_finite()).collect();
        let mean = |f: fn(f64) -> f64| errors.iter().copied().map(f).sum::<f64>() / errors.len() as f64;
        Self {
            corner: solution.transform.corner_distance(pair.transform, solution.width, solution.height),
            rms: mean(|e| e * e).sqrt(),
            bias: mean(|e| e),
            coverage: Coverage::of(pixels().map(|i| (error(i), f64::from(solution.uncertainty[i])))),
        }
    }

    /// Solves a pair.
    pub(crate) fn solve(runner: &mut Runner, pair: &KnownPair, settings: &Settings) -> Result<Self, String> {
        Ok(Self::of(&pair.solve(runner, settings)?, pair))
    }

    /// The median of each error of several solutions.
    pub(crate) fn median(all: &[Self]) -> Option<Self> {
        let of = |f: &dyn Fn(&Self) -> f64| median(all.iter().map(f));
        let coverage = Coverage {
            one: of(&|e| e.coverage.one)?,
            two: of(&|e| e.coverage.two)?,
            beyond_five: of(&|e| e.coverage.beyond_five)?,
        };
        Some(Self { corner: of(&|e| e.corner)?, rms: of(&|e| e.rms)?, bias: of(&|e| e.bias)?, coverage })
    }
}

/// The shares of the pixels with an error within a multiple of their σ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Coverage {
    /// Within one σ: 0.68 for Gaussian errors.
    pub one: f64,
    /// Within two σ: 0.95 for Gaussian errors.
    pub two: f64,
    /// Beyond five σ.
    pub beyond_five: f64,
}

impl Coverage {
    /// Computes the shares from errors and their σ. Pixels with the largest σ have no information and are left out.
    pub(crate) fn of(pixels: impl Iterator<Item = (f64, f64)>) -> Self {
        let stated = pixels.filter(|(error, sigma)| error.is_finite() && *sigma < f64::from(LARGEST));
        let ratios: Vec<f64> = stated.map(|(error, sigma)| error.abs() / sigma).collect();
        let share = |f: &dyn Fn(f64) -> bool| ratios.iter().filter(|r| f(**r)).count() as f64 / ratios.len() as f64;
        Self { one: share(&|r| r <= 1.0), two: share(&|r| r <= 2.0), beyond_five: share(&|r| r > 5.0) }
    }

    /// Adds the shares within one and two σ, and their bounds.
    pub(crate) fn within(self, case: Case) -> Case {
        case.within("within 1 σ", self.one, [0.60, 0.75]).within("within 2 σ", self.two, [0.90, 0.97])
    }

    /// Adds all three shares and their bounds.
    pub(crate) fn all(self, case: Case) -> Case {
        self.within(case).at_most("beyond 5 σ", self.beyond_five, 0.005)
    }
}

/// Least, median and greatest value. A failure counts as infinite.
pub(crate) fn spread(values: &[Option<f64>]) -> [f64; 3] {
    let mut sorted: Vec<f64> = values.iter().map(|v| v.unwrap_or(f64::INFINITY)).collect();
    sorted.sort_by(f64::total_cmp);
    let at = |i: usize| sorted.get(i).copied().unwrap_or(f64::INFINITY);
    [at(0), at(sorted.len() / 2), at(sorted.len().saturating_sub(1))]
}

#[cfg(test)]
mod tests {
    use super::*;
    use parfocal::transform::Similarity;

    #[test]
    fn the_corner_error_of_a_rotation_and_a_scale_is_exact() {
        // Half the diagonal of 301 x 401 px is 250 px: corners are at (±150, ±200).
        let corner = |t: Similarity| t.corner_distance(&Similarity::IDENTITY, 301, 401);
        assert!((corner(Similarity::new(0.0, 0.0, 2.0, 1.0)) - 2.0 * 250.0 * 1f64.to_radians().sin()).abs() < 1e-9);
        assert!((corner(Similarity::new(0.0, 0.0, 0.0, 1.01)) - 2.5).abs() < 1e-9);
        // The corner that rotation and scale move in the same direction: 3 + 1.5 and 4 + 2.
        assert!((corner(Similarity::new(3.0, 4.0, 0.0, 1.01)) - 7.5).abs() < 1e-9);
    }

    #[test]
    fn rms_leaves_out_the_border_and_invalid_pixels() {
        let value = |i: usize| match (i % 40, i / 40) {
            (16, 16) => f64::NAN,
            (x, y) if (16..24).contains(&x) && (16..24).contains(&y) => 3.0,
            _ => 100.0,
        };
        assert_eq!(rms(40, 40, value), Some(3.0));
        assert_eq!(rms(32, 32, value), None);
        assert_eq!(rms(8, 8, value), None);
    }

    #[test]
    fn coverage_leaves_out_pixels_of_the_largest_sigma() {
        let pixels = [(0.5, 1.0), (-1.5, 1.0), (-6.0, 1.0), (3.0, 1.0), (f64::NAN, 1.0), (0.0, f64::from(LARGEST))];
        let coverage = Coverage::of(pixels.into_iter());
        assert_eq!(coverage, Coverage { one: 0.25, two: 0.5, beyond_five: 0.25 });
        assert_eq!(coverage.all(Case::new("x")).values.iter().filter(|v| v.met == Some(true)).count(), 0);
    }

    #[test]
    fn failures_are_worse_than_any_number() {
        assert_eq!(spread(&[Some(2.0), None, Some(1.0)]), [1.0, 2.0, f64::INFINITY]);
        assert_eq!(spread(&[None, None, Some(1.0)])[1], f64::INFINITY);
        assert_eq!(spread(&[])[1], f64::INFINITY);
    }
}
