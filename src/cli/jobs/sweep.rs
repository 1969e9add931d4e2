//! The job of one focus sweep: checks and reads its files, and writes its results.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use parfocal::export::{self, Kind, NearerBy, Report, Results};
use parfocal::image_io::{self, Input, Photograph, Values};
use parfocal::sweep::{Positions, Sweep, SweepOptions};
use parfocal::{
    Engine, Error, Frame, Progress, Settings, SolveOptions, SweepSolver,
    frame::{Channels, Depth, Format},
    settings::{DeviceInfo, Method},
};

use crate::cli::jobs::pair::{check_inputs, check_results, write_results};
use crate::cli::options::output::RunArguments;
use crate::cli::options::photographs;
use crate::cli::options::solve::Request;
use crate::cli::output::failure::Failure;

/// The files of a sweep, and the folder for its results.
#[derive(Clone, Debug)]
pub(crate) struct SweepJob {
    pub(crate) files: Vec<PathBuf>,
    pub(crate) positions: Positions,
    /// Index of the reference frame, from 0.
    pub(crate) reference: Option<usize>,
    pub(crate) out: PathBuf,
}

/// A sweep as read from its files.
pub(crate) struct SweepFrames {
    frames: Vec<Frame>,
    pub(crate) inputs: Vec<Input>,
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

    /// The digest of everything that changes the results, except the frames.
    pub(crate) fn digest(&self, request: &Request) -> Result<String, Failure> {
        request.digest(format!("{:?} {:?}", self.positions, self.reference).as_bytes())
    }
}

/// Refuses options of pairs, options that do not match the sweep, and an output folder that cannot be written or where
/// a result would replace an input.
pub(crate) fn check(request: &Request, job: &SweepJob) -> Result<(), Failure> {
    if request.lens.is_some() || request.part.flat.is_some() || request.settings.method != Method::Unified {
        let problem = "is a focus sweep, and takes no lens, --flat or --method; leave them out, or use parfocal stack";
        return Err(Failure::Usage(format!("{}: {problem}", job.out.display())));
    }
    let fits = job.options(request.settings.clone()).check(job.files.len());
    fits.map_err(|e| Failure::Usage(e.to_string()))?;
    photographs::nearer_end(request.nearer, &job.positions)?;
    request.models.check_labels(job.files.len())?;
    let inputs: Vec<&PathBuf> = job.files.iter().chain(&request.files).collect();
    check_inputs(&job.out, &inputs)?;
    check_results(request, Kind::Sweep, &job.out, job.positions.millimetres().is_some(), false)
}

/// Reads the frames. Returns `None` if `settled` finds complete results of these files.
pub(crate) fn read(
    request: &Request,
    job: &SweepJob,
    settled: impl FnOnce(&[Input]) -> Result<bool, Failure>,
    device: impl FnOnce() -> Result<DeviceInfo, Failure>,
) -> Result<Option<SweepFrames>, Failure> {
    let started = Instant::now();
    let (frames, inputs) = decode(&job.files, |first| match request.part.is_whole() {
        true => photographs::check_size([first; 2], &request.settings, false, device),
        false => Ok(()),
    })?;
    if settled(&inputs)? {
        return Ok(None);
    }
    check_alike(&job.files, &frames)?;
    let values = Values::of(request.settings.decode, &inputs)?;
    let settings = Settings { decode: values.decode, ..request.settings.clone() };
    let (in_mm, in_floats) = (job.positions.millimetres().is_some(), frames[0].format().depth == Depth::F32);
    check_results(request, Kind::Sweep, &job.out, in_mm, in_floats)?;
    let size = [frames[0].width(), frames[0].height()];
    let part = request.part.fitting(size)?;
    if let Some([width, height]) = request.part.size(size) {
        request.wanted.check((width, height))?;
    }
    let options = job.options(settings);
    let read_ms = started.elapsed().as_secs_f64() * 1e3;
    Ok(Some(SweepFrames { frames, inputs, options, part, values, read_ms }))
}

/// Decodes the frames, after checking the first.
fn decode(
    files: &[PathBuf],
    fits: impl FnOnce(&Photograph) -> Result<(), Failure>,
) -> Result<(Vec<Frame>, Vec<Input>), Failure> {
    let first = Photograph::open(&files[0])?;
    fits(&first)?;
    Ok(image_io::read_frames(first, &files[1..])?.into_iter().unzip())
}

/// Refuses frames of different sizes or formats.
fn check_alike(files: &[PathBuf], frames: &[Frame]) -> Result<(), Failure> {
    let describe = |frame: &Frame| {
        let Format { channels, depth } = frame.format();
        let channels = if channels == Channels::Gray { "grey" } else { "colour" };
        let depth = match depth {
            Depth::U8 => "8 bits",
            Depth::U16 => "16 bits",
            Depth::F32 => "floats",
        };
        format!("{}x{}, {channels}, {depth}", frame.width(), frame.height())
    };
    let kind = |frame: &Frame| (frame.width(), frame.height(), frame.format());
    let Some(n) = frames.iter().position(|frame| kind(frame) != kind(&frames[0])) else { return Ok(()) };
    Err(Failure::Failed(format!(
        "{}: frame {} is {}, and {} is {}: frames of a sweep have one size and format; crop, resize or convert it, or take it out",
        files[n].display(),
        n + 1,
        describe(&frames[n]),
        files[0].display(),
        describe(&frames[0])
    )))
}

/// Solves a sweep. Also returns the time since reading began, ms.
pub(crate) fn solve(
    engine: &Engine,
    read: &SweepFrames,
    progress: Option<Arc<dyn Fn(Progress) + Send + Sync>>,
) -> Result<(Sweep, f64), Error> {
    let started = Instant::now();
    let mut solver = SweepSolver::new(engine, &read.options)?;
    let sweep = solver.solve(&read.frames, &SolveOptions { progress, ..read.part.clone() })?;
    Ok((sweep, read.read_ms + started.elapsed().as_secs_f64() * 1e3))
}

/// Writes the results of a sweep. Returns their report.
pub(crate) fn write(
    request: &Request,
    job: &SweepJob,
    device: &DeviceInfo,
    read: &SweepFrames,
    (sweep, total_ms): &(Sweep, f64),
) -> Result<Report, Failure> {
    let nearer = photographs::nearer_end(request.nearer, &job.positions)?;
    let mut report = Report::sweep(sweep, &read.options.settings, &names(&job.files), device, nearer, *total_ms);
    report.values = read.values;
    report.set_inputs(read.inputs.clone(), crate::cli::is_validation_requested());
    report.nearer_by = Some(match (job.positions.millimetres(), request.nearer) {
        (_, Some(_)) => NearerBy::Stated,
        (Some(_), None) => NearerBy::Distances,
        (None, None) => NearerBy::Assumed,
    });
    report.request = job.digest(request)?;
    let results = Results::of_sweep(sweep, report, read.frames[0].format().depth)?;
    let labels = request.models.is_labels().then(|| export::sweep_labels(request.palette));
    let names = sweep.order.iter().map(|n| photographs::file_name(&job.files[*n])).collect();
    let frames: Vec<&Frame> = sweep.order.iter().map(|n| &read.frames[*n]).collect();
    write_results(request, &job.out, results, frames, names, labels)
}

/// Registers the frames of a sweep.
pub(crate) fn register(
    run: &RunArguments,
    settings: &Settings,
    files: &[PathBuf],
    reference: Option<usize>,
) -> Result<Report, Failure> {
    let (started, engine) = (Instant::now(), run.open_engine()?);
    let fits = |first: &Photograph| photographs::check_size([first; 2], settings, false, || Ok(engine.info().clone()));
    let (frames, inputs) = decode(files, fits)?;
    check_alike(files, &frames)?;
    let values = Values::of(settings.decode, &inputs)?;
    let settings = Settings { decode: values.decode, ..settings.clone() };
    let bar = run.bar();
    let options = SweepOptions { settings, reference, ..SweepOptions::default() };
    let solve_options = SolveOptions { progress: Some(bar.reporter()), ..SolveOptions::default() };
    let found = SweepSolver::new(&engine, &options).and_then(|mut solver| solver.register(&frames, &solve_options));
    drop((solve_options, bar));
    let found = found.map_err(|e| Failure::of_solve(e, &files[0]))?;
    crate::cli::check_validation(&engine)?;
    let total_ms = started.elapsed().as_secs_f64() * 1e3;
    let mut report = Report::sweep_registration(&found, &options.settings, &names(files), engine.info(), total_ms);
    report.values = values;
    report.set_inputs(inputs, crate::cli::is_validation_requested());
    Ok(report)
}

/// The paths as given.
fn names(files: &[PathBuf]) -> Vec<String> {
    files.iter().map(|file| file.display().to_string()).collect()
}
