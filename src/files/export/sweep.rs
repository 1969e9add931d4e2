//! What a focus sweep gives, in a folder.

use std::collections::BTreeMap;
use std::io::Write;

use serde::Serialize;

use super::depth::Map;
use super::hashes::{Hash, Hashes};
use super::labelled::{write_beyond, write_frames};
use super::report::{DeviceReport, RangeReport, ShadingReport, SizeReport, SurfaceReport, in_known_order};
use super::{
    DEPTH_FILE, Depth16Report, Destination, Extra, FUSED_FLOAT_FILE, Look, Measurements, Nearer, Palette, Pen, Scale,
    Staging, depth, field, fused, meaning, valid,
};
use crate::base::{Decode, Depth, DeviceInfo, Error, Frame, Homography, Photometric, Region};
use crate::files::image_io::{Input, Values};
use crate::metric::MetricDepth;
use crate::solve::sweep::{Positions, RegisteredSweep, Sweep};

/// The files that [`write_sweep()`] makes.
pub const SWEEP_FILES: [&str; 8] =
    ["focus.exr", "uncertainty.exr", "depth.png", "fused.png", "report.json", "valid.png", "frames.png", "beyond.png"];

/// What `report.json` of a sweep says: fields may be added, not renamed.
#[derive(Clone, Debug, Serialize)]
pub struct SweepReport {
    /// Version of parfocal that wrote it.
    pub version: &'static str,
    /// Of the results.
    pub size: SizeReport,
    /// Size of the frames, about whose centre the transforms are stated.
    pub photograph: SizeReport,
    /// The part of the reference that the results are of.
    pub region: Region,
    /// The frames in the order in which they were solved.
    pub frames: Vec<SweepFrame>,
    /// Which of the files that were given each of them is, from 0.
    pub order: Vec<usize>,
    /// The frame on whose pixels the results are, from 0, of `frames`.
    pub reference: usize,
    /// Whether the first or the last frame is focused nearest, 1 or 2.
    pub nearer: u8,
    /// On whose word: "lens", "distances", "stated" or "assumed".
    pub nearer_by: &'static str,
    /// px² of variance by which blur grows with the squared distance from the focus, in settings.
    pub blur_rate_px2: f64,
    /// How stored values became intensities.
    pub decode: Decode,
    /// The same, and on whose word.
    pub values: Values,
    /// The unit of focus settings: "settings", "1/m" of a lens whose focus distances are known, or "mm" of a stage.
    pub focus_unit: &'static str,
    /// Range of the focus setting; of no pixel: null.
    pub focus: RangeReport,
    /// Depth in mm, where the frames' places of focus are known in mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth: Option<SweepDepthReport>,
    /// What the samples of `depth16.png` and `depth16.tiff` mean, where they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth16: Option<Depth16Report>,
    /// How the surface was made for other programs, where it was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface: Option<SurfaceReport>,
    /// What was asked to be measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measurements: Option<Measurements>,
    /// Fraction of pixels of which some pair tells.
    pub valid_fraction: f64,
    /// What no frame has in focus, since it lies outside the sweep.
    pub never_in_focus: NeverReport,
    /// What speaks against any of the pairs.
    pub warnings: Vec<String>,
    /// Where it ran.
    pub device: DeviceReport,
    /// Whether it ran under the validation layer.
    pub validated: bool,
    /// SHA-256 of the version, settings and flags, by which `batch --resume` knows a solve again; empty where a program
    /// did not set it.
    pub request: String,
    /// The files of the frames, as they were given; empty where they did not come from files.
    pub inputs: Vec<Input>,
    /// The files that belong to it, itself among them; [`write_sweep`] sees to it.
    pub files: Vec<String>,
    /// Size and hash of each of them but the report.
    pub hashes: BTreeMap<String, Hash>,
    /// From the first frame to the results, ms.
    pub total_ms: f64,
}

/// Pixels that no frame has in focus, by the side of the sweep on which they lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct NeverReport {
    /// Those before the first frame.
    pub before_first_px: usize,
    /// Those beyond the last.
    pub beyond_last_px: usize,
}

impl NeverReport {
    /// Of a sweep.
    pub fn of(sweep: &Sweep) -> Self {
        let count = |side: i8| sweep.beyond.iter().filter(|found| **found == side).count();
        Self { before_first_px: count(-1), beyond_last_px: count(1) }
    }
}

/// What `report.json` of a sweep says about depth in mm; `null` where no pixel has one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SweepDepthReport {
    /// Least, greatest and median depth, mm.
    #[serde(flatten)]
    pub range: RangeReport,
    /// The median of its standard deviation, mm.
    pub median_deviation: Option<f32>,
    /// Pixels whose focus setting is beyond infinity; they are NaN.
    pub out_of_range: usize,
    /// Whether it is a place along the axis of a stage, and not a distance from the lens.
    pub stage: bool,
}

impl SweepDepthReport {
    /// Of a sweep, if its depth is known.
    pub fn of(sweep: &Sweep) -> Option<Self> {
        let found = sweep.depth.as_ref()?;
        Some(Self {
            range: RangeReport::of(&found.depth),
            median_deviation: RangeReport::of(&found.deviation).median,
            out_of_range: found.out_of_range,
            stage: matches!(sweep.stated, Positions::Stage(_)),
        })
    }
}

/// One frame of a sweep.
#[derive(Clone, Debug, Serialize)]
pub struct SweepFrame {
    /// Its file as given.
    pub file: String,
    /// Its focus setting.
    pub position: f64,
    /// Where it is focused, mm, as stated: the distance from the lens, or the place along the axis of a stage.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focus_mm: Option<f64>,
    /// Where each pixel of the reference lies in it.
    pub transform: Homography,
    /// What maps its exposure to the reference's.
    pub photometric: Photometric,
    /// How the gain varies over it.
    pub shading: ShadingReport,
}

impl SweepFrame {
    /// Those of these files, in the order in which they were given.
    pub(super) fn of(found: &RegisteredSweep, files: &[String]) -> Vec<Self> {
        let frame = |(n, given): (usize, &usize)| Self {
            file: files.get(*given).cloned().unwrap_or_default(),
            position: found.positions[n],
            focus_mm: found.stated.millimetres().map(|at| at[n]),
            transform: found.transforms[n],
            photometric: found.brightness[n].photometric,
            shading: ShadingReport::of(&found.brightness[n]),
        };
        found.order.iter().enumerate().map(frame).collect()
    }
}

impl SweepReport {
    /// Of a sweep of these files, in the order in which they were given.
    pub fn new(sweep: &Sweep, files: &[String], nearer: Nearer, device: &DeviceInfo, total_ms: f64) -> Self {
        let valid = sweep.focus.iter().filter(|u| !u.is_nan()).count();
        Self {
            version: env!("CARGO_PKG_VERSION"),
            size: SizeReport { width: sweep.width, height: sweep.height },
            photograph: SizeReport { width: sweep.photograph[0], height: sweep.photograph[1] },
            region: sweep.region,
            frames: SweepFrame::of(&sweep.registration(), files),
            order: sweep.order.clone(),
            reference: sweep.reference,
            nearer: nearer.number(),
            nearer_by: "assumed",
            blur_rate_px2: sweep.blur_rate,
            decode: sweep.decode,
            values: Values::stated(sweep.decode),
            focus_unit: sweep.unit,
            focus: RangeReport::of(&sweep.focus),
            depth: SweepDepthReport::of(sweep),
            depth16: None,
            surface: None,
            measurements: None,
            valid_fraction: valid as f64 / sweep.focus.len().max(1) as f64,
            never_in_focus: NeverReport::of(sweep),
            warnings: sweep.warnings.clone(),
            device: device.into(),
            validated: false,
            request: String::new(),
            inputs: Vec::new(),
            files: Vec::new(),
            hashes: Hashes::new(),
            total_ms,
        }
    }

    /// As JSON, without a newline at its end.
    ///
    /// # Errors
    /// None is known; serde_json's signature allows one.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        serde_json::to_string_pretty(self)
    }
}

/// The files of a sweep, as [`write_sweep`] makes them.
pub fn sweep_files(has_depth: bool, look: &Look, has_page: bool) -> Vec<&'static str> {
    let is_float = look.formats[0].depth == Depth::F32;
    let more = [(has_depth, DEPTH_FILE), (is_float, FUSED_FLOAT_FILE), (has_page, super::PAGE_FILE)];
    SWEEP_FILES.into_iter().chain(more.into_iter().filter(|(has, _)| *has).map(|(_, name)| name)).collect()
}

/// The image sharp all over as it is stored, and read again, for frames of this depth.
///
/// # Errors
/// [`Error::Mismatch`] where it is not of the size that the sweep states.
pub fn sweep_fused(sweep: &Sweep, depth: Depth) -> Result<Frame, Error> {
    let size = (sweep.width, sweep.height);
    fused::Image { size, channels: sweep.fused_channels, values: &sweep.fused }.as_stored(sweep.decode, depth)
}

/// What tells near from far, depth where it is known and else focus, and the scale on which `depth.png` has it.
pub fn sweep_surface(sweep: &Sweep, nearer: Nearer) -> (&[f32], Scale) {
    Map::of_sweep(sweep, nearer, Palette::default()).surface()
}

/// Depth through a lens, and the scale on which `depth.png` has it.
pub(crate) fn depth_surface(metric: &MetricDepth) -> (&[f32], Scale) {
    Map::of_depth(metric, Palette::default()).surface()
}

/// Writes the [`SWEEP_FILES`], [`DEPTH_FILE`] where depth is known, and any of the
/// [`EXTRA_FILES`](super::EXTRA_FILES), into the folder `out`, which is made if it is missing; all of them, or none. Where the frames are in floats, `fused.exr` is written too.
/// Of earlier results, what their report lists is replaced or removed, and no other file, as by [`write()`](super::write()); the report
/// that is written comes back.
///
/// # Errors
/// [`Error::File`].
pub fn write_sweep<'d>(
    out: impl Into<Destination<'d>>,
    sweep: &Sweep,
    report: &SweepReport,
    look: &Look,
    extras: Vec<Extra<'_>>,
) -> Result<SweepReport, Error> {
    let size = (sweep.width, sweep.height);
    let [focus, uncertainty, _, fused, json, valid, taken, beyond] = SWEEP_FILES;
    let mut staging = Staging::anew(out.into(), json)?;
    staging.add(focus, |w| field::write(w, size, &sweep.focus, &meaning::FOCUS))?;
    staging.add(uncertainty, |w| field::write(w, size, &sweep.uncertainty, &meaning::FOCUS_UNCERTAINTY))?;
    staging.add(valid, |w| valid::write(w, size, &sweep.focus))?;
    staging.add(taken, |w| write_frames(w, sweep))?;
    staging.add(beyond, |w| write_beyond(w, sweep))?;
    stage_depth(&mut staging, sweep, look.nearer, look.palette, look.pen)?;
    let image = fused::Image { size, channels: sweep.fused_channels, values: &sweep.fused };
    let depth = look.formats[0].depth;
    staging.add(fused, |w| fused::write_image(w, &image, look.decode, depth))?;
    if depth == Depth::F32 {
        staging.add(FUSED_FLOAT_FILE, |w| fused::write_float(w, &image, look.decode))?;
    }
    for extra in extras {
        staging.add(extra.name, |w| (extra.fill)(w))?;
    }
    report.measurements.iter().try_for_each(|measured| measured.stage(&mut staging, look.pen))?;
    let written = staging.names().into_iter().chain([json.to_string()]);
    let report =
        SweepReport { files: in_known_order(&report.files, written), hashes: staging.hashes(), ..report.clone() };
    staging.add(json, |w| {
        report.to_json().map_err(|e| e.to_string()).and_then(|text| writeln!(w, "{text}").map_err(|e| e.to_string()))
    })?;
    staging.place().map(|()| report)
}

/// `depth.png`, hatched where the focus is not known, in colour where it lies outside the sweep, and [`DEPTH_FILE`].
pub(super) fn stage_depth(
    staging: &mut Staging,
    sweep: &Sweep,
    nearer: Nearer,
    palette: Palette,
    pen: Option<Pen>,
) -> Result<(), Error> {
    if let Some(found) = &sweep.depth {
        let channels = [("Y", &found.depth[..]), ("standard_deviation", &found.deviation)];
        let size = (sweep.width, sweep.height);
        staging.add(DEPTH_FILE, |w| field::write_channels(w, size, &channels, &meaning::SWEEP_DEPTH))?;
    }
    let unknown: Vec<bool> = sweep.focus.iter().map(|u| u.is_nan()).collect();
    let near_is_first = nearer == Nearer::First;
    let map = Map::of_sweep(sweep, nearer, palette).marking(&unknown).never_in_focus(&sweep.beyond, near_is_first);
    staging.add(SWEEP_FILES[2], |w| depth::write(w, &map, pen))
}
