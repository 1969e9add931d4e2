//! How cameras pack samples.
//!
//! The formats are those of GenICam's Pixel Format Naming Convention 2.4 and, where `Packed` ends the name, those of GigE Vision
//! 1.x, in which two pixels share three bytes in another way. Samples of more than 8 bits in bytes of their own have the low one first.

use std::fmt;
use std::str::FromStr;

use super::mosaic::{self, Mosaic};
use super::{Channels, Depth, Format, Frame, Samples};

/// How samples lie one behind the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Packing {
    /// In bytes of their own.
    Whole,
    /// In bits one after the other, the low ones first, without padding: `p`.
    Bits,
    /// Two in three bytes: the high bits of the first, the low ones of both, the high bits of the second: `Packed`.
    Pairs,
}

/// What the samples of a pixel are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Order {
    /// One, of grey.
    Gray,
    /// So many, the first red, green and blue, or blue, green and red.
    Colors { count: u32, reversed: bool },
    /// One, of a colour by its place.
    Mosaic(Mosaic),
}

/// A format of a camera's frames; as text a name of GenICam's, `"Mono12p".parse()`.
///
/// | names | become |
/// | --- | --- |
/// | `Mono8`, `Mono10` to `Mono16`, `Mono10p`, `Mono12p`, `Mono10Packed`, `Mono12Packed`, `Mono32f` | grey |
/// | `RGB8`, `BGR8`, `RGBa8`, `BGRa8`, `RGB16`, `RGB32f` | red, green, blue; alpha is left out |
/// | `BayerRG8`, likewise `GR`, `GB`, `BG`, and 10, 12, 16, 10p, 12p, 10Packed, 12Packed | red, green, blue, by Malvar, He and Cutler (ICASSP 2004) |
///
/// Samples of more than 8 bits become 16, their greatest 65535.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct PixelFormat {
    name: &'static str,
    /// In the convention, 0 where that has none.
    code: u32,
    pub(crate) bits: u32,
    pub(crate) packing: Packing,
    pub(crate) order: Order,
}

const fn of(name: &'static str, code: u32, bits: u32, packing: Packing, order: Order) -> PixelFormat {
    PixelFormat { name, code, bits, packing, order }
}

const fn gray(name: &'static str, code: u32, bits: u32, packing: Packing) -> PixelFormat {
    of(name, code, bits, packing, Order::Gray)
}

const fn colors(name: &'static str, code: u32, bits: u32, count: u32, reversed: bool) -> PixelFormat {
    of(name, code, bits, Packing::Whole, Order::Colors { count, reversed })
}

macro_rules! bayer {
    ($($pattern:literal: $mosaic:expr, $codes:expr);*) => {
        [$([
            of(concat!("Bayer", $pattern, "8"), $codes[0], 8, Packing::Whole, Order::Mosaic($mosaic)),
            of(concat!("Bayer", $pattern, "10"), $codes[1], 10, Packing::Whole, Order::Mosaic($mosaic)),
            of(concat!("Bayer", $pattern, "12"), $codes[2], 12, Packing::Whole, Order::Mosaic($mosaic)),
            of(concat!("Bayer", $pattern, "16"), $codes[3], 16, Packing::Whole, Order::Mosaic($mosaic)),
            of(concat!("Bayer", $pattern, "10p"), $codes[4], 10, Packing::Bits, Order::Mosaic($mosaic)),
            of(concat!("Bayer", $pattern, "12p"), $codes[5], 12, Packing::Bits, Order::Mosaic($mosaic)),
            of(concat!("Bayer", $pattern, "10Packed"), $codes[6], 10, Packing::Pairs, Order::Mosaic($mosaic)),
            of(concat!("Bayer", $pattern, "12Packed"), $codes[7], 12, Packing::Pairs, Order::Mosaic($mosaic)),
        ]),*]
    };
}

const GRAY: [PixelFormat; 10] = [
    gray("Mono8", 0x0108_0001, 8, Packing::Whole),
    gray("Mono10", 0x0110_0003, 10, Packing::Whole),
    gray("Mono12", 0x0110_0005, 12, Packing::Whole),
    gray("Mono14", 0x0110_0025, 14, Packing::Whole),
    gray("Mono16", 0x0110_0007, 16, Packing::Whole),
    gray("Mono32f", 0, 32, Packing::Whole),
    gray("Mono10p", 0x010a_0046, 10, Packing::Bits),
    gray("Mono12p", 0x010c_0047, 12, Packing::Bits),
    gray("Mono10Packed", 0x010c_0004, 10, Packing::Pairs),
    gray("Mono12Packed", 0x010c_0006, 12, Packing::Pairs),
];
const COLORS: [PixelFormat; 6] = [
    colors("RGB8", 0x0218_0014, 8, 3, false),
    colors("BGR8", 0x0218_0015, 8, 3, true),
    colors("RGBa8", 0x0220_0016, 8, 4, false),
    colors("BGRa8", 0x0220_0017, 8, 4, true),
    colors("RGB16", 0x0230_0033, 16, 3, false),
    colors("RGB32f", 0, 32, 3, false),
];
#[rustfmt::skip]
const MOSAICS: [[PixelFormat; 8]; 4] = bayer!(
    "GR": Mosaic([1, 0]), [0x0108_0008, 0x0110_000c, 0x0110_0010, 0x0110_002e, 0x010a_0056, 0x010c_0057, 0x010c_0026, 0x010c_002a];
    "RG": Mosaic([0, 0]), [0x0108_0009, 0x0110_000d, 0x0110_0011, 0x0110_002f, 0x010a_0058, 0x010c_0059, 0x010c_0027, 0x010c_002b];
    "GB": Mosaic([0, 1]), [0x0108_000a, 0x0110_000e, 0x0110_0012, 0x0110_0030, 0x010a_0054, 0x010c_0055, 0x010c_0028, 0x010c_002c];
    "BG": Mosaic([1, 1]), [0x0108_000b, 0x0110_000f, 0x0110_0013, 0x0110_0031, 0x010a_0052, 0x010c_0053, 0x010c_0029, 0x010c_002d]
);

impl PixelFormat {
    /// All of them.
    pub fn all() -> impl Iterator<Item = Self> {
        GRAY.into_iter().chain(COLORS).chain(MOSAICS.into_iter().flatten())
    }

    /// That of a number of the convention, as a camera states it.
    pub fn of_code(code: u32) -> Option<Self> {
        Self::all().find(|format| format.code == code && code != 0)
    }

    /// What its frames are once they are unpacked.
    pub fn format(self) -> Format {
        let channels = if self.order == Order::Gray { Channels::Gray } else { Channels::Rgb };
        let depth = match self.bits {
            8 => Depth::U8,
            32 => Depth::F32,
            _ => Depth::U16,
        };
        Format { channels, depth }
    }

    /// Whether frames need no unpacking: their samples lie as those of a [`Frame`].
    pub fn is_plain(self) -> bool {
        Self::from(self.format()) == self
    }

    /// Samples of a pixel as they are packed.
    pub(crate) fn samples_a_pixel(self) -> u32 {
        if let Order::Colors { count, .. } = self.order { count } else { 1 }
    }

    /// Bytes of so many pixels one behind the other.
    pub(crate) fn bytes_of(self, pixels: u64) -> u64 {
        // What is beyond any memory stays so.
        let samples = pixels.saturating_mul(self.samples_a_pixel().into());
        match self.packing {
            Packing::Whole => samples.saturating_mul(self.bits.div_ceil(8).into()),
            Packing::Bits => samples.saturating_mul(self.bits.into()).div_ceil(8),
            Packing::Pairs => samples.div_ceil(2).saturating_mul(3),
        }
    }

    /// Bytes of a frame of this size, row behind row without gaps.
    pub fn bytes(self, [width, height]: [u32; 2]) -> u64 {
        self.bytes_of(u64::from(width) * u64::from(height))
    }

    /// Bytes of a row, of one that ends with a byte; only such rows can have gaps between them.
    pub fn row_bytes(self, width: u32) -> Option<u64> {
        let bytes = self.bytes_of(width.into());
        (2 * bytes == self.bytes_of(2 * u64::from(width))).then_some(bytes)
    }

    /// The frame that these bytes are, row behind row without gaps.
    ///
    /// # Errors
    /// Says how many bytes there should be, and as [`Frame::new`].
    pub fn frame(self, [width, height]: [u32; 2], bytes: &[u8]) -> Result<Frame, String> {
        let (found, expected) = (bytes.len() as u64, self.bytes([width, height]));
        if found != expected {
            return Err(format!("is of {found} bytes, and {width}x{height} of {self} takes {expected}"));
        }
        let format = self.format();
        let packed = Packed { bytes, format: self };
        let value = |i: usize| match self.order {
            Order::Gray => packed.widened(i),
            Order::Colors { count, reversed } => {
                let (pixel, channel) = (i / 3, i % 3);
                packed.widened(pixel * count as usize + if reversed { 2 - channel } else { channel })
            }
            Order::Mosaic(mosaic) => {
                let size = [width as usize, height as usize];
                let most = if self.bits == 8 { 255 } else { 65535 };
                let (x, y) = (i / 3 % size[0], i / 3 / size[0]);
                mosaic::color(mosaic, i % 3, [x, y], size, most, |x, y| i64::from(packed.widened(y * size[0] + x)))
            }
        };
        let count = width as usize * height as usize * format.channels.count() as usize;
        let samples = match format.depth {
            Depth::U8 => Samples::U8((0..count).map(|i| value(i) as u8).collect()),
            Depth::U16 => Samples::U16((0..count).map(|i| value(i) as u16).collect()),
            Depth::F32 => Samples::F32(bytemuck::pod_collect_to_vec(bytes)),
        };
        Frame::new(width, height, format.channels, samples)
    }
}

/// Samples as they are packed.
struct Packed<'a> {
    bytes: &'a [u8],
    format: PixelFormat,
}

impl Packed<'_> {
    fn byte(&self, at: usize) -> u32 {
        self.bytes.get(at).copied().unwrap_or(0).into()
    }

    /// Sample i, of 8 bits or widened to 16; bits beyond those of the format are none of it.
    fn widened(&self, i: usize) -> u32 {
        let bits = self.format.bits;
        let most = (1 << bits) - 1;
        let sample = self.sample(i) & most;
        if bits == 8 { sample } else { (sample * 65535 + most / 2) / most }
    }

    fn sample(&self, i: usize) -> u32 {
        let bits = self.format.bits;
        match self.format.packing {
            Packing::Whole if bits == 8 => self.byte(i),
            Packing::Whole => self.byte(2 * i) | self.byte(2 * i + 1) << 8,
            Packing::Bits => {
                let (at, shift) = (i * bits as usize / 8, i * bits as usize % 8);
                (self.byte(at) | self.byte(at + 1) << 8 | self.byte(at + 2) << 16) >> shift
            }
            Packing::Pairs => {
                let (at, low_bits) = (i / 2 * 3, bits - 8);
                let is_first = i.is_multiple_of(2);
                let high = self.byte(if is_first { at } else { at + 2 });
                let low = self.byte(at + 1) >> if is_first { 0 } else { 4 };
                high << low_bits | low & ((1 << low_bits) - 1)
            }
        }
    }
}

impl From<Format> for PixelFormat {
    fn from(Format { channels, depth }: Format) -> Self {
        match (channels, depth) {
            (Channels::Gray, Depth::U8) => GRAY[0],
            (Channels::Gray, Depth::U16) => GRAY[4],
            (Channels::Gray, Depth::F32) => GRAY[5],
            (Channels::Rgb, Depth::U8) => COLORS[0],
            (Channels::Rgb, Depth::U16) => COLORS[4],
            (Channels::Rgb, Depth::F32) => COLORS[5],
        }
    }
}

impl FromStr for PixelFormat {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::all().find(|format| format.name.eq_ignore_ascii_case(name.trim())).ok_or_else(|| {
            let names: Vec<&str> = GRAY.iter().chain(&COLORS).map(|format| format.name).collect();
            format!("'{name}' is no format that is read; give one of {}, or of Bayer's as BayerRG8", names.join(", "))
        })
    }
}

impl fmt::Display for PixelFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

impl fmt::Debug for PixelFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(format: &str, size: [u32; 2], bytes: &[u8]) -> Vec<u32> {
        let format: PixelFormat = format.parse().unwrap();
        let most = if format.bits == 32 { 0 } else { (1u32 << format.bits) - 1 };
        match format.frame(size, bytes).unwrap().samples() {
            Samples::U8(found) => found.iter().map(|&v| v.into()).collect(),
            Samples::U16(found) => {
                found.iter().map(|&v| ((u64::from(v) * u64::from(most) + 32767) / 65535) as u32).collect()
            }
            Samples::F32(found) => found.iter().map(|v| v.to_bits()).collect(),
        }
    }

    /// By the tables of the conventions: the pixels 0x123 0x456 0x789 and, of 10 bits, 0x123 0x256 0x389 0x0ab.
    #[test]
    fn each_format_has_its_samples() {
        assert_eq!(samples("Mono8", [3, 1], &[1, 2, 255]), [1, 2, 255]);
        assert_eq!(samples("Mono10", [2, 1], &[0x23, 0x01, 0x56, 0x02]), [0x123, 0x256]);
        assert_eq!(samples("Mono12", [2, 1], &[0x23, 0x01, 0xff, 0x0f]), [0x123, 0xfff]);
        assert_eq!(samples("Mono14", [1, 1], &[0xff, 0x3f]), [0x3fff]);
        assert_eq!(samples("Mono16", [2, 1], &[0x34, 0x12, 0xff, 0xff]), [0x1234, 0xffff]);
        assert_eq!(samples("Mono12p", [3, 1], &[0x23, 0x61, 0x45, 0x89, 0x07]), [0x123, 0x456, 0x789]);
        assert_eq!(samples("Mono12Packed", [3, 1], &[0x12, 0x63, 0x45, 0x78, 0x09, 0]), [0x123, 0x456, 0x789]);
        let bits = [0x123u64, 0x256, 0x389, 0x0ab].iter().rev().fold(0u64, |all, v| all << 10 | v);
        assert_eq!(samples("mono10p", [2, 2], &bits.to_le_bytes()[..5]), [0x123, 0x256, 0x389, 0x0ab]);
        assert_eq!(samples("Mono10Packed", [2, 1], &[0x48, 0x23, 0x95]), [0x123, 0x256]);
        assert_eq!(samples("Mono32f", [1, 1], &0.25f32.to_le_bytes()), [0.25f32.to_bits()]);
        assert_eq!(samples("RGB8", [2, 1], &[1, 2, 3, 4, 5, 6]), [1, 2, 3, 4, 5, 6]);
        assert_eq!(samples("BGR8", [2, 1], &[1, 2, 3, 4, 5, 6]), [3, 2, 1, 6, 5, 4]);
        assert_eq!(samples("RGBa8", [2, 1], &[1, 2, 3, 9, 4, 5, 6, 9]), [1, 2, 3, 4, 5, 6]);
        assert_eq!(samples("BGRa8", [1, 1], &[1, 2, 3, 9]), [3, 2, 1]);
        assert_eq!(samples("RGB16", [1, 1], &[1, 2, 3, 4, 5, 6]), [0x201, 0x403, 0x605]);
    }

    #[test]
    fn white_is_white_in_any_format() {
        for format in PixelFormat::all().filter(|format| format.bits != 32) {
            let bytes = vec![255; format.bytes([4, 3]) as usize];
            let frame = format.frame([4, 3], &bytes).unwrap();
            let is_white = match frame.samples() {
                Samples::U8(s) => s.iter().all(|&v| v == 255),
                Samples::U16(s) => s.iter().all(|&v| v == 65535),
                Samples::F32(_) => false,
            };
            assert!(is_white, "{format}: {frame:?}");
        }
    }

    #[test]
    fn formats_of_frames_are_their_own_and_others_are_unpacked() {
        for channels in [Channels::Gray, Channels::Rgb] {
            for depth in [Depth::U8, Depth::U16, Depth::F32] {
                let format = PixelFormat::from(Format { channels, depth });
                assert_eq!(format.format(), Format { channels, depth });
                assert!(format.is_plain());
                assert_eq!(format.bytes([5, 3]), u64::from(15 * channels.count() * depth.bytes()));
            }
        }
        assert_eq!(PixelFormat::all().filter(|format| format.is_plain()).count(), 6);
        let row = |name: &str, width| name.parse::<PixelFormat>().unwrap().row_bytes(width);
        assert_eq!([row("Mono12p", 4), row("Mono12p", 5), row("Mono10p", 6)], [Some(6), None, None]);
        assert_eq!([row("Mono12Packed", 5), row("BayerGB12", 5), row("BGRa8", 5)], [None, Some(10), Some(20)]);
        assert!("Mono13".parse::<PixelFormat>().unwrap_err().contains("Mono12Packed"));
        assert!(PixelFormat::all().all(|format| format.to_string().parse() == Ok(format)));
        // A number states the bits of a pixel.
        let coded = || PixelFormat::all().filter(|format| format.code != 0);
        assert_eq!(coded().count(), PixelFormat::all().count() - 2);
        for format in coded() {
            assert_eq!(PixelFormat::of_code(format.code), Some(format));
            assert_eq!(u64::from(format.code >> 16 & 0xff), format.bytes([8, 1]), "{format}");
        }
        assert_eq!(PixelFormat::of_code(0), None);
    }
}
