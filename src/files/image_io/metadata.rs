//! Metadata of photographs: EXIF, and the transfer curve of the values.

use std::io::Cursor;

use exif::experimental::Writer;
use exif::{In, Reader, Tag, Value};
use serde::{Deserialize, Serialize};

use super::curve::{Curve, LINEAR, MAX_PROFILE, SRGB, UNREADABLE, curve_of};

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

/// What files made from a photograph carry of its metadata.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Carried {
    /// The ICC profile.
    pub(crate) profile: Option<Vec<u8>>,
    /// The curve of the values, if it is neither linear nor nearly sRGB.
    pub(crate) curve: Option<Curve>,
    /// EXIF of the camera, the lens and the exposure, without what holds of the file alone, such as the orientation.
    pub(crate) exif: Option<Vec<u8>>,
    /// The exponent of the values, as a PNG states it.
    pub(crate) exponent: Option<f32>,
    /// Pixels per metre along x and y.
    pub(crate) density: Option<[u32; 2]>,
}

/// The metadata that a file states.
#[derive(Clone, Debug, Default)]
pub(super) struct Metadata {
    /// Transfer curve of the values.
    pub(super) encoding: Option<String>,
    pub(super) exif: Option<Exif>,
    pub(super) carried: Carried,
}

impl Metadata {
    /// Parses EXIF and ICC profile, and the chunks of a PNG or JFIF.
    pub(super) fn of(exif: Option<Vec<u8>>, profile: Option<Vec<u8>>, format: &str, bytes: &[u8]) -> Self {
        let mut found = Self::default();
        let is_srgb = exif.is_some_and(|exif| found.read_exif(exif));
        found.encoding = is_srgb.then(|| SRGB.to_string());
        match format {
            "PNG" => found.read_png(bytes),
            "JPEG" => found.carried.density = found.carried.density.or_else(|| density_of_jfif(bytes)),
            _ => (),
        }
        if let Some(profile) = profile {
            let (encoding, curve) = curve_of(&profile).unwrap_or((UNREADABLE.to_string(), None));
            (found.encoding, found.carried.curve) = (Some(encoding), curve);
            found.carried.profile = Some(profile).filter(|_| found.encoding.as_deref() != Some(UNREADABLE));
        }
        found
    }

    /// The curve from the chunk sRGB or gAMA of a PNG, and its resolution. A gAMA of 1/2.2 means sRGB.
    fn read_png(&mut self, bytes: &[u8]) {
        let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), png::Limits { bytes: MAX_PROFILE });
        // Neither chunk is used, and both may decompress to large data.
        decoder.set_ignore_iccp_chunk(true);
        decoder.set_ignore_text_chunk(true);
        let Ok(reader) = decoder.read_info() else { return };
        let info = reader.info();
        let is_metric = |dims: &png::PixelDimensions| dims.unit == png::Unit::Meter;
        let density = info.pixel_dims.filter(is_metric).map(|dims| [dims.xppu, dims.yppu]);
        self.carried.density = density.or(self.carried.density);
        let exponent = info.gama_chunk.map(png::ScaledFloat::into_value);
        if info.srgb.is_some() {
            self.encoding = Some(SRGB.to_string());
        } else if let Some(exponent) = exponent.filter(|exponent| *exponent > 0.0) {
            let gamma = 1.0 / exponent;
            self.carried.exponent = Some(exponent);
            let is_other = (exponent - 1.0).abs() >= 1e-3 && (gamma - 2.2).abs() >= 0.01;
            self.carried.curve = is_other.then(|| Curve::of_gamma(gamma));
            self.encoding = Some(match exponent {
                exponent if (exponent - 1.0).abs() < 1e-3 => LINEAR.to_string(),
                _ if !is_other => SRGB.to_string(),
                _ => format!("gamma {gamma:.2}"),
            });
        }
    }

    /// Parses the TIFF structure of EXIF, from APP1 of JPEG, eXIf of PNG, or a TIFF file. Returns whether it states sRGB.
    fn read_exif(&mut self, data: Vec<u8>) -> bool {
        // Uses the readable fields of a damaged structure.
        let read = Reader::new().continue_on_error(true).read_raw(data);
        let Ok(fields) = read.or_else(|e| e.distill_partial_result(|_| ())) else { return false };
        let number = |tag| positive(&fields.get_field(tag, In::PRIMARY)?.value);
        let per_metre = match fields.get_field(Tag::ResolutionUnit, In::PRIMARY).map(|field| field.value.get_uint(0)) {
            None | Some(Some(2)) => Some(1.0 / 0.0254),
            Some(Some(3)) => Some(100.0),
            _ => None,
        };
        let density = per_metre.zip(number(Tag::XResolution).zip(number(Tag::YResolution)));
        self.carried.density = density.map(|(factor, (x, y))| [x, y].map(|n| (n * factor).round() as u32));
        self.carried.exif = carried_exif(&fields);
        let is_srgb;
        (self.exif, is_srgb) = described(&fields);
        is_srgb
    }
}

/// The fields of EXIF that hold of any picture made from the photograph.
const CARRIED: [Tag; 22] = [
    Tag::Make,
    Tag::Model,
    Tag::Artist,
    Tag::Copyright,
    Tag::DateTimeOriginal,
    Tag::SubSecTimeOriginal,
    Tag::OffsetTimeOriginal,
    Tag::ExposureTime,
    Tag::FNumber,
    Tag::PhotographicSensitivity,
    Tag::ExposureBiasValue,
    Tag::FocalLength,
    Tag::FocalLengthIn35mmFilm,
    Tag::FocalPlaneXResolution,
    Tag::FocalPlaneYResolution,
    Tag::FocalPlaneResolutionUnit,
    Tag::SubjectDistance,
    Tag::BodySerialNumber,
    Tag::LensMake,
    Tag::LensModel,
    Tag::LensSpecification,
    Tag::LensSerialNumber,
];

/// The structure of the carried fields; `None` if there are none.
fn carried_exif(fields: &exif::Exif) -> Option<Vec<u8>> {
    let mut writer = Writer::new();
    let carried = CARRIED.iter().filter_map(|tag| fields.get_field(*tag, In::PRIMARY));
    let count = carried.inspect(|field| writer.push_field(field)).count();
    let mut bytes = Cursor::new(Vec::new());
    (count > 0 && writer.write(&mut bytes, fields.little_endian()).is_ok()).then(|| bytes.into_inner())
}

/// Pixels per metre from the header of JFIF.
fn density_of_jfif(bytes: &[u8]) -> Option<[u32; 2]> {
    let [unit, x1, x0, y1, y0] = bytes.get(13..18)?.try_into().ok()?;
    let factor = if unit == 1 { 1.0 / 0.0254 } else { 100.0 };
    let is_stated = bytes.get(6..11)? == b"JFIF\0" && (unit == 1 || unit == 2);
    is_stated.then(|| [[x1, x0], [y1, y0]].map(|n| (f64::from(u16::from_be_bytes(n)) * factor).round() as u32))
}

/// The described fields of EXIF, and whether it states sRGB. `None` if it has none of the fields.
fn described(fields: &exif::Exif) -> (Option<Exif>, bool) {
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
