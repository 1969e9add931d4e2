//! The folder of a focus sweep, read again.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::{Value, json};

use super::depth16::{DEPTH16_FILES, Depth16};
use super::extra::showing_depth;
use super::labelled::read_beyond;
use super::measurements::{Measurable, Measurements, Wanted};
use super::results::{nearer_of, read_report};
use super::sweep::{SWEEP_FILES, SweepDepthReport, stage_depth};
use super::{DEPTH_FILE, Extra, FUSED_FLOAT_FILE, Nearer, Palette, Pen, ShadingReport, SizeReport, beside};
use crate::base::{Decode, Error, Frame, Homography, Photometric, Region};
use crate::files::image_io;
use crate::solve::sweep::{Positions, Sweep};

/// A folder that `parfocal stack` wrote.
#[derive(Clone, Debug)]
pub struct SolvedSweep {
    /// The folder.
    pub folder: PathBuf,
    /// What was found.
    pub sweep: Sweep,
    /// The image sharp all over, as it is stored.
    pub fused: Frame,
    /// Which end of the sweep is near.
    pub nearer: Nearer,
    /// The whole of `report.json`.
    report: Value,
}

/// What of a report says how fields are to be read.
#[derive(Deserialize)]
struct Stated {
    size: SizeReport,
    photograph: Option<SizeReport>,
    region: Option<Region>,
    frames: Vec<StatedFrame>,
    /// Absent from reports of earlier versions, whose frames were taken as given.
    order: Option<Vec<usize>>,
    reference: usize,
    blur_rate_px2: f64,
    decode: Decode,
    #[serde(default)]
    focus_unit: String,
    #[serde(default)]
    warnings: Vec<String>,
}

#[derive(Deserialize)]
struct StatedFrame {
    position: f64,
    focus_mm: Option<f64>,
    transform: Homography,
    photometric: Photometric,
    shading: ShadingReport,
}

impl Stated {
    fn of(report: &Value) -> Result<Self, String> {
        let stated = Self::deserialize(report).map_err(|e| e.to_string())?;
        let positions = Positions::Settings(stated.frames.iter().map(|frame| frame.position).collect());
        positions.check(stated.frames.len()).map_err(|e| e.to_string())?;
        if stated.frames.len() < 3 || stated.reference >= stated.frames.len() {
            return Err(format!("{} frames, the reference {}", stated.frames.len(), stated.reference));
        }
        let SizeReport { width, height } = stated.size;
        if let Some(part) = stated.region {
            let whole = stated.photograph.unwrap_or(stated.size);
            part.check((whole.width, whole.height)).map_err(|e| e.to_string())?;
            if (part.width, part.height) != (width, height) {
                return Err(format!("results of {width}x{height} of a part of {}x{}", part.width, part.height));
            }
        }
        Ok(stated)
    }

    fn unit(&self) -> &'static str {
        ["1/m", "mm"].into_iter().find(|unit| *unit == self.focus_unit).unwrap_or("settings")
    }
}

impl SolvedSweep {
    /// Reads a folder.
    ///
    /// # Errors
    /// [`Error::File`]: a file is missing or damaged, or not of the size that the report states.
    pub fn read(folder: &Path) -> Result<Self, Error> {
        let [focus, uncertainty, _, fused, json, ..] = SWEEP_FILES.map(|name| folder.join(name));
        let report = read_report(&json)?;
        let nearer = nearer_of(&report, &json)?;
        let stated = Stated::of(&report)
            .map_err(|problem| Error::file(&json, format!("is no report of a sweep ({problem}); solve it again")))?;
        let SizeReport { width, height } = stated.size;
        let field = |path: &Path| {
            let (w, h, values) = image_io::read_field(path)?;
            of_size(path, [w, h], [width, height]).map(|()| values)
        };
        let (focus, uncertainty) = (field(&focus)?, field(&uncertainty)?);
        let in_floats = folder.join(FUSED_FLOAT_FILE);
        let has = |name: &str| report["files"].as_array().is_some_and(|files| files.contains(&json!(name)));
        let is_float = has(FUSED_FLOAT_FILE);
        // Earlier versions wrote none.
        let beyond =
            if has(SWEEP_FILES[7]) { sides(&folder.join(SWEEP_FILES[7]), [width, height])? } else { Vec::new() };
        let file = if is_float { in_floats } else { fused };
        let fused = image_io::read(&file)?;
        of_size(&file, [fused.width(), fused.height()], [width, height])?;
        let whole = Region { x: 0, y: 0, width, height };
        let (photograph, unit) = (stated.photograph.unwrap_or(stated.size), stated.unit());
        let mut sweep = Sweep {
            width,
            height,
            region: stated.region.unwrap_or(whole),
            photograph: [photograph.width, photograph.height],
            focus,
            uncertainty,
            beyond,
            depth: None,
            fused_channels: fused.format().channels,
            fused: fused.intensities(stated.decode),
            frames: Vec::new(),
            reference: stated.reference,
            positions: stated.frames.iter().map(|frame| frame.position).collect(),
            unit,
            stated: Positions::Counted,
            transforms: stated.frames.iter().map(|frame| frame.transform).collect(),
            brightness: stated.frames.iter().map(|frame| frame.shading.with(frame.photometric)).collect(),
            blur_rate: stated.blur_rate_px2,
            decode: stated.decode,
            order: stated.order.unwrap_or_else(|| (0..stated.frames.len()).collect()),
            warnings: stated.warnings,
        };
        if let Some(at) = stated.frames.iter().map(|frame| frame.focus_mm).collect::<Option<Vec<f64>>>() {
            let is_stage = report["depth"]["stage"].as_bool().unwrap_or(unit == "mm");
            let places = if is_stage { Positions::Stage(at) } else { Positions::Distances(at) };
            sweep.depth = sweep.depth_by(&places).map_err(|e| Error::file(&json, e.to_string()))?;
            sweep.stated = places;
        }
        Ok(Self { folder: folder.to_path_buf(), sweep, fused, nearer, report })
    }

    /// The whole of `report.json`.
    pub fn report(&self) -> &Value {
        &self.report
    }

    /// The same, to be added to.
    pub fn report_mut(&mut self) -> &mut Value {
        &mut self.report
    }

    /// Measures focus, and depth where it is known.
    ///
    /// # Errors
    /// [`Error::Region`].
    pub fn measure(&self, wanted: &Wanted) -> Result<Measurements, Error> {
        wanted.measure(&Measurable::of_sweep(&self.sweep))
    }

    /// Refuses, before it is made, what [`write_measurements`](Self::write_measurements) would not write.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn check_measurements(&self, wanted: &Wanted, force: bool) -> Result<(), Error> {
        beside::check_measurements(&self.folder, wanted, force)
    }

    /// Adds measurements to the folder, as [`Solved::write_measurements`](super::Solved::write_measurements).
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn write_measurements(
        &self,
        measured: &Measurements,
        pen: Option<Pen>,
        shown: Vec<Extra<'_>>,
        force: bool,
    ) -> Result<(), Error> {
        beside::write_measurements(&self.folder, self.report.clone(), measured, (pen, shown), force)
    }

    /// The same with these measurements in its report.
    pub fn with_measurements(&self, measured: &Measurements) -> Self {
        Self { report: beside::with_measurements(self.report.clone(), measured), ..self.clone() }
    }

    /// The same with depth in mm, if the frames are focused at these places.
    ///
    /// # Errors
    /// [`Error::Mismatch`]: they are no places in mm, or do not fit the frames.
    pub fn focused_at(&self, places: &Positions, nearer: Nearer) -> Result<Self, Error> {
        let mut new = Self { nearer, ..self.clone() };
        new.sweep.depth = self.sweep.depth_by(places)?;
        new.sweep.stated = places.clone();
        let at = places.millimetres().ok_or_else(|| Error::Mismatch("positions in mm give depth".to_string()))?;
        new.report["nearer"] = nearer.number().into();
        beside::restate(&mut new.report, "nearer_by", "distances");
        new.report["depth"] = json!(SweepDepthReport::of(&new.sweep));
        for (frame, at) in new.report["frames"].as_array_mut().into_iter().flatten().zip(at) {
            frame["focus_mm"] = json!(at);
        }
        if new.report.get("depth16").is_some() {
            new.report["depth16"] = json!(Depth16::of_sweep(&new.sweep).report());
        }
        Ok(new)
    }

    /// Whether a file of this name belongs to it.
    pub fn has(&self, name: &str) -> bool {
        self.report["files"].as_array().is_some_and(|files| files.contains(&json!(name)))
    }

    /// Refuses, before it is made, what [`write_depth`](Self::write_depth) would not write.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn check_depth(&self, force: bool) -> Result<(), Error> {
        let depth16 = self.report.get("depth16").map_or(&[][..], |_| &DEPTH16_FILES);
        let shown: Vec<&str> = showing_depth().filter(|name| self.has(name)).collect();
        beside::check(&self.folder, &[&[DEPTH_FILE, SWEEP_FILES[2]], depth16, &shown].concat(), force)
    }

    /// Writes depth in mm into its folder: `depth_mm.exr`, `depth` in `report.json`, `depth.png` anew;
    /// `depth16.png` and `depth16.tiff` too, if they are there; and what shows it besides, as is given. All of it, or none. What
    /// shows depth and is not given is removed, as far as the report lists it.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn write_depth(
        &self,
        palette: Palette,
        pen: Option<Pen>,
        shown: Vec<Extra<'_>>,
        force: bool,
    ) -> Result<(), Error> {
        let stale = beside::stale(&shown);
        let mut staging = beside::staging(&self.folder, force, &stale)?;
        stage_depth(&mut staging, &self.sweep, self.nearer, palette, pen)?;
        let depth16 = self.report.get("depth16").map(|_| Depth16::of_sweep(&self.sweep));
        for extra in depth16.iter().flat_map(Depth16::files).chain(shown) {
            staging.add(extra.name, |w| (extra.fill)(w))?;
        }
        beside::finish(staging, self.report.clone(), &stale)
    }
}

fn sides(path: &Path, size: [u32; 2]) -> Result<Vec<i8>, Error> {
    let (found, sides) = read_beyond(path)?;
    of_size(path, found, size).map(|()| sides)
}

fn of_size(path: &Path, found: [u32; 2], stated: [u32; 2]) -> Result<(), Error> {
    if found == stated {
        return Ok(());
    }
    let ([w, h], [width, height]) = (found, stated);
    Err(Error::file(path, format!("is {w}x{h} and the report states {width}x{height}; solve the sweep again")))
}
