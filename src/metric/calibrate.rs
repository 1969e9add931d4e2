//! Calibration of a lens from a target of known depth.
//!
//! Relative blur is a polynomial in x, a function of depth ([`Lens`]): `V = c0 + c1 x + c2 x²`. The coefficients depend
//! on κ and the focus distances, x does not. The parameters minimize the weighted squared residuals of V by the
//! Levenberg-Marquardt method. The weight of a pixel is its confidence times a robust weight: first Huber's, which
//! converges from a distant start, then Tukey's, which excludes outliers.
//!
//! V is almost linear in x, so that a target determines two of the three parameters, and a single depth one.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use crate::base::Region;
use crate::base::statistics::{Estimate, TUKEY, correlation_area, deviation, tukey};
use crate::base::{Error, Lens};
use crate::metric::measure::Values;

/// A target of known depth.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// A plane that fills the image: its depths, mm, at the centres of the top left, top right and bottom left pixels.
    /// Under perspective, 1/z is linear in the pixel coordinates.
    Plane([f64; 3]),
    /// Surfaces perpendicular to the axis, each with its depth, mm. Where regions overlap, the first applies.
    Steps(Vec<(Region, f64)>),
}

/// A parameter that a calibration can estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "kebab-case"))]
pub enum LensParameter {
    /// κ.
    Kappa,
    /// The focus distance of I1.
    Focus1,
    /// The focus distance of I2.
    Focus2,
}

/// The result of a calibration.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Calibration {
    /// The lens with the estimated parameters; the others as stated.
    pub lens: Lens,
    /// The estimated parameters: κ without unit, distances in mm. The standard errors account for correlated pixels.
    pub found: Vec<CalibratedParameter>,
    /// The requested parameters that the target does not determine. They keep their stated values.
    pub undetermined: Vec<LensParameter>,
    /// RMS residual of V over the inliers, px².
    pub residual_rms_px2: f64,
    /// RMS error of the depth over the inliers, mm. `None` if none has a depth.
    pub residual_rms_mm: Option<f64>,
    /// The number of valid pixels on the target, after subsampling.
    pub pixels: usize,
    /// The number of outliers: pixels more than 4.685 standard deviations from the model.
    pub outliers: usize,
}

/// An estimated parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct CalibratedParameter {
    /// The parameter.
    pub unknown: LensParameter,
    /// Its value and standard error.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub estimate: Estimate,
}

/// The largest number of pixels; more are subsampled, since three parameters need no more.
const MAX_PIXELS: usize = 1 << 18;
/// The smallest number of pixels.
const MIN_PIXELS: usize = 64;
/// The largest standard error of a determined parameter, in its scaled units ([`Fit`]).
const MAX_ERROR: f64 = 0.5;
/// The smallest eigenvalue of the normal matrix, scaled to a unit diagonal, of determined parameters.
const MIN_EIGENVALUE: f64 = 1e-9;
/// The threshold of Huber's weight in standard deviations, for 95 % efficiency under Gaussian noise.
const HUBER: f64 = 1.345;

/// Estimates the parameters `unknowns` from V on a target, starting from the stated lens.
///
/// `blur` is V, px²; `confidence` has the same size; `scale` is s of the registration. If the target does not determine
/// all parameters, the last ones keep their stated values.
///
/// # Errors
/// [`Error::Setting`] for an invalid lens or depth. [`Error::Region`] for a region outside the image, too few valid
/// pixels, or a target that does not determine the first parameter.
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
    /// Returns the depth at each pixel, mm. NaN off the target.
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
                // The plane has no depth beyond its horizon.
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

/// V and depth at subsampled pixels.
struct Samples {
    /// Samples per row.
    width: usize,
    pixels: Vec<Sample>,
    /// The number of valid samples on the target.
    valid: usize,
}

#[derive(Clone, Copy)]
struct Sample {
    /// x of the depth.
    x: f64,
    /// Depth, mm.
    z: f64,
    /// V, px².
    v: f64,
    /// The confidence; 0 if not valid or off the target.
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
        let step = (on_target as f64 / MAX_PIXELS as f64).sqrt().ceil().max(1.0) as usize;
        let rows = (0..blur.values.len() / width.max(1)).step_by(step);
        let places = rows.flat_map(|y| (0..width).step_by(step).map(move |x| y * width + x));
        let pixels: Vec<Sample> = places.map(sample).collect();
        let valid = pixels.iter().filter(|s| s.weight > 0.0).count();
        if valid < MIN_PIXELS {
            return Err(Error::Region(format!(
                "the target has {valid} valid pixels, and {MIN_PIXELS} are needed: give larger regions, or texture on it"
            )));
        }
        Ok(Self { width: width.div_ceil(step), pixels, valid })
    }
}

/// A fit of some parameters, in scaled units: the logarithm of κ over its start, and the change of a focus distance
/// over the distance between the two.
struct Fit<'a> {
    start: &'a Lens,
    scale: f64,
    samples: &'a Samples,
    unknowns: &'a [LensParameter],
}

impl Fit<'_> {
    /// Returns the calibration. `None` if the parameters are not determined.
    fn run(&self, undetermined: &[LensParameter]) -> Option<Calibration> {
        let mut at = vec![0.0; self.unknowns.len()];
        self.descend(&mut at, |r| if r.abs() <= HUBER { 1.0 } else { HUBER / r.abs() });
        self.descend(&mut at, tukey);
        let errors = self.standard_errors(&at)?;
        if errors.iter().any(|e| e.is_nan() || *e > MAX_ERROR) {
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

    /// Returns |u2 - u1|, mm.
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

    /// Returns V minus that of the lens, px². NaN off the target.
    fn residuals(&self, lens: &Lens) -> Vec<f64> {
        let [c0, c1, c2] = lens.polynomial(self.scale);
        let residual = |s: &Sample| if s.weight > 0.0 { s.v - (c0 + s.x * (c1 + s.x * c2)) } else { f64::NAN };
        self.samples.pixels.iter().map(residual).collect()
    }

    /// Minimizes the weighted residuals (Levenberg and Marquardt). Each step updates the robust weights and their
    /// scale.
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

    /// Returns `Σ w J Jᵀ` and `Σ w J r`, with the derivatives J of V by the parameters.
    fn normal(&self, at: &[f64], residuals: &[f64], weight: impl Fn(usize) -> f64) -> (DMatrix<f64>, DVector<f64>) {
        // J is K (1, x, x²), so that only sums of powers of x are needed.
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

    /// Returns the derivatives of the polynomial's coefficients, one row per parameter, by central differences.
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

    /// Returns the standard errors of the parameters, in scaled units. `None` if they are not determined.
    ///
    /// The covariance is `A⁻¹ (Σ w² r² J Jᵀ) A⁻¹` with `A = Σ w J Jᵀ` (White 1980), times the correlation area of the
    /// residuals.
    fn standard_errors(&self, at: &[f64]) -> Option<Vec<f64>> {
        let residuals = self.residuals(&self.lens(at));
        let sigma = deviation(&residuals).max(1e-12);
        let weight = |i: usize| self.samples.pixels[i].weight * tukey(residuals[i] / sigma);
        let (normal, _) = self.normal(at, &residuals, weight);
        let scaled =
            DMatrix::from_fn(at.len(), at.len(), |i, j| normal[(i, j)] / (normal[(i, i)] * normal[(j, j)]).sqrt());
        if scaled.iter().any(|v| !v.is_finite()) || scaled.symmetric_eigenvalues().min() < MIN_EIGENVALUE {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::statistics::tests::smooth_noise;

    const SIZE: [usize; 2] = [160, 120];

    fn cup() -> Lens {
        let (pixel_pitch, focus) = (0.01304, [529.0, 869.0]);
        Lens { focal_length: 25.0, f_number: 8.3, pixel_pitch, focus, kappa: 0.43, telecentric: true }
    }

    fn macro_lens() -> Lens {
        let (pixel_pitch, focus) = (0.0075, [226.5, 233.5]);
        Lens { focal_length: 50.0, f_number: 5.6, pixel_pitch, focus, kappa: 0.43, telecentric: false }
    }

    fn plane(lens: &Lens) -> Target {
        let [near, far] = lens.focus;
        Target::Plane([near, 0.3 * near + 0.7 * far, 0.8 * near + 0.2 * far])
    }

    /// V of a target with correlated noise.
    fn noisy_blur(lens: &Lens, scale: f64, target: &Target, noise: f64, seed: u64) -> Vec<f32> {
        let blank = vec![0.0; SIZE[0] * SIZE[1]];
        let depths = target.depths(lens, &Values { width: SIZE[0] as u32, values: &blank }).unwrap();
        let noise: Vec<f64> = smooth_noise(SIZE, 1.5, seed).into_iter().map(|n| noise * n).collect();
        depths.iter().zip(noise).map(|(&z, n)| (lens.relative_blur(z, scale) + n) as f32).collect()
    }

    fn calibrated(start: &Lens, scale: f64, blur: &[f32], target: &Target, unknowns: &[LensParameter]) -> Calibration {
        let field = Values { width: SIZE[0] as u32, values: blur };
        let calibration = calibrate(start, scale, &field, &vec![0.05; blur.len()], target, unknowns).unwrap();
        println!("{calibration:?}");
        calibration
    }

    const TWO: [LensParameter; 2] = [LensParameter::Kappa, LensParameter::Focus2];

    #[test]
    fn a_tilted_plane_determines_kappa_and_a_focus_distance() {
        for truth in [cup(), macro_lens()] {
            let (s, target) = (truth.breathing(), plane(&truth));
            let blur = noisy_blur(&truth, s, &target, 0.0, 0);
            let between = truth.focus[1] - truth.focus[0];
            let start = Lens { kappa: 0.7, focus: [truth.focus[0], truth.focus[1] + 0.2 * between], ..truth };
            let exact = calibrated(&start, s, &blur, &target, &TWO);
            assert!((exact.lens.kappa / 0.43 - 1.0).abs() < 1e-4, "{exact:?}");
            assert!((exact.lens.focus[1] - truth.focus[1]).abs() < 1e-3 * between, "{exact:?}");
            assert!(exact.undetermined.is_empty() && exact.lens.focus[0] == truth.focus[0]);
        }
    }

    #[test]
    fn standard_errors_agree_with_the_scatter_over_noise() {
        let (truth, target) = (cup(), plane(&cup()));
        let start = Lens { kappa: 0.5, ..truth };
        let trials: Vec<[Estimate; 2]> = (0..16)
            .map(|seed| {
                let blur = noisy_blur(&truth, 1.0, &target, 0.05, seed);
                [0, 1].map(|i| calibrated(&start, 1.0, &blur, &target, &TWO).found[i].estimate)
            })
            .collect();
        for (i, value) in [(0, truth.kappa), (1, truth.focus[1])] {
            let mean_square =
                |f: &dyn Fn(&Estimate) -> f64| trials.iter().map(|t| f(&t[i]).powi(2)).sum::<f64>() / 16.0;
            let (scatter, claimed) =
                (mean_square(&|e| e.value - value).sqrt(), mean_square(&|e| e.standard_error).sqrt());
            println!("scatter {scatter}, claimed {claimed}");
            assert!((0.6..1.7).contains(&(claimed / scatter)), "unknown {i}: {claimed}, and the scatter is {scatter}");
        }
    }

    #[test]
    fn undetermined_parameters_are_reported_and_keep_their_values() {
        let (truth, region) = (cup(), |x| Region { x, y: 10, width: 50, height: 90 });
        let start = Lens { kappa: 0.5, ..truth };
        // V is linear in x: two parameters.
        let blur = noisy_blur(&truth, 1.0, &plane(&truth), 0.02, 1);
        let three = calibrated(
            &start,
            1.0,
            &blur,
            &plane(&truth),
            &[LensParameter::Kappa, LensParameter::Focus1, LensParameter::Focus2],
        );
        assert_eq!((&three.undetermined[..], three.lens.focus[1]), (&[LensParameter::Focus2][..], 869.0));
        // One depth: one parameter.
        let one = Target::Steps(vec![(region(0), 560.0)]);
        let single = calibrated(&start, 1.0, &noisy_blur(&truth, 1.0, &one, 0.02, 2), &one, &TWO);
        assert_eq!((&single.undetermined[..], single.lens.focus[1]), (&[LensParameter::Focus2][..], 869.0));
        assert!((single.lens.kappa - 0.43).abs() < 0.01, "{single:?}");
        // Two depths: two parameters.
        let two = Target::Steps(vec![(region(0), 560.0), (region(80), 800.0)]);
        let both = calibrated(&start, 1.0, &noisy_blur(&truth, 1.0, &two, 0.02, 3), &two, &TWO);
        assert!(both.undetermined.is_empty() && (both.lens.focus[1] - 869.0).abs() < 20.0, "{both:?}");
        // Where both images have the same blur, V is 0 for any κ.
        let z = truth.depth(0.0, 1.0).unwrap();
        let none = Target::Steps(vec![(region(0), z)]);
        let blur = noisy_blur(&truth, 1.0, &none, 0.02, 4);
        let field = Values { width: SIZE[0] as u32, values: &blur };
        let result = calibrate(&start, 1.0, &field, &vec![0.05; blur.len()], &none, &[LensParameter::Kappa]);
        assert!(matches!(result, Err(Error::Region(m)) if m.contains("none of the unknowns")));
    }

    #[test]
    fn outliers_have_no_weight() {
        let (truth, target) = (cup(), plane(&cup()));
        let mut blur = noisy_blur(&truth, 1.0, &target, 0.02, 6);
        for (i, v) in blur.iter_mut().enumerate() {
            match i % SIZE[0] {
                20..60 if i / SIZE[0] > 70 => *v += 3.0,
                140.. => *v = f32::NAN,
                _ => {}
            }
        }
        let calibration = calibrated(&Lens { kappa: 0.5, ..truth }, 1.0, &blur, &target, &TWO);
        assert!((calibration.lens.kappa - 0.43).abs() < 0.01 && (calibration.lens.focus[1] - 869.0).abs() < 10.0);
        assert!(calibration.outliers >= 40 * 49 && calibration.residual_rms_px2 < 0.03);
        // 0.02 px² of 2.6 px² over 340 mm.
        assert!((1.0..6.0).contains(&calibration.residual_rms_mm.unwrap()));
    }

    #[test]
    fn an_invalid_target_is_refused() {
        let (lens, blur) = (cup(), vec![0.0f32; SIZE[0] * SIZE[1]]);
        let field = Values { width: SIZE[0] as u32, values: &blur };
        let outside = Region { x: 150, y: 0, width: 20, height: 5 };
        for target in [
            Target::Plane([529.0, 20.0, 700.0]),
            Target::Plane([529.0, f64::NAN, 700.0]),
            Target::Steps(vec![(outside, 600.0)]),
            Target::Steps(vec![(Region { x: 0, y: 0, width: 5, height: 5 }, 600.0)]),
            Target::Steps(vec![]),
        ] {
            assert!(calibrate(&lens, 1.0, &field, &vec![1.0; blur.len()], &target, &TWO).is_err(), "{target:?}");
        }
    }
}
