//! Settings as the report states them.

use serde::{Deserialize, Serialize};

use super::{PhotometricReport, TransformReport};
use crate::{Decode, Method, Settings};

/// Every field of [`Settings`] under its own name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SettingsReport {
    /// "unified" or "aligned".
    pub method: String,
    /// Pyramid levels; `null` is automatic.
    pub levels: Option<u32>,
    /// Outer iterations on each level at most.
    pub outer_iterations: u32,
    /// Red-black sweeps an outer iteration.
    pub sweeps: u32,
    /// Over-relaxation ω.
    pub over_relaxation: f64,
    /// Smoothness α at its final value.
    pub regularization: f64,
    /// On each level α starts `1 + continuation` times too large.
    pub continuation: f64,
    /// η of the data term, intensities.
    pub data_eta: f64,
    /// η of the smoothness term, px² a pixel.
    pub smoothness_eta: f64,
    /// ε of the smooth Heaviside, px².
    pub heaviside_epsilon: f64,
    /// Largest |V|, px² of the full-size image.
    pub max_relative_blur: f64,
    /// Largest change of V in one outer iteration, px² of the level.
    pub largest_step: f64,
    /// Whether gain and offset were solved for.
    pub photometric: bool,
    /// "none" or "srgb".
    pub decode: String,
    /// Where T started.
    pub start: TransformReport,
    /// Where gain and offset started.
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
