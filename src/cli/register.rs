//! `parfocal register`: two photographs in, registration alone out.

use std::path::PathBuf;

use clap::ValueEnum;
use parfocal::export::{self, FileKind, RegistrationReport};
use parfocal::image_io::Photograph;
use parfocal::{Kernel, Method, Solver};

use super::failure::Failure;
use super::headings::{OUTPUT, REGISTRATION};
use super::help::AFTER_HELP;
use super::output::{self, ForceArgument};
use super::pair::{self, PairArguments};
use super::run::RunArguments;
use super::settings::SettingsArguments;
use super::summary::{Bar, registration_summary};

/// Register two photographs of one scene: where each pixel of I1 lies in I2, and how they differ in exposure.
#[derive(clap::Args, Debug)]
#[command(after_long_help = AFTER_HELP)]
pub(super) struct Arguments {
    #[command(flatten)]
    pair: PairArguments,
    #[command(flatten)]
    settings: SettingsArguments,
    /// How to register
    #[arg(long, value_name = "NAME", help_heading = REGISTRATION, value_enum, default_value_t = MethodName::Unified)]
    method: MethodName,
    /// File for the registration, JSON that `solve --transform` reads; an earlier one is replaced
    #[arg(short, long, value_name = "FILE.json", help_heading = OUTPUT, display_order = 0)]
    output: Option<PathBuf>,
    #[command(flatten)]
    force: ForceArgument,
    #[command(flatten)]
    run: RunArguments,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum MethodName {
    /// Together with the blur
    Unified,
    /// By the difference of the images
    Appearance,
    /// By SIFT key-points
    Sift,
}

impl From<MethodName> for Method {
    fn from(name: MethodName) -> Self {
        match name {
            MethodName::Unified => Self::Unified,
            MethodName::Appearance => Self::Appearance,
            MethodName::Sift => Self::Sift,
        }
    }
}

/// Registers a pair, writes and prints the registration.
pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let run = &arguments.run;
    let mut settings = arguments.settings.settings(arguments.method.into(), false)?;
    if settings.method != Method::Unified {
        // No blur is looked for: no memory for it.
        (settings.kernel, settings.max_relative_blur) = (Kernel::Gaussian, 1.0);
    }
    let files = arguments.pair.files();
    check_output(arguments, &files)?;
    let (photographs, inputs) = pair::open(&files)?;
    let values = arguments.settings.decoding().of(&inputs)?;
    settings.decode = values.decode;
    let [i1, i2] = Photograph::decode_pair(photographs)?;
    let engine = run.open_engine()?;
    let bar = Bar::new(run.told.shows_progress());
    let registered = Solver::for_pair(&engine, &i1, &i2, &settings)
        .and_then(|mut solver| solver.register_with(&i1, &i2, &mut |progress| bar.show(progress)))
        .map_err(|e| Failure::of_solve(e, &files[0]))?;
    drop(bar);
    super::check_validation(&engine)?;
    let mut report = RegistrationReport::new(&registered, &settings, engine.info());
    report.values = values;
    report.of(inputs, super::validation_asked());
    if let Some(file) = &arguments.output {
        export::write_registration(arguments.force.to(file), &report)?;
    }
    run.told.tell(&registration_summary(&report, arguments.output.as_deref()), || report.to_json())?;
    run.check_strict(report.converged, &report.warnings)
}

/// Refuses a file that cannot be one, or that is an input, before any work is done.
fn check_output(arguments: &Arguments, files: &[PathBuf]) -> Result<(), Failure> {
    let Some(file) = &arguments.output else { return Ok(()) };
    let inputs: Vec<&PathBuf> = files.iter().chain(arguments.settings.inputs()).collect();
    output::check_file(arguments.force.to(file), FileKind::Registration, " for the registration", &inputs)
}
