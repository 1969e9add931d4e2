//! `parfocal stack`: a focus sweep in, one map of the focus and one sharp image out.

use std::path::{Path, PathBuf};
use std::time::Instant;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use parfocal::export::{
    self, DEPTH_FILE, EXTRA_FILES, FILES, Look, Nearer, RangeReport, SWEEP_FILES, SweepReport, sweep_files,
};
use parfocal::figure::PEN;
use parfocal::focus_stack::{Positions, SweepOptions, solve_sweep};
use parfocal::image_io::{Input, Photograph};
use parfocal::report_html::SweepPage;
use parfocal::{Frame, Method};

use super::colors::ColorsArgument;
use super::depth::decimals;
use super::failure::Failure;
use super::frames;
use super::headings::{INPUT, OUTPUT};
use super::help::AFTER_HELP;
use super::output::{self, ForceArgument};
use super::pair::name;
use super::run::RunArguments;
use super::settings::SettingsArguments;
use super::summary::values_in_words;

/// Recover from a focus sweep where each pixel is in focus, and an image sharp all over.
#[derive(clap::Args, Debug)]
#[command(after_long_help = AFTER_HELP)]
pub(super) struct Arguments {
    /// The frames, three or more of one size and format, in the order of their focus; or their folder
    #[arg(required = true, num_args = 1.., value_name = "FRAME")]
    frames: Vec<PathBuf>,
    /// The focus setting of each frame; counted from 0 without it
    ///
    /// Ascending or descending, and even in 1/distance, as a lens' travel is.
    #[arg(long, value_name = "P,P,...", help_heading = INPUT, value_delimiter = ',', allow_hyphen_values = true)]
    positions: Option<Vec<f64>>,
    /// The distance from the lens at which each frame is focused, in order; gives depth in mm
    #[arg(
        long,
        value_name = "MM,MM,...",
        help_heading = INPUT,
        value_delimiter = ',',
        allow_hyphen_values = true,
        conflicts_with = "positions"
    )]
    focus_at: Option<Vec<f64>>,
    /// What --focus-at states are places along the axis, from any origin
    ///
    /// Because a stage moved the camera or the scene, or the lens is telecentric towards the scene: depth is even in them,
    /// not in their inverse.
    #[arg(long, help_heading = INPUT, requires_if("true", "focus_at"))]
    stage: bool,
    /// The frame on whose pixels the results are, counted from 1; the middle one without it
    #[arg(long, value_name = "N", help_heading = INPUT, value_parser = clap::value_parser!(u32).range(1..))]
    reference: Option<u32>,
    /// Whether the first (1) or the last (2) is focused nearest [default: 1, or by --focus-at]
    ///
    /// It decides which end is near in pictures and page. Of what --focus-at states the larger is the farther.
    #[arg(long, value_name = "1|2", help_heading = INPUT, value_parser = clap::value_parser!(u8).range(1..=2))]
    nearer: Option<u8>,
    #[command(flatten)]
    settings: SettingsArguments,
    #[command(flatten)]
    colors: ColorsArgument,
    /// Do not write report.html
    #[arg(long, help_heading = OUTPUT)]
    no_html: bool,
    /// Folder for the results; made if it is missing, earlier results in it replaced
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT, display_order = 0)]
    output: PathBuf,
    #[command(flatten)]
    force: ForceArgument,
    #[command(flatten)]
    run: RunArguments,
}

/// Solves a sweep and writes the results.
pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let started = Instant::now();
    let stated = arguments.positions.is_some() || arguments.focus_at.is_some();
    let paths = frames::of_sweep(&arguments.frames, stated)?;
    let mut options = options(arguments, paths.len())?;
    let nearer = nearer(arguments.nearer, &options.positions)?;
    let mut read_files: Vec<&PathBuf> = paths.iter().collect();
    read_files.extend(arguments.settings.inputs());
    let out = arguments.force.to(&arguments.output);
    let possible = [&SWEEP_FILES[..], &FILES, &EXTRA_FILES, &[DEPTH_FILE]].concat();
    output::check(&arguments.output, FILES[4], &possible, &read_files)?;
    let (frames, inputs) = read(&paths)?;
    let values = arguments.settings.decoding().of(&inputs)?;
    options.settings.decode = values.decode;
    let (decode, format) = (values.decode, frames[0].format());
    let look = Look { nearer, decode, formats: [format; 2], palette: arguments.colors.palette(), pen: Some(PEN) };
    let written = sweep_files(arguments.focus_at.is_some(), &look, !arguments.no_html);
    out.check_results(FILES[4], &written)?;
    let engine = arguments.run.open_engine()?;
    let bar = bar(arguments.run.told.shows_progress());
    let mut say = |done, levels| {
        bar.set_length(levels as u64);
        bar.set_position(done as u64);
    };
    let sweep = solve_sweep(&engine, &frames, &options, &mut say).map_err(|e| Failure::of_solve(e, &paths[0]))?;
    bar.finish_and_clear();
    super::check_validation(&engine)?;
    let files: Vec<String> = paths.iter().map(|file| file.display().to_string()).collect();
    let total_ms = started.elapsed().as_secs_f64() * 1e3;
    let mut report = SweepReport::new(&sweep, &files, nearer, engine.info(), total_ms);
    report.values = values;
    report.files =
        sweep_files(sweep.depth.is_some(), &look, !arguments.no_html).into_iter().map(String::from).collect();
    let names = paths.iter().map(|path| name(path)).collect();
    let page = SweepPage { frames: &frames, names, decode, nearer, palette: look.palette, fields: Vec::new() };
    let page = (!arguments.no_html).then(|| page.file(&sweep, &report));
    export::write_sweep(out, &sweep, &report, &look, page)?;
    arguments.run.told.tell(&summary(&report, &inputs, &arguments.output), || report.to_json())?;
    arguments.run.check_strict(true, &report.warnings)
}

/// The frames, one file in memory at a time; also what each says of itself.
fn read(paths: &[PathBuf]) -> Result<(Vec<Frame>, Vec<Input>), Failure> {
    let (mut frames, mut inputs) = (Vec::new(), Vec::new());
    let mut last: Option<Photograph> = None;
    for path in paths {
        let photograph = match last.take() {
            Some(last) => last.open_next(path)?,
            None => Photograph::open(path)?,
        };
        inputs.push(photograph.describe()?);
        last = Some(photograph.clone());
        frames.push(photograph.decode()?);
    }
    Ok((frames, inputs))
}

/// What the flags ask for, once it fits together.
fn options(arguments: &Arguments, frames: usize) -> Result<SweepOptions, Failure> {
    let positions = match (&arguments.focus_at, &arguments.positions) {
        (Some(at), _) if arguments.stage => Positions::Stage(at.clone()),
        (Some(at), _) => Positions::Distances(at.clone()),
        (None, Some(settings)) => Positions::Settings(settings.clone()),
        (None, None) => Positions::Counted,
    };
    let settings = arguments.settings.settings(Method::Unified, false)?;
    let options = SweepOptions { settings, positions, reference: arguments.reference.map(|n| n as usize - 1) };
    options.check(frames).map_err(|e| Failure::Usage(e.to_string()))?;
    Ok(options)
}

/// Which end of the sweep is near, by `--nearer` and by the distances. A stage may count either way, and is overruled.
fn nearer(stated: Option<u8>, positions: &Positions) -> Result<Nearer, Failure> {
    let by_distance = positions.first_is_nearest().map(|first| if first { 1 } else { 2 });
    let contradicted = stated.is_some() && by_distance.is_some() && stated != by_distance;
    if contradicted && matches!(positions, Positions::Distances(_)) {
        return Err(Failure::Usage("--nearer contradicts --focus-at; leave --nearer out".to_string()));
    }
    Ok(if stated.or(by_distance) == Some(2) { Nearer::Second } else { Nearer::First })
}

fn bar(shown: bool) -> ProgressBar {
    let target = if shown { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
    let bar = ProgressBar::with_draw_target(None, target);
    bar.set_style(ProgressStyle::default_bar());
    bar
}

/// The few lines of a sweep, without a newline at the end.
fn summary(report: &SweepReport, inputs: &[Input], out: &Path) -> String {
    let unit = &report.focus_unit;
    let mut lines = vec![
        format!("values     {}", values_in_words(inputs, report.values)),
        format!("focus      {}; {:.1} % of the frame", in_words(&report.focus, unit), 100.0 * report.valid_fraction),
        format!("blur       grows by {:.4} px² a squared distance from the focus ({unit})", report.blur_rate_px2),
    ];
    lines.extend(report.depth.as_ref().map(|depth| {
        let range = in_words(&depth.range, "mm");
        format!("depth      {range}; beyond infinity: {} px", depth.out_of_range)
    }));
    lines.extend(report.warnings.iter().map(|warning| format!("warning    {warning}")));
    lines.push(format!("results    {}", out.display()));
    lines.join("\n")
}

/// A range with the digits that tell its ends apart.
fn in_words(range: &RangeReport, unit: &str) -> String {
    let (Some(min), Some(max), Some(median)) = (range.min, range.max, range.median) else {
        return "nowhere".to_string();
    };
    let digits = decimals(f64::from(max - min) / 100.0);
    format!("{min:.digits$} to {max:.digits$} {unit}, median {median:.digits$}")
}
