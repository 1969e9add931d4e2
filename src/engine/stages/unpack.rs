//! A frame as a camera packs it to samples one behind the other, of grey or of red, green and blue.

use bytemuck::{Pod, Zeroable};

use super::pass::{Memory, Pass, bindings};
use super::pixels;
use crate::base::{Frame, Order, Packing, PixelFormat};
use crate::engine::vulkan::Variant;

/// Fours of pixels that a row of invocations writes: of 2^28 pixels there are 2^14 rows, in workgroups of four.
const ROW: u32 = 4096;

/// Push constants.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Constants {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Of a packed sample.
    pub bits: u32,
    /// Packed samples a pixel.
    pub count: u32,
    /// 1: blue comes first.
    pub reversed: u32,
    /// Where red is among two by two pixels.
    pub red: [u32; 2],
    /// Fours of pixels that a row of invocations writes.
    pub row: u32,
    /// Of 65535 in the greatest packed sample, and what is left.
    pub steps: [u32; 2],
}

impl Constants {
    /// Of frames of a size and a format that is not plain.
    pub fn new([width, height]: [u32; 2], format: PixelFormat) -> Self {
        let most = (1 << format.bits) - 1;
        let reversed = matches!(format.order, Order::Colors { reversed: true, .. });
        let red = if let Order::Mosaic(mosaic) = format.order { Some(mosaic.0) } else { None };
        Self {
            width,
            height,
            bits: format.bits,
            count: format.samples_a_pixel(),
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

/// Bit behind bit, or two samples in three bytes; of a mosaic; of more than 8 bits: a software device takes both sides of a branch, so these are
/// constants.
pub(crate) fn variant(format: PixelFormat) -> Variant {
    let is_mosaic = matches!(format.order, Order::Mosaic(_));
    [format.packing == Packing::Bits, format.packing == Packing::Pairs, is_mosaic, format.bits > 8]
}

bindings! {
    UNPACK:
    /// As the camera packs them.
    packed: Reads<Packed>,
    /// Of the photograph.
    samples: Writes<Samples>,
}

impl Pass for Bindings {
    /// Bytes that must move: every packed sample read, every sample written.
    fn bytes(c: &Constants, [_, _, is_mosaic, is_wide]: Variant) -> u64 {
        let written = if c.count == 1 && !is_mosaic { 1 } else { 3 } * if is_wide { 2 } else { 1 };
        pixels(c.width, c.height) * u64::from(c.count * c.bits + 8 * written) / 8
    }

    /// The twins' memory is given frames, which are unpacked.
    fn run(&self, _c: &Constants, _variant: Variant, _memory: &mut Memory) {}
}

/// The frame, by [`PixelFormat::frame`].
///
/// # Errors
/// As that.
pub fn cpu_reference(size: [u32; 2], format: PixelFormat, packed: &[u8]) -> Result<Frame, String> {
    format.frame(size, packed)
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
                let expected = cpu_reference(size, format, &packed).unwrap();
                // One word more, which stays as it is.
                let mut found = expected.bytes().to_vec();
                let length = found.len().next_multiple_of(4) + 4;
                found.fill(0);
                found.resize(length, 0xaa);
                let (packed, samples) = (rig.upload(&packed), rig.upload(&found));
                let constants = Constants::new(size, format);
                let resources = [Resource::Buffer(&packed), Resource::Buffer(&samples)];
                let groups = STAGE.groups(constants.invocations());
                rig.run_variant(&STAGE, variant(format), &resources, &constants, groups);
                found[..expected.bytes().len()].copy_from_slice(expected.bytes());
                found[expected.bytes().len()..length - 4].fill(0);
                assert_eq!(bytemuck::cast_slice::<u32, u8>(&rig.words(&samples)), found, "{format} {size:?}");
            }
        }
    }
}
