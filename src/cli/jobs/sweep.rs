//! A focus sweep: from its files to its results.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use parfocal::export::{self, Kind, Nearer, NearerBy, Report, Results};
use parfocal::image_io::{self, Input, Photograph, Values};
use parfocal::sweep::{Positions, Sweep, SweepOptions};
use parfocal::{
    Engine, Error, Frame, Progress, Settings, SolveOptions, SweepSolver,
    settings::{DeviceInfo, Method},
    transform::Homography,
};

use crate::cli::jobs::results::{Expected, check_inputs, check_results, fitting, write_results};
use crate::cli::options::photographs::{self, SweepFiles};
use crate::cli::options::run::is_validation_requested;
use crate::cli::options::series;
use crate::cli::options::solve::Request;
use crate::cli::output::failure::Failure;

/// The files of a sweep, and the folder for its results.
#[derive(Clone, Debug)]
pub(crate) struct SweepJob {
    pub(crate) files: SweepFiles,
    pub(crate) positions: Positions,
    /// Index of the reference frame, from 0.
    pub(crate) reference: Option<usize>,
    pub(crate) out: PathBuf,
}

/// A sweep as read from its files.
pub(crate) struct SweepFrames {
    pub(crate) frames: Vec<Frame>,
    pub(crate) inputs: Vec<Input>,
    /// What was changed about the frames: their order, how they are turned.
    warnings: Vec<String>,
    /// The settings, with the decoding resolved.
    options: SweepOptions,
    /// The region of the frames, and their mask.
    part: SolveOptions,
    values: Values,
    /// The time of reading.
    read_ms: f64,
}

impl SweepJob {
    /// The options of the solver.
    fn options(&self, settings: Settings) -> SweepOptions {
        SweepOptions { settings, positions: self.positions.clone(), reference: self.reference }
    }

    fn expected(&self) -> Expected {
        Expected { kind: Kind::Sweep, in_mm: self.positions.millimetres().is_some() }
    }

    /// The digest of everything that changes the results, except the frames.
    pub(crate) fn digest(&self, request: &Request) -> Result<String, Failure> {
        request.digest(format!("{:?} {:?}", self.positions, self.reference).as_bytes())
    }

    /// Refuses options of pairs, options that do not match the sweep, and an output folder that cannot be written or
    /// where a result would replace an input.
    pub(crate) fn check(&self, request: &Request) -> Result<(), Failure> {
        let is_held = request.settings.method == Method::Aligned && request.settings.start == Homography::IDENTITY;
        let is_registered = is_held || request.settings.method == Method::Unified;
        if request.lens.is_some() || request.part.flat.is_some() || !is_registered {
            let problem = "is a focus sweep, and takes no lens, --flat, held --transform or --method but aligned; leave them out, or use parfocal stack";
            return Err(Failure::Usage(format!("{}: {problem}", self.out.display())));
        }
        let fits = self.options(request.settings.clone()).check(self.files.frames.len());
        fits.map_err(|e| Failure::Usage(e.to_string()))?;
        photographs::nearer_end(request.nearer, &self.positions)?;
        request.models.check_labels(self.files.frames.len())?;
        check_inputs(request, &self.files.frames, &self.out)?;
        check_results(request, self.expected(), &self.out, &[])
    }

    /// Reads the frames. Returns `None` if `settled` finds complete results of these files.
    pub(crate) fn read(
        &self,
        request: &Request,
        settled: impl FnOnce(&[Input]) -> Result<bool, Failure>,
        device: impl FnOnce() -> Result<DeviceInfo, Failure>,
    ) -> Result<Option<SweepFrames>, Failure> {
        let started = Instant::now();
        let decoded =
            decode(&self.files.frames, self.positions == Positions::Counted, |first| match request.part.is_whole() {
                true => photographs::check_size([first; 2], &request.settings, photographs::LARGE, device),
                false => Ok(()),
            })?;
        let Decoded { mut frames, inputs, warnings, order } = decoded;
        if settled(&inputs)? {
            return Ok(None);
        }
        check_alike(&inputs, &frames)?;
        let values = Values::of(request.settings.decode, &inputs)?.corrected(&inputs, &mut frames);
        let settings = Settings { decode: values.decode, ..request.settings.clone() };
        let reference = self.reference.and_then(|n| order.iter().position(|other| *other == n));
        let options = SweepOptions { reference, ..self.options(settings) };
        let part = fitting(request, self.expected(), &self.out, &frames)?;
        let read_ms = started.elapsed().as_secs_f64() * 1e3;
        Ok(Some(SweepFrames { frames, inputs, warnings, options, part, values, read_ms }))
    }

    /// Writes the results. Returns their report.
    pub(crate) fn write(
        &self,
        request: &Request,
        device: &DeviceInfo,
        read: &SweepFrames,
        (sweep, total_ms): &(Sweep, f64),
    ) -> Result<Report, Failure> {
        let (mut nearer, mut by) = photographs::nearer_end(request.nearer, &self.positions)?;
        let distance = |n: Option<&usize>| read.inputs[*n?].exif.as_ref()?.subject_distance_mm;
        let by_camera = [sweep.order.first(), sweep.order.last()].map(distance);
        if by.is_none() {
            let (first, shown_by) = match (sweep.first_is_nearest(), by_camera) {
                (Some(first), _) => (first, NearerBy::Scale),
                (None, [Some(first), Some(last)]) if first != last => (first < last, NearerBy::Exif),
                _ => (true, NearerBy::Assumed),
            };
            (nearer, by) = (if first { Nearer::First } else { Nearer::Second }, Some(shown_by));
        }
        let files: Vec<String> = read.inputs.iter().map(|input| input.file.clone()).collect();
        let mut report = Report::sweep(sweep, &read.options.settings, &files, device, nearer, *total_ms);
        report.left_out.clone_from(&self.files.left_out);
        report.warnings.splice(0..0, read.warnings.iter().cloned());
        report.values = read.values;
        report.set_inputs(read.inputs.clone());
        report.validated = is_validation_requested();
        report.nearer_by = by;
        report.request_sha256 = self.digest(request)?;
        let results = Results::of_sweep(sweep, report, read.frames[0].format().depth)?;
        let labels = request.models.is_labels().then(|| export::sweep_labels(request.palette));
        let names = sweep.order.iter().map(|n| series::file_name(Path::new(&files[*n]))).collect();
        let frames: Vec<&Frame> = sweep.order.iter().map(|n| &read.frames[*n]).collect();
        write_results(request, &self.out, results, frames, names, labels)
    }
}

impl SweepFrames {
    /// Solves the sweep. Also returns the time since reading began, ms.
    pub(crate) fn solve(
        &self,
        engine: &Engine,
        progress: Option<Arc<dyn Fn(Progress) + Send + Sync>>,
    ) -> Result<(Sweep, f64), Error> {
        let started = Instant::now();
        let mut solver = SweepSolver::new(engine, &self.options)?;
        let sweep = solver.solve(&self.frames, &SolveOptions { progress, ..self.part.clone() })?;
        Ok((sweep, self.read_ms + started.elapsed().as_secs_f64() * 1e3))
    }
}

/// Frames as read from their files.
pub(crate) struct Decoded {
    pub(crate) frames: Vec<Frame>,
    pub(crate) inputs: Vec<Input>,
    /// What was changed about the frames.
    pub(crate) warnings: Vec<String>,
    /// The index of each frame among the files.
    pub(crate) order: Vec<usize>,
}

/// Decodes the frames, after checking the first, and puts them in the order of their times if it is `open`.
pub(crate) fn decode(
    files: &[PathBuf],
    open: bool,
    fits: impl FnOnce(&Photograph) -> Result<(), Failure>,
) -> Result<Decoded, Failure> {
    let first = Photograph::open(&files[0])?;
    photographs::check_memory(&first, files.len())?;
    fits(&first)?;
    let read = image_io::read_frames(first, &files[1..])?;
    let mut warnings = Vec::new();
    let turned = read.iter().filter(|(_, input)| input.is_turned_otherwise);
    let names: Vec<String> = turned.map(|(_, input)| series::file_name(Path::new(&input.file))).collect();
    if !names.is_empty() {
        warnings.push(format!(
            "{} state another orientation than {}, and all are turned as that one",
            photographs::in_short(&names, ", "),
            series::file_name(&files[0])
        ));
    }
    let paged = read.iter().filter(|(_, input)| input.pages > 1 && input.page.is_none());
    let names: Vec<String> = paged.map(|(_, input)| series::file_name(Path::new(&input.file))).collect();
    if !names.is_empty() {
        warnings.push(format!(
            "{} have several pages, and the first of each is read: name pages, as in '{}#2', or give one file alone",
            photographs::in_short(&names, ", "),
            names[0]
        ));
    }
    let times = read.iter().map(|(_, input)| input.exif.as_ref()?.taken.as_deref()).collect::<Option<Vec<_>>>();
    let by_time = times.filter(|_| open).and_then(|times| series::by_time(&times));
    if let Some(order) = &by_time {
        let ends = series::ends(&[order[0], order[order.len() - 1]].map(|n| files[n].clone()));
        warnings
            .push(format!("the frames are taken in the order of their times, {ends}, and not in that of their names"));
    }
    let order = by_time.unwrap_or_else(|| (0..files.len()).collect());
    let mut read: Vec<Option<(Frame, Input)>> = read.into_iter().map(Some).collect();
    let (frames, inputs) = order.iter().filter_map(|n| read[*n].take()).unzip();
    Ok(Decoded { frames, inputs, warnings, order })
}

/// Refuses frames of different sizes or formats.
pub(crate) fn check_alike(files: &[Input], frames: &[Frame]) -> Result<(), Failure> {
    let describe = |frame: &Frame| format!("{}x{}, {}", frame.width(), frame.height(), frame.format());
    let kind = |frame: &Frame| (frame.width(), frame.height(), frame.format());
    let Some(n) = frames.iter().position(|frame| kind(frame) != kind(&frames[0])) else { return Ok(()) };
    Err(Failure::Failed(format!(
        "{}: frame {} is {}, and {} is {}: frames of a sweep have one size and format; crop, resize or convert it, or take it out",
        files[n].file,
        n + 1,
        describe(&frames[n]),
        files[0].file,
        describe(&frames[0])
    )))
}
