//! Computes the standard deviation of the scale of V, as a share of V.
//!
//! A kernel that does not describe the blur makes all of V too large or too small, by a factor that differs between the
//! in-focus and the blurred parts of a scene. Three quantities indicate this error:
//!
//! - **The law.** If disks blur both photographs, one of them blurred by V does not become the other, by fourth
//!   cumulants: the relative law is then off by a factor that differs from place to place. On planes and reliefs through
//!   the focus of a lens that blurs by disks, V by a disk and the relative law was 0.93 to 1.06 times the true one in the
//!   median (frames 3 and 9, 4 and 8, 6 and 9, 1 and 11 of 12). Gaussians have no such error, and the law of a lens none
//!   of this kind.
//! - **The correlation of neighbouring residuals.** Noise differs from pixel to pixel. What the kernel leaves is alike
//!   over a feature of the texture. The ratio of b times the sum of b around it to b² is 1 for the former, and 3 to 11
//!   on real pairs. Their V is 1.06 to 1.4 times that of their sweeps.
//! - **Parallax.** Where displacement outweighs blur, the size of the parallax is that of its start, and V with it.
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
        let ([width, height], at_limit) = (uncertainty_terms::size(size), uncertainty::at_limit(settings.blur_limit()));
        Self { width, height, at_limit, is_disk: u32::from(settings.kernel == Kernel::Pillbox) }
    }
}

/// Samples along x and y.
const SIDE: usize = shaders::scale_deviation::SIDE as usize;
/// The standard deviation of the scale if a disk blurs by the relative law. With 0.06, 63 to 73 % of planes and reliefs
/// under disks were within σ.
const OF_LAW: f64 = shaders::scale_deviation::OF_LAW;
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
        let (terms, state) = (memory.layers(self.terms), memory.state(self.state));
        let is_relative = c.is_disk != 0 || state.kernel_shape != 0.0 && state.separation == 0.0;
        let found = cpu_reference(c, is_relative, memory.layer(self.relative_blur, 0), [&terms[1], &terms[3]]);
        let state = memory.state_mut(self.state);
        [state.scale_deviation, state.correlated] = found;
        state.scale_deviation = state.scale_deviation.hypot(state.parallax_size);
    }
}

/// The standard deviation of the scale, and by how much the correlation of residuals in a window counts, from V and the
/// means of b² and b Σb. `is_relative`: a disk blurs by the relative law.
fn cpu_reference<N: Number>(c: &Constants, is_relative: bool, v: &Raster<N>, [b2, alike]: [&Raster<N>; 2]) -> [f64; 2] {
    let (mut sum, mut count) = (0.0, 0.0);
    for n in 0..SIDE * SIDE {
        let [x, y] = [n % SIDE * c.width as usize / SIDE, n / SIDE * c.height as usize / SIDE];
        if b2.get(x, y) > 0.0 && v.get(2 * x, 2 * y).abs() < c.at_limit.into() {
            sum += alike.get(x, y) / b2.get(x, y);
            count += 1.0;
        }
    }
    let excess = (sum / f64::max(count, 1.0) - 1.0).max(0.0);
    let of_law = if is_relative { OF_LAW } else { 0.0 };
    let scale = f64::hypot(of_law, OF_RESIDUALS * excess / (1.0 + excess));
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
    fn noise_adds_nothing_and_residuals_that_are_alike_and_the_relative_law_do() {
        let flat = |value: f64| Field::from_fn(32, 24, |_, _| value);
        let c = Constants::new([64, 48], &Settings::default());
        let of =
            |is_relative, b2, alike| cpu_reference(&c, is_relative, &Field::zeros(64, 48), [&flat(b2), &flat(alike)]);
        assert_eq!(of(false, 0.02, 0.01), [0.0; 2], "residuals of opposite signs");
        assert_eq!(of(false, 0.0, 0.0), [0.0; 2], "no data");
        assert!((of(true, 0.02, 0.02)[0] - OF_LAW).abs() < 1e-12);
        let [scale, correlated] = of(false, 0.02, 0.08);
        assert!((scale - 0.75 * OF_RESIDUALS).abs() < 1e-12);
        assert!((correlated - 9.0 / (9.0 + CHANCE)).abs() < 1e-12);
    }
}
