//! Numbers and pictures as text that a page can hold.

use std::io::Write;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, RgbImage};

/// Quality of the pictures, of 100: at 92 no block shows, even flickering.
const QUALITY: u8 = 92;

/// 32-bit floats, bit by bit as they are: of each the difference of its bits from those of the one before, all first
/// bytes, then all second ones and so on (neighbours differ little, so that most high bytes are alike), zlib, base64.
/// `report.js` undoes it.
pub(super) fn floats(values: &[f32]) -> Result<String, String> {
    let mut planes = vec![0; 4 * values.len()];
    let mut before = 0u32;
    for (i, value) in values.iter().enumerate() {
        let bits = value.to_bits();
        let difference = bits.wrapping_sub(before).to_le_bytes();
        before = bits;
        (0..4).for_each(|plane| planes[plane * values.len() + i] = difference[plane]);
    }
    let mut encoder = ZlibEncoder::new(Vec::with_capacity(planes.len()), Compression::fast());
    encoder.write_all(&planes).and_then(|()| encoder.finish()).map(base64).map_err(|e| e.to_string())
}

/// A picture as JPEG, base64.
pub(super) fn picture(image: &RgbImage) -> Result<String, String> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, QUALITY)
        .encode(image, image.width(), image.height(), ExtendedColorType::Rgb8)
        .map_err(|e| e.to_string())?;
    Ok(base64(bytes))
}

fn base64(bytes: Vec<u8>) -> String {
    STANDARD.encode(bytes)
}

/// JSON that may stand in a script element: whatever its strings hold, no element ends or begins in it.
pub(super) fn json(value: &impl serde::Serialize) -> Result<String, String> {
    // Outside its strings JSON has no such sign.
    serde_json::to_string(value).map(|text| text.replace('<', "\\u003c")).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    #[test]
    fn every_bit_of_a_float_comes_back() {
        let values = [0.0f32, -0.0, 1.5, f32::NAN, f32::INFINITY, -144.0, 1e-30];
        let packed = STANDARD.decode(floats(&values).unwrap()).unwrap();
        let mut planes = Vec::new();
        flate2::read::ZlibDecoder::new(&packed[..]).read_to_end(&mut planes).unwrap();
        let mut bits = 0u32;
        for (i, value) in values.iter().enumerate() {
            bits = bits.wrapping_add(u32::from_le_bytes([0, 1, 2, 3].map(|plane| planes[plane * values.len() + i])));
            assert_eq!(bits, value.to_bits());
        }
        assert_eq!(floats(&[]).unwrap(), STANDARD.encode([0x78, 0x01, 0x03, 0, 0, 0, 0, 1]));
    }

    #[test]
    fn no_string_ends_the_element_that_holds_it() {
        let text = json(&["</script><script>alert(1)</script>", "<!--"]).unwrap();
        assert!(!text.contains('<'));
        let back: Vec<String> = serde_json::from_str(&text).unwrap();
        assert_eq!(back, ["</script><script>alert(1)</script>", "<!--"]);
    }
}
