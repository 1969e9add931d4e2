//! A photograph that was brought onto the pixels of another, as a file of its own depth.

use std::io::{Seek, Write};
use std::path::Path;

use super::fused::color_type;
use super::meaning::{INTENSITY, PHOTOGRAPH};
use super::picture::{self, Stored};
use super::{field, write_file};
use crate::base::{Error, Frame, Samples};

/// The ending of the file that holds such a frame: PNG for integers, EXR for floats.
pub fn registered_ending(frame: &Frame) -> &'static str {
    if matches!(frame.samples(), Samples::F32(_)) { "exr" } else { "png" }
}

/// Writes a frame, integers as PNG, floats as EXR; its folder is made if it is missing. On failure an earlier file stays as
/// it was.
///
/// # Errors
/// [`Error::File`].
pub fn write_registered(file: &Path, frame: &Frame) -> Result<(), Error> {
    write_file(file, |w| write(w, frame))
}

fn write(writer: impl Write + Seek, frame: &Frame) -> Result<(), String> {
    let size = (frame.width(), frame.height());
    let channels = frame.format().channels;
    let color = color_type(channels);
    match frame.samples() {
        Samples::U8(bytes) => picture::write(writer, size, color, &Stored::Bytes(bytes), &PHOTOGRAPH),
        Samples::U16(words) => picture::write(writer, size, color, &Stored::Words(words), &PHOTOGRAPH),
        Samples::F32(values) => field::write_image(writer, size, channels, values, &INTENSITY),
    }
}
