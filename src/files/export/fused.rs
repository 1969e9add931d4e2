//! The pseudo-radiance as a picture, in the depth of the inputs.

use std::io::{Cursor, Seek, Write};

use png::ColorType;

use super::meaning::{FUSED, FUSED_FLOAT};
use super::picture::{self, Stored};
use super::{Extra, Look, field};
use crate::base::color::{linear_to_srgb, stored};
use crate::base::{Channels, Decode, Depth, Error, Frame, Samples};
use crate::engine::Solution;

/// An image in intensities, white at 1, interleaved.
pub(super) struct Image<'a> {
    pub(super) size: (u32, u32),
    pub(super) channels: Channels,
    pub(super) values: &'a [f32],
}

/// Writes `fused.png`: 8 bits where both inputs have 8, else 16.
pub(super) fn write(writer: impl Write, solution: &Solution, look: &Look) -> Result<(), String> {
    let size = (solution.width, solution.height);
    let image = Image { size, channels: solution.fused_channels, values: &solution.fused };
    let bytes = look.formats.iter().all(|format| format.depth == Depth::U8);
    write_image(writer, &image, look.resolved_decode(), if bytes { Depth::U8 } else { Depth::U16 })
}

/// Writes an image as PNG: 8 bits for inputs of 8, else 16.
pub(super) fn write_image(writer: impl Write, image: &Image<'_>, decode: Decode, depth: Depth) -> Result<(), String> {
    let stored = image.values.iter().map(|&v| stored(v, decode));
    let color = color_type(image.channels);
    if depth == Depth::U8 {
        let bytes: Vec<u8> = stored.map(|v| (v * 255.0).round() as u8).collect();
        return picture::write(writer, image.size, color, &Stored::Bytes(&bytes), &FUSED);
    }
    let words: Vec<u16> = stored.map(|v| (v * 65535.0).round() as u16).collect();
    picture::write(writer, image.size, color, &Stored::Words(&words), &FUSED)
}

/// How PNG calls the channels.
pub(crate) fn color_type(channels: Channels) -> ColorType {
    match channels {
        Channels::Gray => ColorType::Grayscale,
        Channels::Rgb => ColorType::Rgb,
    }
}

/// The fused image in floats, which the integers of `fused.png` clip.
pub const FUSED_FLOAT_FILE: &str = "fused.exr";

/// `fused.exr`, where I1 or I2 is in floats.
pub fn fused_float<'a>(solution: &'a Solution, look: &Look) -> Option<Extra<'a>> {
    let decode = look.resolved_decode();
    let size = (solution.width, solution.height);
    let image = Image { size, channels: solution.fused_channels, values: &solution.fused };
    let is_float = look.formats.iter().any(|format| format.depth == Depth::F32);
    is_float.then(|| {
        Extra::new(FUSED_FLOAT_FILE, move |w| {
            // The format goes back and forth in its file.
            let mut bytes = Cursor::new(Vec::new());
            write_float(&mut bytes, &image, decode)?;
            w.write_all(&bytes.into_inner()).map_err(|e| e.to_string())
        })
    })
}

/// Writes an image as EXR, in the values of the inputs and with nothing clipped.
pub(super) fn write_float(writer: impl Write + Seek, image: &Image<'_>, decode: Decode) -> Result<(), String> {
    field::write_image(writer, image.size, image.channels, &encoded(image.values, decode), &FUSED_FLOAT)
}

/// The fused image as it is stored, and read again: in floats where an input is, in 8 bits where both have 8, else in 16.
///
/// # Errors
/// [`Error::Mismatch`] where it is not of the size that the solution states.
pub fn fused_as_stored(solution: &Solution, look: &Look) -> Result<Frame, Error> {
    let image =
        Image { size: (solution.width, solution.height), channels: solution.fused_channels, values: &solution.fused };
    let has = |depth| look.formats.iter().any(|format| format.depth == depth);
    let depth = [Depth::F32, Depth::U16].into_iter().find(|depth| has(*depth)).unwrap_or(Depth::U8);
    image.as_stored(look.resolved_decode(), depth)
}

impl Look {
    /// How values became intensities, with [`Decode::Auto`] resolved.
    fn resolved_decode(&self) -> Decode {
        self.decode.resolved(self.formats.map(|format| format.depth))
    }
}

impl Image<'_> {
    /// As a file has it.
    pub(super) fn as_stored(&self, decode: Decode, depth: Depth) -> Result<Frame, Error> {
        let values = || self.values.iter();
        let samples = match depth {
            Depth::U8 => Samples::U8(values().map(|&v| (stored(v, decode) * 255.0).round() as u8).collect()),
            Depth::U16 => Samples::U16(values().map(|&v| (stored(v, decode) * 65535.0).round() as u16).collect()),
            Depth::F32 => Samples::F32(encoded(self.values, decode)),
        };
        Frame::new(self.size.0, self.size.1, self.channels, samples).map_err(Error::Mismatch)
    }
}

/// In the values of the inputs.
fn encoded(values: &[f32], decode: Decode) -> Vec<f32> {
    values.iter().map(|&v| if decode == Decode::Srgb { linear_to_srgb(v) } else { v }).collect()
}

/// The fused image in 8 bits, as `fused.png` stores it where both inputs have 8.
///
/// # Errors
/// [`Error::Mismatch`] where it is not of the size that the solution states.
pub fn fused(solution: &Solution, decode: Decode) -> Result<Frame, Error> {
    fused_frame((solution.width, solution.height), solution.fused_channels, &solution.fused, decode)
}

/// The same of intensities, white at 1, interleaved.
pub(crate) fn fused_frame(
    (width, height): (u32, u32),
    channels: Channels,
    values: &[f32],
    decode: Decode,
) -> Result<Frame, Error> {
    let bytes = values.iter().map(|&v| (stored(v, decode) * 255.0).round() as u8).collect();
    Frame::new(width, height, channels, Samples::U8(bytes)).map_err(Error::Mismatch)
}
