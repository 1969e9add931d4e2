//! `report.json`: what was asked, what came out, and what it took. Scripts read it: fields may be added, not renamed.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize, Serializer};

use super::depth16::Depth16Report;
use super::hashes::{Hash, Hashes};
use super::measurements::Measurements;
use super::ranks::Ranks;
use super::{Nearer, Texture, json};
use crate::base::{Brightness, DeviceInfo, Homography, Lens, Method, Photometric, Region, Settings, Shading};
use crate::engine::{LevelHistory, OtherMotion, Solution, Timings};
use crate::files::image_io::{self, Input, Values};
use crate::metric::MetricDepth;

/// The report of one solve. A quantity that no valid pixel supports is `null`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Version of parfocal that wrote it.
    pub version: &'static str,
    /// T: I2(T x) lines up with I1(x).
    pub transform: Homography,
    /// What maps I2 onto I1.
    pub photometric: Photometric,
    /// How the gain varies over I2.
    pub shading: ShadingReport,
    /// Smoothness α of the finest level, as asked or as found.
    pub regularization: f64,
    /// Where the kernel was to be found: 0 is a Gaussian, 1 a disk.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kernel_shape: Option<f64>,
    /// Another motion model that would do, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub other_motion: Option<OtherMotion>,
    /// The method that ran.
    pub method: Method,
    /// What was asked.
    pub settings: Settings,
    /// How stored values became intensities, and on whose word.
    pub values: Values,
    /// Size of the results.
    pub size: SizeReport,
    /// Size of the photographs, about whose centre T is stated.
    pub photograph: SizeReport,
    /// The part of I1 that the results are of.
    pub region: Region,
    /// Where there is nothing to tell V by.
    pub texture: TextureReport,
    /// Whether the field curvature that a flat reference shows was taken from V.
    pub flattened: bool,
    /// Coarse to fine.
    pub levels: Vec<LevelReport>,
    /// Whether the finest level settled on an answer that the images support.
    pub converged: bool,
    /// V over the valid pixels.
    pub relative_blur: RangeReport,
    /// Fraction of pixels whose whole blur window lies inside both images.
    pub valid_fraction: f64,
    /// Mean confidence of the valid pixels.
    pub mean_confidence: f64,
    /// Fraction of the valid pixels at the limit of |V|.
    pub saturated_fraction: f64,
    /// Which image was taken to be focused nearer, 1 or 2.
    pub nearer: u8,
    /// On whose word: "lens", "distances", "stated" or "assumed".
    pub nearer_by: &'static str,
    /// Depth in mm, where the lens is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth: Option<DepthReport>,
    /// What the samples of `depth16.png` and `depth16.tiff` mean, where they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth16: Option<Depth16Report>,
    /// How the surface was made for other programs, where it was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface: Option<SurfaceReport>,
    /// What was asked to be measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measurements: Option<Measurements>,
    /// What the user should know; a sentence each.
    pub warnings: Vec<String>,
    /// What it ran on.
    pub device: DeviceReport,
    /// Whether it ran under the validation layer.
    pub validated: bool,
    /// SHA-256 of the version, settings and flags, by which `batch --resume` knows a solve again; empty where a program
    /// did not set it.
    pub request: String,
    /// The files that belong to it, itself among them; [`write()`](super::write()) sees to it. A later run replaces and
    /// removes these and no others.
    pub files: Vec<String>,
    /// Size and hash of each of them but the report.
    pub hashes: BTreeMap<String, Hash>,
    /// The files of I1 and I2; empty where the frames did not come from files.
    pub inputs: Vec<Input>,
    /// Where the time went.
    pub timings_ms: TimingsReport,
}

/// Pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SizeReport {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// How the gain of a photograph varies with the place on it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ShadingReport {
    /// Least and greatest factor; on average it is 1.
    pub range: [f64; 2],
    /// Of a polynomial, as [`Shading`] has them.
    pub coefficients: [f64; Shading::TERMS],
    /// The part of the photograph that it is stated over, px.
    pub region: Region,
}

impl ShadingReport {
    /// In numbers.
    pub fn of(brightness: &Brightness) -> Self {
        let Brightness { shading, part, .. } = brightness;
        Self { range: shading.range(), coefficients: shading.coefficients, region: *part }
    }

    /// What it says, with gain and offset.
    pub fn with(&self, photometric: Photometric) -> Brightness {
        let shading = Shading { coefficients: self.coefficients };
        Brightness { photometric, shading, part: self.region }
    }

    /// Whether it is worth a word: more than two hundredths either way.
    pub fn is_worth_telling(&self) -> bool {
        self.range.iter().any(|factor| (factor - 1.0).abs() > 0.02)
    }
}

/// Pixels marked as without texture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TextureReport {
    /// Standard deviation of V beyond which a pixel is marked, px².
    pub max_uncertainty_px2: f32,
    /// Fraction of all pixels that are.
    pub marked_fraction: f64,
}

impl TextureReport {
    /// In numbers.
    pub fn of(texture: &Texture) -> Self {
        Self { max_uncertainty_px2: texture.max_uncertainty, marked_fraction: texture.marked_fraction() }
    }
}

/// What one pyramid level did.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LevelReport {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Outer iterations done.
    pub iterations: usize,
    /// Energy per valid pixel, one for each iteration.
    pub energy: Vec<f64>,
}

/// V over the valid pixels, px².
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RangeReport {
    /// Least.
    pub min: Option<f32>,
    /// Greatest.
    pub max: Option<f32>,
    /// Median.
    pub median: Option<f32>,
}

/// What the solve ran on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DeviceReport {
    /// The device's name.
    pub name: String,
    /// Driver name and version.
    pub driver: String,
    /// UUID, 8-4-4-4-12.
    pub uuid: String,
}

/// Milliseconds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TimingsReport {
    /// From the call to the answer.
    pub total: f64,
    /// On the device.
    pub gpu: f64,
    /// On the device by named pass; a JSON object in the order of first use.
    #[serde(serialize_with = "as_object")]
    pub passes: Vec<(&'static str, f64)>,
}

fn as_object<S: Serializer>(passes: &[(&'static str, f64)], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(passes.iter().map(|(name, ms)| (name, ms)))
}

impl Report {
    /// Gathers the report of a solve.
    pub fn new(solution: &Solution, settings: &Settings, device: &DeviceInfo, nearer: Nearer) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION"),
            transform: solution.transform,
            photometric: solution.photometric,
            shading: ShadingReport::of(&solution.brightness()),
            regularization: solution.regularization,
            kernel_shape: solution.kernel_shape,
            other_motion: solution.other_motion,
            method: settings.method,
            settings: settings.clone(),
            values: Values::stated(settings.decode),
            size: SizeReport { width: solution.width, height: solution.height },
            photograph: SizeReport { width: solution.photograph[0], height: solution.photograph[1] },
            region: solution.region(),
            texture: TextureReport::of(&Texture::of(solution, None)),
            flattened: false,
            levels: solution.levels.iter().map(LevelReport::from).collect(),
            converged: solution.converged,
            relative_blur: RangeReport::of(&solution.relative_blur),
            valid_fraction: solution.valid_fraction,
            mean_confidence: solution.mean_confidence,
            saturated_fraction: solution.saturated_fraction,
            nearer: nearer.number(),
            nearer_by: "assumed",
            depth: None,
            depth16: None,
            surface: None,
            measurements: None,
            warnings: solution.warnings.clone(),
            device: device.into(),
            validated: false,
            request: String::new(),
            files: Vec::new(),
            hashes: Hashes::new(),
            inputs: Vec::new(),
            timings_ms: (&solution.timings).into(),
        }
    }

    /// Adds which files were read, and what they give to warn of; and whether the validation layer watched.
    pub fn of(&mut self, inputs: Vec<Input>, validated: bool) {
        self.warnings.extend(image_io::pair_warnings(&inputs, self.settings.decode));
        (self.inputs, self.validated) = (inputs, validated);
    }

    /// The same, listing these files in the order in which it lists them already.
    pub(super) fn listing(&self, written: impl Iterator<Item = String>, hashes: Hashes) -> Self {
        Self { files: in_known_order(&self.files, written), hashes, ..self.clone() }
    }

    /// The text of `report.json`, without a newline at its end.
    ///
    /// # Errors
    /// None is known; serde_json's signature allows one.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        json::to_string(self)
    }
}

/// What `report.json` says of `surface.ply` and the like.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SurfaceReport {
    /// Of the coordinates: "mm", or "px", in which heights are exaggerated.
    pub unit: String,
    /// The most vertices of a mesh along its longer side, if there was a limit.
    pub mesh_cells: Option<u32>,
    /// The exaggeration that was asked for, px for each px² of V or setting of a sweep.
    pub z_scale: Option<f64>,
}

/// What `report.json` says about metric depth; `null` where no pixel has one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthReport {
    /// Least, greatest and median depth of the valid pixels, mm.
    #[serde(flatten)]
    pub range: RangeReport,
    /// Valid pixels whose V no depth in the range of the lens model has, or whose V is at the limit of the solve; they are
    /// NaN.
    pub out_of_range: usize,
    /// The lens.
    pub lens: Lens,
}

impl From<&MetricDepth> for DepthReport {
    fn from(metric: &MetricDepth) -> Self {
        Self { range: RangeReport::of(&metric.depth), out_of_range: metric.out_of_range, lens: metric.lens }
    }
}

/// The files that were written: those that are known first, in their order.
pub(super) fn in_known_order(known: &[String], written: impl Iterator<Item = String>) -> Vec<String> {
    let mut written: Vec<String> = written.collect();
    // Stable, so that the others stay in theirs.
    written.sort_by_key(|name| known.iter().position(|k| k == name).unwrap_or(usize::MAX));
    written
}

impl RangeReport {
    /// Over the values that are finite.
    pub fn of(values: &[f32]) -> Self {
        let mut ranks = Ranks::of(values);
        Self { min: ranks.quantile(0.0), max: ranks.quantile(1.0), median: ranks.quantile(0.5) }
    }
}

impl From<&LevelHistory> for LevelReport {
    fn from(level: &LevelHistory) -> Self {
        let (width, height) = (level.width, level.height);
        Self { width, height, iterations: level.energy.len(), energy: level.energy.clone() }
    }
}

impl From<&DeviceInfo> for DeviceReport {
    fn from(info: &DeviceInfo) -> Self {
        Self { name: info.name.clone(), driver: info.driver.clone(), uuid: info.uuid.clone() }
    }
}

impl From<&Timings> for TimingsReport {
    fn from(timings: &Timings) -> Self {
        Self { total: timings.total_ms, gpu: timings.gpu_ms, passes: timings.passes_ms.clone() }
    }
}
