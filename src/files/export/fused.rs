//! The all-in-focus image, as PNG in the bit depth of the inputs, and as EXR for inputs in floats.

use std::io::{Seek, Write};

use png::ColorType;

use super::description::{FUSED, FUSED_FLOAT};
use super::exr_file;
use super::png_file::{self, Pixels};
use crate::base::color::{linear_to_srgb, stored};
use crate::base::{Channels, Decode, Depth, Error, Frame, Samples};
use crate::engine::Solution;

/// File of the all-in-focus image in integers: 8 bits if all inputs have 8 bits, else 16.
pub const FUSED_FILE: &str = "fused.png";

/// File of the all-in-focus image in floats, unclipped; only for inputs in floats.
pub const FUSED_FLOAT_FILE: &str = "fused.exr";

/// The all-in-focus image in intensities, white at 1, interleaved.
#[derive(Clone, Debug)]
pub(super) struct Fused<'a> {
    size: (u32, u32),
    channels: Channels,
    values: &'a [f32],
    decode: Decode,
    /// Sample types of the inputs.
    pub(super) depth: Depth,
}

impl<'a> Fused<'a> {
    /// Makes an image of this size.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if it has another number of values, or no values because the solve left it out.
    pub(super) fn new(
        size: (u32, u32),
        (channels, values): (Channels, &'a [f32]),
        decode: Decode,
        depth: Depth,
    ) -> Result<Self, Error> {
        let count = size.0 as usize * size.1 as usize * channels.count() as usize;
        if values.len() == count {
            return Ok(Self { size, channels, values, decode, depth });
        }
        let problem = match values.is_empty() {
            true => "results without the fused image cannot be written: solve with `fused` set".to_string(),
            false => format!("the fused image has {} values instead of {count}", values.len()),
        };
        Err(Error::Mismatch(problem))
    }

    fn bytes(&self) -> Vec<u8> {
        self.values.iter().map(|&v| (stored(v, self.decode) * 255.0).round() as u8).collect()
    }

    fn words(&self) -> Vec<u16> {
        self.values.iter().map(|&v| (stored(v, self.decode) * 65535.0).round() as u16).collect()
    }

    /// The values encoded like those of the inputs, unclipped.
    fn floats(&self) -> Vec<f32> {
        let encode = |&v: &f32| if self.decode == Decode::Srgb { linear_to_srgb(v) } else { v };
        self.values.iter().map(encode).collect()
    }

    /// Writes `fused.png`.
    pub(super) fn write_png(&self, writer: impl Write) -> Result<(), String> {
        let color = color_type(self.channels);
        match self.depth {
            Depth::U8 => png_file::write(writer, self.size, color, &Pixels::Bytes(&self.bytes()), &FUSED),
            _ => png_file::write(writer, self.size, color, &Pixels::Words(&self.words()), &FUSED),
        }
    }

    /// Writes `fused.exr`.
    pub(super) fn write_exr(&self, writer: impl Write + Seek) -> Result<(), String> {
        exr_file::write_image(writer, self.size, self.channels, &self.floats(), &FUSED_FLOAT)
    }

    /// The image as stored in its file.
    ///
    /// # Errors
    /// [`Error::Mismatch`]; none known, since the size was checked.
    pub(super) fn as_stored(&self) -> Result<Frame, Error> {
        self.frame(match self.depth {
            Depth::U8 => Samples::U8(self.bytes()),
            Depth::U16 => Samples::U16(self.words()),
            Depth::F32 => Samples::F32(self.floats()),
        })
    }

    /// The image in 8 bits.
    ///
    /// # Errors
    /// As for [`as_stored`](Self::as_stored).
    pub(super) fn in_8_bits(&self) -> Result<Frame, Error> {
        self.frame(Samples::U8(self.bytes()))
    }

    fn frame(&self, samples: Samples) -> Result<Frame, Error> {
        Frame::new(self.size.0, self.size.1, self.channels, samples).map_err(Error::Mismatch)
    }
}

/// The channels as a colour type of PNG.
pub(crate) fn color_type(channels: Channels) -> ColorType {
    match channels {
        Channels::Gray => ColorType::Grayscale,
        Channels::Rgb => ColorType::Rgb,
    }
}

/// The all-in-focus image of a solution in 8 bits.
///
/// # Errors
/// [`Error::Mismatch`] if it does not have the size that the solution states.
pub fn fused(solution: &Solution, decode: Decode) -> Result<Frame, Error> {
    let size = (solution.width, solution.height);
    Fused::new(size, (solution.fused_channels, &solution.fused), decode, Depth::U8)?.in_8_bits()
}
