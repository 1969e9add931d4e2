//! `valid.png`: where V, or focus, is a measurement.

use std::io::Write;

use png::ColorType;

use super::meaning::Meaning;
use super::picture::{self, Stored};

const MEANING: Meaning = Meaning::new(
    "label",
    "255 where the relative blur V, or the focus of a sweep, is measured; 0 where it is not valid, masked, or filled in for \
     want of texture",
);

/// Writes `valid.png`, 8-bit grey: 255 where a field that is NaN where nothing is measured has a value, else 0.
pub(super) fn write(writer: impl Write, size: (u32, u32), measured: &[f32]) -> Result<(), String> {
    let bytes: Vec<u8> = measured.iter().map(|v| if v.is_finite() { 255 } else { 0 }).collect();
    picture::write(writer, size, ColorType::Grayscale, &Stored::Bytes(&bytes), &MEANING)
}
