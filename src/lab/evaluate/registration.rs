//! Table 1: how well each system registers pairs whose registration is known, and what V it gets.

use serde::Serialize;

use super::bench::{Bench, SYSTEMS, settings, unregistered};
use super::cases::{Case, Prepared};
use super::errors::{TransformError, rms};
use super::figures::Collector;
use super::system::{NONE, REFERENCE, SystemResult};
use crate::base::Similarity;
use crate::engine::Solution;

/// All systems on one pair.
#[derive(Serialize)]
pub(super) struct CaseResult {
    pub case: String,
    pub symmetric: bool,
    /// Of a scene; the truth of a displaced photograph is the displacement after the unified method's own estimate of
    /// the pair as it was taken, by which that method cannot be judged.
    pub truth_is_known: bool,
    /// `None` where the pair could not be made.
    pub truth: Option<Similarity>,
    /// Why the pair could not be made.
    pub failure: Option<String>,
    pub systems: Vec<SystemResult>,
}

impl CaseResult {
    pub(super) fn system(&self, name: &str) -> Option<&SystemResult> {
        self.systems.iter().find(|s| s.system == name)
    }
}

/// Runs every system on every case.
pub(super) fn run(bench: &mut Bench, cases: Vec<Case>, figures: &mut Collector) -> Vec<CaseResult> {
    let mut results = Vec::new();
    for case in cases {
        bench.say(&format!("table 1: {}", case.name));
        let (case_name, symmetric, truth_is_known) = (case.name.clone(), case.symmetric, case.truth_is_known());
        results.push(match case.prepare(bench) {
            Ok(prepared) => one(bench, case, &prepared, figures),
            Err(e) => CaseResult {
                case: case_name,
                symmetric,
                truth_is_known,
                truth: None,
                failure: Some(e),
                systems: Vec::new(),
            },
        });
    }
    results
}

fn one(bench: &mut Bench, case: Case, prepared: &Prepared, figures: &mut Collector) -> CaseResult {
    let [i1, i2] = &prepared.displaced.images;
    let [a1, a2] = &prepared.aligned.images;
    let kernel = &prepared.kernel;
    let reference = bench.solve([a1, a2], &unregistered(kernel));
    let mut solved = vec![(NONE, bench.solve([i1, i2], &unregistered(kernel)))];
    for system in SYSTEMS {
        solved.push((system.name(), bench.solve([i1, i2], &settings(system, kernel))));
    }
    let mut systems: Vec<SystemResult> = solved
        .iter()
        .map(|(name, solution)| SystemResult {
            error: solution.as_ref().ok().filter(|_| *name != NONE).map(|s| error(s, prepared)),
            v_rms_to_aligned: both(solution, &reference).and_then(|(s, a)| to_aligned(s, a, prepared)),
            ..SystemResult::new(name, solution, &prepared.displaced)
        })
        .collect();
    systems.push(SystemResult::new(REFERENCE, &reference, &prepared.aligned));
    solved.push((REFERENCE, reference));
    figures.scene(&case.name, i1, &solved, &systems);
    CaseResult {
        truth_is_known: case.truth_is_known(),
        case: case.name,
        symmetric: case.symmetric,
        truth: Some(prepared.truth),
        failure: None,
        systems,
    }
}

fn both<'a>(a: &'a Result<Solution, String>, b: &'a Result<Solution, String>) -> Option<(&'a Solution, &'a Solution)> {
    Some((a.as_ref().ok()?, b.as_ref().ok()?))
}

fn error(solution: &Solution, prepared: &Prepared) -> TransformError {
    TransformError::of(&solution.transform.at_centre(), &prepared.truth, [solution.width, solution.height])
}

/// V of the displaced pair less V of the aligned pair. Where a lens breathes, the true V of the two differ (V is
/// V2/s² - V1), so each is taken less its own truth.
fn to_aligned(solution: &Solution, aligned: &Solution, prepared: &Prepared) -> Option<f64> {
    let truths = prepared.displaced.relative_blur.as_ref().zip(prepared.aligned.relative_blur.as_ref());
    let between = |i: usize| truths.map_or(0.0, |(d, a)| f64::from(d[i]) - f64::from(a[i]));
    // An rms over what little is valid in both would say nothing.
    if 2.0 * solution.valid_fraction < aligned.valid_fraction {
        return None;
    }
    rms(solution.width, solution.height, |i| {
        f64::from(solution.relative_blur[i]) - f64::from(aligned.relative_blur[i]) - between(i)
    })
}
