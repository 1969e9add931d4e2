//! What later steps need of the folder of a solve: V, how far to trust it, and the report.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::{Value, json};

use super::beside;
use super::depth::{self, Map};
use super::depth16::{DEPTH16_FILES, Depth16};
use super::extra::showing_depth;
use super::measurements::{Measurable, Measurements, Wanted};
use super::metric::DEPTH_FILE;
use super::report::DepthReport;
use super::results::{is_of_sweep, nearer_of, read_report};
use super::{Extra, FILES, FUSED_FLOAT_FILE, Nearer, Palette, Pen, Texture, metric, read_transform};
use crate::base::{Error, Frame, Homography, Lens, Region};
use crate::files::image_io;
use crate::metric::{DOUBT, MetricDepth};

/// A folder that `parfocal solve` wrote, without its pictures.
#[derive(Clone, Debug)]
pub struct Solved {
    /// The folder.
    pub folder: PathBuf,
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// V, px², row-major; NaN where not valid.
    pub relative_blur: Vec<f32>,
    /// In [0, 1], of the same size.
    pub confidence: Vec<f32>,
    /// Standard deviation of V, px², of the same size.
    pub uncertainty: Vec<f32>,
    /// Width and height of the photographs, about whose centre T is stated.
    pub photograph: [u32; 2],
    /// T.
    pub transform: Homography,
    /// Which image was taken to be focused nearer.
    pub nearer: Nearer,
    /// Depth through a lens, once it is [seen through](Self::seen_through) one.
    pub metric: Option<MetricDepth>,
    /// The whole of `report.json`.
    report: Value,
}

impl Solved {
    /// Reads a folder.
    ///
    /// # Errors
    /// [`Error::File`]: a file is missing or damaged, or not of the size of `relative_blur.exr`.
    pub fn read(folder: &Path) -> Result<Self, Error> {
        if !folder.is_dir() {
            return Err(Error::file(folder, "is no folder; give the one that parfocal solve -o wrote"));
        }
        let [blur, confidence, _, _, json, uncertainty, ..] = FILES.map(|name| folder.join(name));
        let report = read_report(&json)?;
        if is_of_sweep(&report) {
            return Err(Error::file(folder, "holds a focus sweep; give the folder of a pair, from parfocal solve"));
        }
        let nearer = nearer_of(&report, &json)?;
        let (transform, _) = read_transform(&json)?;
        let (width, height, relative_blur) = image_io::read_field(&blur)?;
        let side = |name: &str| report["photograph"][name].as_u64().and_then(|side| u32::try_from(side).ok());
        let photograph = [side("width").unwrap_or(width), side("height").unwrap_or(height)];
        let solved = Self {
            folder: folder.to_path_buf(),
            width,
            height,
            relative_blur,
            confidence: Vec::new(),
            uncertainty: Vec::new(),
            photograph,
            transform,
            nearer,
            metric: None,
            report,
        };
        let (confidence, uncertainty) = (solved.field(&confidence)?, solved.field(&uncertainty)?);
        Ok(Self { confidence, uncertainty, ..solved })
    }

    /// Measures V, and depth where the report states a lens.
    ///
    /// # Errors
    /// [`Error::Region`]; [`Error::File`]: the report states a lens that is none.
    pub fn measure(&self, wanted: &Wanted) -> Result<Measurements, Error> {
        let metric = self.lens()?.map(|lens| self.through(&lens));
        wanted.measure(&Measurable::of_relative_blur(
            self.width,
            &self.relative_blur,
            &self.uncertainty,
            metric.as_ref(),
        ))
    }

    /// The largest |V| that the solve allowed, px², where the report says so.
    pub(crate) fn limit(&self) -> f64 {
        let stated = self.report.get("settings").and_then(|settings| settings.get("max_relative_blur"));
        stated.and_then(Value::as_f64).unwrap_or(f64::INFINITY)
    }

    /// The lens that the report states, if it states one.
    ///
    /// # Errors
    /// [`Error::File`]: it states one that is none.
    pub fn lens(&self) -> Result<Option<Lens>, Error> {
        let Some(stated) = self.report.get("depth").and_then(|depth| depth.get("lens")) else { return Ok(None) };
        let wrap = |problem: String| {
            let file = self.folder.join(FILES[4]);
            Error::file(&file, format!("states a lens that cannot be used ({problem}); run parfocal depth again"))
        };
        let lens = Lens::deserialize(stated).map_err(|e| wrap(e.to_string()))?;
        lens.check().map_err(|e| wrap(e.to_string()))?;
        Ok(Some(lens))
    }

    /// Its depth through a lens.
    pub fn through(&self, lens: &Lens) -> MetricDepth {
        let (scale, width) = (self.transform.scale(), self.width);
        MetricDepth::new(lens, scale, self.limit(), width, &self.relative_blur, &self.uncertainty)
    }

    /// The whole of `report.json`.
    pub fn report(&self) -> &Value {
        &self.report
    }

    /// The same, to be added to.
    pub fn report_mut(&mut self) -> &mut Value {
        &mut self.report
    }

    /// Whether a file of this name belongs to it.
    pub fn has(&self, name: &str) -> bool {
        self.report["files"].as_array().is_some_and(|files| files.contains(&json!(name)))
    }

    /// What nothing explains, of the same size.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn residual(&self) -> Result<Vec<f32>, Error> {
        self.field(&self.folder.join(FILES[6]))
    }

    /// The same through the lens that the report states, if it states one.
    ///
    /// # Errors
    /// [`Error::File`]: it states one that is none.
    pub fn as_stated(&self) -> Result<Self, Error> {
        Ok(Self { metric: self.lens()?.map(|lens| self.through(&lens)), ..self.clone() })
    }

    /// The same through a lens, which its report states too.
    pub fn seen_through(&self, lens: &Lens) -> Self {
        let metric = self.through(lens);
        let nearer = Nearer::of_lens(lens);
        // An object: `nearer` was read from it.
        let mut report = self.report.clone();
        report["nearer"] = nearer.number().into();
        beside::restate(&mut report, "nearer_by", "lens");
        report["depth"] = json!(DepthReport::from(&metric));
        if let Some(warnings) = report.get_mut("warnings").and_then(Value::as_array_mut) {
            warnings.retain(|warning| !warning.as_str().is_some_and(|text| text.starts_with(DOUBT)));
            warnings.extend(self.doubt(&metric).map(Value::from));
        }
        if report.get("depth16").is_some() {
            report["depth16"] = json!(Depth16::of_depth(&self.measured(&metric)).report());
        }
        Self { nearer, report, metric: Some(metric), ..self.clone() }
    }

    /// What speaks against the lens of a depth of it, if anything does.
    pub fn doubt(&self, metric: &MetricDepth) -> Option<String> {
        metric.doubt(self.transform.scale(), self.limit(), &self.relative_blur)
    }

    /// The same with these measurements in its report.
    pub fn with_measurements(&self, measured: &Measurements) -> Self {
        Self { report: beside::with_measurements(self.report.clone(), measured), ..self.clone() }
    }

    /// V without what was filled in, px².
    pub fn measured_blur(&self) -> Vec<f32> {
        self.texture().without(&self.relative_blur)
    }

    /// Depth without it, where it is known.
    pub fn measured_depth(&self) -> Option<MetricDepth> {
        self.metric.as_ref().map(|metric| self.measured(metric))
    }

    /// The part of I1 that it is of.
    pub fn region(&self) -> Region {
        let whole = Region { x: 0, y: 0, width: self.width, height: self.height };
        Region::deserialize(&self.report["region"]).unwrap_or(whole)
    }

    /// The fused image, of the same size.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn fused(&self) -> Result<Frame, Error> {
        let file = self.folder.join(if self.has(FUSED_FLOAT_FILE) { FUSED_FLOAT_FILE } else { FILES[3] });
        let fused = image_io::read(&file)?;
        self.of_size(&file, (fused.width(), fused.height())).map(|()| fused)
    }

    fn measured(&self, metric: &MetricDepth) -> MetricDepth {
        MetricDepth { depth: self.texture().without(&metric.depth), ..metric.clone() }
    }

    /// Writes its depth in mm into its folder: `depth_mm.exr`, `report.json`, and `depth.png` anew;
    /// `depth16.png` and `depth16.tiff` too, if the report says that they are there; and what shows it besides, as is given.
    /// All of it, or none. What shows depth and is not given is removed, as far as the report lists it.
    /// With `force`, files that it does not list are overwritten.
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
        let Some(metric) = &self.metric else { return Ok(()) };
        let depth16 = self.report.get("depth16").map(|_| Depth16::of_depth(&self.measured(metric)));
        let stale = beside::stale(&shown);
        let mut staging = beside::staging(&self.folder, force, &stale)?;
        staging.add(DEPTH_FILE, |w| metric::write(w, metric))?;
        let map = Map::of_depth(metric, palette);
        let marked = self.texture().marked;
        staging.add(FILES[2], |w| depth::write(w, &map.marking(&marked), pen))?;
        for extra in depth16.iter().flat_map(Depth16::files).chain(shown) {
            staging.add(extra.name, |w| (extra.fill)(w))?;
        }
        beside::finish(staging, self.report.clone(), &stale)
    }

    /// Refuses, before it is made, what [`write_depth`](Self::write_depth) would not write.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn check_depth(&self, force: bool) -> Result<(), Error> {
        let depth16 = self.report.get("depth16").map_or(&[][..], |_| &DEPTH16_FILES);
        let shown: Vec<&str> = showing_depth().filter(|name| self.has(name)).collect();
        beside::check(&self.folder, &[&[DEPTH_FILE, FILES[2]], depth16, &shown].concat(), force)
    }

    /// Refuses, before it is made, what [`write_measurements`](Self::write_measurements) would not write.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn check_measurements(&self, wanted: &Wanted, force: bool) -> Result<(), Error> {
        beside::check_measurements(&self.folder, wanted, force)
    }

    /// Which pixels the solve marked as without texture.
    fn texture(&self) -> Texture {
        let stated = self.report["texture"]["max_uncertainty_px2"].as_f64();
        Texture::beyond(stated.map_or(f32::INFINITY, |most| most as f32), &self.uncertainty)
    }

    /// Adds measurements to the folder: the files of the profiles, and `measurements` in `report.json`. Steps take the place
    /// of earlier steps there, profiles of earlier profiles; where this has none, the earlier ones stay. What shows them, the
    /// page, as it is given. All of it, or none. With `force`, files that the report does not list are overwritten.
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

    /// A field of the same size.
    fn field(&self, path: &Path) -> Result<Vec<f32>, Error> {
        let (w, h, values) = image_io::read_field(path)?;
        self.of_size(path, (w, h)).map(|()| values)
    }

    fn of_size(&self, path: &Path, (w, h): (u32, u32)) -> Result<(), Error> {
        if (w, h) == (self.width, self.height) {
            return Ok(());
        }
        let problem =
            format!("is {w}x{h} and relative_blur.exr is {}x{}; solve the pair again", self.width, self.height);
        Err(Error::file(path, problem))
    }
}
