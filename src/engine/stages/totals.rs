//! What the rows of partial sums add up to, for the host to judge T's motion model by.

use bytemuck::{Pod, Zeroable};

use super::memory::Memory;
use super::pass::{Pass, bindings};
use super::sums::Layout;
use crate::engine::vulkan::{Stage, Variant};

/// Push constants.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Constants {
    /// Rows of partial sums, one a workgroup of [`linearise`](super::linearise).
    pub rows: u32,
}

bindings! {
    TOTALS:
    /// Rows of sums.
    partials: Reads<Partials>,
    /// One row.
    totals: Writes<Totals>,
}

impl Pass for Bindings {
    type Constants = Constants;
    const STAGE: &'static Stage = &STAGE;

    /// Bytes that must move: the partial sums.
    fn bytes(c: &Constants, variant: Variant) -> u64 {
        4 * Layout::of_variant(variant).length as u64 * u64::from(c.rows)
    }

    /// The twins add up as they go.
    fn run(&self, _c: &Constants, _variant: Variant, _memory: &mut Memory) {}
}

#[cfg(test)]
mod tests {
    use super::super::NO_VARIANT;
    use super::super::harness::{Rig, random};
    use super::super::sums::{PROJECTIVE, add_up};
    use super::*;
    use crate::engine::vulkan::Resource;

    #[test]
    fn agrees_with_the_twin() {
        let rig = Rig::new();
        for (variant, rows) in [(NO_VARIANT, 1), (NO_VARIANT, 37), (PROJECTIVE, 3), (PROJECTIVE, 100)] {
            let layout = Layout::of_variant(variant);
            let partials: Vec<f32> = random(rows * layout.length, 5).into_iter().map(|v| v as f32).collect();
            let buffers = [rig.upload(bytemuck::cast_slice(&partials)), rig.upload(&vec![0; 4 * layout.length])];
            let resources = buffers.each_ref().map(|buffer| Resource::Buffer(buffer));
            rig.run_variant(&STAGE, variant, &resources, &Constants { rows: rows as u32 }, [1, 1, 1]);
            for (n, (found, expected)) in rig.floats(&buffers[1]).iter().zip(add_up(&partials, layout)).enumerate() {
                // Single precision over at most 100 numbers below 1.
                assert!((f64::from(*found) - expected).abs() < 1e-4, "{n}: {found}, not {expected}");
            }
        }
    }
}
