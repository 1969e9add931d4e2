//! Blurs the sharper image by V so that both look alike, for gain, offset and shading.
//!
//! Where V is right the two differ only by exposure and noise. Means and deviations then measure the exposure,
//! unaffected by the blur. Every other pixel is computed; the [window](super::uncertainty_terms::window()) then
//! averages the noise.

use super::blur::{Stacks, sample_pair};
use super::mask::{self, Masks};
use super::pass::{Memory, Pass, bindings, push_constants};
use super::state::{Registration, inside};
use super::uncertainty_terms;
use super::{Number, Raster, pixels, spline};
use crate::engine::vulkan::Variant;

/// Layers: I1 and I2, each times the share, and the share.
pub const LAYERS: u32 = 3;

push_constants! {
    /// Width of the level, pixels.
    width: u32,
    /// Height of the level, pixels.
    height: u32,
    /// Nodes of the stacks; 0 before there are any: then V is zero and only the spline of I2 is read.
    nodes: u32,
    /// First layer of the stack of I2.
    second_stack: u32,
    /// Pixels of the full-size image per pixel of this level.
    factor: f32,
    /// The image centre in pixels of this level.
    centre: [f32; 2],
    /// Mean of the kernel at V = 1, px.
    mean: [f32; 2],
}

bindings! {
    BLUR_MATCHED_PAIR:
    i1: Reads<I1>,
    v: Reads<RelativeBlur>,
    /// Stacks of I1 and I2, or spline coefficients of I2.
    stacks: Reads<Words>,
    /// The blur-matched pair, with shares.
    pair: Writes<UncertaintyTerms>,
    state: Reads<State>,
    masks: Reads<Masks>,
}

impl Pass for Bindings {
    /// Compulsory traffic: on every fourth pixel I1, V, and of the stacks the two nodes about V and the other image
    /// read, three values written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        let [width, height] = uncertainty_terms::size([c.width, c.height]);
        32 * pixels(width, height)
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let state = memory.state(self.state);
        let masks = mask::of(memory, self.masks, variant);
        let [i1, v] = [memory.layer(self.i1, 0), memory.layer(self.v, 0)];
        let layers = memory.layers(self.stacks);
        let images = if c.nodes == 0 {
            Images::Spline(&layers[0])
        } else {
            let stacks = Stacks::of(layers, c.second_stack, c.nodes, variant[0]);
            Images::Stacks(stacks, variant[1].then_some(&state.warped))
        };
        let pair = cpu_reference(c, &state.registration, i1, v, &images, masks);
        pair.into_iter().enumerate().for_each(|(n, field)| memory.set_layer(self.pair, n, field));
    }
}

/// The source of I2.
pub enum Images<'a, N = f64> {
    /// Its spline coefficients; V is zero.
    Spline(&'a Raster<N>),
    /// The stacks, and T when I2 was warped onto I1's pixels, if it was.
    Stacks(Stacks<'a, N>, Option<&'a Registration>),
}

/// I1 and I2, each times the share, and the share, on every other pixel.
pub fn cpu_reference<N: Number>(
    c: &Constants,
    r: &Registration,
    i1: &Raster<N>,
    v: &Raster<N>,
    images: &Images<N>,
    masks: Option<&Masks<N>>,
) -> [Raster<N>; LAYERS as usize] {
    let [width, height] = uncertainty_terms::size([c.width, c.height]).map(|side| side as usize);
    let scale = r.scale();
    let moved = match images {
        Images::Stacks(_, Some(warped)) => Some(r.moved_since(warped)),
        _ => None,
    };
    let at = |x: usize, y: usize| {
        let (x, v) = ([2 * x, 2 * y], v.get(2 * x, 2 * y));
        let d = r.displacement(x[0], x[1], c.factor.into(), c.centre.map(f64::from));
        if !inside(x, d, [c.width as usize, c.height as usize], v, scale) {
            return [0.0; 3];
        }
        let share = mask::counts(masks, x, d);
        let i1_here = i1.get(x[0], x[1]);
        let [first, second] = match images {
            Images::Spline(spline2) => [i1_here, spline::read(spline2, x[0] as f64 + d[0], x[1] as f64 + d[1]).value],
            Images::Stacks(stacks, _) => {
                let sample = sample_pair((c.mean, c.factor, c.centre), r, moved.as_ref(), x, i1, v, stacks);
                let [b1, b2] = sample.blurred;
                if v >= 0.0 { [b1.value, sample.i2.value] } else { [i1_here, b2.value] }
            }
        };
        [share * first, share * second, share]
    };
    Raster::several([width, height], at)
}

#[cfg(test)]
mod tests {
    use super::super::Field;
    use super::super::harness::{Input, Trial, build_stack, random_field, smooth_field};
    use super::super::linearise;
    use super::super::stack::{self, Slopes};
    use super::super::state::State;
    use super::*;
    use crate::base::{Kernel, Photometric, Similarity};

    fn check(images: [Field; 2], kernel: &Kernel, [stacked, warped, masked]: [bool; 3]) {
        let [i1, i2] = images;
        let (width, height) = (i1.width, i1.height);
        let (nodes, slopes) = (stack::node_count(6.0), Slopes::of(kernel));
        let stacks = [&i1, &i2].map(|image| build_stack(image, kernel, nodes));
        let mut v = smooth_field(width, height, 3);
        v.data.iter_mut().for_each(|v| *v = if stacked { 8.0 * (*v - 0.5) } else { 0.0 });
        let c = Constants {
            width: width as u32,
            height: height as u32,
            nodes: if stacked { nodes as u32 } else { 0 },
            second_stack: if stacked { (nodes * slopes.layers()) as u32 } else { 0 },
            factor: 2.0,
            centre: [(width as f32 - 1.0) / 2.0, (height as f32 - 1.0) / 2.0],
            mean: kernel.mean().map(|m| m as f32),
        };
        let transform = Similarity::new(1.4, -2.2, 0.4, 1.02);
        let mut state = State::new(&Registration::new(transform, &Photometric { gain: 1.1, offset: -0.03 }));
        state.white = 1.3;
        state.warped = (&Registration::new(Similarity::new(1.36, -2.14, 0.39, 1.019), &Photometric::IDENTITY)).into();
        let masks = [7, 8].map(|seed| mask::shares(width, height, seed));
        let layers = if stacked { stacks.concat() } else { vec![stacks[1][0].clone()] };
        let (i1, v) = ([i1], [v]);
        let [i1, v, layers, masks] = [&i1[..], &v, &layers, &masks].map(Input::Image);
        let inputs = [i1, v, layers, Input::Unread, Input::State(&state), masks];
        let slopes = if stacked { slopes } else { Slopes::Laplacian };
        let variant = linearise::variant(slopes, warped, masked, false);
        let groups = STAGE.groups(uncertainty_terms::size([c.width, c.height]));
        // Intensities of 0 to 1 interpolated in single precision.
        for is_packed in [false, stacked && slopes == Slopes::Laplacian] {
            let variant = stack::packed(variant, is_packed);
            Trial::run::<Bindings>(&inputs, &c, variant, groups).assert_within(2e-5);
        }
    }

    #[test]
    fn matches_the_cpu_reference() {
        for (width, height) in [(67, 43), (32, 33), (17, 40)] {
            let smooth = || [1, 2].map(|seed| smooth_field(width, height, seed));
            let random = || [5, 6].map(|seed| random_field(width, height, seed));
            for masked in [false, true] {
                check(smooth(), &Kernel::Gaussian, [true, true, masked]);
                check(random(), &Kernel::Gaussian, [true, false, masked]);
                check(smooth(), &Kernel::HalfGaussian, [true, false, masked]);
                check(random(), &Kernel::Gaussian, [false, false, masked]);
            }
        }
        let flat = || Field::from_fn(35, 20, |_, _| 0.5);
        check([flat(), flat()], &Kernel::Gaussian, [true, true, false]);
    }
}
