//! What later steps need of the folder of a solve: V, how far to trust it, and the report.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::Value;

use super::measurements::{Measurements, Wanted};
use super::metric::{DEPTH_FILE, DepthReport};
use super::results::{nearer_of, read_report};
use super::staging::Staging;
use super::{EXTRA_FILES, FILES, Nearer, depth, metric, read_transform, remove_stale};
use crate::{Error, Lens, MetricDepth, Similarity, image_io};

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
    /// T.
    pub transform: Similarity,
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
        let [blur, confidence, _, _, json, uncertainty] = FILES.map(|name| folder.join(name));
        let report = read_report(&json)?;
        let nearer = nearer_of(&report, &json)?;
        let (transform, _) = read_transform(&json)?;
        let (width, height, relative_blur) = image_io::read_field(&blur)?;
        let solved = Self {
            folder: folder.to_path_buf(),
            width,
            height,
            relative_blur,
            confidence: Vec::new(),
            uncertainty: Vec::new(),
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
        wanted.measure(self.width, &self.relative_blur, &self.uncertainty, metric.as_ref())
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
        let (scale, width) = (self.transform.scale, self.width);
        MetricDepth::new(lens, scale, self.limit(), width, &self.relative_blur, &self.uncertainty)
    }

    /// Adds metric depth to the folder: `depth_mm.exr`, `depth` in `report.json`, and `depth.png` anew, whose near and far
    /// are now known. All of it, or none. Where near and far change places, the [`EXTRA_FILES`] that show them are removed.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn write_depth(&self, metric: &MetricDepth) -> Result<(), Error> {
        let nearer = Nearer::of_lens(&metric.lens);
        // An object: `nearer` was read from it.
        let mut report = self.report.clone();
        report["nearer"] = nearer.number().into();
        let json = serde_json::to_value(DepthReport::from(metric)).and_then(|depth| {
            report["depth"] = depth;
            serde_json::to_string_pretty(&report)
        });
        let [_, _, picture, _, report_file, _] = FILES;
        let mut staging = Staging::new(&self.folder)?;
        staging.add(DEPTH_FILE, |w| metric::write(w, metric))?;
        staging.add(picture, |w| depth::write(w, (self.width, self.height), &self.relative_blur, nearer))?;
        staging.add(report_file, |w| {
            use std::io::Write;
            json.map_err(|e| e.to_string()).and_then(|text| writeln!(w, "{text}").map_err(|e| e.to_string()))
        })?;
        staging.place()?;
        if nearer == self.nearer {
            return Ok(());
        }
        // They show near and far the other way round.
        EXTRA_FILES.into_iter().try_for_each(|name| remove_stale(&self.folder.join(name)))
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
