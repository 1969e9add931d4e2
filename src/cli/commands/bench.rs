//! `parfocal bench`: measures the speed of a device.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use parfocal::export::{FileKind, Registration};
use parfocal::internals::bench::{self, Input, Options, Report};
use parfocal::{Settings, image_io, settings::Method, transform::Homography};

use crate::cli::options::run::{EngineArguments, QuietArgument, check_validation};
use crate::cli::options::settings::{KernelChoice, TableArguments};
use crate::cli::output::destination::{self, ForceArgument};
use crate::cli::output::failure::{Failure, print};

/// Measure the speed of solving pairs
///
/// Measures the photographs that the project ships, then synthetic pairs: iterations of each level, convergence, and
/// the time end to end, on the device, and pass by pass, with the bandwidth of a copy for comparison.
#[derive(clap::Args, Debug)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Arguments {
    /// Sizes of synthetic pairs: WIDTHxHEIGHT, or NM for a square of N megapixels [default: 512x512,1024x1024]
    ///
    /// With this option and without --data, no photographs are measured.
    #[arg(long, value_name = "SIZE,...", value_delimiter = ',')]
    sizes: Vec<Size>,
    /// Folder of the shipped pairs, heatsink and part; absent ones are named in the report [default: data]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Measure only this pair of photographs
    #[arg(long, num_args = 2, value_names = ["I1", "I2"], conflicts_with_all = ["sizes", "data"])]
    pair: Vec<PathBuf>,
    /// The registration of that pair for the method aligned, in a report.json or truth.json [default: identity]
    #[arg(long, value_name = "FILE", requires = "pair")]
    transform: Option<PathBuf>,
    /// Methods, as of `solve --method`
    #[arg(long, value_name = "METHOD,...", value_delimiter = ',', value_enum, default_value = "unified")]
    methods: Vec<Method>,
    /// Kernels: auto, gaussian, pillbox, half-gaussian, or pictures of kernels
    #[arg(long, value_name = "KERNEL,...", value_delimiter = ',', default_value = "auto")]
    kernels: Vec<KernelChoice>,
    /// Measured solves (1 to 1000)
    #[arg(long, value_name = "N", default_value_t = Options::default().repeats,
          value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeats: u32,
    /// Solves between the first, cold one and the measured ones (0 to 1000)
    #[arg(long, value_name = "N", default_value_t = Options::default().warmup,
          value_parser = clap::value_parser!(u32).range(0..=1000))]
    warmup: u32,
    #[command(flatten)]
    settings: TableArguments<true>,
    /// Do not compute the fused image
    #[arg(long)]
    no_fused: bool,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
    /// File for the report, JSON that --against and --compare read
    #[arg(short, long, value_name = "FILE.json")]
    output: Option<PathBuf>,
    /// File for a trace of the last solve of each run, for Perfetto and chrome://tracing
    #[arg(long, value_name = "FILE.json")]
    trace: Option<PathBuf>,
    /// Print also the ratios to an earlier report
    #[arg(long, value_name = "BASE.json")]
    against: Option<PathBuf>,
    /// Print the ratios of two reports and measure nothing
    #[arg(long, num_args = 2, value_names = ["OLD.json", "NEW.json"], exclusive = true)]
    compare: Vec<PathBuf>,
    #[command(flatten)]
    force: ForceArgument,
    #[command(flatten)]
    engine: EngineArguments,
    #[command(flatten)]
    quiet: QuietArgument,
}

const AFTER_HELP: &str = "\
Ratios are new over old: above 1 is slower.

Exit status: 0 done (whatever the ratios), 1 failed or a size is too large for the device, 2 wrong usage.";

/// A width and a height.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Size([u32; 2]);

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let text = text.trim();
        let size = match text.strip_suffix(['M', 'm']) {
            Some(megapixels) => megapixels.parse().ok().filter(|n| (0.0..=1e6).contains(n)).map(square),
            None => text.split_once(['x', 'X']).and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?])),
        };
        size.filter(|[width, height]| *width > 0 && *height > 0)
            .map(Self)
            .ok_or_else(|| "give WIDTHxHEIGHT, as 1920x1080, or megapixels of a square, as 16M".to_string())
    }
}

fn square(megapixels: f64) -> [u32; 2] {
    [(1e6 * megapixels).sqrt().round() as u32; 2]
}

/// Runs the benchmark, or compares two reports.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if let [old, new] = arguments.compare.as_slice() {
        return print(&bench::compare(&Report::read(old)?, &Report::read(new)?));
    }
    let base = arguments.against.as_deref().map(Report::read).transpose()?;
    check_outputs(arguments)?;
    let options = options(arguments)?;
    let (engine, engine_ms) = bench::open(&arguments.engine.options())?;
    let measured = bench::run(&engine, engine_ms, &options, &mut |line| arguments.quiet.print_line(line))?;
    check_validation(&engine)?;
    let report = &measured.report;
    if let Some(file) = &arguments.output {
        report.write(arguments.force.to(file))?;
    }
    if let Some(file) = &arguments.trace {
        measured.trace.write(arguments.force.to(file))?;
    }
    print_report(report, base.as_ref(), arguments)?;
    match report.refused.as_slice() {
        [] => Ok(()),
        refused => {
            let why = refused.iter().map(|refused| format!("{}: {}", refused.case, refused.error));
            Err(Failure::Failed(why.collect::<Vec<_>>().join("; ")))
        }
    }
}

fn options(arguments: &Arguments) -> Result<Options, Failure> {
    let settings = Settings { fused: !arguments.no_fused, ..arguments.settings.0.clone() };
    settings.check()?;
    let (inputs, absent) = inputs(arguments)?;
    Ok(Options {
        inputs,
        absent,
        methods: arguments.methods.clone(),
        kernels: arguments.kernels.iter().map(KernelChoice::read).collect::<Result<_, _>>()?,
        settings,
        warmup: arguments.warmup,
        repeats: arguments.repeats,
        traced: arguments.trace.is_some(),
    })
}

/// The pairs to measure, photographs first, and the names of the absent ones.
fn inputs(arguments: &Arguments) -> Result<(Vec<Input>, Vec<String>), Failure> {
    if let [i1, i2] = arguments.pair.as_slice() {
        let stated = arguments.transform.as_deref().map(Registration::read).transpose()?;
        let transform = stated.and_then(|stated| Some(stated.second()?.transform)).unwrap_or(Homography::IDENTITY);
        let pair = Box::new(image_io::read_pair(i1, i2)?.into());
        return Ok((vec![Input::Photographs { scene: "pair".to_string(), pair, transform }], Vec::new()));
    }
    let (mut inputs, absent) = match &arguments.data {
        Some(data) => Input::shipped(data)?,
        None if arguments.sizes.is_empty() => Input::shipped(Path::new("data"))?,
        None => Default::default(),
    };
    if arguments.sizes.is_empty() {
        inputs.extend(Options::default().inputs);
    }
    inputs.extend(arguments.sizes.iter().map(|size| Input::Synthetic(size.0)));
    Ok((inputs, absent))
}

/// Refuses output files that cannot be written or that are inputs.
fn check_outputs(arguments: &Arguments) -> Result<(), Failure> {
    let inputs: Vec<&PathBuf> = arguments.pair.iter().chain(&arguments.transform).collect();
    let outputs = [(&arguments.output, FileKind::Bench), (&arguments.trace, FileKind::Trace)];
    for (file, kind) in outputs.iter().filter_map(|(file, kind)| Some((file.as_ref()?, *kind))) {
        destination::check_file(arguments.force.to(file), kind, "", &inputs)?;
    }
    if arguments.output.is_some() && arguments.output == arguments.trace {
        return Err(Failure::Usage("--output and --trace name one file; give two".to_string()));
    }
    Ok(())
}

/// Prints the report on stdout, then the ratios. The ratios go to stderr if the report is JSON.
fn print_report(report: &Report, base: Option<&Report>, arguments: &Arguments) -> Result<(), Failure> {
    if arguments.json {
        print(&report.to_json().map_err(|e| Failure::Failed(e.to_string()))?)?;
    } else {
        print(&report.table())?;
    }
    match base.map(|base| bench::compare(base, report)) {
        Some(ratios) if arguments.json => drop(writeln!(io::stderr(), "{ratios}")),
        Some(ratios) => print(&format!("\n{ratios}"))?,
        None => {}
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_is_given_by_its_sides_or_in_megapixels() {
        for (text, size) in [("640x480", [640, 480]), (" 64X48", [64, 48]), ("4M", [2000, 2000]), ("0.25m", [500, 500])]
        {
            assert_eq!(text.parse(), Ok(Size(size)));
        }
        for text in ["", "x", "640", "640x", "0x5", "-3M", "M", "nanM", "1e9M", "99999999999x1", "640x480x3"] {
            assert!(text.parse::<Size>().unwrap_err().contains("WIDTHxHEIGHT"), "{text}");
        }
    }
}
