//! Warps I2: resamples it onto I1's pixels by T, and applies the shading. With parallax, which differs from pixel to
//! pixel, it applies the shading alone.
//!
//! A blur stack of the warped I2 can be read on the pixels.
//!
//! The blur of a warped image is the warped blur, with a variance in I1's pixels. T may still move a little:
//! [`linearise`](super::linearise) follows it by the gradient on each pixel.

use super::pass::{Memory, Pass};
use super::segments::{SEGMENT, Segment, place};
use super::state::{Displacement, Registration};
use super::{Number, Raster, spline};
use crate::base::{Homography, Parallax, Photometric, Shading};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

pub use super::interface::warp::*;

/// Lines per invocation.
const ROWS: u32 = shaders::warp::ROWS;

/// Workgroups over a level.
pub(crate) fn tiles([width, height]: [u32; 2]) -> [u32; 3] {
    STAGE.groups([width, height.div_ceil(ROWS)])
}

impl Pass for Bindings {
    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let reused = memory.take_layer(self.to, c.layer as usize);
        let state = memory.state(self.state);
        let (r, shading) = (state.registration, state.shading);
        let unmoved = Registration::new(Homography::IDENTITY, &Photometric::IDENTITY);
        let by = if state.parallax == Parallax::NONE { &r } else { &unmoved };
        let samples = cpu_reference(reused, c, by, &shading, memory.layer(self.spline2, 0));
        memory.set_layer(self.to, c.layer as usize, samples);
        let state = memory.state_mut(self.state);
        (state.warped, state.applied_shading) = (r, shading);
    }
}

/// Samples of I2 at T x times the shading, mirrored once where T leaves I2, in the memory of a raster.
fn cpu_reference<N: Number>(
    reused: Raster<N>,
    c: &Constants,
    r: &Registration,
    shading: &Shading,
    spline2: &Raster<N>,
) -> Raster<N> {
    let centre = c.centre.map(f64::from);
    displaced(
        reused.of_size([spline2.width, spline2.height]),
        Displacement { r, parallax: Parallax::NONE, factor: c.factor.into(), centre },
        #[inline(always)]
        |_| [N::default(); SEGMENT],
        #[inline(always)]
        |at, d| resampled(shading, centre, spline2, at, d),
    )
}

/// Fills a raster with the values of segments of pixels from (x, y) to the right, which are displaced by d. `v` returns
/// their V, which parallax depends on.
pub(super) fn displaced<N: Number>(
    raster: Raster<N>,
    displacement: Displacement<'_>,
    v: impl Fn([usize; 2]) -> Segment<N> + Sync,
    values: impl Fn([usize; 2], [&Segment<N>; 2]) -> Segment<N> + Sync,
) -> Raster<N> {
    let [raster] = Raster::fill_segments(
        [raster],
        #[inline(always)]
        |at| {
            let [mut dx, mut dy] = [[N::default(); SEGMENT]; 2];
            displacement.of_row(at, &v(at), [&mut dx, &mut dy]);
            [values(at, [&dx, &dy])]
        },
    );
    raster
}

/// I2 times the shading at the pixels of the segment from (x, y) to the right, displaced by d.
#[inline(always)]
pub(super) fn resampled<N: Number>(
    shading: &Shading,
    centre: [f64; 2],
    spline2: &Raster<N>,
    at: [usize; 2],
    d: [&Segment<N>; 2],
) -> Segment<N> {
    let mut values = [N::default(); SEGMENT];
    spline::read_segment(
        spline2,
        at,
        d,
        |last| [-2.0 * last - 1.0, 2.0 * last + 1.0],
        #[inline(always)]
        |n, jet| values[n] = jet.value,
    );
    let last: [N; 2] = N::all([spline2.width as f64 - 1.0, spline2.height as f64 - 1.0]);
    let factors = factors(
        shading,
        centre,
        at,
        d,
        #[inline(always)]
        |place, axis| {
            let (inner, last) = (place.abs(), last[axis]);
            (last - inner).choose(inner, last + last - inner)
        },
    );
    for n in 0..SEGMENT {
        values[n] = factors[n] * values[n];
    }
    values
}

/// The shading's factors at the pixels of the segment from (x, y) to the right, displaced by d. `inside` returns the
/// place along an axis at which the shading stands for that of a pixel, which may be beyond the border.
#[inline(always)]
pub(super) fn factors<N: Number>(
    shading: &Shading,
    centre: [f64; 2],
    at: [usize; 2],
    d: [&Segment<N>; 2],
    inside: impl Fn(N, usize) -> N,
) -> Segment<N> {
    let (centre, mut factors): ([N; 2], _) = (N::all(centre), [N::default(); SEGMENT]);
    for n in 0..SEGMENT {
        let mut position = [place::<N>(at[0], n) + d[0][n], N::of(at[1] as f64) + d[1][n]];
        for axis in 0..2 {
            position[axis] = (inside(position[axis], axis) - centre[axis]) / centre[axis];
        }
        factors[n] = shading.factor(position, N::of).max(N::of(0.25)).min(N::of(4.0));
    }
    factors
}

#[cfg(test)]
mod tests {
    use super::super::Field;
    use super::super::harness::build_stack;

    use super::*;
    use crate::base::{Photometric, Similarity};

    #[test]
    fn a_wave_is_displaced_as_in_closed_form() {
        let k = 0.7;
        let wave = |x: f64, y: f64| 0.5 + 0.4 * (k * x + 0.3 * k * y).cos();
        let field = Field::from_fn(60, 40, |x, y| wave(x as f64, y as f64));
        let spline2 = build_stack(&field, &crate::base::Kernel::Gaussian, 1).swap_remove(0);
        let r = Registration::new(Similarity::new(1.3, -0.7, 0.8, 1.02), &Photometric::IDENTITY);
        let c = Constants { width: 60, height: 40, layer: 0, factor: 1.0, centre: [29.5, 19.5] };
        let actual = cpu_reference(Raster::default(), &c, &r, &Shading::NONE, &spline2);
        for y in 15..25 {
            for x in 15..45 {
                let d = r.displacement(x, y, 1.0, [29.5, 19.5]);
                let expected = wave(x as f64 + d[0], y as f64 + d[1]);
                // A cubic spline reproduces a wave of 8.6 px to about (k/2π)⁴ = 2e-4 of its amplitude per axis, at
                // worst between the pixels.
                assert!((actual.get(x, y) - expected).abs() < 3e-4, "({x}, {y}): {} {expected}", actual.get(x, y));
            }
        }
    }
}
