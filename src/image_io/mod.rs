//! Photographs in: files to [`Frame`]s.
//!
//! PNG, JPEG, TIFF, PNM and EXR, told apart by content, not by name. Files are untrusted: size is checked before any
//! pixel is decoded, and whatever is wrong comes back as [`Error::File`] with the path and what to do.

mod check;
mod describe;
mod openexr;
mod raster;
#[cfg(test)]
mod tests;
mod tiff_float;

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

pub use check::similar_file;
pub use describe::{Input, describe, pair_warnings};

use crate::stages::ingest;
use crate::{Aperture, Decode, Error, Frame, Kernel};

/// The most pixels that are decoded, 2^28: more than any camera sensor in common use has (150 million), and 1 GiB for
/// a float channel.
pub const MAX_PIXELS: u64 = 1 << 28;

/// The largest side of the picture of a kernel, which is averaged down to 48 cells in any case.
const MAX_KERNEL_SIDE: u32 = 4096;

/// Reads one photograph.
///
/// 8-bit files stay 8-bit, 16-bit stay 16-bit, float (and half) becomes 32-bit float; grey stays grey, palettes become
/// colour, alpha is dropped. A rotation recorded by the camera (EXIF) is applied.
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
    let densities = ingest::twin(&picture, Decode::None, ingest::LUMINANCE).data;
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
    source: Source,
}

enum Source {
    Raster(raster::Raster),
    TiffFloat(Box<tiff_float::TiffFloat>),
    // The crate keeps the whole header in place, 4 KiB.
    Exr(Box<openexr::Exr>),
}

impl<'a> Pending<'a> {
    fn open(path: &'a Path) -> Result<Self, Error> {
        let wrap = |problem| Error::file(path, problem);
        let source = open_source(path).map_err(wrap)?;
        let size = match &source {
            Source::Raster(s) => s.size(),
            Source::TiffFloat(s) => s.size(),
            Source::Exr(s) => s.size(),
        };
        check::size(size).map_err(wrap)?;
        Ok(Self { path, size, source })
    }

    /// Bits of a stored sample and colour channels, alpha not counted.
    fn bits_and_channels(&self) -> (u32, u32) {
        match &self.source {
            Source::Raster(s) => s.bits_and_channels(),
            Source::TiffFloat(_) => (32, 1),
            Source::Exr(s) => s.bits_and_channels(),
        }
    }

    fn decode(self) -> Result<Frame, Error> {
        match self.source {
            Source::Raster(s) => s.decode(),
            Source::TiffFloat(s) => s.decode(),
            Source::Exr(s) => s.decode(),
        }
        .map_err(|problem| Error::file(self.path, problem))
    }
}

/// Opens a file with the reader that its first bytes ask for.
fn open_source(path: &Path) -> Result<Source, String> {
    let (file, magic) = check::open(path)?;
    let reader = BufReader::new(file);
    if openexr::is_exr(magic) {
        return openexr::Exr::open(reader).map(|exr| Source::Exr(Box::new(exr)));
    }
    if tiff_float::is_tiff(magic)
        && let Some(float) = tiff_float::TiffFloat::open(BufReader::new(reopen(path)?))?
    {
        return Ok(Source::TiffFloat(Box::new(float)));
    }
    raster::Raster::open(reader).map(Source::Raster)
}

fn reopen(path: &Path) -> Result<File, String> {
    File::open(path).map_err(|e| format!("cannot be opened ({e})"))
}
