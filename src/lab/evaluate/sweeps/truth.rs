//! How far a sweep's focus is off.

use crate::base::{Decode, Frame, Settings};
use crate::engine::Engine;
use crate::lab::evaluate::errors::Spread;
use crate::lab::evaluate::section::Case;
use crate::lab::evaluate::sigma::Sigma;
use crate::solve::focus_stack::{Positions, Sweep, SweepOptions, solve_sweep};

/// How far u is off, in frames; a pixel without an answer is off by more than any number.
pub(super) struct Errors {
    /// Median of the absolute error.
    pub mad: f64,
    /// Share of the pixels that are off by more than a frame.
    pub beyond: f64,
    /// Share of them that have no answer.
    pub unanswered: f64,
}

impl Errors {
    /// Of u and the truth, where there is one.
    pub(super) fn of(pixels: impl Iterator<Item = (f32, f32)>) -> Self {
        let known = pixels.filter(|(_, truth)| truth.is_finite());
        let off: Vec<f64> = known.map(|(u, truth)| f64::from(u - truth).abs()).collect();
        let share = |f: &dyn Fn(f64) -> bool| off.iter().filter(|e| f(**e)).count() as f64 / off.len() as f64;
        let (within, answered) = (share(&|e| e <= 1.0), share(&f64::is_finite));
        let off: Vec<Option<f64>> = off.iter().map(|e| e.is_finite().then_some(*e)).collect();
        Self { mad: Spread::of(&off).median, beyond: 1.0 - within, unanswered: 1.0 - answered }
    }

    /// A case with figures that are judged, but for the last.
    pub(super) fn judged(&self, name: String, most: f64) -> Case {
        let case = Case::new(name).at_most(MAD, self.mad, most).at_most(BEYOND, 100.0 * self.beyond, 0.2);
        case.told("no answer, %", 100.0 * self.unanswered)
    }

    /// A case for comparison.
    pub(super) fn told(&self, name: String) -> Case {
        Case::new(name).told(MAD, self.mad).told(BEYOND, 100.0 * self.beyond)
    }
}

const MAD: &str = "MAD, frames";
const BEYOND: &str = "off by more than a frame, %";

/// Solved by default settings, values as stored.
pub(super) fn solved(engine: &Engine, frames: &[Frame], positions: Vec<f64>) -> Result<Sweep, String> {
    let settings = Settings { decode: Decode::None, ..Settings::default() };
    let options = SweepOptions { settings, positions: Positions::Settings(positions), ..SweepOptions::default() };
    solve_sweep(engine, frames, &options).map_err(|e| e.to_string())
}

/// Errors and their σ of pixels of a sweep, of settings that count frames.
pub(super) fn judged(sweep: &Sweep, truth: &[f32], pixels: &[usize], name: String, most: f64) -> Case {
    let errors = Errors::of(pixels.iter().map(|&i| (sweep.focus[i], truth[i])));
    let off = |&i: &usize| (f64::from(sweep.focus[i] - truth[i]), f64::from(sweep.uncertainty[i]));
    Sigma::of(pixels.iter().map(off)).covering(errors.judged(name, most))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_no_answer_is_off_and_what_has_no_truth_is_left_out() {
        let nan = f32::NAN;
        let pixels = [(1.0, 1.5), (nan, 1.0), (3.0, nan), (2.0, 2.0), (5.0, 3.0)];
        let errors = Errors::of(pixels.into_iter());
        assert_eq!((errors.mad, errors.beyond, errors.unanswered), (2.0, 0.5, 0.25));
        let most: Vec<_> = errors.judged("x".to_string(), 2.0).figures.iter().map(|f| f.met).collect();
        assert_eq!(most, [Some(true), Some(false), None]);
        assert_eq!(Errors::of([].into_iter()).mad, f64::INFINITY);
    }
}
