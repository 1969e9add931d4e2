//! What a request makes of one pair, from its files to its results.

use std::path::PathBuf;

use parfocal::export::{
    self, Additions, Arrays, DEPTH_FILE, Depth16, DepthReport, EXTRA_FILES, Extra, FILES, FUSED_FLOAT_FILE, Look,
    Measurable, Measurements, Nearer, PAGE_FILE, Report, Texture, TextureReport,
};
use parfocal::image_io::{Input, Photograph, Values};
use parfocal::page::figure::PEN;
use parfocal::page::report_html::{Page, residual};
use parfocal::{
    Frame, Lens, Settings, Solution, SolveOptions,
    frame::Depth,
    metric::MetricDepth,
    settings::{Decode, DeviceInfo},
};

use crate::cli::jobs::request::Request;
use crate::cli::options::models::SurfaceOf;
use crate::cli::options::pair;
use crate::cli::output::destination;
use crate::cli::output::failure::Failure;

/// What says what was solved, and lists the files.
const REPORT: &str = FILES[4];

/// A pair, and the folder for its results.
#[derive(Clone, Debug)]
pub(crate) struct Job {
    pub(crate) files: [PathBuf; 2],
    pub(crate) out: PathBuf,
}

/// A pair as its files hold it.
pub(crate) struct Photographs {
    pub(crate) frames: [Frame; 2],
    pub(crate) inputs: Vec<Input>,
    pub(crate) scope: SolveOptions,
    /// With values decoded as the files say, unless that is stated.
    pub(crate) settings: Settings,
    values: Values,
    lens: Option<Lens>,
}

/// Refuses an output folder that cannot be written, or whose results would replace an input.
pub(crate) fn check(request: &Request, job: &Job) -> Result<(), Failure> {
    if request.part.flat.as_ref().is_some_and(|flat| crate::cli::same_file(flat, &job.out)) {
        let problem = "holds the flat reference; give another folder for the results";
        return Err(Failure::Failed(format!("{}: {problem}", job.out.display())));
    }
    let inputs: Vec<&PathBuf> = job.files.iter().chain(&request.files).collect();
    let profiles = export::profiles_in(&job.out);
    let profiles: Vec<&str> = profiles.iter().map(String::as_str).collect();
    let possible = [&FILES[..], &EXTRA_FILES, &[DEPTH_FILE], &profiles].concat();
    destination::check(&job.out, REPORT, &possible, &inputs)?;
    check_places(request, job, false)
}

/// Refuses an output folder in which results would take the places of files that no solve wrote; whether there are results
/// in floats.
fn check_places(request: &Request, job: &Job, in_floats: bool) -> Result<(), Failure> {
    let in_mm = request.lens.map(|_| DEPTH_FILE);
    let more = request.page.then_some(PAGE_FILE).into_iter().chain(in_mm).chain(in_floats.then_some(FUSED_FLOAT_FILE));
    let profiles = request.wanted.files();
    let mut names: Vec<&str> = FILES.into_iter().chain(request.models.names()).chain(more).collect();
    names.extend(profiles.iter().map(String::as_str));
    Ok(request.force.to(&job.out).check_results(REPORT, &names)?)
}

/// Reads the pair, unless what the files are says that it is `settled` already; asks for the device where that may be too small.
pub(crate) fn read(
    request: &Request,
    job: &Job,
    settled: impl FnOnce(&[Input]) -> Result<bool, Failure>,
    device: impl FnOnce() -> Result<DeviceInfo, Failure>,
) -> Result<Option<Photographs>, Failure> {
    let (photographs, inputs) = pair::open(&job.files)?;
    if settled(&inputs)? {
        return Ok(None);
    }
    if request.part.is_whole() {
        pair::check_size(photographs.each_ref(), &request.settings, true, device)?;
    }
    let lens = request.lens(&inputs)?;
    request.nearer(lens.as_ref())?;
    let values = Values::of(request.settings.decode, &inputs)?;
    let settings = Settings { decode: values.decode, ..request.settings.clone() };
    let frames = Photograph::decode_pair(photographs)?;
    check_places(request, job, frames.iter().any(|frame| frame.format().depth == Depth::F32))?;
    let size = [frames[0].width(), frames[0].height()];
    let scope = request.part.fitting(size)?;
    if let Some([width, height]) = request.part.size(size) {
        request.wanted.check((width, height))?;
    }
    Ok(Some(Photographs { frames, inputs, scope, settings, values, lens }))
}

/// Writes the results; tells the report, and which files.
pub(crate) fn write(
    request: &Request,
    job: &Job,
    device: &DeviceInfo,
    photographs: &Photographs,
    solution: &Solution,
) -> Result<(Report, Vec<&'static str>), Failure> {
    let found = Found::of(request, photographs, solution)?;
    let mut report = found.report(request, device)?;
    let look = found.look(request);
    let fused = export::fused_as_stored(solution, &look)?;
    // What was filled in is no measurement, and is not handed on as one.
    let measured = Solution { relative_blur: found.texture.without(&solution.relative_blur), ..solution.clone() };
    let measured_metric = found
        .metric
        .as_ref()
        .map(|metric| MetricDepth { depth: found.texture.without(&metric.depth), ..metric.clone() });
    let depth16 = request.models.depth16(&measured, measured_metric.as_ref());
    report.depth16 = depth16.as_ref().map(Depth16::report);
    // Which photograph is the sharper V tells before a flat reference is taken off.
    let sharpness = photographs.scope.flat.as_ref().map(|flat| flat.restored(solution));
    let points = request.models.points(&SurfaceOf {
        blur: &measured.relative_blur,
        metric: measured_metric.as_ref(),
        part: solution.region(),
        photograph: solution.photograph,
        fused: &fused,
        nearer: found.nearer,
    })?;
    report.surface = request.models.report(points.as_ref());
    let size = (solution.width, solution.height);
    let of_blur = || Arrays::of_relative_blur(size, &measured.relative_blur, &solution.uncertainty);
    let arrays = request.models.hold_arrays().then(|| measured_metric.as_ref().map_or_else(of_blur, Arrays::of_depth));
    let mut extras = request.models.files(points.as_ref(), &fused);
    extras.extend(request.models.array_files(arrays.as_ref()));
    extras.extend(depth16.iter().flat_map(Depth16::files));
    extras.extend(request.models.labels(sharpness.as_ref().unwrap_or(solution)));
    extras.extend(export::fused_float(solution, &look));
    let mut written: Vec<&str> = FILES.into_iter().chain(extras.iter().map(Extra::name)).collect();
    written.extend(found.metric.as_ref().map(|_| DEPTH_FILE));
    written.extend(request.page.then_some(PAGE_FILE));
    report.files = written.iter().map(ToString::to_string).chain(request.wanted.files()).collect();
    if request.page {
        extras.push(found.page(job, &look).file(solution, &report));
    }
    let additions = Additions { depth: found.metric.as_ref(), measurements: found.measurements.clone(), extras };
    let report = export::write(request.force.to(&job.out), solution, &report, &look, additions)?;
    Ok((report, written))
}

/// What a solution says of a pair.
struct Found<'a> {
    photographs: &'a Photographs,
    solution: &'a Solution,
    nearer: Nearer,
    texture: Texture,
    metric: Option<MetricDepth>,
    measurements: Measurements,
}

impl<'a> Found<'a> {
    fn of(request: &Request, photographs: &'a Photographs, solution: &'a Solution) -> Result<Self, Failure> {
        let (width, blur, uncertainty) = (solution.width, &solution.relative_blur, &solution.uncertainty);
        let limit = photographs.settings.max_relative_blur;
        let through = |lens| MetricDepth::new(lens, solution.transform.scale(), limit, width, blur, uncertainty);
        let metric = photographs.lens.as_ref().map(through);
        Ok(Self {
            photographs,
            solution,
            nearer: request.nearer(photographs.lens.as_ref())?,
            texture: Texture::of(solution, request.part.max_uncertainty),
            measurements: request.wanted.measure(&Measurable::of_relative_blur(
                width,
                blur,
                uncertainty,
                metric.as_ref(),
            ))?,
            metric,
        })
    }

    /// The report, but for what depends on which files are written.
    fn report(&self, request: &Request, device: &DeviceInfo) -> Result<Report, Failure> {
        let mut report = Report::new(self.solution, &self.photographs.settings, device, self.nearer);
        report.values = self.photographs.values;
        report.of(self.photographs.inputs.clone(), crate::cli::validation_asked());
        report.texture = TextureReport::of(&self.texture);
        report.flattened = self.photographs.scope.flat.is_some();
        report.request = request.digest(&[])?;
        report.nearer_by = match (&self.metric, request.nearer) {
            (Some(_), _) => "lens",
            (None, Some(_)) => "stated",
            (None, None) => "assumed",
        };
        report.depth = self.metric.as_ref().map(DepthReport::from);
        let (scale, limit) = (self.solution.transform.scale(), self.photographs.settings.max_relative_blur);
        let doubt = |metric: &MetricDepth| metric.doubt(scale, limit, &self.solution.relative_blur);
        report.warnings.extend(self.metric.as_ref().and_then(doubt));
        report.measurements = (!request.wanted.is_empty()).then(|| self.measurements.clone());
        Ok(report)
    }

    fn look(&self, request: &Request) -> Look {
        let formats = self.photographs.frames.each_ref().map(Frame::format);
        let decode: Decode = self.photographs.settings.decode;
        Look { nearer: self.nearer, decode, formats, palette: request.palette, pen: Some(PEN) }
    }

    fn page(&'a self, job: &Job, look: &Look) -> Page<'a> {
        Page {
            photographs: self.photographs.frames.each_ref(),
            names: job.files.each_ref().map(|file| pair::name(file)),
            decode: look.decode,
            nearer: look.nearer,
            depth: self.metric.as_ref(),
            palette: look.palette,
            fields: vec![residual(&self.solution.residual)],
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use clap::Parser;

    use super::*;
    use crate::cli::options::solve_options::SolveOptions;

    #[derive(Parser)]
    struct Only {
        #[command(flatten)]
        options: SolveOptions,
    }

    #[test]
    fn hash_and_pixels_are_of_one_file_even_if_another_takes_its_name() {
        let folder = tempfile::TempDir::new().unwrap();
        let [file, new] = ["a.pgm", "new.pgm"].map(|name| folder.path().join(name));
        fs::write(&file, b"P5 2 1 255 \x01\x02").unwrap();
        let request = Only::try_parse_from(["only"]).unwrap().options.request().unwrap();
        let job = Job { files: [file.clone(), file.clone()], out: folder.path().join("out") };
        let no_device = || panic!("so small a pair fits any");
        let whole = read(&request, &job, |_| Ok(false), no_device).unwrap().unwrap();
        let swap = |_: &[Input]| {
            fs::write(&new, b"P5 1 2 255 \x03\x04").unwrap();
            fs::rename(&new, &file).unwrap();
            Ok(false)
        };
        let swapped = read(&request, &job, swap, no_device);
        let swapped = swapped.unwrap().unwrap();
        assert_eq!((swapped.frames, swapped.inputs), (whole.frames, whole.inputs));
        assert_eq!(read(&request, &job, |_| Ok(false), no_device).unwrap().unwrap().frames[0].height(), 2);
    }
}
