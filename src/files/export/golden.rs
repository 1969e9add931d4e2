//! The file of a golden part that was taught from several good parts: one EXR.

use std::borrow::Cow;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::destination::{Destination, FileKind};
use super::image_files::{Description, write_channels};
use super::report::{Kind, PROGRAM, UNITS};
use super::single::write_file;
use crate::base::{Channels, Decode, Error, Frame};
use crate::files::image_io::{self, NamedChannels};
use crate::metric::inspect::{Heights, PlacementRange};

/// The channels of the heights.
const FIELDS: [&str; 4] = ["Y", "standard_deviation", "part_standard_deviation", "evidence"];

/// The channels of the picture.
const PICTURE: [&str; 3] = ["R", "G", "B"];

/// Units of heights.
const PX2: &str = "px²";

/// A golden part: what good parts have in common, at the pixels of the first.
#[derive(Clone, Debug)]
pub struct GoldenPart {
    /// How it was taught.
    pub report: GoldenReport,
    /// The mean height, the standard deviation of a good part from it, that of one good part, and the evidence for it.
    pub heights: Heights,
    /// The fused image of the first good part, to which parts are registered.
    pub picture: Frame,
}

/// How a golden part was taught: the comments of its file, as JSON.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct GoldenReport {
    program: Cow<'static, str>,
    kind: Kind,
    /// Version of parfocal that wrote it.
    pub version: Cow<'static, str>,
    /// The good parts. Positions are stated on the pixels of the first.
    pub parts: Vec<TaughtPart>,
    /// The quantity: `depth`, `relative blur` or `focus`.
    pub quantity: String,
    /// Unit of the heights and of the tolerances.
    pub unit: Cow<'static, str>,
    /// The tolerance at which the good parts were compared with each other.
    pub tolerance: f64,
    /// Whether the tolerance was found from the good parts, and not stated.
    pub suggested: bool,
    /// The settings that heights depend on, of all good parts.
    pub settings: Value,
    /// By how much the evidence of a good part may fall short of that of the golden part at a pixel, as a factor.
    #[serde(default = "one")]
    pub spread: f32,
    /// The width of the smallest defect as high as the tolerance that is seen at 95 % of the pixels, px; absent if there
    /// is none, or it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub smallest_px: Option<f64>,
    /// How parts may lie on the picture, if three or more good parts have taught it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub placement: Option<PlacementRange>,
    /// How the two photographs of a part may lie to each other.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub registration: Option<PlacementRange>,
}

/// A good part that a golden part was taught from.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct TaughtPart {
    /// The folder of its results.
    pub folder: String,
    /// The least tolerance at which it is go against the others.
    pub least_tolerance: f64,
}

/// The spread of good parts that have one texture.
fn one() -> f32 {
    1.0
}

impl GoldenReport {
    /// The report of a golden part; `tolerance` and whether it was suggested.
    pub fn new(
        parts: Vec<TaughtPart>,
        (quantity, unit): (&str, &'static str),
        (tolerance, suggested): (f64, bool),
        settings: Value,
    ) -> Self {
        Self {
            program: PROGRAM.into(),
            kind: Kind::Golden,
            version: env!("CARGO_PKG_VERSION").into(),
            parts,
            quantity: quantity.to_string(),
            unit: unit.into(),
            tolerance,
            suggested,
            settings,
            spread: one(),
            smallest_px: None,
            placement: None,
            registration: None,
        }
    }

    /// The unit, if it is one of heights.
    pub fn known_unit(&self) -> Option<&'static str> {
        UNITS.into_iter().chain([PX2]).find(|unit| *unit == self.unit)
    }

    /// The problem of a report from a file.
    fn problem(&self) -> Option<&'static str> {
        match self {
            _ if self.program != PROGRAM || self.kind != Kind::Golden => Some("its comments are of another kind"),
            _ if self.known_unit().is_none() => Some("its unit is unknown"),
            _ if !(self.spread >= 1.0 && self.spread.is_finite()) => Some("its spread is no number from 1"),
            _ if !(self.tolerance >= 0.0 && self.tolerance.is_finite()) => Some("its tolerance is no number from 0"),
            _ => None,
        }
    }
}

/// Writes a golden part. Replaces an earlier one.
///
/// # Errors
/// [`Error::File`].
pub fn write_golden<'d>(out: impl Into<Destination<'d>>, golden: &GoldenPart) -> Result<(), Error> {
    let GoldenPart { report, heights, picture } = golden;
    let out = out.into();
    let report = &GoldenReport { spread: heights.spread, ..report.clone() };
    let json = serde_json::to_string(report).map_err(|e| Error::file(out.path, e.to_string()))?;
    let count = picture.format().channels.count() as usize;
    let stored = picture.intensities(Decode::None);
    let planes: Vec<Vec<f32>> = (0..count).map(|c| stored.iter().skip(c).step_by(count).copied().collect()).collect();
    // A grey picture is the same in all three.
    let picture = PICTURE.iter().enumerate().map(|(c, name)| (*name, &planes[c.min(count - 1)][..]));
    let Heights { values, deviation, part_deviation, evidence, .. } = heights;
    let fields = FIELDS.into_iter().zip([&values[..], deviation, part_deviation, evidence]);
    let channels: Vec<(&str, &[f32])> = fields.chain(picture).collect();
    let units = ascii(&report.unit.replace(PX2, "px^2"));
    let description = Description { units: units.into(), comments: ascii(&json).into() };
    let size = (heights.width, heights.height);
    write_file(out, FileKind::Golden, |w| write_channels(w, size, &channels, &description))
}

/// Escapes what is not ASCII as in JSON, since texts of EXR are ASCII.
fn ascii(json: &str) -> String {
    let escaped = |c: char| match c.is_ascii() {
        true => c.to_string(),
        false => c.encode_utf16(&mut [0; 2]).iter().map(|unit| format!("\\u{unit:04x}")).collect(),
    };
    json.chars().map(escaped).collect()
}

/// Reads a golden part.
///
/// # Errors
/// [`Error::File`].
pub fn read_golden(path: &Path) -> Result<GoldenPart, Error> {
    let invalid = |problem: String| {
        Error::file(
            path,
            format!("is no golden part ({problem}); write one with parfocal teach, or give folders of results"),
        )
    };
    let NamedChannels { size: [width, height], comments, fields } =
        image_io::read_channels(path, &[&FIELDS[..], &PICTURE].concat())?;
    let report: GoldenReport = serde_json::from_str(&comments).map_err(|e| invalid(e.to_string()))?;
    if let Some(problem) = report.problem() {
        return Err(invalid(problem.to_string()));
    }
    let [values, deviation, part_deviation, evidence, r, g, b] =
        <[Vec<f32>; 7]>::try_from(fields).map_err(|_| invalid("a channel is missing".to_string()))?;
    if evidence.iter().chain(&part_deviation).any(|value| *value < 0.0) {
        return Err(invalid("a standard deviation or evidence is below 0".to_string()));
    }
    let samples = r.into_iter().zip(g).zip(b).flat_map(|((r, g), b)| [r, g, b]).collect();
    let picture = Frame::new(width, height, Channels::Rgb, crate::base::Samples::F32(samples)).map_err(invalid)?;
    let heights = Heights::new([width, height], &values, &deviation)?;
    let heights = heights.with_part_deviation(part_deviation)?.with_evidence(evidence)?;
    let heights = Heights { spread: report.spread, ..heights };
    Ok(GoldenPart { report, heights, picture })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn golden() -> GoldenPart {
        let mut values: Vec<f32> = (0..12).map(|i| i as f32).collect();
        values[5] = f32::NAN;
        let heights = Heights::new([4, 3], &values, &[0.5; 12]).unwrap().with_evidence(vec![7.0; 12]).unwrap();
        let parts = vec![TaughtPart { folder: "gut/größe".to_string(), least_tolerance: 0.3 }];
        let settings = serde_json::json!({ "levels": 3 });
        let report = GoldenReport::new(parts, ("relative blur", "px²"), (0.4, true), settings);
        GoldenPart { report, heights, picture: Frame::gray(4, 3, vec![0.25; 12]).unwrap() }
    }

    #[test]
    fn a_golden_part_is_read_as_it_was_written() {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("golden.exr");
        let written = golden();
        write_golden(&file, &written).unwrap();
        let read = read_golden(&file).unwrap();
        assert_eq!(read.report.parts[0].folder, "gut/größe");
        assert_eq!((read.report.known_unit(), read.report.tolerance), (Some("px²"), 0.4));
        assert_eq!(read.report.settings, written.report.settings);
        assert_eq!(format!("{:?}", read.heights), format!("{:?}", written.heights), "with NaN");
        assert_eq!(read.picture.intensities(Decode::None), [0.25; 36]);
        write_golden(&file, &written).unwrap();
    }

    #[test]
    fn other_files_are_refused_by_name() {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("golden.exr");
        let refused = |part: &str| {
            let problem = read_golden(&file).unwrap_err().to_string();
            assert!(problem.contains("golden.exr: ") && problem.contains(part), "{problem}");
        };
        std::fs::write(&file, "my notes").unwrap();
        refused("");
        assert!(write_golden(&file, &golden()).unwrap_err().to_string().contains("--force"));
        let mut wrong = golden();
        wrong.report.tolerance = -1.0;
        std::fs::remove_file(&file).unwrap();
        write_golden(&file, &wrong).unwrap();
        refused("its tolerance is no number from 0");
        wrong = golden();
        wrong.report.unit = "cubits".into();
        write_golden(&file, &wrong).unwrap();
        refused("its unit is unknown");
        let bytes = std::fs::read(&file).unwrap();
        std::fs::write(&file, &bytes[..bytes.len() / 2]).unwrap();
        refused("damaged");
    }
}
