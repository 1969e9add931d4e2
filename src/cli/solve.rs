//! `parfocal solve`: two photographs in, relative blur and registration out.

use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;

use clap::ValueEnum;
use parfocal::export::{self, Additions, DEPTH_FILE, DepthReport, FILES, Look, Report};
use parfocal::{Engine, Frame, Method, MetricDepth, Settings, Solution, Solver};

use super::failure::{Failure, print};
use super::lens::{self, LensArguments, PartOfLens};
use super::measure::MeasureArguments;
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
    /// Which image is focused nearer, 1 or 2; decides what is red in depth.png [default: 1; with a lens, as
    /// its focus distances say]
    #[arg(long, value_name = "1|2", value_parser = clap::value_parser!(u8).range(1..=2))]
    nearer: Option<u8>,
    #[command(flatten)]
    lens: LensArguments,
    #[command(flatten)]
    measure: MeasureArguments,
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
    let lens = arguments.lens.lens(PartOfLens::default())?;
    let nearer = lens::nearer(arguments.nearer, lens.as_ref())?;
    check_output(arguments)?;
    let (i1, i2, engine) = pair.open()?;
    let wanted = arguments.measure.wanted();
    wanted.check((i1.width(), i1.height()))?;
    let solution = solve(&engine, &i1, &i2, &settings, pair.quiet).map_err(|e| Failure::of_solve(e, &pair.i1))?;
    super::check_validation(&engine)?;
    let (width, blur, uncertainty) = (solution.width, &solution.relative_blur, &solution.uncertainty);
    let metric = lens.map(|lens| {
        MetricDepth::new(&lens, solution.transform.scale, settings.max_relative_blur, width, blur, uncertainty)
    });
    let measurements = wanted.measure(width, blur, uncertainty, metric.as_ref())?;
    let mut report = Report::new(&solution, &settings, engine.info(), nearer);
    report.depth = metric.as_ref().map(DepthReport::from);
    report.measurements = (!wanted.is_empty()).then(|| measurements.clone());
    let look = Look { nearer, decode: settings.decode, formats: [i1.format(), i2.format()] };
    export::write(&arguments.output, &solution, &report, &look, &Additions { depth: metric.as_ref(), measurements })?;
    tell(&report, arguments)
}

fn check_output(arguments: &Arguments) -> Result<(), Failure> {
    let inputs: Vec<_> = arguments.pair.inputs().into_iter().chain(arguments.lens.file()).collect();
    output::check(&arguments.output, &[&FILES[..], &[DEPTH_FILE]].concat(), &inputs)
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

fn tell(report: &Report, arguments: &Arguments) -> Result<(), Failure> {
    if !arguments.pair.quiet {
        // Nobody is left to be told where stderr is closed.
        let _ = writeln!(io::stderr(), "{}", summary(report, &arguments.output));
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
