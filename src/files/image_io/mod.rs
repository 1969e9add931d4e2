//! Photographs in: files to [`Frame`]s.
//!
//! PNG, JPEG, TIFF, PNM, PFM and EXR, told apart by content, not by name; of a TIFF of several pages the first, or page N
//! where the path is `FILE#N`. Files are untrusted: size is checked before any pixel is decoded, and whatever is wrong
//! comes back as [`Error::File`] with the path and what to do. Raw files of cameras are not read, but the error has the
//! command that converts them.

mod camera_raw;
mod check;
mod describe;
mod encoding;
mod exif;
mod openexr;
mod page;
mod pfm;
mod raster;
#[cfg(test)]
mod tests;
mod tiff_float;

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

pub use check::similar_file;
pub use describe::{Input, decode_of, describe, pair_warnings};
pub use exif::Exif;
use image::metadata::Orientation;
pub use page::split_page;

use self::page::Paged;
use crate::base::color::LUMINANCE;
use crate::base::{Aperture, Decode, Error, Frame, Kernel};
use crate::engine::stages::ingest;

/// The most pixels that are decoded, 2^28: more than any camera sensor in common use has (150 million), and 1 GiB for
/// a float channel.
pub const MAX_PIXELS: u64 = 1 << 28;

/// The largest side of the picture of a kernel, which is averaged down to 48 cells in any case.
const MAX_KERNEL_SIDE: u32 = 4096;

/// Reads one photograph.
///
/// 8-bit files stay 8-bit, 16-bit stay 16-bit, float (and half) becomes 32-bit float; grey stays grey, palettes become
/// colour. Alpha is dropped and the colour beside it kept as stored: where that is multiplied by alpha, as in EXR, a
/// transparent pixel is black. A rotation recorded by the camera (EXIF, the orientation of a TIFF) is applied.
///
/// # Errors
/// [`Error::File`].
pub fn read(path: &Path) -> Result<Frame, Error> {
    Pending::open(path)?.decode()
}

/// Width and height of a photograph, from its header.
///
/// # Errors
/// [`Error::File`].
pub fn size(path: &Path) -> Result<(u32, u32), Error> {
    Pending::open(path).map(|pending| pending.size)
}

/// Reads two photographs of one size. Where the sizes differ, no pixel is decoded.
///
/// # Errors
/// [`Error::File`], and [`Error::Mismatch`] with both files and both sizes.
pub fn read_pair(first: &Path, second: &Path) -> Result<(Frame, Frame), Error> {
    let (i1, i2) = (Pending::open(first)?, Pending::open(second)?);
    if i1.size != i2.size {
        let ((w1, h1), (w2, h2)) = (i1.size, i2.size);
        return Err(Error::Mismatch(format!(
            "{} is {w1}x{h1} and {} is {w2}x{h2}: both images must have one size; crop or resize one of them",
            first.display(),
            second.display()
        )));
    }
    Ok((i1.decode()?, i2.decode()?))
}

/// Reads a kernel from a picture of it, such as a coded aperture; a colour picture by its luminance, values as stored.
///
/// # Errors
/// [`Error::File`], also where the picture is no kernel: see [`Aperture::new`].
pub fn read_kernel(path: &Path) -> Result<Kernel, Error> {
    let pending = Pending::open(path)?;
    if pending.size.0.max(pending.size.1) > MAX_KERNEL_SIDE {
        let (width, height) = pending.size;
        let problem = format!("is {width}x{height}, and a kernel has at most {MAX_KERNEL_SIDE} a side; reduce it");
        return Err(Error::file(path, problem));
    }
    let picture = pending.decode()?;
    let densities = ingest::twin(&picture, Decode::None, LUMINANCE).data;
    let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy();
    let aperture = Aperture::new(&name, picture.width() as usize, picture.height() as usize, &densities);
    aperture.map(Kernel::Measured).map_err(|e| match e {
        Error::Kernel { problem, .. } => Error::file(path, problem),
        other => other,
    })
}

/// Reads a field of numbers, such as `relative_blur.exr`: an EXR of one channel, in which NaN and infinity are allowed.
/// Width, height and the values, row-major.
///
/// # Errors
/// [`Error::File`].
pub fn read_field(path: &Path) -> Result<(u32, u32, Vec<f32>), Error> {
    let pending = Pending::open(path)?;
    let ((width, height), Source::Exr(exr)) = (pending.size, pending.source) else {
        return Err(Error::file(path, "is no EXR; give the file that parfocal wrote"));
    };
    let values = exr.decode_field().map_err(|problem| Error::file(path, problem))?;
    Ok((width, height, values))
}

/// A file whose header has been read and whose size is allowed.
struct Pending<'a> {
    path: &'a Path,
    size: (u32, u32),
    /// Pages of the file.
    pages: usize,
    source: Source,
}

enum Source {
    Raster(raster::Raster),
    TiffFloat(Box<tiff_float::TiffFloat<BufReader<Paged>>>),
    Pfm(pfm::Pfm<BufReader<File>>),
    // The crate keeps the whole header in place, 4 KiB.
    Exr(Box<openexr::Exr>),
}

impl<'a> Pending<'a> {
    fn open(path: &'a Path) -> Result<Self, Error> {
        let wrap = |problem| Error::file(path, problem);
        let (file, page) = split_page(path);
        let (source, pages) = open_source(&file, page).map_err(wrap)?;
        let size = match &source {
            Source::Raster(s) => s.size(),
            Source::TiffFloat(s) => s.size(),
            Source::Pfm(s) => s.size(),
            Source::Exr(s) => s.size(),
        };
        check::size(size).map_err(wrap)?;
        Ok(Self { path, size, pages, source })
    }

    /// Bits of a stored sample and colour channels, alpha not counted.
    fn bits_and_channels(&self) -> (u32, u32) {
        match &self.source {
            Source::Raster(s) => s.bits_and_channels(),
            Source::TiffFloat(_) => (32, 1),
            Source::Pfm(s) => (32, s.channels().count()),
            Source::Exr(s) => s.bits_and_channels(),
        }
    }

    fn decode(self) -> Result<Frame, Error> {
        match self.source {
            Source::Raster(s) => s.decode(),
            Source::TiffFloat(s) => s.decode(),
            Source::Pfm(s) => s.decode(),
            Source::Exr(s) => s.decode(),
        }
        .map_err(|problem| Error::file(self.path, problem))
    }
}

/// Opens a file with the reader that its first bytes ask for; also how many pages it has.
fn open_source(path: &Path, page: Option<usize>) -> Result<(Source, usize), String> {
    let (file, magic) = check::open(path)?;
    let is_tiff = tiff_float::is_tiff(&magic);
    if let Some(problem) = camera_raw::problem(path, &magic, is_tiff) {
        return Err(problem);
    }
    if is_tiff {
        return open_tiff(path, &magic, page);
    }
    if page.is_some_and(|page| page > 1) {
        return Err("has one page only, for it is no TIFF; leave out what follows the #".to_string());
    }
    let source = if openexr::is_exr(&magic) {
        Source::Exr(Box::new(openexr::Exr::open(BufReader::new(file))?))
    } else if pfm::is_pfm(&magic) {
        Source::Pfm(pfm::Pfm::open(BufReader::new(file))?)
    } else {
        Source::Raster(raster::Raster::open(BufReader::new(file))?)
    };
    Ok((source, 1))
}

fn open_tiff(path: &Path, magic: &[u8], page: Option<usize>) -> Result<(Source, usize), String> {
    let reopen = || File::open(path).map_err(|e| format!("cannot be opened ({e})"));
    let offsets = page::offsets(reopen()?);
    let wanted = page.unwrap_or(1);
    let offset = offsets.get(wanted - 1).copied();
    if offset.is_none() && wanted > 1 {
        return Err(format!("has {} pages and no page {wanted}", offsets.len()));
    }
    let paged = || {
        let file = reopen()?;
        let paged = match offset {
            Some(offset) => Paged::at_page(file, magic, offset),
            None => Paged::whole(file),
        };
        Ok::<_, String>(BufReader::new(paged))
    };
    let source = match tiff_float::TiffFloat::open(paged()?)? {
        Some(float) => Source::TiffFloat(Box::new(float)),
        None => Source::Raster(raster::Raster::open_tiff(paged()?)?),
    };
    Ok((source, offsets.len().max(1)))
}

/// Width and height once a picture is upright.
fn turned((width, height): (u32, u32), orientation: Orientation) -> (u32, u32) {
    match orientation {
        Orientation::Rotate90 | Orientation::Rotate270 | Orientation::Rotate90FlipH | Orientation::Rotate270FlipH => {
            (height, width)
        }
        _ => (width, height),
    }
}
