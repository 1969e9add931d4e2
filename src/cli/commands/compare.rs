//! `parfocal compare`: two results of one scene, side by side.

use std::path::{Path, PathBuf};

use parfocal::export::{FileKind, FrameReport, Palette, Quantity, Report, Results};
use parfocal::page::figure;
use serde::Serialize;
use serde_json::Value;

use crate::cli::options::run::ReportArguments;
use crate::cli::options::settings::differing;
use crate::cli::output::destination::{self, ForceArgument};
use crate::cli::output::failure::Failure;
use crate::cli::output::numbers::decimals;

/// Compare two results of one scene: settings, numbers, and their differences in units of the standard deviation.
#[derive(clap::Args, Debug)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Arguments {
    /// Folder that `parfocal solve -o` or `stack -o` wrote
    first: PathBuf,
    /// Folder of other results with the same pixels
    second: PathBuf,
    /// Also write a picture of the differences, PNG: from -5 (second nearer) to 5 standard deviations, white where not
    /// in both
    #[arg(short, long, value_name = "FILE.png")]
    output: Option<PathBuf>,
    #[command(flatten)]
    report: ReportArguments,
    #[command(flatten)]
    force: ForceArgument,
}

const AFTER_HELP: &str = "\
Depth in mm is compared where both have it, else V, or focus. The difference at a pixel is the second less the first, over the root of
the sum of both variances: if they differ only by noise, two in three pixels are within 1.

Exit status: 0 done, 1 failed, 2 wrong usage.";

/// Standard deviations at the ends of the picture's colour scale.
const ENDS: f64 = 5.0;

/// The result of a comparison.
#[derive(Serialize)]
struct Compared {
    quantity: String,
    unit: &'static str,
    /// Settings that differ, by name.
    settings: Vec<(String, [Value; 2])>,
    numbers: Vec<(&'static str, [Option<f64>; 2])>,
    difference: Difference,
}

/// The second minus the first.
#[derive(Serialize)]
struct Difference {
    /// Number of pixels that both results measure.
    pixels: usize,
    median: Option<f64>,
    /// Root mean square of the difference.
    rms: Option<f64>,
    /// Root mean square in standard deviations.
    median_sigmas: Option<f64>,
    rms_sigmas: Option<f64>,
    /// Fraction of those pixels beyond three standard deviations.
    beyond_three_sigmas: Option<f64>,
}

/// Reads, compares and prints.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let paths = [&arguments.first, &arguments.second];
    if let Some(file) = &arguments.output {
        destination::check_file(arguments.force.to(file), FileKind::Png, " for the picture", &[])?;
    }
    let [a, b] = [Results::read(paths[0])?, Results::read(paths[1])?];
    let named =
        |problem: String| Failure::Failed(format!("{} and {}: {problem}", paths[0].display(), paths[1].display()));
    let (size, (w, h)) = (a.size(), b.size());
    if size != (w, h) {
        return Err(named(format!("are of {}x{} and {w}x{h} pixels; solve the same part", size.0, size.1)));
    }
    let mut common: Vec<[Quantity<'_>; 2]> = a.comparable().into_iter().zip(b.comparable()).map(Into::into).collect();
    common.retain(|[a, b]| (a.name, a.unit) == (b.name, b.unit));
    let Some([first, second]) = common.pop() else {
        return Err(named(
            "have nothing in common: one is of a pair, one of a sweep, or their settings have another unit".to_string(),
        ));
    };
    let pairs = first.values.iter().zip(&*second.values).zip(first.deviation.iter().zip(&*second.deviation));
    let pixels: Vec<(f64, f64)> = pairs
        .map(|((a, b), (s, t))| (f64::from(*b) - f64::from(*a), f64::from(*s).hypot(f64::from(*t))))
        .map(|(off, sigma)| {
            if off.is_finite() && sigma.is_finite() && sigma > 0.0 { (off, off / sigma) } else { (f64::NAN, f64::NAN) }
        })
        .collect();
    let compared = Compared {
        quantity: first.label(),
        unit: first.unit,
        settings: differing(&json(&a.report.settings)?, &json(&b.report.settings)?),
        numbers: numbers([&first, &second], [&a.report, &b.report]),
        difference: Difference::of(&pixels),
    };
    if let Some(file) = &arguments.output {
        figure::write_png(arguments.force.to(file), &picture(size.0, size.1, &pixels))?;
    }
    arguments.report.print(&compared.table(paths, arguments.output.as_deref()), &compared)
}

fn json(value: &impl Serialize) -> Result<Value, Failure> {
    serde_json::to_value(value).map_err(|e| Failure::Failed(e.to_string()))
}

fn numbers(quantities: [&Quantity<'_>; 2], reports: [&Report; 2]) -> Vec<(&'static str, [Option<f64>; 2])> {
    let middle = |values: &[f32]| median(values.iter().map(|v| f64::from(*v)));
    let measured = |quantity: &Quantity<'_>| {
        let values = &quantity.values;
        Some(values.iter().filter(|v| v.is_finite()).count() as f64 / values.len().max(1) as f64)
    };
    let mut rows = vec![
        ("median", quantities.map(|quantity| middle(&quantity.values))),
        ("median σ", quantities.map(|quantity| middle(&quantity.deviation))),
        ("measured", quantities.map(measured)),
    ];
    let second = |of: fn(&FrameReport) -> f64| {
        reports.map(|report| report.frames.get(1).filter(|_| report.frames.len() == 2).map(of))
    };
    let more = [
        ("right, px", second(|frame| frame.transform.translation()[0])),
        ("down, px", second(|frame| frame.transform.translation()[1])),
        ("rotation, °", second(|frame| frame.transform.rotation_deg())),
        ("scale", second(|frame| frame.transform.scale())),
        ("gain", second(|frame| frame.photometric.gain)),
        ("smoothness α", reports.map(|report| report.regularization)),
        ("blur rate, px²", reports.map(|report| report.blur_rate_px2)),
        ("time, ms", reports.map(|report| Some(report.timings_ms.total))),
    ];
    rows.extend(more.into_iter().filter(|(_, both)| both.iter().any(Option::is_some)));
    rows
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut known: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    let at = known.len() / 2;
    (!known.is_empty()).then(|| *known.select_nth_unstable_by(at, f64::total_cmp).1)
}

impl Difference {
    fn of(pixels: &[(f64, f64)]) -> Self {
        let known = || pixels.iter().copied().filter(|(off, _)| off.is_finite());
        let count = known().count();
        let mean = |of: &dyn Fn((f64, f64)) -> f64| (count > 0).then(|| known().map(of).sum::<f64>() / count as f64);
        Self {
            pixels: count,
            median: median(known().map(|(off, _)| off)),
            rms: mean(&|(off, _)| off * off).map(f64::sqrt),
            median_sigmas: median(known().map(|(_, sigmas)| sigmas)),
            rms_sigmas: mean(&|(_, sigmas)| sigmas * sigmas).map(f64::sqrt),
            beyond_three_sigmas: mean(&|(_, sigmas)| f64::from(u8::from(sigmas.abs() > 3.0))),
        }
    }
}

impl Compared {
    fn table(&self, paths: [&PathBuf; 2], picture: Option<&Path>) -> String {
        let number =
            |value: &Option<f64>| value.map_or("-".to_string(), |v| format!("{v:.*}", decimals(v.abs() / 100.0)));
        let row = |name: &str, [a, b]: [String; 2]| format!("{name:<16} {a:>16} {b:>16}");
        let mut lines = vec![row("", paths.map(|path| path.display().to_string()))];
        lines.extend(self.settings.iter().map(|(name, both)| row(name, both.each_ref().map(Value::to_string))));
        lines.extend(self.numbers.iter().map(|(name, both)| row(name, both.each_ref().map(number))));
        let Difference { pixels, median, rms, median_sigmas, rms_sigmas, beyond_three_sigmas } = &self.difference;
        let percent = beyond_three_sigmas.map_or("-".to_string(), |share| format!("{:.1}", 100.0 * share));
        lines.push(format!(
            "{}: second less first, median {} {unit}, rms {} {unit}; in σ median {}, rms {}, {percent} % beyond 3; {pixels} px",
            self.quantity,
            number(median),
            number(rms),
            number(median_sigmas),
            number(rms_sigmas),
            unit = self.unit
        ));
        lines.extend(picture.map(|file| format!("picture          {}", file.display())));
        lines.join("\n")
    }
}

fn picture(width: u32, height: u32, pixels: &[(f64, f64)]) -> image::RgbImage {
    image::RgbImage::from_fn(width, height, |x, y| {
        let (_, sigmas) = pixels[y as usize * width as usize + x as usize];
        let color = Palette::RedBlue.color(0.5 - sigmas / (2.0 * ENDS));
        image::Rgb(if sigmas.is_finite() { color } else { [255; 3] })
    })
}
