//! `valid.png`: where V is a measurement.

use std::io::Write;

use png::ColorType;

use super::meaning::Meaning;
use super::picture::{self, Stored};
use super::texture::Texture;
use crate::engine::Solution;

const MEANING: Meaning = Meaning::new(
    "label",
    "255 where the relative blur V is measured; 0 where it is not valid, masked, or filled in for want of texture",
);

/// Writes `valid.png`, 8-bit grey: 255 where V is valid and there is texture to tell it by, else 0.
pub(super) fn write(writer: impl Write, solution: &Solution, texture: &Texture) -> Result<(), String> {
    let measured = texture.without(&solution.relative_blur);
    let bytes: Vec<u8> = measured.iter().map(|v| if v.is_finite() { 255 } else { 0 }).collect();
    let size = (solution.width, solution.height);
    picture::write(writer, size, ColorType::Grayscale, &Stored::Bytes(&bytes), &MEANING)
}
