//! `parfocal depth`: depth in mm for a folder that has been solved.

use std::path::{Path, PathBuf};

use parfocal::export::{DEPTH_FILE, DepthReport, RangeReport, Solved, SolvedSweep, SweepDepthReport, holds_sweep};
use parfocal::page::figure::PEN;

use crate::cli::commands::view::VIEW;
use crate::cli::options::colors::ColorsArgument;
use crate::cli::options::focus_positions::{self, PlacesArguments};
use crate::cli::options::headings::INPUT;
use crate::cli::options::lens::LensArguments;
use crate::cli::options::results_folder::SolvedArguments;
use crate::cli::options::settings::one_or_two;
use crate::cli::output::derived_outputs::Shown;
use crate::cli::output::destination;
use crate::cli::output::failure::Failure;

/// QueueGuard what was found into depth in mm, once the lens, or what a sweep was focused at, is known.
///
/// Nothing is solved again.
#[derive(clap::Args, Debug)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Arguments {
    #[command(flatten)]
    of: SolvedArguments,
    #[command(flatten)]
    lens: LensArguments,
    #[command(flatten)]
    places: PlacesArguments,
    /// Of a sweep: whether the first (1) or the last (2) frame is focused nearest [default: by --focus-at]
    #[arg(long, value_name = "1|2", help_heading = INPUT, value_parser = one_or_two)]
    nearer: Option<u8>,
    #[command(flatten)]
    colors: ColorsArgument,
}

const AFTER_HELP: &str = "\
Results, in the same folder, all or none:
  depth_mm.exr  channel Y: depth from the lens in mm, NaN where V is or where no depth in the range of the lens has it;
                channel standard_deviation: of Y, mm
  report.json   gains depth: its range in mm, the number of pixels out of range, the lens; near and far by the lens
  depth.png     depth in mm, transparent where there is none
  depth16.png, depth16.tiff
                the same in 16 bits, where the solve has written them
  report.html, surface.ply and the like
                with the new depth, where the solve has written them; with a lens the surface is in mm

Exit status: 0 done, 1 failed, 2 wrong usage.";

/// Reads, inverts, writes.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let results = &arguments.of.results;
    if holds_sweep(results)? {
        return of_sweep(arguments);
    }
    if arguments.places.places().is_some() || arguments.nearer.is_some() {
        let problem = "holds a pair, to whose depth a lens leads; leave out --focus-at and --nearer";
        return Err(Failure::Usage(format!("{}: {problem}", results.display())));
    }
    // Flags that are wrong by themselves are told first.
    arguments.lens.stated()?;
    let solved = Solved::read(results)?;
    let lens = arguments.lens.required(&solved)?;
    let written = [DEPTH_FILE, "depth.png", "report.json"];
    // A report may state the lens: it is read before it is written again.
    let inputs: Vec<&PathBuf> =
        arguments.lens.file().into_iter().filter(|file| !file.ends_with("report.json")).collect();
    destination::check_folder(results)?;
    destination::check_inputs(results, &written, &inputs)?;
    let force = arguments.of.force.is_given();
    solved.check_depth(force)?;
    let mut new = solved.seen_through(&lens);
    let shown = Shown::of_pair(&new)?;
    shown.note(new.report_mut());
    let palette = arguments.colors.palette();
    new.write_depth(palette, Some(PEN), shown.files_of_pair(&new, Some(palette)), force)?;
    let Some(report) = new.metric.as_ref().map(DepthReport::from) else { return Ok(()) };
    let mut lines = vec![format!("depth          {}", summary(&report))];
    let doubt = new.metric.as_ref().and_then(|metric| new.doubt(metric));
    lines.extend(doubt.map(|doubt| format!("warning        {doubt}")));
    lines.extend(shown.warning());
    lines.extend(drawn_before(results));
    lines.push(format!("results        {}", results.display()));
    arguments.of.tell(&lines.join("\n"), &report)
}

/// A word on what `parfocal view` drew before.
fn drawn_before(results: &Path) -> Option<String> {
    let view = results.join(VIEW);
    view.is_file()
        .then(|| format!("note           {} shows what was before; parfocal view draws it anew", view.display()))
}

/// The same for a focus sweep.
fn of_sweep(arguments: &Arguments) -> Result<(), Failure> {
    let (results, force) = (&arguments.of.results, arguments.of.force.is_given());
    let places = arguments.places.places().filter(|_| !arguments.lens.is_given());
    let Some(places) = places else {
        let problem = "holds a focus sweep; give --focus-at, and no lens";
        return Err(Failure::Usage(format!("{}: {problem}", results.display())));
    };
    let nearer = focus_positions::nearer(arguments.nearer, &places)?;
    let solved = SolvedSweep::read(results)?;
    destination::check_folder(results)?;
    solved.check_depth(force)?;
    let mut new = solved.focused_at(&places, nearer).map_err(|e| Failure::Usage(format!("--focus-at: {e}")))?;
    let shown = Shown::of_sweep(&new)?;
    shown.note(new.report_mut());
    let palette = arguments.colors.palette();
    new.write_depth(palette, Some(PEN), shown.files_of_sweep(&new, Some(palette)), force)?;
    let Some(report) = SweepDepthReport::of(&new.sweep) else { return Ok(()) };
    let mut lines = vec![format!("depth          {}", of_range(&report.range, "beyond infinity", report.out_of_range))];
    lines.extend(shown.warning());
    lines.extend(drawn_before(results));
    lines.push(format!("results        {}", results.display()));
    arguments.of.tell(&lines.join("\n"), &report)
}

/// The range of depth, in words.
pub(crate) fn summary(report: &DepthReport) -> String {
    of_range(&report.range, "out of the range of the lens", report.out_of_range)
}

/// A range of depth, and how many pixels lie beyond.
fn of_range(range: &RangeReport, beyond: &str, out: usize) -> String {
    let (Some(min), Some(max), Some(median)) = (range.min, range.max, range.median) else {
        return format!("of no pixel; {beyond}: {out} px");
    };
    let digits = decimals(f64::from(max - min) / 100.0);
    format!("{min:.digits$} to {max:.digits$} mm, median {median:.digits$}; {beyond}: {out} px")
}

/// Decimals with which a number that is known to within `error` is written: two digits of the error.
pub(crate) fn decimals(error: f64) -> usize {
    // 0 and what is not a number have no digits; six decimals are enough for either.
    if error > 0.0 { (1.0 - error.log10().floor()).clamp(0.0, 6.0) as usize } else { 6 }
}
