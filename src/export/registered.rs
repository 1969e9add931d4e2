//! A photograph that was brought onto the pixels of another, as a file of its own depth.

use std::io::{Seek, Write};
use std::path::Path;

use exr::prelude::{Image, SpecificChannels, WritableImage};
use image::ExtendedColorType;

use super::{field, fused, write_file};
use crate::{Channels, Error, Frame, Samples};

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
    let gray = frame.format().channels == Channels::Gray;
    match frame.samples() {
        Samples::U8(_) => {
            let kind = if gray { ExtendedColorType::L8 } else { ExtendedColorType::Rgb8 };
            fused::png(writer, frame.bytes(), size, kind)
        }
        Samples::U16(_) => {
            let kind = if gray { ExtendedColorType::L16 } else { ExtendedColorType::Rgb16 };
            fused::png(writer, frame.bytes(), size, kind)
        }
        Samples::F32(values) if gray => field::write(writer, size, values, &field::INTENSITY),
        Samples::F32(values) => {
            let width = frame.width() as usize;
            let pixel = |place: exr::math::Vec2<usize>| {
                let at = &values[3 * (place.y() * width + place.x())..][..3];
                (at[0], at[1], at[2])
            };
            let channels = SpecificChannels::rgb(pixel);
            let image = Image::from_channels((width, frame.height() as usize), channels);
            image.write().to_buffered(writer).map_err(|e| e.to_string())
        }
    }
}
