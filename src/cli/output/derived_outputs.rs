//! What shows the results of a folder, made anew when they are told anew: the page and the surface.

use parfocal::export::{Arrays, Extra, PAGE_FILE, Palette, Solved, SolvedSweep};
use parfocal::model::Points;
use parfocal::page::report_html::EarlierPage;
use parfocal::{Frame, metric::MetricDepth};
use serde_json::Value;

use crate::cli::options::models::{Models, SurfaceOf};
use crate::cli::output::failure::Failure;

/// What of a folder shows its results.
pub(crate) struct Shown {
    page: Option<EarlierPage>,
    models: Models,
    fused: Option<Frame>,
    points: Option<Points>,
    arrays: Option<Arrays>,
    /// Whether there is a page that cannot be made anew.
    lost: bool,
}

/// Said of it.
const LOST: &str = "cannot be made anew from the one that is there, and is removed; solve again for another";

impl Shown {
    /// The page alone.
    fn page(folder: &std::path::Path, report: &Value) -> Self {
        let listed = report["files"].as_array().into_iter().flatten().any(|file| file == PAGE_FILE);
        let page = listed.then(|| EarlierPage::read(folder)).flatten();
        let models = Models::of_report(report);
        Self { lost: listed && page.is_none(), page, models, fused: None, points: None, arrays: None }
    }

    /// The page of a pair.
    pub(crate) fn page_of_pair(solved: &Solved) -> Self {
        Self::page(&solved.folder, solved.report())
    }

    /// The page of a sweep.
    pub(crate) fn page_of_sweep(solved: &SolvedSweep) -> Self {
        Self::page(&solved.folder, solved.report())
    }

    /// All that shows a pair.
    pub(crate) fn of_pair(solved: &Solved) -> Result<Self, Failure> {
        let mut shown = Self::page_of_pair(solved);
        shown.arrays = shown.models.hold_arrays().then(|| match solved.measured_depth() {
            Some(metric) => Arrays::of_depth(&metric),
            None => {
                Arrays::of_relative_blur((solved.width, solved.height), &solved.measured_blur(), &solved.uncertainty)
            }
        });
        if !shown.models.show_the_surface() {
            return Ok(shown);
        }
        let (blur, metric): (_, Option<MetricDepth>) = (solved.measured_blur(), solved.measured_depth());
        let fused = solved.fused()?;
        shown.points = shown.models.points(&SurfaceOf {
            blur: &blur,
            metric: metric.as_ref(),
            part: solved.region(),
            photograph: solved.photograph,
            fused: &fused,
            nearer: solved.nearer,
        })?;
        shown.fused = Some(fused);
        Ok(shown)
    }

    /// All that shows a sweep.
    pub(crate) fn of_sweep(solved: &SolvedSweep) -> Result<Self, Failure> {
        let mut shown = Self::page_of_sweep(solved);
        shown.arrays = shown.models.hold_arrays().then(|| Arrays::of_sweep(&solved.sweep));
        shown.points = shown.models.points_of_sweep(&solved.sweep, &solved.fused, solved.nearer)?;
        shown.fused = Some(solved.fused.clone());
        Ok(shown)
    }

    /// The files of a pair.
    pub(crate) fn files_of_pair<'a>(&'a self, solved: &'a Solved, palette: Option<Palette>) -> Vec<Extra<'a>> {
        self.files(self.page.as_ref().map(|page| page.of_pair(solved, palette)))
    }

    /// The files of a sweep.
    pub(crate) fn files_of_sweep<'a>(&'a self, solved: &'a SolvedSweep, palette: Option<Palette>) -> Vec<Extra<'a>> {
        self.files(self.page.as_ref().map(|page| page.of_sweep(solved, palette)))
    }

    fn files<'a>(&'a self, page: Option<Extra<'a>>) -> Vec<Extra<'a>> {
        let surface = self.fused.as_ref().map(|fused| self.models.files(self.points.as_ref(), fused));
        let arrays = self.models.array_files(self.arrays.as_ref());
        page.into_iter().chain(surface.into_iter().flatten()).chain(arrays).collect()
    }

    /// What the surface is now, in a report.
    pub(crate) fn note(&self, report: &mut Value) {
        if let Some(surface) = self.models.report(self.points.as_ref()) {
            report["surface"] = serde_json::json!(surface);
        }
    }

    /// A line of what is lost.
    pub(crate) fn warning(&self) -> Option<String> {
        self.lost.then(|| format!("warning        {PAGE_FILE} {LOST}"))
    }
}
