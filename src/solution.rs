//! What a solve gives back.

use crate::{Channels, Photometric, Similarity};

/// The result of one [`Solver::solve`](crate::Solver::solve).
#[derive(Clone, Debug)]
pub struct Solution {
    /// Pixels a row, of every field below.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// V, px² of I1, row-major; positive where I2 is the more blurred. NaN outside the valid region.
    pub relative_blur: Vec<f32>,
    /// How far the images, not the smoothness, decided V: D/(D + Σa), in [0, 1]; 0 outside the valid region.
    pub confidence: Vec<f32>,
    /// Channels of `fused`: grey only if both inputs are.
    pub fused_channels: Channels,
    /// Pseudo-radiance, equation 37, interleaved, in the values of I1 with white at 1; I1 itself outside the valid region.
    pub fused: Vec<f32>,
    /// T, for full-size pixels.
    pub transform: Similarity,
    /// Gain and offset of I2.
    pub photometric: Photometric,
    /// Coarse to fine.
    pub levels: Vec<Level>,
    /// Whether the finest level settled on an answer that the images support.
    pub converged: bool,
    /// Why not, or what else the user should know; a sentence each.
    pub warnings: Vec<String>,
    /// Fraction of pixels whose whole blur window lies inside both images.
    pub valid_fraction: f64,
    /// Fraction of the valid pixels at the limit of |V|.
    pub saturated_fraction: f64,
    /// Where the time went.
    pub timings: Timings,
}

/// What one pyramid level did.
#[derive(Clone, Debug, PartialEq)]
pub struct Level {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// E of section 2 of docs/method.md per valid pixel, one for each outer iteration done.
    pub energy: Vec<f64>,
}

/// Milliseconds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Timings {
    /// From the call to the answer.
    pub total_ms: f64,
    /// On the device, from the first pass to the last.
    pub gpu_ms: f64,
    /// On the device by named pass, in order of first use; empty where the device has no timestamps.
    pub passes_ms: Vec<(&'static str, f64)>,
}
