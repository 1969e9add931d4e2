//! `parfocal stack`: recovers a map of the focus and a sharp image from a focus sweep.

use std::path::{Path, PathBuf};

use parfocal::export::{NearerBy, NeverReport, Palette, RangeReport, Report};
use parfocal::image_io::Input;
use parfocal::settings::Method;
use parfocal::sweep::Positions;

use crate::cli::commands::depth::decimals;
use crate::cli::commands::measure::{MeasureArguments, rows};
use crate::cli::help::AFTER_HELP;
use crate::cli::help::{INPUT, OUTPUT};
use crate::cli::jobs::sweep::{self, SweepJob};
use crate::cli::options::exports::ExportArguments;
use crate::cli::options::output::ColorsArgument;
use crate::cli::options::output::RunArguments;
use crate::cli::options::part::PartArguments;
use crate::cli::options::photographs;
use crate::cli::options::photographs::FocusPositionArguments;
use crate::cli::options::settings::{SettingsArguments, one_or_two};
use crate::cli::options::solve::Request;
use crate::cli::output::destination::ForceArgument;
use crate::cli::output::failure::Failure;
use crate::cli::output::summary::values_in_words;

/// Recover the focus of each pixel and an image that is sharp everywhere from a focus sweep
#[derive(clap::Args, Debug)]
#[command(after_long_help = AFTER_HELP)]
pub(crate) struct Arguments {
    /// Three or more frames of one size and format in the order of their focus, or their folder
    #[arg(required = true, num_args = 1.., value_name = "FRAME")]
    frames: Vec<PathBuf>,
    /// Focus setting of each frame [default: 0, 1, 2, ...]
    ///
    /// Ascending or descending, and linear in 1/distance, as the travel of a lens is. Without them, steps are even
    /// unless the sweep shows that frames are missing or steps are uneven; a warning then states the positions.
    #[arg(
        long,
        value_name = "P,P,...",
        help_heading = INPUT,
        value_delimiter = ',',
        allow_hyphen_values = true,
        conflicts_with = "focus_at"
    )]
    positions: Option<Vec<f64>>,
    #[command(flatten)]
    focus_at: FocusPositionArguments,
    /// Frame whose pixels the results follow, from 1 [default: the middle frame]
    #[arg(long, value_name = "N", help_heading = INPUT, value_parser = clap::value_parser!(u32).range(1..))]
    reference: Option<u32>,
    /// The frame that is focused nearest: 1 the first, 2 the last [default: 1, or by --focus-at]
    ///
    /// Determines which end is near in the pictures and on the page.
    #[arg(long, value_name = "1|2", help_heading = INPUT, value_parser = one_or_two)]
    nearer: Option<u8>,
    #[command(flatten)]
    settings: SettingsArguments,
    #[command(flatten)]
    part: PartArguments,
    #[command(flatten)]
    measure: MeasureArguments,
    #[command(flatten)]
    colors: ColorsArgument,
    /// Do not write report.html
    #[arg(long, help_heading = OUTPUT)]
    no_html: bool,
    #[command(flatten)]
    models: ExportArguments,
    /// Folder for the results; earlier results in it are replaced
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT, display_order = 0)]
    output: PathBuf,
    #[command(flatten)]
    force: ForceArgument,
    #[command(flatten)]
    run: RunArguments,
}

/// Solves a sweep and writes the results. Inexpensive checks come first.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let by_mm = arguments.focus_at.positions();
    let stated = arguments.positions.is_some() || by_mm.is_some();
    let positions = by_mm.or(arguments.positions.clone().map(Positions::Settings)).unwrap_or_default();
    let job = SweepJob {
        files: photographs::sweep_frames(&arguments.frames, stated, arguments.settings.raw())?,
        positions,
        reference: arguments.reference.map(|n| n as usize - 1),
        out: arguments.output.clone(),
    };
    let request = request(arguments)?;
    sweep::check(&request, &job)?;
    let mut engine = None;
    let read = sweep::read(&request, &job, |_| Ok(false), || request.run.info(&mut engine))?;
    let Some(read) = read else { return Ok(()) };
    let engine = request.run.engine(engine)?;
    let bar = request.run.bar();
    let solved = sweep::solve(&engine, &read, Some(bar.reporter())).map_err(|e| Failure::of_solve(e, &job.files[0]))?;
    drop(bar);
    crate::cli::check_validation(&engine)?;
    let report = sweep::write(&request, &job, engine.info(), &read, &solved)?;
    let palette = arguments.colors.palette();
    request.run.report.print(&summary(&report, &read.inputs, palette, &job.out), || report.to_json())?;
    request.run.check_strict(true, &report.warnings)
}

/// The request, or an error if options contradict each other.
fn request(arguments: &Arguments) -> Result<Request, Failure> {
    let part = arguments.part.part();
    let request = Request {
        files: arguments.settings.inputs().chain(part.mask()).cloned().collect(),
        settings: arguments.settings.settings(Method::Unified, false)?,
        raw: arguments.settings.raw().map(|raw| raw.to_string()),
        nearer: arguments.nearer,
        part,
        lens: None,
        wanted: arguments.measure.request(),
        palette: arguments.colors.palette(),
        page: !arguments.no_html,
        models: arguments.models.models(),
        force: arguments.force,
        run: arguments.run.clone(),
    };
    request.check()?;
    Ok(request)
}

/// The summary of a sweep, without a newline at the end.
fn summary(report: &Report, inputs: &[Input], palette: Palette, out: &Path) -> String {
    let unit = report.focus_unit.as_deref().unwrap_or_default();
    let focus = report.focus.as_ref().map_or_else(String::new, |focus| in_words(focus, unit));
    let (valid, rate) = (report.valid_fraction.unwrap_or(0.0), report.blur_rate_px2.unwrap_or(0.0));
    let mut lines = vec![
        format!("values     {}", values_in_words(inputs, report.values)),
        format!("focus      {focus}; {:.1} % of the frame", 100.0 * valid),
        format!("blur       grows by {rate:.4} px² per squared distance from the focus ({unit})"),
    ];
    lines.extend(never_in_focus(report));
    lines.extend(report.depth.as_ref().map(|depth| {
        let range = in_words(&depth.range, "mm");
        format!("depth      {range}; beyond infinity: {} px", depth.out_of_range)
    }));
    lines.push(format!("depth.png  {}", near_and_far(report, palette)));
    lines.extend(report.measurements.iter().flat_map(rows).map(|(label, text)| format!("{label:<10} {text}")));
    lines.extend(report.warnings.iter().map(|warning| format!("warning    {warning}")));
    lines.push(format!("results    {}", out.display()));
    lines.join("\n")
}

fn near_and_far(report: &Report, palette: Palette) -> String {
    let [near, far] = palette.ends();
    if report.depth.is_some() {
        return format!("mm, {near} near, {far} far");
    }
    let (nearest, other) = if report.nearer == Some(1) { ("first", 2) } else { ("last", 1) };
    let ends = format!("{near} near, {far} far, the {nearest} frame");
    match report.nearer_by {
        Some(NearerBy::Stated) => format!("{ends} focused nearest (stated)"),
        Some(NearerBy::Distances) => format!("{ends} focused nearest (distances)"),
        _ => format!("{ends} taken as focused nearest; --nearer {other} swaps them"),
    }
}

/// The share of the frame that is in focus in no frame, before the first frame and beyond the last.
fn never_in_focus(report: &Report) -> Option<String> {
    let pixels = f64::from(report.size.width) * f64::from(report.size.height);
    let NeverReport { before_first_px, beyond_last_px } = report.never_in_focus?;
    let share = |count: usize| 100.0 * count as f64 / pixels;
    let text = format!(
        "never      in focus: {:.1} % of the frame lies before the first frame, {:.1} % beyond the last",
        share(before_first_px),
        share(beyond_last_px)
    );
    (before_first_px + beyond_last_px > 0).then_some(text)
}

/// Formats a range with enough digits to distinguish its ends.
fn in_words(range: &RangeReport, unit: &str) -> String {
    let (Some(min), Some(max), Some(median)) = (range.min, range.max, range.median) else {
        return "nowhere".to_string();
    };
    let digits = decimals(f64::from(max - min) / 100.0);
    format!("{min:.digits$} to {max:.digits$} {unit}, median {median:.digits$}")
}
