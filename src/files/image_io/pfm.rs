//! PFM: 32-bit floats behind three lines of text, grey ("Pf") or colour ("PF"), the lowest row first.
//!
//! Format: Debevec, <https://www.pauldebevec.com/Research/HDR/PFM/>. The sign of the scale is the byte order. Its
//! magnitude is ignored, as in other programs.

use super::check::DAMAGED;
use crate::base::{Channels, Frame, Samples};

/// Greatest length of a header, bytes: more than two sizes and a scale need.
const MAX_HEADER: usize = 256;

/// A PFM file with a parsed header.
pub(super) struct Pfm<'a> {
    samples: &'a [u8],
    size: (u32, u32),
    channels: Channels,
    little_endian: bool,
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
        Ok(Self { samples: bytes, size, channels, little_endian: scale < 0.0 })
    }

    /// Width and height.
    pub(super) fn size(&self) -> (u32, u32) {
        self.size
    }

    /// Grey or colour.
    pub(super) fn channels(&self) -> Channels {
        self.channels
    }

    /// Decodes the pixels.
    pub(super) fn decode(self) -> Result<Frame, String> {
        let (width, height) = self.size;
        let row = width as usize * self.channels.count() as usize;
        let expected = 4 * row as u64 * u64::from(height);
        let found = self.samples.len();
        let bytes = usize::try_from(expected).ok().and_then(|length| self.samples.get(..length));
        let bytes = bytes.ok_or_else(|| format!("the PFM holds {found} of {expected} bytes of samples; {DAMAGED}"))?;
        let number = |b: &[u8]| {
            let b = [b[0], b[1], b[2], b[3]];
            if self.little_endian { f32::from_le_bytes(b) } else { f32::from_be_bytes(b) }
        };
        let upright = bytes.chunks_exact(4 * row).rev().flat_map(|row| row.chunks_exact(4));
        Frame::new(width, height, self.channels, Samples::F32(upright.map(number).collect()))
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
        assert_eq!(huge.size(), (4_000_000_000, 4_000_000_000));
    }
}
