//! `parfocal solve`: recovers relative blur and registration of two photographs, from their files to their results.

use std::path::{Path, PathBuf};

use parfocal::export::{
    self, DEPTH_FILE, Depth16, Drawing, Extra, FUSED_FLOAT_FILE, Kind, NearerBy, PAGE_FILE, REPORT_FILE, Report,
    Results, result_files,
};
use parfocal::image_io::{Input, Photograph, Values};
use parfocal::page::figure::PLOTTER;
use parfocal::page::report_html::Page;
use parfocal::{Frame, Lens, PairSolver, Settings, Solution, SolveOptions, frame::Depth, settings::DeviceInfo};

use crate::cli::help::{AFTER_HELP, OUTPUT};
use crate::cli::options::photographs::{self, PairArguments};
use crate::cli::options::series;
use crate::cli::options::solve::{Request, SolveArguments};
use crate::cli::output::destination;
use crate::cli::output::failure::Failure;
use crate::cli::output::summary::summary;

/// Recover relative blur and registration of two photographs of one scene, focused at two distances.
#[derive(clap::Args, Clone, Debug)]
#[command(after_long_help = AFTER_HELP)]
pub(crate) struct Arguments {
    #[command(flatten)]
    pair: PairArguments,
    #[command(flatten)]
    options: SolveArguments,
    /// Folder for the results; earlier results in it are replaced
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT, display_order = 0)]
    output: PathBuf,
}

/// Solves a pair and writes the results. Inexpensive checks come first.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let request = arguments.options.request()?;
    let job = PairJob {
        files: arguments.pair.files().map(|file| photographs::with_format(file, arguments.options.raw())),
        out: arguments.output.clone(),
    };
    job.check(&request)?;
    let mut engine = None;
    let read = job.read(&request, |_| Ok(false), || request.run.info(&mut engine))?;
    let Some(photographs) = read else { return Ok(()) };
    let engine = request.run.engine(engine)?;
    let frames = photographs.frames.each_ref();
    let bar = request.bar(&photographs.frames);
    let options = SolveOptions { progress: Some(bar.reporter()), ..photographs.scope.clone() };
    let solution = PairSolver::new(&engine, &photographs.settings)
        .and_then(|mut solver| solver.solve(frames, &options))
        .map_err(|e| Failure::of_solve(e, &job.files[0]))?;
    crate::cli::check_validation(&engine)?;
    let report = job.write(&request, engine.info(), &photographs, &solution)?;
    bar.finish();
    drop((options, bar));
    request.run.report.print(&summary(&report, request.palette, &job.out), &report)?;
    request.run.check_strict(report.converged == Some(true), &report.warnings)
}

/// The files of a pair, and the folder for its results.
#[derive(Clone, Debug)]
pub(crate) struct PairJob {
    pub(crate) files: [PathBuf; 2],
    pub(crate) out: PathBuf,
}

/// A pair as read from its files.
pub(crate) struct Photographs {
    pub(crate) frames: [Frame; 2],
    pub(crate) inputs: Vec<Input>,
    pub(crate) scope: SolveOptions,
    /// The settings, with the decoding resolved.
    pub(crate) settings: Settings,
    values: Values,
    lens: Option<Lens>,
}

impl PairJob {
    /// Refuses an output folder that cannot be written, or where a result would replace an input.
    pub(crate) fn check(&self, request: &Request) -> Result<(), Failure> {
        if request.part.flat.as_ref().is_some_and(|flat| crate::cli::same_file(flat, &self.out)) {
            let problem = "holds the flat reference; give another folder for the results";
            return Err(Failure::Failed(format!("{}: {problem}", self.out.display())));
        }
        check_inputs(request, &self.files, &self.out)?;
        check_results(request, Kind::Pair, &self.out, request.lens.is_some(), false)
    }

    /// Reads the pair. Returns `None` if `settled` finds complete results of these files. Checks large photographs
    /// against the device before decoding them.
    pub(crate) fn read(
        &self,
        request: &Request,
        settled: impl FnOnce(&[Input]) -> Result<bool, Failure>,
        device: impl FnOnce() -> Result<DeviceInfo, Failure>,
    ) -> Result<Option<Photographs>, Failure> {
        let (photographs, inputs) = photographs::open_pair(&self.files)?;
        if settled(&inputs)? {
            return Ok(None);
        }
        if request.part.is_whole() {
            photographs::check_size(photographs.each_ref(), &request.settings, true, device)?;
        }
        let lens = request.lens(&inputs)?;
        request.nearer(lens.as_ref())?;
        let values = Values::of(request.settings.decode, &inputs)?;
        let frames = Photograph::decode_pair(photographs)?;
        let values = values.corrected(&inputs, &frames);
        let settings = Settings { decode: values.decode, ..request.settings.clone() };
        let scope = fitting(request, Kind::Pair, &self.out, lens.is_some(), &frames)?;
        Ok(Some(Photographs { frames, inputs, scope, settings, values, lens }))
    }

    /// Writes the results. Returns their report.
    pub(crate) fn write(
        &self,
        request: &Request,
        device: &DeviceInfo,
        photographs: &Photographs,
        solution: &Solution,
    ) -> Result<Report, Failure> {
        let nearer = request.nearer(photographs.lens.as_ref())?;
        let mut report = Report::pair(solution, &photographs.settings, device, nearer);
        report.values = photographs.values;
        report.set_inputs(photographs.inputs.clone(), crate::cli::is_validation_requested());
        report.flattened = photographs.scope.flat.is_some();
        report.request_sha256 = request.digest(&[])?;
        if request.nearer.is_some() {
            report.nearer_by = Some(NearerBy::Stated);
        }
        let depths = photographs.frames.each_ref().map(|frame| frame.format().depth);
        let mut results = Results::of_pair(solution, report, depths)?;
        if let Some(limit) = request.part.max_uncertainty {
            results.set_max_uncertainty(limit);
        }
        if let Some(lens) = &photographs.lens {
            results.set_lens(lens);
        }
        // V before the subtraction of the flat reference determines which photograph is sharper.
        let sharpness = photographs.scope.flat.as_ref().map(|flat| flat.restored(solution));
        let labels = request.models.is_labels().then(|| export::labels(sharpness.as_ref().unwrap_or(solution)));
        let names = self.files.iter().map(|file| series::file_name(file)).collect();
        write_results(request, &self.out, results, photographs.frames.iter().collect(), names, labels)
    }
}

/// Refuses an output folder where a result could replace a photograph or another input.
pub(crate) fn check_inputs(request: &Request, photographs: &[PathBuf], out: &Path) -> Result<(), Failure> {
    let inputs: Vec<&PathBuf> = photographs.iter().chain(&request.files).collect();
    let profiles = export::profiles_in(out);
    let mut possible: Vec<&str> = result_files().collect();
    possible.extend(profiles.iter().map(String::as_str));
    destination::check(out, REPORT_FILE, &possible, &inputs)
}

/// Refuses exports that the results cannot have, and an output folder in which a file of another program has the name
/// of a result.
pub(crate) fn check_results(
    request: &Request,
    kind: Kind,
    out: &Path,
    in_mm: bool,
    in_floats: bool,
) -> Result<(), Failure> {
    request.models.check_metric(in_mm && (kind == Kind::Pair || request.pixel_size.is_some()))?;
    let more = [(request.page, PAGE_FILE), (in_mm, DEPTH_FILE), (in_floats, FUSED_FLOAT_FILE)];
    let more = more.into_iter().filter(|(is_written, _)| *is_written).map(|(_, name)| name);
    let profiles = request.wanted.files();
    let names = kind.files().into_iter().chain(request.models.names()).chain(more);
    let mut names: Vec<&str> = names.collect();
    names.extend(profiles.iter().map(String::as_str));
    Ok(request.force.to(out).check_results(REPORT_FILE, &names)?)
}

/// Reads the files of the part that is solved. Refuses files, measurements and results that do not match the frames.
pub(crate) fn fitting(
    request: &Request,
    kind: Kind,
    out: &Path,
    in_mm: bool,
    frames: &[Frame],
) -> Result<SolveOptions, Failure> {
    check_results(request, kind, out, in_mm, frames.iter().any(|frame| frame.format().depth == Depth::F32))?;
    let size = [frames[0].width(), frames[0].height()];
    let scope = request.part.fitting(size)?;
    if let Some([width, height]) = request.part.size(size) {
        request.wanted.check((width, height))?;
    }
    Ok(scope)
}

/// Measures, writes the results with the requested files, and returns their report. Photographs and names are in the
/// order of the report's frames.
pub(crate) fn write_results(
    request: &Request,
    out: &Path,
    mut results: Results<'_>,
    photographs: Vec<&Frame>,
    names: Vec<String>,
    labels: Option<Extra<'_>>,
) -> Result<Report, Failure> {
    results.report.pixel_size_um = request.pixel_size;
    if !request.wanted.is_empty() {
        results.report.measurements = Some(request.wanted.measure(&results)?);
    }
    let depth16 = request.models.is_depth16().then(|| Depth16::of(&results));
    results.report.depth16 = depth16.as_ref().map(Depth16::report);
    let surface = request.models.surface(&results)?;
    results.report.surface = request.models.report(surface.as_ref());
    let mut extras = request.models.array_files();
    extras.extend(request.models.surface_files(surface.as_ref()));
    extras.extend(depth16.into_iter().flat_map(Depth16::into_files).chain(labels));
    if request.page {
        extras.push(Page { photographs, names, palette: request.palette, fields: Vec::new() }.file());
    }
    let drawing = Drawing { palette: request.palette, plotter: Some(PLOTTER) };
    results.write(request.force.to(out), &drawing, extras)?;
    Ok(results.report)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use clap::Parser;

    use super::*;
    use crate::cli::options::solve::SolveArguments;

    #[derive(Parser)]
    struct Only {
        #[command(flatten)]
        options: SolveArguments,
    }

    #[test]
    fn hash_and_pixels_come_from_one_file_even_if_it_is_replaced() {
        let folder = tempfile::TempDir::new().unwrap();
        let [file, new] = ["a.pgm", "new.pgm"].map(|name| folder.path().join(name));
        fs::write(&file, b"P5 2 1 255 \x01\x02").unwrap();
        let request = Only::try_parse_from(["only"]).unwrap().options.request().unwrap();
        let job = PairJob { files: [file.clone(), file.clone()], out: folder.path().join("out") };
        let no_device = || panic!("so small a pair fits any");
        let whole = job.read(&request, |_| Ok(false), no_device).unwrap().unwrap();
        let swap = |_: &[Input]| {
            fs::write(&new, b"P5 1 2 255 \x03\x04").unwrap();
            fs::rename(&new, &file).unwrap();
            Ok(false)
        };
        let swapped = job.read(&request, swap, no_device);
        let swapped = swapped.unwrap().unwrap();
        assert_eq!((swapped.frames, swapped.inputs), (whole.frames, whole.inputs));
        assert_eq!(job.read(&request, |_| Ok(false), no_device).unwrap().unwrap().frames[0].height(), 2);
    }
}
