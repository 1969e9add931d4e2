//! Metadata of photographs: EXIF, and the transfer curve of the values.

use std::io::Cursor;

use exif::{In, Reader, Tag, Value};
use moxcms::{ColorProfile, ParsingOptions, ProfileText};
use serde::{Deserialize, Serialize};

/// EXIF 2.32 of the camera and the lens. Manufacturers round the focal length to the millimetre, and the distance to
/// the next step of the lens's encoder.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Exif {
    /// Manufacturer and model.
    pub camera: Option<String>,
    /// Focal length, mm.
    pub focal_length_mm: Option<f64>,
    /// Focal length that gives the same angle of view on 36 x 24 mm, mm.
    pub focal_length_35mm_mm: Option<f64>,
    /// f-number.
    pub f_number: Option<f64>,
    /// Distance from the camera to the plane in focus, mm.
    pub subject_distance_mm: Option<f64>,
    /// Pixel pitch of the sensor, mm, from the focal plane resolution of the picture as the camera stored it.
    pub pixel_pitch_mm: Option<f64>,
    /// Date, time and, if stated, fraction of the second when the photograph was taken: `2026:05:01 12:00:59.25`.
    pub taken: Option<String>,
}

/// Parses the TIFF structure of EXIF, from APP1 of JPEG, eXIf of PNG, or a TIFF file. Also returns whether it states
/// sRGB. `None` if it cannot be read or has none of the fields.
pub(super) fn parse_exif(data: Vec<u8>) -> (Option<Exif>, bool) {
    // Uses the readable fields of a damaged structure.
    let Ok(fields) = Reader::new().continue_on_error(true).read_raw(data).or_else(|e| e.distill_partial_result(|_| ()))
    else {
        return (None, false);
    };
    let value = |tag| fields.get_field(tag, In::PRIMARY).map(|field| &field.value);
    let number = |tag| value(tag).and_then(positive);
    let text = |tag| match value(tag) {
        Some(Value::Ascii(parts)) => {
            parts.first().map(|part| String::from_utf8_lossy(part).trim_matches(['\0', ' ']).to_string())
        }
        _ => None,
    };
    let names: Vec<String> =
        [text(Tag::Make), text(Tag::Model)].into_iter().flatten().filter(|t| !t.is_empty()).collect();
    let camera = match names.as_slice() {
        [] => None,
        // Most model names begin with the manufacturer.
        [make, model] if model.to_lowercase().starts_with(&make.to_lowercase()) => Some(model.clone()),
        all => Some(all.join(" ")),
    };
    let unit_mm = match value(Tag::FocalPlaneResolutionUnit).and_then(|v| v.get_uint(0)) {
        Some(3) => 10.0,
        Some(4) => 1.0,
        // The default unit is the inch.
        _ => 25.4,
    };
    let fraction = text(Tag::SubSecTimeOriginal).map_or(String::new(), |digits| format!(".{digits}"));
    let exif = Exif {
        taken: text(Tag::DateTimeOriginal).filter(|t| !t.is_empty()).map(|taken| taken + &fraction),
        camera,
        focal_length_mm: number(Tag::FocalLength),
        focal_length_35mm_mm: number(Tag::FocalLengthIn35mmFilm),
        f_number: number(Tag::FNumber),
        subject_distance_mm: number(Tag::SubjectDistance).map(|metres| 1e3 * metres),
        pixel_pitch_mm: number(Tag::FocalPlaneXResolution).map(|per_unit| unit_mm / per_unit),
    };
    let is_srgb = value(Tag::ColorSpace).and_then(|v| v.get_uint(0)) == Some(1);
    ((exif != Exif::default()).then_some(exif), is_srgb)
}

/// A positive, finite number. In EXIF zero means unknown, and all bits set mean infinity.
fn positive(value: &Value) -> Option<f64> {
    let number = match value {
        Value::Rational(parts) => parts.first().filter(|part| part.num != u32::MAX)?.to_f64(),
        other => f64::from(other.get_uint(0)?),
    };
    (number.is_finite() && number > 0.0).then_some(number)
}

/// The values follow the sRGB curve.
pub(super) const SRGB: &str = "sRGB";
/// The values are proportional to light.
pub(super) const LINEAR: &str = "linear";
/// The ICC profile cannot be read.
pub(super) const UNREADABLE: &str = "those of an ICC profile that cannot be read";

/// Greatest number of bytes of an ICC profile that are parsed, 4 MiB. A profile with tables for a printer has 2 MiB.
pub(super) const MAX_PROFILE: usize = 4 << 20;

/// Greatest number of tags of a profile. Real profiles have two dozen, and a hostile one may repeat a large table.
const MAX_TAGS: u32 = 100;

/// The curve from the chunk sRGB or gAMA of a PNG. A gAMA of 1/2.2 means sRGB.
pub(super) fn encoding_of_png(bytes: &[u8]) -> Option<String> {
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), png::Limits { bytes: MAX_PROFILE });
    // Neither chunk is used, and both may decompress to large data.
    decoder.set_ignore_iccp_chunk(true);
    decoder.set_ignore_text_chunk(true);
    let reader = decoder.read_info().ok()?;
    let info = reader.info();
    if info.srgb.is_some() {
        return Some(SRGB.to_string());
    }
    match info.gama_chunk?.into_value() {
        exponent if exponent <= 0.0 => None,
        exponent if (exponent - 1.0).abs() < 1e-3 => Some(LINEAR.to_string()),
        exponent if (exponent - 1.0 / 2.2).abs() < 1e-3 => Some(SRGB.to_string()),
        exponent => Some(format!("gamma {:.2}", 1.0 / exponent)),
    }
}

/// The curve from the name of an ICC profile.
pub(super) fn encoding_of_icc(profile: &[u8]) -> Option<String> {
    let Some(profile) = parse_icc(profile) else { return Some(UNREADABLE.to_string()) };
    let name = match profile.description? {
        ProfileText::PlainString(text) => text,
        ProfileText::Localizable(texts) => texts.into_iter().next()?.value,
        ProfileText::Description(text) => text.ascii_string,
    };
    let name: String = name.chars().filter(|c| !c.is_control()).collect();
    let (name, lower) = (name.trim(), name.to_lowercase());
    if name.is_empty() {
        None
    } else if lower.contains("linear") {
        Some(LINEAR.to_string())
    } else if lower.contains("srgb") {
        Some(SRGB.to_string())
    } else {
        Some(name.to_string())
    }
}

fn parse_icc(profile: &[u8]) -> Option<ColorProfile> {
    let tags = u32::from_be_bytes(profile.get(128..132)?.try_into().ok()?);
    let options = ParsingOptions { max_profile_size: MAX_PROFILE, ..ParsingOptions::default() };
    (tags <= MAX_TAGS).then(|| ColorProfile::new_from_slice_with_options(profile, options).ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A profile of version 2 or 4 with only a description.
    fn profile(name: &str, version: u8) -> Vec<u8> {
        let mut bytes = vec![0; 128];
        bytes[8] = version;
        for (at, word) in [(12, b"mntr"), (16, b"RGB "), (20, b"XYZ "), (36, b"acsp")] {
            bytes[at..at + 4].copy_from_slice(word);
        }
        let tag = if version == 2 {
            [b"desc\0\0\0\0", &(name.len() as u32 + 1).to_be_bytes()[..], name.as_bytes(), b"\0"].concat()
        } else {
            let text: Vec<u8> = name.encode_utf16().flat_map(u16::to_be_bytes).collect();
            let head = [1, 12, 0x656e_5553, text.len() as u32, 28].map(u32::to_be_bytes).concat();
            [b"mluc\0\0\0\0", head.as_slice(), &text].concat()
        };
        bytes.extend([1, u32::from_be_bytes(*b"desc"), 144, tag.len() as u32].map(u32::to_be_bytes).concat());
        bytes.extend(tag);
        bytes
    }

    #[test]
    fn a_profile_is_identified_by_its_name() {
        for version in [2, 4] {
            for (name, expected) in
                [("sRGB IEC61966-2.1", "sRGB"), ("Linear Rec709", "linear"), ("Adobe RGB (1998)", "Adobe RGB (1998)")]
            {
                assert_eq!(encoding_of_icc(&profile(name, version)).as_deref(), Some(expected));
            }
            assert_eq!(encoding_of_icc(&profile(" ", version)), None);
        }
        for (whole, expected) in [(ColorProfile::new_srgb(), "sRGB"), (ColorProfile::new_display_p3(), "Display P3")] {
            assert_eq!(encoding_of_icc(&whole.encode().unwrap()).as_deref(), Some(expected));
        }
    }

    #[test]
    fn an_unreadable_profile_has_its_own_label() {
        for whole in [profile("sRGB", 2), profile("sRGB", 4), ColorProfile::new_srgb().encode().unwrap()] {
            for at in 0..whole.len() {
                assert_ne!(encoding_of_icc(&whole[..at]).as_deref(), Some("sRGB"), "{at}");
                let mut bent = whole.clone();
                bent[at] ^= 0xa5;
                encoding_of_icc(&bent);
            }
        }
        let large = [profile("sRGB", 4), vec![0; MAX_PROFILE]].concat();
        for bad in [&[0xff; 300][..], &[], &large] {
            assert_eq!(encoding_of_icc(bad).as_deref(), Some(UNREADABLE));
        }
    }
}
