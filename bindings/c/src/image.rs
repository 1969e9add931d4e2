//! Photographs in the caller's memory.

use std::ffi::{CStr, c_char, c_void};

use parfocal::{
    Frame, PixelFormat,
    frame::{Channels, Depth, Format},
};

use crate::fault::Fault;
use crate::handle::slice;
use crate::settings::one_of;
use crate::sized::{Versioned, read};

/// How a sample is stored.
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

/// A photograph: rows of pixels of one sample or of three, red, green, blue. It is copied before the call returns.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_image {
    /// sizeof(parfocal_image).
    pub size: usize,
    /// The first sample of the first row, aligned as a sample is.
    pub data: *const c_void,
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// 1 or 3.
    pub channels: u32,
    /// A parfocal_depth.
    pub depth: u32,
    /// From the start of a row to that of the next, a multiple of a sample; 0 where rows follow one another without a gap.
    pub row_bytes: usize,
    /// How a camera packs pixels, by GenICam's name, such as "Mono12p" or "BayerRG8": then channels and depth say nothing, data needs not
    /// be aligned, and rows that are not whole bytes have no gaps. NULL: as channels and depth say.
    pub format: *const c_char,
}

// SAFETY: integers and a pointer, the size first.
unsafe impl Versioned for parfocal_image {
    const NAME: &'static str = "parfocal_image";

    fn start() -> Self {
        let (size, data, format) = (size_of::<Self>(), std::ptr::null(), std::ptr::null());
        Self { size, data, width: 0, height: 0, channels: 1, depth: 0, row_bytes: 0, format }
    }
}

/// The width and height of photographs such as this, and what their samples are; pixels are not read.
///
/// # Safety
/// `image` is NULL, or as the header describes it.
pub(crate) unsafe fn kind(image: *const parfocal_image, name: &str) -> Result<([u32; 2], Format), Fault> {
    // SAFETY: the contract is the same.
    let image = unsafe { read(image) }?;
    // SAFETY: the contract is the same.
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
        n => Err(Fault::argument(format!("{name} has {n} channels: parfocal takes 1 or 3"))),
    }
}

/// Copies a photograph.
///
/// # Safety
/// `image` is NULL, or as the header describes it.
pub(crate) unsafe fn frame(image: *const parfocal_image, name: &str) -> Result<Frame, Fault> {
    // SAFETY: the contract is the same.
    let image = unsafe { read(image) }?;
    // SAFETY: the contract is the same.
    if let Some(packed) = unsafe { packed(&image, name) }? {
        // SAFETY: the header asks for rows of such pixels.
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
    // SAFETY: the header asks for rows of such pixels.
    unsafe { unpacked(&image, Format { channels, depth }.into(), name) }
}

/// How a camera packs its pixels, if that is said.
///
/// # Safety
/// `image.format` is NULL or a string.
unsafe fn packed(image: &parfocal_image, name: &str) -> Result<Option<PixelFormat>, Fault> {
    if image.format.is_null() {
        return Ok(None);
    }
    // SAFETY: the contract is the same.
    let format = unsafe { CStr::from_ptr(image.format) }.to_string_lossy();
    format.parse().map(Some).map_err(|problem| Fault::argument(format!("{name}.format: {problem}")))
}

/// Reads the frame of a pixel format.
///
/// # Safety
/// `image.data` is NULL, or begins rows of pixels of this format as `image` says.
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

/// How a frame's samples are stored.
pub(crate) fn bytes_a_sample(frame: &Frame) -> usize {
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
        // SAFETY: the tests' images lie within their data, or are refused before it is read.
        let frame = unsafe { frame(&raw const image, "i1") }.ok()?;
        let Samples::U16(samples) = frame.samples() else { return None };
        Some(samples.clone())
    }

    #[test]
    fn what_a_camera_packs_is_unpacked() {
        // Two rows of 0x123 0x456, and a gap of a byte.
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
        // SAFETY: the image is as it says.
        let kind = unsafe { kind(&raw const mono, "i1") }.ok();
        assert_eq!(kind, Some(([2, 2], Format { channels: Channels::Gray, depth: Depth::U16 })));
    }

    #[test]
    fn gaps_between_rows_are_left_out_and_what_is_no_image_is_refused() {
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
