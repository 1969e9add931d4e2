//! Tails of the F distribution, and intervals of functions of mean squares.

use crate::base::random::Random;

/// The number of draws of an interval.
const DRAWS: usize = 10_000;
/// The stream of random numbers, apart from those of scenes and of noise.
const STREAM: u64 = 25_700;
/// The number of degrees of freedom from which chi-square is drawn by the cube of a Gaussian.
const MANY: f64 = 100.0;

/// A value with its 95 % confidence interval.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Interval {
    /// The value.
    pub value: f64,
    /// The lower end, in the unit of the value.
    pub low: f64,
    /// The upper end.
    pub high: f64,
}

/// Draws the true variances and means that would explain what was found, as the generalized pivotal
/// quantities of Weerahandi.
pub(super) struct Chance(Random);

impl Chance {
    /// Returns a standard Gaussian.
    pub(super) fn normal(&mut self) -> f64 {
        self.0.normal()
    }

    /// Returns a true variance for which a mean square of this many degrees of freedom was found: the mean square times
    /// the degrees over a draw of chi-square.
    pub(super) fn variance(&mut self, mean_square: f64, degrees: f64) -> f64 {
        mean_square * degrees / self.chi_square(degrees)
    }

    fn chi_square(&mut self, degrees: f64) -> f64 {
        if degrees > MANY {
            // Wilson and Hilferty 1931.
            let part = 2.0 / (9.0 * degrees);
            return degrees * (1.0 - part + part.sqrt() * self.0.normal()).powi(3);
        }
        (0..degrees as usize).map(|_| self.0.normal().powi(2)).sum::<f64>().max(f64::MIN_POSITIVE)
    }
}

/// Returns the values with their intervals: the 2.5 % and 97.5 % quantiles of seeded draws. A draw that is not finite
/// counts as the largest. `None` for a value that is not finite.
pub(super) fn intervals<const N: usize>(
    values: [f64; N],
    mut draw: impl FnMut(&mut Chance) -> [f64; N],
) -> [Option<Interval>; N] {
    let mut chance = Chance(Random::new(0, STREAM));
    let draws: Vec<[f64; N]> = (0..DRAWS).map(|_| draw(&mut chance)).collect();
    std::array::from_fn(|n| {
        let mut sorted: Vec<f64> =
            draws.iter().map(|draw| if draw[n].is_nan() { f64::INFINITY } else { draw[n] }).collect();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| sorted[(share * (DRAWS - 1) as f64).round() as usize];
        let value = values[n];
        value.is_finite().then(|| Interval { value, low: at(0.025).min(value), high: at(0.975).max(value) })
    })
}

/// Returns the probability that F with these degrees of freedom exceeds a value.
pub(super) fn f_tail(f: f64, [upper, lower]: [f64; 2]) -> f64 {
    if f.is_nan() || f <= 0.0 {
        return 1.0;
    }
    if f.is_infinite() { 0.0 } else { incomplete_beta(lower / (lower + upper * f), lower / 2.0, upper / 2.0) }
}

/// Returns the regularized incomplete beta function I_x(a, b), by its continued fraction (Abramowitz and Stegun
/// 26.5.8).
fn incomplete_beta(x: f64, a: f64, b: f64) -> f64 {
    // The fraction converges quickly below the mean.
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - incomplete_beta(1.0 - x, b, a);
    }
    if x <= 0.0 {
        return 0.0;
    }
    let front = (a * x.ln() + b * (1.0 - x).ln() + log_gamma(a + b) - log_gamma(a) - log_gamma(b)).exp() / a;
    let away = |v: f64| if v.abs() < 1e-300 { 1e-300 } else { v };
    // Lentz's algorithm.
    let (mut c, mut d) = (1.0, 1.0 / away(1.0 - (a + b) * x / (a + 1.0)));
    let mut fraction = d;
    for m in 1..500 {
        let m = f64::from(m);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let mut step = 1.0;
        for term in [even, odd] {
            d = 1.0 / away(1.0 + term * d);
            c = away(1.0 + term / c);
            step *= c * d;
        }
        fraction *= step;
        if (step - 1.0).abs() < 1e-14 {
            break;
        }
    }
    (front * fraction).clamp(0.0, 1.0)
}

/// Returns the logarithm of the gamma function of a positive number, by Stirling's series after a shift to at least 10.
fn log_gamma(x: f64) -> f64 {
    let steps = (10.0 - x).ceil().max(0.0) as usize;
    let shifted: f64 = (0..steps).map(|n| (x + n as f64).ln()).sum();
    let z = x + steps as f64;
    let series = (1.0 / 12.0 - (1.0 / 360.0 - (1.0 / 1260.0 - 1.0 / (1680.0 * z * z)) / (z * z)) / (z * z)) / z;
    (z - 0.5) * z.ln() - z + 0.5 * std::f64::consts::TAU.ln() + series - shifted
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tails_of_f_are_those_of_tables() {
        // The 5 % and 1 % points of tables (NIST/SEMATECH e-Handbook, 1.3.6.7.3), with four digits.
        for (f, degrees, tail) in [
            (4.965, [1.0, 10.0], 0.05),
            (3.493, [2.0, 20.0], 0.05),
            (2.165, [10.0, 30.0], 0.05),
            (10.044, [1.0, 10.0], 0.01),
            (2.979, [10.0, 30.0], 0.01),
        ] {
            assert!((f_tail(f, degrees) - tail).abs() < 2e-3 * tail, "{f}: {}", f_tail(f, degrees));
        }
        // With 2 and 2 degrees the tail is 1 / (1 + F).
        assert!((f_tail(3.0, [2.0, 2.0]) - 0.25).abs() < 1e-12);
        assert_eq!([0.0, f64::INFINITY].map(|f| f_tail(f, [2.0, 9.0])), [1.0, 0.0]);
        assert!((log_gamma(0.5) - 0.5 * std::f64::consts::PI.ln()).abs() < 1e-12 && log_gamma(1.0).abs() < 1e-12);
    }

    #[test]
    fn the_interval_of_a_variance_is_that_of_chi_square() {
        // 95 % of chi-square lie within 2.700 and 19.023 for 9 degrees, 162.73 and 241.06 for 200.
        for (degrees, [below, above]) in [(9.0, [2.700, 19.023]), (200.0, [162.73, 241.06])] {
            let [found] = intervals([4.0], |chance| [chance.variance(4.0, degrees)]);
            let found = found.unwrap();
            let expected = [4.0 * degrees / above, 4.0 * degrees / below];
            assert!((found.low / expected[0] - 1.0).abs() < 0.03, "{found:?}");
            assert!((found.high / expected[1] - 1.0).abs() < 0.04, "{found:?}");
        }
        assert_eq!(intervals([f64::NAN], |_| [1.0]), [None]);
    }
}
