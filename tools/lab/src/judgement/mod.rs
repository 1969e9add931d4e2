//! Inputs that do not fit the model, and whether the program notices; inputs that fit, on which it must not warn.

mod alterations;
mod answer;
mod fitting;
mod pairs;
mod sweeps;

use parfocal::Error;

use self::alterations::DEEP;
use self::answer::{Answer, BEYOND, Input, MOST_BEYOND, MOST_CORNER};
use crate::contact_sheet::Row;
use crate::figures::{self, Figure};
use crate::section::{Case, Runner, Section};

/// The heading in the report.
pub(crate) const HEADING: &str = "Judgement";

/// A kind of inputs.
struct Kind {
    name: &'static str,
    /// Words in lower case. A warning with one of them names the reason.
    words: &'static [&'static str],
    input: fn(Trial) -> Result<Input, Error>,
}

const fn kind(name: &'static str, words: &'static [&'static str], input: fn(Trial) -> Result<Input, Error>) -> Kind {
    Kind { name, words, input }
}

/// One input of a kind.
#[derive(Clone, Copy)]
struct Trial {
    /// Its number among those of its kind, from 0. A kind with a list of values takes the value of this number.
    number: usize,
    /// Width and height of the photographs, px.
    side: u32,
}

impl Trial {
    /// The seed of texture and noise.
    fn seed(self) -> u64 {
        1 + self.number as u64
    }
}

/// Number of inputs of each kind.
const TRIALS: usize = 3;
/// Sizes of the inputs, px. Texture, blur and noise are the same at each, so that larger ones have more to judge by.
const SIDES: [u32; TRIALS] = [128, 192, 256];
/// Sizes of the inputs that fit, px. In smaller ones V changes too fast along the presets' shapes, which the model does
/// not allow: it takes V for constant within a window.
const FITTING_SIDES: [u32; TRIALS] = [192, 224, 256];
/// Number of kinds in each section of a quick run, each with its first input.
const QUICK_KINDS: usize = 2;

/// Number of kinds of pairs that do not fit.
pub(crate) const PAIRS: usize = pairs::KINDS.len();

/// What is known of an input before it is solved.
#[derive(Clone, Copy, PartialEq)]
enum Expected {
    Noticed,
    NoAlarm,
}

/// Measures everything, and draws what was said of pairs that do not fit.
pub(crate) fn run(runner: &mut Runner) -> (Vec<Section>, Vec<Figure>) {
    let mut rows = Vec::new();
    let noticed = format!(
        "An input is noticed if it is refused with an error, or not converged, or a warning names the reason (it has one \
         of the words of its kind), or the result is right: at most {:.0} % of the valid pixels concerned are off by more \
         than {BEYOND} of their standard deviations, and no corner of the result is displaced by T by more than \
         {MOST_CORNER} px from its true place. Pixels without a true value are off unless their standard deviation allows \
         every value. Pixels within {DEEP} px of the border of the part concerned are left out. By word: noticed by \
         error, warning or convergence. Default settings; {TRIALS} inputs of each kind, of {} px.",
        100.0 * MOST_BEYOND,
        SIDES.map(|side| side.to_string()).join(", "),
    );
    let fits = format!(
        "No false alarm: converged, without a warning. Default settings; {TRIALS} inputs of each kind, of {} px. The share \
         off by more than {BEYOND} standard deviations has no bound here.",
        FITTING_SIDES.map(|side| side.to_string()).join(", "),
    );
    let mut section = |name, what: &str, kinds: &[Kind], expected| {
        let kinds = if runner.quick { &kinds[..QUICK_KINDS] } else { kinds };
        Section::new(name, what, kinds.iter().map(|kind| case(runner, kind, expected, &mut rows)).collect())
    };
    let sections = vec![
        section("Sweeps that do not fit", &noticed, sweeps::KINDS, Expected::Noticed),
        section("Pairs that do not fit", &noticed, pairs::KINDS, Expected::Noticed),
        section("Inputs that fit", &fits, fitting::KINDS, Expected::NoAlarm),
    ];
    (sections, figures::warned(rows))
}

/// Asks for all inputs of a kind. A row shows the last one, if it is a pair that does not fit and was noticed by word.
fn case(runner: &mut Runner, kind: &Kind, expected: Expected, rows: &mut Vec<Row>) -> Case {
    let sides = if expected == Expected::Noticed { SIDES } else { FITTING_SIDES };
    let trials = sides.into_iter().enumerate().map(|(number, side)| Trial { number, side });
    let (mut asked, mut right, mut by_word, mut beyond, mut corner, mut wrong) = (0, 0, 0, None, None, Vec::new());
    let trials_of_kind = if runner.quick { 1 } else { TRIALS };
    for trial in trials.take(trials_of_kind) {
        runner.log(&format!("judgement: {}, {} px", kind.name, trial.side));
        asked += 1;
        let solved = (kind.input)(trial).and_then(|input| input.solve(runner).map(|answer| (input, answer)));
        let (input, answer) = match solved {
            Ok(solved) => solved,
            Err(e) => {
                wrong.push(format!("{} px: cannot be asked: {e}", trial.side));
                continue;
            }
        };
        by_word += usize::from(answer.is_noticed_by_word(kind.words));
        if trial.number + 1 == trials_of_kind
            && expected == Expected::Noticed
            && answer.is_noticed_by_word(kind.words)
            && let Input::Pair(pair) = &input
        {
            let measured = if let Answer::Solved { measured, .. } = &answer { &measured[..] } else { &[] };
            rows.push(figures::warned_row(
                kind.name,
                pair.known.images.each_ref(),
                measured,
                answer.reasons(kind.words),
            ));
        }
        beyond = beyond.into_iter().chain(answer.beyond()).reduce(f64::max);
        corner = corner.into_iter().chain(answer.corner()).reduce(f64::max);
        if is_right(&answer, kind, expected) {
            right += 1;
        } else {
            wrong.push(format!("{} px: {}", trial.side, answer.words()));
        }
    }
    let case = Case::new(kind.name).value("asked", f64::from(asked));
    let case = case.bounded("answered rightly", f64::from(right), [Some(f64::from(asked)), None]);
    let case = if expected == Expected::Noticed { case.value("by word", by_word as f64) } else { case };
    let case = case.value("off, %, the worst", beyond.map(|share| 100.0 * share));
    case.value("T off, px, the worst", corner).note(wrong.join("; "))
}

fn is_right(answer: &Answer, kind: &Kind, expected: Expected) -> bool {
    match expected {
        Expected::Noticed => answer.is_noticed(kind.words),
        Expected::NoAlarm => answer.is_without_alarm(),
    }
}
