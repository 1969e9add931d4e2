//! `parfocal teach`: one golden part from several good parts.

use std::path::PathBuf;

use parfocal::export::{FileKind, GoldenPart, GoldenReport, TaughtPart, write_golden};
use parfocal::internals::median;
use parfocal::metric::inspect::golden::{LeastTolerance, Suggestion, least_tolerances, suggestion};
use parfocal::metric::inspect::{Heights, Limits, PlacementRange};
use parfocal::metric::response::Response;

use crate::cli::inspection::arguments::{ComparisonArguments, files_of, result_folders};
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

/// Reads, compares, writes and prints.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if arguments.comparison.limits(0.0).sigmas == 0.0 {
        let problem = "--sigmas 0 leaves no tolerance that good parts need; give more";
        return Err(Failure::Usage(problem.to_string()));
    }
    let out = arguments.force.to(&arguments.output);
    let folders = result_folders(&arguments.parts)?;
    let inputs: Vec<PathBuf> = folders.iter().flat_map(|folder| files_of(folder)).collect();
    destination::check_file(out, FileKind::Golden, " for the golden part", &inputs.iter().collect::<Vec<_>>())?;
    let golden = Golden::of_folders(&folders, arguments.comparison.placement(), true)?;
    // There is one quantity or more, and the best one is last.
    let Some(field) = golden.fields.last() else { return Ok(()) };
    let unit = field.unit;
    let least = least_tolerances(&field.heights, &arguments.comparison.limits(0.0))?;
    let mut lines: Vec<String> = golden
        .names
        .iter()
        .zip(&least)
        .map(|(name, least)| match least.tolerance.is_finite() {
            true => {
                format!(
                    "good part      {name}: go against the others from a tolerance of {} {unit} on",
                    short(least.tolerance)
                )
            }
            false => format!("good part      {name}: go against the others at no tolerance{}", place(least)),
        })
        .collect();
    let stated = arguments.comparison.tolerance;
    let (taught, doubts) = combined(arguments, &golden, &least)?;
    let mut smallest = None;
    let how = if stated.is_some() { "stated" } else { "suggested" };
    if let Some((heights, tolerance)) = &taught {
        lines.push(format!("tolerance      {tolerance} {unit}, {how}"));
        lines.push(area(heights, unit));
        smallest = smallest_seen(heights, &arguments.comparison.limits(*tolerance));
        lines.extend(smallest.as_ref().map(|(_, line)| line.clone()));
    }
    if golden.names.len() < 3 {
        lines.push("warning        fewer than three good parts do not show what good parts differ by".to_string());
    }
    lines.extend(doubts.iter().map(|doubt| format!("reason         {doubt}")));
    let parts = golden.names.iter().zip(&least);
    let parts =
        parts.map(|(folder, least)| TaughtPart { folder: folder.clone(), least_tolerance: least.tolerance }).collect();
    let settings = golden.first.settings.clone();
    let quantity = (field.name.as_str(), unit);
    // Without a tolerance nothing is written, and JSON says null.
    let tolerance = taught.as_ref().map_or(f64::NAN, |(_, tolerance)| *tolerance);
    let mut report = GoldenReport::new(parts, quantity, (tolerance, stated.is_none()), settings);
    (report.placement, report.registration) = (golden.placement, golden.registration);
    report.smallest_px = smallest.and_then(|(width, _)| width);
    lines.push(match golden.placement {
        Some(PlacementRange { max_shift_px, max_rotation_deg, .. }) => {
            format!("parts may lie  within {max_shift_px:.1} px and {max_rotation_deg:.1}° of the good parts")
        }
        None => "parts may lie  anywhere; state --max-shift and --max-rotation".into(),
    });
    match taught {
        Some((heights, _)) if doubts.is_empty() => {
            lines.push(format!("golden part    {}", arguments.output.display()));
            write_golden(out, &GoldenPart { report: report.clone(), heights, picture: golden.first.picture })?;
        }
        _ => lines.push(format!("golden part    {} is not written", arguments.output.display())),
    }
    arguments.report.print(&lines.join("\n"), &report)?;
    if doubts.is_empty() { Ok(()) } else { Err(Failure::CannotJudge) }
}

/// Where a good part is not judged at any tolerance, as the end of a sentence.
fn place(least: &LeastTolerance) -> String {
    least.gap.map_or(String::new(), |gap| {
        let [x, y] = gap.centroid_px;
        format!(", in a region of {} px at {x:.0},{y:.0}", gap.area_px)
    })
}

/// A golden part with its tolerance.
type Taught = (Heights, f64);

/// One golden part from all, if there is a tolerance, and why it should not be used, one sentence each.
fn combined(
    arguments: &Arguments,
    golden: &Golden,
    least: &[LeastTolerance],
) -> Result<(Option<Taught>, Vec<String>), Failure> {
    let Some(field) = golden.fields.last() else { return Err(Failure::Failed("no golden part".to_string())) };
    let limits = |tolerance: f64| Limits { max_tilt: f64::INFINITY, ..arguments.comparison.limits(tolerance) };
    let mut doubts = golden.doubts.clone();
    let tolerance = match arguments.comparison.tolerance {
        Some(tolerance) => tolerance,
        None => {
            let Suggestion { tolerance, doubtful } = suggestion(least);
            if let Some(typical) = doubtful {
                doubts.extend(golden.combined(field, &limits(typical))?.disagreeing);
            }
            rounded_up(tolerance)
        }
    };
    for (name, least) in golden.names.iter().zip(least).filter(|(_, least)| least.tolerance.is_infinite()) {
        let problem = "lacks texture or heights that the others have, or is far less certain than they are";
        let place = place(least);
        doubts
            .push(format!("the good part {name} {problem}, at any tolerance{place}; leave it out, or solve it again"));
    }
    if !tolerance.is_finite() {
        return Ok((None, doubts));
    }
    let Combined { heights, disagreeing } = golden.combined(field, &limits(tolerance))?;
    if doubts.is_empty() {
        doubts.extend(disagreeing);
    }
    Ok((Some((heights, tolerance)), doubts))
}

/// Rounds up to two significant digits.
fn rounded_up(value: f64) -> f64 {
    if !(value.is_finite() && value > 0.0) {
        return value;
    }
    // By decimals, since a product with 0.01 is not exact.
    let decimals = decimals(value);
    let scale = 10f64.powi(decimals.abs());
    // Less by what a calculation may add to an exact value.
    let value = value * (1.0 - 1e-9);
    if decimals >= 0 { (value * scale).ceil() / scale } else { (value / scale).ceil() * scale }
}

/// The decimals of two significant digits; negative for zeros before the point.
fn decimals(value: f64) -> i32 {
    1 - value.log10().floor() as i32
}

/// A number with two significant digits, or all before the point.
fn short(value: f64) -> String {
    let digits = if value.is_finite() && value > 0.0 { decimals(value).clamp(0, 12) } else { 0 };
    format!("{value:.*}", digits as usize)
}

/// Widths of defects that are tried, px.
const WIDTHS: [f64; 12] = [4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 24.0, 32.0, 40.0, 64.0];

/// The share of the pixels at which a defect must be seen.
const SEEN: f64 = 0.95;

/// The width of the smallest defect as high as the tolerance that is seen at most pixels, and the line that says so, with
/// what shows of defects. `None` if the detail is not known.
fn smallest_seen(heights: &Heights, limits: &Limits) -> Option<(Option<f64>, String)> {
    let detail = heights.detail.as_ref()?;
    let response = Response::new(&detail.smoothing, &WIDTHS, limits.tolerance, limits.min_area_px);
    let valid: Vec<usize> = (0..heights.values.len()).filter(|i| heights.values[*i].is_finite()).collect();
    let shows = |n: usize, i: &usize| response.over_area(n, detail.sensitivity[*i]);
    let is_seen = |n: usize, i: &usize| {
        let deviation = f64::from(heights.deviation[*i].max(heights.part_deviation[*i]));
        limits.sigmas * deviation <= shows(n, i) * limits.tolerance
    };
    let share = |n: usize| valid.iter().filter(|i| is_seen(n, i)).count() as f64 / valid.len().max(1) as f64;
    let smallest = (0..WIDTHS.len()).find(|n| share(*n) >= SEEN).map(|n| WIDTHS[n]);
    let defect = smallest.map_or("no defect".to_string(), |width| format!("from {width} px on a defect"));
    let shown = [3, 5, 8, 10].map(|n| {
        let shown = median(valid.iter().map(|i| shows(n, i))).unwrap_or_default();
        format!("{:.0} % of one of {} px", 100.0 * shown, WIDTHS[n])
    });
    let (shown, seen) = (shown.join(", "), "as high as the tolerance is seen at 95 % of the pixels");
    Some((smallest, format!("smallest       {defect} {seen}; {shown} shows")))
}

/// The line of the golden part's area and standard deviation.
fn area(heights: &Heights, unit: &str) -> String {
    let mut known: Vec<f32> = heights.deviation.iter().copied().filter(|deviation| deviation.is_finite()).collect();
    known.sort_by(f32::total_cmp);
    let at = |share: f64| {
        known.get((share * known.len().saturating_sub(1) as f64) as usize).map_or(f64::NAN, |v| (*v).into())
    };
    format!(
        "measured       {} of {} px; standard deviation of a good part {} {unit}, at 95 % of pixels below {}",
        known.len(),
        heights.values.len(),
        short(at(0.5)),
        short(at(0.95))
    )
}

#[cfg(test)]
mod tests {
    #[test]
    fn tolerances_are_rounded_up() {
        for (value, expected) in [
            (0.1234, 0.13),
            (0.12, 0.12),
            (1.25 * 0.224, 0.28),
            (0.1 + 0.2, 0.3),
            (1.01, 1.1),
            (12.3, 13.0),
            (1234.0, 1300.0),
            (0.0, 0.0),
        ] {
            assert_eq!(super::rounded_up(value), expected);
        }
        assert_eq!([0.001_234, 0.28, 12.3, 1234.0, 0.0].map(super::short), ["0.0012", "0.28", "12", "1234", "0"]);
    }
}
