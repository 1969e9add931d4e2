//! What later steps need of the folder of a solve: V, how far to trust it, and the report.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::{Value, json};

use super::beside;
use super::depth::{self, Map};
use super::depth16::{DEPTH16_FILES, Depth16};
use super::extra::with_near_and_far;
use super::measurements::{Measurable, Measurements, Wanted};
use super::metric::DEPTH_FILE;
use super::report::DepthReport;
use super::results::{is_of_sweep, nearer_of, read_report};
use super::{FILES, Nearer, Palette, Pen, Texture, metric, read_transform};
use crate::base::{Error, Homography, Lens};
use crate::files::image_io;
use crate::metric::MetricDepth;

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
    fn limit(&self) -> f64 {
        let stated = self.report.get("settings").and_then(|settings| settings.get("max_relative_blur"));
        stated.and_then(Value::as_f64).unwrap_or(f64::INFINITY)
    }

    /// The lens that the report states, if it states one.
    fn lens(&self) -> Result<Option<Lens>, Error> {
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

    /// Adds metric depth to the folder: `depth_mm.exr`, `depth` in `report.json`, and `depth.png` anew, in mm; `depth16.png`
    /// and `depth16.tiff` too, if the report says that they are there. All of it, or none. Where near and far change places,
    /// the other files that show them are removed, as far as the report lists them. With `force`, files that it does not
    /// list are overwritten.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn write_depth(
        &self,
        metric: &MetricDepth,
        palette: Palette,
        pen: Option<Pen>,
        force: bool,
    ) -> Result<(), Error> {
        let nearer = Nearer::of_lens(&metric.lens);
        // An object: `nearer` was read from it.
        let mut report = self.report.clone();
        report["nearer"] = nearer.number().into();
        report["depth"] = json!(DepthReport::from(metric));
        let texture = self.texture();
        let measured = MetricDepth { depth: texture.without(&metric.depth), ..metric.clone() };
        let depth16 = report.get("depth16").map(|_| Depth16::of_depth(&measured));
        if let Some(depth16) = &depth16 {
            report["depth16"] = json!(depth16.report());
        }
        let picture = FILES[2];
        // They show near and far the other way round.
        let turned = if nearer == self.nearer { Vec::new() } else { with_near_and_far().map(String::from).collect() };
        let mut staging = beside::staging(&self.folder, force, &turned)?;
        staging.add(DEPTH_FILE, |w| metric::write(w, metric))?;
        staging.add(picture, |w| depth::write(w, &Map::of_depth(metric, palette).marking(&texture.marked), pen))?;
        for extra in depth16.iter().flat_map(Depth16::files) {
            staging.add(extra.name, |w| (extra.fill)(w))?;
        }
        beside::finish(staging, report, &turned)
    }

    /// Refuses, before it is made, what [`write_depth`](Self::write_depth) would not write.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn check_depth(&self, force: bool) -> Result<(), Error> {
        let depth16 = self.report.get("depth16").map_or(&[][..], |_| &DEPTH16_FILES);
        beside::check(&self.folder, &[&[DEPTH_FILE, FILES[2]], depth16].concat(), force)
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
    /// of earlier steps there, profiles of earlier profiles; where this has none, the earlier ones stay. All of it, or none. With `force`,
    /// files that the report does not list are overwritten.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn write_measurements(&self, measured: &Measurements, pen: Option<Pen>, force: bool) -> Result<(), Error> {
        beside::write_measurements(&self.folder, self.report.clone(), measured, pen, force)
    }

    /// A field of the same size.
    fn field(&self, path: &Path) -> Result<Vec<f32>, Error> {
        let (w, h, values) = image_io::read_field(path)?;
        if (w, h) == (self.width, self.height) {
            return Ok(values);
        }
        let problem =
            format!("is {w}x{h} and relative_blur.exr is {}x{}; solve the pair again", self.width, self.height);
        Err(Error::file(path, problem))
    }
}
