//! `parfocal repeat`: noise and repeatability of results of one unmoved part, and gauge studies.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use parfocal::export::{
    REPEAT_FILES, REPORT_FILE, ReadingReport, RepeatReport, Results, ValueReport, listed_in, write_repeat,
};
use parfocal::metric::Estimate;
use parfocal::metric::inspect::Heights;
use parfocal::metric::measure::Values;
use parfocal::metric::repeat::{
    GaugeStudy, Interval, LEAST_READINGS, MOST_MAPS, Repeatability, RepeatedMaps, Study, TypeOne, repeated_maps,
};
use parfocal::metric::roughness::{Area, Form};
use parfocal::page::repeat::repeat_page;
use parfocal::{Error, Mask, Region, image_io};

use crate::cli::help::{MEASUREMENTS, OUTPUT, REGION};
use crate::cli::options::part::{check_size, region, within};
use crate::cli::options::run::ReportArguments;
use crate::cli::options::settings::differing;
use crate::cli::options::study_table::{self, Measured, Row};
use crate::cli::output::destination::{self, ForceArgument};
use crate::cli::output::failure::Failure;
use crate::cli::output::numbers::{decimals, signed};

/// Measure how results of one unmoved part repeat: noise by ISO 25178-700, repeatability, type-1 and gauge R&R studies.
#[derive(clap::Args, Debug)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Arguments {
    /// Folders of results of one unmoved part, two or more
    #[arg(required_unless_present = "study")]
    results: Vec<PathBuf>,
    /// Table of a gauge study, CSV with a header: operator, part, and value or results (a folder, with --step)
    #[arg(long, value_name = "FILE.csv", help_heading = MEASUREMENTS,
          conflicts_with_all = ["results", "roi", "mask", "form"])]
    study: Option<PathBuf>,
    /// Step as in measure, second region less first: in mm positive if the second is farther; may be repeated
    #[arg(long, value_names = ["X,Y,W,H", "X,Y,W,H"], num_args = 2, help_heading = MEASUREMENTS,
          value_parser = region)]
    step: Vec<Region>,
    /// The true value of the step, with its sign, or of the table's values, for a type-1 study
    #[arg(long, value_name = "VALUE", help_heading = MEASUREMENTS, requires = "tolerance_width",
          value_parser = within(-1e9..=1e9, "give a number from -1e9 to 1e9"))]
    true_value: Option<f64>,
    /// The width of the tolerance, upper limit less lower limit, in the unit of the value
    #[arg(long, value_name = "WIDTH", help_heading = MEASUREMENTS,
          value_parser = within(1e-9..=1e9, "give a width above 0, up to 1e9"))]
    tolerance_width: Option<f64>,
    /// The form that is subtracted from the differences of maps: none (their mean), plane or quadric
    #[arg(long, value_name = "FORM", help_heading = MEASUREMENTS, value_enum, default_value_t = Form::None)]
    form: Form,
    /// Region of the results, px; noise is over its pixels
    #[arg(long, value_name = "X,Y,W,H", help_heading = REGION, value_parser = region)]
    roi: Option<Region>,
    /// Picture of the size of the results, white where pixels count for the noise
    #[arg(long, value_name = "FILE", help_heading = REGION)]
    mask: Option<PathBuf>,
    /// Folder for the page, the tables and the report
    #[arg(short, long, value_name = "DIR", help_heading = OUTPUT)]
    output: Option<PathBuf>,
    #[command(flatten)]
    report: ReportArguments,
    #[command(flatten)]
    force: ForceArgument,
}

const AFTER_HELP: &str = "\
Photograph one part several times without moving anything, and solve each time with the same settings.

noise      of a height map, over the pixels that all results measure: Sq of the difference of two results over the root
           of 2 (ISO 25178-700), all pairs together. Mean heights, and with --form the tilt, are subtracted first
sigma      the differences seen over the standard deviations that the results state: 1, and 68.3 % and 95.4 % within 1
           and 2, if these are right. They are without the scale of V, which the results have in common
step       mean and standard deviation of each step, second region less first: in mm positive if the second is farther
limit      95 of 100 differences of two measurements of a pixel are below, apart from a shift of the mean height
type 1     with --true-value and --tolerance-width T: Cg = 0.2 T / 6 s, Cgk = (0.1 T - |bias|) / 3 s; use 25 results or
           more
gauge R&R  with --study: operators x parts x trials, crossed analysis of variance (AIAG, MSA, 4th edition)

Numbers in brackets are intervals of 95 %. Folders in a table are relative to the table. A column value may state its
unit, as in value_mm.

Results, with -o, all or none:
  repeat.json                    all numbers
  repeat.html                    what they say, with plots
  repeat_readings.csv            each reading
  repeat_values.csv              mean, standard deviation, Cg and Cgk of each value
  repeat_pairs.csv               the noise of each pair of results
  repeat_anova.csv               analysis of variance
  repeat_components.csv          components of the gauge study
  repeat_categories.csv          number of distinct categories

Examples:
  parfocal repeat shot1 shot2 shot3 --step 40,60,32,32 200,60,32,32 -o repeated
  parfocal repeat shot* --step 40,60,32,32 200,60,32,32 --true-value 0.5 --tolerance-width 0.1
  parfocal repeat --study study.csv --tolerance-width 0.1 -o study

Exit status: 0 done, 1 failed, 2 wrong usage.";

/// Reads, evaluates, writes and prints.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let steps = arguments.step.len() / 2;
    if arguments.true_value.is_some() && steps != 1 && arguments.study.is_none() {
        return Err(Failure::Usage(format!("--true-value is of one step, and there are {steps}: give --step once")));
    }
    if arguments.study.is_none() {
        arguments.check_tolerance()?;
    }
    if let Some(out) = &arguments.output {
        check_output(arguments, out)?;
    }
    let report = match &arguments.study {
        Some(table) => of_table(arguments, table)?,
        None => of_results(arguments)?,
    };
    if let Some(out) = &arguments.output {
        let page = repeat_page(&report).map_err(Failure::Failed)?;
        write_repeat(arguments.force.to(out), &report, &page)?;
    }
    let lines = summary(&report, arguments.output.as_deref());
    arguments.report.print(&lines.join("\n"), &report)
}

/// Refuses a folder that cannot be written.
fn check_output(arguments: &Arguments, out: &Path) -> Result<(), Failure> {
    let of_results = arguments.results.iter();
    let mut inputs: Vec<PathBuf> = of_results
        .flat_map(|folder| listed_in(folder, REPORT_FILE).into_iter().map(|name| folder.join(name)))
        .collect();
    inputs.extend(arguments.study.clone().into_iter().chain(arguments.mask.clone()));
    destination::check(out, REPEAT_FILES[0], &REPEAT_FILES, &inputs.iter().collect::<Vec<_>>())?;
    Ok(arguments.force.to(out).check_results(REPEAT_FILES[0], &REPEAT_FILES)?)
}

/// The ratio of differences to what is stated from which a warning says so.
const MOVED: f64 = 3.0;

/// What the options and the results do not allow is wrong usage.
fn usage(error: &Error) -> Failure {
    Failure::Usage(error.to_string())
}

/// Results that were read, without their fields.
struct Read {
    quantity: String,
    unit: &'static str,
    heights: Option<Heights>,
    /// Value and standard error of each step, without the scale of V.
    steps: Vec<Estimate>,
    settings: serde_json::Value,
    /// What scales the heights: lens, positions, size of a pixel.
    setup: serde_json::Value,
    doubt: Option<String>,
}

impl Arguments {
    /// Refuses the width of a tolerance that no study uses.
    fn check_tolerance(&self) -> Result<(), Failure> {
        if self.tolerance_width.is_some() && self.true_value.is_none() {
            let problem = "--tolerance-width needs --true-value, or the table of several operators and parts";
            return Err(Failure::Usage(problem.to_string()));
        }
        Ok(())
    }

    /// Reads a folder. `with_map` keeps its heights.
    fn read(&self, folder: &Path, with_map: bool) -> Result<Read, Failure> {
        let results = Results::read(folder)?;
        let named = |e: &Error| Failure::Usage(format!("{}: {e}", folder.display()));
        // Depth is last, if it is known.
        let Some(quantity) = results.comparable().pop() else {
            return Err(Failure::file(folder, "has no heights; solve again"));
        };
        let (best, report) = (results.best(), &results.report);
        let values = Values { width: report.size.width, values: &best.values };
        let mut steps = Vec::new();
        // clap passes the values in pairs.
        for (n, pair) in self.step.chunks_exact(2).enumerate() {
            let Some(found) = values.step(pair[0], pair[1]).map_err(|e| named(&e))? else {
                let problem = format!("step {} has too few valid pixels; give other regions", n + 1);
                return Err(Failure::file(folder, problem));
            };
            steps.push(found);
        }
        let positions: Vec<_> = report.frames.iter().map(|frame| [frame.position, frame.focus_mm]).collect();
        let depth = report.depth.as_ref();
        let setup = serde_json::json!({
            "lens": depth.and_then(|depth| depth.lens),
            "stage": depth.and_then(|depth| depth.stage),
            "positions": positions,
            "pixel size": report.pixel_size_um,
        });
        let doubt = || format!("the solve of {} had not converged", folder.display());
        Ok(Read {
            quantity: quantity.label(),
            unit: quantity.unit,
            heights: with_map.then(|| quantity.heights(report.size.into())).transpose()?,
            steps,
            settings: serde_json::to_value(&report.settings).map_err(|e| Failure::Failed(e.to_string()))?,
            setup,
            doubt: (report.converged == Some(false)).then(doubt),
        })
    }
}

/// Checks that results have one quantity, lens, positions and pixel size, and warns where their settings differ.
fn check_alike(all: &[(String, &Read)]) -> Result<Vec<String>, Failure> {
    let Some((first, reference)) = all.first() else { return Ok(Vec::new()) };
    let mut warnings: Vec<String> = all.iter().filter_map(|(_, read)| read.doubt.clone()).collect();
    for (name, read) in all {
        if (&read.quantity, read.unit) != (&reference.quantity, reference.unit) {
            let (found, expected) = (format!("{} in {}", read.quantity, read.unit), reference);
            let problem = format!("has {found}, and {first} has {} in {}", expected.quantity, expected.unit);
            return Err(Failure::Failed(format!("{name}: {problem}; give results of one kind and lens")));
        }
        let names_of = |both: [&serde_json::Value; 2]| -> Vec<String> {
            differing(both[0], both[1]).into_iter().map(|(name, _)| name).collect()
        };
        let others = names_of([&reference.setup, &read.setup]);
        if !others.is_empty() {
            let problem = format!("{name} and {first} differ in {}", others.join(", "));
            return Err(Failure::Failed(format!("{problem}; give results of one lens, stage and pixel size")));
        }
        let names = names_of([&reference.settings, &read.settings]);
        if !names.is_empty() {
            warnings.push(format!("{name} was solved with other settings than {first}: {}", names.join(", ")));
        }
    }
    Ok(warnings)
}

/// Refuses a folder that was given twice.
fn check_once<'a>(folders: impl Iterator<Item = &'a PathBuf>) -> Result<(), Failure> {
    let mut seen = BTreeSet::new();
    for folder in folders {
        if !seen.insert(folder.canonicalize().unwrap_or_else(|_| folder.clone())) {
            return Err(Failure::Usage(format!("{}: was given twice; give each result once", folder.display())));
        }
    }
    Ok(())
}

/// Evaluates results of one part.
fn of_results(arguments: &Arguments) -> Result<RepeatReport, Failure> {
    let folders = &arguments.results;
    if !(2..=MOST_MAPS).contains(&folders.len()) {
        let problem = format!("{} results were given: give 2 to {MOST_MAPS}, of one unmoved part", folders.len());
        return Err(Failure::Usage(problem));
    }
    check_once(folders.iter())?;
    let all = folders.iter().map(|folder| arguments.read(folder, true)).collect::<Result<Vec<_>, _>>()?;
    let names: Vec<String> = folders.iter().map(|folder| folder.display().to_string()).collect();
    let mut warnings = check_alike(&names.iter().cloned().zip(&all).collect::<Vec<_>>())?;
    let maps: Vec<Heights> = all.iter().filter_map(|read| read.heights.clone()).collect();
    let size = [maps[0].width, maps[0].height];
    if let Some((map, name)) = maps.iter().zip(&names).find(|(map, _)| [map.width, map.height] != size) {
        let [found, expected] = [[map.width, map.height], size].map(|[w, h]| format!("{w} x {h} px"));
        let problem = format!("{name} has {found}, and {} has {expected}: different sizes", names[0]);
        return Err(Failure::Usage(format!("{problem}; give results of the same part and region")));
    }
    let region = arguments.roi.unwrap_or(Region { x: 0, y: 0, width: size[0], height: size[1] });
    let mask = arguments.mask.as_ref().map(|file| image_io::read(file)).transpose()?;
    let mask = mask.as_ref().map(Mask::from_image);
    check_size(arguments.mask.as_deref(), mask.as_ref().map(Mask::size), size, "results")?;
    let found = repeated_maps(&maps, &Area { region, mask: mask.as_ref() }, arguments.form).map_err(|e| usage(&e))?;
    let mut report = RepeatReport::new(names.clone(), all[0].quantity.clone(), all[0].unit.to_string());
    warnings.extend((found.seen_over_stated.value > MOVED).then(|| {
        format!(
            "differences are {:.1} times what the results state: the part or the light changed, or a solve failed",
            found.seen_over_stated.value
        )
    }));
    (report.region, report.form, report.maps) = (Some(region.into()), Some(arguments.form), Some(found));
    report.warnings = warnings;
    for n in 0..arguments.step.len() / 2 {
        let readings = (1..).zip(all.iter().zip(&names)).map(|(trial, (read, name))| ReadingReport {
            operator: String::new(),
            part: String::new(),
            trial,
            value: read.steps[n].value,
            standard_error: Some(read.steps[n].standard_error),
            results: name.clone(),
        });
        let value = arguments.value(format!("step {}", n + 1), readings.collect(), &mut report.warnings);
        report.values.push(value);
    }
    Ok(report)
}

impl Arguments {
    /// Readings of one part by one operator.
    fn value(&self, name: String, readings: Vec<ReadingReport>, warnings: &mut Vec<String>) -> ValueReport {
        let values: Vec<f64> = readings.iter().map(|reading| reading.value).collect();
        let repeatability = Repeatability::of(&values);
        let type_one = repeatability.zip(self.true_value).zip(self.tolerance_width);
        let type_one = type_one.map(|((found, true_value), width)| TypeOne::new(&found, true_value, width));
        if type_one.is_some() && values.len() < LEAST_READINGS {
            let few = format!("a type-1 study of {} readings is uncertain; take {LEAST_READINGS}", values.len());
            warnings.push(few);
        }
        ValueReport { name, readings, repeatability, type_one }
    }
}

/// Evaluates the table of a study.
fn of_table(arguments: &Arguments, table: &Path) -> Result<RepeatReport, Failure> {
    let failed = |problem: String| Failure::file(table, problem);
    let (rows, unit) = study_table::read(table)?;
    let (mut read, mut quantity, mut unit) = (Vec::new(), "value".to_string(), unit);
    if rows.iter().any(|row| matches!(row.measured, Measured::Results(_))) {
        if arguments.step.len() != 2 {
            return Err(Failure::Usage("--study with results needs --step once: what is measured in each".to_string()));
        }
        let folders = rows.iter().filter_map(|row| match &row.measured {
            Measured::Results(folder) => Some(folder),
            Measured::Value(_) => None,
        });
        check_once(folders.clone())?;
        for folder in folders {
            read.push((folder.display().to_string(), arguments.read(folder, false)?));
        }
        (quantity, unit) = ("step".to_string(), read[0].1.unit.to_string());
    } else if !arguments.step.is_empty() {
        return Err(Failure::Usage("--step measures results, and the table of --study has values".to_string()));
    }
    let warnings = check_alike(&read.iter().map(|(name, read)| (name.clone(), read)).collect::<Vec<_>>())?;
    let mut trials: BTreeMap<(String, String), usize> = BTreeMap::new();
    let reading = |(n, row): (usize, &Row)| {
        let trial = trials.entry((row.operator.clone(), row.part.clone())).or_default();
        *trial += 1;
        let (value, standard_error, results) = match &row.measured {
            Measured::Value(value) => (*value, None, String::new()),
            Measured::Results(folder) => {
                let step = read[n].1.steps[0];
                (step.value, Some(step.standard_error), folder.display().to_string())
            }
        };
        let (operator, part, trial) = (row.operator.clone(), row.part.clone(), *trial);
        ReadingReport { operator, part, trial, value, standard_error, results }
    };
    let readings: Vec<ReadingReport> = rows.iter().enumerate().map(reading).collect();
    let mut report = RepeatReport::new(vec![table.display().to_string()], quantity.clone(), unit);
    report.warnings = warnings;
    if trials.len() == 1 {
        arguments.check_tolerance()?;
        let value = arguments.value(quantity, readings, &mut report.warnings);
        report.values.push(value);
        return Ok(report);
    }
    if arguments.true_value.is_some() {
        let problem = "--true-value is for repeated readings of one part by one operator, and the table has several";
        return Err(Failure::Usage(problem.to_string()));
    }
    let study = study(&readings).map_err(failed)?;
    report.gauge = Some(study.analyse(arguments.tolerance_width).map_err(|e| failed(e.to_string()))?);
    report.values.push(ValueReport { name: quantity, readings, repeatability: None, type_one: None });
    Ok(report)
}

/// Orders readings by operators, parts and trials. Names what is missing.
fn study(readings: &[ReadingReport]) -> Result<Study, String> {
    let mut cells: BTreeMap<(&str, &str), Vec<f64>> = BTreeMap::new();
    for reading in readings {
        cells.entry((&reading.operator, &reading.part)).or_default().push(reading.value);
    }
    let operators: BTreeSet<&str> = readings.iter().map(|reading| reading.operator.as_str()).collect();
    let parts: BTreeSet<&str> = readings.iter().map(|reading| reading.part.as_str()).collect();
    let trials = cells.values().map(Vec::len).max().unwrap_or(0);
    let mut ordered = Vec::new();
    for (operator, part) in operators.iter().flat_map(|operator| parts.iter().map(move |part| (*operator, *part))) {
        let own = cells.get(&(operator, part)).map_or(&[][..], |own| own);
        if own.len() != trials {
            let found = own.len();
            return Err(format!(
                "operator '{operator}' has {found} readings of part '{part}', and {trials} are needed: each operator \
                 measures each part equally often"
            ));
        }
        ordered.extend_from_slice(own);
    }
    Ok(Study { operators: operators.len(), parts: parts.len(), trials, readings: ordered })
}

/// The lines of the summary.
fn summary(report: &RepeatReport, out: Option<&Path>) -> Vec<String> {
    let unit = &report.unit;
    let mut lines = Vec::new();
    if let Some(maps) = &report.maps {
        lines.push(format!("heights        {} in {unit}, positive towards the camera", report.quantity));
        lines.extend(of_maps(maps, report.results.len(), unit));
    }
    for value in &report.values {
        let of = value.repeatability.iter().flat_map(|found| of_value(&value.name, found, unit));
        lines.extend(of.chain(value.type_one.iter().flat_map(|study| of_type_one(study, unit))));
    }
    lines.extend(report.gauge.iter().flat_map(|gauge| of_gauge(gauge, unit)));
    lines.extend(report.warnings.iter().map(|warning| format!("warning        {warning}")));
    lines.extend(out.map(|out| format!("results        {}", out.display())));
    lines
}

fn of_maps(maps: &RepeatedMaps, count: usize, unit: &str) -> Vec<String> {
    let noise = maps.noise;
    let digits = decimals(noise.standard_error.max(1e-3 * noise.value));
    let number = |v: f64| format!("{v:.digits$}");
    let share = 100.0 * maps.measured_px as f64 / maps.area_px.max(1) as f64;
    let [middle, least, most] = maps.pair_noise.map(number);
    let [one, two] = maps.within.map(|share| format!("{:.1}", 100.0 * share.value));
    let mut lines = vec![
        format!("area           {} px, {share:.1} % measured in all {count} results", maps.area_px),
        format!(
            "noise          {} ± {} {unit} (ISO 25178-700)",
            number(noise.value),
            error(noise.standard_error, digits)
        ),
    ];
    if count > 2 {
        let pairs = maps.pairs.len();
        lines.push(format!("pairs          median {middle}, {least} to {most} {unit}, of {pairs} pairs"));
    }
    lines.push(format!(
        "limit          {} ± {} {unit}: 95 of 100 differences of two measurements of a pixel are below, \
         apart from a shift",
        number(maps.repeatability_limit.value),
        error(maps.repeatability_limit.standard_error, digits)
    ));
    lines.push(format!("shift          {} {unit} between the mean heights", with_ends(maps.shift_deviation)));
    lines.push(format!(
        "sigma          stated {} {unit}; seen over stated {:.2} ± {}; \
         {one} % within 1 (68.3), {two} % within 2 (95.4)",
        number(maps.stated),
        maps.seen_over_stated.value,
        error(maps.seen_over_stated.standard_error, 2)
    ));
    lines
}

/// A standard error with this many digits.
fn error(of: f64, digits: usize) -> String {
    if of.is_finite() { format!("{of:.digits$}") } else { "not measured".to_string() }
}

fn of_value(name: &str, found: &Repeatability, unit: &str) -> Vec<String> {
    let digits = decimals(found.mean_standard_error);
    let mean = format!("{} ± {:.digits$}", signed(found.mean, digits), found.mean_standard_error);
    let s = with_ends(found.standard_deviation);
    let text =
        format!("{mean} {unit}, mean of {}; standard deviation {s}, range {:.digits$}", found.count, found.range);
    vec![format!("{name:<14} {text}")]
}

fn of_type_one(study: &TypeOne, unit: &str) -> Vec<String> {
    let Interval { value, low, high } = study.bias;
    let digits = decimals((high - low) / 4.0);
    let bias = [value, low, high].map(|v| signed(v, digits));
    let index = |of: Option<Interval>| of.map_or("not determined: all readings are equal".to_string(), with_ends);
    vec![
        format!("bias           {} ({} to {}) {unit}", bias[0], bias[1], bias[2]),
        format!("Cg             {}", index(study.cg)),
        format!("Cgk            {}", index(study.cgk)),
    ]
}

fn of_gauge(gauge: &GaugeStudy, unit: &str) -> Vec<String> {
    let GaugeStudy { operators, parts, trials, .. } = gauge;
    let mut lines = vec![format!("gauge R&R      {operators} operators, {parts} parts, {trials} trials")];
    // An interaction that counts as repeatability has none.
    for of in gauge.components.iter().filter(|of| of.standard_deviation.is_some()) {
        let text = |of: Option<Interval>| of.map_or("not determined".to_string(), with_ends);
        let space = if unit.is_empty() { "" } else { " " };
        let tolerance = of.tolerance_percent.map(|of| format!(", {} % of the tolerance", with_ends(of)));
        lines.push(format!(
            "{:<15} {}{space}{unit}, {} % of the study{}",
            of.name,
            text(of.standard_deviation),
            text(of.study_percent),
            tolerance.unwrap_or_default()
        ));
    }
    let probability = gauge.anova[2].probability.map_or("not determined".to_string(), |p| format!("{p:.3}"));
    let pooled = if gauge.is_interaction_pooled { "counts as repeatability" } else { "is a component" };
    lines.push(format!("interaction    {pooled}; by chance with probability {probability}"));
    let categories = gauge.categories.map_or("not determined: the gauge does not scatter".to_string(), |of| {
        format!("{:.0}, rounded down from {}", of.value.floor(), with_ends(of))
    });
    lines.push(format!("categories     {categories}"));
    lines
}

/// A value with its interval, with three digits of the value.
fn with_ends(of: Interval) -> String {
    let digits = decimals(of.value.abs() / 10.0);
    format!("{:.digits$} ({:.digits$} to {:.digits$})", of.value, of.low, of.high)
}
