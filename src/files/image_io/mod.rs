//! Photographs: files that are read as [`Frame`]s.
//!
//! The formats are PNG, JPEG, TIFF, PNM, PFM, EXR, BMP and WebP, detected by content. `FILE#N` is page N of a TIFF, and
//! `FILE#FORMAT:WxH` a frame without a header. A file is read once, as a [`Photograph`]: hash, metadata and pixels come
//! from the same bytes. Files are untrusted: the size is checked before any pixel is decoded. Errors are
//! [`Error::File`] with the path and advice. Raw files of cameras are not read; the error names the command that
//! converts them.

mod curve;
mod foreign;
mod header;
mod input;
mod metadata;
mod openexr;
mod page_stack;
mod photograph;
mod plain;
mod raster;
mod similar_file;
mod source;
#[cfg(test)]
mod tests;
mod tiff_directory;
mod tiff_page;
mod tone;

use std::path::Path;

use image::{Rgb, RgbImage};

pub(crate) use curve::Curve;
pub use foreign::foreign_problem;
pub use header::MAX_PIXELS;
pub use input::{Basis, Input, Values, pair_warnings};
pub use metadata::{Carried, Exif};
pub use page_stack::PageStack;
pub(crate) use photograph::NamedChannels;
pub use photograph::{Photograph, read_frames};
pub use plain::RawFormat;
pub use similar_file::similar_file;
pub use source::split_page;
pub use tone::Tone;

use crate::base::color::LUMINANCE;
use crate::base::{Aperture, Channels, Decode, Error, Frame, Kernel, Samples};
use crate::engine::stages::ingest;

/// Longest side of the picture of a kernel, px. The picture is averaged down to 48 cells.
const MAX_KERNEL_SIDE: u32 = 4096;

/// Reads one photograph.
///
/// 8-bit and 16-bit samples stay as they are, float and half become 32-bit float; palettes become colour. Pixels of
/// PNG and TIFF whose alpha is below a half are not part of the picture, unless all are; other alpha is dropped. A rotation
/// that the camera recorded (EXIF, or the orientation of a TIFF) is applied.
///
/// # Errors
/// [`Error::File`].
pub fn read(path: &Path) -> Result<Frame, Error> {
    Photograph::open(path)?.decode()
}

/// Width and height of a photograph. The whole file is read, and no pixel is decoded.
///
/// # Errors
/// [`Error::File`].
pub fn size(path: &Path) -> Result<(u32, u32), Error> {
    Photograph::open(path).map(|photograph| photograph.size())
}

/// Reads two photographs of one size. If the sizes differ, no pixel is decoded.
///
/// # Errors
/// [`Error::File`], and [`Error::Mismatch`] with both files and both sizes.
pub fn read_pair(first: &Path, second: &Path) -> Result<(Frame, Frame), Error> {
    let [i1, i2] = Photograph::decode_pair(Photograph::open_pair(first, second)?)?;
    Ok((i1, i2))
}

/// Reads a kernel from its picture, such as a coded aperture. A colour picture is read as luminance; values are as
/// stored.
///
/// # Errors
/// [`Error::File`], also if the picture is not a kernel; see [`Aperture::new`].
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

/// Reads a field, such as `relative_blur.exr`: an EXR of one channel, which may hold NaN and infinity. Returns width,
/// height and the values, row-major.
///
/// # Errors
/// [`Error::File`].
pub fn read_field(path: &Path) -> Result<(u32, u32, Vec<f32>), Error> {
    Photograph::open(path)?.decode_field()
}

/// Reads channels of an EXR by their names, and its comments.
///
/// # Errors
/// [`Error::File`].
pub(crate) fn read_channels(path: &Path, names: &[&str]) -> Result<NamedChannels, Error> {
    Photograph::open(path)?.decode_channels(names)
}

/// Converts a photograph to 8-bit RGB, for display, in the range of its own values.
pub(crate) fn preview(frame: &Frame) -> RgbImage {
    preview_in(frame, Tone::of(frame))
}

/// Converts a photograph to 8-bit RGB, for display, in a range of stored values.
pub(crate) fn preview_in(frame: &Frame, tone: Tone) -> RgbImage {
    let byte = |v: f32| (255.0 * tone.shown(v)).round() as u8;
    let bytes: Vec<u8> = match frame.samples() {
        Samples::U8(s) if tone == Tone::default() => s.clone(),
        Samples::U8(s) => s.iter().map(|&v| byte(f32::from(v) / 255.0)).collect(),
        Samples::U16(s) => s.iter().map(|&v| byte(f32::from(v) / 65535.0)).collect(),
        Samples::F32(s) => s.iter().map(|&v| byte(v)).collect(),
    };
    let count = frame.format().channels.count() as usize;
    let mut pixels = bytes.chunks_exact(count);
    RgbImage::from_fn(frame.width(), frame.height(), |_, _| match (frame.format().channels, pixels.next()) {
        (Channels::Rgb, Some(&[r, g, b])) => Rgb([r, g, b]),
        (_, Some(&[v, ..])) => Rgb([v; 3]),
        _ => Rgb([0; 3]),
    })
}
