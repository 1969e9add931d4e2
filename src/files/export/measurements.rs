//! Step heights and profiles: for the report, as CSV and as pictures.

use std::fs;
use std::io::Write;
use std::path::Path;

use png::ColorType;
use serde::Serialize;

use super::image_files::{PROFILE, Pixels, write_png};
use super::report::{Measurements, ProfileReport, StepReport};
use super::results::{NewFile, Plotter, Results};
use super::scale::{Quantity, column};
use crate::base::{Error, Region};
use crate::metric::measure::{Line, Values};

/// Regions and lines to measure.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MeasurementRequest {
    /// Pairs of regions.
    pub steps: Vec<[Region; 2]>,
    /// Lines.
    pub lines: Vec<Line>,
}

impl MeasurementRequest {
    /// Checks every region and line against the size of an image.
    ///
    /// # Errors
    /// [`Error::Region`].
    pub fn check(&self, size: (u32, u32)) -> Result<(), Error> {
        self.steps.iter().flatten().try_for_each(|region| region.check(size))?;
        self.lines.iter().try_for_each(|line| line.check(size))
    }

    /// Names of the files of the profiles.
    pub fn files(&self) -> Vec<String> {
        (0..self.lines.len()).flat_map(|i| [name(i, "csv"), name(i, "png")]).collect()
    }

    /// Whether no region and no line is set.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty() && self.lines.is_empty()
    }

    /// Measures V or focus, and depth where it is known.
    ///
    /// # Errors
    /// As for [`check`](Self::check).
    pub fn measure(&self, results: &Results<'_>) -> Result<Measurements, Error> {
        let (quantity, depth, width) = (results.quantity(), results.depth(), results.report.size.width);
        let step = |quantity: &Quantity<'_>, [from, to]: [Region; 2]| {
            let between = |values| Values { width, values }.step(from, to);
            let mut step = between(&quantity.values)?;
            if let (Some(step), Some(scale)) = (&mut step, results.by_scale(quantity)) {
                // An error of V's scale is the same for both regions, so that it counts by their difference.
                step.standard_error = step.standard_error.hypot(between(&scale)?.map_or(0.0, |error| error.value));
            }
            Ok::<_, Error>(step)
        };
        let steps = self.steps.iter().map(|&[from, to]| {
            Ok(StepReport {
                from: from.into(),
                to: to.into(),
                quantity: quantity.name.into(),
                unit: quantity.unit.to_string(),
                difference: step(&quantity, [from, to])?,
                depth_mm: depth.as_ref().map_or(Ok(None), |depth| step(depth, [from, to]))?,
            })
        });
        let profile = |quantity: &Quantity<'_>, line: &Line| {
            let [values, deviation] = [&quantity.values, &quantity.deviation].map(|values| Values { width, values });
            Ok([values.profile(line)?, deviation.profile(line)?])
        };
        let profiles = self.lines.iter().enumerate().map(|(i, line)| {
            Ok(ProfileReport {
                line: *line,
                csv: name(i, "csv"),
                png: name(i, "png"),
                name: quantity.name,
                unit: quantity.unit.to_string(),
                values: profile(&quantity, line)?,
                depth: depth.as_ref().map(|depth| profile(depth, line)).transpose()?,
                pixel_mm: results.pixel_mm(),
            })
        });
        Ok(Measurements {
            steps: steps.collect::<Result<_, Error>>()?,
            profiles: profiles.collect::<Result<_, Error>>()?,
        })
    }
}

/// Name of the file of a profile; `profile_1.csv` is the first.
fn name(index: usize, ending: &str) -> String {
    format!("profile_{}.{ending}", index + 1)
}

/// Whether a file name is one of a profile.
pub(super) fn is_profile(file: &str) -> bool {
    let number = file.strip_prefix("profile_").and_then(|rest| rest.strip_suffix(".csv").or(rest.strip_suffix(".png")));
    number.is_some_and(|number| number.parse::<usize>().is_ok())
}

/// Names of the files of profiles in a folder. A solve into the folder may replace them. Empty if the folder cannot be
/// listed.
pub fn profiles_in(folder: &Path) -> Vec<String> {
    let names = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.file_name());
    names.filter_map(|name| name.into_string().ok()).filter(|name| is_profile(name)).collect()
}

impl Measurements {
    /// The files of the profiles.
    pub(super) fn files(&self, plotter: Option<Plotter>) -> Vec<NewFile<'static>> {
        let mut files = Vec::new();
        for profile in &self.profiles {
            let table = profile.clone();
            files.push(NewFile::new(profile.csv.clone(), move |_, w| table.write_csv(w).map_err(|e| e.to_string())));
            let Some(plotter) = plotter else { continue };
            let drawn = profile.clone();
            files.push(NewFile::new(profile.png.clone(), move |_, w| {
                let picture = (plotter.profile)(&drawn);
                write_png(w, picture.dimensions(), ColorType::Rgb, &Pixels::Bytes(&picture), &PROFILE)
            }));
        }
        files
    }
}

impl ProfileReport {
    /// The quantity and its unit, as the label of an axis.
    pub(crate) fn label(&self) -> String {
        format!("{}, {}", self.name.replace('_', " "), self.unit)
    }

    /// Writes one row for each sample; invalid values are empty.
    fn write_csv(&self, mut writer: impl Write) -> std::io::Result<()> {
        let [values, deviation] = ["", "_deviation"].map(|of| column(&format!("{}{of}", self.name), &self.unit));
        write!(writer, "distance_px,x_px,y_px,{values},{deviation}")?;
        write!(writer, "{}", if self.depth.is_some() { ",depth_mm,depth_deviation_mm" } else { "" })?;
        writeln!(writer, "{}", if self.pixel_mm.is_some() { ",distance_mm" } else { "" })?;
        let number = |v: f64| if v.is_finite() { v.to_string() } else { String::new() };
        for (i, ([x, y], distance)) in self.line.points().zip(self.distances()).enumerate() {
            write!(writer, "{distance},{x},{y}")?;
            for column in self.values.iter().chain(self.depth.iter().flatten()) {
                write!(writer, ",{}", number(column[i]))?;
            }
            writeln!(writer, "{}", self.pixel_mm.map_or(String::new(), |mm| format!(",{}", mm * distance)))?;
        }
        Ok(())
    }

    /// Distances from the beginning of the line, px.
    pub(crate) fn distances(&self) -> impl Iterator<Item = f64> + use<> {
        let [x1, y1] = self.line.from;
        self.line.points().map(move |[x, y]| (x - x1).hypot(y - y1))
    }
}
