//! Calibration of a lens from targets of known depth.
//!
//! Relative blur is a polynomial in x, a function of depth ([`Lens`]): `V = c0 + c1 x + c2 x²`. The coefficients depend
//! on κ and the focus distances, x does not. The parameters minimize the weighted squared residuals of V by the
//! Levenberg-Marquardt method. The weight of a pixel is its confidence times a robust weight: first Huber's, which
//! converges from a distant start, then Tukey's, which excludes outliers.
//!
//! V is almost linear in x, so that a target determines two of the three parameters, and a single depth one.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use crate::base::statistics::{Estimate, TUKEY, correlation_area, deviation, tukey};
use crate::base::{BlurToDepth, Error, Lens};
use crate::metric::field::{self, CalibratedField};
use crate::metric::target::{Sample, Samples, SolvedTarget};

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
    /// How much V changes over the field, by two targets. What they determine is in the lens.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub field: Option<CalibratedField>,
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

/// The largest standard error of a determined parameter, in its scaled units ([`Fit`]).
const MAX_ERROR: f64 = 0.5;
/// The smallest eigenvalue of the normal matrix, scaled to a unit diagonal, of determined parameters.
const MIN_EIGENVALUE: f64 = 1e-9;
/// The threshold of Huber's weight in standard deviations, for 95 % efficiency under Gaussian noise.
const HUBER: f64 = 1.345;

/// Estimates the parameters `unknowns` from V of targets, starting from the stated lens.
///
/// Two planes that fill the frame, at different distances, also determine how V changes over the field. The lens then
/// holds at the image centre. With one target, the stated lens's field stays. If the targets do not determine all
/// parameters, the last ones keep their stated values.
///
/// # Errors
/// [`Error::Setting`] for an invalid lens or depth. [`Error::Region`] for a region outside the image, too few valid
/// pixels, or targets that do not determine the first parameter or the field. [`Error::Mismatch`] for targets of
/// different sizes, or of another size than the lens's field.
pub fn calibrate(start: &Lens, targets: &[SolvedTarget<'_>], unknowns: &[LensParameter]) -> Result<Calibration, Error> {
    start.check()?;
    let mut samples = Samples::new(start, targets)?;
    if targets.len() < 2 {
        if let Some(field) = &start.field {
            if field.size != samples.size {
                let ([w, h], [width, height]) = (field.size, samples.size);
                let problem =
                    format!("the field of the lens is of {w}x{h} photographs, and the results are {width}x{height}");
                return Err(Error::Mismatch(problem));
            }
            samples.move_to_centre(field);
        }
        return fit(start, &samples, unknowns);
    }
    let even = fit(&Lens { field: None, ..*start }, &samples, unknowns)?;
    let (field, found) = field::fit(&even.lens, &samples)?;
    if let Some(field) = &field {
        samples.move_to_centre(field);
    }
    Ok(Calibration { field: Some(found), ..fit(&Lens { field, ..*start }, &samples, unknowns)? })
}

/// Estimates as many of the parameters as the samples determine.
fn fit(start: &Lens, samples: &Samples, unknowns: &[LensParameter]) -> Result<Calibration, Error> {
    let fits = (1..=unknowns.len()).rev().map(|count| {
        let fit = Fit { start, samples, unknowns: &unknowns[..count] };
        fit.run(&unknowns[count..])
    });
    fits.flatten().next().ok_or_else(|| {
        Error::Region(
            "the target determines none of the unknowns: give depths that differ more, nearer to one focus than to the other"
                .to_string(),
        )
    })
}

/// A fit of some parameters, in scaled units: the logarithm of κ over its start, and the change of a focus distance
/// over the distance between the two.
struct Fit<'a> {
    start: &'a Lens,
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
        let inverses: Vec<BlurToDepth> = self.samples.scales.iter().map(|&scale| lens.inverse(scale)).collect();
        let in_mm = used.clone().filter_map(|(s, _)| Some(inverses[s.target].depth(s.v)? - s.z));
        Calibration {
            lens: *lens,
            found,
            undetermined: undetermined.to_vec(),
            field: None,
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
        let polynomials: Vec<[f64; 3]> = self.samples.scales.iter().map(|&scale| lens.polynomial(scale)).collect();
        let residual = |s: &Sample| {
            let [c0, c1, c2] = polynomials[s.target];
            if s.weight > 0.0 { s.v - (c0 + s.x * (c1 + s.x * c2)) } else { f64::NAN }
        };
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
        let (mut normal, mut gradient) = (DMatrix::zeros(at.len(), at.len()), DVector::zeros(at.len()));
        for (target, &scale) in self.samples.scales.iter().enumerate() {
            // J is K (1, x, x²), so that only sums of powers of x are needed.
            let derivatives = self.derivatives(at, scale);
            let (mut powers, mut moments) = (Matrix3::zeros(), Vector3::zeros());
            let own = |s: &Sample| s.target == target && s.weight > 0.0;
            let samples = self.samples.pixels.iter().zip(residuals).enumerate();
            for (i, (s, r)) in samples.filter(|(_, (s, _))| own(s)) {
                let basis = Vector3::new(1.0, s.x, s.x * s.x);
                let w = weight(i);
                powers.ger(w, &basis, &basis, 1.0);
                moments.axpy(w * r, &basis, 1.0);
            }
            normal += &derivatives * powers * derivatives.transpose();
            gradient += derivatives * moments;
        }
        (normal, gradient)
    }

    /// Returns the derivatives of the polynomial's coefficients, one row per parameter, by central differences.
    fn derivatives(&self, at: &[f64], scale: f64) -> DMatrix<f64> {
        const STEP: f64 = 1e-5;
        let moved = |unknown: usize, by: f64| {
            let mut moved = at.to_vec();
            moved[unknown] += by;
            self.lens(&moved).polynomial(scale)
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
    use crate::base::{LensField, Region};
    use crate::metric::Target;
    use crate::metric::measure::Values;

    const SIZE: [usize; 2] = [160, 120];

    fn cup() -> Lens {
        let (pixel_pitch, focus) = (0.01304, [529.0, 869.0]);
        Lens { focal_length: 25.0, f_number: 8.3, pixel_pitch, focus, kappa: 0.43, telecentric: true, field: None }
    }

    fn macro_lens() -> Lens {
        let (pixel_pitch, focus) = (0.0075, [226.5, 233.5]);
        Lens { focal_length: 50.0, f_number: 5.6, pixel_pitch, focus, kappa: 0.43, telecentric: false, field: None }
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
        let calibration = result(start, &[(scale, blur, target)], unknowns).unwrap();
        println!("{calibration:?}");
        calibration
    }

    /// Calibrates by s, V and depth of each target.
    fn result(
        start: &Lens,
        targets: &[(f64, &[f32], &Target)],
        unknowns: &[LensParameter],
    ) -> Result<Calibration, Error> {
        let confidence = vec![0.05; SIZE[0] * SIZE[1]];
        let solved = targets.iter().map(|&(scale, blur, target)| SolvedTarget {
            target: target.clone(),
            blur: Values { width: SIZE[0] as u32, values: blur },
            confidence: &confidence,
            scale,
        });
        calibrate(start, &solved.collect::<Vec<_>>(), unknowns)
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
        let result = result(&start, &[(1.0, &blur, &none)], &[LensParameter::Kappa]);
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
        let outside = Region { x: 150, y: 0, width: 20, height: 5 };
        for target in [
            Target::Plane([529.0, 20.0, 700.0]),
            Target::Plane([529.0, f64::NAN, 700.0]),
            Target::Steps(vec![(outside, 600.0)]),
            Target::Steps(vec![(Region { x: 0, y: 0, width: 5, height: 5 }, 600.0)]),
            Target::Steps(vec![]),
        ] {
            assert!(result(&lens, &[(1.0, &blur, &target)], &TWO).is_err(), "{target:?}");
        }
    }

    /// V of a plane at one depth under a field, with correlated noise.
    fn under(field: &LensField, lens: &Lens, z: f64, noise: f64, seed: u64) -> Vec<f32> {
        let mut blur = noisy_blur(lens, 1.0, &Target::Plane([z; 3]), 0.0, 0);
        let noise: Vec<f64> = smooth_noise(SIZE, 1.5, seed).into_iter().map(|n| noise * n).collect();
        for (i, (v, noise)) in blur.iter_mut().zip(noise).enumerate() {
            let [gain, offset] = field.at([(i % SIZE[0]) as f64, (i / SIZE[0]) as f64]);
            *v = (gain * f64::from(*v) + offset + noise) as f32;
        }
        blur
    }

    fn bowed() -> LensField {
        let mut offset = [0.0; 14];
        (offset[2], offset[4], offset[5]) = (0.3, 0.4, -0.1);
        LensField { size: SIZE.map(|side| side as u32), gain: [-0.06, 0.0, -0.15, 0.05, -0.2], offset }
    }

    #[test]
    fn two_planes_determine_gain_and_offset_over_the_field() {
        let (truth, field, planes) = (cup(), bowed(), [560.0, 800.0]);
        let start = Lens { kappa: 0.5, focus: [529.0, 820.0], ..truth };
        let targets = planes.map(|z| Target::Plane([z; 3]));
        let calibrated = |noise: f64, seed: u64| {
            let blurs = [0, 1].map(|i| under(&field, &truth, planes[i], noise, 2 * seed + i as u64));
            result(&start, &[(1.0, &blurs[0], &targets[0]), (1.0, &blurs[1], &targets[1])], &TWO).unwrap()
        };
        let exact = calibrated(0.0, 1);
        assert!((exact.lens.kappa - 0.43).abs() < 1e-4 && (exact.lens.focus[1] - 869.0).abs() < 0.1, "{exact:?}");
        let off = |found: &LensField, of: usize| {
            let squares =
                LensField::places(field.size).map(|place| (found.at(place)[of] - field.at(place)[of]).powi(2));
            (squares.sum::<f64>() / LensField::places(field.size).count() as f64).sqrt()
        };
        assert!([0, 1].into_iter().all(|of| off(&exact.lens.field.unwrap(), of) < 1e-4), "{exact:?}");
        let mut errors = [[0.0; 2]; 2];
        for seed in 1..13 {
            let noisy = calibrated(0.05, seed);
            let (found, claimed) = (noisy.lens.field.unwrap(), noisy.field.unwrap());
            for (of, estimate) in [(0, claimed.gain), (1, claimed.offset)] {
                errors[of][0] += off(&found, of).powi(2);
                errors[of][1] += estimate.standard_error.powi(2);
            }
        }
        for [actual, claimed] in errors {
            let ratio = (claimed / actual).sqrt();
            println!("off by {:.4} rms, claimed {:.4}", (actual / 12.0).sqrt(), (claimed / 12.0).sqrt());
            assert!((0.6..1.7).contains(&ratio), "{errors:?}");
        }
    }

    #[test]
    fn a_field_that_is_even_or_not_determined_is_left_out() {
        let (truth, even) = (cup(), LensField { gain: [0.0; 5], offset: [0.0; 14], ..bowed() });
        let found = |field: &LensField, planes: [f64; 2], unknowns: &[LensParameter]| {
            let targets = planes.map(|z| Target::Plane([z; 3]));
            let blurs = [0, 1].map(|i| under(field, &truth, planes[i], 0.05, 40 + i as u64));
            result(&truth, &[(1.0, &blurs[0], &targets[0]), (1.0, &blurs[1], &targets[1])], unknowns).unwrap()
        };
        let level = found(&even, [560.0, 800.0], &TWO);
        assert!(level.lens.field.is_none() && level.field.unwrap().gain.value < 0.02, "{level:?}");
        // Planes at almost the same distance determine the sum of gain and offset only.
        let near = found(&bowed(), [560.0, 562.0], &[LensParameter::Kappa]);
        assert_eq!(near.lens.field.unwrap().gain, [0.0; 5], "{near:?}");
        let curved = LensField { gain: [0.0; 5], ..bowed() };
        let offset = found(&curved, [560.0, 800.0], &TWO).lens.field.unwrap();
        assert!(offset.gain == [0.0; 5] && (offset.offset[2] - 0.3).abs() < 0.2, "{offset:?}");
    }

    #[test]
    fn one_target_keeps_the_field_and_planes_that_do_not_fill_the_frame_are_refused() {
        let (truth, field) = (cup(), bowed());
        let blur = under(&field, &truth, 800.0, 0.0, 0);
        let (plane, other) = (Target::Plane([800.0; 3]), Target::Plane([560.0; 3]));
        let start = Lens { kappa: 0.5, field: Some(field), ..truth };
        let one = result(&start, &[(1.0, &blur, &plane)], &[LensParameter::Kappa]).unwrap();
        assert!((one.lens.kappa - 0.43).abs() < 1e-4 && one.lens.field == Some(field) && one.field.is_none());
        let of_others = Lens { field: Some(LensField { size: [320, 240], ..field }), ..start };
        let refused = result(&of_others, &[(1.0, &blur, &plane)], &[LensParameter::Kappa]).unwrap_err().to_string();
        assert!(refused.contains("320x240") && refused.contains("160x120"), "{refused}");
        let mut half = under(&field, &truth, 560.0, 0.0, 0);
        half.iter_mut().enumerate().filter(|(i, _)| i % SIZE[0] > 100).for_each(|(_, v)| *v = f32::NAN);
        let refused = result(&start, &[(1.0, &blur, &plane), (1.0, &half, &other)], &TWO).unwrap_err().to_string();
        assert!(refused.contains("fill the frame"), "{refused}");
    }
}
