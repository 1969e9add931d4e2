//! What the camera says of how a photograph was taken (Exif 2.32).

use exif::{In, Reader, Tag, Value};
use serde::{Deserialize, Serialize};

/// What EXIF says of lens and camera, where it says it. Makers round: a focal length to the millimetre, a distance to
/// the next step of the lens's encoder.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Exif {
    /// Maker and model.
    pub camera: Option<String>,
    /// Focal length, mm.
    pub focal_length_mm: Option<f64>,
    /// Focal length of the same angle of view on 36 x 24 mm, mm.
    pub focal_length_35mm_mm: Option<f64>,
    /// f-number.
    pub f_number: Option<f64>,
    /// Distance from the camera to what is in focus, mm.
    pub subject_distance_mm: Option<f64>,
    /// Distance of neighbouring pixels on the sensor, mm, by the focal plane resolution: of the picture as the camera
    /// stored it, not as it may have been resized since.
    pub pixel_pitch_mm: Option<f64>,
}

/// Reads a TIFF structure, as APP1 of JPEG and eXIf of PNG hold it and as a TIFF file is one; also whether it says sRGB.
/// `None` where nothing of it can be read, or it says nothing of the above.
pub(super) fn parse(data: Vec<u8>) -> (Option<Exif>, bool) {
    // What can be read of a damaged one is taken.
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
        // Most models begin with their maker.
        [make, model] if model.to_lowercase().starts_with(&make.to_lowercase()) => Some(model.clone()),
        all => Some(all.join(" ")),
    };
    let unit_mm = match value(Tag::FocalPlaneResolutionUnit).and_then(|v| v.get_uint(0)) {
        Some(3) => 10.0,
        Some(4) => 1.0,
        // An inch, also where nothing is said.
        _ => 25.4,
    };
    let exif = Exif {
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

/// A number that is known: zero stands for unknown, and all bits for infinity.
fn positive(value: &Value) -> Option<f64> {
    let number = match value {
        Value::Rational(parts) => parts.first().filter(|part| part.num != u32::MAX)?.to_f64(),
        other => f64::from(other.get_uint(0)?),
    };
    (number.is_finite() && number > 0.0).then_some(number)
}
