//! The options of an inspection, which `inspect`, `batch` and `watch` share, and those that `teach` has too.

use std::path::{Path, PathBuf};
use std::{fs, io};

use parfocal::export::{REPORT_FILE, listed_in, read_golden};
use parfocal::metric::inspect::{Limits, PlacementRange};
use parfocal::{Region, internals::bounded_read};
use serde_json::Value;

use crate::cli::batch::summary::{SUMMARY, is_of_batch};
use crate::cli::help::{INPUT, INSPECTION};
use crate::cli::inspection::golden::{Golden, Placement};
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
    /// Standard deviations that a difference must also exceed [default: 3]
    #[arg(long, value_name = "K", help_heading = INSPECTION, value_parser = from_zero)]
    sigmas: Option<f64>,
    /// Least number of pixels of a region that counts [default: 50]
    #[arg(long, value_name = "COUNT", help_heading = INSPECTION)]
    min_area: Option<usize>,
    /// The allowed share of the golden part's pixels that are not judged, 0 to 1: without a height of the part, or with
    /// one whose K standard deviations exceed the tolerance [default: 0.25]
    #[arg(long, value_name = "SHARE", help_heading = INSPECTION,
          value_parser = within(0.0..=1.0, "give a share from 0 to 1"))]
    max_unjudged: Option<f64>,
    /// Do not register the pictures: the fixture holds every part in the same position
    #[arg(long, help_heading = INSPECTION)]
    in_place: bool,
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
    /// The allowed tilt of the part over the golden one, from one corner of the picture to the opposite one, in the
    /// unit of the tolerance [default: 10 tolerances]
    #[arg(long, value_name = "TILT", help_heading = INSPECTION, value_parser = from_zero)]
    max_tilt: Option<f64>,
    /// Width of the smallest defect that must be seen (px, 2 to 100); where one as high as the tolerance would not be, the
    /// part cannot be judged. Of pairs only [default: none]
    #[arg(long, value_name = "PX", help_heading = INSPECTION, value_parser = within(2.0..=100.0, "give 2 to 100 px"))]
    smallest: Option<f64>,
    /// The allowed shift of the part from where the golden one lies in its picture, px [default: as good parts taught]
    #[arg(long, value_name = "PX", help_heading = INSPECTION, value_parser = from_zero)]
    max_shift: Option<f64>,
    /// The allowed rotation of the part from how the golden one lies, degrees [default: as good parts taught]
    #[arg(long, value_name = "DEGREES", help_heading = INSPECTION, value_parser = from_zero)]
    max_rotation: Option<f64>,
    /// Region of the golden part that is judged, px; may be repeated [default: all of it]
    #[arg(long, value_name = "X,Y,W,H", help_heading = INSPECTION, value_parser = region)]
    inspect_roi: Vec<Region>,
}

fn from_zero(text: &str) -> Result<f64, String> {
    within(0.0..=1e6, "give a number from 0 to 1e6")(text)
}

impl ComparisonArguments {
    pub(crate) fn placement(&self) -> Placement {
        if self.in_place { Placement::Fixed } else { Placement::Free }
    }

    pub(crate) fn limits(&self, tolerance: f64) -> Limits {
        let default = Limits::new(tolerance);
        Limits {
            sigmas: self.sigmas.unwrap_or(default.sigmas),
            min_area_px: self.min_area.unwrap_or(default.min_area_px),
            max_unjudged: self.max_unjudged.unwrap_or(default.max_unjudged),
            ..default
        }
    }
}

impl InspectionArguments {
    /// Whether golden parts are given.
    pub(crate) fn is_given(&self) -> bool {
        !self.golden.is_empty()
    }

    /// Refuses golden parts within the folder of results, where a part of their name would replace them.
    pub(crate) fn check_output(&self, out: &Path) -> Result<(), Failure> {
        let Ok(out) = out.canonicalize() else { return Ok(()) };
        let is_within = |golden: &&PathBuf| {
            golden.canonicalize().is_ok_and(|golden| {
                golden.starts_with(&out) && (golden.is_dir() || golden.parent() != Some(out.as_path()))
            })
        };
        self.golden.iter().find(is_within).map_or(Ok(()), |golden| {
            let problem = "is a golden part in the folder of the results, which may replace it; give another folder";
            Err(Failure::file(golden, problem))
        })
    }

    /// Reads the golden parts. Returns `None` if none is given.
    pub(crate) fn judge(&self) -> Result<Option<Judge>, Failure> {
        if self.golden.is_empty() {
            let ComparisonArguments { tolerance, sigmas, min_area, max_unjudged, in_place } = self.comparison;
            let needs = [
                (tolerance.is_some(), "--tolerance"),
                (sigmas.is_some(), "--sigmas"),
                (min_area.is_some(), "--min-area"),
                (max_unjudged.is_some(), "--max-unjudged"),
                (in_place, "--in-place"),
                (self.max_tilt.is_some(), "--max-tilt"),
                (self.smallest.is_some(), "--smallest"),
                (self.max_shift.is_some(), "--max-shift"),
                (self.max_rotation.is_some(), "--max-rotation"),
                (!self.inspect_roi.is_empty(), "--inspect-roi"),
            ];
            return match needs.iter().find(|(is_given, _)| *is_given) {
                Some((_, option)) => Err(Failure::Usage(format!("{option} needs golden parts: give --golden too"))),
                None => Ok(None),
            };
        }
        let mut golden = self.read()?;
        golden.placement = self.placement_range(golden.placement);
        let tolerance = self.tolerance(&golden)?;
        let default = self.comparison.limits(tolerance);
        let max_tilt = self.max_tilt.unwrap_or(default.max_tilt);
        let limits = Limits { max_tilt, smallest_px: self.smallest, ..default };
        Judge::new(golden, limits, &self.inspect_roi, self.comparison.placement()).map(Some)
    }

    fn read(&self) -> Result<Golden, Failure> {
        match self.golden.as_slice() {
            [file] if !file.is_dir() => Ok(Golden::taught(file, read_golden(file)?)),
            several => match several.iter().find(|path| path.is_file()) {
                Some(file) => Err(Failure::Usage(format!(
                    "--golden: {} is a file beside others; give one file of parfocal teach, or folders of results",
                    file.display()
                ))),
                None => Golden::of_folders(&result_folders(several)?, self.comparison.placement(), false),
            },
        }
    }

    /// The stated placement of parts, in the place of the taught one.
    fn placement_range(&self, taught: Option<PlacementRange>) -> Option<PlacementRange> {
        let mut range = taught.unwrap_or(PlacementRange::ANY);
        if let Some(shift) = self.max_shift {
            (range.middle.tx, range.middle.ty, range.max_shift_px) = (0.0, 0.0, shift);
        }
        if let Some(rotation) = self.max_rotation {
            (range.middle.rotation, range.max_rotation_deg) = (0.0, rotation);
        }
        Some(range).filter(|range| *range != PlacementRange::ANY)
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

/// Greatest size of a summary of a batch, 1 GiB.
const MAX_SUMMARY: u64 = 1 << 30;

/// The folders of results, with each folder of a batch replaced by those of its pairs and sweeps that have results by
/// batch.json, or without it by the summaries of shares.
pub(crate) fn result_folders(paths: &[PathBuf]) -> Result<Vec<PathBuf>, Failure> {
    let mut all = Vec::new();
    for path in paths {
        let failed = |problem: String| Failure::file(path, problem);
        let unreadable = |e: io::Error| failed(format!("cannot be read ({e}); check its permissions"));
        if path.join(REPORT_FILE).exists() || !path.is_dir() {
            all.push(path.clone());
            continue;
        }
        let names = fs::read_dir(path).and_then(Iterator::collect::<io::Result<Vec<_>>>).map_err(unreadable)?;
        let names = names.iter().map(|entry| entry.file_name().to_string_lossy().into_owned());
        let mut summaries: Vec<String> = names.filter(|name| is_of_batch(name) && name.ends_with(".json")).collect();
        if summaries.is_empty() {
            all.push(path.clone());
            continue;
        }
        if summaries.iter().any(|name| name == SUMMARY) {
            summaries = vec![SUMMARY.to_string()];
        }
        let mut folders = Vec::new();
        for name in &summaries {
            let bytes = bounded_read::read(&path.join(name), MAX_SUMMARY).map_err(unreadable)?;
            let summary: Value =
                serde_json::from_slice(&bytes).map_err(|e| failed(format!("{name} is no summary of a batch ({e})")))?;
            let rows = summary["pairs"].as_array().into_iter().flatten();
            let good = rows.filter(|row| row["status"] == "solved" || row["status"] == "kept");
            folders.extend(good.filter_map(|row| Some(path.join(row["name"].as_str()?))));
        }
        if folders.is_empty() {
            return Err(failed("its batch has no results".to_string()));
        }
        folders.sort();
        folders.dedup();
        all.extend(folders);
    }
    Ok(all)
}

/// The files of the results in a folder.
pub(crate) fn files_of(folder: &Path) -> Vec<PathBuf> {
    listed_in(folder, REPORT_FILE).into_iter().map(|name| folder.join(name)).collect()
}
