//! `parfocal teach`: one golden part from several good parts.

use std::path::PathBuf;

use parfocal::export::{FileKind, GoldenPart, GoldenReport, TaughtPart, write_golden};
use parfocal::metric::inspect::{Heights, Limits};
use parfocal::metric::least_tolerances;

use crate::cli::inspection::arguments::{ComparisonArguments, result_folders};
use crate::cli::inspection::golden::{Combined, Golden};
use crate::cli::options::run::ReportArguments;
use crate::cli::output::destination::{self, ForceArgument};
use crate::cli::output::failure::Failure;

/// Teach a golden part from good parts: one file with what they have in common, for --golden.
#[derive(clap::Args, Debug)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Arguments {
    /// Folders of the results of good parts of equal size, or the folder of a batch of them
    #[arg(required = true, value_name = "GOOD")]
    parts: Vec<PathBuf>,
    #[command(flatten)]
    comparison: ComparisonArguments,
    /// File for the golden part
    #[arg(short, long, value_name = "FILE.exr")]
    output: PathBuf,
    #[command(flatten)]
    report: ReportArguments,
    #[command(flatten)]
    force: ForceArgument,
}

const AFTER_HELP: &str = "\
The good parts are registered onto the first. At each pixel the file has the mean of their heights (channel Y), the
standard deviation of a good part from it (standard_deviation), that of one measurement (part_standard_deviation), the
evidence for it (evidence), and the picture of the first (R, G, B).

Without --tolerance one is suggested: each good part is inspected against the others, and has a least tolerance at which
it is go. The suggestion is a quarter more than the largest. If a good part disagrees with the others, it is named, and
nothing is written: leave it out.

Examples:
  parfocal teach good/* -o golden.exr
  parfocal watch incoming -o results --golden golden.exr

Exit status: 0 done, 4 the good parts disagree or a solve had not converged, 1 failed, 2 wrong usage.";

/// The factor by which the suggested tolerance exceeds what good parts need, since the next good part may need more than
/// all before.
const MARGIN: f64 = 1.25;

/// The factor by which the least tolerance of a good part may exceed the median of all before it is compared in detail.
const OUTLYING: f64 = 2.0;

/// Reads, compares, writes and prints.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let out = arguments.force.to(&arguments.output);
    destination::check_file(out, FileKind::Golden, " for the golden part", &[])?;
    let golden = Golden::of_folders(&result_folders(&arguments.parts), arguments.comparison.in_place)?;
    // There is one quantity or more, and the best one is last.
    let Some(field) = golden.fields.last() else { return Ok(()) };
    let unit = field.unit;
    let least = least_tolerances(&field.heights, &arguments.comparison.limits(0.0))?;
    let mut lines: Vec<String> = golden
        .names
        .iter()
        .zip(&least)
        .map(|(name, least)| match least.is_finite() {
            true => format!("good part      {name}: go against the others from a tolerance of {least:.2} {unit} on"),
            false => format!("good part      {name}: go against the others at no tolerance"),
        })
        .collect();
    let stated = arguments.comparison.tolerance;
    let (heights, tolerance, doubts) = combined(arguments, &golden, &least)?;
    let how = if stated.is_some() { "stated" } else { "suggested" };
    lines.push(format!("tolerance      {tolerance} {unit}, {how}"));
    lines.push(area(&heights, unit));
    if golden.names.len() < 3 {
        lines.push("warning        fewer than three good parts do not show what good parts differ by".to_string());
    }
    lines.extend(doubts.iter().map(|doubt| format!("reason         {doubt}")));
    let parts = golden.names.iter().zip(&least);
    let parts = parts.map(|(folder, least)| TaughtPart { folder: folder.clone(), least_tolerance: *least }).collect();
    let settings = golden.first.settings.clone();
    let quantity = (field.name.as_str(), unit);
    let report = GoldenReport::new(parts, quantity, (tolerance, stated.is_none()), settings);
    if doubts.is_empty() {
        lines.push(format!("golden part    {}", arguments.output.display()));
        write_golden(out, &GoldenPart { report: report.clone(), heights, picture: golden.first.picture })?;
    } else {
        lines.push(format!("golden part    {} is not written", arguments.output.display()));
    }
    arguments.report.print(&lines.join("\n"), || serde_json::to_string_pretty(&report))?;
    if doubts.is_empty() { Ok(()) } else { Err(Failure::CannotJudge) }
}

/// One golden part from all, the tolerance, and why it should not be used, one sentence each.
fn combined(arguments: &Arguments, golden: &Golden, least: &[f64]) -> Result<(Heights, f64, Vec<String>), Failure> {
    let Some(field) = golden.fields.last() else { return Err(Failure::Failed("no golden part".to_string())) };
    let limits = |tolerance: f64| Limits { max_tilt: f64::INFINITY, ..arguments.comparison.limits(tolerance) };
    let mut doubts = golden.doubts.clone();
    let tolerance = match arguments.comparison.tolerance {
        Some(tolerance) => tolerance,
        None => {
            let mut sorted = least.to_vec();
            sorted.sort_by(f64::total_cmp);
            let typical = OUTLYING * sorted[(sorted.len() - 1) / 2];
            if typical.is_finite() && sorted.last().is_some_and(|most| *most > typical) {
                doubts.extend(golden.combined(field, &limits(typical))?.disagreeing);
            }
            rounded_up(MARGIN * sorted.last().copied().filter(|most| most.is_finite()).unwrap_or(typical))
        }
    };
    for (name, _) in golden.names.iter().zip(least).filter(|(_, least)| least.is_infinite()) {
        let problem =
            "lacks texture or heights that the others have, at any tolerance; leave it out, or solve it again";
        doubts.push(format!("the good part {name} {problem}"));
    }
    if !tolerance.is_finite() {
        return Ok((field.heights[0].clone(), 0.0, doubts));
    }
    let Combined { heights, disagreeing } = golden.combined(field, &limits(tolerance))?;
    if doubts.is_empty() {
        doubts.extend(disagreeing);
    }
    Ok((heights, tolerance, doubts))
}

/// Rounds up to two significant digits.
fn rounded_up(value: f64) -> f64 {
    if !(value.is_finite() && value > 0.0) {
        return value;
    }
    // By decimals, since a product with 0.01 is not exact.
    let decimals = 1 - value.log10().floor() as i32;
    let scale = 10f64.powi(decimals.abs());
    if decimals >= 0 { (value * scale).ceil() / scale } else { (value / scale).ceil() * scale }
}

/// The line of the golden part's area and standard deviation.
fn area(heights: &Heights, unit: &str) -> String {
    let mut known: Vec<f32> = heights.deviation.iter().copied().filter(|deviation| deviation.is_finite()).collect();
    known.sort_by(f32::total_cmp);
    let at =
        |share: f64| known.get((share * known.len().saturating_sub(1) as f64) as usize).copied().unwrap_or(f32::NAN);
    format!(
        "measured       {} of {} px; standard deviation of a good part {:.3} {unit}, at 95 % of pixels below {:.3}",
        known.len(),
        heights.values.len(),
        at(0.5),
        at(0.95)
    )
}

#[cfg(test)]
mod tests {
    #[test]
    fn tolerances_are_rounded_up() {
        for (value, expected) in [(0.1234, 0.13), (0.12, 0.12), (1.01, 1.1), (12.3, 13.0), (1234.0, 1300.0), (0.0, 0.0)]
        {
            assert_eq!(super::rounded_up(value), expected);
        }
    }
}
