//! Frames without a header, of a stated size and [format](PixelFormat), `FILE#Mono12p:2448x2048`; camera raw files.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use super::tiff_page::is_tiff;
use crate::base::{Depth, Frame, PixelFormat};

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
    bytes: &'a [u8],
    raw: RawFormat,
}

impl<'a> Raw<'a> {
    /// Checks the length of the bytes.
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

    /// Makes the frame.
    pub(super) fn decode(self) -> Result<Frame, String> {
        self.raw.format.frame(self.raw.size, self.bytes)
    }
}

/// Magic bytes of raw files: their offset, the bytes, and the format.
const BEGINNINGS: [(usize, &[u8], &str); 9] = [
    (8, b"CR", "Canon CR2"),
    (4, b"ftypcrx", "Canon CR3"),
    (0, b"FUJIFILMCCD-RAW", "Fujifilm RAF"),
    (0, b"IIRO", "Olympus ORF"),
    (0, b"IIRS", "Olympus ORF"),
    (0, b"MMOR", "Olympus ORF"),
    (0, b"IIU\0", "Panasonic RW2"),
    (0, b"FOVb", "Sigma X3F"),
    (0, b"\0MRM", "Minolta MRW"),
];

/// Raw files that begin like TIFF, by their extension.
const TIFF_ENDINGS: [(&str, &str); 10] = [
    ("nef", "Nikon NEF"),
    ("nrw", "Nikon NRW"),
    ("arw", "Sony ARW"),
    ("sr2", "Sony SR2"),
    ("dng", "DNG"),
    ("pef", "Pentax PEF"),
    ("srw", "Samsung SRW"),
    ("3fr", "Hasselblad 3FR"),
    ("iiq", "Phase One IIQ"),
    ("erf", "Epson ERF"),
];

/// Advice for a camera raw file; `None` for another file.
pub(super) fn camera_raw_problem(path: &Path, start: &[u8]) -> Option<String> {
    let is_tiff = is_tiff(start);
    let begins = |(at, what, _): &&(usize, &[u8], &str)| {
        // "CR" at byte 8 has a meaning only in a TIFF.
        start.get(*at..).is_some_and(|rest| rest.starts_with(what)) && (*what != b"CR" || is_tiff)
    };
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase()).unwrap_or_default();
    let by_ending = || TIFF_ENDINGS.iter().find(|(e, _)| is_tiff && *e == ending).map(|(_, name)| *name);
    let name = BEGINNINGS.iter().find(begins).map(|(_, _, name)| *name).or_else(by_ending)?;
    let file = path.display();
    let tiff = path.with_extension("tiff");
    Some(format!(
        "is a raw file ({name}), which is not read: convert both photographs alike and linearly, as `dcraw -4 -T -w -o 0 \
         '{file}'` does, which writes '{}' (newer cameras: `dcraw_emu` of LibRaw, with the same options)",
        tiff.display()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn camera_raw_files_are_distinguished_from_pictures() {
        for (name, start, expected) in [
            ("a.CR2", &b"II*\0\x10\0\0\0CR\x02\0"[..], Some("Canon CR2")),
            ("a.cr3", b"\0\0\0\x18ftypcrx \0\0\0\0", Some("Canon CR3")),
            ("a.RAF", b"FUJIFILMCCD-RAW 0201", Some("Fujifilm RAF")),
            ("a.NEF", b"MM\0*\0\0\0\x08", Some("Nikon NEF")),
            ("a.dng", b"II*\0\x08\0\0\0", Some("DNG")),
            ("noending", b"IIU\0\x08\0\0\0", Some("Panasonic RW2")),
            ("a.tif", b"II*\0\x08\0\0\0", None),
            ("a.nef", b"\x89PNG\r\n\x1a\n", None),
            ("a.png", b"\x89PNG\r\n\x1a\nCR", None),
        ] {
            let problem = camera_raw_problem(Path::new(name), start);
            assert_eq!(problem.is_some(), expected.is_some(), "{name}: {problem:?}");
            let problem = problem.unwrap_or_default();
            assert!(problem.contains(expected.unwrap_or_default()), "{problem}");
            assert!(problem.is_empty() || problem.contains(&format!("dcraw -4 -T -w -o 0 '{name}'")), "{problem}");
        }
    }
}
