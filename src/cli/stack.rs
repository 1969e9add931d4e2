//! `parfocal stack`: a focus sweep in, one map of the focus and one sharp image out.

use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;
use std::time::Instant;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use parfocal::export::{self, DEPTH_FILE, EXTRA_FILES, FILES, Nearer, SWEEP_FILES, SweepReport};
use parfocal::focus_stack::{SweepOptions, solve_sweep};
use parfocal::{Frame, Method, image_io};

use super::colors::ColorsArgument;
use super::failure::{Failure, print};
use super::output;
use super::pair::SettingsArguments;

/// Recover from a focus sweep where each pixel is in focus, and an image sharp all over.
#[derive(clap::Args, Debug)]
#[command(after_help = super::AFTER_HELP)]
pub(super) struct Arguments {
    /// The frames, three or more of one size and format, in the order of their focus
    #[arg(required = true, num_args = 3.., value_name = "FRAME")]
    frames: Vec<PathBuf>,
    /// Folder for the results; made if it is missing, earlier results in it replaced
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// The focus setting of each frame, ascending or descending, even in 1/distance (a lens' travel is); counted from 0
    /// without it
    #[arg(long, value_name = "P,P,...", value_delimiter = ',', allow_negative_numbers = true)]
    positions: Option<Vec<f64>>,
    /// The frame on whose pixels the results are, counted from 1; the middle one without it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    reference: Option<u32>,
    /// Whether the first frame is focused nearest (1) or the last (2); decides which end is near in depth.png
    #[arg(long, value_name = "1|2", default_value_t = Nearer::default().number(),
          value_parser = clap::value_parser!(u8).range(1..=2))]
    nearer: u8,
    #[command(flatten)]
    colors: ColorsArgument,
    #[command(flatten)]
    settings: SettingsArguments,
}

/// Solves a sweep and writes the results.
pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let started = Instant::now();
    let settings = arguments.settings.settings(Method::Unified, false)?;
    check(arguments)?;
    let mut inputs: Vec<&PathBuf> = arguments.frames.iter().collect();
    inputs.extend(arguments.settings.inputs());
    output::check(&arguments.output, &[&SWEEP_FILES[..], &FILES, &EXTRA_FILES, &[DEPTH_FILE]].concat(), &inputs)?;
    let frames: Vec<Frame> = arguments.frames.iter().map(|file| image_io::read(file)).collect::<Result<_, _>>()?;
    let engine = arguments.settings.open_engine()?;
    let reference = arguments.reference.map(|n| n as usize - 1);
    let (decode, format) = (settings.decode, frames[0].format());
    let options = SweepOptions { settings, positions: arguments.positions.clone(), reference };
    let bar = bar(!arguments.settings.quiet && io::stderr().is_terminal(), frames.len() - 1);
    let sweep = solve_sweep(&engine, &frames, &options, &mut |done, _| bar.set_position(done as u64))
        .map_err(|e| Failure::of_solve(e, &arguments.frames[0]))?;
    bar.finish_and_clear();
    super::check_validation(&engine)?;
    let nearer = if arguments.nearer == 2 { Nearer::Second } else { Nearer::First };
    let files: Vec<String> = arguments.frames.iter().map(|file| file.display().to_string()).collect();
    let total_ms = started.elapsed().as_secs_f64() * 1e3;
    let report = SweepReport::new(&sweep, &files, nearer, engine.info(), total_ms);
    let palette = arguments.colors.palette();
    export::write_sweep(&arguments.output, &sweep, &report, nearer, decode, format, palette)?;
    tell(&report, arguments)?;
    arguments.settings.check_strict(true, &report.warnings)
}

/// Refuses positions and a reference that do not fit the frames.
fn check(arguments: &Arguments) -> Result<(), Failure> {
    let frames = arguments.frames.len();
    if let Some(reference) = arguments.reference.filter(|&n| n as usize > frames) {
        return Err(Failure::Usage(format!("--reference {reference}: there are {frames} frames, counted from 1")));
    }
    match &arguments.positions {
        Some(positions) if positions.len() != frames => {
            let count = positions.len();
            Err(Failure::Usage(format!("--positions: {count} positions for {frames} frames; give one for each")))
        }
        _ => Ok(()),
    }
}

fn bar(shown: bool, pairs: usize) -> ProgressBar {
    let target = if shown { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
    let bar = ProgressBar::with_draw_target(Some(pairs as u64), target);
    bar.set_style(ProgressStyle::default_bar());
    bar
}

fn tell(report: &SweepReport, arguments: &Arguments) -> Result<(), Failure> {
    if !arguments.settings.quiet {
        let number = |v: Option<f32>| v.map_or("none".to_string(), |v| format!("{v:.2}"));
        let mut lines = vec![
            format!(
                "focus      {} to {}, median {} (settings); {:.1} % of the frame",
                number(report.focus.min),
                number(report.focus.max),
                number(report.focus.median),
                100.0 * report.valid_fraction
            ),
            format!("blur       grows by {:.3} px² a squared setting", report.blur_rate_px2),
        ];
        lines.extend(report.warnings.iter().map(|warning| format!("warning    {warning}")));
        lines.push(format!("results    {}", arguments.output.display()));
        // Nobody is left to be told where stderr is closed.
        let _ = writeln!(io::stderr(), "{}", lines.join("\n"));
    }
    if arguments.settings.json {
        print(&report.to_json().map_err(|e| Failure::Failed(e.to_string()))?)?;
    }
    Ok(())
}
