//! The folder of a focus sweep, read again.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::{Value, json};

use super::depth16::{DEPTH16_FILES, Depth16};
use super::extra::with_near_and_far;
use super::labelled::read_beyond;
use super::measurements::{Measurable, Measurements, Wanted};
use super::results::{nearer_of, read_report};
use super::sweep::{SWEEP_FILES, SweepDepthReport, stage_depth};
use super::{DEPTH_FILE, Extra, FUSED_FLOAT_FILE, Nearer, PAGE_FILE, Palette, Pen, ShadingReport, SizeReport, beside};
use crate::around::focus_stack::{Positions, Sweep};
use crate::base::{Decode, Error, Frame, Homography, Photometric, Region};
use crate::files::image_io::{self, Input, Photograph};

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

    /// The names of the files of the frames, as given.
    pub fn frame_files(&self) -> Vec<PathBuf> {
        let frames = self.report["frames"].as_array().into_iter().flatten();
        frames.map(|frame| PathBuf::from(frame["file"].as_str().unwrap_or_default())).collect()
    }

    /// The frames, one file in memory at a time.
    ///
    /// # Errors
    /// [`Error::File`]: one is not there any more, or is another.
    pub fn frames(&self) -> Result<Vec<Frame>, Error> {
        let inputs: Vec<Input> = Deserialize::deserialize(&self.report["inputs"]).unwrap_or_default();
        let files = self.frame_files();
        let frame = |(n, file): (usize, &PathBuf)| {
            let photograph = Photograph::open(file)?;
            let given = self.sweep.order.get(n).copied().unwrap_or(n);
            let is_another = inputs.get(given).is_some_and(|input| input.sha256 != sha256(&photograph));
            let frame = photograph.decode()?;
            let size = [frame.width(), frame.height()];
            if is_another || size != self.sweep.photograph {
                return Err(Error::file(file, "is not the file that was solved"));
            }
            Ok(frame)
        };
        files.iter().enumerate().map(frame).collect()
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
    pub fn write_measurements(&self, measured: &Measurements, pen: Option<Pen>, force: bool) -> Result<(), Error> {
        beside::write_measurements(&self.folder, self.report.clone(), measured, pen, force)
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
        let page = if self.has(PAGE_FILE) { &[PAGE_FILE][..] } else { &[] };
        beside::check(&self.folder, &[&[DEPTH_FILE, SWEEP_FILES[2]], depth16, page].concat(), force)
    }

    /// Writes depth in mm into the folder `before` was read from: `depth_mm.exr`, `depth` in `report.json`, `depth.png` anew, the page where
    /// one is given; `depth16.png` and `depth16.tiff` too, if they are there. All of it, or none. A page that is not given,
    /// and where near and far change places the other files that show them, are removed, as far as the report lists them.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn write_depth(
        &self,
        before: &Self,
        palette: Palette,
        pen: Option<Pen>,
        page: Option<Extra<'_>>,
        force: bool,
    ) -> Result<(), Error> {
        let turned = self.nearer != before.nearer;
        let stale = with_near_and_far().filter(|name| if *name == PAGE_FILE { page.is_none() } else { turned });
        let stale: Vec<String> = stale.map(String::from).collect();
        let mut staging = beside::staging(&self.folder, force, &stale)?;
        stage_depth(&mut staging, &self.sweep, self.nearer, palette, pen)?;
        let depth16 = self.report.get("depth16").map(|_| Depth16::of_sweep(&self.sweep));
        for extra in depth16.iter().flat_map(Depth16::files).chain(page) {
            staging.add(extra.name, |w| (extra.fill)(w))?;
        }
        beside::finish(staging, self.report.clone(), &stale)
    }
}

fn sha256(photograph: &Photograph) -> String {
    photograph.describe().map(|input| input.sha256).unwrap_or_default()
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
