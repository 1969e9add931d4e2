//! Computes the squared residual that neither blur nor T explains, on every other pixel.
//!
//! It is S², as in [`linearise`](mod@super::linearise). Averaged over the
//! [window](super::uncertainty_terms::window()), its root shows where something moved between the photographs, reflects
//! differently, or is occluded.

use super::blur::{Sample, Samples};
use super::pass::{Memory, Pass};
use super::{Number, Raster, pixels, uncertainty_terms};
use crate::engine::vulkan::Variant;

pub use super::interface::residual::*;

impl Pass for Bindings {
    /// Compulsory traffic: on every fourth pixel V and two nodes of either stack read, one value written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        let [width, height] = uncertainty_terms::size([c.width, c.height]);
        24 * pixels(width, height)
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let (state, layers) = (memory.state(self.state), memory.layers(self.stacks));
        let samples = Samples::of(state, layers, [c.second_stack, c.nodes], (c.mean, 1.0, c.centre), variant);
        let squared = cpu_reference(c, &samples, memory.layer(self.relative_blur, 0));
        memory.set_layer(self.terms, c.layer as usize, squared);
    }
}

/// The squared residual on every other pixel.
fn cpu_reference<N: Number>(c: &Constants, samples: &Samples<N>, v: &Raster<N>) -> Raster<N> {
    let [width, height] = uncertainty_terms::size([c.width, c.height]);
    let (mut squared, r) = (Raster::zeros(width as usize, height as usize), samples.displacement.r);
    squared.fill_rows(|y, row| {
        let v = |x: usize| &v.row(2 * y)[x..];
        samples.visit_row(2 * y, 2, v, |Sample { x, blurred: [b1, b2], .. }| {
            row[x / 2] = N::of((b1 - (r.gain * b2 + r.offset)).powi(2));
        });
    });
    squared
}
