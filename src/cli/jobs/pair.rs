//! The job of one pair: checks and reads its files, and writes its results.

use std::path::{Path, PathBuf};

use parfocal::export::{
    self, DEPTH_FILE, Depth16, Drawing, Extra, FUSED_FLOAT_FILE, Kind, NearerBy, PAGE_FILE, REPORT_FILE, Report,
    Results, result_files,
};
use parfocal::image_io::{Input, Photograph, Values};
use parfocal::page::figure::PLOTTER;
use parfocal::page::report_html::Page;
use parfocal::{Frame, Lens, Settings, Solution, SolveOptions, frame::Depth, settings::DeviceInfo};

use crate::cli::options::photographs;
use crate::cli::options::solve::Request;
use crate::cli::output::destination;
use crate::cli::output::failure::Failure;

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

/// Refuses an output folder that cannot be written, or where a result would replace an input.
pub(crate) fn check(request: &Request, job: &PairJob) -> Result<(), Failure> {
    if request.part.flat.as_ref().is_some_and(|flat| crate::cli::same_file(flat, &job.out)) {
        let problem = "holds the flat reference; give another folder for the results";
        return Err(Failure::Failed(format!("{}: {problem}", job.out.display())));
    }
    let inputs: Vec<&PathBuf> = job.files.iter().chain(&request.files).collect();
    check_inputs(&job.out, &inputs)?;
    check_results(request, Kind::Pair, &job.out, request.lens.is_some(), false)
}

/// Refuses an output folder where a result could replace an input.
pub(crate) fn check_inputs(out: &Path, inputs: &[&PathBuf]) -> Result<(), Failure> {
    let profiles = export::profiles_in(out);
    let mut possible: Vec<&str> = result_files().collect();
    possible.extend(profiles.iter().map(String::as_str));
    destination::check(out, REPORT_FILE, &possible, inputs)
}

/// Refuses an output folder in which a file of another program has the name of a result.
pub(crate) fn check_results(
    request: &Request,
    kind: Kind,
    out: &Path,
    in_mm: bool,
    in_floats: bool,
) -> Result<(), Failure> {
    let more = [(request.page, PAGE_FILE), (in_mm, DEPTH_FILE), (in_floats, FUSED_FLOAT_FILE)];
    let more = more.into_iter().filter(|(is_written, _)| *is_written).map(|(_, name)| name);
    let profiles = request.wanted.files();
    let names = kind.files().into_iter().chain(request.models.names()).chain(more);
    let mut names: Vec<&str> = names.collect();
    names.extend(profiles.iter().map(String::as_str));
    Ok(request.force.to(out).check_results(REPORT_FILE, &names)?)
}

/// Reads the pair. Returns `None` if `settled` finds complete results of these files. Checks large photographs against
/// the device before decoding them.
pub(crate) fn read(
    request: &Request,
    job: &PairJob,
    settled: impl FnOnce(&[Input]) -> Result<bool, Failure>,
    device: impl FnOnce() -> Result<DeviceInfo, Failure>,
) -> Result<Option<Photographs>, Failure> {
    let (photographs, inputs) = photographs::open_pair(&job.files)?;
    if settled(&inputs)? {
        return Ok(None);
    }
    if request.part.is_whole() {
        photographs::check_size(photographs.each_ref(), &request.settings, true, device)?;
    }
    let lens = request.lens(&inputs)?;
    request.nearer(lens.as_ref())?;
    let values = Values::of(request.settings.decode, &inputs)?;
    let settings = Settings { decode: values.decode, ..request.settings.clone() };
    let frames = Photograph::decode_pair(photographs)?;
    let in_floats = frames.iter().any(|frame| frame.format().depth == Depth::F32);
    check_results(request, Kind::Pair, &job.out, lens.is_some(), in_floats)?;
    let size = [frames[0].width(), frames[0].height()];
    let scope = request.part.fitting(size)?;
    if let Some([width, height]) = request.part.size(size) {
        request.wanted.check((width, height))?;
    }
    Ok(Some(Photographs { frames, inputs, scope, settings, values, lens }))
}

/// Writes the results of a pair. Returns their report.
pub(crate) fn write(
    request: &Request,
    job: &PairJob,
    device: &DeviceInfo,
    photographs: &Photographs,
    solution: &Solution,
) -> Result<Report, Failure> {
    let nearer = request.nearer(photographs.lens.as_ref())?;
    let mut report = Report::pair(solution, &photographs.settings, device, nearer);
    report.values = photographs.values;
    report.set_inputs(photographs.inputs.clone(), crate::cli::is_validation_requested());
    report.flattened = photographs.scope.flat.is_some();
    report.request = request.digest(&[])?;
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
    let names = job.files.iter().map(|file| photographs::file_name(file)).collect();
    write_results(request, &job.out, results, photographs.frames.iter().collect(), names, labels)
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
    if !request.wanted.is_empty() {
        results.report.measurements = Some(request.wanted.measure(&results)?);
    }
    let depth16 = request.models.is_depth16().then(|| Depth16::of(&results));
    results.report.depth16 = depth16.as_ref().map(Depth16::report);
    let fused = request.models.show_the_surface().then(|| results.fused()).transpose()?;
    let points = fused.as_ref().map(|fused| request.models.points(&results, fused)).transpose()?.flatten();
    results.report.surface = request.models.report(points.as_ref());
    let mut extras = request.models.array_files();
    extras.extend(fused.iter().flat_map(|fused| request.models.files(points.as_ref(), fused)));
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
