//! The fixed smoothness α of least error.

use super::truth::weighed;
use crate::base::Settings;

/// Weights that are tried: two a decade.
const STEPS: [f64; 9] = [1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 3e-1, 1.0];

/// The best α and its error: downhill from a guess by noise, then once more where a parabola through the three best,
/// logarithms of α and error, has its vertex. An error has one minimum over α.
pub(super) fn best_weight(settings: &Settings, noise: f64, mut error: impl FnMut(&Settings) -> f64) -> [f64; 2] {
    let mut known = [f64::NAN; STEPS.len()];
    let mut at = |i: usize, error: &mut dyn FnMut(&Settings) -> f64| {
        if known[i].is_nan() {
            known[i] = error(&weighed(settings, STEPS[i]));
        }
        known[i]
    };
    // The best of the plane: 0.0003 without noise, 0.01, 0.03 and 0.1 at noise 0.003, 0.01 and 0.03.
    let mut best = STEPS.partition_point(|alpha| *alpha < 3.0 * noise).clamp(1, STEPS.len() - 2);
    loop {
        let [low, middle, high] = [best - 1, best, best + 1].map(|i| at(i, &mut error));
        let next = if low < middle { best - 1 } else { best + 1 };
        if low.min(high) >= middle || next == 0 || next == STEPS.len() - 1 {
            break;
        }
        best = next;
    }
    let three = [best - 1, best, best + 1].map(|i| [STEPS[i], known[i]]);
    let tried = vertex(three).map(|alpha| [alpha, error(&weighed(settings, alpha))]);
    three.into_iter().chain(tried).min_by(|a, b| a[1].total_cmp(&b[1])).unwrap_or([f64::NAN; 2])
}

/// Where the parabola through three points has its least value, within them; logarithms of both coordinates.
fn vertex(points: [[f64; 2]; 3]) -> Option<f64> {
    let [[x0, y0], [x1, y1], [x2, y2]] = points.map(|point| point.map(f64::ln));
    let (left, right) = ((y1 - y0) / (x1 - x0), (y2 - y1) / (x2 - x1));
    let curvature = (right - left) / (x2 - x0);
    let x = (x0 + x1) / 2.0 - left / (2.0 * curvature);
    (curvature > 0.0 && x > x0 && x < x2).then(|| x.exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_of_a_parabola_is_found_from_every_guess() {
        for least in [2e-4, 1.3e-3, 0.04] {
            for noise in [0.0, 0.003, 0.03] {
                let mut calls = 0;
                let error = |s: &Settings| {
                    calls += 1;
                    (0.1 * (s.regularization.unwrap() / least).ln().powi(2)).exp()
                };
                let [alpha, value] = best_weight(&Settings::default(), noise, error);
                assert!((alpha / least - 1.0).abs() < 1e-6 && (value - 1.0).abs() < 1e-9, "{alpha}, not {least}");
                assert!(calls <= STEPS.len() + 1);
            }
        }
    }

    #[test]
    fn an_error_that_falls_to_the_end_is_least_there() {
        let [alpha, _] = best_weight(&Settings::default(), 0.01, |s| 1.0 / s.regularization.unwrap());
        assert_eq!(alpha, 1.0);
    }
}
