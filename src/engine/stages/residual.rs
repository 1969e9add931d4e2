//! Computes the squared residual that neither blur nor T explains, on every other pixel.
//!
//! It is H S1² + (1 - H) S2², as in [`linearise`](mod@super::linearise). Averaged over the
//! [window](super::uncertainty_terms::window()), its root shows where something moved between the photographs, reflects
//! differently, or is occluded.

use super::blur::{Stacks, heaviside, sample_pair};
use super::pass::{Memory, Pass, bindings, push_constants};
use super::state::{Registration, inside};
use super::{Number, Raster, pixels, uncertainty_terms};
use crate::engine::vulkan::Variant;

push_constants! {
    /// Width of the image, pixels.
    width: u32,
    /// Height of the image, pixels.
    height: u32,
    /// Target layer.
    layer: u32,
    /// Nodes of the stacks.
    nodes: u32,
    /// First layer of the stack of I2.
    second_stack: u32,
    /// The image centre, pixels.
    centre: [f32; 2],
    /// Mean of the kernel at V = 1, px.
    mean: [f32; 2],
    /// ε of the Heaviside, px².
    epsilon: f32,
}

bindings! {
    RESIDUAL:
    i1: Reads<I1>,
    v: Reads<RelativeBlur>,
    stacks: Reads<Stacks>,
    /// The last layer of the uncertainty terms.
    terms: Writes<UncertaintyTerms>,
    state: Reads<State>,
}

impl Pass for Bindings {
    /// Compulsory traffic: on every fourth pixel V, I1, J and two nodes read, one value written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        let [width, height] = uncertainty_terms::size([c.width, c.height]);
        24 * pixels(width, height)
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let state = memory.state(self.state);
        let stacks = Stacks::of(memory.layers(self.stacks), c.second_stack, c.nodes, variant[0]);
        let warped = variant[1].then_some(&state.warped);
        let [i1, v] = [memory.layer(self.i1, 0), memory.layer(self.v, 0)];
        let squared = cpu_reference(c, &state.registration, warped, i1, v, &stacks);
        memory.set_layer(self.terms, c.layer as usize, squared);
    }
}

/// The squared residual on every other pixel. `warped` is T when I2 was warped onto I1's pixels, if it was.
pub fn cpu_reference<N: Number>(
    c: &Constants,
    r: &Registration,
    warped: Option<&Registration>,
    i1: &Raster<N>,
    v: &Raster<N>,
    stacks: &Stacks<N>,
) -> Raster<N> {
    let [width, height] = uncertainty_terms::size([c.width, c.height]);
    let (scale, moved) = (r.scale(), warped.map(|before| r.moved_since(before)));
    Raster::from_fn(width as usize, height as usize, |x, y| {
        let (x, v) = ([2 * x, 2 * y], v.get(2 * x, 2 * y));
        let d = r.displacement(x[0], x[1], 1.0, c.centre.map(f64::from));
        if !inside(x, d, [c.width as usize, c.height as usize], v, scale) {
            return 0.0;
        }
        let sample = sample_pair((c.mean, 1.0, c.centre), r, moved.as_ref(), x, i1, v, stacks);
        let s1 = sample.blurred[0].value - (r.gain * sample.i2.value + r.offset);
        let s2 = r.gain * sample.blurred[1].value + r.offset - sample.i1;
        let h = heaviside(v, c.epsilon.into());
        h * s1 * s1 + (1.0 - h) * s2 * s2
    })
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

    fn check(images: [Field; 2], kernel: &Kernel, warped: bool) {
        let [i1, i2] = images;
        let (width, height) = (i1.width, i1.height);
        let (nodes, slopes) = (stack::node_count(6.0), Slopes::of(kernel));
        let stacks = [&i1, &i2].map(|image| build_stack(image, kernel, nodes));
        let mut v = smooth_field(width, height, 3);
        v.data.iter_mut().for_each(|v| *v = 8.0 * (*v - 0.5));
        let c = Constants {
            width: width as u32,
            height: height as u32,
            layer: 1,
            nodes: nodes as u32,
            second_stack: (nodes * slopes.layers()) as u32,
            centre: [(width as f32 - 1.0) / 2.0, (height as f32 - 1.0) / 2.0],
            mean: kernel.mean().map(|m| m as f32),
            epsilon: 0.1,
        };
        let transform = Similarity::new(0.7, -1.1, 0.4, 1.02);
        let photometric = Photometric { gain: 1.1, offset: -0.03 };
        let mut state = State::new(&Registration::new(transform, &photometric));
        state.white = 1.3;
        state.warped = (&Registration::new(Similarity::new(0.68, -1.07, 0.39, 1.019), &Photometric::IDENTITY)).into();
        let (i1, v, stacks) = ([i1], [v], stacks.concat());
        let inputs = [&i1[..], &v, &stacks].map(Input::Image);
        let inputs = [&inputs[..], &[Input::Unread, Input::State(&state)]].concat();
        let variant = linearise::variant(slopes, warped, false, false);
        let groups = STAGE.groups(uncertainty_terms::size([c.width, c.height]));
        // 2e-5: a residual of up to 1, squared in single precision.
        for is_packed in [false, slopes == Slopes::Laplacian] {
            let variant = stack::packed(variant, is_packed);
            Trial::run::<Bindings>(&inputs, &c, variant, groups).assert_within(2e-5);
        }
    }

    #[test]
    fn matches_the_cpu_reference() {
        for (width, height) in [(67, 43), (32, 33), (17, 40)] {
            let smooth = || [1, 2].map(|seed| smooth_field(width, height, seed));
            for kernel in [Kernel::Gaussian, Kernel::HalfGaussian] {
                check(smooth(), &kernel, false);
                check([5, 6].map(|seed| random_field(width, height, seed)), &kernel, false);
            }
            check(smooth(), &Kernel::Gaussian, true);
        }
        let flat = || Field::from_fn(35, 20, |_, _| 0.5);
        check([flat(), flat()], &Kernel::Gaussian, true);
    }
}
