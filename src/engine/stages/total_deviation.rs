//! Adds to the standard deviation of V the correlation of neighbouring residuals, and the deviation of V's
//! [scale](mod@super::scale_deviation).
//!
//! The search for depth edges runs before this pass. It compares levels of one pair, which share the scale, so it needs
//! only the errors that differ from pixel to pixel. Section 7 of `docs/method.md`.

use super::pass::{Memory, Pass};
use super::segments::{SEGMENT, segment};
use super::uncertainty::{LARGEST, WINDOW_PIXELS};
use super::uncertainty_terms::{self, at_pixels};
use super::{Number, Raster, pixels};
use crate::engine::vulkan::Variant;

pub use super::interface::total_deviation::*;

impl Constants {
    /// The constants of an image.
    pub(crate) fn new([width, height]: [u32; 2]) -> Self {
        Self { width, height, pixels: WINDOW_PIXELS, largest: LARGEST }
    }
}

impl Pass for Bindings {
    /// Compulsory traffic: V and its deviation read, and on every fourth pixel three terms; the deviation written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        let [width, height] = uncertainty_terms::size([c.width, c.height]);
        12 * pixels(c.width, c.height) + 12 * pixels(width, height)
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let (state, terms) = (memory.state(self.state), memory.layers(self.terms));
        let terms = [&terms[0], &terms[1], &terms[3]];
        let of_state = [state.scale_deviation, state.correlated];
        let total = cpu_reference(c, of_state, [memory.layer(self.results, 0), memory.layer(self.results, 1)], terms);
        memory.set_layer(self.results, 1, total);
    }
}

/// The standard deviation of V, from the deviation of V's scale, by how much the correlation of residuals counts, V,
/// its deviation so far, and the means of the curvature, b² and b Σb.
pub fn cpu_reference<N: Number>(
    c: &Constants,
    [scale, correlated]: [f64; 2],
    [v, deviation]: [&Raster<N>; 2],
    [curvature, b2, alike]: [&Raster<N>; 3],
) -> Raster<N> {
    let (pixels, largest) = (f64::from(c.pixels), f64::from(c.largest));
    let [total] = Raster::fill_segments(
        [Raster::zeros(v.width, v.height)],
        #[inline(always)]
        |at @ [x, y]| {
            let [v, mut deviations] = [segment(&v.row(y)[x..]), segment(&deviation.row(y)[x..])];
            let [curvature, b2, alike] = [at_pixels(curvature, at), at_pixels(b2, at), at_pixels(alike, at)];
            for n in 0..SEGMENT {
                let (so_far, v): (f64, f64) = (deviations[n].into(), v[n].into());
                let covariance = correlated * (alike[n] - b2[n]).max(0.0) / (pixels * curvature[n] * curvature[n]);
                let covariance = if curvature[n] > 0.0 { covariance } else { 0.0 };
                let total = (so_far * so_far + covariance + (scale * v) * (scale * v)).sqrt().min(largest);
                // It stays where it is not a number.
                deviations[n] = if so_far < largest { N::of(total) } else { deviations[n] };
            }
            [deviations]
        },
    );
    total
}

#[cfg(test)]
mod tests {
    use super::super::Field;

    use super::*;

    /// N pixels with residuals of deviation s, weight w and slope g, alike in groups of m: `σ² = m s²/(g² N)`.
    #[test]
    fn residuals_that_are_alike_count_once() {
        let (s, g, w, m) = (0.02, 0.01, 40.0, 4.0);
        let flat = |size: usize, value: f64| Field::from_fn(size, size, |_, _| value);
        let by_chance = s / (g * f64::from(WINDOW_PIXELS).sqrt());
        let b2 = w * w * g * g * s * s;
        let terms = [flat(16, w * g * g), flat(16, b2), flat(16, m * b2)];
        let total = cpu_reference(
            &Constants::new([32; 2]),
            [0.1, 1.0],
            [&flat(32, -5.0), &flat(32, by_chance)],
            terms.each_ref(),
        );
        let expected = (m * by_chance * by_chance + 0.25).sqrt();
        assert!((total.get(16, 16) / expected - 1.0).abs() < 1e-6, "{} {expected}", total.get(16, 16));
    }
}
