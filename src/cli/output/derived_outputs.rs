//! Files that are derived from results and regenerated when these change: the page, the surface and the arrays.

use parfocal::Frame;
use parfocal::export::{Drawing, Extra, PAGE_FILE, Palette, Results, SurfaceReport};
use parfocal::model::Points;
use parfocal::page::figure::PLOTTER;
use parfocal::page::report_html::ExistingPage;

use crate::cli::options::exports::Exports;
use crate::cli::output::failure::Failure;
/// The derived files of a folder.
pub(crate) struct DerivedOutputs {
    page: Option<ExistingPage>,
    models: Exports,
    fused: Option<Frame>,
    points: Option<Points>,
    /// Whether there is a page that cannot be regenerated.
    is_page_lost: bool,
}

impl DerivedOutputs {
    /// The page alone.
    pub(crate) fn page(results: &Results<'_>) -> Self {
        let listed = results.report.has_file(PAGE_FILE);
        let page = listed.then(|| ExistingPage::read(&results.folder)).flatten();
        Self { is_page_lost: listed && page.is_none(), page, models: Exports::default(), fused: None, points: None }
    }

    /// All derived files.
    pub(crate) fn new(results: &Results<'_>) -> Result<Self, Failure> {
        let models = Exports::of_report(&results.report);
        let fused = models.show_the_surface().then(|| results.fused()).transpose()?;
        let points = fused.as_ref().map(|fused| models.points(results, fused)).transpose()?.flatten();
        Ok(Self { models, fused, points, ..Self::page(results) })
    }

    /// The files. The page keeps its colours unless others are passed.
    pub(crate) fn files(&self, palette: Option<Palette>) -> Vec<Extra<'_>> {
        let page = self.page.as_ref().map(|page| page.file(palette));
        let surface = self.fused.as_ref().map(|fused| self.models.files(self.points.as_ref(), fused));
        page.into_iter().chain(surface.into_iter().flatten()).chain(self.models.array_files()).collect()
    }

    /// The style of pictures.
    pub(crate) fn drawing(&self, palette: Option<Palette>) -> Drawing {
        Drawing { palette: palette.unwrap_or_default(), plotter: Some(PLOTTER) }
    }

    /// The entry of the surface in the report.
    pub(crate) fn surface(&self) -> Option<SurfaceReport> {
        self.models.report(self.points.as_ref())
    }

    /// A warning that the page will be removed.
    pub(crate) fn warning(&self) -> Option<String> {
        let problem = "cannot be written again from the existing one and is removed; solve again for another";
        self.is_page_lost.then(|| format!("warning        {PAGE_FILE} {problem}"))
    }
}
