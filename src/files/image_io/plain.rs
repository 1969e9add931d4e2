//! Frames of plain samples: PFM, and camera buffers of a stated size and [format](PixelFormat),
//! `FILE#Mono12p:2448x2048`.

use std::fmt;
use std::str::FromStr;

use super::header::{DAMAGED, Header};
use crate::base::{Channels, Depth, Format, Frame, PixelFormat, Samples};

/// Greatest length of a header, bytes: more than two sizes and a scale need.
const MAX_HEADER: usize = 256;

/// A PFM file with a parsed header: three lines of text, then the lowest row first. "Pf" is grey, "PF" colour.
///
/// Format: Debevec, <https://www.pauldebevec.com/Research/HDR/PFM/>. The sign of the scale is the byte order. Its
/// magnitude is ignored, as in other programs.
pub(super) struct Pfm<'a> {
    pub(super) header: Header,
    samples: &'a [u8],
    is_little_endian: bool,
}

/// Whether a file begins like PFM.
pub(super) fn is_pfm(magic: &[u8]) -> bool {
    matches!(magic, [b'P', b'F' | b'f', space, ..] if space.is_ascii_whitespace())
}

impl<'a> Pfm<'a> {
    /// Reads the header.
    pub(super) fn open(mut bytes: &'a [u8]) -> Result<Self, String> {
        let broken =
            || format!("cannot be decoded as PFM (its header is not a width, a height and a scale); {DAMAGED}");
        let mut words: Vec<String> = vec![String::new()];
        // The samples begin one byte of white space after the fourth word.
        for _ in 0..MAX_HEADER {
            let (&byte, rest) = bytes.split_first().ok_or_else(broken)?;
            bytes = rest;
            let in_word = words.last().is_some_and(|word| !word.is_empty());
            match byte {
                space if space.is_ascii_whitespace() && in_word && words.len() == 4 => break,
                space if space.is_ascii_whitespace() && in_word => words.push(String::new()),
                space if space.is_ascii_whitespace() => {}
                other => words.last_mut().into_iter().for_each(|word| word.push(other.into())),
            }
        }
        let [kind, width, height, scale] = <[String; 4]>::try_from(words).map_err(|_| broken())?;
        let size = (width.parse().map_err(|_| broken())?, height.parse().map_err(|_| broken())?);
        let scale: f32 = scale.parse().map_err(|_| broken())?;
        if !scale.is_finite() || scale == 0.0 {
            return Err(broken());
        }
        let channels = if kind == "PF" { Channels::Rgb } else { Channels::Gray };
        let header = Header { format: "PFM", size, depth: Depth::F32, bits: 32, channels, alpha: false, pages: 1 };
        Ok(Self { header, samples: bytes, is_little_endian: scale < 0.0 })
    }

    /// Decodes the pixels.
    pub(super) fn decode(self) -> Result<Frame, String> {
        let Header { size: (width, height), channels, .. } = self.header;
        let row = width as usize * channels.count() as usize;
        let expected = 4 * row as u64 * u64::from(height);
        let found = self.samples.len();
        let bytes = usize::try_from(expected).ok().and_then(|length| self.samples.get(..length));
        let bytes = bytes.ok_or_else(|| format!("the PFM holds {found} of {expected} bytes of samples; {DAMAGED}"))?;
        let number = |b: &[u8]| {
            let b = [b[0], b[1], b[2], b[3]];
            if self.is_little_endian { f32::from_le_bytes(b) } else { f32::from_be_bytes(b) }
        };
        let upright = bytes.chunks_exact(4 * row).rev().flat_map(|row| row.chunks_exact(4));
        Frame::with_holes(width, height, channels, Samples::F32(upright.map(number).collect()))
    }
}

/// Format and size of a frame without a header; as text `Mono12p:2448x2048`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawFormat {
    format: PixelFormat,
    size: [u32; 2],
}

impl FromStr for RawFormat {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let size = |text: &str| {
            let (width, height) = text.split_once(['x', 'X', '×'])?;
            Some([width.trim().parse().ok()?, height.trim().parse().ok()?])
        };
        let parts = text.split_once(':').map(|(name, of)| (name, size(of)));
        let Some((name, Some(size))) = parts.filter(|(_, size)| size.is_none_or(|[w, h]| w > 0 && h > 0)) else {
            return Err("give format and size, as in Mono12p:2448x2048".to_string());
        };
        Ok(Self { format: name.parse()?, size })
    }
}

impl fmt::Display for RawFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}x{}", self.format, self.size[0], self.size[1])
    }
}

impl RawFormat {
    /// Decodes the bytes of a camera's buffer.
    ///
    /// # Errors
    /// A message with the expected number of bytes, or the formats that fit.
    pub fn frame(self, bytes: &[u8]) -> Result<Frame, String> {
        Raw::open(bytes, self)?.decode()
    }

    /// Checks that a frame of this format and size has this number of bytes.
    pub(super) fn check_length(self, found: u64) -> Result<(), String> {
        let expected = self.format.bytes(self.size);
        if found == expected {
            return Ok(());
        }
        let hint = match self.fitting(found).as_slice() {
            [] => "state another size, or take off a header".to_string(),
            fitting => format!("of this size it may be {}", fitting.join(" or ")),
        };
        Err(format!("is of {found} bytes, and {self} takes {expected}; {hint}"))
    }

    /// The formats in which a frame of this size has `length` bytes: one for each number of bits, and one for all
    /// mosaic patterns.
    fn fitting(&self, length: u64) -> Vec<String> {
        let of_patterns =
            |name: &String| !["BayerGR", "BayerGB", "BayerBG"].iter().any(|other| name.starts_with(other));
        let all = PixelFormat::all().filter(|format| format.bytes(self.size) == length);
        all.map(|format| format.to_string()).filter(of_patterns).collect()
    }
}

/// A frame of the right length in bytes.
pub(super) struct Raw<'a> {
    pub(super) header: Header,
    bytes: &'a [u8],
    raw: RawFormat,
}

impl<'a> Raw<'a> {
    /// Checks the length of the bytes.
    pub(super) fn open(bytes: &'a [u8], raw: RawFormat) -> Result<Self, String> {
        raw.check_length(bytes.len() as u64)?;
        let Format { channels, depth } = raw.format.format();
        let (bits, alpha) = (raw.format.bits, raw.format.samples_per_pixel() == 4);
        let header = Header { format: "raw", size: raw.size.into(), depth, bits, channels, alpha, pages: 1 };
        Ok(Self { header, bytes, raw })
    }

    /// Makes the frame.
    pub(super) fn decode(self) -> Result<Frame, String> {
        self.raw.format.frame(self.raw.size, self.bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A 3x2 picture with values that count from the upper left.
    fn file(kind: &str, scale: &str) -> Vec<u8> {
        let channels = if kind == "PF" { 3 } else { 1 };
        let mut bytes = format!("{kind}\n3 2\n{scale}\n").into_bytes();
        for row in [1, 0] {
            for i in 0..3 * channels {
                let value = (row * 3 * channels + i) as f32 / 16.0;
                bytes.extend(if scale.starts_with('-') { value.to_le_bytes() } else { value.to_be_bytes() });
            }
        }
        bytes
    }

    #[test]
    fn both_byte_orders_are_read_from_the_bottom_up() {
        for (kind, channels) in [("PF", Channels::Rgb), ("Pf", Channels::Gray)] {
            for scale in ["-1.0", "1.0", "-0.5", "2"] {
                let bytes = file(kind, scale);
                assert!(is_pfm(&bytes));
                let frame = Pfm::open(bytes.as_slice()).unwrap().decode().unwrap();
                let values = (0..6 * channels.count()).map(|i| i as f32 / 16.0).collect();
                assert_eq!(frame, Frame::new(3, 2, channels, Samples::F32(values)).unwrap());
            }
        }
    }

    #[test]
    fn other_files_are_refused() {
        let whole = file("Pf", "-1");
        for length in 0..whole.len() {
            let cut = Pfm::open(&whole[..length]).and_then(Pfm::decode);
            assert!(cut.unwrap_err().contains("damaged"), "{length}");
        }
        for text in ["Pf\n-3 2\n1\n", "Pf 3 2 0\n", "Pf 3 2 nan\n", "Pf\n99999999999 1\n1\n"] {
            assert!(Pfm::open(text.as_bytes()).is_err(), "{text}");
        }
        let huge = Pfm::open(&b"Pf 4000000000 4000000000 1\n"[..]).unwrap();
        assert_eq!(huge.header.size, (4_000_000_000, 4_000_000_000));
    }

    #[test]
    fn a_wrong_length_is_refused_with_the_formats_that_fit() {
        let problem = |text: &str, length: usize| Raw::open(&vec![0; length], text.parse().unwrap()).err().unwrap();
        let message = problem("Mono12p:4x2", 16);
        assert!(
            message.contains("16 bytes, and Mono12p:4x2 takes 12") && message.contains("Mono10 or Mono12 or"),
            "{message}"
        );
        assert!(problem("Mono8:4x2", 9).contains("another size"));
        for bad in ["", "Mono12p", "Mono12p:", "Mono12p:4", "Mono12p:0x4", "Mono12p:4x-1", "Mono12p:99999999999x1"] {
            assert!(bad.parse::<RawFormat>().unwrap_err().contains("as in Mono12p:2448x2048"), "{bad}");
        }
        assert!("Mono13:4x4".parse::<RawFormat>().unwrap_err().contains("Mono12Packed"));
        assert_eq!("MONO12P:4x2".parse::<RawFormat>().unwrap().to_string(), "Mono12p:4x2");
        assert_eq!("bayerrg12p:4x2".parse::<RawFormat>().unwrap().frame(&[0; 12]).unwrap().bytes().len(), 48);
    }
}
