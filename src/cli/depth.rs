//! `parfocal depth`: depth in mm for a folder that has been solved.

use std::path::PathBuf;

use parfocal::export::{DEPTH_FILE, DepthReport, Solved};
use parfocal::figure::PEN;

use super::colors::ColorsArgument;
use super::failure::Failure;
use super::lens::LensArguments;
use super::output;
use super::solved::SolvedArguments;

/// Turn the relative blur of a finished solve into depth in mm, once the lens is known. Nothing is solved again.
#[derive(clap::Args, Debug)]
#[command(after_help = AFTER_HELP)]
pub(super) struct Arguments {
    #[command(flatten)]
    of: SolvedArguments,
    #[command(flatten)]
    lens: LensArguments,
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

Exit status: 0 done, 1 failed, 2 wrong usage.";

/// Reads, inverts, writes.
pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let lens = arguments.lens.required()?;
    let results = &arguments.of.results;
    let solved = Solved::read(results)?;
    let written = [DEPTH_FILE, "depth.png", "report.json"];
    // A report may state the lens: it is read before it is written again.
    let inputs: Vec<&PathBuf> =
        arguments.lens.file().into_iter().filter(|file| !file.ends_with("report.json")).collect();
    output::check_folder(results)?;
    output::check_inputs(results, &written, &inputs)?;
    solved.check_depth(arguments.of.force.is_given())?;
    let metric = solved.through(&lens);
    solved.write_depth(&metric, arguments.colors.palette(), Some(PEN), arguments.of.force.is_given())?;
    let report = DepthReport::from(&metric);
    let (range, files) = (summary(&report), written.join(" "));
    arguments.of.tell(&format!("depth          {range}\nresults        {}: {files}", results.display()), &report)
}

/// The range of depth, in words.
pub(super) fn summary(report: &DepthReport) -> String {
    let range = &report.range;
    let (Some(min), Some(max), Some(median)) = (range.min, range.max, range.median) else {
        return format!("no pixel in the range of the lens, {} out of it", report.out_of_range);
    };
    let digits = decimals(f64::from(max - min) / 100.0);
    let out = report.out_of_range;
    format!("{min:.digits$} to {max:.digits$} mm, median {median:.digits$}; out of the range of the lens: {out} px")
}

/// Decimals with which a number that is known to within `error` is written: two digits of the error.
pub(super) fn decimals(error: f64) -> usize {
    // 0 and what is not a number have no digits; six decimals are enough for either.
    if error > 0.0 { (1.0 - error.log10().floor()).clamp(0.0, 6.0) as usize } else { 6 }
}
