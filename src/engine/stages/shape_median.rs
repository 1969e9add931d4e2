//! The kernel's shape from [what windows say of it](super::shape_windows): their weighted median, since at edges of depth and where
//! something moved a window errs.

use bytemuck::{Pod, Zeroable};

use super::pass::{Memory, Pass, bindings};
use super::shape_windows::Window;
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

/// Push constants.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Constants {
    /// Windows.
    pub windows: u32,
}

bindings! {
    SHAPE_MEDIAN:
    /// Shape and weight by each window.
    windows: Reads<Partials>,
    /// State.
    state: Updates<State>,
}

/// Fewer windows' worth tell nothing.
const LEAST_WINDOWS: f64 = shaders::shape_median::LEAST_WINDOWS;
/// Less, or less than two of its deviations, is a Gaussian: at 0.1 V differs by 3 %.
const LEAST_SHAPE: f64 = shaders::shape_median::LEAST_SHAPE;
/// Of the shape that fits best, what lets V come out right: what the departure leaves of a disk is made up for by a V too small by 6 %,
/// which takes a larger shape: by fits of textures' spectra, 1/f to 1/f⁴ in power, 0.70 to 0.83 of what fits is right.
const UNBIASED: f64 = shaders::shape_median::UNBIASED;
/// The flattest that is believed: where both images are blurred by disks the relative blur is flatter than one.
const MOST_SHAPE: f64 = shaders::shape_median::MOST_SHAPE;

impl Pass for Bindings {
    /// Bytes that must move: two floats a window.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        8 * u64::from(c.windows)
    }

    fn run(&self, c: &Constants, _variant: Variant, memory: &mut Memory) {
        let numbers = &memory.numbers(self.windows)[..2 * c.windows as usize];
        let windows: Vec<_> = numbers.chunks(2).map(|w| Window { shape: w[0], weight: w[1] }).collect();
        let state = memory.state_mut(self.state);
        state.kernel_shape = cpu_reference(state.kernel_shape, &windows);
    }
}

/// The shape, of that so far and what the windows ask for beyond it.
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
    // Of a median, 1.25 times that of a mean; of quartiles, 1.35 deviations apart.
    let deviation = UNBIASED * 1.25 / 1.35 * (quartile(0.75) - quartile(0.25)) / independent.sqrt();
    if shape > LEAST_SHAPE.max(2.0 * deviation) { shape.min(MOST_SHAPE) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::super::harness::{Rig, random};
    use super::super::state::{DoubleState, State};
    use super::*;
    use crate::engine::vulkan::Resource;

    fn windows(count: usize, middle: f64, spread: f64) -> Vec<Window> {
        let numbers = random(2 * count, 3);
        numbers.chunks(2).map(|w| Window { shape: middle + spread * (w[0] - 0.5), weight: 0.1 + w[1] }).collect()
    }

    #[test]
    fn matches_the_cpu_reference() {
        let cases = [(256, 0.7, 0.4), (37, 0.2, 3.0), (5, 1.0, 0.1), (64, 2.0, 0.1), (100, -0.3, 0.1), (0, 0.0, 0.0)];
        for (count, middle, spread) in cases {
            let (windows, so_far) = (windows(count, middle, spread), 0.25);
            let floats: Vec<f32> = windows.iter().flat_map(|w| [w.shape as f32, w.weight as f32]).collect();
            let mut state = State::new(&DoubleState::default().registration);
            state.kernel_shape = so_far as f32;
            let rig = Rig::new();
            let upload = [floats, vec![0.0; 2]].concat();
            let (partials, buffer) =
                (rig.upload(bytemuck::cast_slice(&upload)), rig.upload(bytemuck::bytes_of(&state)));
            let c = Constants { windows: count as u32 };
            rig.run_groups(&STAGE, &[Resource::Buffer(&partials), Resource::Buffer(&buffer)], &c, [1, 1, 1]);
            let found = f64::from(rig.value::<State>(&buffer).kernel_shape);
            let expected = cpu_reference(so_far, &windows);
            // A window's shape in single precision.
            assert!((found - expected).abs() < 1e-6, "{count} {middle}: {found} {expected}");
        }
    }

    #[test]
    fn outliers_chance_and_too_few_windows_change_nothing() {
        let mut told = windows(100, 0.8, 0.1);
        told[..20].iter_mut().for_each(|w| w.shape = -40.0);
        told[20..35].iter_mut().for_each(|w| w.shape = 40.0);
        assert!((cpu_reference(0.0, &told) - 0.6).abs() < 0.05, "{}", cpu_reference(0.0, &told));
        assert_eq!(cpu_reference(0.0, &windows(30, 0.2, 4.0)), 0.0, "within what chance does");
        assert_eq!(cpu_reference(0.3, &windows(4, 0.9, 0.1)), 0.3, "too few");
    }
}
