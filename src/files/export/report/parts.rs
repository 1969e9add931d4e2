//! The parts of a report.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::base::{Brightness, DeviceInfo, Estimate, Homography, Lens, Parallax, Photometric, Region, Shading, centre};
use crate::engine::{LevelHistory, Solution, Timings};
use crate::files::export::image_files::Description;
use crate::files::export::scale::Quantiles;
use crate::metric::measure::Line;
use crate::solve::sweep::{Positions, RegisteredSweep, SweepDepth};

/// A frame and its registration to the reference.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameReport {
    /// The file as passed; empty if the frame did not come from a file.
    pub file: String,
    /// T: the reference's pixel x lies at T x in this frame.
    pub transform: Homography,
    /// Parallax of a frame of a sweep, px per setting: what is in focus at u is displaced by (u - m) times this before the
    /// transform, m being the middle between the first and the last position.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parallax: Option<[f64; 2]>,
    /// Its standard deviation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parallax_deviation: Option<[f64; 2]>,
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
        let (file, [parallax, parallax_deviation], clipped_fraction) = (String::new(), [None; 2], None);
        let (position, focus_mm) = (None, None);
        Self {
            file,
            transform,
            parallax,
            parallax_deviation,
            photometric,
            shading,
            clipped_fraction,
            position,
            focus_mm,
        }
    }

    /// The frames of a pair: I1, which is the reference, and I2.
    pub(super) fn pair(
        photograph: [u32; 2],
        transform: Homography,
        brightness: &Brightness,
        clipped: [f64; 2],
    ) -> Vec<Self> {
        let first = Self::new(Homography::IDENTITY, &Brightness::identity(photograph));
        let frames = [first, Self::new(transform, brightness)].into_iter().zip(clipped);
        frames.map(|(frame, clipped)| Self { clipped_fraction: Some(clipped), ..frame }).collect()
    }

    /// The frames of a sweep; `files` are in the order in which they were passed.
    pub(super) fn sweep(found: &RegisteredSweep, files: &[String]) -> Vec<Self> {
        let moved = |frames: &[[f64; 2]], n: usize| {
            Some(frames[n]).filter(|_| found.parallax.iter().any(|moves| *moves != [0.0; 2]))
        };
        let frame = |(n, file): (usize, &usize)| Self {
            file: files.get(*file).cloned().unwrap_or_default(),
            clipped_fraction: Some(found.clipped_fractions[n]),
            position: Some(found.positions[n]),
            parallax: moved(&found.parallax, n),
            parallax_deviation: moved(&found.parallax_deviation, n),
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
    pub(in crate::files::export) fn new(name: &'static str, file: &'static str, description: &Description) -> Self {
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

/// The parallax of a pair whose camera moved between the photographs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParallaxReport {
    /// A pixel x is displaced by `(across + along (x - c)) V` before the transform maps it; c is the image centre.
    #[serde(flatten)]
    pub parallax: Parallax,
    /// Standard deviations of these numbers.
    pub deviation: Parallax,
    /// How far the nearest things are displaced against the farthest, px, where that is the most: in the middle or at a
    /// corner, between the 2nd and the 98th percentile of V.
    pub near_to_far_px: f64,
}

impl ParallaxReport {
    /// That of a solution; `None` if there is none.
    pub fn of(solution: &Solution) -> Option<Self> {
        let (parallax, deviation) = (solution.parallax, solution.parallax_deviation);
        let mut quantiles = Quantiles::of(&solution.relative_blur);
        let range = match [0.02, 0.98].map(|p| quantiles.at(p)) {
            [Some(low), Some(high)] => f64::from(high - low),
            _ => 0.0,
        };
        let [x, y] = centre(solution.photograph[0], solution.photograph[1]);
        let at = |place: [f64; 2]| {
            let [right, down] = parallax.displacement(place, range);
            right.hypot(down)
        };
        let places = [[0.0, 0.0], [x, y], [-x, y], [x, -y], [-x, -y]];
        let near_to_far_px = places.map(at).into_iter().fold(0.0, f64::max);
        (parallax != Parallax::NONE).then_some(Self { parallax, deviation, near_to_far_px })
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
    pub(in crate::files::export) fn marked(&self, uncertainty: &[f32]) -> Vec<bool> {
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

impl From<&LevelHistory> for LevelReport {
    fn from(level: &LevelHistory) -> Self {
        let energy = level.energy.iter().map(|energy| energy.is_finite().then_some(*energy)).collect();
        Self { width: level.width, height: level.height, iterations: level.energy.len(), energy }
    }
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
    /// The scale of the frames: a lens that is extended to focus near shows things larger.
    Scale,
    /// The distances that the camera stated in the first and the last frame.
    Exif,
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
    pub(in crate::files::export) fn new(depth: &[f32], deviation: &[f32], out_of_range: usize) -> Self {
        let median_deviation = RangeReport::of(deviation).median;
        Self { range: RangeReport::of(depth), median_deviation, out_of_range, lens: None, stage: None }
    }

    pub(in crate::files::export) fn of_sweep(depth: &SweepDepth, positions: &Positions) -> Self {
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
