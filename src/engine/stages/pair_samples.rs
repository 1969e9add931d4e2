//! Samples the [blur-matched pair](super::blur_matched_pair), averaged over the
//! [window](super::uncertainty_terms::window()).
//!
//! [`exposure`](super::exposure) needs the averages at a few thousand places only: a sixth of the work of smoothing all
//! of the pair.

use super::blur_matched_pair::LAYERS;
use super::pass::{Memory, Pass};
use super::separable::weigh;
use super::spline::fold;
use super::{Number, Raster, pixels};
use crate::engine::plan::FilterRange;
use crate::engine::vulkan::Variant;

pub use super::interface::pair_samples::*;

/// The most weights of the window along an axis.
const TAPS: u32 = crate::engine::shaders::pair_samples::TAPS;

impl Constants {
    /// The constants of a pair of a size, sampled at every `every`-th pixel.
    pub(crate) fn new([width, height]: [u32; 2], every: u32, window: FilterRange) -> Self {
        let FilterRange { offset, radius, .. } = window;
        assert!(2 * radius < TAPS, "a window of radius {radius}");
        Self { width, height, every, offset, radius }
    }

    /// Columns and rows of samples.
    pub(crate) fn samples(&self) -> [u32; 2] {
        [self.width, self.height].map(|side| side.div_ceil(self.every))
    }

    /// Workgroups over the samples of all layers.
    pub(crate) fn groups(&self) -> [u32; 3] {
        let [x, y, _] = STAGE.groups(self.samples());
        [x, y, LAYERS]
    }
}

impl Pass for Bindings {
    /// Compulsory traffic: the pair read, the samples written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        let [columns, rows] = c.samples();
        4 * u64::from(LAYERS) * (pixels(c.width, c.height) + pixels(columns, rows))
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let first = 4 * c.offset as usize;
        let window = memory.numbers(self.filters)[first..][..2 * c.radius as usize + 1].to_vec();
        let layers = (0..LAYERS as usize).map(|n| cpu_reference(c, &window, memory.layer(self.pair, n)));
        let samples: Vec<N> = layers.flat_map(|layer| layer.data).collect();
        memory.numbers_mut(self.samples, samples.len())[..samples.len()].copy_from_slice(&samples);
    }
}

/// The means over the windows around every `every`-th pixel of a layer, mirrored at its border.
pub fn cpu_reference<N: Number>(c: &Constants, window: &[N], layer: &Raster<N>) -> Raster<N> {
    let [columns, rows] = c.samples().map(|count| count as usize);
    let (every, radius) = (c.every as usize, c.radius as isize);
    let [across, down] = [layer.width, layer.height].map(|side| (2 * (side - 1)).max(1));
    let mut means = Raster::zeros(columns, rows);
    means.fill_rows(|y, means| {
        let near: Vec<&[N]> = (-radius..=radius).map(|n| layer.row(fold((y * every) as isize + n, down))).collect();
        let mut row = vec![N::default(); layer.width];
        weigh(&mut row, window, &near);
        for (x, mean) in means.iter_mut().enumerate() {
            let place = |n: usize| fold((x * every + n) as isize - radius, across);
            *mean = window.iter().enumerate().fold(N::default(), |sum, (n, &weight)| sum + weight * row[place(n)]);
        }
    });
    means
}

#[cfg(test)]
mod tests {
    use super::super::harness::{Rig, assert_numbers, random_field};
    use super::super::separable::filtered;
    use super::super::uncertainty_terms::window;
    use super::*;
    use crate::engine::vulkan::Resource;

    #[test]
    fn matches_the_cpu_reference_and_samples_what_separable_smooths() {
        let window = window();
        for ([width, height], every) in [([37, 21], 4), ([150, 80], 3), ([8, 9], 1), ([5, 2], 1), ([64, 64], 8)] {
            let layers: Vec<_> = (0..u64::from(LAYERS)).map(|seed| random_field(width, height, seed)).collect();
            let range = FilterRange { bank: 0, offset: 2, blocks: 1, radius: (window.len() / 2) as u32 };
            let c = Constants::new([width as u32, height as u32], every, range);
            let expected: Vec<f64> = layers.iter().flat_map(|layer| cpu_reference(&c, &window, layer).data).collect();
            let [columns, rows] = c.samples().map(|count| count as usize);
            for (n, expected) in expected.iter().enumerate() {
                let (plane, at) = (n / (columns * rows), n % (columns * rows));
                let [x, y] = [at % columns, at / columns].map(|place| place * every as usize);
                let smoothed = filtered(&layers[plane], [&window; 2], 1).get(x, y);
                assert!((smoothed - expected).abs() < 1e-12, "{expected}, not {smoothed}");
            }
            let rig = Rig::new();
            let (weights, samples) = (rig.filter(2, &window), rig.numbers(vec![f64::NAN; expected.len()]));
            let pair = rig.image(&layers);
            let resources = [Resource::Image(&pair), Resource::Uniform(&weights), Resource::Buffer(&samples)];
            rig.run_groups(&STAGE, &resources, &c, c.groups());
            // 1e-6: 361 products of single precision whose weights add up to 1.
            assert_numbers(&rig.floats(&samples), &expected, 1e-6);
        }
    }
}
