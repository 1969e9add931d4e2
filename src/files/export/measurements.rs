//! Step heights and profiles: for the report, as CSV and as pictures.

use std::fs;
use std::io::Write;
use std::path::Path;

use png::ColorType;
use serde::Serialize;

use super::Pen;
use super::meaning::PROFILE;
use super::picture::{self, Stored};
use super::staging::Staging;
use crate::base::Region;
use crate::base::{Error, Estimate};
use crate::metric::MetricDepth;
use crate::metric::measure::{Line, Values};

/// What was asked to be measured, and the numbers.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Measurements {
    /// Step heights.
    pub steps: Vec<StepReport>,
    /// Profiles.
    pub profiles: Vec<ProfileReport>,
}

/// How far one region lies above another: the level of the second less that of the first. `null` where a region has too few
/// valid pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StepReport {
    /// The first region: x, y, width, height, px.
    pub from: [u32; 4],
    /// The second.
    pub to: [u32; 4],
    /// Of V, px².
    pub relative_blur: Option<Estimate>,
    /// Of depth, mm; also `null` without a lens.
    pub depth_mm: Option<Estimate>,
}

/// A profile, of which the report has the place and the file the numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ProfileReport {
    /// Where.
    #[serde(flatten)]
    pub line: Line,
    /// `profile_N.csv`.
    pub csv: String,
    /// `profile_N.png`.
    pub png: String,
    /// V and its standard deviation, px², from place to place of the line.
    #[serde(skip)]
    pub relative_blur: [Vec<f64>; 2],
    /// Depth and its standard deviation, mm.
    #[serde(skip)]
    pub depth: Option<[Vec<f64>; 2]>,
}

/// What to measure.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
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

    /// Measures V, its standard deviation `uncertainty`, both in px² and of `width` values a row, and depth.
    ///
    /// # Errors
    /// Those of [`check`](Self::check).
    pub fn measure(
        &self,
        width: u32,
        blur: &[f32],
        uncertainty: &[f32],
        metric: Option<&MetricDepth>,
    ) -> Result<Measurements, Error> {
        let field = |values| Values { width, values };
        let depth = metric.map(|metric| field(&metric.depth[..]));
        let steps = self.steps.iter().map(|&[from, to]| {
            Ok(StepReport {
                from: from.into(),
                to: to.into(),
                relative_blur: field(blur).step(from, to)?,
                depth_mm: depth.map_or(Ok(None), |depth| depth.step(from, to))?,
            })
        });
        let profiles = self.lines.iter().enumerate().map(|(i, line)| {
            let with = |values, deviation| Ok([field(values).profile(line)?, field(deviation).profile(line)?]);
            Ok(ProfileReport {
                line: *line,
                csv: name(i, "csv"),
                png: name(i, "png"),
                relative_blur: with(blur, uncertainty)?,
                depth: metric.map(|metric| with(&metric.depth, &metric.deviation)).transpose()?,
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
        write!(writer, "distance_px,x_px,y_px,relative_blur_px2,relative_blur_deviation_px2")?;
        writeln!(writer, "{}", if self.depth.is_some() { ",depth_mm,depth_deviation_mm" } else { "" })?;
        let number = |v: f64| if v.is_finite() { v.to_string() } else { String::new() };
        for (i, ([x, y], distance)) in self.line.places().zip(self.distances()).enumerate() {
            write!(writer, "{distance},{x},{y}")?;
            for column in self.relative_blur.iter().chain(self.depth.iter().flatten()) {
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
