//! The pseudo-radiance as a picture, in the depth of the inputs.

use std::io::Write;

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};

use super::Look;
use crate::{Channels, Decode, Depth, Error, Frame, Samples, Solution};

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
    write_image(writer, &image, look.decode, if bytes { Depth::U8 } else { Depth::U16 })
}

/// Writes an image as PNG: 8 bits for inputs of 8, else 16.
pub(super) fn write_image(writer: impl Write, image: &Image<'_>, decode: Decode, depth: Depth) -> Result<(), String> {
    let stored = image.values.iter().map(|&v| stored(v, decode));
    let gray = image.channels == Channels::Gray;
    if depth == Depth::U8 {
        let bytes: Vec<u8> = stored.map(|v| (v * 255.0).round() as u8).collect();
        return png(writer, &bytes, image.size, if gray { ExtendedColorType::L8 } else { ExtendedColorType::Rgb8 });
    }
    let samples: Vec<u16> = stored.map(|v| (v * 65535.0).round() as u16).collect();
    let kind = if gray { ExtendedColorType::L16 } else { ExtendedColorType::Rgb16 };
    png(writer, bytemuck::cast_slice(&samples), image.size, kind)
}

/// The fused image in 8 bits, as `fused.png` stores it where both inputs have 8.
///
/// # Errors
/// [`Error::Mismatch`] where it is not of the size that the solution states.
pub fn fused(solution: &Solution, decode: Decode) -> Result<Frame, Error> {
    let bytes = solution.fused.iter().map(|&v| (stored(v, decode) * 255.0).round() as u8).collect();
    Frame::new(solution.width, solution.height, solution.fused_channels, Samples::U8(bytes)).map_err(Error::Mismatch)
}

/// The value that a file stores, in [0, 1].
pub(crate) fn stored(value: f32, decode: Decode) -> f32 {
    let value = value.clamp(0.0, 1.0);
    match decode {
        Decode::None => value,
        Decode::Srgb => encode_srgb(value),
    }
}

/// The sRGB curve, IEC 61966-2-1.
fn encode_srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// Writes a PNG; 16-bit samples in the machine's byte order.
pub(super) fn png(
    writer: impl Write,
    bytes: &[u8],
    (width, height): (u32, u32),
    color: ExtendedColorType,
) -> Result<(), String> {
    PngEncoder::new(writer).write_image(bytes, width, height, color).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_clamped_and_srgb_is_encoded_back() {
        assert_eq!(stored(-1.0, Decode::None), 0.0);
        assert!((stored(2.0, Decode::Srgb) - 1.0).abs() < 1e-6);
        assert_eq!(stored(0.25, Decode::None), 0.25);
        // 50 % stored is 21.4 % linear.
        assert!((stored(0.214_041_1, Decode::Srgb) - 0.5).abs() < 1e-5);
        assert!((stored(0.001, Decode::Srgb) - 0.01292).abs() < 1e-7);
    }
}
