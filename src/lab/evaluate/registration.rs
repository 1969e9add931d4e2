//! Table 1: how well each system registers pairs whose registration is known, and what V it gets.

use serde::Serialize;

use super::bench::{Bench, SYSTEMS, settings, unregistered};
use super::cases::{Case, Pair, Prepared};
use super::figures::Collector;
use super::measure::{TransformError, energy, rms, rms_error};
use crate::base::Similarity;
use crate::engine::Solution;

/// Without registration: T held at identity.
pub(super) const NONE: &str = "none";
/// The pair without displacement, T held at identity.
pub(super) const REFERENCE: &str = "aligned pair";

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

/// One system on one pair; what there is not is `null`.
#[derive(Serialize)]
pub(super) struct SystemResult {
    pub system: &'static str,
    /// Why there is no solution.
    pub failure: Option<String>,
    pub transform: Option<Similarity>,
    pub error: Option<TransformError>,
    /// Rms of V less the true V, px².
    pub v_rms_to_truth: Option<f64>,
    /// Rms of V less V of the aligned pair, px².
    pub v_rms_to_aligned: Option<f64>,
    /// E per valid pixel.
    pub energy: Option<f64>,
    pub time_ms: Option<f64>,
    pub converged: Option<bool>,
    pub warnings: Vec<String>,
}

impl CaseResult {
    pub(super) fn system(&self, name: &str) -> Option<&SystemResult> {
        self.systems.iter().find(|s| s.system == name)
    }
}

impl SystemResult {
    pub(super) fn corner_px(&self) -> Option<f64> {
        self.error.map(|e| e.corner_px)
    }

    /// Whether SIFT found too little to register by: the paper's dashes.
    pub(super) fn lacks_key_points(&self) -> bool {
        self.failure.as_deref().is_some_and(|f| f.starts_with("SIFT cannot register"))
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

impl SystemResult {
    /// What a solution says of itself, and against the true V.
    fn new(system: &'static str, solution: &Result<Solution, String>, pair: &Pair) -> Self {
        let found = solution.as_ref().ok();
        Self {
            system,
            failure: solution.as_ref().err().cloned(),
            transform: found.map(|s| s.transform),
            error: None,
            v_rms_to_truth: found.and_then(|s| rms_error(s, pair.relative_blur.as_ref()?)),
            v_rms_to_aligned: None,
            energy: found.and_then(energy),
            time_ms: found.map(|s| s.timings.total_ms),
            converged: found.map(|s| s.converged),
            warnings: found.map(|s| s.warnings.clone()).unwrap_or_default(),
        }
    }
}

fn both<'a>(a: &'a Result<Solution, String>, b: &'a Result<Solution, String>) -> Option<(&'a Solution, &'a Solution)> {
    Some((a.as_ref().ok()?, b.as_ref().ok()?))
}

fn error(solution: &Solution, prepared: &Prepared) -> TransformError {
    TransformError::of(&solution.transform, &prepared.truth, [solution.width, solution.height])
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
