//! How V changes over the field of a lens, from planes at two distances.
//!
//! V of a plane is `(1 + g) P + o` at each place: P is that of the lens at the plane's depth, the gain g and the offset
//! o are polynomials of the place. One plane determines their sum only. Two planes with different P determine both.

use nalgebra::{DMatrix, DVector};

use crate::base::smooth_field::{Equation, QUADRATIC, RobustFit, TERMS, terms};
use crate::base::statistics::{Estimate, correlation_area};
use crate::base::{Error, Lens, LensField};
use crate::metric::target::Samples;

/// How much V changes over the field, as calibrated: root mean squares over the frame, and their standard errors.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct CalibratedField {
    /// Of the gain.
    pub gain: Estimate,
    /// Of the offset, px².
    #[cfg_attr(feature = "serde", serde(rename = "offset_px2"))]
    pub offset: Estimate,
}

/// A gain or an offset counts if its root mean square is this many standard errors. A polynomial that is fitted to
/// noise has about 1.
const LEAST_ERRORS: f64 = 2.0;

/// Fits gain and offset. What the targets do not determine is 0; the field is `None` if they determine neither.
pub(super) fn fit(lens: &Lens, samples: &Samples) -> Result<(Option<LensField>, CalibratedField), Error> {
    let undetermined = "V of the targets does not determine the field: photograph textured planes that fill the frame";
    let polynomials: Vec<[f64; 3]> = samples.scales.iter().map(|&scale| lens.polynomial(scale)).collect();
    let valid: Vec<usize> = (0..samples.pixels.len()).filter(|&i| samples.pixels[i].weight > 0.0).collect();
    let solve = |[is_gain, is_offset]: [bool; 2]| {
        let (gains, offsets) = (if is_gain { QUADRATIC } else { 1 }, if is_offset { TERMS } else { 1 });
        let equation = |&i: &usize| {
            let sample = samples.pixels[i];
            let [c0, c1, c2] = polynomials[sample.target];
            let (of_lens, terms) = (c0 + sample.x * (c1 + sample.x * c2), terms(samples.size, sample.place));
            let gain = terms[..gains].iter().map(|term| of_lens * term);
            let all: Vec<f64> = gain.chain(terms[..offsets].iter().copied()).collect();
            Equation { terms: DVector::from_vec(all), value: sample.v, weight: sample.weight }
        };
        let equations: Vec<Equation> = valid.iter().map(equation).collect();
        let fit = RobustFit::new(&equations)?;
        let mut residuals = vec![f64::NAN; samples.pixels.len()];
        valid.iter().zip(&fit.residuals).for_each(|(&i, r)| residuals[i] = *r);
        let covariance = fit.covariance(&equations)? * correlation_area(&residuals, samples.width);
        // Relative to the centre, whose V is `middle P + constant`.
        let c = fit.coefficients.as_slice();
        let (middle, constant) = (c[0], c[gains]);
        let mut field = LensField { size: samples.size, gain: [0.0; QUADRATIC - 1], offset: [0.0; TERMS - 1] };
        field.gain.iter_mut().zip(&c[1..gains]).for_each(|(g, c)| *g = c / middle);
        field.offset.iter_mut().zip(&c[gains + 1..]).for_each(|(o, c)| *o = *c);
        // `(middle + G) P + constant + O = (1 + g)(middle P + constant) + O - g constant`
        field.offset.iter_mut().zip(&field.gain).for_each(|(o, g)| *o -= g * constant);
        let of_gain = covariance.view((1, 1), (gains - 1, gains - 1)) / middle.powi(2);
        let of_offset = covariance.view((gains + 1, gains + 1), (offsets - 1, offsets - 1)).into_owned();
        let estimates = [
            estimate(samples.size, &field.gain[..gains - 1], of_gain),
            estimate(samples.size, &field.offset[..offsets - 1], of_offset),
        ];
        Some((field, estimates))
    };
    let failed = || Error::Region(undetermined.to_string());
    if !samples.cover_the_frame() {
        return Err(failed());
    }
    let counts = |estimate: &Estimate| estimate.value > LEAST_ERRORS * estimate.standard_error;
    let (mut kept, mut found) = ([true; 2], [Estimate { value: 0.0, standard_error: 0.0 }; 2]);
    loop {
        let (field, estimates) = solve(kept).ok_or_else(failed)?;
        (0..2).filter(|&k| kept[k]).for_each(|k| found[k] = estimates[k]);
        // If the planes hardly differ, V determines only the sum of both. The offset alone is then tried.
        match (0..2).find(|&k| kept[k] && !counts(&estimates[k])) {
            Some(dropped) => kept[dropped] = false,
            None => {
                let [gain, offset] = found;
                field.check()?;
                return Ok(((kept != [false; 2]).then_some(field), CalibratedField { gain, offset }));
            }
        }
    }
}

/// Returns the root mean square over the frame of a polynomial without a constant, and its standard error.
fn estimate(size: [u32; 2], coefficients: &[f64], covariance: DMatrix<f64>) -> Estimate {
    let coefficients = DVector::from_column_slice(coefficients);
    let (mut square, mut variance, mut count) = (0.0, 0.0, 0.0);
    for place in LensField::places(size) {
        let terms = DVector::from_column_slice(&terms(size, place)[1..][..coefficients.len()]);
        square += terms.dot(&coefficients).powi(2);
        variance += terms.dot(&(&covariance * &terms));
        count += 1.0;
    }
    Estimate { value: f64::sqrt(square / count), standard_error: f64::sqrt(variance / count) }
}
