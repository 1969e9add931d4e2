//! The reader of a photograph file. Its first bytes select the format, its name the page or raw format.

use std::path::{Path, PathBuf};

use image::metadata::Orientation;

use super::curve::LINEAR;
use super::header::Header;
use super::metadata::Metadata;
use super::openexr::{Exr, is_exr};
use super::plain::{Pfm, Raw, RawFormat, is_pfm};
use super::raster::Raster;
use super::tiff_page::{TiffPage, is_tiff};
use crate::base::Frame;

/// A file, and the page or raw format that its name selects.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Selected {
    pub(super) file: PathBuf,
    /// Page of a TIFF, from 1.
    pub(super) page: Option<usize>,
    pub(super) raw: Option<RawFormat>,
    /// Whether only this page is read of a TIFF with one directory for all.
    pub(super) is_cut: bool,
}

impl Selected {
    /// Parses `FILE`, `FILE#N` or `FILE#FORMAT:WxH`. A path that names neither page nor format, or that is an existing
    /// file, is used unchanged.
    ///
    /// # Errors
    /// A message if the text after # begins like a format but is not one.
    pub(super) fn of(path: &Path) -> Result<Self, String> {
        let whole = Self { file: path.to_path_buf(), page: None, raw: None, is_cut: false };
        let Some((file, after)) = path.to_str().and_then(|text| text.rsplit_once('#')) else { return Ok(whole) };
        if file.is_empty() || path.exists() {
            return Ok(whole);
        }
        let file = PathBuf::from(file);
        match (after.parse(), after.parse::<RawFormat>()) {
            (Ok(page), _) if page > 0 => Ok(Self { file, page: Some(page), ..whole }),
            (_, Ok(raw)) => Ok(Self { file, raw: Some(raw), ..whole }),
            (_, Err(problem)) if after.to_lowercase().starts_with("mono") => Err(format!("#{after}: {problem}")),
            _ => Ok(whole),
        }
    }
}

/// Splits `FILE#N` into the file and the page, from 1, and `FILE#FORMAT:WxH` into the file and no page. A path that
/// names neither, or that is an existing file, is returned unchanged.
pub fn split_page(path: &Path) -> (PathBuf, Option<usize>) {
    Selected::of(path).map_or_else(|_| (path.to_path_buf(), None), |selected| (selected.file, selected.page))
}

/// Largest TIFF from which EXIF is read, 1 GiB, since it is copied.
const MAX_TIFF: usize = 1 << 30;

/// A copy; `None` if there is no memory for it.
fn copied(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut copy = Vec::new();
    copy.try_reserve_exact(bytes.len()).ok()?;
    copy.extend_from_slice(bytes);
    Some(copy)
}

/// A reader of one format with a parsed header.
pub(super) enum Source<'a> {
    Raster(Raster<'a>),
    Tiff(Box<TiffPage<'a>>),
    Pfm(Pfm<'a>),
    Raw(Raw<'a>),
    // The crate's header is boxed, since it takes 4 KiB.
    Exr(Box<Exr<'a>>),
}

impl<'a> Source<'a> {
    /// Parses the header; for a TIFF, that of the selected page.
    pub(super) fn open(bytes: &'a [u8], selected: &Selected) -> Result<Self, String> {
        if let Some(format) = selected.raw {
            return Ok(Self::Raw(Raw::open(bytes, format)?));
        }
        let page = selected.page;
        if is_tiff(bytes) {
            return Ok(Self::Tiff(Box::new(TiffPage::open(bytes, page, selected.is_cut)?)));
        }
        if page.is_some_and(|page| page > 1) {
            return Err("has one page only, for it is no TIFF; leave out what follows the #".to_string());
        }
        Ok(if is_exr(bytes) {
            Self::Exr(Box::new(Exr::open(bytes)?))
        } else if is_pfm(bytes) {
            Self::Pfm(Pfm::open(bytes)?)
        } else {
            Self::Raster(Raster::open(bytes)?)
        })
    }

    pub(super) fn header(&self) -> &Header {
        match self {
            Self::Raster(s) => &s.header,
            Self::Tiff(s) => &s.header,
            Self::Pfm(s) => &s.header,
            Self::Raw(s) => &s.header,
            Self::Exr(s) => &s.header,
        }
    }

    /// How the pixels are turned after decoding, as the file states at first; `None` if its format does not state it.
    pub(super) fn orientation(&mut self) -> Option<&mut Orientation> {
        match self {
            Self::Raster(s) => Some(&mut s.orientation),
            Self::Tiff(s) => Some(&mut s.layout.orientation),
            _ => None,
        }
    }

    /// The header, and the number of bytes that all layers of an EXR take without compression.
    pub(super) fn header_and_length(&self) -> (Header, Option<u64>) {
        (self.header().clone(), if let Self::Exr(s) = self { Some(s.length()) } else { None })
    }

    /// The metadata that the file states. `bytes` is the whole file.
    pub(super) fn metadata(&mut self, bytes: &[u8]) -> Metadata {
        let (exif, profile) = match self {
            Self::Exr(_) | Self::Pfm(_) => {
                return Metadata { encoding: Some(LINEAR.to_string()), ..Metadata::default() };
            }
            Self::Raw(_) => return Metadata::default(),
            Self::Raster(s) => s.metadata(),
            // EXIF is a TIFF structure.
            Self::Tiff(s) => (if bytes.len() <= MAX_TIFF { copied(bytes) } else { None }, s.profile.take()),
        };
        Metadata::of(exif, profile, self.header().format, bytes)
    }

    /// Decodes the pixels.
    pub(super) fn decode(self) -> Result<Frame, String> {
        match self {
            Self::Raster(s) => s.decode(),
            Self::Tiff(s) => s.decode(),
            Self::Pfm(s) => s.decode(),
            Self::Raw(s) => s.decode(),
            Self::Exr(s) => s.decode(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_may_end_with_a_page_or_a_format() {
        let of = |text: &str| Selected::of(Path::new(text)).map(|s| (s.file.display().to_string(), s.page, s.raw));
        assert_eq!(of("a.tif#2").unwrap(), ("a.tif".to_string(), Some(2), None));
        let raw = "Mono12p:4x2".parse().unwrap();
        assert_eq!(of("a.raw#Mono12p:4x2").unwrap(), ("a.raw".to_string(), None, Some(raw)));
        for other in ["a.png", "#2", "a#b", "a#0"] {
            assert_eq!(of(other).unwrap().0, other);
        }
        assert!(of("a.raw#Mono13:4x2").unwrap_err().contains("'Mono13'"));
    }
}
