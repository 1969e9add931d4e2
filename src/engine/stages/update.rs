//! `V ← V + share clamp(dV)`, section 4 of `docs/method.md`.

use super::pass::{Memory, Pass, bindings, push_constants};
use super::{Field, pixels, relax};
use crate::engine::vulkan::Variant;

push_constants! {
    /// Width of the level, pixels.
    width: u32,
    /// Height of the level, pixels.
    height: u32,
    /// Largest |dV|, px² of the level.
    largest_step: f32,
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
}

impl Pass for Bindings {
    /// Compulsory traffic: dV and V read, V written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        12 * pixels(c.width, c.height)
    }

    fn run(&self, c: &Constants, _variant: Variant, memory: &mut Memory) {
        let change = relax::both([memory.layer(self.red, 0), memory.layer(self.black, 0)]);
        cpu_reference(c, &change, memory.layer_mut(self.v, 0));
    }
}

/// Adds dV to V.
pub fn cpu_reference(c: &Constants, change: &Field, v: &mut Field) {
    let (step, limit, share) = (f64::from(c.largest_step), f64::from(c.limit), f64::from(c.share));
    for (v, change) in v.data.iter_mut().zip(&change.data) {
        *v = (*v + share * change.clamp(-step, step)).clamp(-limit, limit);
    }
}

#[cfg(test)]
mod tests {
    use super::super::harness::{Rig, random_field};
    use super::super::relax::half;
    use super::*;
    use crate::engine::vulkan::Resource;

    #[test]
    fn matches_the_cpu_reference() {
        for (width, height) in [(37usize, 21usize), (16, 16), (1, 2)] {
            let (mut v, change) = (random_field(width, height, 1), random_field(width, height, 2));
            let (width32, height32) = (width as u32, height as u32);
            let constants = Constants { width: width32, height: height32, largest_step: 0.4, limit: 0.9, share: 0.5 };
            let rig = Rig::new();
            let images = [&half(&change, 0), &half(&change, 1), &v].map(|f| rig.field(f));
            rig.run(&STAGE, &images.each_ref().map(Resource::Image), &constants, [width as u32, height as u32]);
            cpu_reference(&constants, &change, &mut v);
            rig.assert_close(&images[2], &[v], 1e-6);
        }
    }
}
