//! Reads registrations from files, and writes photographs that a registration moves.

use std::fmt::Display;
use std::io::ErrorKind;
use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::destination::{Destination, FileKind};
use super::image_files::{INTENSITY, PHOTOGRAPH, write_frame};
use super::report::{MAX_BYTES, Report, ShadingReport, SizeReport, with_header, write_json_to};
use super::single::write_file;
use super::staging::Staging;
use crate::base::{Brightness, Decode, Depth, Error, Frame, Homography, Photometric, Region, Settings};
use crate::files::bounded_read;
use crate::files::image_io::{Carried, Values};

/// The expected content of a registration file, for error messages.
const SHAPE: &str =
    "parfocal reads a report.json or {\"tx_px\", \"ty_px\", \"rotation_deg\", \"scale\"}, perhaps with \"matrix\"";

/// The registration of a pair or a focus sweep, from a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Registration {
    /// The frames in the order in which their files were passed.
    pub frames: Vec<FrameRegistration>,
    /// Index of the reference.
    pub reference: usize,
    /// Width and height of the frames.
    pub size: Option<[u32; 2]>,
    /// The part of the reference that the results cover.
    pub region: Option<Region>,
    /// The decoding of stored values to intensities.
    pub decode: Decode,
}

/// The registration of a frame to the reference, as a file states it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct FrameRegistration {
    /// T: the reference's pixel x lies at T x in this frame.
    pub transform: Homography,
    gain: Option<f64>,
    offset: Option<f64>,
    /// Variation of the gain, where stated.
    pub shading: Option<ShadingReport>,
}

impl FrameRegistration {
    /// Gain and offset, where both are stated.
    pub fn photometric(&self) -> Option<Photometric> {
        self.gain.zip(self.offset).map(|(gain, offset)| Photometric { gain, offset })
    }

    /// Brightness of a frame of this size, if gain and offset are stated.
    pub fn brightness(&self, size: [u32; 2]) -> Option<Brightness> {
        let unchanged = Brightness::identity(size);
        let photometric = self.photometric()?;
        Some(self.shading.map_or(Brightness { photometric, ..unchanged }, |shading| shading.with(photometric)))
    }

    /// Refuses a registration from which no solve can start.
    fn check(&self) -> Result<(), String> {
        let start_photometric = self.photometric().unwrap_or_default();
        let settings = Settings { start: self.transform, start_photometric, ..Settings::default() };
        settings.check().map_err(|e| unusable(format!("cannot be started from: {e}")))
    }
}

/// The problem of a file without a transform that can be used.
fn unusable(problem: impl Display) -> String {
    format!("holds no transform that can be used ({problem}); {SHAPE}")
}

/// The keys of a report that a registration needs.
#[derive(Deserialize)]
struct Stated {
    frames: Vec<FrameRegistration>,
    #[serde(default)]
    order: Vec<usize>,
    #[serde(default)]
    reference: usize,
    photograph: Option<SizeReport>,
    size: Option<SizeReport>,
    region: Option<Region>,
    values: Option<Values>,
}

impl Registration {
    /// Reads a registration: any report with `frames`, a single frame of such a report, or the transform of a frame,
    /// optionally with `gain` and `offset`. A single frame is the second frame of a pair.
    ///
    /// # Errors
    /// [`Error::File`] if the file cannot be read, does not hold a registration, or a value is out of range.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = bounded_read::text(path, MAX_BYTES).map_err(|e| match e.kind() {
            ErrorKind::FileTooLarge => format!("is too long for a transform; {SHAPE}"),
            _ => format!("cannot be read as a transform ({e}); check the path"),
        });
        text.and_then(|text| parse(&text)).map_err(|problem| Error::file(path, problem))
    }

    /// The second frame of a pair; `None` for a sweep.
    pub fn second(&self) -> Option<&FrameRegistration> {
        if self.frames.len() == 2 { self.frames.get(1 - self.reference) } else { None }
    }
}

fn parse(text: &str) -> Result<Registration, String> {
    let mut file: Value = serde_json::from_str(text).map_err(|e| format!("is not JSON ({e}); {SHAPE}"))?;
    if file.get("frames").is_some() {
        let stated = Stated::deserialize(&file).map_err(unusable)?;
        stated.frames.iter().try_for_each(FrameRegistration::check)?;
        return stated.registration().map_err(|problem| format!("holds no registration ({problem}); {SHAPE}"));
    }
    if file.get("transform").is_none() && file.is_object() {
        let transform = file.clone();
        file["transform"] = transform;
    }
    let second = FrameRegistration::deserialize(file).map_err(unusable)?;
    second.check()?;
    let first = FrameRegistration { transform: Homography::IDENTITY, gain: None, offset: None, shading: None };
    Ok(Registration { frames: vec![first, second], reference: 0, size: None, region: None, decode: Decode::None })
}

impl Stated {
    /// The registration, with frames in the order in which their files were passed.
    fn registration(self) -> Result<Registration, String> {
        let Self { mut frames, order, mut reference, .. } = self;
        let count = frames.len();
        if count < 2 || reference >= count {
            return Err(format!("{count} frames, the reference {reference}"));
        }
        if order.len() == count {
            let mut passed: Vec<usize> = (0..count).collect();
            passed.sort_by_key(|n| order[*n]);
            frames = passed.iter().map(|n| frames[*n]).collect();
            reference = passed.iter().position(|n| *n == reference).unwrap_or(reference);
        }
        Ok(Registration {
            frames,
            reference,
            size: self.photograph.or(self.size).map(Into::into),
            region: self.region,
            decode: self.values.map_or(Decode::None, |values| values.decode),
        })
    }
}

/// Writes a value as a JSON file that states its kind. Creates the folder of the file if it is missing. Replaces a file
/// of the same kind; the [`Destination`] must force the replacement of any other file. On failure the earlier file
/// stays unchanged.
///
/// # Errors
/// [`Error::File`].
pub fn write_json<'d>(file: impl Into<Destination<'d>>, kind: FileKind, value: &impl Serialize) -> Result<(), Error> {
    write_file(file.into(), kind, |w| match kind.report() {
        Some(report) => write_json_to(w, &with_header(report, value)),
        None => write_json_to(w, value),
    })
}

/// Writes the report of a registration into a file. Existing files are handled as in [`write_json`].
///
/// # Errors
/// [`Error::File`].
pub fn write_report<'d>(file: impl Into<Destination<'d>>, report: &Report) -> Result<(), Error> {
    write_file(file.into(), FileKind::Registration, |w| write_json_to(w, report))
}

/// Ending of the file of a moved photograph: PNG for integers, EXR for floats.
pub fn registered_ending(depth: Depth) -> &'static str {
    if depth == Depth::F32 { "exr" } else { "png" }
}

/// Kind of that file.
pub fn registered_kind(depth: Depth) -> FileKind {
    if depth == Depth::F32 { FileKind::Exr } else { FileKind::Png }
}

/// Writes moved photographs, all of this sample type, into files of these names: all or none. Integers become PNG with
/// the metadata of their photograph, floats EXR. Creates the folder if it is missing. Replaces files of parfocal; the
/// [`Destination`] must force the replacement of others. Only one photograph at a time is in memory.
///
/// # Errors
/// [`Error::File`]; errors of the frames.
pub fn write_registered<'d, E: From<Error>>(
    folder: impl Into<Destination<'d>>,
    depth: Depth,
    frames: impl Iterator<Item = Result<(String, Frame, Arc<Carried>), E>>,
) -> Result<(), E> {
    let mut staging = Staging::of_kind(folder.into(), registered_kind(depth))?;
    for frame in frames {
        let (name, frame, carried) = frame?;
        staging.add(&name, |w| write_frame(w, &frame, &carried, [&PHOTOGRAPH, &INTENSITY]))?;
    }
    Ok(staging.place()?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::image_io::Photograph;

    const T: &str = r#"{"tx_px": 1.5, "ty_px": -2, "rotation_deg": 90, "scale": 1.07}"#;

    fn second(text: &str) -> FrameRegistration {
        *parse(text).unwrap().second().unwrap()
    }

    #[test]
    fn transforms_frames_and_reports_are_read() {
        let found = second(T);
        assert_eq!((found.transform.translation(), found.photometric()), ([1.5, -2.0], None));
        assert!(
            (found.transform.rotation_deg() - 90.0).abs() < 1e-12 && (found.transform.scale() - 1.07).abs() < 1e-12
        );
        assert_eq!(second(&format!(r#"{{"transform": {T}, "shading": null}}"#)), found);
        let bright = Some(Photometric { gain: 1.1, offset: -0.02 });
        let frame = format!(r#"{{"transform": {T}, "gain": 1.1, "offset": -0.02}}"#);
        assert_eq!(second(&frame), FrameRegistration { gain: Some(1.1), offset: Some(-0.02), ..found });
        assert_eq!(second(&T.replace('}', r#", "gain": 1.1, "offset": -0.02}"#)).photometric(), bright);
        let report =
            format!(r#"{{"frames": [{frame}, {{"transform": {T}}}, {frame}], "order": [2, 0, 1], "reference": 1}}"#);
        let sweep = parse(&report).unwrap();
        assert_eq!((sweep.frames.len(), sweep.reference, sweep.second()), (3, 0, None));
        assert_eq!((sweep.frames[0].photometric(), sweep.frames[2].photometric()), (None, bright));
        let matrix = [[1.1, 0.02, 1.5], [0.0, 1.0, -2.0], [1e-5, 0.0, 1.0]];
        let homography = Homography::from_matrix(matrix).unwrap();
        let stored = serde_json::to_string(&homography).unwrap();
        assert!(stored.contains("\"matrix\":[[1.1,0.02,1.5]"), "{stored}");
        assert_eq!(second(&stored).transform, homography);
    }

    #[test]
    fn a_moved_photograph_carries_profile_exif_and_resolution() {
        use exif::{Field, In, Rational, Tag, Value, experimental::Writer};
        use image::codecs::jpeg::{JpegEncoder, PixelDensity};
        use image::{ExtendedColorType, ImageEncoder};

        let folder = tempfile::TempDir::new().unwrap();
        let focal = Value::Rational(vec![Rational { num: 100, denom: 1 }]);
        let fields = [(Tag::Orientation, Value::Short(vec![6])), (Tag::FocalLength, focal)].map(|(tag, value)| Field {
            tag,
            ifd_num: In::PRIMARY,
            value,
        });
        let mut writer = Writer::new();
        fields.iter().for_each(|field| writer.push_field(field));
        let mut exif = std::io::Cursor::new(Vec::new());
        writer.write(&mut exif, false).unwrap();
        let file = folder.path().join("a.jpg");
        let mut encoder = JpegEncoder::new(std::fs::File::create(&file).unwrap());
        encoder.set_pixel_density(PixelDensity::dpi(300));
        encoder.set_exif_metadata(exif.into_inner()).unwrap();
        encoder.set_icc_profile(moxcms::ColorProfile::new_adobe_rgb().encode().unwrap()).unwrap();
        encoder.write_image(&[7; 5 * 3 * 3], 5, 3, ExtendedColorType::Rgb8).unwrap();
        let photograph = Photograph::open(&file).unwrap();
        let input = photograph.describe();
        let frame = photograph.decode().unwrap();
        let moved = ("a.png".to_string(), frame.clone(), input.carried.clone());
        write_registered(folder.path(), Depth::U8, std::iter::once(Ok::<_, Error>(moved))).unwrap();
        let photograph = Photograph::open(&folder.path().join("a.png")).unwrap();
        let output = photograph.describe();
        assert_eq!((output.carried, output.encoding), (input.carried.clone(), Some("gamma 2.20".to_string())));
        assert_eq!(output.exif.and_then(|exif| exif.focal_length_mm), Some(100.0));
        assert_eq!(input.carried.density, Some([11_811; 2]));
        // The pixels are upright, and the orientation is not repeated.
        assert!(photograph.decode().unwrap() == frame && frame.height() == 5);
    }

    #[test]
    fn an_unusable_file_is_an_error_with_the_reason() {
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
                "singular or mirrors",
            ),
            (
                r#"{"tx_px": 0, "ty_px": 0, "rotation_deg": 0, "scale": 1, "matrix": [[1,0,0],[0,1,0],[1,0,1]]}"#,
                "perspective of start is 1,",
            ),
            (r#"{"tx_px": 1e6, "ty_px": 1, "rotation_deg": 0, "scale": 1}"#, "is 1000000"),
            (r#"{"frames": []}"#, "0 frames"),
        ];
        for (text, expected) in cases {
            let problem = parse(text).unwrap_err();
            assert!(problem.contains(expected), "{text}: {problem}");
        }
        let dark = format!(r#"{{"transform": {T}, "gain": 0, "offset": 0}}"#);
        assert!(parse(&dark).unwrap_err().contains("the gain of start_photometric is 0"));
        let bad_shading = format!(r#"{{"transform": {T}, "shading": {{"range": [1, 1], "coefficients": [0.1]}}}}"#);
        assert!(parse(&bad_shading).unwrap_err().contains("no transform that can be used"));
    }

    #[test]
    fn a_missing_file_is_named() {
        let message = Registration::read(Path::new("no/such.json")).unwrap_err().to_string();
        assert!(message.starts_with("no/such.json: "), "{message}");
    }
}
