//! Photographs in the caller's memory, copied to frames.

use std::ffi::{CStr, c_char, c_void};

use parfocal::{
    Frame, PixelFormat,
    frame::{Channels, Depth, Format},
};

use crate::fault::Fault;
use crate::handle::slice;
use crate::settings::one_of;
use crate::sized::{Versioned, read};

/// The type of a sample.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub enum parfocal_depth {
    /// uint8_t, white at 255.
    PARFOCAL_U8 = 0,
    /// uint16_t, white at 65535.
    PARFOCAL_U16 = 1,
    /// float, white at 1.
    PARFOCAL_F32 = 2,
}

/// A photograph: rows of pixels with one sample, or with three (red, green, blue). The call copies it before it returns.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_image {
    /// sizeof(parfocal_image).
    pub size: usize,
    /// The first sample of the first row, aligned for its type.
    pub data: *const c_void,
    /// Pixels per row.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// 1 or 3.
    pub channels: u32,
    /// A parfocal_depth.
    pub depth: u32,
    /// Bytes from the start of one row to the next, a multiple of the sample's size. 0: rows have no gaps.
    pub row_bytes: usize,
    /// GenICam name of a camera's pixel format, for example "Mono12p" or "BayerRG8". channels and depth are then ignored, and
    /// data needs no alignment. Rows that do not end on a byte must have no gaps. NULL: channels and depth apply.
    pub format: *const c_char,
}

// SAFETY: `repr(C)`, integers and pointers, the size first.
unsafe impl Versioned for parfocal_image {
    const NAME: &'static str = "parfocal_image";

    fn start() -> Self {
        let (size, data, format) = (size_of::<Self>(), std::ptr::null(), std::ptr::null());
        Self { size, data, width: 0, height: 0, channels: 1, depth: 0, row_bytes: 0, format }
    }
}

/// Returns width, height and format of an image. Reads no pixels.
///
/// # Safety
/// The C contract holds for `image`.
pub(crate) unsafe fn size_and_format(image: *const parfocal_image, name: &str) -> Result<([u32; 2], Format), Fault> {
    // SAFETY: by the C contract.
    let image = unsafe { read(image) }?;
    // SAFETY: by the C contract.
    if let Some(packed) = unsafe { packed(&image, name) }? {
        return Ok(([image.width, image.height], packed.format()));
    }
    let channels = channels(&image, name)?;
    let depth = one_of(&format!("{name}.depth"), image.depth, &[Depth::U8, Depth::U16, Depth::F32])?;
    Ok(([image.width, image.height], Format { channels, depth }))
}

fn channels(image: &parfocal_image, name: &str) -> Result<Channels, Fault> {
    match image.channels {
        1 => Ok(Channels::Gray),
        3 => Ok(Channels::Rgb),
        n => Err(Fault::argument(format!("{name} has {n} channels: give 1 or 3"))),
    }
}

/// Copies an image to a frame.
///
/// # Safety
/// The C contract holds for `image`.
pub(crate) unsafe fn frame(image: *const parfocal_image, name: &str) -> Result<Frame, Fault> {
    // SAFETY: by the C contract.
    let image = unsafe { read(image) }?;
    // SAFETY: by the C contract.
    if let Some(packed) = unsafe { packed(&image, name) }? {
        // SAFETY: by the C contract the rows have this format.
        return unsafe { unpacked(&image, packed, name) };
    }
    let channels = channels(&image, name)?;
    let depth = one_of(&format!("{name}.depth"), image.depth, &[Depth::U8, Depth::U16, Depth::F32])?;
    let sample = depth.bytes() as usize;
    if !image.data.addr().is_multiple_of(sample) || !image.row_bytes.is_multiple_of(sample) {
        return Err(Fault::argument(format!(
            "{name}: data and row_bytes must be multiples of {sample} bytes, a sample"
        )));
    }
    // SAFETY: by the C contract the rows have samples of this type.
    unsafe { unpacked(&image, Format { channels, depth }.into(), name) }
}

/// Returns the camera's pixel format, if one is stated.
///
/// # Safety
/// `image.format` is NULL or a string.
unsafe fn packed(image: &parfocal_image, name: &str) -> Result<Option<PixelFormat>, Fault> {
    if image.format.is_null() {
        return Ok(None);
    }
    // SAFETY: not NULL, so a string by the caller's guarantee.
    let format = unsafe { CStr::from_ptr(image.format) }.to_string_lossy();
    format.parse().map(Some).map_err(|problem| Fault::argument(format!("{name}.format: {problem}")))
}

/// Reads the frame of a pixel format.
///
/// # Safety
/// `image.data` is NULL, or points to rows of this format with the size that `image` states.
unsafe fn unpacked(image: &parfocal_image, format: PixelFormat, name: &str) -> Result<Frame, Fault> {
    let wrong = |problem: String| Fault::argument(format!("{name}: {problem}"));
    let size = [image.width, image.height];
    let rows = format.rows(size, image.row_bytes).map_err(wrong)?;
    // SAFETY: the caller guarantees the bytes from the start of the first row to the end of the last.
    let bytes = unsafe { slice(image.data.cast::<u8>(), rows.bytes, &format!("{name}.data")) }?;
    if rows.row_bytes == rows.bytes {
        return format.frame(size, bytes).map_err(wrong);
    }
    let unpadded: Vec<u8> = bytes.chunks(rows.pitch).flat_map(|row| &row[..rows.row_bytes]).copied().collect();
    format.frame(size, &unpadded).map_err(wrong)
}

/// Returns the size of a frame's sample in bytes.
pub(crate) fn bytes_per_sample(frame: &Frame) -> usize {
    frame.format().depth.bytes() as usize
}

#[cfg(test)]
mod tests {
    use parfocal::frame::Samples;

    use super::*;

    fn image(data: &[u16], width: u32, height: u32, row_bytes: usize) -> parfocal_image {
        parfocal_image { data: data.as_ptr().cast(), width, height, depth: 1, row_bytes, ..parfocal_image::start() }
    }

    fn read_back(image: parfocal_image) -> Option<Vec<u16>> {
        // SAFETY: the images are within their data, or are refused before it is read.
        let frame = unsafe { frame(&raw const image, "i1") }.ok()?;
        let Samples::U16(samples) = frame.samples() else { return None };
        Some(samples.clone())
    }

    #[test]
    fn camera_frames_are_unpacked() {
        // Two rows of 0x123 0x456, with a gap of one byte.
        let data = [0x23u8, 0x61, 0x45, 0xff, 0x23, 0x61, 0x45];
        let mono = parfocal_image {
            data: data.as_ptr().cast(),
            width: 2,
            height: 2,
            row_bytes: 4,
            format: c"Mono12p".as_ptr(),
            channels: 0,
            ..parfocal_image::start()
        };
        let widened = |v: u32| ((v * 65535 + 2047) / 4095) as u16;
        assert_eq!(read_back(mono), Some([0x123, 0x456, 0x123, 0x456].map(widened).to_vec()));
        // SAFETY: the image describes its data.
        let described = unsafe { size_and_format(&raw const mono, "i1") }.ok();
        assert_eq!(described, Some(([2, 2], Format { channels: Channels::Gray, depth: Depth::U16 })));
    }

    #[test]
    fn gaps_between_rows_are_removed_and_invalid_images_are_refused() {
        let data: Vec<u16> = (0..12).collect();
        assert_eq!(read_back(image(&data, 4, 3, 0)), Some(data.clone()));
        assert_eq!(read_back(image(&data, 2, 3, 8)), Some(vec![0, 1, 4, 5, 8, 9]));
        // The last row needs no gap.
        assert_eq!(read_back(image(&data[..10], 2, 3, 8)), Some(vec![0, 1, 4, 5, 8, 9]));
        for bad in [
            image(&data, 4, 3, 7),
            image(&data, 4, 3, 6),
            image(&data, 0, 3, 0),
            image(&data, u32::MAX, u32::MAX, usize::MAX - 1),
            parfocal_image { data: std::ptr::null(), ..image(&data, 4, 3, 0) },
            parfocal_image { data: data.as_ptr().cast::<u8>().wrapping_add(1).cast(), ..image(&data, 1, 1, 0) },
            parfocal_image { channels: 2, ..image(&data, 4, 3, 0) },
            parfocal_image { depth: 3, ..image(&data, 4, 3, 0) },
            parfocal_image { format: c"Mono13".as_ptr(), ..image(&data, 4, 3, 0) },
            parfocal_image { format: c"Mono12p".as_ptr(), ..image(&data, 3, 3, 6) },
            parfocal_image { format: c"Mono12p".as_ptr(), ..image(&data, 4, 3, 5) },
            parfocal_image { format: c"RGB8".as_ptr(), ..image(&data, 0, 3, 0) },
            parfocal_image { format: c"RGB8".as_ptr(), ..image(&data, u32::MAX, u32::MAX, usize::MAX) },
        ] {
            assert_eq!(read_back(bad), None, "{bad:?}");
        }
    }
}
