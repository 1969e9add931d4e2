//! Unpacks a frame from its camera's format to interleaved samples, grey or red, green and blue.
//!
//! [`PixelFormat::frame`] is the CPU reference.

use super::pass::{Memory, Pass};
use super::{Number, pixels};
use crate::base::{Order, Packing, PixelFormat};
use crate::engine::vulkan::Variant;

pub use super::interface::unpack::*;

/// Groups of four pixels per row of invocations: 2^28 pixels have 2^14 rows, in workgroups of four.
const ROW: u32 = 4096;

impl Constants {
    /// The constants for frames of a size and a packed format.
    pub fn new([width, height]: [u32; 2], format: PixelFormat) -> Self {
        let most = (1 << format.bits) - 1;
        let reversed = matches!(format.order, Order::Colors { reversed: true, .. });
        let red = if let Order::Mosaic(mosaic) = format.order { Some(mosaic.0) } else { None };
        Self {
            width,
            height,
            bits: format.bits,
            count: format.samples_per_pixel(),
            reversed: reversed.into(),
            red: red.unwrap_or_default(),
            row: ROW,
            steps: [65535 / most, 65535 % most],
        }
    }

    /// Invocations along x and y: one for four pixels.
    pub fn invocations(&self) -> [u32; 2] {
        let fours = pixels(self.width, self.height).div_ceil(4);
        [ROW, fours.div_ceil(ROW.into()) as u32]
    }
}

/// The variant for a format. Constants,
/// since software devices execute both sides of a branch.
pub(crate) fn variant(format: PixelFormat) -> Variant {
    Variant::BITS.when(format.packing == Packing::Bits)
        | Variant::PAIRS.when(format.packing == Packing::Pairs)
        | Variant::MOSAIC.when(matches!(format.order, Order::Mosaic(_)))
        | Variant::WIDE.when(format.bits > 8)
}

impl Pass for Bindings {
    /// Compulsory traffic: every packed sample read, every sample written.
    fn bytes(c: &Constants, variant: Variant) -> u64 {
        let written = if c.count == 1 && !variant.has(Variant::MOSAIC) { 1 } else { 3 }
            * if variant.has(Variant::WIDE) { 2 } else { 1 };
        pixels(c.width, c.height) * u64::from(c.count * c.bits + 8 * written) / 8
    }

    /// No-op: the memory of the CPU references is given unpacked frames.
    fn run<N: Number>(&self, _c: &Constants, _variant: Variant, _memory: &mut Memory<N>) {}
}

#[cfg(test)]
mod tests {
    use super::super::harness::{Rig, random};
    use super::*;
    use crate::engine::vulkan::Resource;

    #[test]
    fn every_format_matches_the_cpu_reference_to_the_bit() {
        let rig = Rig::new();
        for size in [[37, 19], [16, 16], [33, 8], [301, 41]] {
            for format in PixelFormat::all().filter(|format| !format.is_plain()) {
                let count = format.bytes(size) as usize;
                let packed: Vec<u8> = random(count, 5).iter().map(|v| (256.0 * v) as u8).collect();
                let expected = format.frame(size, &packed).unwrap();
                // One extra word, which must stay unchanged.
                let mut actual = expected.bytes().to_vec();
                let length = actual.len().next_multiple_of(4) + 4;
                actual.fill(0);
                actual.resize(length, 0xaa);
                let (packed, samples) = (rig.upload(&packed), rig.upload(&actual));
                let constants = Constants::new(size, format);
                let resources = [Resource::Buffer(&packed), Resource::Buffer(&samples)];
                let groups = STAGE.groups(constants.invocations());
                rig.run_variant(&STAGE, variant(format), &resources, &constants, groups);
                actual[..expected.bytes().len()].copy_from_slice(expected.bytes());
                actual[expected.bytes().len()..length - 4].fill(0);
                assert_eq!(bytemuck::cast_slice::<u32, u8>(&rig.words(&samples)), actual, "{format} {size:?}");
            }
        }
    }
}
