//! Writes results into a folder: all files or none.

use std::io::Write;

use png::ColorType;

use super::destination::Destination;
use super::extra::{Drawing, Extra, PAGE_FILE};
use super::fused::{FUSED_FILE, FUSED_FLOAT_FILE};
use super::measurements::{MeasurementRequest, is_profile};
use super::png_file::{self, Pixels};
use super::report::{Kind, Measurements, REPORT_FILE, write_json_to};
use super::results::{DEPTH_FILE, DEPTH_PICTURE_FILE, Results};
use super::staging::Staging;
use super::{arrays, depth_picture, description, exr_file};
use crate::base::{Depth, Error};

/// Files that show depth. They are written again when depth changes.
const DEPTH_EXPORTS: [&str; 11] = [
    PAGE_FILE,
    "surface.ply",
    "points.ply",
    "surface.glb",
    "surface.stl",
    "surface.obj",
    "depth.npy",
    "deviation.npy",
    "depth.tiff",
    "deviation.tiff",
    "depth.zarr.zip",
];

/// Names of all files that a folder of results may hold, except profiles.
pub fn result_files() -> impl Iterator<Item = &'static str> {
    let [pair, sweep] = [Kind::Pair, Kind::Sweep].map(Kind::files);
    let exports = DEPTH_EXPORTS.into_iter().chain(arrays::DEPTH16_FILES);
    pair.into_iter().chain(sweep).chain(exports).chain(["labels.png", DEPTH_FILE, FUSED_FLOAT_FILE])
}

impl Results<'_> {
    /// Writes the results into the folder `out`. Creates the folder if it is missing.
    ///
    /// Replaces or removes files that the report of earlier results lists. Any other file stays; if it has the name of
    /// a result, nothing is written unless the [`Destination`] forces it. The new report lists the files and their
    /// hashes.
    ///
    /// Files are written under temporary names and renamed at the end. On failure the earlier results stay. If the
    /// program is ended meanwhile, the next run that writes into the folder restores them.
    ///
    /// # Errors
    /// [`Error::File`]; [`Error::Mismatch`] for results that were read from a folder.
    pub fn write<'d>(
        &mut self,
        out: impl Into<Destination<'d>>,
        drawing: &Drawing,
        extras: Vec<Extra<'_>>,
    ) -> Result<(), Error> {
        let Some(fused) = &self.fused else {
            return Err(Error::Mismatch("results that were read from a folder cannot be written again".to_string()));
        };
        let mut staging = Staging::replacing(out.into(), REPORT_FILE)?;
        let size = self.size();
        for (name, file, description) in self.report.kind.fields() {
            match *name {
                "valid" => staging.add(file, |w| self.write_valid(w))?,
                "frames" => staging.add(file, |w| write_frames(w, self))?,
                "beyond" => staging.add(file, |w| write_beyond(w, self))?,
                _ => {
                    let values = self.field(name)?;
                    staging.add(file, |w| exr_file::write(w, size, &values, description))?;
                }
            }
        }
        self.stage_depth(&mut staging, drawing)?;
        staging.add(FUSED_FILE, |w| fused.write_png(w))?;
        if fused.depth == Depth::F32 {
            staging.add(FUSED_FLOAT_FILE, |w| fused.write_exr(w))?;
        }
        if let Some(measured) = &self.report.measurements {
            measured.stage(&mut staging, drawing.plotter)?;
        }
        self.report.hashes.clear();
        self.report.files.clear();
        self.finish(staging, &[], extras)
    }

    /// 255 where the results are measured, else 0: 8-bit grey.
    fn write_valid(&self, writer: impl Write) -> Result<(), String> {
        let measured = self.values().iter().zip(&self.marked).map(|(value, marked)| value.is_finite() && !marked);
        let bytes: Vec<u8> = measured.map(|measured| if measured { 255 } else { 0 }).collect();
        png_file::write(writer, self.size(), ColorType::Grayscale, &Pixels::Bytes(&bytes), &description::VALID)
    }

    /// Adds `depth.png`, and `depth_mm.exr` if depth is known.
    fn stage_depth(&self, staging: &mut Staging, drawing: &Drawing) -> Result<(), Error> {
        if let Some(depth) = self.depth() {
            let channels = [("Y", &depth.values[..]), ("standard_deviation", &depth.deviation)];
            let description = self.depth_description();
            staging.add(DEPTH_FILE, |w| exr_file::write_channels(w, self.size(), &channels, description))?;
        }
        staging.add(DEPTH_PICTURE_FILE, |w| depth_picture::write(w, self, drawing))
    }

    /// Writes depth in mm into the folder of the results: `depth_mm.exr`, `depth.png`, the report, `depth16` if it
    /// exists, and the files `shown`; all of them or none. Removes other files that show depth. With `force`,
    /// overwrites files that the report does not list.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn write_depth(&mut self, drawing: &Drawing, mut shown: Vec<Extra<'_>>, force: bool) -> Result<(), Error> {
        if self.report.depth16.is_some() {
            let depth16 = arrays::Depth16::of(self);
            self.report.depth16 = Some(depth16.report());
            shown.extend(depth16.into_files());
        }
        let stale = DEPTH_EXPORTS.into_iter().filter(|name| !shown.iter().any(|extra| extra.name == *name));
        let stale: Vec<String> = stale.map(String::from).collect();
        let mut staging = self.joining(force, &stale)?;
        self.stage_depth(&mut staging, drawing)?;
        self.finish(staging, &stale, shown)
    }

    /// Checks that [`write_depth`](Self::write_depth) may write its files.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn check_depth(&self, force: bool) -> Result<(), Error> {
        let exports = DEPTH_EXPORTS.into_iter().chain(arrays::DEPTH16_FILES).filter(|name| self.report.has_file(name));
        let names: Vec<&str> = exports.chain([DEPTH_FILE, DEPTH_PICTURE_FILE, REPORT_FILE]).collect();
        Destination::new(&self.folder, force).check_results(REPORT_FILE, &names)
    }

    /// Writes measurements into the folder of the results: profiles, the report and the files `shown`; all of them or
    /// none. New steps replace earlier steps, and new profiles earlier profiles. Removes a page that is not in `shown`.
    /// With `force`, overwrites files that the report does not list.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn write_measurements(
        &mut self,
        measured: &Measurements,
        drawing: &Drawing,
        shown: Vec<Extra<'_>>,
        force: bool,
    ) -> Result<(), Error> {
        let new: Vec<&str> = measured.profiles.iter().flat_map(|p| [p.csv.as_str(), &p.png]).collect();
        let is_stale = |file: &&String| {
            let replaced = is_profile(file) && !new.is_empty() && !new.contains(&file.as_str());
            replaced || (*file == PAGE_FILE && !shown.iter().any(|extra| extra.name == PAGE_FILE))
        };
        let stale: Vec<String> = self.report.files.iter().filter(is_stale).cloned().collect();
        let known = self.report.measurements.get_or_insert_default();
        if !measured.steps.is_empty() {
            known.steps.clone_from(&measured.steps);
        }
        if !measured.profiles.is_empty() {
            known.profiles.clone_from(&measured.profiles);
        }
        let mut staging = self.joining(force, &stale)?;
        measured.stage(&mut staging, drawing.plotter)?;
        self.finish(staging, &stale, shown)
    }

    /// Checks that [`write_measurements`](Self::write_measurements) may write its files.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn check_measurements(&self, request: &MeasurementRequest, force: bool) -> Result<(), Error> {
        let mut names = request.files();
        names.push(REPORT_FILE.to_string());
        Destination::new(&self.folder, force).check_results(REPORT_FILE, &names)
    }

    /// Begins files that are added to those of the folder. Removes the `stale` ones of the existing files.
    fn joining(&self, force: bool, stale: &[String]) -> Result<Staging, Error> {
        Staging::joining(Destination::new(&self.folder, force), REPORT_FILE, stale.to_vec())
    }

    /// Adds the extras and the report, and renames all files.
    fn finish(&mut self, mut staging: Staging, stale: &[String], extras: Vec<Extra<'_>>) -> Result<(), Error> {
        self.report.fields = self.field_reports();
        self.report.files.retain(|file| !stale.contains(file));
        let names = staging.names().into_iter().chain(extras.iter().map(|extra| extra.name.to_string()));
        for name in names.chain([REPORT_FILE.to_string()]) {
            if !self.report.has_file(&name) {
                self.report.files.push(name);
            }
        }
        for Extra { name, fill } in extras {
            staging.add(name, |w| fill(self, w))?;
        }
        self.report.hashes.retain(|file, _| !stale.contains(file));
        self.report.hashes.extend(staging.hashes());
        // The report is renamed last: where it exists, so do the other files (`batch --resume`).
        staging.add(REPORT_FILE, |w| write_json_to(w, &self.report))?;
        staging.place()
    }
}

/// Writes `frames.png`: the number of the frame that supplies each pixel of the fused image, from 1. 8-bit grey; 16-bit
/// grey for more than 255 frames.
fn write_frames(writer: impl Write, results: &Results<'_>) -> Result<(), String> {
    let bytes: Result<Vec<u8>, _> = results.frames.iter().map(|frame| u8::try_from(*frame)).collect();
    let pixels = bytes.as_ref().map_or(Pixels::Words(results.frames), |bytes| Pixels::Bytes(bytes));
    png_file::write(writer, results.size(), ColorType::Grayscale, &pixels, &description::FRAMES)
}

/// Writes `beyond.png`: 1 for pixels in focus before the first frame, 2 beyond the last, else 0; 8-bit grey.
fn write_beyond(writer: impl Write, results: &Results<'_>) -> Result<(), String> {
    let side = |side: &i8| if *side < 0 { 1 } else { 2 * u8::from(*side > 0) };
    let bytes: Vec<u8> = results.beyond.iter().map(side).collect();
    png_file::write(writer, results.size(), ColorType::Grayscale, &Pixels::Bytes(&bytes), &description::BEYOND)
}
