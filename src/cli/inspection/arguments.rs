//! The options of an inspection, which `inspect`, `batch` and `watch` share, and those that `teach` has too.

use std::path::{Path, PathBuf};

use parfocal::Region;
use parfocal::export::{REPORT_FILE, read_golden};
use parfocal::metric::inspect::Limits;

use crate::cli::batch::summary::SUMMARY;
use crate::cli::help::{INPUT, INSPECTION};
use crate::cli::inspection::golden::Golden;
use crate::cli::inspection::judge::Judge;
use crate::cli::options::part::{region, within};
use crate::cli::output::failure::Failure;

/// The options of a comparison of parts.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct ComparisonArguments {
    /// The allowed difference of heights [default: that of a taught golden part]
    ///
    /// In mm where all have depth in mm, else in px² of V, or in settings of a sweep.
    #[arg(long, value_name = "T", help_heading = INSPECTION, value_parser = from_zero)]
    pub(crate) tolerance: Option<f64>,
    /// Standard deviations that a difference must also exceed
    #[arg(long, value_name = "K", help_heading = INSPECTION, default_value_t = Limits::new(0.0).sigmas,
          value_parser = from_zero)]
    sigmas: f64,
    /// Least number of pixels of a region that counts
    #[arg(long, value_name = "COUNT", help_heading = INSPECTION, default_value_t = Limits::new(0.0).min_area_px)]
    min_area: usize,
    /// The allowed share of the golden part's pixels that are not judged, 0 to 1: without a height of the part, or with
    /// one whose K standard deviations exceed the tolerance
    #[arg(long, value_name = "SHARE", help_heading = INSPECTION, default_value_t = Limits::new(0.0).max_unjudged,
          value_parser = within(0.0..=1.0, "give a share from 0 to 1"))]
    max_unjudged: f64,
    /// Do not register the pictures: the fixture holds every part in the same position
    #[arg(long, help_heading = INSPECTION)]
    pub(crate) in_place: bool,
}

/// The options of an inspection.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct InspectionArguments {
    /// Golden parts: folders of results, or the file that `parfocal teach` made of them
    ///
    /// They have one size. Positions are stated on the pixels of the first.
    #[arg(long, num_args = 1.., value_name = "GOLDEN", help_heading = INPUT)]
    pub(crate) golden: Vec<PathBuf>,
    #[command(flatten)]
    comparison: ComparisonArguments,
    /// The allowed tilt of the part over the golden one, from one corner of the picture to the opposite one, in the unit
    /// of the tolerance [default: 10 tolerances]
    #[arg(long, value_name = "TILT", help_heading = INSPECTION, value_parser = from_zero)]
    max_tilt: Option<f64>,
    /// Region of the golden part that is judged, px; may be repeated [default: all of it]
    #[arg(long, value_name = "X,Y,W,H", help_heading = INSPECTION, value_parser = region)]
    inspect_roi: Vec<Region>,
}

fn from_zero(text: &str) -> Result<f64, String> {
    within(0.0..=1e6, "give a number from 0 to 1e6")(text)
}

impl ComparisonArguments {
    /// The limits with this tolerance.
    pub(crate) fn limits(&self, tolerance: f64) -> Limits {
        let Self { sigmas, min_area, max_unjudged, .. } = *self;
        Limits { sigmas, min_area_px: min_area, max_unjudged, ..Limits::new(tolerance) }
    }
}

impl InspectionArguments {
    /// Whether golden parts are given.
    pub(crate) fn is_given(&self) -> bool {
        !self.golden.is_empty()
    }

    /// Reads the golden parts. Returns `None` if none is given.
    pub(crate) fn judge(&self) -> Result<Option<Judge>, Failure> {
        if self.golden.is_empty() {
            let needs =
                [(self.comparison.tolerance.is_some(), "--tolerance"), (!self.inspect_roi.is_empty(), "--inspect-roi")];
            return match needs.iter().find(|(is_given, _)| *is_given) {
                Some((_, option)) => Err(Failure::Usage(format!("{option} needs golden parts: give --golden too"))),
                None => Ok(None),
            };
        }
        let golden = self.read()?;
        let tolerance = self.tolerance(&golden)?;
        let default = self.comparison.limits(tolerance);
        let limits = Limits { max_tilt: self.max_tilt.unwrap_or(default.max_tilt), ..default };
        Judge::new(golden, limits, &self.inspect_roi, self.comparison.in_place).map(Some)
    }

    fn read(&self) -> Result<Golden, Failure> {
        match self.golden.as_slice() {
            [file] if !file.is_dir() => Ok(Golden::taught(file, read_golden(file)?)),
            several => match several.iter().find(|path| path.is_file()) {
                Some(file) => Err(Failure::Usage(format!(
                    "--golden: {} is a file beside others; give one file of parfocal teach, or folders of results",
                    file.display()
                ))),
                None => Golden::of_folders(&result_folders(several), self.comparison.in_place),
            },
        }
    }

    /// The stated tolerance, or the one of a taught golden part.
    fn tolerance(&self, golden: &Golden) -> Result<f64, Failure> {
        let taught = golden.tolerance();
        let Some(tolerance) = self.comparison.tolerance.or(taught) else {
            let problem = "--tolerance is missing: state it, or take the one that parfocal teach suggests";
            return Err(Failure::Usage(problem.to_string()));
        };
        if let Some(taught) = taught.filter(|taught| tolerance < *taught) {
            let problem = format!(
                "--tolerance {tolerance} is less than {taught}, at which the golden parts of {} were compared; teach \
                 them again with --tolerance {tolerance}",
                golden.name()
            );
            return Err(Failure::Usage(problem));
        }
        Ok(tolerance)
    }
}

/// The folders of results, with each folder of a batch replaced by those of its pairs and sweeps.
pub(crate) fn result_folders(paths: &[PathBuf]) -> Vec<PathBuf> {
    let of_batch = |path: &PathBuf| path.join(SUMMARY).is_file() && !path.join(REPORT_FILE).exists();
    let inner = |path: &Path| -> Vec<PathBuf> {
        let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
        let mut folders: Vec<PathBuf> =
            entries.map(|entry| entry.path()).filter(|path| path.join(REPORT_FILE).is_file()).collect();
        folders.sort();
        folders
    };
    paths.iter().flat_map(|path| if of_batch(path) { inner(path) } else { vec![path.clone()] }).collect()
}
