//! `parfocal calibrate`: finds constants of a lens, and its field, from targets of known depth.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use parfocal::Region;
use parfocal::export::{self, FileKind, Results};
use parfocal::metric::measure::Values;
use parfocal::{
    Error,
    internals::bounded_read,
    metric::{Calibration, LensField, LensParameter, SolvedTarget, Target, calibrate},
};
use serde::Deserialize;

use crate::cli::options::lens::LensArguments;
use crate::cli::options::part::{numbers, region_at_depth};
use crate::cli::options::run::ResultsArguments;
use crate::cli::output::destination::{self, same_file};
use crate::cli::output::failure::Failure;
use crate::cli::output::numbers::decimals;

/// Find the blur constant kappa, focus distances and the field of a lens from the results of known targets
#[derive(clap::Args, Debug)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Arguments {
    #[command(flatten)]
    of: ResultsArguments,
    #[command(flatten)]
    lens: LensArguments,
    /// Depths of a plane that fills the image, at its corners top left, top right, bottom left (mm)
    #[arg(long, value_name = "Z00,Z10,Z01", value_parser = corners, required_unless_present_any = ["known", "known_from"],
          conflicts_with_all = ["known", "known_from"])]
    plane: Option<[f64; 3]>,
    /// Results of the plane at another distance, which determine how V changes over the field
    ///
    /// The lens of the output then has a field: a gain and an offset of V at each place. They are removed from V before
    /// it is converted to depth. An error of a stated depth or tilt goes into the field and into kappa.
    #[arg(long, value_name = "OUT", requires_all = ["plane", "second_plane"],
          conflicts_with_all = ["known", "known_from"])]
    second: Option<PathBuf>,
    /// Depths of the plane of --second, at its corners as for --plane (mm)
    #[arg(long, value_name = "Z00,Z10,Z01", value_parser = corners, requires = "second")]
    second_plane: Option<[f64; 3]>,
    /// Region of the target and its depth (px, mm); can be repeated
    #[arg(long, value_name = "X,Y,W,H=Z", value_parser = region_at_depth)]
    known: Vec<(Region, f64)>,
    /// File with regions and depths, JSON: [{"region": [X, Y, W, H], "depth_mm": Z}, ...]
    #[arg(long, value_name = "FILE")]
    known_from: Option<PathBuf>,
    /// Constants to find; if the target does not determine all, the last one stays as stated
    #[arg(long, value_enum, value_name = "UNKNOWN,...", value_delimiter = ',', default_value = "kappa")]
    fit: Vec<UnknownName>,
    /// File for the lens, JSON that --lens reads
    #[arg(short, long, value_name = "FILE.json")]
    output: Option<PathBuf>,
}

const AFTER_HELP: &str = "\
Example, a plane tilted from left to right:
  parfocal solve near.png far.png -o target
  parfocal calibrate target --focal-length 50 --f-number 5.6 --pixel-pitch 0.0075 --focus 226.5,233.5 \\
    --plane 227,233,227 --fit kappa,focus2 -o lens.json
  parfocal solve other-near.png other-far.png -o part --lens lens.json

Example, how V changes over the field, from a plane square to the axis at two distances:
  parfocal calibrate target --focus 226.5,233.5 --plane 228,228,228 --second target2 --second-plane 232,232,232 \\
    --fit kappa,focus2 -o lens.json

Exit status: 0 done, 1 failed (also where the target determines nothing), 2 wrong usage.";

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum UnknownName {
    /// Standard deviation of the blur over its radius
    Kappa,
    /// Distance at which I1 is focused
    Focus1,
    /// Distance at which I2 is focused
    Focus2,
}

impl From<UnknownName> for LensParameter {
    fn from(name: UnknownName) -> Self {
        match name {
            UnknownName::Kappa => Self::Kappa,
            UnknownName::Focus1 => Self::Focus1,
            UnknownName::Focus2 => Self::Focus2,
        }
    }
}

fn corners(text: &str) -> Result<[f64; 3], String> {
    numbers(text).ok_or_else(|| "give three depths in mm, as in 227,233,227".to_string())
}

/// An entry of --known-from.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StepOfFile {
    region: [u32; 4],
    depth_mm: f64,
}

/// Fits, writes and prints the lens.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    arguments.lens.stated()?;
    let unknowns = unknowns(&arguments.fit)?;
    let target = target(arguments)?;
    check_output(arguments)?;
    check_second(arguments)?;
    let folders: Vec<&PathBuf> = std::iter::once(&arguments.of.results).chain(&arguments.second).collect();
    let solved: Vec<Results> = folders.iter().map(|folder| Results::read_pair(folder)).collect::<Result<_, _>>()?;
    let lens = arguments.lens.required(&solved[0])?;
    for (folder, solved) in folders.iter().zip(&solved) {
        let refused = |problem: &str| Err(Failure::file(folder, problem));
        let needs_all = matches!(target, Target::Plane(_)) || lens.field.is_some();
        if needs_all && solved.report.size != solved.report.photograph {
            return refused(
                "is of a part of the photographs, but a plane or a field is of all; solve without --roi and --crop-valid",
            );
        }
        if solved.report.flattened && (arguments.second.is_some() || lens.field.is_some()) {
            return refused(
                "was solved with --flat, which has changed V over the field already; solve it without --flat",
            );
        }
    }
    let confidence: Vec<Vec<f32>> = solved.iter().map(Results::confidence_without_scale).collect();
    let fit = |target: &Target| {
        let targets = std::iter::once(target.clone()).chain(arguments.second_plane.map(Target::Plane));
        let results = solved.iter().zip(&confidence).zip(targets);
        let solved = results.map(|((solved, confidence), target)| SolvedTarget {
            target,
            blur: Values { width: solved.report.size.width, values: solved.values() },
            confidence,
            scale: solved.magnification(),
        });
        calibrate(&lens, &solved.collect::<Vec<_>>(), &unknowns)
    };
    let found = fit(&target).map_err(|e| with_turned_corners(e, &target, |target| fit(target).is_ok()))?;
    if let Some(file) = &arguments.output {
        export::write_json(arguments.of.force.to(file), FileKind::Lens, &found)?;
    }
    arguments.of.report(&summary(&found, arguments.output.as_deref()), &found)
}

/// Refuses a second plane that is the first.
fn check_second(arguments: &Arguments) -> Result<(), Failure> {
    let (first, Some(second)) = (&arguments.of.results, &arguments.second) else { return Ok(()) };
    if same_file(first, second) {
        let problem = "is also the first plane; --second takes results at another distance";
        return Err(Failure::Usage(format!("{}: {problem}", second.display())));
    }
    if arguments.plane == arguments.second_plane {
        let problem = "--plane and --second-plane are equal; a field needs planes at two distances";
        return Err(Failure::Usage(problem.to_string()));
    }
    Ok(())
}

/// Suggests another order of the corners of a plane, if one determines the lens.
fn with_turned_corners(error: Error, target: &Target, fits: impl Fn(&Target) -> bool) -> Failure {
    let (Error::Region(problem), Target::Plane(corners)) = (&error, target) else { return error.into() };
    let [a, b, c] = corners.map(|z| 1.0 / z);
    let d = b + c - a;
    let turned = [[b, a, d], [c, d, a], [d, c, b], [a, c, b]].map(|corners| corners.map(|q| 1.0 / q));
    let Some([a, b, c]) = turned.into_iter().find(|corners| fits(&Target::Plane(*corners))) else {
        return error.into();
    };
    Failure::Failed(format!(
        "{problem}; or did you mean --plane {a:.3},{b:.3},{c:.3}? Its corners are top left, top right, bottom left, as the image is seen"
    ))
}

fn unknowns(names: &[UnknownName]) -> Result<Vec<LensParameter>, Failure> {
    let twice = names.iter().enumerate().any(|(i, name)| names[..i].contains(name));
    if twice {
        return Err(Failure::Usage("--fit names one unknown twice".to_string()));
    }
    Ok(names.iter().map(|&name| name.into()).collect())
}

fn target(arguments: &Arguments) -> Result<Target, Failure> {
    if let Some(corners) = arguments.plane {
        return Ok(Target::Plane(corners));
    }
    let mut steps = arguments.known.clone();
    if let Some(file) = &arguments.known_from {
        steps.extend(read_steps(file)?);
    }
    Ok(Target::Steps(steps))
}

/// Greatest size of a file of regions, 1 MiB: some ten thousand regions.
const MAX_BYTES: u64 = 1 << 20;

fn read_steps(file: &Path) -> Result<Vec<(Region, f64)>, Failure> {
    const SHAPE: &str = r#"give [{"region": [X, Y, W, H], "depth_mm": Z}, ...]"#;
    let failed = |problem: String| Failure::file(file, problem);
    let text =
        bounded_read::text(file, MAX_BYTES).map_err(|e| failed(format!("cannot be read ({e}); check the path")))?;
    let steps: Vec<StepOfFile> =
        serde_json::from_str(&text).map_err(|e| failed(format!("holds no steps ({e}); {SHAPE}")))?;
    let step = |StepOfFile { region: [x, y, width, height], depth_mm }| (Region { x, y, width, height }, depth_mm);
    Ok(steps.into_iter().map(step).collect())
}

/// Reads a file, for fuzz tests.
#[cfg(test)]
pub(crate) fn reads(file: &Path) {
    let _ = read_steps(file);
}

/// Refuses an output file that cannot be written or that is an input. An earlier lens may be replaced.
fn check_output(arguments: &Arguments) -> Result<(), Failure> {
    let Some(file) = &arguments.output else { return Ok(()) };
    let folders = std::iter::once(&arguments.of.results).chain(&arguments.second);
    let results = folders.flat_map(|folder| export::result_files().map(|name| folder.join(name)));
    let inputs: Vec<PathBuf> = results.chain(arguments.known_from.clone()).collect();
    let inputs: Vec<&PathBuf> = inputs.iter().collect();
    destination::check_file(arguments.of.force.to(file), FileKind::Lens, " for the lens", &inputs)
}

fn summary(found: &Calibration, file: Option<&Path>) -> String {
    let name = |unknown| match unknown {
        LensParameter::Kappa => ("kappa", ""),
        LensParameter::Focus1 => ("focus of I1", " mm"),
        LensParameter::Focus2 => ("focus of I2", " mm"),
    };
    let mut lines: Vec<String> = Vec::new();
    for item in &found.found {
        let ((label, unit), estimate) = (name(item.unknown), item.estimate);
        let digits = decimals(estimate.standard_error);
        lines.push(format!("{label:<14} {:.digits$} ± {:.digits$}{unit}", estimate.value, estimate.standard_error));
    }
    for &unknown in &found.undetermined {
        lines.push(format!("{:<14} not determined by this target; left as stated", name(unknown).0));
    }
    if let Some(estimates) = &found.field {
        let field = found.lens.field.as_ref();
        let (gain, offset) = (estimates.gain.standard_error, estimates.offset.standard_error);
        let is_even = |coefficients: &[f64]| coefficients.iter().all(|c| *c == 0.0);
        lines.push(match field.filter(|field| !is_even(&field.gain)).map(LensField::gains) {
            Some([least, most]) => format!("gain of V      {least:.3} to {most:.3} ± {gain:.3} over the field"),
            None => format!("gain of V      1 over the field, or not determined: ± {gain:.3}"),
        });
        let digits = decimals(offset);
        lines.push(match field.filter(|field| !is_even(&field.offset)).map(LensField::offsets) {
            Some([least, most]) => {
                format!("offset of V    {least:+.digits$} to {most:+.digits$} ± {offset:.digits$} px² over the field")
            }
            None => format!("offset of V    0 over the field, or not determined: ± {offset:.digits$} px²"),
        });
    }
    let in_mm = found.residual_rms_mm.map_or(String::new(), |mm| format!(", {mm:.4} mm"));
    let part = 100.0 * found.outliers as f64 / found.pixels as f64;
    lines.push(format!(
        "residual rms   {:.4} px²{in_mm}; {part:.1} % of {} pixels do not belong",
        found.residual_rms_px2, found.pixels
    ));
    lines.extend(file.map(|file| format!("result         {}", file.display())));
    lines.join("\n")
}
