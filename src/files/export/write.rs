//! Writes results into a folder: all files or none.

use std::fs::File;
use std::io::{BufWriter, Seek, Write};

use png::ColorType;

use super::destination::Destination;
use super::fused::{FUSED_FILE, FUSED_FLOAT_FILE};
use super::image_files::{self, Description, Pixels, write_channels, write_field, write_png};
use super::measurements::{MeasurementRequest, is_profile};
use super::report::{FieldReport, Kind, Measurements, REPORT_FILE, write_json_to};
use super::results::{DEPTH_FILE, DEPTH_PICTURE_FILE, Drawing, Extra, NewFile, PAGE_FILE, Results};
use super::staging::Staging;
use super::{arrays, maps};
use crate::base::{Depth, Error};
use crate::files::image_io::Carried;

/// Files that show depth. They are written again when depth changes.
const DEPTH_EXPORTS: [&str; 17] = [
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
    "surface.x3p",
    "surface.sdf",
    "surface_ascii.sdf",
    "surface_x.tiff",
    "surface_y.tiff",
    "surface_z.tiff",
];

/// Greatest number of pixels of results whose files are written in parallel, 16 Mi. Files of larger results are written
/// one after the other, since each may need some 50 bytes of memory per pixel.
const MAX_PARALLEL_PIXELS: u64 = 1 << 24;

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
        let Some(is_in_floats) = self.fused.as_ref().map(|fused| fused.depth == Depth::F32) else {
            return Err(Error::Mismatch("results that were read from a folder cannot be written again".to_string()));
        };
        let staging = Staging::replacing(out.into(), REPORT_FILE)?;
        let fields = self.report.kind.fields().iter();
        let mut files: Vec<NewFile<'_>> = fields
            .map(|(name, file, description)| {
                NewFile::new(*file, |results, w| results.write_field(name, description, w))
            })
            .collect();
        files.extend(self.depth_files(drawing));
        files.push(NewFile::new(FUSED_FILE, |results, w| results.write_fused(w)));
        if is_in_floats {
            files.push(NewFile::new(FUSED_FLOAT_FILE, |results, w| {
                results.fused.as_ref().map_or(Ok(()), |fused| fused.write_exr(w))
            }));
        }
        files.extend(self.report.measurements.iter().flat_map(|measured| measured.files(drawing.plotter)));
        files.extend(extras.into_iter().map(NewFile::from));
        self.report.hashes.clear();
        self.report.files.clear();
        self.finish(staging, &[], files)
    }

    /// Writes `fused.png`. It carries the metadata of the reference's photograph.
    fn write_fused(&self, writer: impl Write + Seek) -> Result<(), String> {
        let (Some(fused), report) = (&self.fused, &self.report) else { return Ok(()) };
        let reference = report.order.get(report.reference).unwrap_or(&report.reference);
        let input = report.inputs.get(*reference);
        let curve = input.filter(|input| report.values.converts(input)).and_then(|input| input.carried.curve.as_ref());
        fused.write_png(writer, input.map_or(&Carried::default(), |input| &input.carried), curve)
    }

    /// Writes the field of this name.
    fn write_field(&self, name: &str, description: &Description, writer: impl Write + Seek) -> Result<(), String> {
        match name {
            "valid" => self.write_valid(writer),
            "frames" => self.write_frames(writer),
            "beyond" => self.write_beyond(writer),
            _ => {
                let values = self.field(name).map_err(|e| e.to_string())?;
                write_field(writer, self.size(), &values, description)
            }
        }
    }

    /// 255 where the results are measured, else 0.
    fn write_valid(&self, writer: impl Write) -> Result<(), String> {
        let measured = self.values().iter().zip(&self.marked).map(|(value, marked)| value.is_finite() && !marked);
        let bytes: Vec<u8> = measured.map(|measured| if measured { 255 } else { 0 }).collect();
        self.write_gray(writer, &Pixels::Bytes(&bytes), &image_files::VALID)
    }

    /// The number of the frame that supplies each pixel of the fused image, from 1; in 16 bits for more than 255
    /// frames.
    fn write_frames(&self, writer: impl Write) -> Result<(), String> {
        let bytes: Result<Vec<u8>, _> = self.frames.iter().map(|frame| u8::try_from(*frame)).collect();
        let pixels = bytes.as_ref().map_or(Pixels::Words(self.frames), |bytes| Pixels::Bytes(bytes));
        self.write_gray(writer, &pixels, &image_files::FRAMES)
    }

    /// 1 for pixels in focus before the first frame, 2 beyond the last, else 0.
    fn write_beyond(&self, writer: impl Write) -> Result<(), String> {
        let side = |side: &i8| if *side < 0 { 1 } else { 2 * u8::from(*side > 0) };
        let bytes: Vec<u8> = self.beyond.iter().map(side).collect();
        self.write_gray(writer, &Pixels::Bytes(&bytes), &image_files::BEYOND)
    }

    fn write_gray(&self, writer: impl Write, pixels: &Pixels<'_>, description: &Description) -> Result<(), String> {
        write_png(writer, self.size(), ColorType::Grayscale, pixels, description)
    }

    /// `depth.png`, and `depth_mm.exr` if depth is known.
    fn depth_files(&self, drawing: &Drawing) -> Vec<NewFile<'static>> {
        let in_mm = self.depth.is_some().then(|| NewFile::new(DEPTH_FILE, |results, w| results.write_depth_mm(w)));
        let drawing = *drawing;
        let picture = NewFile::new(DEPTH_PICTURE_FILE, move |results, w| maps::write(w, results, &drawing));
        in_mm.into_iter().chain([picture]).collect()
    }

    fn write_depth_mm(&self, writer: impl Write + Seek) -> Result<(), String> {
        let Some(depth) = self.depth() else { return Ok(()) };
        let channels = [("Y", &depth.values[..]), ("standard_deviation", &depth.deviation)];
        write_channels(writer, self.size(), &channels, self.depth_description())
    }

    /// Writes depth in mm into `out`, the folder of the results: `depth_mm.exr`, `depth.png`, the report, `depth16` if it
    /// exists, and the files `shown`; all of them or none. Removes other files that show depth.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn write_depth(
        &mut self,
        out: Destination<'_>,
        drawing: &Drawing,
        mut shown: Vec<Extra<'_>>,
    ) -> Result<(), Error> {
        if self.report.depth16.is_some() {
            let depth16 = arrays::Depth16::of(self);
            self.report.depth16 = Some(depth16.report());
            shown.extend(depth16.into_files());
        }
        let stale = DEPTH_EXPORTS.into_iter().filter(|name| !shown.iter().any(|extra| extra.name == *name));
        let stale: Vec<String> = stale.map(String::from).collect();
        let staging = Staging::joining(out, REPORT_FILE, stale.clone())?;
        let mut files: Vec<NewFile<'_>> = self.depth_files(drawing);
        files.extend(shown.into_iter().map(NewFile::from));
        self.finish(staging, &stale, files)
    }

    /// Checks that [`write_depth`](Self::write_depth) may write its files.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn check_depth(&self, out: Destination<'_>) -> Result<(), Error> {
        let exports = DEPTH_EXPORTS.into_iter().chain(arrays::DEPTH16_FILES).filter(|name| self.report.has_file(name));
        let names: Vec<&str> = exports.chain([DEPTH_FILE, DEPTH_PICTURE_FILE, REPORT_FILE]).collect();
        out.check_results(REPORT_FILE, &names)
    }

    /// Writes measurements into `out`, the folder of the results: profiles, the report and the files `shown`; all of them or
    /// none. New steps replace earlier steps, and new profiles earlier profiles. Removes a page that is not in `shown`.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn write_measurements(
        &mut self,
        out: Destination<'_>,
        measured: &Measurements,
        drawing: &Drawing,
        shown: Vec<Extra<'_>>,
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
        let staging = Staging::joining(out, REPORT_FILE, stale.clone())?;
        let mut files: Vec<NewFile<'_>> = measured.files(drawing.plotter);
        files.extend(shown.into_iter().map(NewFile::from));
        self.finish(staging, &stale, files)
    }

    /// Checks that [`write_measurements`](Self::write_measurements) may write its files.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn check_measurements(&self, out: Destination<'_>, request: &MeasurementRequest) -> Result<(), Error> {
        let mut names = request.files();
        names.push(REPORT_FILE.to_string());
        out.check_results(REPORT_FILE, &names)
    }

    /// The files of [`Kind::fields`] and of depth, as listed in the report.
    fn field_reports(&self) -> Vec<FieldReport> {
        let fields = self.report.kind.fields().iter();
        let fields = fields.map(|(name, file, description)| FieldReport::new(name, file, description));
        fields
            .chain(self.depth.as_ref().map(|_| FieldReport::new("depth", DEPTH_FILE, self.depth_description())))
            .collect()
    }

    /// Writes the files and the report, and renames all of them.
    fn finish(&mut self, mut staging: Staging, stale: &[String], files: Vec<NewFile<'_>>) -> Result<(), Error> {
        self.report.fields = self.field_reports();
        self.report.files.retain(|file| !stale.contains(file));
        for name in files.iter().map(|file| &*file.name).chain([REPORT_FILE]) {
            if !self.report.has_file(name) {
                self.report.files.push(name.to_string());
            }
        }
        let results = &*self;
        let contents = files
            .into_iter()
            .map(|NewFile { name, fill }| (name.into_owned(), move |w: &mut BufWriter<&mut File>| fill(results, w)));
        let mut contents = contents.peekable();
        let size = self.report.size;
        let is_large = u64::from(size.width) * u64::from(size.height) > MAX_PARALLEL_PIXELS;
        while contents.peek().is_some() {
            staging.add_all(contents.by_ref().take(if is_large { 1 } else { usize::MAX }).collect())?;
        }
        self.report.hashes.retain(|file, _| !stale.contains(file));
        self.report.hashes.extend(staging.hashes());
        // The report is renamed last: where it exists, so do the other files (`batch --resume`).
        staging.add(REPORT_FILE, |w| write_json_to(w, &self.report))?;
        staging.place()
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use serde_json::Value;
    use tempfile::TempDir;

    use super::super::{Kind, Nearer, RangeReport, Registration, Report};
    use super::*;
    use crate::base::{Decode, Depth, DeviceInfo, Error, Photometric, Region, Samples, Settings, Similarity};
    use crate::engine::{Findings, LevelHistory, Solution, Timings, TransformDeviation};
    use crate::files::image_io::{self, Values};

    fn solution() -> Solution {
        let findings = Findings {
            width: 3,
            height: 2,
            photograph: [3, 2],
            transform: Similarity::new(1.25, -0.5, 0.15, 1.01).into(),
            transform_deviation: Some(TransformDeviation { corner_px: 0.02, direction_deg: 30.0 }),
            photometric: Photometric { gain: 1.02, offset: -0.01 },
            solved: Region { x: 0, y: 0, width: 3, height: 2 },
            regularization: 0.003,
            kernel_shape: Some(1.0),
            separation: Some(9.0),
            scale_deviation: 0.1,
            levels: vec![LevelHistory { width: 2, height: 1, energy: vec![0.5, f64::NAN] }],
            converged: true,
            warnings: vec!["a warning".to_string()],
            valid_fraction: 4.0 / 6.0,
            saturated_fraction: f64::NAN,
            clipped_fractions: [0.02, 0.0],
            unsettled_fraction: 0.1,
            noise: 0.0025,
            timings: Timings {
                total_ms: 9.0,
                gpu_ms: 7.0,
                passes_ms: vec![("warp", 1.0), ("blur", 2.0), ("apply", 3.0)],
            },
            ..Findings::default()
        };
        Solution {
            relative_blur: vec![f32::NAN, -1.5, 0.1, 2.0, 4.0, f32::NAN],
            uncertainty: vec![f32::NAN, 3f32.sqrt(), 1.0, (1.0f32 / 3.0).sqrt(), 0.0, f32::NAN],
            residual: vec![f32::NAN, 0.01, 0.02, 0.01, 0.03, f32::NAN],
            confidence: vec![0.0, 0.25, 0.5, 0.75, 1.0, 0.0],
            fused: vec![-0.1, 0.0, 0.2, 0.5, 1.0, 1.5],
            findings,
        }
    }

    fn device() -> DeviceInfo {
        DeviceInfo {
            name: "a device".to_string(),
            driver: "a driver 1.2".to_string(),
            uuid: "00000000-0000-0000-0000-000000000001".to_string(),
            ..DeviceInfo::default()
        }
    }

    fn report() -> Report {
        Report::pair(&solution(), &Settings::default(), &device(), Nearer::First)
    }

    fn write(out: &Path, solution: &Solution, depth: Depth) -> Result<(), Error> {
        let mut report = report();
        report.values = Values::stated(Decode::None);
        Results::of_pair(solution, report, [depth; 2])?.write(out, &Drawing::default(), Vec::new())
    }

    fn keys(value: &Value) -> Vec<&str> {
        let mut keys: Vec<&str> = value.as_object().unwrap().keys().map(String::as_str).collect();
        keys.sort_unstable();
        keys
    }

    #[test]
    fn the_report_has_the_fields_that_scripts_read() {
        let text = report().to_json().unwrap();
        let json: Value = serde_json::from_str(&text).unwrap();
        let expected = "program kind version frames reference regularization max_relative_blur method settings size \
             kernel_shape separation scale_deviation levels transform_deviation converged relative_blur valid_fraction mean_confidence saturated_fraction unsettled_fraction unexplained_fraction nearer nearer_by \
             warnings device validated values inputs photograph region texture timings_ms";
        let mut expected: Vec<&str> = expected.split(' ').collect();
        expected.sort_unstable();
        assert_eq!(keys(&json), expected);
        assert_eq!((&json["program"], &json["kind"]), (&"parfocal".into(), &"pair".into()));
        assert_eq!(keys(&json["frames"][1]), ["clipped_fraction", "file", "gain", "offset", "shading", "transform"]);
        assert_eq!(keys(&json["frames"][1]["transform"]), ["rotation_deg", "scale", "tx_px", "ty_px"]);
        assert_eq!(keys(&json["frames"][1]["shading"]), ["coefficients", "range", "region"]);
        assert_eq!((&json["frames"][0]["gain"], &json["frames"][1]["gain"]), (&1.0.into(), &1.02.into()));
        assert_eq!(keys(&json["levels"][0]), ["energy", "height", "iterations", "width"]);
        assert_eq!(keys(&json["relative_blur"]), ["max", "median", "min"]);
        assert_eq!(keys(&json["transform_deviation"]), ["corner_px", "direction_deg"]);
        assert_eq!(keys(&json["timings_ms"]), ["gpu", "passes", "total"]);
        assert_eq!((&json["method"], &json["nearer"]), (&Value::from("unified"), &Value::from(1)));
        assert_eq!(json["settings"]["levels"], Value::Null);
        assert_eq!(json["settings"]["start_photometric"]["gain"], Value::from(1.0));
        assert_eq!(json["levels"][0]["iterations"], Value::from(2));
        assert_eq!((&json["levels"][0]["energy"][1], &json["saturated_fraction"]), (&Value::Null, &Value::Null));
        assert_eq!(json["relative_blur"]["median"], Value::from(1.05));
        let places: Vec<_> = ["\"warp\"", "\"blur\"", "\"apply\""].map(|name| text.find(name).unwrap()).to_vec();
        assert!(places.is_sorted(), "passes are out of order");
        let again = serde_json::from_str::<Report>(&text).unwrap().to_json().unwrap();
        let mut back: Value = serde_json::from_str(&again).unwrap();
        // Transforms pass through a matrix, and serde_json reads the last bit of a number either way.
        back["frames"] = json["frames"].clone();
        assert_eq!(back, json, "it is read as it was written");
    }

    #[test]
    fn without_a_valid_pixel_the_range_is_null() {
        let json = serde_json::to_value(RangeReport::of(&[f32::NAN; 4])).unwrap();
        assert!(["min", "max", "median"].iter().all(|name| json[name].is_null()));
    }

    #[test]
    fn the_files_of_a_solve_are_read_as_they_were_written() {
        let base = TempDir::new().unwrap();
        let out = base.path().join("deep/out");
        write(&out, &solution(), Depth::U8).unwrap();
        let mut found: Vec<_> =
            fs::read_dir(&out).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        let mut expected = Kind::Pair.files();
        found.sort_unstable();
        expected.sort_unstable();
        assert_eq!(found, expected);

        let results = Results::read(&out).unwrap();
        assert_eq!(results.field("confidence").unwrap(), solution().confidence);
        assert!(results.field("focus").unwrap_err().to_string().contains("the fields are relative_blur"));
        assert!(results.values()[0].is_nan() && results.values()[1..5] == solution().relative_blur[1..5]);
        let stated: Vec<_> = results.report.fields.iter().map(|field| (&*field.name, &*field.file)).collect();
        assert_eq!(stated[0], ("relative_blur", "relative_blur.exr"));
        let hashed: Vec<_> = results.report.hashes.keys().map(String::as_str).collect();
        assert!(hashed.len() + 1 == expected.len() && !hashed.contains(&"report.json"));
        let registration = Registration::read(&out.join("report.json")).unwrap();
        let second = registration.second().unwrap();
        assert!(second.transform.corner_distance(solution().transform, 4000, 3000) < 1e-9);
        assert_eq!(second.photometric(), Some(solution().photometric));

        let image = exr::prelude::read_first_flat_layer_from_file(out.join("relative_blur.exr")).unwrap();
        assert_eq!(image.layer_data.channel_data.list[0].name.to_string(), "Y");
        let attributes = &image.layer_data.attributes;
        assert!(attributes.software_name.as_ref().unwrap().to_string().starts_with("parfocal "));
        assert_eq!(attributes.other.len(), 1);
    }

    #[test]
    fn the_fused_image_has_the_depth_of_the_inputs() {
        let base = TempDir::new().unwrap();
        let path = base.path().join("fused.png");
        write(base.path(), &solution(), Depth::U8).unwrap();
        assert_eq!(image_io::read(&path).unwrap().samples(), &Samples::U8(vec![0, 0, 51, 128, 255, 255]));
        // Floats beyond black and white are stretched.
        for (depth, samples, is_float) in [
            (Depth::U16, vec![0, 0, 13107, 32768, 65535, 65535], false),
            (Depth::F32, vec![0, 4096, 12288, 24576, 45055, 65535], true),
        ] {
            write(base.path(), &solution(), depth).unwrap();
            assert_eq!(image_io::read(&path).unwrap().samples(), &Samples::U16(samples));
            assert_eq!(base.path().join("fused.exr").exists(), is_float);
            assert_eq!(Results::read(base.path()).unwrap().report.tone.is_some(), is_float);
        }
        let fused = Results::read(base.path()).unwrap().fused().unwrap();
        assert_eq!(fused.samples(), &Samples::F32(solution().fused));
    }

    #[test]
    fn a_solution_that_contradicts_itself_is_not_written() {
        let base = TempDir::new().unwrap();
        let out = base.path().join("out");
        let mut wrong = solution();
        wrong.fused.pop();
        assert!(matches!(write(&out, &wrong, Depth::U8), Err(Error::Mismatch(_))));
        let mut wrong = solution();
        wrong.residual.pop();
        assert!(matches!(write(&out, &wrong, Depth::U8), Err(Error::Mismatch(_))));
        assert!(!out.exists());
    }
}
