//! What is common to all pixels of a sweep: the registration of its frames, their brightness, and c.

use crate::base::{Homography, Shading};
use crate::engine::plan::Level;

/// How far beyond the first and the last frame u may lie, px of blur.
const BEYOND: f64 = 0.5;

/// What is common to all pixels.
#[derive(Clone)]
pub(super) struct Common {
    /// Ascending.
    pub(super) settings: Vec<f64>,
    /// Half-way between the first and the last.
    pub(super) middle: f64,
    pub(super) reference: usize,
    /// px² of the full-size image.
    pub(super) rate: f64,
    pub(super) transforms: Vec<Homography>,
    /// As they were when the frames were last brought onto the reference's pixels.
    pub(super) aligned: Vec<Option<Homography>>,
    pub(super) brightness: Vec<(f64, Shading)>,
    /// Pairs that tell of a pixel, on average over those that count.
    pub(super) telling: f64,
}

impl Common {
    /// c on a level.
    pub(super) fn rate_on(&self, level: &Level) -> f64 {
        self.rate / (level.factor * level.factor)
    }

    /// The wider of the gaps to the settings beside a frame's.
    pub(super) fn gap(&self, n: usize) -> f64 {
        let gap = |n: usize| self.settings.get(n + 1).map_or(0.0, |next| next - self.settings[n]);
        gap(n).max(if n > 0 { gap(n - 1) } else { 0.0 })
    }

    /// How far u may lie from the middle.
    pub(super) fn limit(&self, level: &Level) -> f64 {
        self.settings[self.settings.len() - 1] - self.middle + BEYOND / self.rate_on(level).sqrt()
    }
}
