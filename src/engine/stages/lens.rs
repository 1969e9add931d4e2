//! Chooses the law and the kernel that leave the least of the residual in the windows.
//!
//! The numbers are means over the [windows](super::lens_windows) of logarithms of ratios: but for a factor, logarithms of
//! ratios of likelihoods if each window has its own deviation. Windows at depth edges or on moving objects, where no
//! candidate fits, count little.

use super::Number;
use super::lens_windows::{CHAIN, KERNEL, LAW, MEAN, OF_LENS, separations};
use super::pass::{Memory, Pass};
use super::state::DoubleState;
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

pub use super::interface::lens::*;

/// The least number of windows. With fewer, nothing changes.
const LEAST_WINDOWS: f64 = shaders::lens::LEAST_WINDOWS;
/// The largest separation, in means of |V|: where both photographs are blurred by much more than they differ, a window
/// holds too little detail to tell.
const FARTHEST: f64 = shaders::lens::FARTHEST;
/// By how much more a disk may leave than a Gaussian that coarser levels have found: windows of a fine level have little
/// detail where the blur is wide.
const FOUND: f64 = shaders::lens::FOUND;
/// By how much less a lens must leave than the relative law, in standard errors over the windows; and a disk than a
/// Gaussian, if coarser levels have found none. Without that, a lens was taken for photographs by differences within one
/// standard error, and V of the dimple was 60 instead of 240 px² wide.
const CERTAIN: f64 = shaders::lens::CERTAIN;

impl Pass for Bindings {
    /// Compulsory traffic: the numbers of the windows.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        4 * (MEAN + 1) as u64 * u64::from(c.windows)
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let state = memory.state_mut(self.state);
        state.becomes_disk = 0;
        let was_disk = c.are_gaussian == 0 && state.kernel_shape != 0.0;
        if was_disk || state.levels[c.level as usize].settled != 0 {
            return;
        }
        let numbers = &memory.numbers(self.partials)[..(MEAN + 1) * c.windows as usize];
        let numbers: Vec<f64> = numbers.iter().map(|&number| number.into()).collect();
        adopt(memory.state_mut(self.state), &numbers);
    }
}

/// Adopts the best law and kernel by the numbers of all windows, unless too few of them count.
pub(super) fn adopt(state: &mut DoubleState, numbers: &[f64]) {
    let windows: Vec<_> = numbers.chunks(MEAN + 1).filter(|window| window[MEAN] >= 0.0).collect();
    let whole = windows.len() as f64;
    if whole < LEAST_WINDOWS {
        return;
    }
    let mean = |n: usize| windows.iter().map(|window| window[n]).sum::<f64>() / whole;
    let of_lens = |lens: usize, n: usize| mean(1 + OF_LENS * lens + n);
    let separations = separations(state.separation);
    // Residuals relative to that of the first lens.
    let mut left = vec![0.0];
    (1..separations.len()).for_each(|lens| left.push(left[lens - 1] + of_lens(lens - 1, CHAIN)));
    let near = separations.iter().filter(|&&p| p <= FARTHEST * mean(MEAN)).count().max(1);
    let best = (0..near).fold(0, |best, n| if left[n] < left[best] { n } else { best });
    // The vertex of the parabola through the best one and its neighbours.
    let mut place = best as f64;
    if best > 0 && best + 1 < left.len() {
        let bend = left[best - 1] - 2.0 * left[best] + left[best + 1];
        if bend > 0.0 {
            place += (0.5 * (left[best - 1] - left[best + 1]) / bend).clamp(-0.5, 0.5);
        }
    }
    let certain = |n: usize| {
        let variance = windows.iter().map(|window| window[n].powi(2)).sum::<f64>() / whole - mean(n).powi(2);
        CERTAIN * (variance.max(0.0) / whole).sqrt()
    };
    let [law, kernel] = [LAW, KERNEL].map(|n| 1 + OF_LENS * best + n);
    let is_lens = mean(law) > certain(law);
    let number = if is_lens { kernel } else { 0 };
    let is_disk = mean(number) > if state.kernel_shape != 0.0 { -FOUND } else { certain(number) };
    state.kernel_shape = f64::from(u8::from(is_disk));
    state.becomes_disk = u32::from(is_disk);
    state.separation =
        if is_disk && is_lens { separations[0] * (separations[1] / separations[0]).powf(place) } else { 0.0 };
}

#[cfg(test)]
mod tests {
    use super::super::harness::random;
    use super::*;

    /// The state after 30 windows whose mean |V| is 8 px², with noise around the numbers.
    fn adopted(count: usize, of: impl Fn(usize) -> f64) -> DoubleState {
        let noise = random(count * (MEAN + 1), 3);
        let number = |n: usize| match n % (MEAN + 1) {
            MEAN => 8.0,
            number => of(number) + 0.01 * (noise[n] - 0.5),
        };
        let mut state = DoubleState::default();
        adopt(&mut state, &(0..noise.len()).map(number).collect::<Vec<_>>());
        state
    }

    #[test]
    fn the_separation_is_that_of_the_least_residual_between_candidates() {
        let separations = separations(0.0);
        let left = |lens: usize| 0.2 * (lens as f64 - 6.3).powi(2);
        let state = adopted(30, |n| match n.checked_sub(1).map(|n| (n / OF_LENS, n % OF_LENS)) {
            Some((lens, CHAIN)) => left(lens + 1) - left(lens),
            Some(_) => 0.5,
            None => 0.0,
        });
        let truth = separations[6] * (separations[7] / separations[6]).powf(0.3);
        assert!(state.kernel_shape == 1.0 && (state.separation / truth - 1.0).abs() < 0.05, "{state:?} {truth}");
    }

    #[test]
    fn the_relative_law_and_the_gaussian_stand_unless_others_leave_less() {
        let found = |count, of_relative: f64, of_lens: f64| {
            let state = adopted(count, |n| if n == 0 { of_relative } else { of_lens });
            (state.kernel_shape, state.separation)
        };
        assert_eq!(found(30, 0.5, -0.2), (1.0, 0.0), "a disk of one photograph");
        assert_eq!(found(30, -0.05, -0.05), (0.0, 0.0), "a Gaussian");
        assert_eq!(found(4, 0.5, 0.5), (0.0, 0.0), "too few windows");
    }
}
