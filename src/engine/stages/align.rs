//! Resamples a frame of a sweep onto the reference's pixels, by T and by the parallax of u, and matches its brightness.

use super::pass::{Memory, Pass};
use super::segments::{SEGMENT, segment};
use super::state::{Displacement, Double};
use super::{Number, Raster, spline, warp};
use crate::base::Parallax;
use crate::engine::vulkan::Variant;

pub use super::interface::align::*;

impl Pass for Bindings {
    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let reused = memory.take_layer(self.aligned, c.layer as usize);
        let aligned = cpu_reference(reused, c, memory.layer(self.spline, 0), memory.layer(self.focus, 0));
        memory.set_layer(self.aligned, c.layer as usize, aligned);
    }
}

/// The frame on the reference's pixels, in the memory of a raster. Beyond its border it repeats the border.
fn cpu_reference<N: Number>(reused: Raster<N>, c: &Constants, spline: &Raster<N>, focus: &Raster<N>) -> Raster<N> {
    let (r, centre) = (c.registration.double(), c.centre.map(f64::from));
    let shading = c.shading.double();
    // u takes the place of V, which is in px² of the full-size image.
    let across = c.parallax.map(|px| f64::from(px) / f64::from(c.factor));
    let parallax = Parallax { across, along: 0.0 };
    let size = [c.width as usize, c.height as usize];
    warp::displaced(
        reused.of_size(size),
        Displacement { r: &r, parallax, factor: c.factor.into(), centre },
        #[inline(always)]
        |[x, y]| segment(&focus.row(y)[x..]),
        #[inline(always)]
        |at, d| {
            let mut values = [N::default(); SEGMENT];
            spline::read_segment(
                spline,
                at,
                d,
                |last| [-1.0, last + 1.0],
                #[inline(always)]
                |n, jet| values[n] = jet.value,
            );
            let ([gain, offset, least], ends): (_, [N; 2]) =
                (N::all([r.gain, r.offset, -1.0]), N::all(size.map(|side| side as f64)));
            let factors = warp::factors(
                &shading,
                centre,
                at,
                d,
                #[inline(always)]
                |place, axis| place.max(least).min(ends[axis]),
            );
            for n in 0..SEGMENT {
                values[n] = gain * factors[n] * values[n] + offset;
            }
            values
        },
    )
}
