//! Smooth fields over an image: polynomials of the place, and their fit.

use nalgebra::{DMatrix, DVector};

use crate::base::centre;
use crate::base::statistics::{self, TUKEY, tukey};

/// Largest sum of the exponents of x and y.
const DEGREE: usize = 4;
/// Number of terms.
pub(crate) const TERMS: usize = (DEGREE + 1) * (DEGREE + 2) / 2;
/// Number of terms up to the second degree. They are the first ones.
pub(crate) const QUADRATIC: usize = 6;
/// Rounds of reweighting: after the first few the weights hardly change.
const ROUNDS: usize = 8;

/// Returns the terms of a polynomial of fourth degree at a place, px: 1, x, y, x², xy, y², and so on, relative to the
/// image centre, in half diagonals.
pub(crate) fn terms([width, height]: [u32; 2], place: [f64; 2]) -> [f64; TERMS] {
    let centre = centre(width, height);
    let length = (f64::from(width).hypot(height.into()) / 2.0).max(1.0);
    let (x, y) = ((place[0] - centre[0]) / length, (place[1] - centre[1]) / length);
    let mut terms = [0.0; TERMS];
    let powers = (0..=DEGREE).flat_map(|degree| (0..=degree).map(move |j| (degree - j, j)));
    for (term, (i, j)) in terms.iter_mut().zip(powers) {
        *term = x.powi(i as i32) * y.powi(j as i32);
    }
    terms
}

/// Returns the sum of terms times their coefficients. Terms without a coefficient are left out.
pub(crate) fn sum(terms: &[f64], coefficients: &[f64]) -> f64 {
    terms.iter().zip(coefficients).map(|(term, c)| term * c).sum()
}

/// Returns whether each ninth of an image has a place. Elsewhere a polynomial would extrapolate, which is inaccurate.
pub(crate) fn covers([width, height]: [u32; 2], places: impl Iterator<Item = [f64; 2]>) -> bool {
    let mut ninths = [false; 9];
    for [x, y] in places {
        let third = |at: f64, side: u32| ((3.0 * at / f64::from(side.max(1))) as usize).min(2);
        ninths[3 * third(y, height) + third(x, width)] = true;
    }
    ninths.iter().all(|is_covered| *is_covered)
}

/// A measured value, the terms whose weighted sum it is, and the weight of the measurement.
#[derive(Clone, Debug)]
pub(crate) struct Equation {
    pub(crate) terms: DVector<f64>,
    pub(crate) value: f64,
    pub(crate) weight: f64,
}

/// A solution of equations.
pub(crate) struct RobustFit {
    pub(crate) coefficients: DVector<f64>,
    /// The value of each equation minus the fit.
    pub(crate) residuals: Vec<f64>,
    /// The robust standard deviation of the residuals.
    deviation: f64,
}

impl RobustFit {
    /// Solves equations by least squares, reweighted by Tukey's function against outliers. `None` if they do not
    /// determine the coefficients.
    pub(crate) fn new(equations: &[Equation]) -> Option<Self> {
        let mut robust = vec![1.0; equations.len()];
        let (mut coefficients, mut residuals, mut deviation) = (DVector::zeros(0), Vec::new(), 0.0);
        for _ in 0..ROUNDS {
            let (normal, right) = normal(equations, |i| equations[i].weight * robust[i])?;
            coefficients = normal.cholesky()?.solve(&right);
            residuals = equations.iter().map(|e| e.value - sum(e.terms.as_slice(), coefficients.as_slice())).collect();
            deviation = statistics::deviation(&residuals).max(1e-12);
            robust = residuals.iter().map(|r| tukey(r / deviation)).collect();
        }
        coefficients.iter().all(|c| c.is_finite()).then_some(Self { coefficients, residuals, deviation })
    }

    /// Returns the covariance of the coefficients if the errors of the equations are independent: that of weighted
    /// least squares (White 1980), times the square of a factor because the weights follow the residuals (Huber 1981).
    pub(crate) fn covariance(&self, equations: &[Equation]) -> Option<DMatrix<f64>> {
        let in_deviations = |i: usize| self.residuals[i] / self.deviation;
        let robust = |i: usize| equations[i].weight * tukey(in_deviations(i));
        // The derivative of a residual times its weight.
        let derivative = |i: usize| {
            let square = (in_deviations(i) / TUKEY).powi(2).min(1.0);
            equations[i].weight * (1.0 - square) * (1.0 - 5.0 * square)
        };
        let total = |of: &dyn Fn(usize) -> f64| (0..equations.len()).map(of).sum::<f64>();
        let factor = total(&robust) / total(&derivative);
        let inverse = normal(equations, robust)?.0.try_inverse()?;
        let (spread, _) = normal(equations, |i| (robust(i) * self.residuals[i]).powi(2))?;
        (factor > 0.0).then(|| &inverse * spread * &inverse * factor.powi(2))
    }
}

/// Returns the matrix and the right side of the normal equations. `None` if there are no equations.
fn normal(equations: &[Equation], weight: impl Fn(usize) -> f64) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let count = equations.first()?.terms.len();
    let (mut normal, mut right) = (DMatrix::zeros(count, count), DVector::zeros(count));
    for (i, equation) in equations.iter().enumerate() {
        let weight = weight(i);
        normal.ger(weight, &equation.terms, &equation.terms, 1.0);
        right.axpy(weight * equation.value, &equation.terms, 1.0);
    }
    // A diagonal that is larger by a millionth limits the terms that the places hardly determine.
    for i in 0..count {
        normal[(i, i)] *= 1.0 + 1e-6;
    }
    Some((normal, right))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [u32; 2] = [300, 200];

    fn places() -> impl Iterator<Item = [f64; 2]> {
        (0..20).flat_map(|y| (0..30).map(move |x| [10.0 * f64::from(x), 10.0 * f64::from(y)]))
    }

    #[test]
    fn a_bowl_is_fitted_despite_outliers() {
        let bowl = |[x, y]: [f64; 2]| 2.0 + 1e-4 * ((x - 120.0).powi(2) + (y - 90.0).powi(2)) + 1e-9 * x.powi(4);
        let equation = |(i, place): (usize, [f64; 2])| Equation {
            terms: DVector::from_column_slice(&terms(SIZE, place)),
            value: bowl(place) + if i % 7 == 0 { 50.0 } else { 0.0 },
            weight: 1.0,
        };
        let equations: Vec<Equation> = places().enumerate().map(equation).collect();
        let fit = RobustFit::new(&equations).unwrap();
        for (place, equation) in places().zip(&equations) {
            let found = equation.terms.dot(&fit.coefficients);
            assert!((found - bowl(place)).abs() < 0.02, "{place:?}: {found} {}", bowl(place));
        }
    }

    #[test]
    fn covariances_agree_with_the_scatter_over_noise() {
        let trials: Vec<(f64, f64)> = (0..200)
            .map(|seed| {
                let mut random = crate::base::random::Random::new(seed, 0);
                let mut equation = |place| Equation {
                    terms: DVector::from_column_slice(&terms(SIZE, place)[..QUADRATIC]),
                    value: random.normal(),
                    weight: 0.3,
                };
                let equations: Vec<Equation> = places().map(&mut equation).collect();
                let fit = RobustFit::new(&equations).unwrap();
                (fit.coefficients[3], fit.covariance(&equations).unwrap()[(3, 3)].sqrt())
            })
            .collect();
        let mean_square = |of: &dyn Fn(&(f64, f64)) -> f64| trials.iter().map(|t| of(t).powi(2)).sum::<f64>() / 200.0;
        let ratio = (mean_square(&|t| t.1) / mean_square(&|t| t.0)).sqrt();
        assert!((0.85..1.15).contains(&ratio), "{ratio}");
    }

    #[test]
    fn values_in_a_third_of_the_frame_do_not_cover_it() {
        assert!(covers(SIZE, places()));
        assert!(!covers(SIZE, places().filter(|[x, _]| (100.0..200.0).contains(x))));
    }

    #[test]
    fn too_few_values_have_no_fit() {
        let terms = DVector::from_column_slice(&terms(SIZE, [3.0, 4.0]));
        assert!(RobustFit::new(&[]).is_none());
        assert!(RobustFit::new(&vec![Equation { terms, value: 1.0, weight: 0.0 }; 30]).is_none());
    }
}
