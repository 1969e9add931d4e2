//! The constants of a lens from a target of known depth.
//!
//! Relative blur is a polynomial in the coordinate x of depth, `V = c0 + c1 x + c2 x²`, whose coefficients depend on κ and
//! on the focus distances ([`Lens`]); x itself does not. The unknowns are found by damped Gauss-Newton (Levenberg and
//! Marquardt) on the weighted squares of V less the polynomial. The weight of a pixel is its confidence times a robust one,
//! first Huber's, which finds the way from afar, then Tukey's, which gives no weight to pixels that do not belong.
//!
//! Since V falls nearly on a line over x, a target determines two of the three unknowns, and one depth only one.

#[cfg(test)]
mod tests;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use crate::base::Region;
use crate::base::statistics::{Estimate, TUKEY, correlation_area, deviation, tukey};
use crate::base::{Error, Lens};
use crate::metric::measure::Values;

/// Where depth is known.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// A plane that fills the image: its depths in mm at the centres of the pixels top left, top right and bottom left.
    /// In between, 1/z is linear in the pixels, as perspective has it.
    Plane([f64; 3]),
    /// Surfaces square to the axis, each with its depth in mm. Where two overlap, the first counts.
    Steps(Vec<(Region, f64)>),
}

/// What a calibration can find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "kebab-case"))]
pub enum LensParameter {
    /// κ.
    Kappa,
    /// The distance at which I1 is focused.
    Focus1,
    /// The distance at which I2 is focused.
    Focus2,
}

/// A calibrated lens.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Calibration {
    /// The lens: what was found, and for the rest what was stated.
    pub lens: Lens,
    /// What was found, κ without unit and distances in mm. The standard errors allow for neighbouring pixels being alike.
    pub found: Vec<CalibratedParameter>,
    /// What the target does not determine beside `found`; it has its stated value.
    pub undetermined: Vec<LensParameter>,
    /// Rms of V less that of the model over the pixels that belong, px².
    pub residual_rms_px2: f64,
    /// Rms of the depth by the lens less the known depth over these pixels, mm; null where none has a depth.
    pub residual_rms_mm: Option<f64>,
    /// Valid pixels on the target, or the part of them that was taken.
    pub pixels: usize,
    /// Those that do not belong: more than 4.685 deviations from the model.
    pub outliers: usize,
}

/// An unknown that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct CalibratedParameter {
    /// Which.
    pub unknown: LensParameter,
    /// Value and standard error.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub estimate: Estimate,
}

/// The most pixels that are taken, every n-th of every n-th row: more would not determine three numbers better.
const MOST_PIXELS: usize = 1 << 18;
/// The least.
const LEAST_PIXELS: usize = 64;
/// The largest standard error of an unknown that counts as determined: of ln κ, or of a focus distance over the distance
/// between the two.
const LARGEST_ERROR: f64 = 0.5;
/// The least eigenvalue of the normal equations, scaled to a unit diagonal, with which the unknowns can be told apart.
const LEAST_EIGENVALUE: f64 = 1e-9;
/// Where Huber's weight begins to fall, in deviations: as efficient.
const HUBER: f64 = 1.345;

/// Finds `unknowns` from V on a target, starting from the lens as stated. `scale` is s of the registration; `confidence` is
/// of the size of `blur`. Where the target cannot tell the unknowns apart, the last of them is left as stated, and so on.
///
/// # Errors
/// [`Error::Setting`]: the lens, or a depth of the target. [`Error::Region`]: a region outside the image, too few valid
/// pixels, or a target that does not even determine the first unknown.
pub fn calibrate(
    start: &Lens,
    scale: f64,
    blur: &Values,
    confidence: &[f32],
    target: &Target,
    unknowns: &[LensParameter],
) -> Result<Calibration, Error> {
    start.check()?;
    let samples = Samples::new(start, blur, confidence, &target.depths(start, blur)?)?;
    for count in (1..=unknowns.len()).rev() {
        let fit = Fit { start, scale, samples: &samples, unknowns: &unknowns[..count] };
        if let Some(calibration) = fit.run(&unknowns[count..]) {
            return Ok(calibration);
        }
    }
    Err(Error::Region(
        "the target determines none of the unknowns: give depths that differ more, nearer to one focus than to the other"
            .to_string(),
    ))
}

impl Target {
    /// Depth at each pixel, NaN off the target.
    fn depths(&self, lens: &Lens, blur: &Values) -> Result<Vec<f64>, Error> {
        let check = |z: f64| {
            let range = format!("more than the focal length, {} mm, and less than 1e9", lens.focal_length);
            if z > lens.focal_length && z < 1e9 {
                Ok(())
            } else {
                Err(Error::Setting { name: "depth of the target", value: z, range })
            }
        };
        let (width, pixels) = (blur.width as usize, blur.values.len());
        match self {
            Self::Plane(corners) => {
                corners.iter().try_for_each(|&z| check(z))?;
                let [q00, q10, q01] = corners.map(|z| 1.0 / z);
                let last = |length: usize| length.saturating_sub(1).max(1) as f64;
                let (right, down) = ((q10 - q00) / last(width), (q01 - q00) / last(pixels / width.max(1)));
                let depth = |i: usize| 1.0 / (q00 + right * (i % width) as f64 + down * (i / width) as f64);
                // Beyond its horizon, bottom right, the plane has no depth.
                Ok((0..pixels).map(depth).map(|z| if z > lens.focal_length { z } else { f64::NAN }).collect())
            }
            Self::Steps(steps) => {
                let mut depths = vec![f64::NAN; pixels];
                for &(region, z) in steps.iter().rev() {
                    check(z)?;
                    blur.region(region)?;
                    for y in region.y..region.y + region.height {
                        let start = y as usize * width + region.x as usize;
                        depths[start..start + region.width as usize].fill(z);
                    }
                }
                Ok(depths)
            }
        }
    }
}

/// V and depth on a grid of every n-th pixel.
struct Samples {
    /// Of the grid.
    width: usize,
    pixels: Vec<Sample>,
    /// How many of them lie on the target and are valid.
    valid: usize,
}

#[derive(Clone, Copy)]
struct Sample {
    /// Coordinate of depth.
    x: f64,
    /// Depth, mm.
    z: f64,
    /// V, px².
    v: f64,
    /// Confidence; 0 where not valid or off the target.
    weight: f64,
}

impl Samples {
    fn new(lens: &Lens, blur: &Values, confidence: &[f32], depths: &[f64]) -> Result<Self, Error> {
        let width = blur.width as usize;
        let sample = |i: usize| {
            let (z, v, c) = (depths[i], f64::from(blur.values[i]), f64::from(confidence[i]));
            let weight = if z.is_finite() && v.is_finite() && c > 0.0 { c } else { 0.0 };
            Sample { x: lens.coordinate(z), z, v, weight }
        };
        let on_target = depths.iter().filter(|z| z.is_finite()).count();
        let step = (on_target as f64 / MOST_PIXELS as f64).sqrt().ceil().max(1.0) as usize;
        let rows = (0..blur.values.len() / width.max(1)).step_by(step);
        let places = rows.flat_map(|y| (0..width).step_by(step).map(move |x| y * width + x));
        let pixels: Vec<Sample> = places.map(sample).collect();
        let valid = pixels.iter().filter(|s| s.weight > 0.0).count();
        if valid < LEAST_PIXELS {
            return Err(Error::Region(format!(
                "the target has {valid} valid pixels, and {LEAST_PIXELS} are needed: give larger regions, or texture on it"
            )));
        }
        Ok(Self { width: width.div_ceil(step), pixels, valid })
    }
}

/// One set of unknowns. They are ln κ over its start, and how far each focus distance has moved over the distance between
/// the two.
struct Fit<'a> {
    start: &'a Lens,
    scale: f64,
    samples: &'a Samples,
    unknowns: &'a [LensParameter],
}

impl Fit<'_> {
    /// The calibration, unless these unknowns are not determined.
    fn run(&self, undetermined: &[LensParameter]) -> Option<Calibration> {
        let mut at = vec![0.0; self.unknowns.len()];
        self.descend(&mut at, |r| if r.abs() <= HUBER { 1.0 } else { HUBER / r.abs() });
        self.descend(&mut at, tukey);
        let errors = self.standard_errors(&at)?;
        if errors.iter().any(|e| e.is_nan() || *e > LARGEST_ERROR) {
            return None;
        }
        let lens = self.lens(&at);
        let found = self.unknowns.iter().zip(errors).map(|(&unknown, error)| {
            let (value, unit) = match unknown {
                LensParameter::Kappa => (lens.kappa, lens.kappa),
                LensParameter::Focus1 => (lens.focus[0], self.between()),
                LensParameter::Focus2 => (lens.focus[1], self.between()),
            };
            CalibratedParameter { unknown, estimate: Estimate { value, standard_error: error * unit } }
        });
        Some(self.report(&lens, found.collect(), undetermined))
    }

    fn report(&self, lens: &Lens, found: Vec<CalibratedParameter>, undetermined: &[LensParameter]) -> Calibration {
        let residuals = self.residuals(lens);
        let limit = TUKEY * deviation(&residuals);
        let used = self.samples.pixels.iter().zip(&residuals).filter(|(_, r)| r.abs() <= limit);
        let inverse = lens.inverse(self.scale);
        let in_mm = used.clone().filter_map(|(s, _)| Some(inverse.depth(s.v)? - s.z));
        Calibration {
            lens: *lens,
            found,
            undetermined: undetermined.to_vec(),
            residual_rms_px2: rms(used.clone().map(|(_, &r)| r)).unwrap_or(0.0),
            residual_rms_mm: rms(in_mm),
            pixels: self.samples.valid,
            outliers: self.samples.valid - used.count(),
        }
    }

    /// |u2 - u1|, mm.
    fn between(&self) -> f64 {
        (self.start.focus[1] - self.start.focus[0]).abs()
    }

    fn lens(&self, at: &[f64]) -> Lens {
        let mut lens = *self.start;
        for (unknown, value) in self.unknowns.iter().zip(at) {
            match unknown {
                LensParameter::Kappa => lens.kappa *= value.exp(),
                LensParameter::Focus1 => lens.focus[0] += value * self.between(),
                LensParameter::Focus2 => lens.focus[1] += value * self.between(),
            }
        }
        lens
    }

    /// V less that of the lens, px²; NaN off the target.
    fn residuals(&self, lens: &Lens) -> Vec<f64> {
        let [c0, c1, c2] = lens.polynomial(self.scale);
        let residual = |s: &Sample| if s.weight > 0.0 { s.v - (c0 + s.x * (c1 + s.x * c2)) } else { f64::NAN };
        self.samples.pixels.iter().map(residual).collect()
    }

    /// Levenberg and Marquardt, with weights by the residuals over their deviation, both renewed at each step.
    fn descend(&self, at: &mut Vec<f64>, robust: impl Fn(f64) -> f64) {
        const STEPS: usize = 60;
        let mut damping = 1e-3;
        for _ in 0..STEPS {
            let residuals = self.residuals(&self.lens(at));
            let sigma = deviation(&residuals).max(1e-12);
            let weight = |(s, r): (&Sample, &f64)| if r.is_nan() { 0.0 } else { s.weight * robust(r / sigma) };
            let weights: Vec<f64> = self.samples.pixels.iter().zip(&residuals).map(weight).collect();
            let cost =
                |r: &[f64]| r.iter().zip(&weights).filter(|(_, w)| **w > 0.0).map(|(r, w)| w * r * r).sum::<f64>();
            let (normal, gradient) = self.normal(at, &residuals, |i| weights[i]);
            let damped = &normal + DMatrix::from_diagonal(&(normal.diagonal() * damping));
            let Some(step) = damped.cholesky().map(|c| c.solve(&gradient)) else { return };
            let moved: Vec<f64> = at.iter().zip(step.iter()).map(|(a, d)| a + d.clamp(-1.0, 1.0)).collect();
            let lens = self.lens(&moved);
            if lens.check().is_ok() && cost(&self.residuals(&lens)) <= cost(&residuals) {
                *at = moved;
                damping = (damping / 10.0).max(1e-12);
                if step.amax() < 1e-7 {
                    return;
                }
            } else {
                damping *= 10.0;
                if damping > 1e9 {
                    return;
                }
            }
        }
    }

    /// `Σ w J Jᵀ` and `Σ w J r`, J the derivatives of V by the unknowns.
    fn normal(&self, at: &[f64], residuals: &[f64], weight: impl Fn(usize) -> f64) -> (DMatrix<f64>, DVector<f64>) {
        // J is K (1, x, x²): the sums are those of the powers of x.
        let derivatives = self.derivatives(at);
        let (mut powers, mut moments) = (Matrix3::zeros(), Vector3::zeros());
        for (i, (s, r)) in self.samples.pixels.iter().zip(residuals).enumerate().filter(|(_, (s, _))| s.weight > 0.0) {
            let basis = Vector3::new(1.0, s.x, s.x * s.x);
            let w = weight(i);
            powers.ger(w, &basis, &basis, 1.0);
            moments.axpy(w * r, &basis, 1.0);
        }
        (&derivatives * powers * derivatives.transpose(), derivatives * moments)
    }

    /// Of the three coefficients of the polynomial, a row for each unknown; by central differences.
    fn derivatives(&self, at: &[f64]) -> DMatrix<f64> {
        const STEP: f64 = 1e-5;
        let moved = |unknown: usize, by: f64| {
            let mut moved = at.to_vec();
            moved[unknown] += by;
            self.lens(&moved).polynomial(self.scale)
        };
        let column = |i: usize, j: usize| (moved(i, STEP)[j] - moved(i, -STEP)[j]) / (2.0 * STEP);
        DMatrix::from_fn(at.len(), 3, column)
    }

    /// Standard errors of the unknowns, each in its own measure; `None` where they cannot be told apart.
    ///
    /// `A⁻¹ (Σ w² r² J Jᵀ) A⁻¹` with `A = Σ w J Jᵀ` (White 1980), times the area over which residuals are alike.
    fn standard_errors(&self, at: &[f64]) -> Option<Vec<f64>> {
        let residuals = self.residuals(&self.lens(at));
        let sigma = deviation(&residuals).max(1e-12);
        let weight = |i: usize| self.samples.pixels[i].weight * tukey(residuals[i] / sigma);
        let (normal, _) = self.normal(at, &residuals, weight);
        let scaled =
            DMatrix::from_fn(at.len(), at.len(), |i, j| normal[(i, j)] / (normal[(i, i)] * normal[(j, j)]).sqrt());
        if scaled.iter().any(|v| !v.is_finite()) || scaled.symmetric_eigenvalues().min() < LEAST_EIGENVALUE {
            return None;
        }
        let inverse = normal.try_inverse()?;
        let (spread, _) = self.normal(at, &residuals, |i| (weight(i) * residuals[i]).powi(2));
        let covariance = &inverse * spread * &inverse * correlation_area(&residuals, self.samples.width);
        Some(covariance.diagonal().iter().map(|v| v.sqrt()).collect())
    }
}

fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + v * v, count + 1.0));
    (count > 0.0).then(|| f64::sqrt(sum / count))
}
