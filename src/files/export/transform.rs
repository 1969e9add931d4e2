//! A registration from a file: a report, or part of one.

use std::io::ErrorKind;
use std::path::Path;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::{ShadingReport, SizeReport};
use crate::base::{Decode, Error, Homography, Photometric, Region, Settings};
use crate::files::bounded_read;

/// The most bytes that are read, 16 MiB: a report with every level and iteration at its limit takes under 1 MiB.
const MAX_BYTES: u64 = 16 << 20;

/// What the file may look like, for whoever has got it wrong.
const SHAPE: &str =
    "parfocal reads a report.json or {\"tx_px\", \"ty_px\", \"rotation_deg\", \"scale\"}, perhaps with \"matrix\"";

/// Reads where T, and gain and offset if the file states them, should start.
///
/// Takes a whole `report.json`, an object with `transform` and perhaps `photometric`, or the transform object itself.
///
/// # Errors
/// [`Error::File`]: the file cannot be read, is not of one of these shapes, or a value is out of range.
pub fn read_transform(path: &Path) -> Result<(Homography, Option<Photometric>), Error> {
    text(path).and_then(|text| parse(&text)).map_err(|problem| Error::file(path, problem))
}

/// What the file of [`read_transform`] states of the pair that was registered.
#[derive(Clone, Copy, Debug, Default)]
pub struct PairOf {
    /// Size of the photographs.
    pub size: Option<SizeReport>,
    /// The part of I1 that its results are of.
    pub region: Option<Region>,
    /// How the gain of I2 varies with the place.
    pub shading: Option<ShadingReport>,
    /// How stored values became intensities.
    pub decode: Decode,
}

/// Reads it.
///
/// # Errors
/// As [`read_transform`].
pub fn read_pair_of(path: &Path) -> Result<PairOf, Error> {
    text(path).and_then(|text| pair_of(&text)).map_err(|problem| Error::file(path, problem))
}

fn pair_of(text: &str) -> Result<PairOf, String> {
    let file: Value = serde_json::from_str(text).map_err(|e| format!("is not JSON ({e}); {SHAPE}"))?;
    let shading = match file.get("shading") {
        None | Some(Value::Null) => None,
        Some(value) => Some(part(value, "shading")?),
    };
    let size = file.get("photograph").or(file.get("size")).and_then(|size| SizeReport::deserialize(size).ok());
    let region = file.get("region").and_then(|region| Region::deserialize(region).ok());
    let decode = file.get("settings").and_then(|settings| settings.get("decode"));
    let decode = decode.and_then(|decode| Decode::deserialize(decode).ok()).unwrap_or(Decode::None);
    Ok(PairOf { size, region, shading, decode })
}

fn text(path: &Path) -> Result<String, String> {
    bounded_read::text(path, MAX_BYTES).map_err(|e| match e.kind() {
        ErrorKind::FileTooLarge => format!("is too long for a transform; {SHAPE}"),
        _ => format!("cannot be read as a transform ({e}); check the path"),
    })
}

fn parse(text: &str) -> Result<(Homography, Option<Photometric>), String> {
    let file: Value = serde_json::from_str(text).map_err(|e| format!("is not JSON ({e}); {SHAPE}"))?;
    let start: Homography = part(file.get("transform").unwrap_or(&file), "transform")?;
    let start_photometric: Option<Photometric> = match file.get("photometric") {
        None | Some(Value::Null) => None,
        Some(value) => Some(part(value, "photometric")?),
    };
    startable(start, start_photometric)?;
    Ok((start, start_photometric))
}

/// Refuses a registration that no solve could start from.
pub(super) fn startable(start: Homography, photometric: Option<Photometric>) -> Result<(), String> {
    let asked = Settings { start, start_photometric: photometric.unwrap_or_default(), ..Settings::default() };
    asked.check().map_err(|e| format!("cannot be started from: {e}"))
}

fn part<T: DeserializeOwned>(value: &Value, name: &str) -> Result<T, String> {
    T::deserialize(value).map_err(|e| format!("holds no {name} that can be used ({e}); {SHAPE}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const T: &str = r#"{"tx_px": 1.5, "ty_px": -2, "rotation_deg": 90, "scale": 1.07}"#;

    #[test]
    fn all_three_shapes_are_read() {
        let (t, p) = parse(T).unwrap();
        assert_eq!((t.translation(), p), ([1.5, -2.0], None));
        assert!((t.rotation_deg() - 90.0).abs() < 1e-12 && (t.scale() - 1.07).abs() < 1e-12);
        assert_eq!(parse(&format!(r#"{{"transform": {T}, "photometric": null}}"#)).unwrap(), (t, None));
        let whole =
            format!(r#"{{"transform": {T}, "photometric": {{"gain": 1.1, "offset": -0.02}}, "converged": true}}"#);
        assert_eq!(parse(&whole).unwrap(), (t, Some(Photometric { gain: 1.1, offset: -0.02 })));
        let matrix = [[1.1, 0.02, 1.5], [0.0, 1.0, -2.0], [1e-5, 0.0, 1.0]];
        let homography = Homography::from_matrix(matrix).unwrap();
        let stored = serde_json::to_string(&homography).unwrap();
        assert!(stored.contains("\"matrix\":[[1.1,0.02,1.5]"), "{stored}");
        assert_eq!(parse(&stored).unwrap().0, homography);
    }

    #[test]
    fn what_cannot_be_used_says_why() {
        let cases = [
            ("", "is not JSON"),
            ("[1, 2]", "no transform"),
            ("7", "no transform"),
            (r#"{"tx_px": 1, "ty_px": 1, "rotation_deg": 0}"#, "scale"),
            (r#"{"tx_px": null, "ty_px": 1, "rotation_deg": 0, "scale": 1}"#, "null"),
            (r#"{"tx_px": 1e999, "ty_px": 1, "rotation_deg": 0, "scale": 1}"#, "is not JSON"),
            (r#"{"tx_px": 0, "ty_px": 1, "rotation_deg": 0, "scale": 0}"#, "scale is 0"),
            (
                r#"{"tx_px": 0, "ty_px": 0, "rotation_deg": 0, "scale": 1, "matrix": [[1,0,0],[0,-1,0],[0,0,1]]}"#,
                "has no inverse, or mirrors",
            ),
            (
                r#"{"tx_px": 0, "ty_px": 0, "rotation_deg": 0, "scale": 1, "matrix": [[1,0,0],[0,1,0],[1,0,1]]}"#,
                "perspective along x is 1",
            ),
            (r#"{"tx_px": 1e6, "ty_px": 1, "rotation_deg": 0, "scale": 1}"#, "translation x is 1000000"),
        ];
        for (text, expected) in cases {
            let problem = parse(text).unwrap_err();
            assert!(problem.contains(expected), "{text}: {problem}");
        }
        let bad_gain = format!(r#"{{"transform": {T}, "photometric": {{"gain": 0, "offset": 0}}}}"#);
        assert!(parse(&bad_gain).unwrap_err().contains("gain is 0"));
        let bad_shading = format!(r#"{{"transform": {T}, "shading": {{"range": [1, 1], "coefficients": [0.1]}}}}"#);
        assert!(pair_of(&bad_shading).unwrap_err().contains("holds no shading"));
        assert!(pair_of(T).unwrap().shading.is_none());
    }

    #[test]
    fn a_missing_file_is_named() {
        let message = read_transform(Path::new("no/such.json")).unwrap_err().to_string();
        assert!(message.starts_with("no/such.json: "), "{message}");
    }
}
