//! The page of repeated measurements: noise of maps, readings, gauge R&R.

use std::fmt::Write;

use image::RgbImage;

use super::batch_html::{document, text};
use super::figure::{Axis, Plot, Series};
use super::report_html::jpeg;
use crate::base::Estimate;
use crate::files::export::{RepeatReport, ValueReport};
use crate::metric::repeat::{BINS, GaugeStudy, HISTOGRAM_END, Interval, RepeatedMaps};

/// Size of a plot, px, and the quality of its JPEG.
const PLOT: (u32, u32) = (640, 400);
const QUALITY: u8 = 92;

/// Writes the page. It needs no other file.
///
/// # Errors
/// A phrase, if a plot cannot be encoded.
pub fn repeat_page(report: &RepeatReport) -> Result<String, String> {
    let mut page = Page::default();
    if let Some(maps) = &report.maps {
        page.maps(report, maps)?;
    }
    for value in &report.values {
        page.readings(report, value)?;
    }
    if let Some(gauge) = &report.gauge {
        page.gauge(report, gauge);
    }
    let warnings: String =
        report.warnings.iter().map(|warning| format!("<p class=\"warning\">{}</p>", text(warning))).collect();
    let results: String = report.results.iter().map(|name| format!("<p class=\"fact\">{}</p>", text(name))).collect();
    let unit = if report.unit.is_empty() { String::new() } else { format!(", {}", text(&report.unit)) };
    let header = format!("<h1>Repeated measurements: {}{unit}</h1>{warnings}", text(&report.quantity));
    let main = format!("{}<section><h2>Measured</h2>{results}</section>\n", page.0);
    Ok(document("parfocal repeat", "Repeated measurements – parfocal", OWN_STYLE, &header, &main))
}

/// The sections so far.
#[derive(Default)]
struct Page(String);

impl Page {
    fn section(&mut self, title: &str, content: &str) {
        // Writing into a string does not fail.
        let _ = writeln!(self.0, "<section><h2>{}</h2>{content}</section>", text(title));
    }

    fn maps(&mut self, report: &RepeatReport, maps: &RepeatedMaps) -> Result<(), String> {
        let unit = &report.unit;
        let [middle, least, most] = maps.pair_noise.map(|v| short(v, v));
        let shift = maps.shift_deviation;
        let percent = |n: usize| {
            let share = maps.within[n];
            let error = error(100.0 * share.standard_error, 1);
            format!("{:.1} ± {error} %", 100.0 * share.value)
        };
        let rows = [
            ("measured by all", format!("{} of {} px", maps.measured_px, maps.area_px)),
            ("measurement noise (ISO 25178-700)", format!("{} {unit}", estimate(maps.noise))),
            ("of a pair of maps: median, least to greatest", format!("{middle}, {least} to {most} {unit}")),
            (
                "repeatability limit: 95 of 100 differences of two measurements are below, apart from a shift",
                format!("{} {unit}", estimate(maps.repeatability_limit)),
            ),
            ("standard deviation of the mean height between maps", format!("{} {unit}", interval(shift))),
            ("stated standard deviation, root mean square", format!("{} {unit}", short(maps.stated, maps.stated))),
            (
                "seen over stated: 1 if what is stated is right",
                format!("{:.3} ± {}", maps.seen_over_stated.value, error(maps.seen_over_stated.standard_error, 3)),
            ),
            ("differences within 1 stated standard deviation (Gaussian: 68.3 %)", percent(0)),
            ("differences within 2 (Gaussian: 95.4 %)", percent(1)),
        ];
        let centre = |n: usize| HISTOGRAM_END * (2.0 * (n as f64 + 0.5) / BINS as f64 - 1.0);
        let width = 2.0 * HISTOGRAM_END / BINS as f64;
        let seen = (0..maps.histogram.len()).map(|n| (centre(n), maps.histogram[n] / width));
        let gaussian = (0..161).map(|n| HISTOGRAM_END * (f64::from(n) / 80.0 - 1.0)).map(|z| (z, density(z)));
        let axes = (Axis::linear("difference, stated standard deviations"), Axis::linear("density"));
        let plot = Plot::new("Differences of two maps", axes.0, axes.1)
            .series(Series::new("seen", seen))
            .series(Series::new("as stated", gaussian).unmarked());
        let content = format!("{}{}", table(&rows), picture(&plot, "Histogram of differences of two maps")?);
        self.section("Height maps", &content);
        Ok(())
    }

    fn readings(&mut self, report: &RepeatReport, value: &ValueReport) -> Result<(), String> {
        let unit = &report.unit;
        let mut rows = Vec::new();
        if let Some(found) = &value.repeatability {
            let s = found.standard_deviation;
            rows.push(("readings", found.count.to_string()));
            let error = short(found.mean_standard_error, s.value);
            rows.push(("mean", format!("{} ± {error} {unit}", short(found.mean, s.value))));
            rows.push(("repeatability, standard deviation (95 % interval)", format!("{} {unit}", interval(s))));
            rows.push(("range", format!("{} {unit}", short(found.range, s.value))));
        }
        if let Some(study) = &value.type_one {
            let scale = study.bias.high - study.bias.low;
            let stated = format!("{}, {} {unit}", study.true_value, study.tolerance_width);
            rows.push(("true value, width of the tolerance", stated));
            let [bias, low, high] = [study.bias.value, study.bias.low, study.bias.high].map(|v| short(v, scale));
            rows.push(("bias (95 % interval)", format!("{bias} ({low} to {high}) {unit}")));
            rows.push(("Cg = 0.2 T / 6 s", optional(study.cg, "not determined: all readings are equal")));
            rows.push(("Cgk = (0.1 T - |bias|) / 3 s", optional(study.cgk, "not determined: all readings are equal")));
        }
        let plot = if value.repeatability.is_some() { in_order(value, unit) } else { by_part(value, unit) };
        let content = format!("{}{}", table(&rows), picture(&plot, "Readings")?);
        self.section(&value.name, &content);
        Ok(())
    }

    fn gauge(&mut self, report: &RepeatReport, gauge: &GaugeStudy) {
        let units = match report.unit.as_str() {
            "" => String::new(),
            "px²" => " Standard deviations are in px², squares in px⁴.".to_string(),
            unit => format!(" Standard deviations are in {0}, squares in ({0})².", text(unit)),
        };
        let mut content = format!(
            "<p>{} operators, {} parts, {} trials. Intervals are of 95 %.{units}</p>",
            gauge.operators, gauge.parts, gauge.trials
        );
        let head = ["", "standard deviation", "% contribution", "% study variation", "% tolerance"];
        let has_tolerance = gauge.components.iter().any(|of| of.tolerance_percent.is_some());
        let columns = if has_tolerance { 4 } else { 3 };
        content += "<table><tr>";
        head[..=columns].iter().for_each(|cell| content += &format!("<th>{cell}</th>"));
        content += "</tr>";
        for of in &gauge.components {
            let cells = [of.standard_deviation, of.contribution_percent, of.study_percent, of.tolerance_percent];
            // An interaction that counts as repeatability has no components.
            let otherwise = if of.standard_deviation.is_none() { "pooled" } else { "not determined" };
            let cell = |cell: &Option<Interval>| format!("<td>{}</td>", optional(*cell, otherwise));
            let cells: String = cells[..columns].iter().map(cell).collect();
            content += &format!("<tr><th>{}</th>{cells}</tr>", text(of.name));
        }
        content += "</table><table><tr><th></th><th>df</th><th>sum of squares</th><th>mean square</th><th>F</th>\
                    <th>by chance</th></tr>";
        for row in &gauge.anova {
            let f = row.f.map_or(String::new(), |f| format!("{f:.3}"));
            let by_chance = |p: f64| if p < 1e-4 { "below 0.0001".to_string() } else { format!("{p:.4}") };
            let probability = row.probability.map_or(String::new(), by_chance);
            content += &format!(
                "<tr><th>{}</th><td>{}</td><td>{:.6}</td><td>{:.6}</td><td>{f}</td><td>{probability}</td></tr>",
                row.source, row.degrees, row.sum, row.mean_square
            );
        }
        let pooled = match gauge.is_interaction_pooled {
            true => {
                "The interaction is no greater than chance and counts as repeatability. The pooled error is that of F."
            }
            false => "The interaction is greater than chance.",
        };
        let categories = gauge.categories.map_or("not determined: the gauge does not scatter".to_string(), |of| {
            format!("{:.0} (rounded down from 1.41 times parts over gauge: {})", of.value.floor(), interval(of))
        });
        content += &format!("</table><p>{pooled} Distinct categories: {categories}.</p>");
        self.section(&format!("Gauge R&R of {}", report.quantity), &content);
    }
}

/// Readings of one part in their order, with the true value.
fn in_order(value: &ValueReport, unit: &str) -> Plot {
    let points = (1..).zip(&value.readings).map(|(n, reading)| {
        let error = reading.standard_error.unwrap_or(0.0);
        (f64::from(n), [reading.value - error, reading.value, reading.value + error])
    });
    let axes = (Axis::linear("reading"), Axis::linear(label(&value.name, unit)));
    let mut plot = Plot::new("Readings", axes.0, axes.1).series(Series::with_spread("", points));
    if let Some(study) = &value.type_one {
        for (share, name) in [(0.0, "true value"), (0.1, "+10 % of T"), (-0.1, "-10 % of T")] {
            plot = plot.target(study.true_value + share * study.tolerance_width, name);
        }
    }
    plot
}

/// The mean of each operator at each part, with the least and the greatest reading.
fn by_part(value: &ValueReport, unit: &str) -> Plot {
    let mut parts: Vec<&str> = Vec::new();
    let mut operators: Vec<&str> = Vec::new();
    for reading in &value.readings {
        for (names, name) in [(&mut parts, &reading.part), (&mut operators, &reading.operator)] {
            if !names.contains(&name.as_str()) {
                names.push(name);
            }
        }
    }
    let axes = (Axis::linear("part, in the order of the table"), Axis::linear(label(&value.name, unit)));
    let mut plot = Plot::new("Mean and range of each operator", axes.0, axes.1);
    for operator in operators {
        let points = (1..).zip(&parts).filter_map(|(n, part)| {
            let own = value.readings.iter().filter(|r| r.operator == operator && r.part == **part).map(|r| r.value);
            let (low, sum, high, count) = own.fold((f64::INFINITY, 0.0, f64::NEG_INFINITY, 0.0), |of, v| {
                (v.min(of.0), of.1 + v, v.max(of.2), of.3 + 1.0)
            });
            (count > 0.0).then_some((f64::from(n), [low, sum / count, high]))
        });
        plot = plot.series(Series::with_spread(operator, points));
    }
    plot
}

fn label(name: &str, unit: &str) -> String {
    if unit.is_empty() { name.to_string() } else { format!("{name}, {unit}") }
}

/// The density of a standard Gaussian.
fn density(z: f64) -> f64 {
    (-z * z / 2.0).exp() / std::f64::consts::TAU.sqrt()
}

/// A number with three digits of the `scale`.
fn short(value: f64, scale: f64) -> String {
    let digits = if scale.abs() > 0.0 && scale.is_finite() {
        (2.0 - scale.abs().log10().floor()).clamp(0.0, 9.0) as usize
    } else {
        6
    };
    if value.is_finite() { format!("{value:.digits$}") } else { "not measured".to_string() }
}

fn interval(of: Interval) -> String {
    let [value, low, high] = [of.value, of.low, of.high].map(|v| short(v, of.value));
    format!("{value} ({low} to {high})")
}

/// An interval, or why there is none.
fn optional(of: Option<Interval>, otherwise: &str) -> String {
    of.map_or(otherwise.to_string(), interval)
}

/// A value with its standard error.
fn estimate(of: Estimate) -> String {
    format!("{} ± {}", short(of.value, of.value), short(of.standard_error, of.value))
}

/// A standard error with this many digits.
fn error(of: f64, digits: usize) -> String {
    if of.is_finite() { format!("{of:.digits$}") } else { "not measured".to_string() }
}

fn table(rows: &[(&str, String)]) -> String {
    let row = |(name, value): &(&str, String)| format!("<tr><th>{}</th><td>{}</td></tr>", text(name), text(value));
    format!("<table>{}</table>", rows.iter().map(row).collect::<String>())
}

fn picture(plot: &Plot, alternative: &str) -> Result<String, String> {
    let drawn: RgbImage = plot.clone().size(PLOT.0, PLOT.1).draw();
    Ok(format!("<img alt=\"{}\" src=\"data:image/jpeg;base64,{}\">", text(alternative), jpeg(&drawn, QUALITY)?))
}

const OWN_STYLE: &str = "
section { background: var(--panel); border: 1px solid var(--line); border-radius: 10px;
  padding: 4px 16px 14px; margin: 12px 0; }
section img { width: auto; max-width: 100%; height: auto; background: none; }
table { border-collapse: collapse; margin: 8px 0 14px; }
th, td { text-align: left; padding: 3px 14px 3px 0; white-space: nowrap; }
section { overflow-x: auto; }
th { font-weight: 500; color: var(--soft); } td { font-variant-numeric: tabular-nums; }
";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::export::ReadingReport;
    use crate::metric::repeat::{Repeatability, Study, TypeOne};

    #[test]
    fn the_page_shows_all_sections_and_escapes_names() {
        let odd = "<b>&\"".to_string();
        let mut report = RepeatReport::new(vec![odd.clone()], "step".to_string(), "mm".to_string());
        let readings: Vec<f64> = (0..8).map(|n| 1.0 + 0.01 * f64::from(n % 3)).collect();
        let found = Repeatability::of(&readings).unwrap();
        let reading = |(n, value): (usize, &f64)| ReadingReport {
            operator: odd.clone(),
            part: String::new(),
            trial: n + 1,
            value: *value,
            standard_error: Some(0.01),
            results: String::new(),
        };
        report.values.push(ValueReport {
            name: "step 1".to_string(),
            readings: readings.iter().enumerate().map(reading).collect(),
            repeatability: Some(found),
            type_one: Some(TypeOne::new(&found, 1.0, 0.5)),
        });
        let study = Study { operators: 2, parts: 2, trials: 2, readings };
        report.gauge = Some(study.analyse(Some(1.0)).unwrap());
        report.warnings.push("a <warning>".to_string());
        let page = repeat_page(&report).unwrap();
        assert!(!page.contains("<b>") && !page.contains("<warning>") && page.contains("&lt;b&gt;"));
        assert!(page.contains("<td>pooled</td>") && !page.contains("not measured"));
        for part in ["parfocal repeat", "Cgk", "Gauge R&amp;R", "% study variation", "data:image/jpeg;base64,"] {
            assert!(page.contains(part), "{part}");
        }
    }
}
