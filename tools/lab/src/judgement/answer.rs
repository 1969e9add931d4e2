//! What is asked, what the program answers, and the definition of "noticed".

use parfocal::{
    Error, Frame, Region, Settings, Solution, SolveOptions,
    internals::scene::{Scene, SimulatedSweep, SweepScene},
    internals::stages::uncertainty::LARGEST,
    settings::Decode,
    sweep::{Sweep, SweepOptions, SweepSolver},
    transform::centre,
};

use super::alterations::DEEP;
use crate::pairs::KnownPair;
use crate::section::{Runner, number};

/// A pixel is off if its error exceeds this multiple of its standard deviation: 0.3 % of Gaussian errors do.
pub(crate) const BEYOND: f64 = 3.0;
/// The largest share of the valid pixels concerned that may be off. Errors of neighbours are alike, so that a single
/// bend of V takes a few per cent of a small picture.
pub(crate) const MOST_BEYOND: f64 = 0.05;
/// The largest error of T that counts as right, px. It is four times the paper's bound for a registration that failed.
pub(crate) const MOST_CORNER: f64 = 1.0;

/// Photographs to solve, with their truth.
pub(crate) enum Input {
    Pair(Box<Pair>),
    Sweep {
        frames: Vec<Frame>,
        /// u at each pixel, frames; NaN: no value is right.
        focus: Vec<f32>,
    },
}

/// A pair of photographs with its truth.
pub(crate) struct Pair {
    /// The pair. Where its V is NaN, no value is right.
    pub known: KnownPair,
    /// Whether `known.transform` is true for the whole pair. If not, T is not judged.
    pub has_transform: bool,
    /// The part to solve.
    pub region: Option<Region>,
    /// The parts of I1 that are concerned, px. Each is judged alone, and the worst counts.
    pub parts: Vec<Region>,
}

impl Pair {
    /// A rendered pair whose every pixel is concerned.
    pub(crate) fn render(scene: &Scene) -> Result<Self, Error> {
        let known = KnownPair::render(scene).map_err(Error::Mismatch)?;
        let parts = vec![Region { x: 0, y: 0, width: scene.width, height: scene.height }];
        Ok(Self { known, has_transform: true, region: None, parts })
    }

    /// States that no V of a part of I1 is right.
    pub(crate) fn without_truth(mut self, part: Region) -> Self {
        let width = self.known.images[0].width();
        let values = self.known.relative_blur.iter_mut().enumerate();
        values.filter(|(i, _)| contains(part, *i, width)).for_each(|(_, v)| *v = f32::NAN);
        self
    }
}

impl From<Pair> for Input {
    fn from(pair: Pair) -> Self {
        Self::Pair(Box::new(pair))
    }
}

impl Input {
    pub(crate) fn sweep(scene: &SweepScene) -> Result<Self, Error> {
        let SimulatedSweep { frames, focus, .. } = scene.render()?;
        Ok(Self::Sweep { frames, focus })
    }

    /// A sweep at whose pixels no focus is right.
    pub(crate) fn without_focus(frames: Vec<Frame>) -> Self {
        let pixels = frames.first().map_or(0, |frame| frame.width() as usize * frame.height() as usize);
        Self::Sweep { frames, focus: vec![f32::NAN; pixels] }
    }

    /// Solves the input with default settings; only an asymmetric kernel is stated.
    ///
    /// # Errors
    /// Those that do not concern the input.
    pub(crate) fn solve(&self, runner: &mut Runner) -> Result<Answer, Error> {
        let answer = match self {
            Self::Pair(pair) => solve_pair(runner, pair),
            Self::Sweep { frames, focus } => solve_sweep(runner, frames, focus),
        };
        match answer {
            Err(e @ (Error::Mismatch(_) | Error::TooSmall { .. } | Error::Region(_))) => {
                Ok(Answer::Refused(e.to_string()))
            }
            answer => answer,
        }
    }
}

fn solve_pair(runner: &mut Runner, pair: &Pair) -> Result<Answer, Error> {
    let settings = Settings { decode: Decode::Auto, ..pair.known.default_settings() };
    let options = SolveOptions { region: pair.region, ..SolveOptions::default() };
    let solution = runner.attempt(pair.known.images.each_ref(), &settings, &options)?;
    let corner = pair.has_transform.then(|| displacement(&solution, pair));
    let field = |i: usize| pixel_of(&solution, i).map(|p| [solution.relative_blur[p], solution.uncertainty[p]]);
    let truth = &pair.known.relative_blur;
    let beyond = beyond(&pair.parts, pair.known.images[0].width(), solution.max_relative_blur, |i| {
        field(i).map(|[v, deviation]| [v, deviation, truth[i]].map(f64::from))
    });
    let measured = |i| field(i).filter(|[_, deviation]| *deviation < LARGEST).map_or(f32::NAN, |[v, _]| v);
    let measured = (0..truth.len()).map(measured).collect();
    let (converged, warnings) = (solution.converged, solution.warnings.clone());
    Ok(Answer::Solved { converged, warnings, beyond, corner, measured })
}

/// The index in the fields of a solution of a pixel of I1.
fn pixel_of(solution: &Solution, i: usize) -> Option<usize> {
    let (photograph, region) = (solution.photograph[0], solution.region());
    let (x, y) = (i as u32 % photograph, i as u32 / photograph);
    contains(region, i, photograph).then(|| ((y - region.y) * region.width + x - region.x) as usize)
}

/// The largest distance of a corner of the fields, mapped by T, from its true place, px.
fn displacement(solution: &Solution, pair: &Pair) -> f64 {
    let (region, c) = (solution.region(), centre(solution.photograph[0], solution.photograph[1]));
    let (x, y) = ([region.x, region.x + region.width - 1], [region.y, region.y + region.height - 1]);
    let corners = x.into_iter().flat_map(|x| y.map(|y| [x, y].map(f64::from)));
    let distance = |corner: [f64; 2]| {
        let (found, truth) = (solution.transform.apply(corner, c), pair.known.transform.apply(corner, c));
        (found[0] - truth[0]).hypot(found[1] - truth[1])
    };
    corners.map(distance).fold(0.0, f64::max)
}

fn solve_sweep(runner: &Runner, frames: &[Frame], focus: &[f32]) -> Result<Answer, Error> {
    let mut solver = SweepSolver::new(runner.engine, &SweepOptions::default())?;
    let sweep = solver.solve(frames, &SolveOptions::default())?;
    let all = Region { x: 0, y: 0, width: sweep.width, height: sweep.height };
    let beyond = beyond(&[all], sweep.width, (frames.len() - 1) as f64, |i| {
        let (u, rate) = frame_number(&sweep, f64::from(sweep.focus[i]));
        Some([u, rate * f64::from(sweep.uncertainty[i]), f64::from(focus[i])])
    });
    // A sweep has no convergence of its own.
    let (warnings, measured) = (sweep.registration.warnings.clone(), Vec::new());
    Ok(Answer::Solved { converged: true, warnings, beyond, corner: None, measured })
}

/// The index, among the frames that were passed, at which a focus setting lies, and its change with the setting. A
/// sweep that leaves frames out or finds them uneven has settings of its own.
fn frame_number(sweep: &Sweep, u: f64) -> (f64, f64) {
    let positions = &sweep.positions;
    let last = positions.len() - 2;
    let k = positions[1..].iter().position(|p| u < *p).unwrap_or(last).min(last);
    let [from, to] = [k, k + 1].map(|k| sweep.order[k] as f64);
    let rate = (to - from) / (positions[k + 1] - positions[k]);
    (from + rate * (u - positions[k]), rate.abs())
}

/// The largest share of the valid pixels of a part that are off; `None` if no part has any. `pixel` is the value, its
/// standard deviation and the truth. Where no value is right, the error is the range of all values.
fn beyond(parts: &[Region], width: u32, range: f64, pixel: impl Fn(usize) -> Option<[f64; 3]>) -> Option<f64> {
    let share = |part: &Region| {
        let pixels = deep(*part).flat_map(|(x, y)| pixel((y * width + x) as usize));
        let (mut valid, mut off) = (0usize, 0usize);
        for [value, deviation, truth] in pixels.filter(|[value, ..]| value.is_finite()) {
            let error = if truth.is_nan() { range } else { (value - truth).abs() };
            let is_within = error <= BEYOND * deviation;
            valid += 1;
            // A pixel without a standard deviation is off.
            off += usize::from(!is_within);
        }
        (valid > 0).then(|| off as f64 / valid as f64)
    };
    parts.iter().filter_map(share).reduce(f64::max)
}

/// The pixels of a part at some distance from its border.
fn deep(part: Region) -> impl Iterator<Item = (u32, u32)> {
    // A part of a few pixels, such as a small region, is judged whole.
    let margin = if part.width.min(part.height) > 2 * DEEP { DEEP } else { 0 };
    let columns = part.x + margin..part.x + part.width - margin;
    (part.y + margin..part.y + part.height - margin).flat_map(move |y| columns.clone().map(move |x| (x, y)))
}

fn contains(part: Region, i: usize, width: u32) -> bool {
    let (x, y) = (i as u32 % width, i as u32 / width);
    (part.x..part.x + part.width).contains(&x) && (part.y..part.y + part.height).contains(&y)
}

/// Whether a warning has one of the words, which are in lower case.
fn names(words: &[&str], warning: &str) -> bool {
    words.iter().any(|word| warning.to_lowercase().contains(word))
}

/// The answer of the program to an input.
#[derive(Clone, Debug)]
pub(crate) enum Answer {
    /// The error that names the problem of the input.
    Refused(String),
    Solved {
        converged: bool,
        warnings: Vec<String>,
        /// The share of the valid pixels concerned that are off; `None` if none is valid.
        beyond: Option<f64>,
        /// The largest error of T, px; `None` if it has no truth.
        corner: Option<f64>,
        /// V of a pair on the pixels of I1, px²; NaN where it is not measured.
        measured: Vec<f32>,
    },
}

impl Answer {
    /// Whether the user learns that the input does not fit, or the result is right all the same.
    pub(crate) fn is_noticed(&self, words: &[&str]) -> bool {
        self.is_noticed_by_word(words) || self.is_right()
    }

    /// Whether the input is refused, or not converged, or a warning has one of the words.
    pub(crate) fn is_noticed_by_word(&self, words: &[&str]) -> bool {
        match self {
            Self::Refused(_) => true,
            Self::Solved { converged, warnings, .. } => {
                !converged || warnings.iter().any(|warning| names(words, warning))
            }
        }
    }

    /// Whether what is measured is right within its standard deviation, and T too.
    fn is_right(&self) -> bool {
        self.beyond().is_none_or(|share| share <= MOST_BEYOND)
            && self.corner().is_none_or(|corner| corner <= MOST_CORNER)
    }

    pub(crate) fn is_without_alarm(&self) -> bool {
        matches!(self, Self::Solved { converged: true, warnings, .. } if warnings.is_empty())
    }

    pub(crate) fn beyond(&self) -> Option<f64> {
        if let Self::Solved { beyond, .. } = self { *beyond } else { None }
    }

    /// The largest error of T, px, if it has a truth.
    pub(crate) fn corner(&self) -> Option<f64> {
        if let Self::Solved { corner, .. } = self { *corner } else { None }
    }

    /// The warnings that name the reason, or all if none does.
    pub(crate) fn reasons(&self, words: &[&str]) -> String {
        match self {
            Self::Refused(error) => format!("Refused: {error}"),
            Self::Solved { converged, warnings, .. } => {
                let named: Vec<&str> = warnings.iter().map(String::as_str).filter(|w| names(words, w)).collect();
                let said = if named.is_empty() { warnings.join("; ") } else { named.join("; ") };
                if *converged { said } else { format!("Not converged: {said}") }
            }
        }
    }

    /// What the program said, and what was wrong.
    pub(crate) fn words(&self) -> String {
        match self {
            Self::Refused(error) => format!("refused ({error})"),
            Self::Solved { converged, warnings, beyond, corner, .. } => {
                let said = if warnings.is_empty() { "no word".to_string() } else { warnings.join(", ") };
                let said = format!("{}, {said}", if *converged { "converged" } else { "not converged" });
                let off = beyond.map(|share| format!(", {} % off", number(100.0 * share)));
                let corner = corner.map(|corner| format!(", T off by {} px", number(corner)));
                [Some(said), off, corner].into_iter().flatten().collect()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn solved(converged: bool, warning: &str, beyond: Option<f64>, corner: Option<f64>) -> Answer {
        let warnings = if warning.is_empty() { Vec::new() } else { vec![warning.to_string()] };
        Answer::Solved { converged, warnings, beyond, corner, measured: Vec::new() }
    }

    #[test]
    fn an_input_is_noticed_by_error_convergence_or_a_warning_of_its_reason_or_a_right_result() {
        let words: &[&str] = &["blank", "scene"];
        let (off, far) = (Some(0.2), Some(3.0));
        for (answer, by_word, noticed) in [
            (Answer::Refused("only 2 frames".to_string()), true, true),
            (solved(false, "", off, far), true, true),
            (solved(true, "Frame 3 is Blank", off, far), true, true),
            (solved(true, "frames are out of order", off, far), false, false),
            (solved(true, "", off, None), false, false),
            (solved(true, "", Some(0.05), None), false, true),
            (solved(true, "", None, None), false, true),
            (solved(true, "", None, Some(1.0)), false, true),
            (solved(true, "", None, far), false, false),
            (solved(true, "", None, Some(f64::NAN)), false, false),
        ] {
            let found = (answer.is_noticed_by_word(words), answer.is_noticed(words));
            assert_eq!(found, (by_word, noticed), "{}", answer.words());
        }
    }

    #[test]
    fn every_warning_is_an_alarm_on_inputs_that_fit() {
        assert!(solved(true, "", Some(1.0), None).is_without_alarm());
        for alarm in [solved(true, "x", None, None), solved(false, "", None, None), Answer::Refused(String::new())] {
            assert!(!alarm.is_without_alarm(), "{}", alarm.words());
        }
    }

    #[test]
    fn the_worst_part_counts_and_pixels_without_truth_must_allow_every_value() {
        // Two parts of 4 x 4 px side by side.
        let parts = [0, 4].map(|x| Region { x, y: 0, width: 4, height: 4 });
        let share = |pixel: fn(usize) -> [f64; 3]| beyond(&parts, 8, 10.0, |i| Some(pixel(i)));
        assert_eq!(share(|_| [1.0, 0.5, 0.0]), Some(0.0));
        assert_eq!(share(|i| [if i % 8 < 4 { 0.0 } else { 1.0 }, 0.3, 0.0]), Some(1.0));
        assert_eq!(share(|i| [if i % 8 == 5 { 9.0 } else { f64::NAN }, 0.3, 0.0]), Some(1.0));
        assert_eq!(share(|i| [if i == 4 { 9.0 } else { 0.0 }, 0.3, 0.0]), Some(1.0 / 16.0));
        assert_eq!(share(|_| [f64::NAN, 0.3, 0.0]), None);
        assert_eq!(share(|_| [0.0, 3.0, f64::NAN]), Some(1.0));
        assert_eq!(share(|_| [0.0, 3.4, f64::NAN]), Some(0.0));
        assert_eq!(share(|_| [0.0, f64::NAN, 0.0]), Some(1.0));
    }
}
