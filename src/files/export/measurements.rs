//! Step heights and profiles: for the report, as CSV and as pictures.

use std::fs;
use std::io::Write;
use std::path::Path;

use png::ColorType;
use serde::ser::{Serialize, SerializeMap, Serializer};

use super::Pen;
use super::meaning::PROFILE;
use super::picture::{self, Stored};
use super::staging::Staging;
use crate::base::{Error, Estimate, Region};
use crate::metric::MetricDepth;
use crate::metric::measure::{Line, Values};
use crate::solve::sweep::Sweep;

/// What was asked to be measured, and the numbers.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Measurements {
    /// Step heights.
    pub steps: Vec<StepReport>,
    /// Profiles.
    pub profiles: Vec<ProfileReport>,
}

/// What is measured, besides depth in mm where that is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// V of a pair, px².
    RelativeBlur,
    /// The focus setting of a sweep, in "settings", "1/m" or "mm".
    Focus(&'static str),
}

impl Quantity {
    /// The key in reports.
    fn key(self) -> &'static str {
        match self {
            Self::RelativeBlur => "relative_blur",
            Self::Focus(_) => "focus",
        }
    }

    /// As a person reads it.
    pub fn unit(self) -> &'static str {
        match self {
            Self::RelativeBlur => "px²",
            Self::Focus(unit) => unit,
        }
    }

    /// With its unit, beside an axis.
    pub(crate) fn label(self) -> String {
        format!("{}, {}", self.key().replace('_', " "), self.unit())
    }

    /// The heads of columns of values and their standard deviations.
    fn columns(self) -> [String; 2] {
        let unit = self.unit().replace("px²", "px2").replace("1/m", "per_m");
        ["", "_deviation"].map(|of| format!("{}{of}_{unit}", self.key()))
    }
}

/// How far one region lies above another: the level of the second less that of the first. `null` where a region has too few
/// valid pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepReport {
    /// The first region: x, y, width, height, px.
    pub from: [u32; 4],
    /// The second.
    pub to: [u32; 4],
    /// What `difference` is of; its key in reports.
    pub quantity: Quantity,
    /// Of V or of focus, in the unit of the quantity.
    pub difference: Option<Estimate>,
    /// Of depth, mm; also `null` where depth is not known.
    pub depth_mm: Option<Estimate>,
}

impl Serialize for StepReport {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(4))?;
        map.serialize_entry("from", &self.from)?;
        map.serialize_entry("to", &self.to)?;
        map.serialize_entry(self.quantity.key(), &self.difference)?;
        map.serialize_entry("depth_mm", &self.depth_mm)?;
        map.end()
    }
}

/// A profile, of which the report has the place and the file the numbers.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct ProfileReport {
    /// Where.
    #[serde(flatten)]
    pub line: Line,
    /// `profile_N.csv`.
    pub csv: String,
    /// `profile_N.png`.
    pub png: String,
    /// What `values` are of.
    #[serde(skip)]
    pub quantity: Quantity,
    /// V or focus and its standard deviation, in the unit of the quantity, from place to place of the line.
    #[serde(skip)]
    pub values: [Vec<f64>; 2],
    /// Depth and its standard deviation, mm.
    #[serde(skip)]
    pub depth: Option<[Vec<f64>; 2]>,
}

/// What there is to measure: fields of one size.
#[derive(Clone, Copy, Debug)]
pub struct Measurable<'a> {
    /// Pixels a row.
    pub width: u32,
    /// What `values` are of.
    pub quantity: Quantity,
    /// Row-major; NaN where there is none.
    pub values: &'a [f32],
    /// Their standard deviation.
    pub deviation: &'a [f32],
    /// Depth and its standard deviation, mm, where it is known.
    pub depth: Option<[&'a [f32]; 2]>,
}

impl<'a> Measurable<'a> {
    /// V and its standard deviation, both in px² and of `width` values a row, and depth through a lens.
    pub fn of_relative_blur(
        width: u32,
        blur: &'a [f32],
        uncertainty: &'a [f32],
        metric: Option<&'a MetricDepth>,
    ) -> Self {
        let depth = metric.map(|metric| [&metric.depth[..], &metric.deviation]);
        Self { width, quantity: Quantity::RelativeBlur, values: blur, deviation: uncertainty, depth }
    }

    /// Focus of a sweep, and its depth where that is known.
    pub fn of_sweep(sweep: &'a Sweep) -> Self {
        let (values, deviation) = (&sweep.focus, &sweep.uncertainty);
        let depth = sweep.depth.as_ref().map(|found| [&found.depth[..], &found.deviation]);
        Self { width: sweep.width, quantity: Quantity::Focus(sweep.unit), values, deviation, depth }
    }
}

/// What to measure.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Wanted {
    /// Pairs of regions.
    pub steps: Vec<[Region; 2]>,
    /// Lines.
    pub lines: Vec<Line>,
}

impl Wanted {
    /// Checks every place against the size of an image.
    ///
    /// # Errors
    /// [`Error::Region`].
    pub fn check(&self, size: (u32, u32)) -> Result<(), Error> {
        self.steps.iter().flatten().try_for_each(|region| region.check(size))?;
        self.lines.iter().try_for_each(|line| line.check(size))
    }

    /// The files of the profiles.
    pub fn files(&self) -> Vec<String> {
        (0..self.lines.len()).flat_map(|i| [name(i, "csv"), name(i, "png")]).collect()
    }

    /// Whether there is nothing to measure.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty() && self.lines.is_empty()
    }

    /// Measures the fields.
    ///
    /// # Errors
    /// Those of [`check`](Self::check).
    pub fn measure(&self, of: &Measurable<'_>) -> Result<Measurements, Error> {
        let field = |values| Values { width: of.width, values };
        let depth = of.depth.map(|[depth, _]| field(depth));
        let steps = self.steps.iter().map(|&[from, to]| {
            Ok(StepReport {
                from: from.into(),
                to: to.into(),
                quantity: of.quantity,
                difference: field(of.values).step(from, to)?,
                depth_mm: depth.map_or(Ok(None), |depth| depth.step(from, to))?,
            })
        });
        let profiles = self.lines.iter().enumerate().map(|(i, line)| {
            let with =
                |[values, deviation]: [_; 2]| Ok([field(values).profile(line)?, field(deviation).profile(line)?]);
            Ok(ProfileReport {
                line: *line,
                csv: name(i, "csv"),
                png: name(i, "png"),
                quantity: of.quantity,
                values: with([of.values, of.deviation])?,
                depth: of.depth.map(with).transpose()?,
            })
        });
        Ok(Measurements {
            steps: steps.collect::<Result<_, Error>>()?,
            profiles: profiles.collect::<Result<_, Error>>()?,
        })
    }
}

/// `profile_1.csv` is the first.
fn name(index: usize, ending: &str) -> String {
    format!("profile_{}.{ending}", index + 1)
}

/// Whether a file is called as those of profiles are.
pub(super) fn is_profile(file: &str) -> bool {
    let number = file.strip_prefix("profile_").and_then(|rest| rest.strip_suffix(".csv").or(rest.strip_suffix(".png")));
    number.is_some_and(|number| number.parse::<usize>().is_ok())
}

/// The files of profiles that are in a folder, which a solve into it may replace; none where it cannot be listed.
pub fn profiles_in(folder: &Path) -> Vec<String> {
    let names = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.file_name());
    names.filter_map(|name| name.into_string().ok()).filter(|name| is_profile(name)).collect()
}

impl Measurements {
    /// Adds the profiles to what is about to appear.
    pub(super) fn stage(&self, staging: &mut Staging, pen: Option<Pen>) -> Result<(), Error> {
        for profile in &self.profiles {
            staging.add(&profile.csv, |w| profile.write_csv(w).map_err(|e| e.to_string()))?;
            let Some(pen) = pen else { continue };
            let picture = (pen.profile)(profile);
            let bytes = Stored::Bytes(&picture);
            staging.add(&profile.png, |w| picture::write(w, picture.dimensions(), ColorType::Rgb, &bytes, &PROFILE))?;
        }
        Ok(())
    }
}

impl ProfileReport {
    /// A row for each place; what is not valid is left empty.
    fn write_csv(&self, mut writer: impl Write) -> std::io::Result<()> {
        write!(writer, "distance_px,x_px,y_px,{}", self.quantity.columns().join(","))?;
        writeln!(writer, "{}", if self.depth.is_some() { ",depth_mm,depth_deviation_mm" } else { "" })?;
        let number = |v: f64| if v.is_finite() { v.to_string() } else { String::new() };
        for (i, ([x, y], distance)) in self.line.places().zip(self.distances()).enumerate() {
            write!(writer, "{distance},{x},{y}")?;
            for column in self.values.iter().chain(self.depth.iter().flatten()) {
                write!(writer, ",{}", number(column[i]))?;
            }
            writeln!(writer)?;
        }
        Ok(())
    }

    /// From the beginning of the line, px.
    pub(crate) fn distances(&self) -> impl Iterator<Item = f64> + use<> {
        let [x1, y1] = self.line.from;
        self.line.places().map(move |[x, y]| (x - x1).hypot(y - y1))
    }
}
