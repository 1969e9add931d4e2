//! `parfocal solve`: two photographs in, relative blur and registration out.

use std::fmt;
use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

use clap::ValueEnum;
use parfocal::export::{self, FILES, Look, Nearer, Report};
use parfocal::{Decode, Engine, EngineOptions, Frame, Method, Settings, Solution, Solver, image_io};

use super::failure::{Failure, print};
use super::summary::{Bar, summary};

/// Recover relative blur and registration of two photographs of one scene, focused at two distances.
#[derive(clap::Args, Debug)]
#[command(after_help = super::AFTER_HELP)]
pub(super) struct Arguments {
    /// The reference photograph: PNG, JPEG, TIFF, PNM or EXR
    i1: PathBuf,
    /// The other photograph, of the same size
    i2: PathBuf,
    /// Folder for the results; made if it is missing, earlier results in it replaced
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Solve for the registration too, or hold it at identity (or at --transform)
    #[arg(long, value_enum, default_value_t = MethodName::from(Settings::default().method))]
    method: MethodName,
    /// Pyramid levels, 1 to 12; auto halves the images while the short side stays at least 32 px
    #[arg(long, value_name = "N|auto", default_value_t = Levels(Settings::default().levels))]
    levels: Levels,
    /// Largest |V|, the difference of the blurs' variances, px² of the full-size image, 1 to 256
    #[arg(long, value_name = "PX2", allow_negative_numbers = true, default_value_t = Settings::default().max_relative_blur)]
    max_relative_blur: f64,
    /// Weight α of the smoothness of V, no unit, 1e-6 to 10; larger is smoother
    #[arg(long, value_name = "A", allow_negative_numbers = true, default_value_t = Settings::default().regularization)]
    regularization: f64,
    /// Outer iterations on each level at most, 5 to 1000
    #[arg(long, value_name = "N", default_value_t = Settings::default().outer_iterations)]
    outer_iterations: u32,
    /// Relaxation sweeps in each outer iteration, 1 to 100
    #[arg(long, value_name = "N", default_value_t = Settings::default().sweeps)]
    sweeps: u32,
    /// Start from the registration (and exposure, if stated) in a report.json or its transform object
    #[arg(long, value_name = "FILE")]
    transform: Option<PathBuf>,
    /// Keep what --transform states instead of starting from it; the method is then aligned
    #[arg(long, requires = "transform")]
    hold: bool,
    /// How stored values become intensities: as stored, or with the sRGB curve undone
    #[arg(long, value_enum, default_value_t = DecodeName::from(Settings::default().decode))]
    decode: DecodeName,
    /// Do not solve for the difference in exposure (gain and offset) of the two images
    #[arg(long)]
    no_photometric: bool,
    /// Which image is focused nearer, 1 or 2; decides what is red in depth.png
    #[arg(long, value_name = "1|2", default_value_t = Nearer::default().number(),
          value_parser = clap::value_parser!(u8).range(1..=2))]
    nearer: u8,
    /// Print the report on stdout too
    #[arg(long)]
    json: bool,
    /// Index, part of the name, or UUID of the device [default: the most capable]
    #[arg(long, value_name = "D")]
    device: Option<String>,
    /// Longest wait for the device, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = EngineOptions::default().timeout.as_secs(),
          value_parser = clap::value_parser!(u64).range(1..))]
    timeout: u64,
    /// Print nothing on stderr but errors
    #[arg(long)]
    quiet: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum MethodName {
    Unified,
    Aligned,
}

impl From<Method> for MethodName {
    fn from(method: Method) -> Self {
        match method {
            Method::Unified => Self::Unified,
            Method::Aligned => Self::Aligned,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum DecodeName {
    None,
    Srgb,
}

impl From<Decode> for DecodeName {
    fn from(decode: Decode) -> Self {
        match decode {
            Decode::None => Self::None,
            Decode::Srgb => Self::Srgb,
        }
    }
}

/// A number of levels, or `auto`.
#[derive(Clone, Copy, Debug)]
struct Levels(Option<u32>);

impl FromStr for Levels {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Self(None));
        }
        text.parse().map(|count| Self(Some(count))).map_err(|_| "give a whole number or auto".to_string())
    }
}

impl fmt::Display for Levels {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            None => f.write_str("auto"),
            Some(count) => count.fmt(f),
        }
    }
}

/// Solves a pair and writes the results. Cheap checks come before dear ones: arguments, files, device, solve, write.
pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let mut settings = settings(arguments);
    settings.check()?;
    start_from_file(arguments, &mut settings)?;
    check_output(arguments)?;
    let (i1, i2) = image_io::read_pair(&arguments.i1, &arguments.i2)?;
    let engine = Engine::new(&engine_options(arguments))?;
    let solution = solve(&engine, &i1, &i2, &settings, arguments).map_err(|e| Failure::of_solve(e, &arguments.i1))?;
    super::check_validation(&engine)?;
    let nearer = if arguments.nearer == 2 { Nearer::Second } else { Nearer::First };
    let report = Report::new(&solution, &settings, engine.info(), nearer);
    let look = Look { nearer, decode: settings.decode, formats: [i1.format(), i2.format()] };
    export::write(&arguments.output, &solution, &report, &look)?;
    tell(&report, arguments)
}

fn settings(arguments: &Arguments) -> Settings {
    Settings {
        method: match arguments.method {
            MethodName::Unified => Method::Unified,
            MethodName::Aligned => Method::Aligned,
        },
        levels: arguments.levels.0,
        outer_iterations: arguments.outer_iterations,
        sweeps: arguments.sweeps,
        regularization: arguments.regularization,
        max_relative_blur: arguments.max_relative_blur,
        photometric: !arguments.no_photometric,
        decode: match arguments.decode {
            DecodeName::None => Decode::None,
            DecodeName::Srgb => Decode::Srgb,
        },
        ..Settings::default()
    }
}

/// Takes over what `--transform` states; with `--hold` it is kept.
fn start_from_file(arguments: &Arguments, settings: &mut Settings) -> Result<(), Failure> {
    let Some(file) = &arguments.transform else { return Ok(()) };
    let (start, photometric) = export::read_transform(file)?;
    settings.start = start;
    if arguments.hold {
        settings.method = Method::Aligned;
    }
    if let Some(start_photometric) = photometric {
        settings.start_photometric = start_photometric;
        settings.photometric &= !arguments.hold;
    }
    Ok(())
}

/// Refuses an output folder that cannot be one, or where a result would replace an input, before any work is done.
fn check_output(arguments: &Arguments) -> Result<(), Failure> {
    let out = &arguments.output;
    if out.exists() && !out.is_dir() {
        return Err(Failure::Failed(format!("{}: is a file; give a folder for the results", out.display())));
    }
    // The folder, or the nearest above it that there is, must take a file.
    let above = out.ancestors().find(|p| p.is_dir()).filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if let Err(e) = tempfile::tempfile_in(above) {
        return Err(Failure::Failed(format!(
            "{}: cannot be written ({}); give another folder",
            out.display(),
            e.kind()
        )));
    }
    for image in [&arguments.i1, &arguments.i2] {
        if let Some(name) = FILES.iter().find(|name| super::same_file(&out.join(name), image)) {
            let problem = format!("is an input, and the result {name} would replace it; give another folder");
            return Err(Failure::Failed(format!("{}: {problem}", image.display())));
        }
    }
    Ok(())
}

fn engine_options(arguments: &Arguments) -> EngineOptions {
    EngineOptions {
        device: arguments.device.clone(),
        validation: super::validation_asked(),
        timeout: Duration::from_secs(arguments.timeout),
    }
}

fn solve(
    engine: &Engine,
    i1: &Frame,
    i2: &Frame,
    settings: &Settings,
    arguments: &Arguments,
) -> Result<Solution, parfocal::Error> {
    let bar = Bar::new(!arguments.quiet && io::stderr().is_terminal());
    Solver::for_pair(engine, i1, i2, settings)?.solve_with(i1, i2, &mut |progress| bar.show(progress))
}

fn tell(report: &Report, arguments: &Arguments) -> Result<(), Failure> {
    if !arguments.quiet {
        // Nobody is left to be told where stderr is closed.
        let _ = writeln!(io::stderr(), "{}", summary(report, &arguments.output));
    }
    if arguments.json {
        print(&report.to_json().map_err(|e| Failure::Failed(e.to_string()))?)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use clap::Parser;

    use super::*;
    use crate::cli::{Cli, Command};

    const T: &str = r#"{"tx_px": 3, "ty_px": 4, "rotation_deg": 0, "scale": 1}"#;

    fn with_exposure() -> String {
        format!(r#"{{"transform": {T}, "photometric": {{"gain": 1.2, "offset": 0.1}}}}"#)
    }

    fn parse(extra: &[&str]) -> Box<Arguments> {
        let arguments = ["parfocal", "solve", "a.png", "b.png", "-o", "out"].iter().chain(extra);
        match Cli::try_parse_from(arguments).unwrap().command {
            Command::Solve(arguments) => arguments,
            other => panic!("{other:?}"),
        }
    }

    fn with_file(extra: &[&str], json: &str) -> Settings {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("report.json");
        fs::write(&file, json).unwrap();
        let all = ["--transform", file.to_str().unwrap()].into_iter().chain(extra.iter().copied());
        let arguments = parse(&all.collect::<Vec<_>>());
        let mut settings = settings(&arguments);
        start_from_file(&arguments, &mut settings).unwrap();
        settings
    }

    #[test]
    fn without_flags_the_settings_are_those_of_the_library() {
        assert_eq!(settings(&parse(&[])), Settings::default());
    }

    #[test]
    fn a_transform_is_a_start_and_hold_keeps_it() {
        let start = with_file(&[], &with_exposure());
        assert_eq!((start.method, start.photometric, start.start.tx), (Method::Unified, true, 3.0));
        assert_eq!(start.start_photometric.gain, 1.2);
        let held = with_file(&["--hold"], &with_exposure());
        assert_eq!((held.method, held.photometric, held.start.ty), (Method::Aligned, false, 4.0));
        let exposure_not_stated = with_file(&["--hold"], T);
        assert_eq!((exposure_not_stated.method, exposure_not_stated.photometric), (Method::Aligned, true));
        let aligned = with_file(&["--method", "aligned"], &with_exposure());
        assert_eq!((aligned.method, aligned.photometric, aligned.start.tx), (Method::Aligned, true, 3.0));
    }
}
