//! Results of a pair or a focus sweep, in memory or in a folder, and their additional files.

use std::borrow::Cow;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use image::RgbImage;

use super::fused::{FUSED_FILE, FUSED_FLOAT_FILE, Fused};
use super::image_files::{
    BEYOND, CONFIDENCE, Description, FOCUS, FOCUS_UNCERTAINTY, FRAMES, RELATIVE_BLUR, RESIDUAL, UNCERTAINTY, VALID,
};
use super::report::{
    DepthReport, FieldReport, Kind, NearerBy, ProfileReport, REPORT_FILE, Report, SizeReport, TextureReport, UNITS,
    invalid, read_json,
};
use super::scale::{Nearer, Palette, Quantity, Scale};
use crate::base::{Channels, Depth, Error, Frame, Lens, Region, Samples};
use crate::engine::Solution;
use crate::engine::solution::confidence;
use crate::engine::stages::scale_deviation::without_scale;
use crate::files::image_io;
use crate::metric::{DOUBT, MetricDepth, evidence};
use crate::solve::sweep::{Positions, Sweep};

/// The page of results.
pub const PAGE_FILE: &str = "report.html";

/// Depth in mm, channel `Y`, and its standard deviation, channel `standard_deviation`.
pub const DEPTH_FILE: &str = "depth_mm.exr";

/// `depth.png`: a picture of depth, or of V or focus if depth is not known.
pub const DEPTH_PICTURE_FILE: &str = "depth.png";

/// A field: its name, its file and its description.
type FieldFile = (&'static str, &'static str, &'static Description);

/// Fields of a pair.
static PAIR_FIELDS: [FieldFile; 5] = [
    ("relative_blur", "relative_blur.exr", &RELATIVE_BLUR),
    ("uncertainty", "uncertainty.exr", &UNCERTAINTY),
    ("confidence", "confidence.exr", &CONFIDENCE),
    ("residual", "residual.exr", &RESIDUAL),
    ("valid", "valid.png", &VALID),
];

/// Fields of a sweep.
static SWEEP_FIELDS: [FieldFile; 5] = [
    ("focus", "focus.exr", &FOCUS),
    ("uncertainty", "uncertainty.exr", &FOCUS_UNCERTAINTY),
    ("valid", "valid.png", &VALID),
    ("frames", "frames.png", &FRAMES),
    ("beyond", "beyond.png", &BEYOND),
];

impl Kind {
    /// Fields of the results of this kind.
    pub(super) fn fields(self) -> &'static [FieldFile] {
        match self {
            Self::Pair => &PAIR_FIELDS,
            Self::Sweep => &SWEEP_FIELDS,
            _ => &[],
        }
    }

    /// Files that every solve of this kind writes.
    pub fn files(self) -> Vec<&'static str> {
        let fields = self.fields().iter().map(|(_, file, _)| *file);
        fields.chain([DEPTH_PICTURE_FILE, FUSED_FILE, REPORT_FILE]).collect()
    }
}

/// Results of a pair or a focus sweep: the report, and fields of one size.
///
/// ```no_run
/// use std::path::Path;
///
/// use parfocal::export::Results;
///
/// let results = Results::read(Path::new("out"))?;
/// let sigma = results.field("uncertainty")?;
/// println!("{} of {} pixels, T {:?}", results.report.frames.len(), sigma.len(), results.report.frames[1].transform);
/// # Ok::<(), parfocal::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Results<'a> {
    /// The folder; empty for results that were not read.
    pub folder: PathBuf,
    /// The report of the results.
    pub report: Report,
    /// Fields in memory.
    fields: Vec<(&'static str, Cow<'a, [f32]>)>,
    /// Depth and its standard deviation, mm.
    pub(super) depth: Option<[Cow<'a, [f32]>; 2]>,
    /// Pixels without a measurement: they lack texture, or have no focus, and are filled in.
    pub(super) marked: Vec<bool>,
    /// For a sweep: -1 and 1 where no frame is in focus, by side.
    pub(super) beyond: Cow<'a, [i8]>,
    /// For a sweep: the frame that supplies each pixel of the fused image; empty if the results were read.
    pub(super) frames: &'a [u16],
    /// The fused image; `None` if the results were read.
    pub(super) fused: Option<Fused<'a>>,
}

impl<'a> Results<'a> {
    /// Results of a pair. Its photographs have these sample types.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if a field does not have the size that the solution states.
    pub fn of_pair(solution: &'a Solution, report: Report, depths: [Depth; 2]) -> Result<Self, Error> {
        let fields = [
            ("relative_blur", &solution.relative_blur),
            ("uncertainty", &solution.uncertainty),
            ("confidence", &solution.confidence),
            ("residual", &solution.residual),
        ];
        Self::new(report, &depths, &fields, (solution.fused_channels, &solution.fused))
    }

    /// Results of a focus sweep. Its frames have this sample type.
    ///
    /// # Errors
    /// As for [`of_pair`](Self::of_pair).
    pub fn of_sweep(sweep: &'a Sweep, report: Report, depth: Depth) -> Result<Self, Error> {
        let fields = [("focus", &sweep.focus), ("uncertainty", &sweep.uncertainty)];
        let results = Self::new(report, &[depth], &fields, (sweep.fused_channels, &sweep.fused))?;
        let depth = sweep.depth.as_ref().map(|depth| [(&depth.depth[..]).into(), (&depth.deviation[..]).into()]);
        Ok(Self { depth, beyond: (&sweep.beyond[..]).into(), frames: &sweep.frames, ..results })
    }

    /// Results with these fields and this fused image, of photographs with these sample types.
    fn new(
        mut report: Report,
        depths: &[Depth],
        fields: &[(&'static str, &'a Vec<f32>)],
        fused: (Channels, &'a [f32]),
    ) -> Result<Self, Error> {
        let [width, height]: [u32; 2] = report.size.into();
        if let Some((name, field)) = fields.iter().find(|(_, field)| field.len() != width as usize * height as usize) {
            let problem = format!("{name} has {} values and the results are {width}x{height}", field.len());
            return Err(Error::Mismatch(problem));
        }
        report.values.decode = report.values.decode.resolved(depths.iter().copied());
        let deepest = [Depth::F32, Depth::U16].into_iter().find(|depth| depths.contains(depth));
        let fused = Fused::new((width, height), fused, report.values.decode, deepest.unwrap_or(Depth::U8))?;
        let fields = fields.iter().map(|(name, field)| (*name, field.as_slice().into())).collect();
        let mut results = Self { fields, fused: Some(fused), ..Self::empty(PathBuf::new(), report) };
        results.mark();
        Ok(results)
    }

    /// Results without fields.
    fn empty(folder: PathBuf, report: Report) -> Self {
        let (fields, marked, beyond) = (Vec::new(), Vec::new(), Cow::Borrowed(&[][..]));
        Self { folder, report, fields, depth: None, marked, beyond, frames: &[], fused: None }
    }

    /// Marks the pixels without a measurement.
    fn mark(&mut self) {
        self.marked = match &self.report.texture {
            Some(texture) => texture.marked(&self.uncertainty_without_scale()),
            None => self.values().iter().map(|value| value.is_nan()).collect(),
        };
    }

    /// Width and height, px.
    pub fn size(&self) -> (u32, u32) {
        (self.report.size.width, self.report.size.height)
    }

    /// Scale of the second photograph of a pair relative to the first.
    pub fn magnification(&self) -> f64 {
        self.report.frames.get(1).map_or(1.0, |frame| frame.transform.scale())
    }

    /// V of a pair, or the focus of a sweep.
    pub fn values(&self) -> &[f32] {
        self.fields.first().map_or(&[], |(_, values)| values)
    }

    /// Standard deviation of [`values`](Self::values).
    pub fn uncertainty(&self) -> &[f32] {
        self.fields.get(1).map_or(&[], |(_, values)| values)
    }

    /// V of a pair, or the focus of a sweep, with its standard deviation.
    pub fn quantity(&self) -> Quantity<'_> {
        let (report, nearer) = (&self.report, self.report.nearer());
        match report.focus_unit {
            None => Quantity::relative_blur(self.values(), self.uncertainty(), nearer),
            Some(_) => Quantity::focus(self.values(), self.uncertainty(), self.focus_unit(), &self.positions(), nearer),
        }
    }

    /// Depth in mm, if it is known.
    pub fn depth(&self) -> Option<Quantity<'_>> {
        let [values, deviation] = self.depth.as_ref()?;
        Some(match self.lens() {
            Some(lens) => Quantity::depth(values, deviation, &lens.focus, Nearer::Second),
            None => {
                let planes = self.planes();
                Quantity::depth(values, deviation, &planes, self.report.nearer().end_of(&planes))
            }
        })
    }

    /// Depth in mm if it is known, else V or the focus.
    pub fn best(&self) -> Quantity<'_> {
        self.depth().unwrap_or_else(|| self.quantity())
    }

    /// V or the focus, and then depth in mm if it is known, with NaN where they are not measured.
    pub fn measured(&self) -> Vec<Quantity<'_>> {
        let all = std::iter::once(self.quantity()).chain(self.depth());
        all.map(|quantity| quantity.without(&self.marked)).collect()
    }

    /// [`measured`](Self::measured) with the standard deviations between results of one lens and setup: without that of
    /// V's scale, which they share.
    pub fn comparable(&self) -> Vec<Quantity<'_>> {
        let mut quantities = self.measured();
        if let Some(shares) = self.shares_without_scale() {
            for quantity in &mut quantities {
                quantity.deviation.to_mut().iter_mut().zip(&shares).for_each(|(deviation, share)| *deviation *= share);
            }
        }
        quantities
    }

    /// Standard deviation of [`values`](Self::values) without that of V's scale.
    pub fn uncertainty_without_scale(&self) -> Cow<'_, [f32]> {
        match self.shares_without_scale() {
            Some(shares) => self.uncertainty().iter().zip(shares).map(|(deviation, share)| deviation * share).collect(),
            None => self.uncertainty().into(),
        }
    }

    /// The confidence in V without the standard deviation of V's scale: the weight of a pixel for a fit.
    pub fn confidence_without_scale(&self) -> Vec<f32> {
        self.uncertainty_without_scale().iter().map(|&deviation| confidence(deviation)).collect()
    }

    /// The share of a pixel's standard deviation that remains without that of V's scale. `None` for sweeps.
    fn shares_without_scale(&self) -> Option<Vec<f32>> {
        let scale = self.report.scale_deviation? as f32;
        let share = |(v, deviation): (&f32, &f32)| match *deviation > 0.0 {
            true => without_scale(*deviation, scale * v) / deviation,
            false => 1.0,
        };
        Some(self.values().iter().zip(self.uncertainty()).map(share).collect())
    }

    /// The part of a quantity's standard deviation that comes from the scale of V, with the sign of V. `None` for
    /// sweeps.
    pub fn by_scale(&self, quantity: &Quantity<'_>) -> Option<Vec<f32>> {
        let scale = self.report.scale_deviation? as f32;
        let pixels = self.values().iter().zip(self.uncertainty()).zip(&*quantity.deviation);
        Some(pixels.map(|((v, of_v), deviation)| scale * v * deviation / of_v).collect())
    }

    /// [`best`](Self::best) with NaN where it is not measured.
    pub fn best_measured(&self) -> Quantity<'_> {
        self.best().without(&self.marked)
    }

    /// The lens of a pair, if it is known.
    pub fn lens(&self) -> Option<&Lens> {
        self.report.depth.as_ref()?.lens.as_ref()
    }

    /// The size of a pixel on the surface, mm, if it is stated: the same everywhere.
    pub fn pixel_mm(&self) -> Option<f64> {
        self.report.pixel_size_um.map(|um| um / 1000.0)
    }

    /// The size of a pixel at the middle of the scale of [`best`](Self::best), mm: as stated, or by the lens. `None` if
    /// neither is known, or `best` is not in mm.
    pub fn footprint(&self) -> Option<f64> {
        let depth = self.best();
        let by_lens = || self.lens().map(|lens| lens.footprint(depth.scale().value(0.5)));
        (depth.unit == "mm").then(|| self.pixel_mm().or_else(by_lens)).flatten()
    }

    /// Focus settings of the frames of a sweep.
    pub(crate) fn positions(&self) -> Vec<f64> {
        self.report.frames.iter().filter_map(|frame| frame.position).collect()
    }

    /// Focus distances, or positions along the axis of a stage, of the frames of a sweep, mm, as far as they are
    /// stated.
    fn planes(&self) -> Vec<f64> {
        self.report.frames.iter().filter_map(|frame| frame.focus_mm).collect()
    }

    /// Sets the standard deviation of V without that of its scale, px², above which a pixel is marked as lacking
    /// texture.
    pub fn set_max_uncertainty(&mut self, limit: f32) {
        self.report.texture = Some(TextureReport::beyond(limit, &self.uncertainty_without_scale()));
        self.mark();
    }

    /// Sets the lens of a pair, and from it depth and the nearer image. Returns a warning for each fact that
    /// contradicts the lens.
    pub fn set_lens(&mut self, lens: &Lens) -> Vec<String> {
        let (metric, blur) = self.depth_through(lens);
        let (scale, limit) = (self.magnification(), self.report.settings.max_relative_blur);
        let doubts: Vec<String> = self.field_doubt(lens).into_iter().chain(metric.doubt(scale, limit, &blur)).collect();
        let depth = DepthReport::new(&metric.depth, &metric.deviation, metric.out_of_range);
        self.report.depth = Some(DepthReport { lens: Some(*lens), ..depth });
        self.report.nearer = Some(Nearer::of_lens(lens).number());
        self.report.nearer_by = Some(NearerBy::Lens);
        self.report.warnings.retain(|warning| !warning.starts_with(DOUBT));
        self.report.warnings.extend(doubts.iter().cloned());
        self.depth = Some([metric.depth.into(), metric.deviation.into()]);
        doubts
    }

    /// Returns depth through a lens, and V as it would be at the image centre.
    fn depth_through(&self, lens: &Lens) -> (MetricDepth, Cow<'_, [f32]>) {
        let (scale, limit, width) =
            (self.magnification(), self.report.settings.max_relative_blur, self.report.size.width);
        let [blur, deviation] = self.blur_at_centre(lens);
        (MetricDepth::new(lens, scale, limit, width, &blur, &deviation), blur)
    }

    /// V and its standard deviation, as they would be at the image centre, where the lens holds.
    fn blur_at_centre(&self, lens: &Lens) -> [Cow<'_, [f32]>; 2] {
        let fields = [self.values(), self.uncertainty()];
        match &lens.field {
            Some(field) if self.field_doubt(lens).is_none() => {
                let (Region { x, y, .. }, limit) = (self.report.region, self.report.settings.max_relative_blur);
                field.to_centre(fields, self.report.size.width, [x, y], limit).map(Cow::from)
            }
            _ => fields.map(Cow::from),
        }
    }

    /// Why the field of a lens does not apply, if it does not.
    fn field_doubt(&self, lens: &Lens) -> Option<String> {
        let ([w, h], SizeReport { width, height }) = (lens.field?.size, self.report.photograph);
        if [w, h] != [width, height] {
            let problem = format!("is of {w}x{h} photographs, and these are {width}x{height}");
            return Some(format!(
                "{DOUBT}its field {problem}, so that it is left out: calibrate with photographs of their size"
            ));
        }
        self.report.flattened.then(|| {
            format!("{DOUBT}its field is left out, because --flat has already changed V: solve without --flat")
        })
    }

    /// Sets the focus positions of the frames of a sweep in mm, and computes depth from them. `nearer` states whether
    /// the first or the last frame is focused nearest.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if the positions are not in mm, or do not fit the frames.
    pub fn set_positions(&mut self, positions: &Positions, nearer: Nearer) -> Result<(), Error> {
        let depth = positions.depth_of(&self.positions(), self.values(), self.uncertainty())?;
        let (Some(depth), Some(planes)) = (depth, positions.millimetres()) else {
            return Err(Error::Mismatch("positions in mm give depth".to_string()));
        };
        self.report.depth = Some(DepthReport::of_sweep(&depth, positions));
        (self.report.nearer, self.report.nearer_by) = (Some(nearer.number()), Some(NearerBy::Distances));
        self.report.frames.iter_mut().zip(planes).for_each(|(frame, at)| frame.focus_mm = Some(*at));
        self.depth = Some([depth.depth.into(), depth.deviation.into()]);
        Ok(())
    }

    /// A field by its name, from memory or from its file.
    ///
    /// # Errors
    /// [`Error::File`] if the file is missing, damaged, or of another size. [`Error::Mismatch`] if results of this kind
    /// have no field of this name in floats.
    pub fn field(&self, name: &str) -> Result<Cow<'_, [f32]>, Error> {
        if let Some((_, values)) = self.fields.iter().find(|(field, _)| *field == name) {
            return Ok(Cow::Borrowed(values));
        }
        if let (Some([depth, _]), "depth") = (&self.depth, name) {
            return Ok(Cow::Borrowed(depth));
        }
        let files = self.report.kind.fields().iter();
        let file = files.clone().find(|(field, file, _)| *field == name && file.ends_with(".exr"));
        let Some((_, file, _)) = file else {
            let names: Vec<&str> = files.map(|(name, ..)| *name).collect();
            return Err(Error::Mismatch(format!("there is no field {name}; the fields are {}", names.join(", "))));
        };
        let path = self.folder.join(file);
        let (width, height, values) = image_io::read_field(&path)?;
        self.check_size(&path, (width, height)).map(|()| values.into())
    }

    /// For a pair, the evidence for each pixel of V: the standard deviation of the fused image around it over that of
    /// what neither blur nor registration explains. `None` for a sweep, since its results do not state the latter.
    ///
    /// # Errors
    /// As for [`field`](Self::field) and [`fused`](Self::fused).
    pub fn evidence(&self) -> Result<Option<Vec<f32>>, Error> {
        if self.report.kind != Kind::Pair {
            return Ok(None);
        }
        let (noise, fused) = (self.field("residual")?, self.fused()?);
        let channels = fused.format().channels.count() as usize;
        let intensities = fused.intensities(self.report.values.decode);
        let grey: Vec<f32> =
            intensities.chunks_exact(channels).map(|pixel| pixel.iter().sum::<f32>() / channels as f32).collect();
        Ok(Some(evidence(&grey, &noise, self.report.size.width as usize)))
    }

    /// The fused image as stored in its file.
    ///
    /// # Errors
    /// [`Error::File`] if the file is missing, damaged, or of another size.
    pub fn fused(&self) -> Result<Frame, Error> {
        if let Some(fused) = &self.fused {
            return fused.frame(fused.depth);
        }
        let path = self.folder.join(self.fused_file());
        let image = image_io::read(&path)?;
        self.check_size(&path, (image.width(), image.height())).map(|()| image)
    }

    /// Checks that the fields and the fused image in the folder are the files that the solve wrote.
    ///
    /// # Errors
    /// [`Error::File`] for the first file whose size or SHA-256 is not the one that the report states.
    pub fn check_hashes(&self) -> Result<(), Error> {
        let fields = self.report.kind.fields().iter().map(|(_, file, _)| *file);
        for file in fields.chain([self.fused_file()]) {
            let path = self.folder.join(file);
            let Some(hash) = self.report.hashes.get(file) else {
                return Err(Error::file(&path, format!("has no SHA-256 in {REPORT_FILE}; solve again")));
            };
            if !hash.matches(&path) {
                let problem = format!("has changed since the solve: its SHA-256 is not the one in {REPORT_FILE}");
                return Err(Error::file(&path, format!("{problem}; solve again")));
            }
        }
        Ok(())
    }

    /// The file of the fused image.
    fn fused_file(&self) -> &'static str {
        if self.report.has_file(FUSED_FLOAT_FILE) { FUSED_FLOAT_FILE } else { FUSED_FILE }
    }

    fn check_size(&self, path: &Path, (width, height): (u32, u32)) -> Result<(), Error> {
        let (w, h) = self.size();
        if (width, height) == (w, h) {
            return Ok(());
        }
        Err(Error::file(path, format!("is {width}x{height} and {REPORT_FILE} states {w}x{h}; solve again")))
    }

    /// The fused image in 8 bits.
    ///
    /// # Errors
    /// As for [`fused`](Self::fused); [`Error::Mismatch`] for results that were read from a folder.
    pub(crate) fn fused_in_8_bits(&self) -> Result<&Frame, Error> {
        let absent = || Error::Mismatch("the fused image was not read".to_string());
        self.fused.as_ref().ok_or_else(absent)?.in_8_bits()
    }

    /// Unit of the focus of a sweep.
    pub(crate) fn focus_unit(&self) -> &'static str {
        let unit = self.report.focus_unit.as_deref();
        UNITS.into_iter().find(|known| unit == Some(known)).unwrap_or(UNITS[0])
    }

    /// The files of [`Kind::fields`] and of depth, as listed in the report.
    pub(super) fn field_reports(&self) -> Vec<FieldReport> {
        let fields = self.report.kind.fields().iter();
        let fields = fields.map(|(name, file, description)| FieldReport::new(name, file, description));
        fields
            .chain(self.depth.as_ref().map(|_| FieldReport::new("depth", DEPTH_FILE, self.depth_description())))
            .collect()
    }

    pub(super) fn depth_description(&self) -> &'static Description {
        match self.lens() {
            Some(_) => &super::image_files::METRIC_DEPTH,
            None => &super::image_files::SWEEP_DEPTH,
        }
    }
}

impl Results<'static> {
    /// Reads the folder of a pair or a focus sweep.
    ///
    /// # Errors
    /// [`Error::File`] if the folder has no results, or if a file is missing, damaged, or of another size than the
    /// report states.
    pub fn read(folder: &Path) -> Result<Self, Error> {
        if !folder.is_dir() {
            return Err(Error::file(folder, "is no folder; give the one that parfocal solve or stack wrote"));
        }
        let path = folder.join(REPORT_FILE);
        if folder.join("batch.json").is_file() && !path.exists() {
            return Err(Error::file(
                folder,
                "holds the results of a batch; give the folder of one pair or sweep in it",
            ));
        }
        let report = read_json(&path)?;
        let Some(kind @ (Kind::Pair | Kind::Sweep)) = Kind::of(&report) else {
            return Err(invalid(&path, "it is not of a pair or a sweep"));
        };
        let report: Report = serde_json::from_value(report).map_err(|e| invalid(&path, e))?;
        report.check().map_err(|problem| invalid(&path, problem))?;
        let mut results = Self::empty(folder.to_path_buf(), report);
        for (name, ..) in &kind.fields()[..2] {
            let values = results.field(name)?.into_owned();
            results.fields.push((*name, values.into()));
        }
        if kind == Kind::Sweep {
            let path = folder.join("beyond.png");
            let ([width, height], sides) = read_beyond(&path)?;
            results.check_size(&path, (width, height))?;
            results.beyond = sides.into();
        }
        results.mark();
        results.read_depth().map_err(|e| invalid(&path, e))?;
        Ok(results)
    }

    /// Reads the folder of a pair.
    ///
    /// # Errors
    /// As for [`read`](Self::read); [`Error::File`] if the folder holds a sweep.
    pub fn read_pair(folder: &Path) -> Result<Self, Error> {
        let results = Self::read(folder)?;
        if results.report.kind == Kind::Pair {
            return Ok(results);
        }
        Err(Error::file(folder, "holds a focus sweep; give the folder of a pair, from parfocal solve"))
    }

    /// Derives depth in mm from the lens or the positions that the report states.
    fn read_depth(&mut self) -> Result<(), Error> {
        if let Some(lens) = self.lens() {
            let (metric, _) = self.depth_through(lens);
            self.depth = Some([metric.depth.into(), metric.deviation.into()]);
            return Ok(());
        }
        let planes = self.planes();
        if planes.len() == self.report.frames.len() {
            let is_stage = self.report.depth.as_ref().and_then(|depth| depth.stage) == Some(true);
            let positions = if is_stage { Positions::Stage(planes) } else { Positions::Distances(planes) };
            let depth = positions.depth_of(&self.positions(), self.values(), self.uncertainty())?;
            self.depth = depth.map(|depth| [depth.depth.into(), depth.deviation.into()]);
        }
        Ok(())
    }
}

/// Draws the keys of maps and the curves of profiles. Without one, `depth.png` has no key and a profile has no picture.
#[derive(Clone, Copy, Debug)]
pub struct Plotter {
    /// Draws the key of a scale in the colours of a palette, under a title, for a map of this width and height.
    pub key: fn(&str, &Scale, Palette, (u32, u32)) -> RgbImage,
    /// Draws a profile.
    pub profile: fn(&ProfileReport) -> RgbImage,
}

/// The style of pictures.
#[derive(Clone, Copy, Debug, Default)]
pub struct Drawing {
    /// Colours of `depth.png`.
    pub palette: Palette,
    /// The function object that draws keys and profiles.
    pub plotter: Option<Plotter>,
}

/// An additional file of results.
pub struct Extra<'a> {
    pub(super) name: &'static str,
    pub(super) fill: Fill<'a>,
}

/// Writes the content of a file. An error is a phrase that fits into "cannot be written (...)".
type Fill<'a> = Box<dyn FnOnce(&Results<'_>, &mut dyn Write) -> Result<(), String> + Send + 'a>;

impl<'a> Extra<'a> {
    pub(crate) fn new(
        name: &'static str,
        fill: impl FnOnce(&Results<'_>, &mut dyn Write) -> Result<(), String> + Send + 'a,
    ) -> Self {
        Self { name, fill: Box::new(fill) }
    }

    /// Its name in the folder of results.
    pub fn name(&self) -> &'static str {
        self.name
    }
}

/// A file that [`Results::write`] and the functions that add to results write.
pub(super) struct NewFile<'a> {
    pub(super) name: Cow<'static, str>,
    pub(super) fill: FillFile<'a>,
}

/// Writes the content of a file. Some contents seek.
type FillFile<'a> = Box<dyn FnOnce(&Results<'_>, &mut BufWriter<&mut File>) -> Result<(), String> + Send + 'a>;

impl<'a> NewFile<'a> {
    pub(super) fn new(
        name: impl Into<Cow<'static, str>>,
        fill: impl FnOnce(&Results<'_>, &mut BufWriter<&mut File>) -> Result<(), String> + Send + 'a,
    ) -> Self {
        Self { name: name.into(), fill: Box::new(fill) }
    }
}

impl<'a> From<Extra<'a>> for NewFile<'a> {
    fn from(Extra { name, fill }: Extra<'a>) -> Self {
        Self::new(name, |results, writer| fill(results, writer))
    }
}

/// Reads `beyond.png`. Returns width and height, and the side of each pixel: -1, 0 or 1.
///
/// # Errors
/// [`Error::File`].
fn read_beyond(path: &Path) -> Result<([u32; 2], Vec<i8>), Error> {
    let picture = image_io::read(path)?;
    let Samples::U8(bytes) = picture.samples() else {
        return Err(Error::file(path, "does not have 8 bits per sample; solve the sweep again"));
    };
    let sides = bytes.iter().map(|byte| i8::from(*byte == 2) - i8::from(*byte == 1)).collect();
    Ok(([picture.width(), picture.height()], sides))
}
