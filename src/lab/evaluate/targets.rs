//! What is aimed at, and whether the numbers of Table 1 reach it.

use serde::Serialize;

use super::registration::CaseResult;
use super::robustness::PAPER_PX;
use super::system::{NONE, SystemResult};
use crate::base::Method;

/// One aim.
#[derive(Debug, PartialEq, Serialize)]
pub(super) struct Target {
    pub name: String,
    pub unit: &'static str,
    /// Whether values must be at most or at least `bound`.
    pub at_most: bool,
    pub bound: f64,
    /// The value that decides: the largest, or the least.
    pub worst: Option<f64>,
    /// `None` where there was nothing to judge by.
    pub met: Option<bool>,
    /// Where the bound is not kept, with the value; `null` where the system gave no answer.
    pub missed: Vec<(String, Option<f64>)>,
    /// How many values were judged.
    pub judged: usize,
}

/// A value by the name of its case; `None` where the system failed.
type Named = (String, Option<f64>);

impl Target {
    fn at_most(name: &str, bound: f64, unit: &'static str, values: Vec<Named>) -> Self {
        let worst = values.iter().filter_map(|v| v.1).reduce(f64::max);
        let judged = values.len();
        let missed: Vec<Named> = values.into_iter().filter(|v| !v.1.is_some_and(|v| v <= bound)).collect();
        Self::new(name, unit, true, bound, worst, missed, judged)
    }

    /// What gave no value is missed: nothing is known of it.
    fn at_least(name: &str, bound: f64, unit: &'static str, values: Vec<Named>) -> Self {
        let worst = values.iter().filter_map(|v| v.1).reduce(f64::min);
        let judged = values.len();
        let missed: Vec<Named> = values.into_iter().filter(|v| !v.1.is_some_and(|v| v >= bound)).collect();
        Self::new(name, unit, false, bound, worst, missed, judged)
    }

    fn new(
        name: &str,
        unit: &'static str,
        at_most: bool,
        bound: f64,
        worst: Option<f64>,
        missed: Vec<Named>,
        judged: usize,
    ) -> Self {
        let met = (judged > 0).then_some(missed.is_empty());
        Self { name: name.to_string(), unit, at_most, bound, worst, met, missed, judged }
    }
}

/// Judges Table 1.
pub(super) fn all(results: &[CaseResult]) -> Vec<Target> {
    let unified = |symmetric: Option<bool>, value: fn(&SystemResult) -> Option<f64>| -> Vec<Named> {
        let cases = results.iter().filter(|case| case.truth_is_known);
        let cases = cases.filter(|case| symmetric.is_none_or(|s| s == case.symmetric));
        cases.map(|case| (case.case.clone(), case.system(Method::Unified.name()).and_then(value))).collect()
    };
    let degrees = |s: &SystemResult| s.error.map(|e| e.rotation_deg.abs());
    let percent = |s: &SystemResult| s.error.map(|e| e.scale_percent.abs());
    let corner = SystemResult::corner_px;
    let bound = "unified, the paper's bound on every scene";
    vec![
        Target::at_most("unified, symmetric kernels: corners", 0.01, "px", unified(Some(true), corner)),
        Target::at_most("unified, symmetric kernels: rotation", 0.0003, "°", unified(Some(true), degrees)),
        Target::at_most("unified, symmetric kernels: scale", 0.003, "%", unified(Some(true), percent)),
        Target::at_most("unified, asymmetric kernels: corners", 0.02, "px", unified(Some(false), corner)),
        Target::at_most(&format!("{bound}: corners"), PAPER_PX, "px", unified(None, corner)),
        Target::at_most(&format!("{bound}: rotation"), 0.001, "°", unified(None, degrees)),
        Target::at_most(&format!("{bound}: scale"), 0.1, "%", unified(None, percent)),
        Target::at_least("separate systems fail under asymmetric kernels: corners", 0.8, "px", separate(results)),
        Target::at_most("V of the displaced pair is that of the aligned pair: rms", 0.1, "px²", same(results)),
        Target::at_least("without registration V falls apart: rms over that of unified", 5.0, "times", apart(results)),
    ]
}

/// V of the unified method, displaced against aligned.
fn same(results: &[CaseResult]) -> Vec<Named> {
    let rms = |case: &CaseResult| case.system(Method::Unified.name()).and_then(|s| s.v_rms_to_aligned);
    results.iter().map(|case| (case.case.clone(), rms(case))).collect()
}

/// Corner errors of the separate systems under asymmetric kernels. Without key-points there is no registration, which is
/// as far off as can be.
fn separate(results: &[CaseResult]) -> Vec<Named> {
    let cases = results.iter().filter(|case| !case.symmetric);
    let systems = [Method::Appearance.name(), Method::Sift.name()];
    cases
        .flat_map(|case| systems.map(|name| (case, name)))
        .map(|(case, name)| {
            let system = case.system(name);
            let corner = system.and_then(|s| if s.lacks_key_points() { Some(f64::INFINITY) } else { s.corner_px() });
            (format!("{name} on {}", case.case), corner)
        })
        .collect()
}

/// Error of V without registration over that of the unified method, both against the aligned pair.
fn apart(results: &[CaseResult]) -> Vec<Named> {
    let rms = |case: &CaseResult, name: &str| case.system(name).and_then(|s| s.v_rms_to_aligned);
    let ratio = |case: &CaseResult| Some(rms(case, NONE)? / rms(case, Method::Unified.name())?);
    results.iter().map(|case| (case.case.clone(), ratio(case))).collect()
}

/// The separate systems that are about as good as the unified one on a case: within twice its corner error, or 0.01 px.
pub(super) fn as_good(results: &[CaseResult]) -> Vec<(String, &'static str, f64)> {
    let mut found = Vec::new();
    for case in results {
        let corner = |name: &str| case.system(name).and_then(SystemResult::corner_px);
        let limit = corner(Method::Unified.name()).map_or(0.01, |c| (2.0 * c).max(0.01));
        for name in [Method::Appearance.name(), Method::Sift.name()] {
            found.extend(corner(name).filter(|c| *c <= limit).map(|c| (case.case.clone(), name, c)));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(values: &[Option<f64>]) -> Vec<Named> {
        values.iter().enumerate().map(|(i, v)| (i.to_string(), *v)).collect()
    }

    #[test]
    fn the_worst_value_decides_and_no_answer_is_a_miss() {
        let met = Target::at_most("a", 0.1, "px", named(&[Some(0.05), Some(0.1)]));
        assert_eq!((met.met, met.worst, met.missed.len()), (Some(true), Some(0.1), 0));
        let missed = Target::at_most("a", 0.1, "px", named(&[Some(0.2), None, Some(f64::NAN)]));
        assert_eq!((missed.met, missed.missed.len()), (Some(false), 3));
        assert_eq!(Target::at_most("a", 0.1, "px", Vec::new()).met, None);
    }

    #[test]
    fn a_least_error_is_reached_by_values_and_not_by_their_absence() {
        let met = Target::at_least("a", 0.8, "px", named(&[Some(0.9), Some(f64::INFINITY)]));
        assert_eq!((met.met, met.worst), (Some(true), Some(0.9)));
        let missed = Target::at_least("a", 0.8, "px", named(&[Some(0.1), None, Some(f64::NAN)]));
        assert_eq!((missed.met, missed.missed.len()), (Some(false), 3));
    }
}
