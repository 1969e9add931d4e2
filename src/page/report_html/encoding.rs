//! Encoding of numbers and pictures as text, and the grid of pixels that a page holds.

use std::io::Write;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, RgbImage};

use crate::page::figure::resized;

/// The integer that encodes NaN.
const NOTHING: i32 = i32::MIN;
/// Greatest magnitude of the other integers.
const BEYOND: f64 = i32::MAX as f64;

/// Encodes numbers, `width` per row, with this number of decimals. Each number becomes an integer, which is predicted
/// from its left, upper and upper left neighbours. The residual is zigzag-coded (0, -1, 1, -2 ...). The first bytes of
/// all residuals come first, then all second bytes and so on, since most high bytes are 0. The result is compressed by
/// zlib and encoded in base64. `data.js` decodes it.
///
/// Level 1 of zlib takes 0.07 s for the fields of the heat sink, and the default level 0.57 s. It needs 14 % more
/// bytes.
pub(super) fn decimals(values: &[f32], width: usize, digits: u32) -> Result<String, String> {
    let integers: Vec<i32> = values.iter().map(|&v| integer(v, digits)).collect();
    let mut planes = vec![0; 4 * values.len()];
    for (i, &value) in integers.iter().enumerate() {
        let off = value.wrapping_sub(predicted(&integers, width, i));
        let zigzag = ((off << 1) ^ (off >> 31)).to_le_bytes();
        (0..4).for_each(|plane| planes[plane * values.len() + i] = zigzag[plane]);
    }
    let mut encoder = ZlibEncoder::new(Vec::with_capacity(planes.len()), Compression::fast());
    encoder
        .write_all(&planes)
        .and_then(|()| encoder.finish())
        .map(|bytes| STANDARD.encode(bytes))
        .map_err(|e| e.to_string())
}

fn integer(value: f32, digits: u32) -> i32 {
    if value.is_nan() {
        return NOTHING;
    }
    (f64::from(value) * 10f64.powi(digits as i32)).round().clamp(-BEYOND, BEYOND) as i32
}

/// The prediction of an integer from its neighbours.
fn predicted(integers: &[i32], width: usize, i: usize) -> i32 {
    match (i % width, i / width) {
        (0, 0) => 0,
        (_, 0) => integers[i - 1],
        (0, _) => integers[i - width],
        _ => integers[i - 1].wrapping_add(integers[i - width]).wrapping_sub(integers[i - width - 1]),
    }
}

/// A picture as JPEG of a quality up to 100, base64.
pub(in crate::page) fn jpeg(image: &RgbImage, quality: u8) -> Result<String, String> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality)
        .encode(image, image.width(), image.height(), ExtendedColorType::Rgb8)
        .map_err(|e| e.to_string())?;
    Ok(STANDARD.encode(bytes))
}

/// JSON for a script element. No string in it can begin or end an element.
pub(super) fn json(value: &impl serde::Serialize) -> Result<String, String> {
    // Outside strings JSON does not contain this character.
    serde_json::to_string(value).map(|text| text.replace('<', "\\u003c")).map_err(|e| e.to_string())
}

/// Greatest number of pixels of a page, so that a browser can open it. A page of a larger image has every second pixel
/// of every second row, or every third, and so on. Each value is that of its pixel.
const MAX_PIXELS: usize = 1 << 22;

/// A grid of pixels at `step / 2 + k step` on both axes, k = 0, 1 and so on.
pub(super) struct Grid {
    full: (usize, usize),
    pub(super) step: usize,
    pub(super) width: usize,
    pub(super) height: usize,
}

impl Grid {
    /// The grid for images of this size.
    pub(super) fn of(full: (u32, u32)) -> Self {
        Self::within(full, MAX_PIXELS)
    }

    /// The grid with at most `most` pixels.
    pub(super) fn within((width, height): (u32, u32), most: usize) -> Self {
        let full = (width as usize, height as usize);
        let count = |side: usize, step: usize| (side - step / 2).div_ceil(step);
        let mut step = 1;
        while count(full.0, step) * count(full.1, step) > most && step < full.0.min(full.1) {
            step += 1;
        }
        Self { full, step, width: count(full.0, step), height: count(full.1, step) }
    }

    pub(super) fn values(&self, values: &[f32]) -> Vec<f32> {
        let (first, step) = (self.step / 2, self.step);
        let rows = values.chunks_exact(self.full.0).skip(first).step_by(step);
        rows.flat_map(|row| row.iter().skip(first).step_by(step)).copied().collect()
    }

    pub(super) fn picture(&self, image: RgbImage) -> RgbImage {
        if self.step == 1 { image } else { resized(&image, (self.width as u32, self.height as u32)) }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    fn unpacked(text: &str, width: usize) -> Vec<i32> {
        let mut planes = Vec::new();
        flate2::read::ZlibDecoder::new(&STANDARD.decode(text).unwrap()[..]).read_to_end(&mut planes).unwrap();
        let count = planes.len() / 4;
        let mut integers = Vec::new();
        for i in 0..count {
            let zigzag = u32::from_le_bytes([0, 1, 2, 3].map(|plane| planes[plane * count + i]));
            let off = (zigzag >> 1) as i32 ^ -((zigzag & 1) as i32);
            integers.push(predicted(&integers, width, i).wrapping_add(off));
        }
        integers
    }

    #[test]
    fn every_decimal_is_recovered() {
        let values = [0.0f32, -0.0, 1.5, f32::NAN, f32::INFINITY, -144.0, 1e-30, -1e30, 0.12345, 9.0, f32::NAN, -7.25];
        let found = unpacked(&decimals(&values, 4, 4).unwrap(), 4);
        let expected = [0, 0, 15000, NOTHING, i32::MAX, -1_440_000, 0, -i32::MAX, 1235, 90_000, NOTHING, -72_500];
        assert_eq!(found, expected);
        assert!(unpacked(&decimals(&[], 4, 4).unwrap(), 4).is_empty());
    }

    #[test]
    fn no_string_can_close_its_script_element() {
        let text = json(&["</script><script>alert(1)</script>", "<!--"]).unwrap();
        assert!(!text.contains('<'));
        let back: Vec<String> = serde_json::from_str(&text).unwrap();
        assert_eq!(back, ["</script><script>alert(1)</script>", "<!--"]);
    }
}
