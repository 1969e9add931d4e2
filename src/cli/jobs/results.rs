//! What pairs and sweeps share: checks of the request against files and frames, and the writing of results.

use std::path::{Path, PathBuf};

use parfocal::export::{
    self, DEPTH_FILE, Depth16, Drawing, Extra, FUSED_FLOAT_FILE, Kind, PAGE_FILE, REPORT_FILE, Report, Results,
    result_files,
};
use parfocal::page::figure::PLOTTER;
use parfocal::page::report_html::Page;
use parfocal::{Frame, SolveOptions, frame::Depth};

use crate::cli::options::solve::Request;
use crate::cli::output::destination;
use crate::cli::output::failure::Failure;

/// Refuses an output folder where a result could replace a photograph or another input.
pub(crate) fn check_inputs(request: &Request, photographs: &[PathBuf], out: &Path) -> Result<(), Failure> {
    let inputs: Vec<&PathBuf> = photographs.iter().chain(&request.files).collect();
    let profiles = export::profiles_in(out);
    let mut possible: Vec<&str> = result_files().collect();
    possible.extend(profiles.iter().map(String::as_str));
    destination::check(out, REPORT_FILE, &possible, &inputs)
}

/// What is known of results before the solve.
#[derive(Clone, Copy)]
pub(crate) struct Expected {
    pub(crate) kind: Kind,
    /// Whether depth will be in mm.
    pub(crate) in_mm: bool,
}

/// Refuses exports that the results cannot have, and an output folder in which a file of another program has the name
/// of a result. `frames` are empty before they are read.
pub(crate) fn check_results(
    request: &Request,
    expected: Expected,
    out: &Path,
    frames: &[Frame],
) -> Result<(), Failure> {
    let Expected { kind, in_mm } = expected;
    let in_floats = frames.iter().any(|frame| frame.format().depth == Depth::F32);
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
    expected: Expected,
    out: &Path,
    frames: &[Frame],
) -> Result<SolveOptions, Failure> {
    check_results(request, expected, out, frames)?;
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
