//! Pixel formats of cameras: packed samples, channel orders and Bayer mosaics.
//!
//! Names and codes are those of the GenICam Pixel Format Naming Convention 2.4. Formats whose name ends in `Packed` are
//! those of GigE Vision 1.x, with two pixels in three bytes. Unpacked samples of more than 8 bits are little-endian.

use std::fmt;
use std::str::FromStr;

use super::{Channels, Depth, Format, Frame, Samples};

/// How samples are packed into bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Packing {
    /// Each sample has its own bytes.
    Unpacked,
    /// `p`: consecutive bits, low bits first, without padding.
    Bits,
    /// `Packed`: two samples in three bytes: the high bits of the first, the low bits of both, the high bits of the
    /// second.
    Pairs,
}

/// The samples of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Order {
    /// One grey sample.
    Gray,
    /// `count` samples. The first three are red, green and blue, or blue, green and red if `reversed`.
    Colors { count: u32, reversed: bool },
    /// One sample, whose colour depends on the position.
    Mosaic(Mosaic),
}

/// The pixel format of a camera's frames. It is parsed from and displayed as its GenICam name: `"Mono12p".parse()`.
///
/// | names | unpacked to |
/// | --- | --- |
/// | `Mono8`, `Mono10` to `Mono16`, `Mono10p`, `Mono12p`, `Mono10Packed`, `Mono12Packed`, `Mono32f` | grey |
/// | `RGB8`, `BGR8`, `RGBa8`, `BGRa8`, `RGB16`, `RGB32f` | red, green, blue; alpha is dropped |
/// | `BayerRG8`, also `GR`, `GB`, `BG`, and 10, 12, 16, 10p, 12p, 10Packed, 12Packed | red, green, blue, demosaiced |
///
/// Samples of 10 to 16 bits become 16 bits, with white at 65535.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct PixelFormat {
    name: &'static str,
    /// The code in the convention, 0 if it has none.
    code: u32,
    pub(crate) bits: u32,
    pub(crate) packing: Packing,
    pub(crate) order: Order,
}

const fn format(name: &'static str, code: u32, bits: u32, packing: Packing, order: Order) -> PixelFormat {
    PixelFormat { name, code, bits, packing, order }
}

const fn gray(name: &'static str, code: u32, bits: u32, packing: Packing) -> PixelFormat {
    format(name, code, bits, packing, Order::Gray)
}

const fn colors(name: &'static str, code: u32, bits: u32, count: u32) -> PixelFormat {
    let reversed = name.as_bytes()[0] == b'B';
    format(name, code, bits, Packing::Unpacked, Order::Colors { count, reversed })
}

macro_rules! bayer {
    ($($pattern:literal: $mosaic:expr, $codes:expr);*) => {
        [$([
            format(concat!("Bayer", $pattern, "8"), $codes[0], 8, Packing::Unpacked, Order::Mosaic($mosaic)),
            format(concat!("Bayer", $pattern, "10"), $codes[1], 10, Packing::Unpacked, Order::Mosaic($mosaic)),
            format(concat!("Bayer", $pattern, "12"), $codes[2], 12, Packing::Unpacked, Order::Mosaic($mosaic)),
            format(concat!("Bayer", $pattern, "16"), $codes[3], 16, Packing::Unpacked, Order::Mosaic($mosaic)),
            format(concat!("Bayer", $pattern, "10p"), $codes[4], 10, Packing::Bits, Order::Mosaic($mosaic)),
            format(concat!("Bayer", $pattern, "12p"), $codes[5], 12, Packing::Bits, Order::Mosaic($mosaic)),
            format(concat!("Bayer", $pattern, "10Packed"), $codes[6], 10, Packing::Pairs, Order::Mosaic($mosaic)),
            format(concat!("Bayer", $pattern, "12Packed"), $codes[7], 12, Packing::Pairs, Order::Mosaic($mosaic)),
        ]),*]
    };
}

const GRAY: [PixelFormat; 10] = [
    gray("Mono8", 0x0108_0001, 8, Packing::Unpacked),
    gray("Mono10", 0x0110_0003, 10, Packing::Unpacked),
    gray("Mono12", 0x0110_0005, 12, Packing::Unpacked),
    gray("Mono14", 0x0110_0025, 14, Packing::Unpacked),
    gray("Mono16", 0x0110_0007, 16, Packing::Unpacked),
    gray("Mono32f", 0, 32, Packing::Unpacked),
    gray("Mono10p", 0x010a_0046, 10, Packing::Bits),
    gray("Mono12p", 0x010c_0047, 12, Packing::Bits),
    gray("Mono10Packed", 0x010c_0004, 10, Packing::Pairs),
    gray("Mono12Packed", 0x010c_0006, 12, Packing::Pairs),
];
const COLORS: [PixelFormat; 6] = [
    colors("RGB8", 0x0218_0014, 8, 3),
    colors("BGR8", 0x0218_0015, 8, 3),
    colors("RGBa8", 0x0220_0016, 8, 4),
    colors("BGRa8", 0x0220_0017, 8, 4),
    colors("RGB16", 0x0230_0033, 16, 3),
    colors("RGB32f", 0, 32, 3),
];
#[rustfmt::skip]
const MOSAICS: [[PixelFormat; 8]; 4] = bayer!(
    "GR": Mosaic([1, 0]), [0x0108_0008, 0x0110_000c, 0x0110_0010, 0x0110_002e, 0x010a_0056, 0x010c_0057, 0x010c_0026, 0x010c_002a];
    "RG": Mosaic([0, 0]), [0x0108_0009, 0x0110_000d, 0x0110_0011, 0x0110_002f, 0x010a_0058, 0x010c_0059, 0x010c_0027, 0x010c_002b];
    "GB": Mosaic([0, 1]), [0x0108_000a, 0x0110_000e, 0x0110_0012, 0x0110_0030, 0x010a_0054, 0x010c_0055, 0x010c_0028, 0x010c_002c];
    "BG": Mosaic([1, 1]), [0x0108_000b, 0x0110_000f, 0x0110_0013, 0x0110_0031, 0x010a_0052, 0x010c_0053, 0x010c_0029, 0x010c_002d]
);

impl PixelFormat {
    /// Returns all formats.
    pub fn all() -> impl Iterator<Item = Self> {
        GRAY.into_iter().chain(COLORS).chain(MOSAICS.into_iter().flatten())
    }

    /// Returns the format of a code of the convention, as cameras report it.
    pub fn from_code(code: u32) -> Option<Self> {
        Self::all().find(|format| format.code == code && code != 0)
    }

    /// Returns channels and depth of an unpacked frame.
    pub fn format(self) -> Format {
        let channels = if self.order == Order::Gray { Channels::Gray } else { Channels::Rgb };
        let depth = match self.bits {
            8 => Depth::U8,
            32 => Depth::F32,
            _ => Depth::U16,
        };
        Format { channels, depth }
    }

    /// Returns whether frames have the layout of a [`Frame`] and need no unpacking.
    pub fn is_plain(self) -> bool {
        Self::from(self.format()) == self
    }

    /// Returns the number of packed samples per pixel.
    pub(crate) fn samples_per_pixel(self) -> u32 {
        if let Order::Colors { count, .. } = self.order { count } else { 1 }
    }

    /// Returns the bytes of consecutive pixels. It saturates beyond any memory size.
    fn bytes_of(self, pixels: u64) -> u64 {
        let samples = pixels.saturating_mul(self.samples_per_pixel().into());
        match self.packing {
            Packing::Unpacked => samples.saturating_mul(self.bits.div_ceil(8).into()),
            Packing::Bits => samples.saturating_mul(self.bits.into()).div_ceil(8),
            Packing::Pairs => samples.div_ceil(2).saturating_mul(3),
        }
    }

    /// Returns the bytes of a frame of `width` x `height` pixels without row padding.
    pub fn bytes(self, [width, height]: [u32; 2]) -> u64 {
        self.bytes_of(u64::from(width) * u64::from(height))
    }

    /// Returns the layout of a frame's rows in memory. `pitch` is the number of bytes from the start of a row to that
    /// of the next, 0 for rows without padding.
    ///
    /// # Errors
    /// A message if the frame has no pixels, the pitch is shorter than a row, or padded rows do not end at a byte.
    pub fn rows(self, size: [u32; 2], pitch: usize) -> Result<RowLayout, String> {
        let [width, height] = size;
        if size.contains(&0) {
            return Err("it has no pixels".to_string());
        }
        let too_many = || format!("{width}x{height} pixels are too many");
        let whole = usize::try_from(self.bytes(size)).map_err(|_| too_many())?;
        let row_bytes = self.bytes_of(width.into()) as usize;
        let ends_at_byte = self.bytes_of(2 * u64::from(width)) == 2 * row_bytes as u64;
        if pitch == 0 || (ends_at_byte && pitch == row_bytes) {
            return Ok(RowLayout { row_bytes: whole, pitch: whole, bytes: whole });
        }
        if !ends_at_byte {
            return Err(format!(
                "a row of {width} px of {self} ends within a byte: give rows without padding, a pitch of 0, or an even width"
            ));
        }
        if pitch < row_bytes {
            return Err(format!(
                "rows of {width} px of {self} take {row_bytes} bytes, and the pitch is {pitch}: give bytes, 0 for rows without padding"
            ));
        }
        let padded = (height as usize - 1).checked_mul(pitch).and_then(|bytes| bytes.checked_add(row_bytes));
        Ok(RowLayout { row_bytes, pitch, bytes: padded.ok_or_else(too_many)? })
    }

    /// Unpacks a frame of `width` x `height` pixels without row padding.
    ///
    /// # Errors
    /// A message if `bytes` has another length, or as for [`Frame::new`].
    pub fn frame(self, [width, height]: [u32; 2], bytes: &[u8]) -> Result<Frame, String> {
        let (found, expected) = (bytes.len() as u64, self.bytes([width, height]));
        if found != expected {
            return Err(format!("is of {found} bytes, and {width}x{height} of {self} takes {expected}"));
        }
        let format = self.format();
        if self.is_plain() {
            let samples = match format.depth {
                Depth::U8 => Samples::U8(bytes.to_vec()),
                Depth::U16 => Samples::U16(bytemuck::pod_collect_to_vec(bytes)),
                Depth::F32 => Samples::F32(bytemuck::pod_collect_to_vec(bytes)),
            };
            return Frame::new(width, height, format.channels, samples);
        }
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
                mosaic.color(i % 3, [x, y], size, most, |x, y| i64::from(packed.widened(y * size[0] + x)))
            }
        };
        let count = width as usize * height as usize * format.channels.count() as usize;
        let samples = match format.depth {
            Depth::U8 => Samples::U8((0..count).map(|i| value(i) as u8).collect()),
            _ => Samples::U16((0..count).map(|i| value(i) as u16).collect()),
        };
        Frame::new(width, height, format.channels, samples)
    }
}

/// The layout of a frame's rows in memory. Rows without padding count as one row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RowLayout {
    /// Bytes of a row.
    pub row_bytes: usize,
    /// Bytes from the start of a row to that of the next.
    pub pitch: usize,
    /// Bytes from the start of the first row to the end of the last.
    pub bytes: usize,
}

/// Packed samples.
struct Packed<'a> {
    bytes: &'a [u8],
    format: PixelFormat,
}

impl Packed<'_> {
    fn byte(&self, at: usize) -> u32 {
        self.bytes.get(at).copied().unwrap_or(0).into()
    }

    /// Returns sample `i`, of 8 bits or scaled to 16 bits. Unused bits are ignored.
    fn widened(&self, i: usize) -> u32 {
        let bits = self.format.bits;
        let most = (1 << bits) - 1;
        let sample = self.sample(i) & most;
        if bits == 8 { sample } else { (sample * 65535 + most / 2) / most }
    }

    fn sample(&self, i: usize) -> u32 {
        let bits = self.format.bits;
        match self.format.packing {
            Packing::Unpacked if bits == 8 => self.byte(i),
            Packing::Unpacked => self.byte(2 * i) | self.byte(2 * i + 1) << 8,
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
            format!(
                "'{name}' is no supported pixel format; give one of {}, or a Bayer format such as BayerRG8",
                names.join(", ")
            )
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

/// A Bayer pattern: the position of red in each 2x2 block. Blue is diagonally opposite, green in the other two.
///
/// Demosaicing uses linear 5x5 filters: Malvar, He and Cutler, High-quality linear interpolation for demosaicing of
/// Bayer-patterned color images, ICASSP 2004.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Mosaic(pub(crate) [u32; 2]);

impl Mosaic {
    /// Returns the channel 0 (red), 1 (green) or 2 (blue) of a pixel from the samples of a mosaic, each 0 to `white`.
    /// Beyond the border, samples are mirrored about the border pixels, which preserves the pattern.
    fn color(
        self,
        channel: usize,
        [x, y]: [usize; 2],
        size: [usize; 2],
        white: i64,
        sample: impl Fn(usize, usize) -> i64,
    ) -> u32 {
        let Self(red) = self;
        let inside = |p: i64, side: usize| p.abs().min(2 * (side as i64 - 1) - p.abs()).max(0) as usize;
        let at = |dx: i64, dy: i64| sample(inside(x as i64 + dx, size[0]), inside(y as i64 + dy, size[1]));
        let across = |d: i64| at(-d, 0) + at(d, 0);
        let along = |d: i64| at(0, -d) + at(0, d);
        let (here, corners) = (at(0, 0), || at(-1, -1) + at(1, -1) + at(-1, 1) + at(1, 1));
        // Whether the pixel is in a column, and in a row, with red.
        let [in_column, in_row] = [(x as u32 & 1) == red[0], (y as u32 & 1) == red[1]];
        let is_green = in_column != in_row;
        // The filters' weights are multiples of 1/16.
        let sum = match channel {
            1 if is_green => 16 * here,
            1 => 8 * here + 4 * (across(1) + along(1)) - 2 * (across(2) + along(2)),
            // A green pixel with the channel in its row, or in its column.
            c if is_green && in_row == (c == 0) => 10 * here + 8 * across(1) - 2 * corners() - 2 * across(2) + along(2),
            _ if is_green => 10 * here + 8 * along(1) - 2 * corners() - 2 * along(2) + across(2),
            c if in_row == (c == 0) => 16 * here,
            _ => 12 * here + 4 * corners() - 3 * (across(2) + along(2)),
        };
        ((sum + 8) >> 4).clamp(0, white) as u32
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

    /// The pixels 0x123 0x456 0x789, and of 10 bits 0x123 0x256 0x389 0x0ab, packed by the tables of the conventions.
    #[test]
    fn samples_are_unpacked() {
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
    fn plain_formats_names_codes_and_sizes_are_consistent() {
        for channels in [Channels::Gray, Channels::Rgb] {
            for depth in [Depth::U8, Depth::U16, Depth::F32] {
                let format = PixelFormat::from(Format { channels, depth });
                assert_eq!(format.format(), Format { channels, depth });
                assert!(format.is_plain());
                assert_eq!(format.bytes([5, 3]), u64::from(15 * channels.count() * depth.bytes()));
            }
        }
        assert_eq!(PixelFormat::all().filter(|format| format.is_plain()).count(), 6);
        assert!("Mono13".parse::<PixelFormat>().unwrap_err().contains("Mono12Packed"));
        assert!(PixelFormat::all().all(|format| format.to_string().parse() == Ok(format)));
        // Bits 16 to 23 of a code are the bits per pixel.
        let coded = || PixelFormat::all().filter(|format| format.code != 0);
        assert_eq!(coded().count(), PixelFormat::all().count() - 2);
        for format in coded() {
            assert_eq!(PixelFormat::from_code(format.code), Some(format));
            assert_eq!(u64::from(format.code >> 16 & 0xff), format.bytes([8, 1]), "{format}");
        }
        assert_eq!(PixelFormat::from_code(0), None);
    }

    #[test]
    fn padded_rows_end_at_a_byte_and_rows_without_padding_are_one() {
        let rows = |name: &str, width, pitch| name.parse::<PixelFormat>().unwrap().rows([width, 3], pitch);
        let layout = |row_bytes, pitch, bytes| Ok(RowLayout { row_bytes, pitch, bytes });
        assert_eq!(rows("Mono12p", 4, 8), layout(6, 8, 22));
        assert_eq!([rows("Mono12p", 4, 6), rows("Mono12p", 4, 0)], [layout(18, 18, 18), layout(18, 18, 18)]);
        assert_eq!(rows("Mono12p", 5, 0), layout(23, 23, 23));
        assert_eq!(rows("BGRa8", 5, 24), layout(20, 24, 68));
        for (name, width, pitch) in [("Mono12p", 5, 8), ("Mono10p", 6, 9), ("Mono12Packed", 5, 9)] {
            assert!(rows(name, width, pitch).unwrap_err().contains("ends within a byte"), "{name}");
        }
        assert!(rows("BayerGB12", 5, 9).unwrap_err().contains("take 10 bytes"));
        assert!(rows("Mono8", 0, 0).unwrap_err().contains("no pixels"));
        assert!(rows("Mono16", u32::MAX, usize::MAX).unwrap_err().contains("too many"));
    }

    const SIZE: [usize; 2] = [9, 7];

    fn for_each_sample(mut check: impl FnMut(Mosaic, [usize; 2], usize)) {
        for mosaic in [[0, 0], [1, 0], [0, 1], [1, 1]].map(Mosaic) {
            for (x, y, c) in (0..SIZE[0] * SIZE[1] * 3).map(|i| (i / 3 % SIZE[0], i / 3 / SIZE[0], i % 3)) {
                check(mosaic, [x, y], c);
            }
        }
    }

    /// Returns the sample of a uniform colour at a position.
    fn sample_of(Mosaic(red): Mosaic, colors: [i64; 3], [x, y]: [usize; 2]) -> i64 {
        let [in_column, in_row] = [(x as u32 & 1) == red[0], (y as u32 & 1) == red[1]];
        colors[if in_column != in_row {
            1
        } else if in_row {
            0
        } else {
            2
        }]
    }

    #[test]
    fn a_uniform_colour_is_exact_up_to_the_border() {
        let colors = [200, 90, 3];
        for_each_sample(|mosaic, place, c| {
            let found = mosaic.color(c, place, SIZE, 255, |x, y| sample_of(mosaic, colors, [x, y]));
            assert_eq!(i64::from(found), colors[c], "{mosaic:?} {place:?} {c}");
        });
    }

    #[test]
    fn a_grey_gradient_is_exact_inside() {
        for_each_sample(|mosaic, [x, y], c| {
            if (2..SIZE[0] - 2).contains(&x) && (2..SIZE[1] - 2).contains(&y) {
                let found = mosaic.color(c, [x, y], SIZE, 65535, |x, y| 100 + 7 * x as i64 + 13 * y as i64);
                assert_eq!(found as usize, 100 + 7 * x + 13 * y);
            }
        });
    }

    #[test]
    fn overshoot_is_clamped() {
        for_each_sample(|mosaic, place, c| {
            let found = mosaic.color(c, place, SIZE, 255, |x, y| if (x / 2 + y / 3) % 2 == 0 { 255 } else { 0 });
            assert!(found <= 255);
        });
    }
}
