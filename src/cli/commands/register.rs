//! `parfocal register`: registers two photographs or the frames of a sweep.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::ValueEnum;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use parfocal::export::{self, FileKind, FrameReport, Report};
use parfocal::image_io::{Photograph, Values};
use parfocal::sweep::SweepOptions;
use parfocal::{PairSolver, Settings, SolveOptions, SweepSolver, settings::Method};

use crate::cli::help::{AFTER_HELP, INPUT, OUTPUT, REGISTRATION};
use crate::cli::jobs::sweep::{Decoded, check_alike, decode};
use crate::cli::options::photographs::{self, PageArguments, SweepFiles};
use crate::cli::options::run::{RunArguments, check_validation, is_validation_requested};
use crate::cli::options::series;
use crate::cli::options::settings::{SettingsArguments, StartUse};
use crate::cli::output::destination::{self, ForceArgument};
use crate::cli::output::failure::Failure;
use crate::cli::output::numbers::signed;
use crate::cli::output::summary::registration_summary;

/// Register two photographs of one scene or a focus sweep, in position and exposure
#[derive(clap::Args, Debug)]
#[command(after_long_help = AFTER_HELP)]
pub(crate) struct Arguments {
    /// I1 and I2, or three or more frames of a sweep in order, or their folder
    #[arg(required = true, num_args = 1.., value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// Frame of a sweep that the others are registered to, from 1 [default: the middle frame]
    #[arg(long, value_name = "N", help_heading = INPUT, value_parser = clap::value_parser!(u32).range(1..))]
    reference: Option<u32>,
    #[command(flatten)]
    settings: SettingsArguments,
    /// Method of registration
    #[arg(long, value_name = "NAME", help_heading = REGISTRATION, value_parser = method_parser(),
          default_value = "unified")]
    method: Method,
    /// File for the registration, JSON that `solve --transform` reads
    #[arg(short, long, value_name = "FILE.json", help_heading = OUTPUT, display_order = 0)]
    output: Option<PathBuf>,
    #[command(flatten)]
    force: ForceArgument,
    #[command(flatten)]
    run: RunArguments,
}

/// The methods that register, with their names.
fn method_parser() -> impl TypedValueParser<Value = Method> {
    let methods = Method::value_variants().iter().filter(|method| **method != Method::Aligned);
    PossibleValuesParser::new(methods.filter_map(ValueEnum::to_possible_value))
        .map(|name| Method::from_str(&name, false).unwrap_or_default())
}

/// Registers a pair. Writes and prints the registration.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let run = &arguments.run;
    let mut settings = arguments.settings.settings(arguments.method, StartUse::Start)?;
    let files = match <[PathBuf; 2]>::try_from(arguments.images.clone()) {
        Ok(files) if arguments.reference.is_none() => {
            files.map(|file| photographs::with_format(file, arguments.settings.raw()))
        }
        _ => return of_sweep(arguments, &settings),
    };
    check_output(arguments, &files)?;
    let (photographs, inputs) = photographs::open_pair(&files)?;
    let values = Values::of(settings.decode, &inputs)?;
    let mut engine = None;
    photographs::check_size(photographs.each_ref(), &settings, photographs::LARGE, || run.info(&mut engine))?;
    let mut frames = Photograph::decode_pair(photographs)?;
    let values = values.corrected(&inputs, &mut frames);
    settings.decode = values.decode;
    let engine = run.engine(engine)?;
    let bar = run.bar(0.0);
    let options = SolveOptions { progress: Some(bar.reporter()), ..SolveOptions::default() };
    let registered = PairSolver::new(&engine, &settings)
        .and_then(|mut solver| solver.register(frames.each_ref(), &options))
        .map_err(|e| Failure::of_solve(e, &files[0]))?;
    drop((options, bar));
    check_validation(&engine)?;
    let mut report = Report::registration(&registered, &settings, engine.info());
    report.values = values;
    report.set_inputs(inputs);
    report.validated = is_validation_requested();
    if let Some(file) = &arguments.output {
        export::write_report(arguments.force.to(file), &report)?;
    }
    run.report.print(&registration_summary(&report, arguments.output.as_deref()), &report)?;
    run.check_strict(report.converged, &report.warnings)
}

/// Registers a sweep. Writes and prints the registration.
fn of_sweep(arguments: &Arguments, settings: &Settings) -> Result<(), Failure> {
    if settings.method != Method::Unified {
        return Err(Failure::Usage("--method is of pairs; a sweep is registered together with the blur".to_string()));
    }
    let files =
        photographs::sweep_frames(&arguments.images, false, arguments.settings.raw(), PageArguments::default())?;
    let reference = arguments.reference.map(|n| n as usize - 1);
    let fits =
        SweepOptions { reference, settings: settings.clone(), ..SweepOptions::default() }.check(files.frames.len());
    fits.map_err(|e| Failure::Usage(e.to_string()))?;
    check_output(arguments, &files.frames)?;
    let run = &arguments.run;
    files.note().iter().for_each(|note| run.report.print_line(note));
    let found = register_sweep(run, settings, &files, reference)?;
    if let Some(file) = &arguments.output {
        export::write_report(arguments.force.to(file), &found)?;
    }
    run.report.print(&sweep_summary(&found, arguments.output.as_deref()), &found)?;
    run.check_strict(found.converged, &found.warnings)
}

/// Registers the frames of a sweep.
fn register_sweep(
    run: &RunArguments,
    settings: &Settings,
    SweepFiles { frames: files, left_out, .. }: &SweepFiles,
    reference: Option<usize>,
) -> Result<Report, Failure> {
    let (started, engine) = (Instant::now(), run.engine.open()?);
    let fits = |first: &Photograph| {
        photographs::check_size([first; 2], settings, photographs::LARGE, || Ok(engine.info().clone()))
    };
    let Decoded { mut frames, inputs, warnings, order } = decode(files, true, fits)?;
    check_alike(&inputs, &frames)?;
    let reference = reference.and_then(|n| order.iter().position(|other| *other == n));
    let values = Values::of(settings.decode, &inputs)?.corrected(&inputs, &mut frames);
    let settings = Settings { decode: values.decode, ..settings.clone() };
    let bar = run.bar(0.0);
    let options = SweepOptions { settings, reference, ..SweepOptions::default() };
    let solve_options = SolveOptions { progress: Some(bar.reporter()), ..SolveOptions::default() };
    let found = SweepSolver::new(&engine, &options).and_then(|mut solver| solver.register(&frames, &solve_options));
    drop((solve_options, bar));
    let found = found.map_err(|e| Failure::of_solve(e, &files[0]))?;
    check_validation(&engine)?;
    let total_ms = started.elapsed().as_secs_f64() * 1e3;
    let names: Vec<String> = inputs.iter().map(|input| input.file.clone()).collect();
    let mut report = Report::sweep_registration(&found, &options.settings, &names, engine.info(), total_ms);
    report.warnings.splice(0..0, warnings);
    report.left_out.clone_from(left_out);
    report.values = values;
    report.set_inputs(inputs);
    report.validated = is_validation_requested();
    Ok(report)
}

/// The summary, a line for each frame, without a newline at the end.
fn sweep_summary(found: &Report, file: Option<&Path>) -> String {
    let frame = |(n, frame): (usize, &FrameReport)| {
        let ([x, y], t) = (frame.transform.translation(), &frame.transform);
        let (rotation, scale, gain) = (t.rotation_deg(), t.scale(), frame.photometric.gain);
        let note = if n == found.reference { "  (reference)" } else { "" };
        let name = series::file_name(Path::new(&frame.file));
        let [x, y, rotation] = [(x, 3), (y, 3), (rotation, 4)].map(|(value, digits)| signed(value, digits));
        format!("{name}  {x} {y} px, {rotation}°, scale {scale:.5}, gain {gain:.4}{note}")
    };
    let mut lines: Vec<String> = found.frames.iter().enumerate().map(frame).collect();
    lines.extend(found.warnings.iter().map(|warning| format!("warning    {warning}")));
    lines.extend(file.map(|file| format!("results    {}", file.display())));
    lines.join("\n")
}

/// Refuses an output file that cannot be written or that is an input.
fn check_output(arguments: &Arguments, files: &[PathBuf]) -> Result<(), Failure> {
    let Some(file) = &arguments.output else { return Ok(()) };
    let inputs: Vec<&PathBuf> = files.iter().chain(arguments.settings.inputs()).collect();
    destination::check_file(arguments.force.to(file), FileKind::Registration, " for the registration", &inputs)
}
