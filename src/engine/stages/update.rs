//! `V ← V + share clamp(dV)`, and the count of the pixels that still move. Sections 4 and 6 of `docs/method.md`.

use super::pass::{Memory, Pass, bindings, push_constants};
use super::{Field, pixels, relax};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

push_constants! {
    /// Width of the level, pixels.
    width: u32,
    /// Height of the level, pixels.
    height: u32,
    /// Largest |dV|, px² of the level,
    largest_step: f32,
    /// or this share of |V|, if that is more.
    relative_step: f32,
    /// Largest |V|, px² of the level.
    limit: f32,
    /// Share of dV that is added.
    share: f32,
}

bindings! {
    UPDATE:
    /// dV of the red pixels.
    red: Reads<Change>,
    /// dV of the black pixels.
    black: Reads<Change>,
    /// V.
    v: Updates<RelativeBlur>,
    /// D, averaged over a window.
    equations: Reads<Plane>,
    /// State, with the count.
    state: Updates<State>,
}

impl Pass for Bindings {
    /// Compulsory traffic: dV, V and D read, V written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        16 * pixels(c.width, c.height)
    }

    fn run(&self, c: &Constants, _variant: Variant, memory: &mut Memory) {
        let change = relax::both([memory.layer(self.red, 0), memory.layer(self.black, 0)]);
        let d = memory.layer(self.equations, 0).clone();
        let variance = memory.state(self.state).variance;
        let moving = cpu_reference(c, &change, &d, variance, memory.layer_mut(self.v, 0));
        memory.state_mut(self.state).moving.iter_mut().zip(moving).for_each(|(sum, count)| *sum += f64::from(count));
    }
}

/// A pixel moves if its step is more than a tenth of its standard deviation (section 7 of `docs/method.md`), and far if it
/// is more than half of it.
const STEPS: [f64; 2] = [shaders::update::STILL, shaders::update::FAR];
/// One over the pixels that say as much as one independent pixel, 4π 4² of the window.
const INDEPENDENT: f64 = shaders::update::INDEPENDENT;
/// The square of 1.8, by which D exceeds the curvature of the robust norm at strong noise: 1.4 at 0.01, 2.0 at 0.03 on
/// generated scenes. On photographs it is not measured.
const WIDER: f64 = shaders::update::WIDER;

/// Adds dV to V; returns the numbers of pixels that a whole step moves, and moves far. `variance` is Σ b² / Σ D.
pub fn cpu_reference(c: &Constants, change: &Field, d: &Field, variance: f64, v: &mut Field) -> [u32; 2] {
    let [step, relative, limit, share] = [c.largest_step, c.relative_step, c.limit, c.share].map(f64::from);
    let mut moving = [0; 2];
    for ((v, change), d) in v.data.iter_mut().zip(&change.data).zip(&d.data) {
        let most = step.max(relative * v.abs());
        let change = change.clamp(-most, most);
        let whole = (*v + change).clamp(-limit, limit) - *v;
        for (count, step) in moving.iter_mut().zip(STEPS) {
            *count += u32::from(d * whole * whole > step * step * WIDER * INDEPENDENT * variance);
        }
        *v = (*v + share * change).clamp(-limit, limit);
    }
    moving
}

#[cfg(test)]
mod tests {
    use super::super::harness::{Rig, random_field};
    use super::super::relax::half;
    use super::super::state::{DoubleState, State};
    use super::*;
    use crate::engine::vulkan::Resource;

    #[test]
    fn matches_the_cpu_reference() {
        for (width, height) in [(37usize, 21usize), (16, 16), (1, 2)] {
            let [mut v, change, mut d] = [1, 2, 3].map(|seed| random_field(width, height, seed));
            d.data.iter_mut().step_by(3).for_each(|d| *d = 0.0);
            let [width, height] = [width as u32, height as u32];
            let constants = Constants { width, height, largest_step: 0.4, relative_step: 0.6, limit: 0.9, share: 0.5 };
            let state = State { variance: 5.0, ..State::new(&DoubleState::default().registration) };
            let rig = Rig::new();
            let images = [&half(&change, 0), &half(&change, 1), &v, &d].map(|f| rig.field(f));
            let buffer = rig.upload(bytemuck::bytes_of(&state));
            let mut resources: Vec<_> = images.iter().map(Resource::Image).collect();
            resources.push(Resource::Buffer(&buffer));
            rig.run(&STAGE, &resources, &constants, [width, height]);
            let moving = cpu_reference(&constants, &change, &d, state.variance.into(), &mut v);
            rig.assert_close(&images[2], &[v], 1e-6);
            let actual: State = rig.value(&buffer);
            assert_eq!([actual.moving, actual.moving_far], moving);
            assert!(width < 16 || moving[1] > 0 && moving[1] < moving[0], "{moving:?}");
        }
    }
}
