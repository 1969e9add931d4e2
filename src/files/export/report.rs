//! `report.json`: the inputs of results, their contents, and how they were made.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::ops::RangeInclusive;
use std::path::{Component, Path};

use serde::{Deserialize, Deserializer, Serialize};
use serde_json::ser::{Formatter, PrettyFormatter, Serializer};
use serde_json::{Map, Value};

use super::image_files::Description;
use super::scale::{Nearer, Quantiles};
use crate::base::{
    Brightness, DeviceInfo, Error, Estimate, Homography, Lens, Method, Photometric, Region, Settings, Shading,
};
use crate::engine::{LevelHistory, OtherMotion, Registered, Solution, Timings, TransformDeviation};
use crate::files::bounded_read;
use crate::files::bounded_read::Hash;
use crate::files::image_io::{self, Input, Values};
use crate::metric::measure::Line;
use crate::solve::sweep::{Positions, RegisteredSweep, Sweep, SweepDepth};

/// The report of results.
pub const REPORT_FILE: &str = "report.json";

/// The range of the size of a pixel on the surface, µm.
pub const PIXEL_SIZES_UM: RangeInclusive<f64> = 1e-6..=1e6;

/// Units of the focus of a sweep.
pub(super) const UNITS: [&str; 3] = ["settings", "1/m", "mm"];

/// Greatest number of bytes of a report that are read, 16 MiB. A report with every level and iteration at its limit has
/// less than 1 MiB.
pub(super) const MAX_BYTES: u64 = 16 << 20;

/// The value of `program` in every JSON file of parfocal.
pub(super) const PROGRAM: &str = "parfocal";

/// The version of this program.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// The subject of a JSON file of parfocal; its key is `kind`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// The solve of a pair.
    #[default]
    Pair,
    /// The solve of a focus sweep.
    Sweep,
    /// The registration of a pair or a focus sweep.
    Registration,
    /// A synthetic pair or focus sweep, with its truth.
    Simulation,
    /// A batch of pairs and focus sweeps.
    Batch,
    /// The inspection of a part.
    Inspection,
    /// A golden part.
    Golden,
    /// Repeated measurements.
    Repeatability,
    /// A calibrated lens.
    Lens,
    /// A benchmark.
    Bench,
    /// An evaluation of the program.
    Evaluation,
}

impl Kind {
    /// The kind that a JSON file states; `None` for a file of another program.
    pub(crate) fn of(file: &Value) -> Option<Self> {
        (file.get("program")? == PROGRAM).then(|| Self::deserialize(file.get("kind")?).ok()).flatten()
    }
}

/// The first keys of a JSON file of parfocal.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Header {
    program: &'static str,
    kind: Kind,
}

impl Header {
    /// Header of a file of this kind.
    pub fn new(kind: Kind) -> Self {
        Self { program: PROGRAM, kind }
    }
}

/// The report of a pair, a focus sweep or a registration. A quantity without a valid pixel is `null`; a key that does
/// not apply is absent. Later versions may add keys, but do not rename them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// The program: "parfocal".
    pub program: Cow<'static, str>,
    /// The subject of the report.
    pub kind: Kind,
    /// Version of parfocal that wrote it.
    pub version: Cow<'static, str>,
    /// I1 and I2 of a pair; the frames of a sweep in the order of their focus.
    pub frames: Vec<FrameReport>,
    /// Index of the frame whose pixels the results have, from 0.
    pub reference: usize,
    /// Index of each frame among the files that were passed, from 0; empty for a pair.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub order: Vec<usize>,
    /// Photographs in the folder of a sweep that are not frames of it, by their names.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<String>,
    /// The files that hold a value for each pixel.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub fields: Vec<FieldReport>,
    /// Method of the solve.
    pub method: Method,
    /// Settings of the solve.
    pub settings: Settings,
    /// The decoding of stored values to intensities.
    pub values: Values,
    /// Size of the results.
    pub size: SizeReport,
    /// Size of the frames. The transforms are stated about their centre.
    pub photograph: SizeReport,
    /// The part of the reference frame that the results cover.
    pub region: Region,
    /// Pyramid levels of a pair, coarse to fine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub levels: Option<Vec<LevelReport>>,
    /// Whether the finest level of a pair converged to a solution that the images support.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub converged: Option<bool>,
    /// The standard deviation of the registration of a pair, if it is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub transform_deviation: Option<TransformDeviation>,
    /// Another motion model that fits as well, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub other_motion: Option<OtherMotion>,
    /// Smoothness α of the finest level of a pair, as set or as estimated.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "number_or_null")]
    pub regularization: Option<f64>,
    /// The estimated shape of the kernel: 0 is a Gaussian, 1 a disk. `None` if it was not estimated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kernel_shape: Option<f64>,
    /// The standard deviation of the scale of V of a pair, as a share of V. The uncertainty includes it.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "number_or_null")]
    pub scale_deviation: Option<f64>,
    /// Range of V of a pair, px².
    #[serde(skip_serializing_if = "Option::is_none")]
    pub relative_blur: Option<RangeReport>,
    /// Range of the focus of a sweep, in `focus_unit`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focus: Option<RangeReport>,
    /// Unit of the positions of a sweep: "settings", "1/m" if focus distances are known, "mm" for a stage.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focus_unit: Option<Cow<'static, str>>,
    /// Coefficient of the blur of a sweep: its growth with the squared distance from the focus, px² per squared
    /// `focus_unit`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub blur_rate_px2: Option<f64>,
    /// Fraction of the pixels that are valid.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "number_or_null")]
    pub valid_fraction: Option<f64>,
    /// Mean confidence of the valid pixels of a pair.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "number_or_null")]
    pub mean_confidence: Option<f64>,
    /// Fraction of the valid pixels of a pair at the limit of |V|.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "number_or_null")]
    pub saturated_fraction: Option<f64>,
    /// Fraction of the valid pixels of a pair below the limit of |V| that the last step moved by more than a tenth of
    /// their standard deviation.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "number_or_null")]
    pub unsettled_fraction: Option<f64>,
    /// Fraction of the valid pixels of a pair that are not measured because of what noise and blur do not explain.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "number_or_null")]
    pub unexplained_fraction: Option<f64>,
    /// Pixels of a sweep that no frame has in focus.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub never_in_focus: Option<NeverReport>,
    /// Pixels of a pair that are marked as not measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub texture: Option<TextureReport>,
    /// Whether the field curvature from a flat reference was subtracted from V.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub flattened: bool,
    /// Whether the first (1) or the last (2) frame is focused nearest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nearer: Option<u8>,
    /// The source of `nearer`: the lens, the focus distances, the user, or the default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nearer_by: Option<NearerBy>,
    /// Depth in mm, if it is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth: Option<DepthReport>,
    /// Size of a pixel on the surface, µm, if it is stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixel_size_um: Option<f64>,
    /// Scale of `depth16.png` and `depth16.tiff`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth16: Option<Depth16Report>,
    /// The parameters of the exported surface.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface: Option<SurfaceReport>,
    /// Step heights and profiles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measurements: Option<Measurements>,
    /// Warnings for the user; one sentence each.
    pub warnings: Vec<String>,
    /// The device that solved.
    pub device: DeviceReport,
    /// Whether the Khronos validation layer was enabled.
    pub validated: bool,
    /// SHA-256 of version, settings and flags, which `batch --resume` compares; empty if the caller did not set it.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub request_sha256: String,
    /// The photographs' files; empty if the frames did not come from files.
    pub inputs: Vec<Input>,
    /// The files of the results, including the report. A later run replaces or removes only these files.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub files: Vec<String>,
    /// Size and hash of each file but the report.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub hashes: BTreeMap<String, Hash>,
    /// Durations.
    pub timings_ms: TimingsReport,
}

/// Reads a number. Reads `null` as NaN, since JSON has no NaN.
fn number_or_null<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    Option::deserialize(deserializer).map(|number| Some(number.unwrap_or(f64::NAN)))
}

/// A frame and its registration to the reference.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameReport {
    /// The file as passed; empty if the frame did not come from a file.
    pub file: String,
    /// T: the reference's pixel x lies at T x in this frame.
    pub transform: Homography,
    /// Gain and offset, which map the frame's intensities to the reference's.
    #[serde(flatten)]
    pub photometric: Photometric,
    /// Variation of the gain over the frame.
    pub shading: ShadingReport,
    /// Fraction of its pixels that are clipped, of those that no mask excludes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clipped_fraction: Option<f64>,
    /// Focus setting of a frame of a sweep.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position: Option<f64>,
    /// Focus distance, or position along the axis of a stage, mm, as stated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focus_mm: Option<f64>,
}

impl FrameReport {
    fn new(transform: Homography, brightness: &Brightness) -> Self {
        let (photometric, shading) = (brightness.photometric, ShadingReport::of(brightness));
        let (file, clipped_fraction, position, focus_mm) = (String::new(), None, None, None);
        Self { file, transform, photometric, shading, clipped_fraction, position, focus_mm }
    }

    /// The frames of a pair: I1, which is the reference, and I2.
    fn pair(photograph: [u32; 2], transform: Homography, brightness: &Brightness, clipped: [f64; 2]) -> Vec<Self> {
        let first = Self::new(Homography::IDENTITY, &Brightness::identity(photograph));
        let frames = [first, Self::new(transform, brightness)].into_iter().zip(clipped);
        frames.map(|(frame, clipped)| Self { clipped_fraction: Some(clipped), ..frame }).collect()
    }

    /// The frames of a sweep; `files` are in the order in which they were passed.
    fn sweep(found: &RegisteredSweep, files: &[String]) -> Vec<Self> {
        let frame = |(n, file): (usize, &usize)| Self {
            file: files.get(*file).cloned().unwrap_or_default(),
            clipped_fraction: Some(found.clipped_fractions[n]),
            position: Some(found.positions[n]),
            focus_mm: found.stated.millimetres().map(|at| at[n]),
            ..Self::new(found.transforms[n], &found.brightness[n])
        };
        found.order.iter().enumerate().map(frame).collect()
    }

    /// Gain, offset and shading.
    pub fn brightness(&self) -> Brightness {
        self.shading.with(self.photometric)
    }
}

/// A file that holds a value for each pixel.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FieldReport {
    /// Name of the field.
    pub name: Cow<'static, str>,
    /// Its file.
    pub file: Cow<'static, str>,
    /// Unit of its values, ASCII.
    pub unit: Cow<'static, str>,
    /// Meaning of its values.
    pub meaning: Cow<'static, str>,
}

impl FieldReport {
    pub(super) fn new(name: &'static str, file: &'static str, description: &Description) -> Self {
        let (unit, meaning) = (description.units.clone(), description.comments.clone());
        Self { name: name.into(), file: file.into(), unit, meaning }
    }
}

/// Width and height, px.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SizeReport {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl From<[u32; 2]> for SizeReport {
    fn from([width, height]: [u32; 2]) -> Self {
        Self { width, height }
    }
}

impl From<SizeReport> for [u32; 2] {
    fn from(size: SizeReport) -> Self {
        [size.width, size.height]
    }
}

/// Variation of the gain over a photograph.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ShadingReport {
    /// Least and greatest factor; their mean over the photograph is 1.
    pub range: [f64; 2],
    /// Coefficients of the polynomial of [`Shading`].
    pub coefficients: [f64; Shading::TERMS],
    /// The part of the photograph that the polynomial is defined over, px.
    pub region: Region,
}

impl ShadingReport {
    /// Shading of a frame.
    pub fn of(brightness: &Brightness) -> Self {
        let Brightness { shading, part, .. } = brightness;
        Self { range: shading.range(), coefficients: shading.coefficients, region: *part }
    }

    /// Brightness with this shading, gain and offset.
    pub fn with(&self, photometric: Photometric) -> Brightness {
        let shading = Shading { coefficients: self.coefficients };
        Brightness { photometric, shading, part: self.region }
    }

    /// Whether the gain varies by more than 2 % in either direction.
    pub fn is_significant(&self) -> bool {
        self.range.iter().any(|factor| (factor - 1.0).abs() > 0.02)
    }
}

/// Pixels of a pair that are marked as not measured: they lack texture, or V is at its limit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TextureReport {
    /// Standard deviation of V above which a pixel is marked, px².
    pub max_uncertainty_px2: f32,
    /// Fraction of all pixels that are marked.
    pub marked_fraction: f64,
}

impl TextureReport {
    /// The least limit, px².
    const LEAST: f32 = 1.0;

    /// Marks pixels with a standard deviation above half of the range from the 1st to the 99th percentile of V, and
    /// above 1 px². Such a pixel may be in either half of the range.
    pub fn of(solution: &Solution) -> Self {
        let mut quantiles = Quantiles::of(&solution.relative_blur);
        let max = match [0.01, 0.99].map(|p| quantiles.at(p)) {
            [Some(low), Some(high)] => (0.5 * (high - low)).max(Self::LEAST),
            _ => Self::LEAST,
        };
        Self::beyond(max, &solution.uncertainty_without_scale())
    }

    /// Marks pixels with a standard deviation above this limit, px².
    pub fn beyond(max_uncertainty_px2: f32, uncertainty: &[f32]) -> Self {
        let mut report = Self { max_uncertainty_px2, marked_fraction: 0.0 };
        let marked = report.marked(uncertainty).iter().filter(|marked| **marked).count();
        report.marked_fraction = marked as f64 / uncertainty.len().max(1) as f64;
        report
    }

    /// The marked pixels.
    pub(super) fn marked(&self, uncertainty: &[f32]) -> Vec<bool> {
        uncertainty.iter().map(|&deviation| deviation > self.max_uncertainty_px2).collect()
    }
}

/// One pyramid level.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LevelReport {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Number of outer iterations.
    pub iterations: usize,
    /// Energy per valid pixel after each iteration.
    pub energy: Vec<Option<f64>>,
}

/// Range of a field over its valid pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RangeReport {
    /// Least value.
    pub min: Option<f32>,
    /// Greatest value.
    pub max: Option<f32>,
    /// Median.
    pub median: Option<f32>,
}

impl RangeReport {
    /// Range of the finite values.
    pub fn of(values: &[f32]) -> Self {
        let mut quantiles = Quantiles::of(values);
        Self { min: quantiles.at(0.0), max: quantiles.at(1.0), median: quantiles.at(0.5) }
    }
}

/// Pixels of a sweep that no frame has in focus, by side.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NeverReport {
    /// Pixels before the first frame.
    pub before_first_px: usize,
    /// Pixels beyond the last frame.
    pub beyond_last_px: usize,
}

/// The source of the statement which image is focused nearer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NearerBy {
    /// The focus distances of the lens.
    Lens,
    /// The focus distances of the frames.
    Distances,
    /// The user.
    Stated,
    /// No source; it is the default.
    Assumed,
}

/// Depth in mm; `null` if no pixel has a depth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DepthReport {
    /// Least, greatest and median depth, mm.
    #[serde(flatten)]
    pub range: RangeReport,
    /// Median of its standard deviation, mm.
    pub median_deviation: Option<f32>,
    /// Valid pixels without a depth: out of the range of the lens model, at the limit of |V|, or focused beyond
    /// infinity.
    pub out_of_range: usize,
    /// The lens of a pair.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lens: Option<Lens>,
    /// Whether the depth of a sweep is a position along the axis of a stage, not a distance from the lens.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stage: Option<bool>,
}

impl DepthReport {
    pub(super) fn new(depth: &[f32], deviation: &[f32], out_of_range: usize) -> Self {
        let median_deviation = RangeReport::of(deviation).median;
        Self { range: RangeReport::of(depth), median_deviation, out_of_range, lens: None, stage: None }
    }

    pub(super) fn of_sweep(depth: &SweepDepth, positions: &Positions) -> Self {
        let stage = Some(matches!(positions, Positions::Stage(_)));
        Self { stage, ..Self::new(&depth.depth, &depth.deviation, depth.out_of_range) }
    }
}

/// The parameters of the exported surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SurfaceReport {
    /// Unit of the coordinates: "mm", or "px" with exaggerated heights.
    pub unit: String,
    /// Greatest number of vertices of a mesh along its longer side, if limited.
    pub mesh_cells: Option<u32>,
    /// Exaggeration that the user set, px for each px² of V or each setting of a sweep.
    pub z_scale: Option<f64>,
}

/// The meaning of the samples: `offset + scale * sample` in `unit`, unless the sample is 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Depth16Report {
    /// "depth", "relative_blur" or "focus".
    pub quantity: Cow<'static, str>,
    /// Unit in ASCII: "mm", "px^2", "settings" or "1/m".
    pub unit: Cow<'static, str>,
    /// Step from one sample value to the next, in `unit`.
    pub scale: f64,
    /// Value of the sample 0.
    pub offset: f64,
}

/// Step heights and profiles.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Measurements {
    /// Step heights.
    pub steps: Vec<StepReport>,
    /// Profiles.
    pub profiles: Vec<ProfileReport>,
}

/// Height of one region above another: the level of the second region minus that of the first. `null` if a region has
/// too few valid pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StepReport {
    /// The first region: x, y, width, height, px.
    pub from: [u32; 4],
    /// The second region.
    pub to: [u32; 4],
    /// "relative_blur" or "focus".
    pub quantity: Cow<'static, str>,
    /// Unit of the quantity.
    pub unit: String,
    /// Difference of the quantity.
    pub difference: Option<Estimate>,
    /// Difference of depth, mm; `null` if depth is not known.
    pub depth_mm: Option<Estimate>,
}

/// A profile. The report has its line and the CSV file its numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ProfileReport {
    /// The line.
    #[serde(flatten)]
    pub line: Line,
    /// `profile_N.csv`.
    pub csv: String,
    /// `profile_N.png`.
    pub png: String,
    /// Name of the quantity.
    #[serde(skip)]
    pub(crate) name: &'static str,
    /// Unit of the quantity.
    #[serde(skip)]
    pub(crate) unit: String,
    /// V or focus and its standard deviation along the line.
    #[serde(skip)]
    pub(crate) values: [Vec<f64>; 2],
    /// Depth and its standard deviation along the line, mm.
    #[serde(skip)]
    pub(crate) depth: Option<[Vec<f64>; 2]>,
    /// Size of a pixel on the surface, mm, if it is stated.
    #[serde(skip)]
    pub(crate) pixel_mm: Option<f64>,
}

/// The device that solved.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DeviceReport {
    /// Name of the device.
    pub name: String,
    /// Name and version of the driver.
    pub driver: String,
    /// UUID, 8-4-4-4-12.
    pub uuid: String,
}

impl From<&DeviceInfo> for DeviceReport {
    fn from(info: &DeviceInfo) -> Self {
        Self { name: info.name.clone(), driver: info.driver.clone(), uuid: info.uuid.clone() }
    }
}

/// Durations, ms.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TimingsReport {
    /// Duration from the call to the results; for a sweep including reading the frames.
    pub total: f64,
    /// Duration on the device.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gpu: Option<f64>,
    /// Duration on the device of each pass, in the order of first use.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub passes: Map<String, Value>,
}

impl From<&Timings> for TimingsReport {
    fn from(timings: &Timings) -> Self {
        let passes = timings.passes_ms.iter().map(|(name, ms)| (name.to_string(), (*ms).into())).collect();
        Self { total: timings.total_ms, gpu: Some(timings.gpu_ms), passes }
    }
}

impl Report {
    /// A report with the contents that all kinds share.
    fn new(
        kind: Kind,
        settings: &Settings,
        device: &DeviceInfo,
        photograph: [u32; 2],
        frames: Vec<FrameReport>,
        timings_ms: TimingsReport,
    ) -> Self {
        let [width, height] = photograph;
        Self {
            program: PROGRAM.into(),
            kind,
            version: VERSION.into(),
            frames,
            method: settings.method,
            settings: settings.clone(),
            values: Values::stated(settings.decode),
            size: photograph.into(),
            photograph: photograph.into(),
            region: Region { x: 0, y: 0, width, height },
            device: device.into(),
            timings_ms,
            ..Self::default()
        }
    }

    /// Report of the solve of a pair.
    pub fn pair(solution: &Solution, settings: &Settings, device: &DeviceInfo, nearer: Nearer) -> Self {
        let photograph = solution.photograph;
        let frames =
            FrameReport::pair(photograph, solution.transform, &solution.brightness(), solution.clipped_fractions);
        Self {
            size: [solution.width, solution.height].into(),
            region: solution.region(),
            levels: Some(solution.levels.iter().map(LevelReport::from).collect()),
            converged: Some(solution.converged),
            transform_deviation: solution.transform_deviation,
            other_motion: solution.other_motion,
            regularization: Some(solution.regularization),
            kernel_shape: solution.kernel_shape,
            scale_deviation: Some(solution.scale_deviation),
            relative_blur: Some(RangeReport::of(&solution.relative_blur)),
            valid_fraction: Some(solution.valid_fraction),
            mean_confidence: Some(solution.mean_confidence),
            saturated_fraction: Some(solution.saturated_fraction),
            unsettled_fraction: Some(solution.unsettled_fraction),
            unexplained_fraction: Some(solution.unexplained_fraction),
            texture: Some(TextureReport::of(solution)),
            nearer: Some(nearer.number()),
            nearer_by: Some(NearerBy::Assumed),
            warnings: solution.warnings.clone(),
            ..Self::new(Kind::Pair, settings, device, photograph, frames, (&solution.timings).into())
        }
    }

    /// Report of the solve of a focus sweep. `files` are in the order in which they were passed. `total_ms` is the
    /// duration from the first frame to the results.
    pub fn sweep(
        sweep: &Sweep,
        settings: &Settings,
        files: &[String],
        device: &DeviceInfo,
        nearer: Nearer,
        total_ms: f64,
    ) -> Self {
        let count = |side: i8| sweep.beyond.iter().filter(|beyond| **beyond == side).count();
        let valid = sweep.focus.iter().filter(|u| !u.is_nan()).count();
        Self {
            kind: Kind::Sweep,
            size: [sweep.width, sweep.height].into(),
            region: sweep.region,
            focus: Some(RangeReport::of(&sweep.focus)),
            focus_unit: Some(sweep.unit.into()),
            blur_rate_px2: Some(sweep.blur_rate),
            valid_fraction: Some(valid as f64 / sweep.focus.len().max(1) as f64),
            never_in_focus: Some(NeverReport { before_first_px: count(-1), beyond_last_px: count(1) }),
            nearer: Some(nearer.number()),
            nearer_by: Some(NearerBy::Assumed),
            depth: sweep.depth.as_ref().map(|depth| DepthReport::of_sweep(depth, &sweep.stated)),
            ..Self::sweep_registration(&sweep.registration, settings, files, device, total_ms)
        }
    }

    /// Report of the registration of a pair.
    pub fn registration(registered: &Registered, settings: &Settings, device: &DeviceInfo) -> Self {
        let photograph = [registered.width, registered.height];
        let (brightness, clipped) = (registered.brightness(), registered.clipped_fractions);
        let frames = FrameReport::pair(photograph, registered.transform, &brightness, clipped);
        Self {
            levels: Some(registered.levels.iter().map(LevelReport::from).collect()),
            converged: Some(registered.converged),
            other_motion: registered.other_motion,
            warnings: registered.warnings.clone(),
            ..Self::new(Kind::Registration, settings, device, photograph, frames, (&registered.timings).into())
        }
    }

    /// Report of the registration of a focus sweep; the arguments are those of [`sweep`](Self::sweep).
    pub fn sweep_registration(
        found: &RegisteredSweep,
        settings: &Settings,
        files: &[String],
        device: &DeviceInfo,
        total_ms: f64,
    ) -> Self {
        let timings = TimingsReport { total: total_ms, ..TimingsReport::default() };
        Self {
            reference: found.reference,
            order: found.order.clone(),
            warnings: found.warnings.clone(),
            values: Values::stated(found.decode),
            ..Self::new(
                Kind::Registration,
                settings,
                device,
                found.photograph,
                FrameReport::sweep(found, files),
                timings,
            )
        }
    }

    /// Adds the files that were read, the warnings about the files of a pair, and whether the validation layer was
    /// enabled.
    pub fn set_inputs(&mut self, inputs: Vec<Input>, validated: bool) {
        if let [i1, i2] = inputs.as_slice() {
            self.warnings.extend(image_io::pair_warnings(&inputs, self.settings.decode));
            self.frames.iter_mut().zip([i1, i2]).for_each(|(frame, input)| frame.file.clone_from(&input.file));
        }
        (self.inputs, self.validated) = (inputs, validated);
    }

    /// Whether a file of this name belongs to the results.
    pub fn has_file(&self, name: &str) -> bool {
        self.files.iter().any(|file| file == name)
    }

    /// The photograph, or the end of the sweep, that is focused nearer.
    pub fn nearer(&self) -> Nearer {
        if self.nearer == Some(2) { Nearer::Second } else { Nearer::First }
    }

    /// Checks a report that was read from a file. Returns a description of a contradiction in it, if there is one.
    pub(super) fn check(&self) -> Result<(), String> {
        let (count, reference) = (self.frames.len(), self.reference);
        let least = if self.kind == Kind::Sweep { 3 } else { 2 };
        if count < least || reference >= count || (self.kind == Kind::Pair && (count, reference) != (2, 0)) {
            return Err(format!("{count} frames, the reference {reference}"));
        }
        if !matches!(self.nearer, Some(1 | 2)) {
            return Err("it does not state which image is nearer (\"nearer\": 1 or 2)".to_string());
        }
        if let Some(um) = self.pixel_size_um.filter(|um| !PIXEL_SIZES_UM.contains(um)) {
            return Err(format!("a pixel of {um} µm"));
        }
        let (size, whole): ([u32; 2], [u32; 2]) = (self.size.into(), self.photograph.into());
        self.region.check((whole[0], whole[1])).map_err(|e| e.to_string())?;
        if [self.region.width, self.region.height] != size {
            let Region { width, height, .. } = self.region;
            return Err(format!("results of {}x{} of a part of {width}x{height}", size[0], size[1]));
        }
        let positions: Vec<f64> = self.frames.iter().filter_map(|frame| frame.position).collect();
        let unit = self.focus_unit.as_deref();
        if (self.kind == Kind::Sweep) != unit.is_some_and(|unit| UNITS.contains(&unit)) {
            return Err(format!("focus in the unit {}", unit.unwrap_or("px²")));
        }
        if self.kind == Kind::Sweep {
            Positions::Settings(positions).check(count).map_err(|e| e.to_string())?;
        }
        match self.depth.as_ref().and_then(|depth| depth.lens.as_ref()).map(Lens::check) {
            Some(Err(e)) => Err(format!("its lens cannot be used: {e}")),
            _ => Ok(()),
        }
    }

    /// The text of `report.json`, without a newline at its end.
    ///
    /// # Errors
    /// None known; serde_json's signature allows one.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        to_json(self)
    }
}

impl From<&LevelHistory> for LevelReport {
    fn from(level: &LevelHistory) -> Self {
        let energy = level.energy.iter().map(|energy| energy.is_finite().then_some(*energy)).collect();
        Self { width: level.width, height: level.height, iterations: level.energy.len(), energy }
    }
}

/// Writes a value as JSON and a newline.
pub(crate) fn write_json_to(mut writer: impl Write, value: &impl Serialize) -> Result<(), String> {
    let text = to_json(value).map_err(|e| e.to_string())?;
    writeln!(writer, "{text}").map_err(|e| e.to_string())
}

/// The text of a value: indented, without negative zeros, and without a newline at its end.
///
/// # Errors
/// None is known for the reports; serde_json's signature allows one.
pub(crate) fn to_json(value: &impl Serialize) -> Result<String, serde_json::Error> {
    let mut bytes = Vec::new();
    value.serialize(&mut Serializer::with_formatter(&mut bytes, PositiveZeros(PrettyFormatter::new())))?;
    String::from_utf8(bytes).map_err(serde::ser::Error::custom)
}

/// [`PrettyFormatter`] that writes -0 as 0.
struct PositiveZeros(PrettyFormatter<'static>);

/// Delegates methods of [`Formatter`].
macro_rules! pass_on {
    ($($name:ident($($argument:ident: $type:ty),*);)*) => {
        $(fn $name<W: ?Sized + Write>(&mut self, writer: &mut W $(, $argument: $type)*) -> io::Result<()> {
            self.0.$name(writer $(, $argument)*)
        })*
    };
}

impl Formatter for PositiveZeros {
    fn write_f32<W: ?Sized + Write>(&mut self, writer: &mut W, value: f32) -> io::Result<()> {
        // Adding zero makes -0 positive and does not change any other number.
        self.0.write_f32(writer, value + 0.0)
    }

    fn write_f64<W: ?Sized + Write>(&mut self, writer: &mut W, value: f64) -> io::Result<()> {
        self.0.write_f64(writer, value + 0.0)
    }

    pass_on! {
        begin_array();
        end_array();
        begin_array_value(first: bool);
        end_array_value();
        begin_object();
        end_object();
        begin_object_key(first: bool);
        begin_object_value();
        end_object_value();
    }
}

/// The text of a JSON value with the program, the kind and this value.
pub(crate) fn with_header(kind: Kind, value: &impl Serialize) -> impl Serialize {
    #[derive(Serialize)]
    struct Whole<'a, T: Serialize> {
        #[serde(flatten)]
        header: Header,
        #[serde(flatten)]
        value: &'a T,
    }
    Whole { header: Header::new(kind), value }
}

/// An error that states a problem with a report, and what to do.
pub(super) fn invalid(path: &Path, problem: impl std::fmt::Display) -> Error {
    Error::file(path, format!("is no report of results ({problem}); solve again, or give the folder of another solve"))
}

/// Reads a JSON file.
pub(super) fn read_json(path: &Path) -> Result<Value, Error> {
    let text = bounded_read::text(path, MAX_BYTES).map_err(|e| invalid(path, format!("it cannot be read: {e}")))?;
    serde_json::from_str(&text).map_err(|e| invalid(path, e))
}

/// The strings of an array.
pub(super) fn strings(value: &Value) -> impl Iterator<Item = &str> {
    value.as_array().into_iter().flatten().filter_map(Value::as_str)
}

/// Whether a name is a plain file name, without folders.
pub(super) fn is_plain(name: &str) -> bool {
    let mut parts = Path::new(name).components();
    let only = (parts.next(), parts.next());
    matches!(only, (Some(Component::Normal(part)), None) if part == name) && !name.contains(['/', '\\', '\0'])
}

#[cfg(test)]
mod tests {
    #[test]
    fn negative_zero_becomes_zero_and_other_values_are_written_as_by_serde_json() {
        let value = serde_json::json!({"a": [1.5, -2.0, {"b": []}], "c": {}, "d": "-0.0", "e": null});
        assert_eq!(super::to_json(&value).unwrap(), serde_json::to_string_pretty(&value).unwrap());
        assert_eq!(super::to_json(&[-0.0f64, -1e-300]).unwrap(), "[\n  0.0,\n  -1e-300\n]");
        assert_eq!(super::to_json(&-0.0f32).unwrap(), "0.0");
    }
}
