//! Computes the kernel's shape as the weighted median of its estimates in windows.
//!
//! The median is robust to [windows](super::shape_windows) with wrong estimates, at depth edges and on moving objects.

use super::Number;
use super::pass::{Memory, Pass};
use super::shape_windows::Window;
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

pub use super::interface::shape_median::*;

/// The least number of independent windows. With fewer, the shape does not change.
const LEAST_WINDOWS: f64 = shaders::shape_median::LEAST_WINDOWS;
/// The least shape. A smaller one, or one below twice its standard deviation, counts as Gaussian. A shape of 0.1
/// changes V by 3 %.
const LEAST_SHAPE: f64 = shaders::shape_median::LEAST_SHAPE;
/// The share of the best-fitting shape that makes V right. The departure leaves a part of a disk, which the fit
/// compensates by a V that is 6 % too small and a shape that is too large. By fits of texture spectra, 1/f to 1/f⁴ in
/// power, 0.70 to 0.83 of the best fit is right.
const UNBIASED: f64 = shaders::shape_median::UNBIASED;
/// The largest shape. Where disks blur both images, the sharper one by b, the relative blur is flatter than a disk:
/// fourth cumulants of disks go with the square of their variances, so that the shape is
/// `((b + V)² - b²)/V² = 1 + 2b/V`.
const MOST_SHAPE: f64 = shaders::shape_median::MOST_SHAPE;

impl Pass for Bindings {
    /// Compulsory traffic: two floats a window.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        8 * u64::from(c.windows)
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let numbers = &memory.numbers(self.partials)[..2 * c.windows as usize];
        let windows: Vec<_> = numbers.chunks(2).map(|w| Window { shape: w[0].into(), weight: w[1].into() }).collect();
        let state = memory.state_mut(self.state);
        state.kernel_shape = cpu_reference(state.kernel_shape, &windows);
    }
}

/// The shape, from the current one and what the windows add to it.
pub fn cpu_reference(so_far: f64, windows: &[Window]) -> f64 {
    let sum: f64 = windows.iter().map(|w| w.weight).sum();
    let squares: f64 = windows.iter().map(|w| w.weight * w.weight).sum();
    let independent = sum * sum / squares.max(1e-30);
    if independent < LEAST_WINDOWS {
        return so_far;
    }
    let mut sorted = windows.to_vec();
    sorted.sort_by(|a, b| a.shape.total_cmp(&b.shape));
    let quartile = |share: f64| {
        let mut below = 0.0;
        let reached = |w: &&Window| {
            below += w.weight;
            below >= share * sum
        };
        sorted.iter().find(reached).map_or(0.0, |w| w.shape)
    };
    let shape = UNBIASED * (so_far + quartile(0.5));
    // The deviation of a median is 1.25 times that of a mean; quartiles are 1.35 deviations apart.
    let deviation = UNBIASED * 1.25 / 1.35 * (quartile(0.75) - quartile(0.25)) / independent.sqrt();
    if shape > LEAST_SHAPE.max(2.0 * deviation) { shape.min(MOST_SHAPE) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::super::harness::random;

    use super::*;

    fn windows(count: usize, middle: f64, spread: f64) -> Vec<Window> {
        let numbers = random(2 * count, 3);
        numbers.chunks(2).map(|w| Window { shape: middle + spread * (w[0] - 0.5), weight: 0.1 + w[1] }).collect()
    }

    #[test]
    fn outliers_chance_and_too_few_windows_change_nothing() {
        let mut estimates = windows(100, 0.8, 0.1);
        estimates[..20].iter_mut().for_each(|w| w.shape = -40.0);
        estimates[20..35].iter_mut().for_each(|w| w.shape = 40.0);
        assert!((cpu_reference(0.0, &estimates) - 0.6).abs() < 0.05, "{}", cpu_reference(0.0, &estimates));
        assert_eq!(cpu_reference(0.0, &windows(30, 0.2, 4.0)), 0.0, "within chance");
        assert_eq!(cpu_reference(0.3, &windows(4, 0.9, 0.1)), 0.3, "too few");
    }
}
