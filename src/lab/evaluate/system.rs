//! One of the systems that are compared, and what it made of a pair.

use serde::Serialize;

use super::cases::Pair;
use super::errors::{TransformError, energy, rms_error};
use crate::base::Similarity;
use crate::engine::Solution;

/// Without registration: T held at identity.
pub(super) const NONE: &str = "none";
/// The pair without displacement, T held at identity.
pub(super) const REFERENCE: &str = "aligned pair";

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

impl SystemResult {
    pub(super) fn corner_px(&self) -> Option<f64> {
        self.error.map(|e| e.corner_px)
    }

    /// Whether SIFT found too little to register by: the paper's dashes.
    pub(super) fn lacks_key_points(&self) -> bool {
        self.failure.as_deref().is_some_and(|f| f.starts_with("SIFT cannot register"))
    }

    /// What a solution says of itself, and against the true V.
    pub(super) fn new(system: &'static str, solution: &Result<Solution, String>, pair: &Pair) -> Self {
        let found = solution.as_ref().ok();
        Self {
            system,
            failure: solution.as_ref().err().cloned(),
            transform: found.map(|s| s.transform.at_centre()),
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
