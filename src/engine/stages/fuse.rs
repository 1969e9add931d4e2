//! Computes one channel of the fused image, equation 37: `r̃ = I1 H(V) + J (1 - H(V))`.
//!
//! It is the sharper image at each pixel. J includes gain, offset and shading, which avoids seams. Where I2 does not
//! reach, the result is I1.

use super::law::share_of_first;
use super::pass::{Memory, Pass};
use super::segments::{SEGMENT, place, segment};
use super::state::{Displacement, from_centre, inside, margin};
use super::{Number, Raster, spline, warp};
use crate::base::Shading;
use crate::engine::vulkan::Variant;

pub use super::interface::fuse::*;

impl Pass for Bindings {
    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let reused = memory.take_layer(self.result, c.layer as usize);
        let state = memory.state(self.state);
        let fused = cpu_reference(
            reused,
            (
                Displacement { r: &state.registration.in_intensities(state.unit), ..state.displacement(1.0, c.centre) },
                &state.applied_shading,
            ),
            memory.layer(self.channel1, 0),
            memory.layer(self.spline2, 0),
            memory.layer(self.relative_blur, 0),
        );
        memory.set_layer(self.result, c.layer as usize, fused);
    }
}

/// The fused channel, in the memory of a raster.
fn cpu_reference<N: Number>(
    reused: Raster<N>,
    (displacement, shading): (Displacement, &Shading),
    channel1: &Raster<N>,
    coefficients2: &Raster<N>,
    v: &Raster<N>,
) -> Raster<N> {
    let (size, Displacement { r, centre, .. }) = ([v.width, v.height], displacement);
    let [fused] = Raster::fill_segments(
        [reused.of_size(size)],
        #[inline(always)]
        |at @ [x, y]| {
            let [i1, v] = [segment(&channel1.row(y)[x..]), segment(&v.row(y)[x..])];
            let mut d = [[N::default(); SEGMENT]; 2];
            let [dx, dy] = &mut d;
            displacement.of_row(at, &v, [dx, dy]);
            let d = d.each_ref();
            let mut fused = warp::resampled(shading, centre, coefficients2, at, d);
            let [gain, offset, one, row] = N::all([r.gain, r.offset, 1.0, y as f64]);
            for n in 0..SEGMENT {
                let (h, j) = (share_of_first(v[n]), gain * fused[n] + offset);
                let inside = margin([place(x, n), row], [d[0][n], d[1][n]], size, [N::default(); 2], 1.0);
                fused[n] = inside.choose(h * i1[n] + (one - h) * j, i1[n]);
            }
            [fused]
        },
    );
    fused
}

/// A channel of I1 and J at a pixel with this V, from that of I1 and the spline coefficients of I2. Where I2 does not reach, both
/// are I1. The CPU reference of `glsl/include/fuse.glsl`.
pub(super) fn photographs<N: Number>(
    (displacement, shading): (Displacement, &Shading),
    [channel1, coefficients2]: [&Raster<N>; 2],
    ([x, y], v): ([usize; 2], f64),
) -> [f64; 2] {
    let (size, Displacement { r, centre, .. }) = ([channel1.width, channel1.height], displacement);
    let (i1, d) = (channel1.get(x, y), displacement.of([x as f64, y as f64], v));
    if !inside([x, y], d, size, [0.0; 2], 1.0) {
        return [i1; 2];
    }
    let at = [x as f64 + d[0], y as f64 + d[1]];
    let applied_shading = shading.at(from_centre(at, centre)) * spline::read(coefficients2, at[0], at[1]).value;
    [i1, r.gain * applied_shading + r.offset]
}
