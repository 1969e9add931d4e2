//! `parfocal compare`: two results of one scene, side by side.

use std::path::{Path, PathBuf};

use parfocal::export::{FileKind, Palette, Solved, SolvedSweep, holds_sweep};
use parfocal::page::figure;
use serde::Serialize;
use serde_json::Value;

use crate::cli::commands::depth::decimals;
use crate::cli::options::output_options::ToldArguments;
use crate::cli::output::destination::{self, ForceArgument};
use crate::cli::output::failure::Failure;

/// Compare two results of one scene: settings, numbers, and where they differ, in units of their standard deviation.
#[derive(clap::Args, Debug)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Arguments {
    /// Folder that `parfocal solve -o` or `stack -o` wrote
    first: PathBuf,
    /// Another, of the same pixels
    second: PathBuf,
    /// Also write where they differ as a picture, PNG: from -5 (second nearer) to 5 standard deviations, white where not in both
    #[arg(short, long, value_name = "FILE.png")]
    output: Option<PathBuf>,
    #[command(flatten)]
    told: ToldArguments,
    #[command(flatten)]
    force: ForceArgument,
}

const AFTER_HELP: &str = "\
Depth in mm is compared where both have it, else V, or focus. The difference at a pixel is the second less the first, over the root of
the sum of both variances: were nothing but noise between them, two in three lay within 1.

Exit status: 0 done, 1 failed, 2 wrong usage.";

/// Standard deviations at the ends of the picture's colours.
const ENDS: f64 = 5.0;

/// What is compared of a folder.
struct Side {
    width: u32,
    height: u32,
    /// What there is, the best last: name, unit, values, standard deviations.
    fields: Vec<(&'static str, &'static str, Vec<f32>, Vec<f32>)>,
    report: Value,
}

/// What came out.
#[derive(Serialize)]
struct Compared {
    quantity: &'static str,
    unit: &'static str,
    /// Those that are not the same in both, by their names.
    settings: Vec<(String, [Value; 2])>,
    numbers: Vec<(&'static str, [Option<f64>; 2])>,
    difference: Difference,
}

/// Second less first.
#[derive(Serialize)]
struct Difference {
    /// Pixels that both measured.
    pixels: usize,
    median: Option<f64>,
    /// Root mean square.
    rms: Option<f64>,
    /// In standard deviations.
    median_sigmas: Option<f64>,
    rms_sigmas: Option<f64>,
    /// Share of those pixels beyond three standard deviations.
    beyond_three_sigmas: Option<f64>,
}

/// Reads, compares, tells.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let paths = [&arguments.first, &arguments.second];
    if let Some(file) = &arguments.output {
        destination::check_file(arguments.force.to(file), FileKind::Png, " for the picture", &[])?;
    }
    let [a, b] = [Side::read(paths[0])?, Side::read(paths[1])?];
    let named =
        |problem: String| Failure::Failed(format!("{} and {}: {problem}", paths[0].display(), paths[1].display()));
    if (a.width, a.height) != (b.width, b.height) {
        let problem =
            format!("are of {}x{} and {}x{} pixels; solve the same part", a.width, a.height, b.width, b.height);
        return Err(named(problem));
    }
    let common =
        |(name, unit, ..): &&(&str, &str, Vec<f32>, Vec<f32>)| b.fields.iter().any(|f| (f.0, f.1) == (*name, *unit));
    let Some((quantity, unit, first, first_sigma)) = a.fields.iter().rev().find(common) else {
        return Err(named(
            "have nothing in common: one is of a pair, one of a sweep, or their settings have another unit".to_string(),
        ));
    };
    let other = b.fields.iter().find(|field| field.0 == *quantity);
    let (second, second_sigma) = other.map(|(.., values, sigma)| (values, sigma)).unwrap_or((first, first_sigma));
    let pairs = first.iter().zip(second).zip(first_sigma.iter().zip(second_sigma));
    let pixels: Vec<(f64, f64)> = pairs
        .map(|((a, b), (s, t))| (f64::from(*b) - f64::from(*a), f64::from(*s).hypot(f64::from(*t))))
        .map(|(off, sigma)| {
            if off.is_finite() && sigma.is_finite() && sigma > 0.0 { (off, off / sigma) } else { (f64::NAN, f64::NAN) }
        })
        .collect();
    let compared = Compared {
        quantity,
        unit,
        settings: differing(&a.report["settings"], &b.report["settings"]),
        numbers: numbers([&a, &b], quantity),
        difference: Difference::of(&pixels),
    };
    if let Some(file) = &arguments.output {
        figure::write_png(arguments.force.to(file), &picture(a.width, a.height, &pixels))?;
    }
    arguments.told.tell(&compared.table(paths, arguments.output.as_deref()), || serde_json::to_string_pretty(&compared))
}

impl Side {
    fn read(folder: &Path) -> Result<Self, Failure> {
        if holds_sweep(folder)? {
            let solved = SolvedSweep::read(folder)?;
            let (report, sweep) = (solved.report().clone(), solved.sweep);
            let mut fields = vec![("focus", sweep.unit, sweep.focus, sweep.uncertainty)];
            fields.extend(sweep.depth.map(|found| ("depth", "mm", found.depth, found.deviation)));
            return Ok(Self { width: sweep.width, height: sweep.height, fields, report });
        }
        let solved = Solved::read(folder)?.as_stated()?;
        let (blur, metric) = (solved.measured_blur(), solved.measured_depth());
        let mut fields = vec![("relative blur", "px²", blur, solved.uncertainty.clone())];
        fields.extend(metric.map(|metric| ("depth", "mm", metric.depth, metric.deviation)));
        Ok(Self { width: solved.width, height: solved.height, fields, report: solved.report().clone() })
    }
}

/// Settings by their names, those within others too, that are not the same.
fn differing(a: &Value, b: &Value) -> Vec<(String, [Value; 2])> {
    let keys = |value: &Value| value.as_object().map(|map| map.keys().cloned().collect::<Vec<_>>()).unwrap_or_default();
    let mut names = keys(a);
    names.extend(keys(b).into_iter().filter(|key| a.get(key).is_none()));
    let of = |name: String| match (&a[&name], &b[&name]) {
        (x, y) if x == y => Vec::new(),
        (x, y) if x.is_object() && y.is_object() => {
            differing(x, y).into_iter().map(|(inner, both)| (format!("{name}.{inner}"), both)).collect()
        }
        (x, y) => vec![(name, [x.clone(), y.clone()])],
    };
    names.into_iter().flat_map(of).collect()
}

fn numbers(sides: [&Side; 2], quantity: &str) -> Vec<(&'static str, [Option<f64>; 2])> {
    let field = |side: &Side, deviation: bool| {
        side.fields.iter().find(|field| field.0 == quantity).map(|f| if deviation { f.3.clone() } else { f.2.clone() })
    };
    let share = |side: &Side| {
        field(side, false).map(|v| v.iter().filter(|v| v.is_finite()).count() as f64 / v.len().max(1) as f64)
    };
    let middle = |side: &Side, deviation| field(side, deviation).and_then(|v| median(v.into_iter().map(f64::from)));
    let told = |path: &'static str| sides.map(|side| side.report.pointer(path).and_then(Value::as_f64));
    let mut rows = vec![
        ("median", sides.map(|side| middle(side, false))),
        ("median σ", sides.map(|side| middle(side, true))),
        ("measured", sides.map(share)),
    ];
    let more = [
        ("right, px", "/transform/tx_px"),
        ("down, px", "/transform/ty_px"),
        ("rotation, °", "/transform/rotation_deg"),
        ("scale", "/transform/scale"),
        ("gain", "/photometric/gain"),
        ("smoothness α", "/regularization"),
        ("blur rate, px²", "/blur_rate_px2"),
        ("time, ms", "/timings_ms/total"),
        ("time, ms", "/total_ms"),
    ];
    rows.extend(
        more.map(|(name, path)| (name, told(path))).into_iter().filter(|(_, both)| both.iter().any(Option::is_some)),
    );
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
