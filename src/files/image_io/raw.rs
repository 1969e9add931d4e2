//! Frames of a camera without a header, of a size and a format that are stated with the name: `FILE#Mono12p:2448x2048`.
//!
//! The formats are those of GenICam's Pixel Format Naming Convention 2.4 and, where `Packed` ends the name, those of GigE Vision
//! 1.x, in which two pixels share three bytes in another way. Samples of more than 8 bits have their low byte first.

use std::fmt;
use std::str::FromStr;

use crate::base::{Channels, Depth, Frame, Samples};

/// How samples lie one behind the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Packing {
    /// In bytes of their own.
    Whole,
    /// In bits one after the other, the low ones first, without padding: `p`.
    Bits,
    /// Two in three bytes: the high bits of the first, the low ones of both, the high bits of the second: `Packed`.
    Pairs,
}

/// Name, bits of a sample, packing.
const FORMATS: [(&str, u32, Packing); 9] = [
    ("Mono8", 8, Packing::Whole),
    ("Mono10", 10, Packing::Whole),
    ("Mono12", 12, Packing::Whole),
    ("Mono14", 14, Packing::Whole),
    ("Mono16", 16, Packing::Whole),
    ("Mono10p", 10, Packing::Bits),
    ("Mono12p", 12, Packing::Bits),
    ("Mono10Packed", 10, Packing::Pairs),
    ("Mono12Packed", 12, Packing::Pairs),
];

/// Format and size of a frame that does not state them itself; as text `Mono12p:2448x2048`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawFormat {
    name: &'static str,
    bits: u32,
    packing: Packing,
    size: (u32, u32),
}

impl FromStr for RawFormat {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let size = |text: &str| {
            let (width, height) = text.split_once(['x', 'X', '×'])?;
            Some((width.trim().parse().ok()?, height.trim().parse().ok()?))
        };
        let parts = text.split_once(':').map(|(name, of)| (name, size(of)));
        let Some((name, Some(size))) = parts.filter(|(_, size)| size.is_none_or(|(w, h)| w > 0 && h > 0)) else {
            return Err("give format and size, as in Mono12p:2448x2048".to_string());
        };
        let known = FORMATS.iter().find(|(known, ..)| known.eq_ignore_ascii_case(name.trim()));
        let &(name, bits, packing) = known.ok_or_else(|| {
            let names: Vec<&str> = FORMATS.iter().map(|(name, ..)| *name).collect();
            format!("'{name}' is no format that is read; give one of {}", names.join(", "))
        })?;
        Ok(Self { name, bits, packing, size })
    }
}

impl fmt::Display for RawFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}x{}", self.name, self.size.0, self.size.1)
    }
}

impl RawFormat {
    /// Bytes of a frame.
    fn length(&self) -> u64 {
        let pixels = u64::from(self.size.0) * u64::from(self.size.1);
        match self.packing {
            Packing::Whole => pixels * u64::from(self.bits.div_ceil(8)),
            Packing::Bits => (pixels * u64::from(self.bits)).div_ceil(8),
            Packing::Pairs => pixels.div_ceil(2) * 3,
        }
    }

    /// The frame that these bytes are, as those of a camera's buffer; samples of more than 8 bits become 16, their greatest 65535.
    ///
    /// # Errors
    /// Says how many bytes there should be.
    pub fn frame(self, bytes: &[u8]) -> Result<Frame, String> {
        Raw::open(bytes, self)?.decode()
    }

    /// The formats in which a frame of this size takes so many bytes.
    fn fitting(&self, length: u64) -> Vec<&'static str> {
        let all = FORMATS.iter().map(|&(name, bits, packing)| Self { name, bits, packing, ..*self });
        all.filter(|format| format.length() == length).map(|format| format.name).collect()
    }
}

/// A frame whose length has been checked.
pub(super) struct Raw<'a> {
    bytes: &'a [u8],
    format: RawFormat,
}

impl<'a> Raw<'a> {
    /// Checks the length.
    pub(super) fn open(bytes: &'a [u8], format: RawFormat) -> Result<Self, String> {
        let (found, expected) = (bytes.len() as u64, format.length());
        if found == expected {
            return Ok(Self { bytes, format });
        }
        let hint = match format.fitting(found).as_slice() {
            [] => "state another size, or take off a header".to_string(),
            fitting => format!("of this size it may be {}", fitting.join(" or ")),
        };
        Err(format!("is of {found} bytes, and {format} takes {expected}; {hint}"))
    }

    pub(super) fn size(&self) -> (u32, u32) {
        self.format.size
    }

    pub(super) fn bits(&self) -> u32 {
        self.format.bits
    }

    pub(super) fn depth(&self) -> Depth {
        if self.format.bits == 8 { Depth::U8 } else { Depth::U16 }
    }

    /// The frame; samples of more than 8 bits become 16, their greatest 65535.
    pub(super) fn decode(self) -> Result<Frame, String> {
        let (width, height) = self.format.size;
        if self.format.bits == 8 {
            return Frame::new(width, height, Channels::Gray, Samples::U8(self.bytes.to_vec()));
        }
        let most = (1u32 << self.format.bits) - 1;
        let pixels = width as usize * height as usize;
        // Bits beyond those of the format are none of the sample.
        let widened = |i: usize| (((u32::from(self.sample(i)) & most) * 65535 + most / 2) / most) as u16;
        Frame::new(width, height, Channels::Gray, Samples::U16((0..pixels).map(widened).collect()))
    }

    fn sample(&self, i: usize) -> u16 {
        let (byte, bits) = (|at: usize| u16::from(self.bytes.get(at).copied().unwrap_or(0)), self.format.bits);
        match self.format.packing {
            Packing::Whole => byte(2 * i) | byte(2 * i + 1) << 8,
            Packing::Bits => {
                let (at, shift) = (i * bits as usize / 8, i * bits as usize % 8);
                let three = u32::from(byte(at)) | u32::from(byte(at + 1)) << 8 | u32::from(byte(at + 2)) << 16;
                (three >> shift) as u16 & ((1 << bits) - 1)
            }
            Packing::Pairs => {
                let (at, low_bits) = (i / 2 * 3, bits - 8);
                let (high, low) =
                    if i.is_multiple_of(2) { (byte(at), byte(at + 1)) } else { (byte(at + 2), byte(at + 1) >> 4) };
                high << low_bits | low & ((1 << low_bits) - 1)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(format: &str, bytes: &[u8]) -> Vec<u32> {
        let format: RawFormat = format.parse().unwrap();
        let frame = format.frame(bytes).unwrap();
        let most = (1u32 << format.bits) - 1;
        match frame.samples() {
            Samples::U8(found) => found.iter().map(|&v| v.into()).collect(),
            Samples::U16(found) => found.iter().map(|&v| (u32::from(v) * most + 32767) / 65535).collect(),
            Samples::F32(_) => panic!("integers"),
        }
    }

    /// By the tables of the conventions: the pixels 0x123 0x456 0x789 and, of 10 bits, 0x123 0x256 0x389 0x0ab.
    #[test]
    fn each_format_has_its_samples() {
        assert_eq!(samples("Mono8:3x1", &[1, 2, 255]), [1, 2, 255]);
        assert_eq!(samples("Mono10:2x1", &[0x23, 0x01, 0x56, 0x02]), [0x123, 0x256]);
        assert_eq!(samples("Mono12:2x1", &[0x23, 0x01, 0xff, 0x0f]), [0x123, 0xfff]);
        assert_eq!(samples("Mono14:1x1", &[0xff, 0x3f]), [0x3fff]);
        assert_eq!(samples("Mono16:2x1", &[0x34, 0x12, 0xff, 0xff]), [0x1234, 0xffff]);
        assert_eq!(samples("Mono12p:3x1", &[0x23, 0x61, 0x45, 0x89, 0x07]), [0x123, 0x456, 0x789]);
        assert_eq!(samples("Mono12Packed:3x1", &[0x12, 0x63, 0x45, 0x78, 0x09, 0]), [0x123, 0x456, 0x789]);
        let bits = [0x123u64, 0x256, 0x389, 0x0ab].iter().rev().fold(0u64, |all, v| all << 10 | v);
        assert_eq!(samples("mono10p:2x2", &bits.to_le_bytes()[..5]), [0x123, 0x256, 0x389, 0x0ab]);
        assert_eq!(samples("Mono10Packed:2x1", &[0x48, 0x23, 0x95]), [0x123, 0x256]);
    }

    #[test]
    fn white_is_white_in_any_format() {
        for (format, bytes) in [("Mono12p:2x1", vec![255; 3]), ("Mono10:2x1", vec![255, 3, 255, 3])] {
            let frame = Raw::open(&bytes, format.parse().unwrap()).unwrap().decode().unwrap();
            assert_eq!(frame.samples(), &Samples::U16(vec![65535; 2]), "{format}");
        }
    }

    #[test]
    fn what_does_not_fit_is_told_what_would() {
        let problem = |text: &str, length: usize| Raw::open(&vec![0; length], text.parse().unwrap()).err().unwrap();
        let told = problem("Mono12p:4x2", 16);
        assert!(told.contains("16 bytes, and Mono12p:4x2 takes 12") && told.contains("Mono10 or Mono12 or"), "{told}");
        assert!(problem("Mono8:4x2", 9).contains("another size"));
        for bad in ["", "Mono12p", "Mono12p:", "Mono12p:4", "Mono12p:0x4", "Mono12p:4x-1", "Mono12p:99999999999x1"] {
            assert!(bad.parse::<RawFormat>().unwrap_err().contains("as in Mono12p:2448x2048"), "{bad}");
        }
        assert!("Mono13:4x4".parse::<RawFormat>().unwrap_err().contains("Mono12Packed"));
        assert_eq!("MONO12P:4x2".parse::<RawFormat>().unwrap().to_string(), "Mono12p:4x2");
    }
}
