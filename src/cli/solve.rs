//! `parfocal solve`: two photographs in, relative blur and registration out.

use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use parfocal::export::{self, EXTRA_FILES, FILES, Look, Nearer, Report};
use parfocal::report_html::Page;
use parfocal::{Engine, Frame, Method, Settings, Solution, Solver};

use super::failure::{Failure, print};
use super::models::ModelArguments;
use super::output;
use super::pair::PairArguments;
use super::summary::{Bar, summary};

/// Recover relative blur and registration of two photographs of one scene, focused at two distances.
#[derive(clap::Args, Debug)]
#[command(after_help = super::AFTER_HELP)]
pub(super) struct Arguments {
    #[command(flatten)]
    pair: PairArguments,
    /// Folder for the results; made if it is missing, earlier results in it replaced
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// How the registration is found: with the blur; not at all, but held at identity (or at --transform); before the
    /// blur, by the difference of the images or by SIFT key-points
    #[arg(long, value_enum, default_value_t = MethodName::from(Settings::default().method))]
    method: MethodName,
    /// Keep what --transform states instead of starting from it; the method is then aligned
    #[arg(long, requires = "transform")]
    hold: bool,
    /// Which image is focused nearer, 1 or 2; decides what is red in depth.png
    #[arg(long, value_name = "1|2", default_value_t = Nearer::default().number(),
          value_parser = clap::value_parser!(u8).range(1..=2))]
    nearer: u8,
    /// Do not write report.html
    #[arg(long)]
    no_html: bool,
    #[command(flatten)]
    models: ModelArguments,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(super) enum MethodName {
    Unified,
    Aligned,
    Appearance,
    Sift,
}

impl From<Method> for MethodName {
    fn from(method: Method) -> Self {
        match method {
            Method::Unified => Self::Unified,
            Method::Aligned => Self::Aligned,
            Method::Appearance => Self::Appearance,
            Method::Sift => Self::Sift,
        }
    }
}

impl From<MethodName> for Method {
    fn from(name: MethodName) -> Self {
        match name {
            MethodName::Unified => Self::Unified,
            MethodName::Aligned => Self::Aligned,
            MethodName::Appearance => Self::Appearance,
            MethodName::Sift => Self::Sift,
        }
    }
}

/// Solves a pair and writes the results. Cheap checks come before dear ones: arguments, files, device, solve, write.
pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let pair = &arguments.pair;
    let settings = settings(arguments)?;
    output::check(&arguments.output, &[&FILES[..], &EXTRA_FILES].concat(), &pair.inputs())?;
    let (i1, i2, engine) = pair.open()?;
    let solution = solve(&engine, &i1, &i2, &settings, pair.quiet).map_err(|e| Failure::of_solve(e, &pair.i1))?;
    super::check_validation(&engine)?;
    let nearer = if arguments.nearer == 2 { Nearer::Second } else { Nearer::First };
    let report = Report::new(&solution, &settings, engine.info(), nearer);
    let look = Look { nearer, decode: settings.decode, formats: [i1.format(), i2.format()] };
    let fused = export::fused(&solution, settings.decode)?;
    let points = arguments.models.points(&solution, &fused, nearer)?;
    let mut extras = arguments.models.files(points.as_ref(), &fused);
    if !arguments.no_html {
        let names = [&pair.i1, &pair.i2].map(|path| name(path));
        let page = Page { photographs: [&i1, &i2], names, decode: settings.decode, nearer };
        extras.push(page.file(&solution, &report));
    }
    let written: Vec<&str> = FILES.into_iter().chain(extras.iter().map(|extra| extra.name())).collect();
    export::write_with(&arguments.output, &solution, &report, &look, extras)?;
    tell(&report, &written, arguments)
}

/// What a photograph is called in the report: without its folders.
fn name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

fn settings(arguments: &Arguments) -> Result<Settings, Failure> {
    arguments.pair.settings(arguments.method.into(), arguments.hold)
}

fn solve(
    engine: &Engine,
    i1: &Frame,
    i2: &Frame,
    settings: &Settings,
    quiet: bool,
) -> Result<Solution, parfocal::Error> {
    let bar = Bar::new(!quiet && io::stderr().is_terminal());
    Solver::for_pair(engine, i1, i2, settings)?.solve_with(i1, i2, &mut |progress| bar.show(progress))
}

fn tell(report: &Report, written: &[&str], arguments: &Arguments) -> Result<(), Failure> {
    if !arguments.pair.quiet {
        // Nobody is left to be told where stderr is closed.
        let _ = writeln!(io::stderr(), "{}", summary(report, &arguments.output, written));
    }
    if arguments.pair.json {
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
        settings(&parse(&all.collect::<Vec<_>>())).unwrap()
    }

    #[test]
    fn without_flags_the_settings_are_those_of_the_library() {
        assert_eq!(settings(&parse(&[])).unwrap(), Settings::default());
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

    #[test]
    fn every_method_has_its_name() {
        for method in [Method::Unified, Method::Aligned, Method::Appearance, Method::Sift] {
            assert_eq!(settings(&parse(&["--method", method.name()])).unwrap().method, method);
        }
    }
}
