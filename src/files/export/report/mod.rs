//! `report.json`: the inputs of results, their contents, and how they were made.

mod json;
mod parts;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use serde::{Deserialize, Deserializer, Serialize};

use super::scale::Nearer;
use crate::base::{DeviceInfo, Lens, Method, Region, Settings};
use crate::engine::{ColorShift, OtherMotion, Registered, Solution, TransformDeviation};
use crate::files::bounded_read::Hash;
use crate::files::image_io::{self, Input, Tone, Values};
use crate::solve::sweep::{Positions, RegisteredSweep, Sweep};
pub use json::{Header, Kind, to_json};
pub(super) use json::{MAX_BYTES, PROGRAM, invalid, is_plain, read_json, strings};
pub(crate) use json::{with_header, write_json_to};
pub use parts::{
    Depth16Report, DepthReport, DeviceReport, FieldReport, FrameReport, LevelReport, Measurements, NearerBy,
    NeverReport, ParallaxReport, ProfileReport, RangeReport, ShadingReport, SizeReport, StepReport, SurfaceReport,
    TextureReport, TimingsReport,
};

/// The report of results.
pub const REPORT_FILE: &str = "report.json";

/// The range of the size of a pixel on the surface, µm.
pub const PIXEL_SIZES_UM: RangeInclusive<f64> = 1e-6..=1e6;

/// Units of the focus of a sweep.
pub(super) const UNITS: [&str; 3] = ["settings", "1/m", "mm"];

/// The version of this program.
const VERSION: &str = env!("CARGO_PKG_VERSION");

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
    /// The stored values that `fused.png` and pictures show as black and as white, unless they are 0 and the white of the
    /// photographs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tone: Option<Tone>,
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
    /// The limit of |V| of a pair, px², as set or as found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_relative_blur: Option<f64>,
    /// The estimated shape of the kernel: 0 is a Gaussian, 1 a disk. `None` if it was not estimated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kernel_shape: Option<f64>,
    /// How far the two focus settings of a pair are apart, if it was found: the variance of the blur in one photograph of
    /// what is in focus in the other, px².
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub separation: Option<f64>,
    /// The parallax of a pair whose camera moved between the photographs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parallax: Option<ParallaxReport>,
    /// The standard deviation of the scale of V of a pair, as a share of V. The uncertainty includes it.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "number_or_null")]
    pub scale_deviation: Option<f64>,
    /// By how much V of a pair differs between the channels of its photographs, if that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub color_shift: Option<ColorShift>,
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
            max_relative_blur: Some(solution.max_relative_blur),
            kernel_shape: solution.kernel_shape,
            separation: solution.separation,
            parallax: ParallaxReport::of(solution),
            scale_deviation: Some(solution.scale_deviation),
            color_shift: solution.color_shift,
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

    /// Adds the files that were read, and the warnings about the files of a pair.
    pub fn set_inputs(&mut self, inputs: Vec<Input>) {
        if let [i1, i2] = inputs.as_slice() {
            self.warnings.extend(image_io::pair_warnings(&inputs, self.settings.decode));
            self.frames.iter_mut().zip([i1, i2]).for_each(|(frame, input)| frame.file.clone_from(&input.file));
        }
        self.inputs = inputs;
    }

    /// Whether a file of this name belongs to the results.
    pub fn has_file(&self, name: &str) -> bool {
        self.files.iter().any(|file| file == name)
    }

    /// The limit of |V|, px².
    pub(crate) fn blur_limit(&self) -> f64 {
        self.max_relative_blur.unwrap_or(self.settings.blur_limit())
    }

    /// The photograph, or the end of the sweep, that is focused nearer.
    pub fn nearer(&self) -> Nearer {
        if self.nearer == Some(2) { Nearer::Second } else { Nearer::First }
    }

    /// The names of the near and the far end in pictures; of a sweep that does not show which end is near, its frames.
    pub fn end_names(&self) -> [&'static str; 2] {
        match (self.kind, self.nearer_by, self.nearer()) {
            (Kind::Sweep, Some(NearerBy::Assumed), Nearer::First) => ["first", "last"],
            (Kind::Sweep, Some(NearerBy::Assumed), Nearer::Second) => ["last", "first"],
            _ => ["near", "far"],
        }
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
