//! A smooth field over an image: a polynomial in both directions, fitted to what is known at some places.

use nalgebra::{DMatrix, DVector};

use crate::base::statistics::{deviation, tukey};

/// Sum of the powers of x and y at most.
const DEGREE: usize = 4;
/// Coefficients.
const TERMS: usize = (DEGREE + 1) * (DEGREE + 2) / 2;
/// Rounds of reweighting: after the first few the weights hardly change.
const ROUNDS: usize = 8;

/// A polynomial of fourth degree in the place, from the image centre in half diagonals.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SmoothField {
    centre: [f64; 2],
    length: f64,
    coefficients: [f64; TERMS],
}

/// A value at a place, px, and its weight.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Known {
    pub(crate) place: [f64; 2],
    pub(crate) value: f64,
    pub(crate) weight: f64,
}

/// Whether there is something known in each ninth of an image: beyond what is known a polynomial goes anywhere.
pub(crate) fn covers([width, height]: [u32; 2], known: &[Known]) -> bool {
    let mut ninths = [false; 9];
    for k in known.iter().filter(|k| k.weight > 0.0) {
        let third = |at: f64, side: u32| ((3.0 * at / f64::from(side.max(1))) as usize).min(2);
        ninths[3 * third(k.place[1], height) + third(k.place[0], width)] = true;
    }
    ninths.iter().all(|known| *known)
}

impl SmoothField {
    /// Fits values over an image of `width` x `height` pixels by least squares, reweighted by Tukey's function so that
    /// outliers have no say; `None` where the places do not determine it.
    pub(crate) fn fit([width, height]: [u32; 2], known: &[Known]) -> Option<Self> {
        let centre = crate::base::centre(width, height);
        let length = (f64::from(width).hypot(height.into()) / 2.0).max(1.0);
        let mut field = Self { centre, length, coefficients: [0.0; TERMS] };
        let terms: Vec<[f64; TERMS]> = known.iter().map(|k| field.terms(k.place)).collect();
        let mut robust = vec![1.0; known.len()];
        for _ in 0..ROUNDS {
            field.coefficients = least_squares(&terms, known, &robust)?;
            let residuals: Vec<f64> = known.iter().map(|k| k.value - field.at(k.place)).collect();
            let deviation = deviation(&residuals).max(1e-12);
            robust = residuals.into_iter().map(|r| tukey(r / deviation)).collect();
        }
        Some(field)
    }

    /// Its value at a place, px.
    pub(crate) fn at(&self, place: [f64; 2]) -> f64 {
        self.terms(place).iter().zip(&self.coefficients).map(|(term, c)| term * c).sum()
    }

    /// The same with the value at the image centre taken off.
    pub(crate) fn above_centre(&self, place: [f64; 2]) -> f64 {
        self.at(place) - self.coefficients[0]
    }

    fn terms(&self, [x, y]: [f64; 2]) -> [f64; TERMS] {
        let (x, y) = ((x - self.centre[0]) / self.length, (y - self.centre[1]) / self.length);
        let mut terms = [0.0; TERMS];
        let powers = (0..=DEGREE).flat_map(|degree| (0..=degree).map(move |j| (degree - j, j)));
        for (term, (i, j)) in terms.iter_mut().zip(powers) {
            *term = x.powi(i as i32) * y.powi(j as i32);
        }
        terms
    }
}

fn least_squares(terms: &[[f64; TERMS]], known: &[Known], robust: &[f64]) -> Option<[f64; TERMS]> {
    let (mut normal, mut right) = (DMatrix::zeros(TERMS, TERMS), DVector::zeros(TERMS));
    for ((term, known), robust) in terms.iter().zip(known).zip(robust) {
        let term = DVector::from_column_slice(term);
        let weight = known.weight * robust;
        normal.ger(weight, &term, &term, 1.0);
        right.axpy(weight * known.value, &term, 1.0);
    }
    // A millionth of the diagonal keeps terms that the places hardly determine from growing.
    for i in 0..TERMS {
        normal[(i, i)] *= 1.0 + 1e-6;
    }
    let solved = normal.cholesky()?.solve(&right);
    let mut coefficients = [0.0; TERMS];
    coefficients.copy_from_slice(solved.as_slice());
    coefficients.iter().all(|c: &f64| c.is_finite()).then_some(coefficients)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn places() -> impl Iterator<Item = [f64; 2]> {
        (0..20).flat_map(|y| (0..30).map(move |x| [10.0 * f64::from(x), 10.0 * f64::from(y)]))
    }

    #[test]
    fn a_bowl_is_found_in_spite_of_outliers() {
        let bowl = |[x, y]: [f64; 2]| 2.0 + 1e-4 * ((x - 120.0).powi(2) + (y - 90.0).powi(2)) + 1e-9 * x.powi(4);
        let known: Vec<Known> = places()
            .enumerate()
            .map(|(i, place)| Known { place, value: bowl(place) + if i % 7 == 0 { 50.0 } else { 0.0 }, weight: 1.0 })
            .collect();
        let field = SmoothField::fit([300, 200], &known).unwrap();
        for place in places() {
            assert!((field.at(place) - bowl(place)).abs() < 0.02, "{place:?}: {} {}", field.at(place), bowl(place));
        }
        let centre = crate::base::centre(300, 200);
        assert!(field.above_centre(centre).abs() < 1e-12);
    }

    #[test]
    fn a_third_of_the_frame_does_not_cover_it() {
        let known = |places: Vec<[f64; 2]>| -> Vec<Known> {
            places.into_iter().map(|place| Known { place, value: 1.0, weight: 1.0 }).collect()
        };
        assert!(covers([300, 200], &known(places().collect())));
        assert!(!covers([300, 200], &known(places().filter(|[x, _]| (100.0..200.0).contains(x)).collect())));
    }

    #[test]
    fn too_little_to_go_by_is_none() {
        let one = Known { place: [3.0, 4.0], value: 1.0, weight: 1.0 };
        assert_eq!(SmoothField::fit([300, 200], &[]), None);
        assert_eq!(SmoothField::fit([300, 200], &[Known { weight: 0.0, ..one }; 30]), None);
    }
}
