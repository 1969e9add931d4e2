//! Computes the standard deviation of the scale of V, as a share of V.
//!
//! A kernel that does not describe the blur makes all of V too large or too small, by a factor that differs between the
//! in-focus and the blurred parts of a scene. Two quantities indicate this error:
//!
//! - **The shape of the kernel.** If a disk blurs one photograph only, the shape θ is 1. If disks blur both, their
//!   fourth cumulants make it `1 + 2 v/V`, v the variance of the narrower: it differs from place to place, and V, found
//!   with one θ, is off. On planes and reliefs through the focus of a lens that blurs by disks, θ is 1.1 to 1.8 and V
//!   0.93 to 1.06 times the true one in the median (frames 3 and 9, 4 and 8, 6 and 9, 1 and 11 of 12). The standard
//!   deviation of the scale is taken as 0.15 (θ - 1). On cards and blocks, whose parts are each sharp in one of the
//!   two, θ is 1.0 to 1.24 and V 0.98 to 1.01 times the true one. Gaussians have no such error.
//! - **The correlation of neighbouring residuals.** Noise differs from pixel to pixel. What the kernel leaves is alike
//!   over a feature of the texture. The ratio of b times the sum of b around it to b² is 1 for the former, and 3 to 11
//!   on real pairs. Their V is 1.06 to 1.4 times that of their sweeps.
//!
//! `docs/experiments/noise.md` has what was tried.
//!
//! Section 7 of `docs/method.md`.

use super::pass::{Memory, Pass};
use super::uncertainty::LARGEST;
use super::{Number, Raster, uncertainty, uncertainty_terms};
use crate::base::{Kernel, Settings};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

pub use super::interface::scale_deviation::*;

impl Constants {
    /// The constants of an image.
    pub(crate) fn new(size: [u32; 2], settings: &Settings) -> Self {
        let ([width, height], at_limit) =
            (uncertainty_terms::size(size), uncertainty::at_limit(settings.max_relative_blur));
        let shape = if settings.kernel == Kernel::Pillbox { BLURRED_TWICE } else { 0.0 };
        Self { width, height, at_limit, shape }
    }
}

/// Samples along x and y.
const SIDE: usize = shaders::scale_deviation::SIDE as usize;
/// The shape that is assumed for a stated disk: on planes and reliefs through the focus, with V up to 17 px², 1.3 to
/// 1.8 is found, 1.4 in the median.
const BLURRED_TWICE: f32 = 1.4;
/// The standard deviation of the scale by the excess of the shape over that of a disk. With 0.15, 63 to 73 % of planes
/// and reliefs under disks are within σ; with 0.12 less than 60 % of the relief would be.
const OF_SHAPE: f64 = shaders::scale_deviation::OF_SHAPE;
/// The standard deviation of the scale if all residuals are correlated with their neighbours. With 0.15 and 0.2, 56 to
/// 62 and 60 to 69 % of the pixels of five real pairs are within σ of their sweeps.
const OF_RESIDUALS: f64 = shaders::scale_deviation::OF_RESIDUALS;
/// The variance of a window's ratio of b Σb to b² where residuals are white noise. The correlation of a window counts
/// by the share of the squared excess that is not chance. Where residuals are not correlated, a single window would
/// make σ too large by chance.
const CHANCE: f64 = shaders::scale_deviation::CHANCE;

impl Pass for Bindings {
    /// Compulsory traffic: V and two terms at each sample.
    fn bytes(_c: &Constants, _variant: Variant) -> u64 {
        12 * (SIDE * SIDE) as u64
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let (terms, shape) = (memory.layers(self.terms), memory.state(self.state).kernel_shape);
        let found = cpu_reference(c, shape, memory.layer(self.relative_blur, 0), [&terms[1], &terms[3]]);
        let state = memory.state_mut(self.state);
        [state.scale_deviation, state.correlated] = found;
    }
}

/// The standard deviation of the scale, and by how much the correlation of residuals in a window counts, from the
/// kernel's shape, V, and the means of b² and b Σb.
pub fn cpu_reference<N: Number>(c: &Constants, shape: f64, v: &Raster<N>, [b2, alike]: [&Raster<N>; 2]) -> [f64; 2] {
    let (mut sum, mut count) = (0.0, 0.0);
    for n in 0..SIDE * SIDE {
        let [x, y] = [n % SIDE * c.width as usize / SIDE, n / SIDE * c.height as usize / SIDE];
        if b2.get(x, y) > 0.0 && v.get(2 * x, 2 * y).abs() < c.at_limit.into() {
            sum += alike.get(x, y) / b2.get(x, y);
            count += 1.0;
        }
    }
    let excess = (sum / f64::max(count, 1.0) - 1.0).max(0.0);
    let scale =
        f64::hypot(OF_SHAPE * (shape.max(c.shape.into()) - 1.0).max(0.0), OF_RESIDUALS * excess / (1.0 + excess));
    [scale, excess * excess / (excess * excess + CHANCE)]
}

/// A standard deviation of V, px², without the part of it that comes from the scale of V. What is not measured stays
/// so.
pub(crate) fn without_scale(deviation: f32, by_scale: f32) -> f32 {
    if deviation < LARGEST { (deviation * deviation - by_scale * by_scale).max(0.0).sqrt() } else { deviation }
}

#[cfg(test)]
mod tests {
    use super::super::Field;

    use super::*;

    #[test]
    fn noise_adds_nothing_and_a_shape_adds_its_share() {
        let (size, flat) = ([64, 48], |value: f64| Field::from_fn(32, 24, |_, _| value));
        let c = Constants::new(size, &Settings::default());
        let of =
            |c: &Constants, shape, b2, alike| cpu_reference(c, shape, &Field::zeros(64, 48), [&flat(b2), &flat(alike)]);
        assert_eq!(of(&c, 0.0, 0.02, 0.01), [0.0; 2], "residuals of opposite signs");
        assert_eq!(of(&c, 0.0, 0.0, 0.0), [0.0; 2], "no data");
        assert!((of(&c, 1.2, 0.02, 0.02)[0] - 0.2 * OF_SHAPE).abs() < 1e-12);
        assert_eq!(of(&c, 0.9, 0.02, 0.02)[0], 0.0, "one photograph is sharp");
        let [scale, correlated] = of(&c, 0.0, 0.02, 0.08);
        assert!((scale - 0.75 * OF_RESIDUALS).abs() < 1e-12);
        assert!((correlated - 9.0 / (9.0 + CHANCE)).abs() < 1e-12);
        let disks = Constants::new(size, &Settings { kernel: Kernel::Pillbox, ..Settings::default() });
        assert!((of(&disks, 0.0, 0.02, 0.02)[0] - 0.4 * OF_SHAPE).abs() < 1e-6);
    }
}
