//! `parfocal roughness`: areal and profile parameters of the surface texture of results.

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::ValueEnum;
use clap::builder::PossibleValue;
use parfocal::export::{Kind, Quantity, Results};
use parfocal::metric::measure::Line;
use parfocal::metric::roughness::{Area, Dimension, Evaluation, Form, Parameter, Roughness, roughness};
use parfocal::{Error, Mask, Region, image_io};
use serde::Serialize;

use crate::cli::help::{MEASUREMENTS, REGION};
use crate::cli::options::part::{PixelSizeArgument, check_size, line, region, within};
use crate::cli::options::run::ReportArguments;
use crate::cli::output::failure::Failure;
use crate::cli::output::numbers::{decimals, signed};

/// Measure the roughness of results: areal parameters of ISO 25178-2, profile parameters of ISO 21920-2.
#[derive(clap::Args, Debug)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Arguments {
    /// Folder that `parfocal solve -o` or `stack -o` wrote
    results: PathBuf,
    /// The form that is removed
    #[arg(long, value_name = "FORM", help_heading = MEASUREMENTS, value_enum, default_value_t)]
    form: Form,
    /// Cutoff wavelength of the S-filter, which removes shorter waves: px, or µm if the pixel size is
    /// known [default: none]
    #[arg(long, value_name = "LENGTH", help_heading = MEASUREMENTS, value_parser = length)]
    s_filter: Option<f64>,
    /// Cutoff wavelength of the L-filter, which removes longer waves: px, or µm if the pixel size is
    /// known [default: none]
    #[arg(long, value_name = "LENGTH", help_heading = MEASUREMENTS, value_parser = length)]
    l_filter: Option<f64>,
    /// Take the robust L-filter, which scratches and peaks do not move
    #[arg(long, help_heading = MEASUREMENTS, requires = "l_filter")]
    robust: bool,
    /// Evaluate Ra, Rq and Rz along this line instead of the rows; WIDTH as in --profile of measure
    #[arg(long, value_name = "X1,Y1,X2,Y2[,WIDTH]", help_heading = MEASUREMENTS, value_parser = line)]
    line: Option<Line>,
    #[command(flatten)]
    pixel: PixelSizeArgument,
    /// Realizations of noise from which the standard deviations follow, 2 to 10000
    #[arg(long, value_name = "COUNT", help_heading = MEASUREMENTS, default_value_t = 20,
          value_parser = within(2usize..=10_000, "give a number from 2 to 10000"))]
    realizations: usize,
    /// Standard deviation of the window over which a solve averages noise, px, 0 to 100 [default: 4 for a pair, 2 for a
    /// sweep]
    #[arg(long, value_name = "PX", help_heading = MEASUREMENTS,
          value_parser = within(0.0..=100.0, "give a number of px from 0 to 100"))]
    noise_window: Option<f64>,
    /// Region of the results, px; nothing outside is used
    #[arg(long, value_name = "X,Y,W,H", help_heading = REGION, value_parser = region)]
    roi: Option<Region>,
    /// Picture of the size of the results, white where pixels count
    #[arg(long, value_name = "FILE", help_heading = REGION)]
    mask: Option<PathBuf>,
    #[command(flatten)]
    report: ReportArguments,
}

const AFTER_HELP: &str = "\
Heights are depth in mm where it is known, else V in px², or the focus of a sweep in its unit. They are positive
towards the camera. The form is removed first, then the S-filter and the L-filter are applied (Gaussian, ISO 16610-61;
with --robust ISO 16610-71 of order 0; along profiles ISO 16610-21). Missing pixels are not filled in: filters weight
the measured pixels, and parameters are over measured pixels. The size of a pixel is that of the results unless
--pixel-size states another. Sdr needs it, and heights in mm. Parameters of heights in mm are in µm. Sal and Str are at
the autocorrelation 0.2.

Each ± is a standard deviation. \"noise\" is the scatter of the parameter when noise with the standard deviations of the
results is added, in seeded realizations. \"scale\" is the part by the scale of V of a pair, which is the same everywhere.
\"noise adds\" is how much the mean of the realizations is above the parameter; it is not subtracted.

Examples:
  parfocal roughness out --form plane --s-filter 10 --l-filter 100
  parfocal roughness out --pixel-size 4.5 --s-filter 45 --l-filter 450 --roi 40,60,320,200 --json

Exit status: 0 done, 1 failed, 2 wrong usage.";

fn length(text: &str) -> Result<f64, String> {
    within(1e-6..=1e6, "give a length above 0, up to 1e6")(text)
}

/// Standard deviations of the Gaussian windows over which the noise of a pair and of a sweep is averaged, px: N of the
/// standard deviations of V and of the focus is 4π times their square.
const PAIR_WINDOW: f64 = 4.0;
const SWEEP_WINDOW: f64 = 2.0;

#[derive(Serialize)]
struct RoughnessReport {
    results: String,
    quantity: String,
    unit: &'static str,
    lateral_unit: &'static str,
    pixel_size_um: Option<f64>,
    region: [u32; 4],
    mask: Option<PathBuf>,
    #[serde(flatten)]
    evaluation: Evaluation,
    scale_deviation: Option<f64>,
    area_px: usize,
    measured_px: usize,
    missing_fraction: f64,
    profiles: usize,
    sections: usize,
    str_is_upper_bound: bool,
    parameters: Vec<ParameterReport>,
    warnings: Vec<String>,
}

/// A parameter in its unit. What is not determined is null.
#[derive(Serialize)]
struct ParameterReport {
    name: &'static str,
    unit: String,
    value: f64,
    standard_deviation: f64,
    by_noise: f64,
    by_scale: Option<f64>,
    noise_bias: f64,
}

/// Reads, evaluates and prints.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let results = Results::read(&arguments.results)?;
    let size: [u32; 2] = results.report.size.into();
    let region = arguments.roi.unwrap_or(Region { x: 0, y: 0, width: size[0], height: size[1] });
    let mask = arguments.mask.as_ref().map(|file| image_io::read(file)).transpose()?;
    let mask = mask.as_ref().map(Mask::from_image);
    check_size(arguments.mask.as_deref(), mask.as_ref().map(Mask::size), size, "results")?;
    // Depth is last, if it is known.
    let measured = results.measured().pop();
    let (Some(measured), Some(quantity)) = (measured, results.comparable().pop()) else {
        return Err(Failure::file(&arguments.results, "has no heights; solve again"));
    };
    let common = results.by_scale(&measured);
    let pixel = arguments.pixel.pixel_size.or(results.report.pixel_size_um);
    let evaluation = arguments.evaluation(&results, quantity.unit, pixel);
    evaluation.check(region, size).map_err(|e| usage(&e))?;
    let heights = quantity.heights(size)?;
    let area = Area { region, mask: mask.as_ref() };
    let found = roughness(&heights, common.as_deref(), &area, &evaluation).map_err(|e| usage(&e))?;
    let report = arguments.report(&results, &quantity, (region, pixel), evaluation, &found);
    arguments.report.print(&report.summary(), &report)
}

/// What the options and the results do not allow is wrong usage.
fn usage(error: &Error) -> Failure {
    Failure::Usage(error.to_string())
}

impl Arguments {
    /// How the surface is evaluated. `pixel` is the size of a pixel, µm.
    fn evaluation(&self, results: &Results<'_>, unit: &str, pixel: Option<f64>) -> Evaluation {
        let in_px = |length: f64| length / pixel.unwrap_or(1.0);
        let window = if results.report.kind == Kind::Sweep { SWEEP_WINDOW } else { PAIR_WINDOW };
        Evaluation {
            form: self.form,
            s_filter_px: self.s_filter.map(in_px),
            l_filter_px: self.l_filter.map(in_px),
            robust: self.robust,
            line: self.line,
            realizations: self.realizations,
            noise_window_px: self.noise_window.unwrap_or(window),
            pixel_size: pixel.filter(|_| unit == "mm").map(|um| um / 1000.0),
        }
    }

    fn report(
        &self,
        results: &Results<'_>,
        quantity: &Quantity<'_>,
        (region, pixel): (Region, Option<f64>),
        evaluation: Evaluation,
        found: &Roughness,
    ) -> RoughnessReport {
        let lateral = if pixel.is_some() { "µm" } else { "px" };
        let is_slope = evaluation.pixel_size.is_some();
        // Surface texture is stated in µm, as in ISO 25178.
        let (height, of_height) = if quantity.unit == "mm" { ("µm", 1000.0) } else { (quantity.unit, 1.0) };
        let parameter = |found: &Parameter| {
            let (unit, factor) = match found.dimension {
                Dimension::Height => (height.to_string(), of_height),
                Dimension::Number => (String::new(), 1.0),
                Dimension::Percent => ("%".to_string(), 1.0),
                Dimension::Length => (lateral.to_string(), pixel.unwrap_or(1.0)),
                Dimension::Gradient if is_slope => (String::new(), 1.0),
                Dimension::Gradient => (gradient(height, lateral), of_height / pixel.unwrap_or(1.0)),
            };
            ParameterReport {
                name: found.name,
                unit,
                value: factor * found.value,
                standard_deviation: factor * found.standard_deviation,
                by_noise: factor * found.by_noise,
                by_scale: found.by_scale.map(|part| factor * part),
                noise_bias: factor * found.noise_bias,
            }
        };
        let missing = 1.0 - found.measured_px as f64 / found.area_px.max(1) as f64;
        RoughnessReport {
            results: self.results.display().to_string(),
            quantity: quantity.label(),
            unit: quantity.unit,
            lateral_unit: lateral,
            pixel_size_um: pixel,
            region: region.into(),
            mask: self.mask.clone(),
            evaluation,
            scale_deviation: results.report.scale_deviation,
            area_px: found.area_px,
            measured_px: found.measured_px,
            missing_fraction: missing,
            profiles: found.profiles,
            sections: found.sections,
            str_is_upper_bound: found.is_str_bound,
            parameters: found.parameters.iter().map(parameter).collect(),
            warnings: warnings(results, found),
        }
    }
}

fn gradient(unit: &str, lateral: &str) -> String {
    if unit.contains('/') { format!("({unit})/{lateral}") } else { format!("{unit}/{lateral}") }
}

/// Why the parameters should not be believed, if there is a reason.
fn warnings(results: &Results<'_>, found: &Roughness) -> Vec<String> {
    let unsettled = "the solve had not converged: its heights, and so the parameters, may be wrong".to_string();
    let by_name: BTreeMap<&str, &Parameter> = found.parameters.iter().map(|p| (p.name, p)).collect();
    // Of a surface without relief noise adds 41 % to Sq, since its own noise counts once more.
    let is_noise = by_name.get("Sq").is_some_and(|sq| sq.noise_bias > MOST_NOISE * sq.value);
    let noise =
        "noise makes a large part of the heights: the parameters describe it rather than the surface".to_string();
    let unsettled = (results.report.converged == Some(false)).then_some(unsettled);
    unsettled.into_iter().chain(is_noise.then_some(noise)).collect()
}

/// The share of Sq that noise may add without a warning: half of the variance is then noise.
const MOST_NOISE: f64 = 0.22;

impl RoughnessReport {
    fn summary(&self) -> String {
        let (evaluation, [.., width, height]) = (&self.evaluation, self.region);
        let filter = |cutoff: Option<f64>| match cutoff {
            Some(px) => format!("{} {}", rounded(px * self.pixel_size_um.unwrap_or(1.0)), self.lateral_unit),
            None => "none".to_string(),
        };
        let robust = if evaluation.robust { ", robust" } else { "" };
        let form = evaluation.form.to_possible_value();
        let mut lines = vec![
            format!("heights        {} in {}, positive towards the camera", self.quantity, self.unit),
            format!(
                "area           {width}x{height} px, {:.1} % of {} px missing",
                100.0 * self.missing_fraction,
                self.area_px
            ),
            format!("form           {}", form.as_ref().map_or("", PossibleValue::get_name)),
            format!(
                "filters        S {}, L {}{robust}",
                filter(evaluation.s_filter_px),
                filter(evaluation.l_filter_px)
            ),
        ];
        lines.extend(self.parameters.iter().map(|parameter| self.line(parameter)));
        let of = if evaluation.line.is_some() { "line" } else { "rows" };
        lines.push(format!("profiles       {} {of}, {} section lengths each", self.profiles, self.sections));
        lines.push(format!(
            "noise          {} realizations, window of {} px",
            evaluation.realizations, evaluation.noise_window_px
        ));
        lines.extend(self.warnings.iter().map(|warning| format!("warning        {warning}")));
        lines.join("\n")
    }

    /// A parameter with its standard deviation, its parts, and what noise adds.
    fn line(&self, parameter: &ParameterReport) -> String {
        let (name, value, unit) = (parameter.name, parameter.value, &parameter.unit);
        if !value.is_finite() {
            let reason = match name {
                "Sdr" => "not defined without heights in mm and a pixel size; give --pixel-size",
                "Sal" | "Str" => "not determined: heights are alike over the whole area",
                "Ra" | "Rq" | "Rz" => "not determined: no row is measured to at least half; give --line",
                _ => "not determined",
            };
            return format!("{name:<14} {reason}");
        }
        let digits = decimals(parameter.standard_deviation);
        let number = |v: f64| format!("{v:.digits$}");
        let scale = parameter.by_scale.map_or_else(String::new, |part| format!(", scale {}", number(part)));
        let bound = if name == "Str" && self.str_is_upper_bound { "at most " } else { "" };
        let space = if unit.is_empty() { "" } else { " " };
        let value = if name == "Ssk" { signed(value, digits) } else { number(value) };
        format!(
            "{name:<14} {bound}{value} ± {}{space}{unit} (noise {}{scale}; noise adds {})",
            number(parameter.standard_deviation),
            number(parameter.by_noise),
            signed(parameter.noise_bias, digits)
        )
    }
}

/// A length without digits that rounding adds.
fn rounded(value: f64) -> String {
    format!("{}", (1e6 * value).round() / 1e6)
}
