//! Frames of a camera without a header, of a size and a [format](PixelFormat) that are stated with the name: `FILE#Mono12p:2448x2048`.

use std::fmt;
use std::str::FromStr;

use crate::base::{Depth, Frame, PixelFormat};

/// Format and size of a frame that does not state them itself; as text `Mono12p:2448x2048`.
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
    /// The frame that these bytes are, as those of a camera's buffer.
    ///
    /// # Errors
    /// Says how many bytes there should be, or what format they may have.
    pub fn frame(self, bytes: &[u8]) -> Result<Frame, String> {
        Raw::open(bytes, self)?.decode()
    }

    /// The formats in which a frame of this size takes so many bytes, one for each of the same bits, and of mosaics one of all patterns.
    fn fitting(&self, length: u64) -> Vec<String> {
        let of_patterns =
            |name: &String| !["BayerGR", "BayerGB", "BayerBG"].iter().any(|other| name.starts_with(other));
        let all = PixelFormat::all().filter(|format| format.bytes(self.size) == length);
        all.map(|format| format.to_string()).filter(of_patterns).collect()
    }
}

/// A frame whose length has been checked.
pub(super) struct Raw<'a> {
    bytes: &'a [u8],
    raw: RawFormat,
}

impl<'a> Raw<'a> {
    /// Checks the length.
    pub(super) fn open(bytes: &'a [u8], raw: RawFormat) -> Result<Self, String> {
        let (found, expected) = (bytes.len() as u64, raw.format.bytes(raw.size));
        if found == expected {
            return Ok(Self { bytes, raw });
        }
        let hint = match raw.fitting(found).as_slice() {
            [] => "state another size, or take off a header".to_string(),
            fitting => format!("of this size it may be {}", fitting.join(" or ")),
        };
        Err(format!("is of {found} bytes, and {raw} takes {expected}; {hint}"))
    }

    pub(super) fn size(&self) -> (u32, u32) {
        self.raw.size.into()
    }

    pub(super) fn bits_and_channels(&self) -> (u32, u32) {
        (self.raw.format.bits, self.raw.format.format().channels.count())
    }

    pub(super) fn has_alpha(&self) -> bool {
        self.raw.format.samples_per_pixel() == 4
    }

    pub(super) fn depth(&self) -> Depth {
        self.raw.format.format().depth
    }

    /// The frame.
    pub(super) fn decode(self) -> Result<Frame, String> {
        self.raw.format.frame(self.raw.size, self.bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        assert_eq!("bayerrg12p:4x2".parse::<RawFormat>().unwrap().frame(&[0; 12]).unwrap().bytes().len(), 48);
    }
}
