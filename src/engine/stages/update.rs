//! `V ← V + share clamp(dV)`, and the count of the pixels that still move. Sections 4 and 6 of `docs/method.md`.

use super::pass::{Memory, Pass, bindings, push_constants};
use super::{Number, Raster, pixels, rows};
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

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let mut v = memory.take_layer(self.v, 0);
        let change = [self.red, self.black].map(|half| memory.layer(half, 0));
        let (d, variance) = (memory.layer(self.equations, 0), memory.state(self.state).variance);
        let moving = cpu_reference(c, change, d, variance, &mut v);
        memory.set_layer(self.v, 0, v);
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

/// Adds dV, of the red and of the black pixels, to V; returns the numbers of pixels that a whole step moves, and moves
/// far. `variance` is Σ b² / Σ D.
pub fn cpu_reference<N: Number>(
    c: &Constants,
    change: [&Raster<N>; 2],
    d: &Raster<N>,
    variance: f64,
    v: &mut Raster<N>,
) -> [u32; 2] {
    let [step, relative, limit, share] = [c.largest_step, c.relative_step, c.limit, c.share].map(|n| N::of(n.into()));
    let bounds = STEPS.map(|step| N::of(step * step * WIDER * INDEPENDENT * variance));
    let within = |value: N, most: N| value.max(-most).min(most);
    let moving = rows::map([v.into()], |y, [v]| {
        let (d, change) = (d.row(y), change.map(|half| half.row(y)));
        let mut moving = [0; 2];
        for (x, v) in v.iter_mut().enumerate() {
            let change = within(change[(x + y) % 2][x / 2], step.max(relative * v.abs()));
            let whole = within(*v + change, limit) - *v;
            moving.iter_mut().zip(bounds).for_each(|(count, bound)| *count += u32::from(d[x] * whole * whole > bound));
            *v = within(*v + share * change, limit);
        }
        moving
    });
    moving.iter().fold([0; 2], |[a, b], [c, d]| [a + c, b + d])
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
            let halves = [0, 1].map(|color| half(&change, color));
            let moving = cpu_reference(&constants, halves.each_ref(), &d, state.variance.into(), &mut v);
            rig.assert_close(&images[2], &[v], 1e-6);
            let actual: State = rig.value(&buffer);
            assert_eq!([actual.moving, actual.moving_far], moving);
            assert!(width < 16 || moving[1] > 0 && moving[1] < moving[0], "{moving:?}");
        }
    }
}
