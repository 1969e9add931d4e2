//! Photographs in: files to [`Frame`]s.
//!
//! PNG, JPEG, TIFF, PNM, PFM, EXR, BMP and WebP, told apart by content, not by name; of a TIFF of several pages the first, or page N
//! where the path is `FILE#N`; frames without a header as `FILE#FORMAT:WxH`. A file is opened and read once, as a [`Photograph`]: its hash, what it says of itself and
//! its pixels are of the same bytes. Files are untrusted: size is checked before any pixel is decoded, and whatever is
//! wrong comes back as [`Error::File`] with the path and what to do. Raw files of cameras are not read, but the error has
//! the command that converts them.

mod camera_raw;
mod check;
mod describe;
mod encoding;
mod exif;
mod frames;
mod openexr;
mod page;
mod pfm;
mod photograph;
mod raster;
mod raw;
mod source;
#[cfg(test)]
mod tests;
mod tiff_page;
mod tiff_samples;
mod turn;
mod values;

use std::path::Path;

pub use check::similar_file;
pub use describe::{Input, pair_warnings};
pub use exif::Exif;
pub use frames::read_frames;
pub use page::split_page;
pub use photograph::Photograph;
pub use raw::RawFormat;
pub use values::{Basis, Values};

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
    Photograph::open(path)?.decode()
}

/// Width and height of a photograph. The whole file is read, but no pixel is decoded.
///
/// # Errors
/// [`Error::File`].
pub fn size(path: &Path) -> Result<(u32, u32), Error> {
    Photograph::open(path).map(|photograph| photograph.size())
}

/// Reads two photographs of one size. Where the sizes differ, no pixel is decoded.
///
/// # Errors
/// [`Error::File`], and [`Error::Mismatch`] with both files and both sizes.
pub fn read_pair(first: &Path, second: &Path) -> Result<(Frame, Frame), Error> {
    let [i1, i2] = Photograph::decode_pair(Photograph::open_pair(first, second)?)?;
    Ok((i1, i2))
}

/// Reads a kernel from a picture of it, such as a coded aperture; a colour picture by its luminance, values as stored.
///
/// # Errors
/// [`Error::File`], also where the picture is no kernel: see [`Aperture::new`].
pub fn read_kernel(path: &Path) -> Result<Kernel, Error> {
    let photograph = Photograph::open(path)?;
    let (width, height) = photograph.size();
    if width.max(height) > MAX_KERNEL_SIDE {
        let problem = format!("is {width}x{height}, and a kernel has at most {MAX_KERNEL_SIDE} a side; reduce it");
        return Err(Error::file(path, problem));
    }
    let picture = photograph.decode()?;
    let densities = ingest::cpu_reference(&picture, Decode::None, LUMINANCE).data;
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
    Photograph::open(path)?.decode_field()
}
