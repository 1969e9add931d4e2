//! All relaxation sweeps on a small level by one workgroup.
//!
//! On small levels a dispatch of [`relax`] takes longer than its work.

use super::pass::{Memory, Pass, bindings, push_constants};
use super::{Number, Raster, pixels, relax};
use crate::engine::vulkan::Variant;

/// The most pixels of a level for one workgroup. On lavapipe ten dispatches over 64 x 64 pixels take 1 ms, one
/// workgroup on one core 0.3 ms. With four times as many pixels both take the same time.
const MOST_PIXELS: u64 = 1 << 13;

push_constants! {
    /// Width of the level, pixels.
    width: u32,
    /// Height of the level, pixels.
    height: u32,
    /// Relaxation sweeps.
    sweeps: u32,
    /// ω of successive over-relaxation.
    over_relaxation: f32,
}

bindings! {
    RELAX_LEVEL:
    /// Right sides.
    right_sides: Reads<RightSides>,
    /// Weights.
    weights: Reads<Weights>,
    /// dV of the red pixels.
    red: Updates<Change>,
    /// dV of the black pixels.
    black: Updates<Change>,
    /// dV of the coarse grids.
    coarse: Reads<GridSteps>,
}

impl Pass for Bindings {
    /// Compulsory traffic: the system read and dV written, once.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        24 * pixels(c.width, c.height)
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let system = [0, 1].map(|color| memory.system((self.right_sides, color), self.weights, color));
        let [red, black] = cpu_reference(c, &system, memory.numbers(self.coarse));
        memory.set_layer(self.red, 0, red);
        memory.set_layer(self.black, 0, black);
    }
}

/// Whether a level is small enough.
pub(crate) fn takes([width, height]: [u32; 2]) -> bool {
    pixels(width, height) <= MOST_PIXELS
}

/// dV of both colors, relaxed from dV of the coarse grids.
pub fn cpu_reference<N: Number>(c: &Constants, system: &[[&Raster<N>; 5]; 2], steps: &[N]) -> [Raster<N>; 2] {
    relax::relaxed(Default::default(), [c.width, c.height], (c.sweeps, c.over_relaxation), system, steps)
}

#[cfg(test)]
mod tests {
    use super::super::Field;
    use super::super::harness::Rig;
    use super::super::relax::{
        interleaved,
        tests::{coarse_steps, system},
    };
    use super::*;
    use crate::engine::vulkan::Resource;

    #[test]
    fn matches_the_cpu_reference_from_any_contents() {
        for (width, height) in [(37usize, 21usize), (64, 16), (17, 18), (2, 2), (200, 40)] {
            let system = system(width, height);
            let c = Constants { width: width as u32, height: height as u32, sweeps: 3, over_relaxation: 1.8 };
            let rig = Rig::new();
            let right_sides = rig.image(&system.each_ref().map(|[right_side, ..]| right_side.clone()));
            let weights = rig.weights(&interleaved(&system));
            let nothing = Field::from_fn(width.div_ceil(2), height, |_, _| f64::NAN);
            let changes = [0, 1].map(|_| rig.field(&nothing));
            let (steps, coarse) = coarse_steps(&rig, width, height);
            let mut resources = [&right_sides, &weights, &changes[0], &changes[1]].map(Resource::Image).to_vec();
            resources.push(Resource::Buffer(&steps));
            rig.run_groups(&STAGE, &resources, &c, [1, 1, 1]);
            let expected = cpu_reference(&c, &system.each_ref().map(|parts| parts.each_ref()), &coarse);
            for color in [0, 1] {
                rig.assert_close(&changes[color], &expected[color..=color], 1e-4);
            }
        }
    }
}
