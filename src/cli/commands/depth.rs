//! `parfocal depth`: depth in mm for results.

use std::path::PathBuf;

use parfocal::export::{DEPTH_FILE, DEPTH_PICTURE_FILE, DepthReport, Kind, REPORT_FILE, Results};
use serde::Serialize;

use crate::cli::commands::view::VIEW;
use crate::cli::help::INPUT;
use crate::cli::options::exports::DerivedOutputs;
use crate::cli::options::lens::LensArguments;
use crate::cli::options::part::PixelSizeArgument;
use crate::cli::options::photographs::{self, FocusPositionArguments};
use crate::cli::options::run::ColorsArgument;
use crate::cli::options::run::ResultsArguments;
use crate::cli::options::settings::one_or_two;
use crate::cli::output::destination;
use crate::cli::output::failure::Failure;
use crate::cli::output::numbers::depth_range;

/// Convert results to depth in mm, once the lens, or the focus positions of a sweep, are known; set the pixel size.
///
/// Nothing is solved again.
#[derive(clap::Args, Debug)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Arguments {
    #[command(flatten)]
    of: ResultsArguments,
    #[command(flatten)]
    lens: LensArguments,
    #[command(flatten)]
    focus_at: FocusPositionArguments,
    /// For a sweep: whether the first (1) or the last (2) frame is focused nearest [default: by --focus-at]
    #[arg(long, value_name = "1|2", help_heading = INPUT, value_parser = one_or_two)]
    nearer: Option<u8>,
    #[command(flatten)]
    pixel: PixelSizeArgument,
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
                with the new depth, where the solve has written them; with a lens, or --pixel-size, the surface is in mm

With --pixel-size alone, depth stays as it is. Profiles that exist get their distances in mm when measure runs again.

Exit status: 0 done, 1 failed, 2 wrong usage.";

/// Reads results, computes depth, writes and prints it.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let results = &arguments.of.results;
    let usage = |problem: &str| Failure::Usage(format!("{}: {problem}", results.display()));
    // Invalid options are reported first.
    arguments.lens.stated()?;
    let mut solved = Results::read(results)?;
    let pixel = arguments.pixel.pixel_size;
    solved.report.pixel_size_um = pixel.or(solved.report.pixel_size_um);
    let is_stated = arguments.lens.is_given() || arguments.focus_at.is_given() || arguments.nearer.is_some();
    let doubts = if pixel.is_some() && !is_stated {
        // Depth stays as it is.
        Vec::new()
    } else if solved.report.kind == Kind::Sweep {
        let frames = solved.report.frames.len();
        let positions = arguments.focus_at.positions(frames).filter(|_| !arguments.lens.is_given());
        let positions = positions.ok_or_else(|| usage("holds a focus sweep; give --focus-at, and no lens"))?;
        let (nearer, by) =
            photographs::nearer_end(arguments.focus_at.nearer(arguments.nearer, &positions), &positions)?;
        solved.set_positions(&positions, nearer).map_err(|e| Failure::Usage(format!("--focus-at: {e}")))?;
        solved.report.nearer_by = by;
        Vec::new()
    } else {
        if arguments.focus_at.is_given() || arguments.nearer.is_some() {
            return Err(usage("holds a pair, which needs a lens for depth; leave out --focus-at and --nearer"));
        }
        solved.set_lens(&arguments.lens.required(&solved)?)
    };
    let out = arguments.of.force.to(results);
    // A report may state the lens. It is read before it is replaced.
    let inputs: Vec<&PathBuf> = arguments.lens.file().into_iter().filter(|file| !file.ends_with(REPORT_FILE)).collect();
    destination::check_folder(results)?;
    destination::check_inputs(results, &[DEPTH_FILE, DEPTH_PICTURE_FILE, REPORT_FILE], &inputs)?;
    solved.check_depth(out)?;
    let derived = DerivedOutputs::new(&solved)?;
    solved.report.surface = derived.surface().or(solved.report.surface.take());
    let palette = Some(arguments.colors.palette());
    solved.write_depth(out, &derived.drawing(palette), derived.files(palette))?;
    let mut lines: Vec<String> =
        solved.report.depth.iter().map(|depth| format!("depth          {}", depth_range(depth))).collect();
    lines.extend(pixel.map(|um| format!("pixel          {um} µm on the surface")));
    lines.extend(doubts.iter().map(|doubt| format!("warning        {doubt}")));
    lines.extend(derived.warning());
    let view = results.join(VIEW);
    lines.extend(
        view.is_file().then(|| {
            format!("note           {} shows the earlier results; parfocal view draws it again", view.display())
        }),
    );
    lines.push(format!("results        {}", results.display()));
    arguments.of.report(
        &lines.join("\n"),
        &Stated { depth: solved.report.depth.as_ref(), pixel_size_um: solved.report.pixel_size_um },
    )
}

/// What is printed with `--json`: depth as in the report, and the size of a pixel if it is stated.
#[derive(Serialize)]
struct Stated<'a> {
    #[serde(flatten)]
    depth: Option<&'a DepthReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pixel_size_um: Option<f64>,
}
