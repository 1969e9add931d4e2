//! Pairs of which T and V are known, and how far off a solution is.

use crate::base::statistics::median;
use crate::base::{Frame, Homography, Kernel, Settings};
use crate::engine::Solution;
use crate::engine::stages::uncertainty::LARGEST;
use crate::lab::evaluate::bench::Bench;
use crate::lab::evaluate::cases::model;
use crate::lab::evaluate::errors::{BORDER, inside};
use crate::lab::scene::Scene;

use super::section::Case;

/// A pair with its truth.
pub(super) struct Known {
    pub images: [Frame; 2],
    pub transform: Homography,
    /// V at each pixel of I1, px².
    pub relative_blur: Vec<f32>,
    pub settings: Settings,
}

impl Known {
    pub(super) fn of(scene: &Scene) -> Result<Self, String> {
        let pair = scene.render().map_err(|e| e.to_string())?;
        let settings = by_itself(&model(scene.kernel));
        let (images, transform) = ([pair.i1, pair.i2], pair.transform);
        Ok(Self { images, transform: transform.into(), relative_blur: pair.relative_blur, settings })
    }

    /// Solved by its settings.
    pub(super) fn errors(&self, bench: &mut Bench) -> Result<Errors, String> {
        self.errors_by(bench, &self.settings)
    }

    pub(super) fn errors_by(&self, bench: &mut Bench, settings: &Settings) -> Result<Errors, String> {
        let [i1, i2] = &self.images;
        let solution = bench.solve([i1, i2], settings)?;
        Ok(Errors::of(&solution, &self.transform, &self.relative_blur))
    }
}

/// The default settings. A symmetrical kernel is left to them; one that is not has to be stated, as by its owner.
pub(super) fn by_itself(kernel: &Kernel) -> Settings {
    match kernel {
        Kernel::Gaussian | Kernel::Pillbox => Settings::default(),
        other => Settings { kernel: other.clone(), ..Settings::default() },
    }
}

/// The same with this smoothness α.
pub(super) fn weighed(settings: &Settings, alpha: f64) -> Settings {
    Settings { regularization: Some(alpha), ..settings.clone() }
}

/// How far off a solution is; V in px², [`BORDER`] px along the border left out.
#[derive(Clone, Copy, Debug)]
pub(super) struct Errors {
    /// The largest distance of a corner from where it belongs, px.
    pub corner: f64,
    /// Root mean square of V less the true V.
    pub rms: f64,
    /// Their mean.
    pub bias: f64,
    pub sigma: Sigma,
}

impl Errors {
    pub(super) fn of(solution: &Solution, transform: &Homography, truth: &[f32]) -> Self {
        let error = |i: usize| f64::from(solution.relative_blur[i]) - f64::from(truth[i]);
        let pixels = || inside(solution.width, solution.height, BORDER);
        let errors: Vec<f64> = pixels().map(error).filter(|e| e.is_finite()).collect();
        let mean = |f: fn(f64) -> f64| errors.iter().copied().map(f).sum::<f64>() / errors.len() as f64;
        Self {
            corner: solution.transform.corner_distance(transform, solution.width, solution.height),
            rms: mean(|e| e * e).sqrt(),
            bias: mean(|e| e),
            sigma: Sigma::of(pixels().map(|i| (error(i), f64::from(solution.uncertainty[i])))),
        }
    }

    /// Each figure's median.
    pub(super) fn median(all: &[Self]) -> Option<Self> {
        let of = |f: &dyn Fn(&Self) -> f64| median(all.iter().map(f));
        let sigma = Sigma {
            one: of(&|e| e.sigma.one)?,
            two: of(&|e| e.sigma.two)?,
            beyond_five: of(&|e| e.sigma.beyond_five)?,
        };
        Some(Self { corner: of(&|e| e.corner)?, rms: of(&|e| e.rms)?, bias: of(&|e| e.bias)?, sigma })
    }
}

/// Whether σ says what the error is: shares of the pixels.
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
        let case = Case::new(name).within("within 1 σ", self.one, [0.60, 0.75]);
        case.within("within 2 σ", self.two, [0.90, 0.97]).at_most("beyond 5 σ", self.beyond_five, 0.005)
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
