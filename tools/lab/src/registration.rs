//! Tables 1 and 2: the registration and V by each method, on pairs of known registration and on photographs.

use std::path::Path;

use parfocal::{
    Frame, Solution,
    internals::scene,
    settings::{Kernel, Method},
    transform::Similarity,
};

use crate::errors::{BORDER, rms};
use crate::figures::{ALIGNED, Collector, NONE, Solved};
use crate::pairs::{KnownPair, PhotographedPair, Source, TablePair};
use crate::robustness::PAPER_PX;
use crate::section::{Case, METHODS, Runner, Section, number, settings, unregistered};

const TX: &str = "t_x, px";
const TY: &str = "t_y, px";
const ROTATION: &str = "θ, °";
const SCALE: &str = "s, %";
pub(crate) const CORNER: &str = "corners, px";
const TO_TRUTH: &str = "V to truth, px²";
const TO_ALIGNED: &str = "V to aligned, px²";

/// Makes Table 1 and the targets that judge it.
pub(crate) fn known(runner: &mut Runner, data: &Path, figures: &mut Collector) -> [Section; 2] {
    let mut rows = Vec::new();
    for pair in TablePair::all(data, runner.quick) {
        runner.log(&format!("table 1: {}", pair.name));
        match pair.prepare(runner, data) {
            Ok(prepared) => rows.extend(solve_known(runner, &pair, &prepared, figures)),
            Err(e) => {
                let case = Case::failed(&pair.name, e);
                rows.push(Row { kind: Kind::of(&pair), pair: pair.name, method: Method::Unified.name(), case });
            }
        }
    }
    let targets = Section::new("Targets", "Of Table 1; the worst value decides.", judge(&rows));
    let what = format!(
        "T found less the truth, and the largest error of a corner. V: rms, {BORDER} px along the border left out, of V \
         less the true V, and of V less that of the aligned pair (the same pair without displacement, T held at the \
         identity), each less its own truth. Energy: E per valid pixel after the last iteration. The truth of the \
         displaced photograph is its displacement after the unified method's own registration of the pair as taken: the \
         targets of registration leave it out."
    );
    let cases = rows.into_iter().map(|row| row.case).collect();
    [targets, Section::without_bounds("Table 1: registration errors", what, cases)]
}

/// Kinds of pairs with separate targets: scenes by the symmetry of their kernel, and the displaced photograph.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Symmetric,
    Asymmetric,
    Photograph,
}

impl Kind {
    fn of(pair: &TablePair) -> Self {
        match &pair.source {
            Source::Cup => Self::Photograph,
            Source::Scene(scene) if scene.kernel == scene::Kernel::HalfGaussian => Self::Asymmetric,
            Source::Scene(_) => Self::Symmetric,
        }
    }
}

/// One method on one pair of Table 1.
struct Row {
    pair: String,
    kind: Kind,
    method: &'static str,
    case: Case,
}

fn solve_known(runner: &mut Runner, pair: &TablePair, known: &[KnownPair; 2], figures: &mut Collector) -> Vec<Row> {
    let [displaced, aligned] = known;
    let reference = aligned.solve(runner, &unregistered(&aligned.kernel));
    let mut solved = solve_all(runner, displaced);
    let truth = transform(Case::new(format!("**{}**: truth", pair.name)), &displaced.transform, &Similarity::IDENTITY);
    let mut cases = vec![("truth", truth)];
    for (method, solution) in &solved {
        let case = solution_case(&format!("{}: {method}", pair.name), *method == NONE, solution, |s, mut case| {
            if *method != NONE {
                let registered = s.transform.at_centre();
                let corner = registered.corner_distance(&displaced.transform, s.width, s.height);
                case = transform(case, &registered, &displaced.transform).value(CORNER, corner);
            }
            let aligned_rms = reference.as_ref().ok().and_then(|a| rms_to_aligned(s, a, known));
            case.value(TO_TRUTH, rms_to_truth(s, displaced)).value(TO_ALIGNED, aligned_rms)
        });
        cases.push((*method, case));
    }
    let case = |s: &Solution, case: Case| case.value(TO_TRUTH, rms_to_truth(s, aligned));
    cases.push((ALIGNED, solution_case(&format!("{}: {ALIGNED}", pair.name), true, &reference, case)));
    solved.push((ALIGNED, reference));
    let captions = cases[1..].iter().map(|(_, case)| case.get(CORNER)).collect::<Vec<_>>();
    figures.scene(&pair.name, &displaced.images[0], &solved, &captions);
    cases
        .into_iter()
        .map(|(method, case)| Row { pair: pair.name.clone(), kind: Kind::of(pair), method, case })
        .collect()
}

/// Solves a pair without registration and by each method.
fn solve_all(runner: &mut Runner, pair: &KnownPair) -> Vec<Solved> {
    let mut solved = vec![(NONE, pair.solve(runner, &unregistered(&pair.kernel)))];
    solved.extend(METHODS.map(|method| (method.name(), pair.solve(runner, &settings(method, &pair.kernel)))));
    solved
}

/// A case of a solution: `values`, then energy and time, or the reason for a failure. Without registration, warnings
/// are expected and left out.
fn solution_case(
    name: &str,
    doubtless: bool,
    solution: &Result<Solution, String>,
    values: impl FnOnce(&Solution, Case) -> Case,
) -> Case {
    match solution {
        Ok(s) => {
            let case = values(s, Case::new(name)).value("energy", energy(s)).value("time, s", s.timings.total_ms / 1e3);
            case.note(if doubtless { String::new() } else { s.warnings.join("; ") })
        }
        Err(e) => Case::failed(name, e),
    }
}

/// Adds the errors of T against the truth.
fn transform(case: Case, found: &Similarity, truth: &Similarity) -> Case {
    let case = case.value(TX, found.tx - truth.tx).value(TY, found.ty - truth.ty);
    let case = case.value(ROTATION, found.rotation_deg() - truth.rotation_deg());
    case.value(SCALE, 100.0 * (found.scale - truth.scale))
}

fn rms_to_truth(solution: &Solution, pair: &KnownPair) -> Option<f64> {
    let error = |i: usize| f64::from(solution.relative_blur[i]) - f64::from(pair.relative_blur[i]);
    if pair.relative_blur.is_empty() { None } else { rms(solution.width, solution.height, error) }
}

/// V of the displaced pair minus V of the aligned pair, each minus its own truth. The truths differ if the lens
/// breathes.
fn rms_to_aligned(solution: &Solution, aligned: &Solution, [displaced, undisplaced]: &[KnownPair; 2]) -> Option<f64> {
    let truth = |pair: &KnownPair, i: usize| pair.relative_blur.get(i).map_or(0.0, |v| f64::from(*v));
    // An rms over the few pixels that are valid in both would be meaningless.
    if 2.0 * solution.valid_fraction < aligned.valid_fraction {
        return None;
    }
    rms(solution.width, solution.height, |i| {
        let between = truth(displaced, i) - truth(undisplaced, i);
        f64::from(solution.relative_blur[i]) - f64::from(aligned.relative_blur[i]) - between
    })
}

/// E of the finest level after its last iteration.
fn energy(solution: &Solution) -> Option<f64> {
    solution.levels.last()?.energy.last().copied()
}

/// A bound on one value of selected rows of Table 1.
struct Target {
    name: &'static str,
    value: &'static str,
    methods: &'static [Method],
    kinds: &'static [Kind],
    bounds: [Option<f64>; 2],
}

const UNIFIED: &[Method] = &[Method::Unified];
const SCENES: &[Kind] = &[Kind::Symmetric, Kind::Asymmetric];

const TARGETS: [Target; 9] = [
    target("unified, symmetric kernels: corners", CORNER, &[Kind::Symmetric], 0.01),
    target("unified, symmetric kernels: rotation", ROTATION, &[Kind::Symmetric], 0.0003),
    target("unified, symmetric kernels: scale", SCALE, &[Kind::Symmetric], 0.003),
    target("unified, asymmetric kernels: corners", CORNER, &[Kind::Asymmetric], 0.02),
    target("unified, the paper's bound on every scene: corners", CORNER, SCENES, PAPER_PX),
    target("unified, the paper's bound on every scene: rotation", ROTATION, SCENES, 0.001),
    target("unified, the paper's bound on every scene: scale", SCALE, SCENES, 0.1),
    Target {
        name: "separate methods fail under asymmetric kernels: corners",
        value: CORNER,
        methods: &[Method::Appearance, Method::Sift],
        kinds: &[Kind::Asymmetric],
        bounds: [Some(0.8), None],
    },
    target(
        "V of the displaced pair is that of the aligned pair: rms",
        TO_ALIGNED,
        &[Kind::Symmetric, Kind::Asymmetric, Kind::Photograph],
        0.1,
    ),
];

const fn target(name: &'static str, value: &'static str, kinds: &'static [Kind], most: f64) -> Target {
    Target { name, value, methods: UNIFIED, kinds, bounds: [None, Some(most)] }
}

/// Judges Table 1.
fn judge(rows: &[Row]) -> Vec<Case> {
    let mut cases: Vec<Case> = TARGETS
        .iter()
        .map(|target| {
            let judged = rows.iter().filter(|row| target.kinds.contains(&row.kind));
            let judged = judged.filter(|row| target.methods.iter().any(|method| method.name() == row.method));
            // Too few key-points mean no registration, which counts as an infinite error.
            let value = |row: &Row| match row.case.get(target.value) {
                None if row.case.note.starts_with("SIFT cannot register") => Some(f64::INFINITY),
                value => value.map(f64::abs),
            };
            worst(
                target.name,
                target.value,
                target.bounds,
                judged.map(|row| (&row.case.name[..], value(row))).collect(),
            )
        })
        .collect();
    let of = |pair: &str, method: &str| {
        rows.iter().find(|row| row.pair == pair && row.method == method).and_then(|row| row.case.get(TO_ALIGNED))
    };
    let unified = rows.iter().filter(|row| row.method == Method::Unified.name());
    let ratio = |row: &Row| Some(of(&row.pair, NONE)? / row.case.get(TO_ALIGNED)?);
    let ratios = unified.map(|row| (&row.pair[..], ratio(row))).collect();
    let name = "without registration V falls apart: rms over that of unified";
    cases.push(worst(name, "times", [Some(5.0), None], ratios));
    cases
}

/// A case with the worst of some values: the greatest for an upper bound, the least for a lower bound. A missing value
/// is the worst.
fn worst(name: &str, quantity: &'static str, bounds: [Option<f64>; 2], values: Vec<(&str, Option<f64>)>) -> Case {
    let meets = |v: f64| bounds[0].is_none_or(|least| v >= least) && bounds[1].is_none_or(|most| v <= most);
    let missed = values.iter().filter(|(_, value)| !value.is_some_and(meets));
    let missed: Vec<String> = missed.map(|(name, value)| format!("{name} ({})", number(*value))).collect();
    let all: Option<Vec<f64>> = values.iter().map(|(_, value)| *value).collect();
    let pick = if bounds[1].is_some() { f64::max } else { f64::min };
    // If all values are infinite, the lower bound is met.
    let worst = all.and_then(|all| all.into_iter().reduce(pick)).map(|v| v.min(f64::MAX));
    Case::new(name).bounded(quantity, worst, bounds).value("judged", values.len() as f64).note(missed.join("; "))
}

/// Makes Table 2: the results of each method on photographs of unknown registration.
pub(crate) fn photographs(runner: &mut Runner, data: &Path, figures: &mut Collector) -> Section {
    let mut cases = Vec::new();
    for pair in PhotographedPair::all() {
        let missing: Vec<String> = pair.missing(data).iter().map(|path| path.display().to_string()).collect();
        if !missing.is_empty() {
            cases.push(Case::failed(pair.name, format!("absent: looked for {}", missing.join(" and "))));
            continue;
        }
        runner.log(&format!("table 2: {}", pair.name));
        match pair.read(data, runner.quick) {
            Ok(images) => cases.extend(solve_photographs(runner, &pair, images, figures)),
            Err(e) => cases.push(Case::failed(pair.name, e)),
        }
    }
    let what = "Nobody knows the truth of photographs. The lower the energy per valid pixel, the better a registration \
                and its V explain the pair; which pixels are valid differs a little between the methods.";
    Section::without_bounds("Table 2: photographs", what, cases)
}

fn solve_photographs(
    runner: &mut Runner,
    pair: &PhotographedPair,
    images: [Frame; 2],
    figures: &mut Collector,
) -> Vec<Case> {
    let known =
        KnownPair { images, transform: Similarity::IDENTITY, relative_blur: Vec::new(), kernel: Kernel::Gaussian };
    let solved = solve_all(runner, &known);
    figures.photographs(pair, known.images.each_ref(), &solved);
    let unified = solved.iter().find(|(name, _)| *name == Method::Unified.name()).and_then(|(_, s)| s.as_ref().ok());
    let case = |(method, solution): &Solved| {
        solution_case(&format!("{}: {method}", pair.name), *method == NONE, solution, |s, case| {
            let case =
                transform(case, &s.transform.at_centre(), &Similarity::IDENTITY).value("gain", s.photometric.gain);
            let corner = unified.map(|unified| s.transform.corner_distance(unified.transform, s.width, s.height));
            let case = case.value("corners from unified, px", corner);
            case.value("at the limit of V, %", 100.0 * s.saturated_fraction)
        })
    };
    solved.iter().map(case).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_value_decides_and_a_missing_value_misses_the_bound() {
        let judge = |bounds, values: &[Option<f64>]| {
            let case = worst("a", "x", bounds, values.iter().map(|v| ("b", *v)).collect());
            (case.values[0].met, case.values[0].value, case.note.matches("b (").count())
        };
        let most = [None, Some(0.1)];
        assert_eq!(judge(most, &[Some(0.05), Some(0.1)]), (Some(true), Some(0.1), 0));
        assert_eq!(judge(most, &[Some(0.2), None, Some(f64::NAN)]), (Some(false), None, 3));
        assert_eq!(judge([Some(0.8), None], &[Some(0.9), Some(f64::INFINITY)]), (Some(true), Some(0.9), 0));
        assert_eq!(judge([Some(0.8), None], &[Some(0.1), None]), (Some(false), None, 2));
    }
}
