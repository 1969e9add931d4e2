//! Computes the squared residual that neither blur nor T explains, on every other pixel.
//!
//! It is H S1² + (1 - H) S2², as in [`linearise`](mod@super::linearise). Averaged over the
//! [window](super::uncertainty_terms::window()), its root shows where something moved between the photographs, reflects
//! differently, or is occluded.

use super::blur::{Sample, Samples, Stacks, heaviside};
use super::pass::{Memory, Pass};
use super::{Number, Raster, pixels, uncertainty_terms};
use crate::engine::vulkan::Variant;

pub use super::interface::residual::*;

impl Pass for Bindings {
    /// Compulsory traffic: on every fourth pixel V, I1, J and two nodes read, one value written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        let [width, height] = uncertainty_terms::size([c.width, c.height]);
        24 * pixels(width, height)
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let state = memory.state(self.state);
        let stacks = Stacks::of(memory.layers(self.stacks), c.second_stack, c.nodes, variant.has(Variant::ANY_KERNEL));
        let (warped, r) = (variant.has(Variant::WARPED).then_some(&state.warped), &state.registration);
        let (i1, lens) = (memory.layer(self.image1, 0), (c.mean, 1.0, c.centre));
        let squared = cpu_reference(c, &Samples { lens, r, warped, i1, stacks }, memory.layer(self.relative_blur, 0));
        memory.set_layer(self.terms, c.layer as usize, squared);
    }
}

/// The squared residual on every other pixel.
fn cpu_reference<N: Number>(c: &Constants, samples: &Samples<N>, v: &Raster<N>) -> Raster<N> {
    let [width, height] = uncertainty_terms::size([c.width, c.height]);
    let (mut squared, r) = (Raster::zeros(width as usize, height as usize), samples.r);
    squared.fill_rows(|y, row| {
        let v = |x: usize| &v.row(2 * y)[x..];
        samples.visit_row(2 * y, 2, v, |Sample { x, v, sharp: [i1, j], blurred: [b1, b2], .. }| {
            let (s1, s2) = (b1 - (r.gain * j + r.offset), r.gain * b2 + r.offset - i1);
            let h = heaviside(v, c.epsilon.into());
            row[x / 2] = N::of(h * s1 * s1 + (1.0 - h) * s2 * s2);
        });
    });
    squared
}
