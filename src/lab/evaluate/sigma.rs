//! Whether σ says what the error is.

use super::section::Case;
use crate::engine::stages::uncertainty::LARGEST;

/// Shares of the pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sigma {
    /// Off by at most one σ: 0.68 of Gaussian errors.
    pub one: f64,
    /// By at most two: 0.95.
    pub two: f64,
    /// By more than five.
    pub beyond_five: f64,
}

impl Sigma {
    /// Of errors and their σ, where σ claims to know anything.
    pub(super) fn of(pixels: impl Iterator<Item = (f64, f64)>) -> Self {
        let known = pixels.filter(|(error, sigma)| error.is_finite() && *sigma < f64::from(LARGEST));
        let ratios: Vec<f64> = known.map(|(error, sigma)| error.abs() / sigma).collect();
        let share = |f: &dyn Fn(f64) -> bool| ratios.iter().filter(|r| f(**r)).count() as f64 / ratios.len() as f64;
        Self { one: share(&|r| r <= 1.0), two: share(&|r| r <= 2.0), beyond_five: share(&|r| r > 5.0) }
    }

    /// A case with the shares that a σ which can be believed has.
    pub(super) fn case(self, name: impl Into<String>) -> Case {
        self.covering(Case::new(name)).at_most("beyond 5 σ", self.beyond_five, 0.005)
    }

    /// A case with those within one σ and two.
    pub(super) fn covering(self, case: Case) -> Case {
        case.within("within 1 σ", self.one, [0.60, 0.75]).within("within 2 σ", self.two, [0.90, 0.97])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_of_the_pixels_whose_sigma_claims_anything() {
        let pixels = [(0.5, 1.0), (-1.5, 1.0), (-6.0, 1.0), (3.0, 1.0), (f64::NAN, 1.0), (0.0, f64::from(LARGEST))];
        let sigma = Sigma::of(pixels.into_iter());
        assert_eq!(sigma, Sigma { one: 0.25, two: 0.5, beyond_five: 0.25 });
        assert_eq!(sigma.case("x").figures.iter().filter(|f| f.met == Some(true)).count(), 0);
    }
}
