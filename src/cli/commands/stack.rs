//! `parfocal stack`: recovers a map of the focus and a sharp image from a focus sweep, from its files to its results.

use std::path::{Path, PathBuf};

use parfocal::export::{FrameReport, NearerBy, NeverReport, PIXEL_SIZES_UM, Palette, RangeReport, Report};
use parfocal::image_io::Input;
use parfocal::settings::Method;
use parfocal::sweep::Positions;

use crate::cli::help::{AFTER_HELP, INPUT, OUTPUT, REGISTRATION};
use crate::cli::jobs::sweep::SweepJob;
use crate::cli::options::part::PartArguments;
use crate::cli::options::photographs::{self, FocusPositionArguments, FramePositions, PageArguments};
use crate::cli::options::run::check_validation;
use crate::cli::options::series;
use crate::cli::options::settings::{SettingsArguments, StartUse, one_or_two};
use crate::cli::options::solve::ResultArguments;
use crate::cli::output::failure::Failure;
use crate::cli::output::numbers::{decimals, depth_range, measurements};
use crate::cli::output::summary::{camera_moved, pictures_in_words, values_in_words};

/// Recover the focus of each pixel and an image that is sharp everywhere from a focus sweep
#[derive(clap::Args, Debug)]
#[command(after_long_help = AFTER_HELP)]
pub(crate) struct Arguments {
    /// Three or more frames of one size in the order of their focus, their folder, or a TIFF of pages
    ///
    /// The frames of a folder are the photographs whose names differ in their numbers only, such as IMG_0001.JPG and
    /// 0.5mm.tif, in the order of the numbers. Others are left out and listed. Of ImageJ and OME-TIFF stacks the pages
    /// along z are read, with the pixel size and the positions that they state.
    #[arg(required = true, num_args = 1.., value_name = "FRAME")]
    frames: Vec<PathBuf>,
    /// Focus setting of each frame [default: 0, 1, 2, ...]
    ///
    /// Ascending or descending, and linear in 1/distance, as the travel of a lens is. Without them, steps are even
    /// unless the sweep shows that frames are missing or steps are uneven; a warning then states the positions.
    #[arg(long, value_name = "P,P,...|START:STEP", help_heading = INPUT, allow_hyphen_values = true,
          conflicts_with = "focus_at")]
    positions: Option<FramePositions>,
    #[command(flatten)]
    focus_at: FocusPositionArguments,
    #[command(flatten)]
    pages: PageArguments,
    /// Frame whose pixels the results follow, from 1 [default: the middle frame]
    #[arg(long, value_name = "N", help_heading = INPUT, value_parser = clap::value_parser!(u32).range(1..))]
    reference: Option<u32>,
    /// The frame that is focused nearest: 1 the first, 2 the last [default: as the sweep shows]
    ///
    /// Determines which end is near in the pictures and on the page. By default --focus-at does, or the scale of the
    /// frames: a lens that is extended to focus near shows things larger; or the distances that the camera stated.
    #[arg(long, value_name = "1|2", help_heading = INPUT, value_parser = one_or_two)]
    nearer: Option<u8>,
    #[command(flatten)]
    settings: SettingsArguments,
    /// Take the frames as aligned already: their registration is held at the identity
    #[arg(long, help_heading = REGISTRATION)]
    hold: bool,
    #[command(flatten)]
    part: PartArguments,
    #[command(flatten)]
    results: ResultArguments,
    /// Folder for the results; earlier results in it are replaced
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT, display_order = 0)]
    output: PathBuf,
}

/// Solves a sweep and writes the results. Inexpensive checks come first.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let has_positions = arguments.focus_at.is_given() || arguments.positions.is_some();
    let files = photographs::sweep_frames(&arguments.frames, has_positions, arguments.settings.raw(), arguments.pages)?;
    let count = files.frames.len();
    let by_setting = arguments.positions.as_ref().map(|positions| Positions::Settings(positions.of(count)));
    let by_file = files.z_mm.clone().map(Positions::Stage);
    let mut job = SweepJob {
        files,
        positions: arguments.focus_at.positions(count).or(by_setting).or(by_file).unwrap_or_default(),
        reference: arguments.reference.map(|n| n as usize - 1),
        out: arguments.output.clone(),
    };
    let (part, method) = (arguments.part.part(), if arguments.hold { Method::Aligned } else { Method::Unified });
    let settings = arguments.settings.settings(method, StartUse::Start)?;
    let nearer = arguments.focus_at.nearer(arguments.nearer, &job.positions);
    let mut request = arguments.results.request(&arguments.settings, settings, part, nearer)?;
    request.pixel_size = request.pixel_size.or(job.files.pixel_um.filter(|um| PIXEL_SIZES_UM.contains(um)));
    job.check(&request)?;
    job.files.note().iter().for_each(|note| request.run.report.print_line(note));
    if let (Some(at @ [first, .., last]), [_]) = (job.positions.millimetres(), &arguments.frames[..]) {
        if job.files.z_mm.is_none() && series::is_backwards(&job.files.frames, at) {
            job.files.frames.reverse();
        }
        let note = format!("note: {} are at {first} to {last} mm, in this order", series::ends(&job.files.frames));
        request.run.report.print_line(&note);
    }
    let mut engine = None;
    let read = job.read(&request, |_| Ok(false), || request.run.info(&mut engine))?;
    let Some(read) = read else { return Ok(()) };
    let engine = request.run.engine(engine)?;
    let bar = request.bar(&read.frames);
    let solved = read.solve(&engine, Some(bar.reporter())).map_err(|e| Failure::of_solve(e, &job.files.frames[0]))?;
    check_validation(&engine)?;
    let report = job.write(&request, engine.info(), &read, &solved)?;
    bar.finish();
    drop(bar);
    request.run.report.print(&summary(&report, &read.inputs, request.palette, &job.out), &report)?;
    request.run.check_strict(report.converged, &report.warnings)
}

/// The summary of a sweep, without a newline at the end.
fn summary(report: &Report, inputs: &[Input], palette: Palette, out: &Path) -> String {
    let unit = report.focus_unit.as_deref().unwrap_or_default();
    let focus = report.focus.as_ref().map_or_else(String::new, |focus| in_words(focus, unit));
    let (valid, rate) = (report.valid_fraction.unwrap_or(0.0), report.blur_rate_px2.unwrap_or(0.0));
    let mut lines = vec![
        format!("frames     {}", frames_in_words(report)),
        format!("values     {}", values_in_words(inputs, report.values)),
        format!("focus      {focus}; {:.1} % of the frame", 100.0 * valid),
        format!("blur       grows by {rate:.4} px² per squared distance from the focus ({unit})"),
    ];
    lines.extend(pictures_in_words(report).map(|words| format!("pictures   {words}")));
    lines.extend(parallax(report));
    lines.extend(most_clipped(report));
    lines.extend(never_in_focus(report));
    lines.extend(report.depth.as_ref().map(|report| format!("depth      {}", depth_range(report))));
    lines.push(format!("depth.png  {}", near_and_far(report, palette)));
    lines.extend(report.measurements.iter().flat_map(measurements).map(|(label, text)| format!("{label:<10} {text}")));
    lines.extend(report.warnings.iter().map(|warning| format!("warning    {warning}")));
    lines.push(format!("results    {}", out.display()));
    lines.join("\n")
}

/// The number of frames that were used, the first and the last, and what was left out of their folder.
fn frames_in_words(report: &Report) -> String {
    let files: Vec<PathBuf> = report.frames.iter().map(|frame| PathBuf::from(&frame.file)).collect();
    let left_out = match &report.left_out[..] {
        [] => String::new(),
        names => format!("; left out: {}", photographs::in_short(names, ", ")),
    };
    format!("{}, {}{left_out}", files.len(), series::ends(&files))
}

fn near_and_far(report: &Report, palette: Palette) -> String {
    let [near, far] = palette.ends();
    let ([near_end, far_end], unit) = (report.end_names(), if report.depth.is_some() { "mm, " } else { "" });
    let (nearest, other) = if report.nearer == Some(1) { ("first", 2) } else { ("last", 1) };
    let by = match report.nearer_by {
        Some(NearerBy::Stated) => "stated",
        Some(NearerBy::Distances) => "distances",
        Some(NearerBy::Scale) => "its scale",
        Some(NearerBy::Exif) => "EXIF",
        _ if report.depth.is_some() => "greater positions are taken as farther away: --stage up if they are nearer",
        _ => "nothing shows which is focused nearer: --nearer 1 or 2",
    };
    if report.nearer_by == Some(NearerBy::Assumed) {
        return format!("{unit}{near} {near_end}, {far} {far_end} frame; {by}");
    }
    format!("{unit}{near} near, {far} far, the {nearest} frame focused nearest ({by}); --nearer {other} swaps them")
}

/// How far near things are displaced against far ones between two frames at most.
fn parallax(report: &Report) -> Option<String> {
    let range = report.focus.as_ref().and_then(|focus| Some(f64::from(focus.max? - focus.min?)))?;
    let all: Vec<[f64; 2]> = report.frames.iter().filter_map(|frame| frame.parallax).collect();
    let between = all.iter().flat_map(|a| all.iter().map(move |b| (a[0] - b[0]).hypot(a[1] - b[1])));
    let px = range * between.fold(0.0, f64::max);
    (px > 0.0).then(|| format!("parallax   {}", camera_moved(format_args!("{px:.1}"))))
}

/// The frame with the most clipped pixels, if any are.
fn most_clipped(report: &Report) -> Option<String> {
    let share = |frame: &&FrameReport| frame.clipped_fraction.unwrap_or(0.0);
    let frame = report.frames.iter().max_by(|a, b| share(a).total_cmp(&share(b)))?;
    let name = series::file_name(Path::new(&frame.file));
    let text = format!("clipped    up to {:.1} % of the pixels of a frame ({name})", 100.0 * share(&frame));
    (share(&frame) > 0.0).then_some(text)
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
