//! The reader that the first bytes of a file ask for.

use super::openexr::{self, Exr};
use super::page::Selected;
use super::pfm::{self, Pfm};
use super::raster::Raster;
use super::raw::Raw;
use super::tiff_page::{self, TiffPage};
use super::{Exif, encoding, exif};
use crate::base::{Depth, Frame};

/// The largest TIFF in which EXIF is looked for, 1 GiB, since it is copied for that.
const MAX_TIFF: usize = 1 << 30;

/// The bytes of a file of which the header has been read.
pub(super) enum Source<'a> {
    Raster(Raster<'a>),
    Tiff(Box<TiffPage<'a>>),
    Pfm(Pfm<'a>),
    Raw(Raw<'a>),
    // The crate keeps the whole header in place, 4 KiB.
    Exr(Box<Exr<'a>>),
}

impl<'a> Source<'a> {
    /// Reads the header; of a TIFF that of a page, from 1.
    pub(super) fn open(bytes: &'a [u8], selected: &Selected) -> Result<Self, String> {
        if let Some(format) = selected.raw {
            return Ok(Self::Raw(Raw::open(bytes, format)?));
        }
        let page = selected.page;
        if tiff_page::is_tiff(bytes) {
            return Ok(Self::Tiff(Box::new(TiffPage::open(bytes, page)?)));
        }
        if page.is_some_and(|page| page > 1) {
            return Err("has one page only, for it is no TIFF; leave out what follows the #".to_string());
        }
        Ok(if openexr::is_exr(bytes) {
            Self::Exr(Box::new(Exr::open(bytes)?))
        } else if pfm::is_pfm(bytes) {
            Self::Pfm(Pfm::open(bytes)?)
        } else {
            Self::Raster(Raster::open(bytes)?)
        })
    }

    /// The format's name.
    pub(super) fn format(&self) -> &'static str {
        match self {
            Self::Raster(s) => s.format(),
            Self::Tiff(_) => "TIFF",
            Self::Pfm(_) => "PFM",
            Self::Raw(_) => "raw",
            Self::Exr(_) => "EXR",
        }
    }

    /// Width and height once the camera's rotation is applied.
    pub(super) fn size(&self) -> (u32, u32) {
        match self {
            Self::Raster(s) => s.size(),
            Self::Tiff(s) => s.size(),
            Self::Pfm(s) => s.size(),
            Self::Raw(s) => s.size(),
            Self::Exr(s) => s.size(),
        }
    }

    /// Pages of the file.
    pub(super) fn pages(&self) -> usize {
        if let Self::Tiff(s) = self { s.pages() } else { 1 }
    }

    /// How a sample is stored once it is decoded.
    pub(super) fn depth(&self) -> Depth {
        match self {
            Self::Raster(s) if s.bits_and_channels().0 == 16 => Depth::U16,
            Self::Raster(_) => Depth::U8,
            Self::Tiff(s) => s.depth(),
            Self::Raw(s) => s.depth(),
            Self::Pfm(_) | Self::Exr(_) => Depth::F32,
        }
    }

    /// Bits of a stored sample and colour channels, alpha not counted.
    pub(super) fn bits_and_channels(&self) -> (u32, u32) {
        match self {
            Self::Raster(s) => s.bits_and_channels(),
            Self::Tiff(s) => s.bits_and_channels(),
            Self::Pfm(s) => (32, s.channels().count()),
            Self::Raw(s) => s.bits_and_channels(),
            Self::Exr(s) => s.bits_and_channels(),
        }
    }

    /// Whether there is an alpha channel, which is dropped.
    pub(super) fn has_alpha(&self) -> bool {
        match self {
            Self::Raster(s) => s.has_alpha(),
            Self::Tiff(s) => s.has_alpha(),
            Self::Raw(s) => s.has_alpha(),
            Self::Pfm(_) => false,
            Self::Exr(s) => s.has_alpha(),
        }
    }

    /// What the file, whose bytes these are, says of its values and of the lens.
    pub(super) fn said(&mut self, bytes: &[u8]) -> (Option<String>, Option<Exif>) {
        let (data, profile) = match self {
            Self::Exr(_) | Self::Pfm(_) => return (Some(encoding::LINEAR.to_string()), None),
            Self::Raw(_) => return (None, None),
            Self::Raster(s) => s.metadata(),
            // A TIFF is itself such a structure as EXIF is.
            Self::Tiff(s) => ((bytes.len() <= MAX_TIFF).then(|| bytes.to_vec()), s.profile()),
        };
        let (exif, is_srgb) = data.map_or((None, false), exif::parse);
        let by_exif = is_srgb.then(|| encoding::SRGB.to_string());
        let by_chunks = || if self.format() == "PNG" { encoding::of_png(bytes) } else { None };
        let by_profile = profile.and_then(|profile| encoding::of_icc(&profile));
        (by_profile.or_else(by_chunks).or(by_exif), exif)
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
