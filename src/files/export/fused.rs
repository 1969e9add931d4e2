//! The all-in-focus image, as PNG in the bit depth of the inputs, and as EXR for inputs in floats.

use std::borrow::Cow;
use std::io::{Seek, Write};
use std::sync::OnceLock;

use super::image_files::{FUSED, FUSED_FLOAT, write_floats, write_frame};
use crate::base::color::linear_to_srgb;
use crate::base::{Channels, Decode, Depth, Error, Frame, Samples};
use crate::engine::Solution;
use crate::files::image_io::{Carried, Curve, Tone};
use crate::solve::resample::in_rows;

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
    /// The range of stored values that integers in files and pictures have.
    pub(super) tone: Tone,
    /// The image in 8 bits, computed once: a file and the page use it.
    eight_bits: OnceLock<Result<Frame, String>>,
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
            let tone = match depth {
                Depth::U8 => Tone::default(),
                // The overshoot of resampled integers is no part of their range.
                Depth::U16 => Tone::over(values.len(), |i| Some(encoded(values[i], decode).clamp(0.0, 1.0))),
                Depth::F32 => Tone::over(values.len(), |i| Some(encoded(values[i], decode))),
            };
            return Ok(Self { size, channels, values, decode, depth, tone, eight_bits: OnceLock::new() });
        }
        let problem = match values.is_empty() {
            true => "results without the fused image cannot be written: solve with `fused` set".to_string(),
            false => format!("the fused image has {} values instead of {count}", values.len()),
        };
        Err(Error::Mismatch(problem))
    }

    /// The image in samples of this type. Floats are encoded like those of the inputs, unclipped.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if a value is not finite.
    pub(super) fn frame(&self, depth: Depth) -> Result<Frame, Error> {
        let samples = match depth {
            Depth::U8 => return self.in_8_bits().cloned(),
            Depth::U16 => Samples::U16(self.integers(65535.0, Tone::default(), |v| v as u16)),
            Depth::F32 => Samples::F32(self.floats()),
        };
        Frame::new(self.size.0, self.size.1, self.channels, samples).map_err(Error::Mismatch)
    }

    /// The image in 8 bits, in the range of its tone.
    ///
    /// # Errors
    /// As for [`frame`](Self::frame).
    pub(super) fn in_8_bits(&self) -> Result<&Frame, Error> {
        let frame = self.eight_bits.get_or_init(|| {
            let samples = Samples::U8(self.integers(255.0, self.tone, |v| v as u8));
            Frame::new(self.size.0, self.size.1, self.channels, samples)
        });
        frame.as_ref().map_err(|problem| Error::Mismatch(problem.clone()))
    }

    /// The stored values on a scale from the tone's black at 0 to its white at `white`.
    fn integers<T: Copy + Default + Send>(&self, white: f32, tone: Tone, of: impl Fn(f32) -> T + Sync) -> Vec<T> {
        let mut integers = vec![T::default(); self.values.len()];
        let row = self.size.0 as usize * self.channels.count() as usize;
        in_rows(&mut integers, row, |y, integers| {
            let values = &self.values[y * row..];
            let integer = |v: f32| of((tone.shown(encoded(v, self.decode)) * white).round());
            integers.iter_mut().zip(values).for_each(|(to, v)| *to = integer(*v));
        });
        integers
    }

    fn floats(&self) -> Vec<f32> {
        self.values.iter().map(|v| encoded(*v, self.decode)).collect()
    }

    /// Writes `fused.png` with the metadata of a photograph, its values by a curve in the place of that of sRGB.
    pub(super) fn write_png(
        &self,
        writer: impl Write + Seek,
        carried: &Carried,
        curve: Option<&Curve>,
    ) -> Result<(), String> {
        let frame = match self.depth {
            Depth::U8 => self.in_8_bits().map(Cow::Borrowed),
            _ => {
                let words = Samples::U16(self.integers(65535.0, self.tone, |v| v as u16));
                let frame = Frame::new(self.size.0, self.size.1, self.channels, words);
                frame.map(Cow::Owned).map_err(Error::Mismatch)
            }
        };
        let frame = frame.map_err(|e| e.to_string())?;
        let frame = match curve {
            Some(curve) => Cow::Owned(curve.encoded(&frame)),
            None => frame,
        };
        write_frame(writer, &frame, carried, [&FUSED, &FUSED_FLOAT])
    }

    /// Writes `fused.exr`.
    pub(super) fn write_exr(&self, writer: impl Write + Seek) -> Result<(), String> {
        write_floats(writer, self.size, self.channels, &self.floats(), &FUSED_FLOAT)
    }
}

/// The stored value of an intensity, unclipped.
fn encoded(intensity: f32, decode: Decode) -> f32 {
    if decode == Decode::Srgb { linear_to_srgb(intensity) } else { intensity }
}

/// The all-in-focus image of a solution in 8 bits.
///
/// # Errors
/// [`Error::Mismatch`] if it does not have the size that the solution states.
pub fn fused(solution: &Solution, decode: Decode) -> Result<Frame, Error> {
    let size = (solution.width, solution.height);
    Fused::new(size, (solution.fused_channels, &solution.fused), decode, Depth::U8)?.frame(Depth::U8)
}
