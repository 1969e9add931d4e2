//! Settings as the report states them.

use serde::{Deserialize, Serialize};

use super::{PhotometricReport, TransformReport};
use crate::{Decode, Method, Settings};

/// Every field of [`Settings`] under its own name; units are stated there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct SettingsReport {
    pub method: String,
    /// `null` is automatic.
    pub levels: Option<u32>,
    pub outer_iterations: u32,
    pub sweeps: u32,
    pub over_relaxation: f64,
    pub regularization: f64,
    pub continuation: f64,
    pub data_eta: f64,
    pub smoothness_eta: f64,
    pub heaviside_epsilon: f64,
    pub max_relative_blur: f64,
    pub largest_step: f64,
    pub photometric: bool,
    pub decode: String,
    pub start: TransformReport,
    pub start_photometric: PhotometricReport,
}

/// "unified" or "aligned".
pub(super) fn method_name(method: Method) -> String {
    match method {
        Method::Unified => "unified",
        Method::Aligned => "aligned",
    }
    .to_string()
}

impl From<&Settings> for SettingsReport {
    fn from(settings: &Settings) -> Self {
        // Taken apart, so that a new setting that is not reported does not compile.
        let &Settings {
            method,
            levels,
            outer_iterations,
            sweeps,
            over_relaxation,
            regularization,
            continuation,
            data_eta,
            smoothness_eta,
            heaviside_epsilon,
            max_relative_blur,
            largest_step,
            photometric,
            decode,
            start,
            start_photometric,
        } = settings;
        let decode = match decode {
            Decode::None => "none",
            Decode::Srgb => "srgb",
        };
        Self {
            method: method_name(method),
            levels,
            outer_iterations,
            sweeps,
            over_relaxation,
            regularization,
            continuation,
            data_eta,
            smoothness_eta,
            heaviside_epsilon,
            max_relative_blur,
            largest_step,
            photometric,
            decode: decode.to_string(),
            start: start.into(),
            start_photometric: start_photometric.into(),
        }
    }
}
