//! Blurs both images until they look alike, for gain, offset and shading.
//!
//! Where V is right the two differ only by exposure and noise. Means and deviations then measure the exposure,
//! unaffected by the blur. Every other pixel is computed; the [window](super::uncertainty_terms::window()) then
//! averages the noise.

use super::blur::{Sample, Samples};
use super::mask::{self, Masks};
use super::pass::{Memory, Pass};
use super::rows::{self, Rows};
use super::state::{Registration, inside};
use super::uncertainty_terms;
use super::{Number, Raster, pixels, spline};
use crate::engine::vulkan::Variant;

pub use super::interface::blur_matched_pair::*;

/// Layers: I1 and I2, each times the share, and the share.
pub const LAYERS: u32 = 3;

impl Pass for Bindings {
    /// Compulsory traffic: on every fourth pixel V and two nodes of either stack read, three values written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        let [width, height] = uncertainty_terms::size([c.width, c.height]);
        32 * pixels(width, height)
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let state = memory.state(self.state);
        let masks = mask::of(memory, self.masks, variant);
        let [i1, v] = [memory.layer(self.image1, 0), memory.layer(self.relative_blur, 0)];
        let layers = memory.layers(self.stacks);
        let pair = if c.nodes == 0 {
            before_stacks(c, &state.registration, [i1, &layers[0]], masks)
        } else {
            let lens = (c.mean, c.factor, c.centre);
            let samples = Samples::of(state, layers, [c.second_stack, c.nodes], lens, variant);
            cpu_reference(c, &samples, v, masks)
        };
        pair.into_iter().enumerate().for_each(|(n, field)| memory.set_layer(self.pair, n, field));
    }
}

/// I1 and I2, each times the share, and the share, on every other pixel.
fn cpu_reference<N: Number>(
    c: &Constants,
    samples: &Samples<N>,
    v: &Raster<N>,
    masks: Option<&Masks<N>>,
) -> [Raster<N>; LAYERS as usize] {
    let size = uncertainty_terms::size([c.width, c.height]).map(|side| side as usize);
    let mut pair = [(); LAYERS as usize].map(|()| Raster::zeros(size[0], size[1]));
    rows::map(pair.each_mut().map(Rows::from), |y, mut rows| {
        let of_pixel = |x: usize| &v.row(2 * y)[x..];
        samples.visit_row(2 * y, 2, of_pixel, |Sample { x, d, blurred: [first, second], .. }| {
            let share = mask::counts(masks, [x, 2 * y], d);
            let numbers = [share * first, share * second, share];
            rows.iter_mut().zip(numbers).for_each(|(row, number)| row[x / 2] = N::of(number));
        });
    });
    pair
}

/// The same before there are stacks, from I1 and the spline of I2.
fn before_stacks<N: Number>(
    c: &Constants,
    r: &Registration,
    [i1, spline2]: [&Raster<N>; 2],
    masks: Option<&Masks<N>>,
) -> [Raster<N>; LAYERS as usize] {
    let size = uncertainty_terms::size([c.width, c.height]).map(|side| side as usize);
    Raster::several(size, |x, y| {
        let x = [2 * x, 2 * y];
        let d = r.displacement(x[0], x[1], c.factor.into(), c.centre.map(f64::from));
        if !inside(x, d, [c.width as usize, c.height as usize], [0.0; 2], r.scale()) {
            return [0.0; 3];
        }
        let share = mask::counts(masks, x, d);
        let second = spline::read(spline2, x[0] as f64 + d[0], x[1] as f64 + d[1]).value;
        [share * i1.get(x[0], x[1]), share * second, share]
    })
}
