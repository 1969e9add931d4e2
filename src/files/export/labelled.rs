//! `frames.png` and `beyond.png` of a sweep: a number at each pixel.

use std::io::Write;
use std::path::Path;

use png::ColorType;

use super::meaning;
use super::picture::{self, Stored};
use crate::base::{Error, Samples};
use crate::files::image_io;
use crate::solve::sweep::Sweep;

/// The frame that each pixel of the fused image is taken from, counted from 1: 8-bit grey, of more than 255 frames 16-bit.
pub(super) fn write_frames(writer: impl Write, sweep: &Sweep) -> Result<(), String> {
    let size = (sweep.width, sweep.height);
    let bytes: Result<Vec<u8>, _> = sweep.frames.iter().map(|frame| u8::try_from(*frame)).collect();
    let stored = bytes.as_ref().map_or(Stored::Words(&sweep.frames), |bytes| Stored::Bytes(bytes));
    picture::write(writer, size, ColorType::Grayscale, &stored, &meaning::FRAMES)
}

/// 1 before the first frame, 2 beyond the last, else 0: 8-bit grey.
pub(super) fn write_beyond(writer: impl Write, sweep: &Sweep) -> Result<(), String> {
    let bytes: Vec<u8> = sweep.beyond.iter().map(|side| if *side < 0 { 1 } else { 2 * u8::from(*side > 0) }).collect();
    picture::write(writer, (sweep.width, sweep.height), ColorType::Grayscale, &Stored::Bytes(&bytes), &meaning::BEYOND)
}

/// The sides as [`write_beyond`] wrote them, and width and height.
///
/// # Errors
/// [`Error::File`]: it cannot be read, or is none.
pub(super) fn read_beyond(path: &Path) -> Result<([u32; 2], Vec<i8>), Error> {
    let picture = image_io::read(path)?;
    let Samples::U8(bytes) = picture.samples() else {
        return Err(Error::file(path, "has no numbers of 8 bits; solve the sweep again"));
    };
    let sides = bytes.iter().map(|byte| i8::from(*byte == 2) - i8::from(*byte == 1)).collect();
    Ok(([picture.width(), picture.height()], sides))
}
