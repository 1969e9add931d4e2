//! Repeated measurements: `repeat.json`, its tables as CSV, and its page.

use std::io::{self, Write};

use serde::Serialize;

use super::destination::{Destination, REPEAT_FILES};
use super::report::{Header, Kind};
use super::scale::column;
use super::staging::{ListedFiles, Staging};
use crate::base::{Error, Estimate};
use crate::metric::repeat::{GaugeStudy, Interval, Repeatability, RepeatedMaps, TypeOne};
use crate::metric::roughness::Form;

/// The report of repeated measurements.
#[derive(Clone, Debug, Serialize)]
pub struct RepeatReport {
    #[serde(flatten)]
    header: Header,
    /// Version of parfocal that wrote it.
    pub version: &'static str,
    /// The folders of the results, or the table of the study.
    pub results: Vec<String>,
    /// What was measured: `depth`, `relative blur`, `focus`, or `value` of a table.
    pub quantity: String,
    /// Unit of the quantity; empty if it is not stated.
    pub unit: String,
    /// Region of the results: x, y, width, height, px.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub region: Option<[u32; 4]>,
    /// The form that was subtracted from differences of maps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub form: Option<Form>,
    /// The noise of the height maps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub maps: Option<RepeatedMaps>,
    /// Repeated single values: the steps, or those of the table.
    pub values: Vec<ValueReport>,
    /// Repeatability and reproducibility.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gauge: Option<GaugeStudy>,
    /// Warnings; one sentence each.
    pub warnings: Vec<String>,
    #[serde(flatten)]
    listed: Option<ListedFiles>,
}

/// A value that was measured repeatedly.
#[derive(Clone, Debug, Serialize)]
pub struct ValueReport {
    /// Its name: `step 1`, or `value`.
    pub name: String,
    /// The readings, in the order in which they were passed.
    pub readings: Vec<ReadingReport>,
    /// Their scatter, if they are of one part and one operator.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub repeatability: Option<Repeatability>,
    /// The type-1 study, if the true value is stated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub type_one: Option<TypeOne>,
}

/// One reading.
#[derive(Clone, Debug, Serialize)]
pub struct ReadingReport {
    /// The operator; empty if there is only one.
    pub operator: String,
    /// The part; empty if there is only one.
    pub part: String,
    /// The number of the trial of this operator and part, from 1.
    pub trial: usize,
    /// The reading, in the unit of the report.
    pub value: f64,
    /// Its stated standard error. `None` for a value of a table.
    pub standard_error: Option<f64>,
    /// The folder of its results; empty for a value of a table.
    pub results: String,
}

impl RepeatReport {
    /// A report without measurements, of these results.
    pub fn new(results: Vec<String>, quantity: String, unit: String) -> Self {
        Self {
            header: Header::new(Kind::Repeatability),
            version: env!("CARGO_PKG_VERSION"),
            results,
            quantity,
            unit,
            region: None,
            form: None,
            maps: None,
            values: Vec::new(),
            gauge: None,
            warnings: Vec::new(),
            listed: None,
        }
    }

    /// The readings as CSV.
    fn write_readings(&self, writer: &mut dyn Write) -> io::Result<()> {
        let value = self.with_unit("value");
        row(writer, &["name", "operator", "part", "trial", &value, &self.with_unit("standard_error"), "results"])?;
        for of in &self.values {
            for reading in &of.readings {
                let error = reading.standard_error.map_or(String::new(), number);
                let (trial, value) = (reading.trial.to_string(), number(reading.value));
                let cells = [&of.name, &reading.operator, &reading.part, &trial, &value, &error, &reading.results];
                row(writer, &cells)?;
            }
        }
        Ok(())
    }

    /// The scatter of each value, and its type-1 study, as CSV.
    fn write_values(&self, writer: &mut dyn Write) -> io::Result<()> {
        let plain = ["name", "readings"].map(String::from);
        let of_readings = ["mean", "mean_standard_error", "range"].map(|name| self.with_unit(name));
        let stated = ["true_value", "tolerance_width"].map(|name| self.with_unit(name));
        let indices = [with_ends("cg"), with_ends("cgk")].concat();
        let [deviation, bias] =
            ["standard_deviation", "bias"].map(|name| with_ends(name).map(|name| self.with_unit(&name)));
        row(writer, &[&plain[..], &of_readings, &deviation, &stated, &bias, &indices].concat())?;
        for of in &self.values {
            let Some(found) = &of.repeatability else { continue };
            let plain = [of.name.clone(), found.count.to_string()];
            let of_readings = [found.mean, found.mean_standard_error, found.range].map(number);
            let study = of.type_one.as_ref();
            let stated = [study.map(|s| s.true_value), study.map(|s| s.tolerance_width)];
            let stated = stated.map(|v| v.map_or(String::new(), number));
            let bias = ends(study.map(|s| s.bias));
            let [cg, cgk] = [study.and_then(|s| s.cg), study.and_then(|s| s.cgk)].map(ends);
            let deviation = ends(Some(found.standard_deviation));
            row(writer, &[&plain[..], &of_readings, &deviation, &stated, &bias, &cg, &cgk].concat())?;
        }
        Ok(())
    }

    /// The pairs of maps as CSV.
    fn write_pairs(&self, maps: &RepeatedMaps, writer: &mut dyn Write) -> io::Result<()> {
        let [noise, error, shift] = ["noise", "noise_standard_error", "shift"].map(|name| self.with_unit(name));
        let ratio = ["seen_over_stated", "seen_over_stated_standard_error"];
        row(writer, &["first", "second", &noise, &error, &shift, ratio[0], ratio[1]])?;
        for pair in &maps.pairs {
            let [first, second] = [pair.first, pair.second].map(|n| self.results.get(n).cloned().unwrap_or_default());
            let both = |of: Estimate| [of.value, of.standard_error].map(number);
            let (noise, ratio) = (both(pair.noise), both(pair.seen_over_stated));
            row(writer, &[&[first, second][..], &noise, &[number(pair.shift)], &ratio].concat())?;
        }
        Ok(())
    }

    /// The analysis of variance as CSV.
    fn write_anova(&self, gauge: &GaugeStudy, writer: &mut dyn Write) -> io::Result<()> {
        let [sum, square] = ["sum_of_squares", "mean_square"].map(|name| self.with_squared_unit(name));
        row(writer, &["source", "degrees_of_freedom", &sum, &square, "f", "probability"])?;
        for of in &gauge.anova {
            let [f, probability] = [of.f, of.probability].map(|v| v.map_or(String::new(), number));
            let cells = [of.source.to_string(), of.degrees.to_string(), number(of.sum), number(of.mean_square)];
            row(writer, &[&cells[..], &[f, probability]].concat())?;
        }
        Ok(())
    }

    /// The components as CSV.
    fn write_components(&self, gauge: &GaugeStudy, writer: &mut dyn Write) -> io::Result<()> {
        let plain = ["component".to_string(), self.with_squared_unit("variance")];
        let deviation = with_ends("standard_deviation").map(|name| self.with_unit(&name));
        let [contribution, study, tolerance] = ["contribution", "study", "tolerance"].map(|of| {
            let percent = |name: String| column(&name, "percent");
            with_ends(of).map(percent)
        });
        row(writer, &[&plain[..], &deviation, &contribution, &study, &tolerance].concat())?;
        for of in &gauge.components {
            let all = [of.standard_deviation, of.contribution_percent, of.study_percent, of.tolerance_percent];
            let cells = [of.name.to_string(), number(of.variance)];
            row(writer, &cells.into_iter().chain(all.into_iter().flat_map(ends)).collect::<Vec<_>>())?;
        }
        Ok(())
    }

    /// The number of categories as CSV.
    fn write_categories(gauge: &GaugeStudy, writer: &mut dyn Write) -> io::Result<()> {
        row(writer, &with_ends("categories"))?;
        row(writer, &ends(gauge.categories))
    }

    /// The name of a column with its unit, in ASCII.
    fn with_unit(&self, name: &str) -> String {
        column(name, &self.unit)
    }

    /// The name of a column with the square of its unit, in ASCII: `variance_mm2`, `variance_px4`.
    fn with_squared_unit(&self, name: &str) -> String {
        let squared = match self.unit.as_str() {
            "" => String::new(),
            "px²" => "px4".to_string(),
            unit => format!("{unit}2"),
        };
        column(name, &squared)
    }
}

/// The names of the columns of an interval, without their unit.
fn with_ends(name: &str) -> [String; 3] {
    ["", "_low", "_high"].map(|end| format!("{name}{end}"))
}

/// The cells of an interval.
fn ends(of: Option<Interval>) -> [String; 3] {
    of.map_or_else(Default::default, |of| [of.value, of.low, of.high].map(number))
}

/// A number, or nothing if it is not finite.
fn number(value: f64) -> String {
    if value.is_finite() { value.to_string() } else { String::new() }
}

/// Writes a row of CSV (RFC 4180).
fn row(writer: &mut dyn Write, cells: &[impl AsRef<str>]) -> io::Result<()> {
    let quoted = |cell: &str| match cell.contains([',', '"', '\n', '\r']) {
        true => format!("\"{}\"", cell.replace('"', "\"\"")),
        false => cell.to_string(),
    };
    let cells: Vec<String> = cells.iter().map(|cell| quoted(cell.as_ref())).collect();
    writeln!(writer, "{}", cells.join(","))
}

/// Writes report, tables and page into a folder: all or none. Creates the folder if it is missing. Replaces the files
/// of an earlier report of repeated measurements. Any other file stays; if it has the name of a result, nothing is
/// written unless the [`Destination`] forces it.
///
/// # Errors
/// [`Error::File`].
pub fn write_repeat<'d>(out: impl Into<Destination<'d>>, report: &RepeatReport, page: &str) -> Result<(), Error> {
    let [json, html, readings, values, pairs, anova, components, categories] = REPEAT_FILES;
    let mut staging = Staging::replacing(out.into(), json)?;
    let text = |e: io::Error| e.to_string();
    staging.add(html, |w| w.write_all(page.as_bytes()).map_err(text))?;
    if !report.values.is_empty() {
        staging.add(readings, |w| report.write_readings(w).map_err(text))?;
    }
    if report.values.iter().any(|value| value.repeatability.is_some()) {
        staging.add(values, |w| report.write_values(w).map_err(text))?;
    }
    if let Some(maps) = &report.maps {
        staging.add(pairs, |w| report.write_pairs(maps, w).map_err(text))?;
    }
    if let Some(found) = &report.gauge {
        staging.add(anova, |w| report.write_anova(found, w).map_err(text))?;
        staging.add(components, |w| report.write_components(found, w).map_err(text))?;
        staging.add(categories, |w| RepeatReport::write_categories(found, w).map_err(text))?;
    }
    staging.place_with_report(json, |listed| RepeatReport { listed: Some(listed), ..report.clone() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_of_squares_state_the_square_of_the_unit() {
        let name =
            |unit: &str| RepeatReport::new(Vec::new(), String::new(), unit.to_string()).with_squared_unit("variance");
        assert_eq!(
            ["", "mm", "px²", "1/m", "settings"].map(name),
            ["variance", "variance_mm2", "variance_px4", "variance_per_m2", "variance_settings2"]
        );
    }

    #[test]
    fn cells_with_commas_and_quotes_are_quoted() {
        let mut written = Vec::new();
        row(&mut written, &["a,b", "say \"x\"", "c", ""]).unwrap();
        assert_eq!(String::from_utf8(written).unwrap(), "\"a,b\",\"say \"\"x\"\"\",c,\n");
    }
}
