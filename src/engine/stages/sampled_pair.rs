//! Pairs for tests of the passes that sample both photographs.

use super::harness::{Input, build_stack, random_field, smooth_field};
use super::stack::{self, Slopes};
use super::state::{Registration, State};
use super::{Field, linearise};
use crate::base::{Kernel, Photometric, Similarity};
use crate::engine::vulkan::Variant;

/// A pair with V, T and blur stacks, for passes that sample both photographs.
pub(crate) struct SampledPair {
    pub(crate) i1: [Field; 1],
    pub(crate) v: [Field; 1],
    pub(crate) stacks: Vec<Field>,
    pub(crate) state: State,
    /// Whether the texture is noise of single pixels, with slopes of several intensities per pixel.
    pub(crate) is_random: bool,
    pub(crate) slopes: Slopes,
    /// Nodes of a stack, and the first layer of the stack of I2.
    pub(crate) nodes: u32,
    pub(crate) second_stack: u32,
    pub(crate) centre: [f32; 2],
    /// Mean of the kernel at V = 1.
    pub(crate) mean: [f32; 2],
}

impl SampledPair {
    /// Calls `check` with smooth, random and flat pairs of odd sizes and two kernels, and whether I2 is warped.
    /// `limit`: the largest |V| of the stacks.
    pub(crate) fn for_each(limit: f64, check: impl Fn(&Self, bool)) {
        for (width, height) in [(67, 43), (32, 33), (17, 140)] {
            let smooth = || [1, 2].map(|seed| smooth_field(width, height, seed));
            for kernel in [Kernel::Gaussian, Kernel::HalfGaussian] {
                check(&Self::new(smooth(), &kernel, limit), false);
                let random = Self::new([5, 6].map(|seed| random_field(width, height, seed)), &kernel, limit);
                check(&Self { is_random: true, ..random }, false);
            }
            check(&Self::new(smooth(), &Kernel::Gaussian, limit), true);
        }
        let flat = [(); 2].map(|()| Field::from_fn(35, 20, |_, _| 0.5));
        check(&Self::new(flat, &Kernel::Gaussian, limit), true);
    }

    fn new(images: [Field; 2], kernel: &Kernel, limit: f64) -> Self {
        let (nodes, slopes, [width, height]) =
            (stack::node_count(limit), Slopes::of(kernel), [images[0].width, images[0].height]);
        let mut v = smooth_field(width, height, 3);
        v.data.iter_mut().for_each(|v| *v = 8.0 * (*v - 0.5));
        let photometric = Photometric { gain: 1.1, offset: -0.03 };
        let mut state = State::new(&Registration::new(Similarity::new(0.7, -1.1, 0.4, 1.02), &photometric));
        state.white = 1.3;
        state.warped = (&Registration::new(Similarity::new(0.68, -1.07, 0.39, 1.019), &Photometric::IDENTITY)).into();
        let stacks = images.each_ref().map(|image| build_stack(image, kernel, nodes)).concat();
        let [i1, _] = images;
        Self {
            i1: [i1],
            v: [v],
            stacks,
            state,
            is_random: false,
            slopes,
            nodes: nodes as u32,
            second_stack: (nodes * slopes.layers()) as u32,
            centre: [width, height].map(|side| (side as f32 - 1.0) / 2.0),
            mean: kernel.mean().map(|m| m as f32),
        }
    }

    /// Width and height.
    pub(crate) fn size(&self) -> [u32; 2] {
        [self.v[0].width as u32, self.v[0].height as u32]
    }

    /// I1, V and the stacks.
    pub(crate) fn inputs(&self) -> [Input<'_>; 3] {
        [Input::Image(&self.i1), Input::Image(&self.v), Input::Image(&self.stacks)]
    }

    /// Variants of a pass, with packed stacks too where they can be.
    pub(crate) fn variants(&self, warped: bool, masked: bool) -> impl Iterator<Item = Variant> + use<> {
        let variant = linearise::variant(self.slopes, warped, masked, false);
        let packed = (self.slopes == Slopes::Laplacian).then(|| stack::packed(variant, true));
        [variant].into_iter().chain(packed)
    }
}
