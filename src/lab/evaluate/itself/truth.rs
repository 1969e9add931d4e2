//! Pairs of which T and V are known, and how far off a solution is.

use crate::base::statistics::median;
use crate::base::{Decode, Frame, Homography, Kernel, Settings};
use crate::engine::Solution;
use crate::lab::evaluate::bench::Bench;
use crate::lab::evaluate::cases::model;
use crate::lab::evaluate::errors::{BORDER, inside};
use crate::lab::evaluate::sigma::Sigma;
use crate::lab::scene::Scene;

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
    let kernel = match kernel {
        Kernel::Gaussian | Kernel::Pillbox => Kernel::Auto,
        other => other.clone(),
    };
    Settings { kernel, decode: Decode::None, ..Settings::default() }
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
