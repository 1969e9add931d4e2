//! The option `--export`: the surface and its depth for other programs. Also the files that are derived from results.

use std::ops::RangeInclusive;

use clap::ValueEnum;
use parfocal::export::{
    self, ArrayKind, Drawing, Extra, PAGE_FILE, Palette, Report, Results, SurfaceReport, TopographyKind,
};
use parfocal::model::{COORDINATE_FILES, Model, Points};
use parfocal::page::{figure::PLOTTER, report_html::ExistingPage};
use parfocal::{Error, Frame};
use serde::Serialize;

use crate::cli::help::OUTPUT;
use crate::cli::options::part::within;
use crate::cli::output::failure::Failure;

/// The requested additional files.
#[derive(clap::Args, Clone, Debug, Default, Serialize)]
pub(crate) struct Exports {
    /// Write also (comma-separated): ply, glb, stl, obj, x3p, sdf, xyz, npy, tiff, zarr and others
    ///
    /// The surface, in mm if the lens is known: ply (surface.ply, a mesh with colour and normals), cloud (points.ply,
    /// points with both), glb (surface.glb, glTF with the fused image as texture), stl (surface.stl, triangles), obj
    /// (surface.obj, a mesh with colour and normals as text).
    ///
    /// Depth in mm if the lens is known, else V or focus: depth16 (depth16.png and depth16.tiff, 16-bit grey, 0 where
    /// not valid; scale and offset are in the files and in report.json), npy (depth.npy and deviation.npy, 32-bit
    /// floats, NaN where not measured), tiff (depth.tiff and deviation.tiff, the same), zarr (depth.zarr.zip, the same
    /// in one file).
    ///
    /// The surface in metric units, if depth in mm and the size of a pixel are known (--pixel-size, or the lens): x3p
    /// (surface.x3p, ISO 25178-72), sdf (surface.sdf, ISO 25178-71 in binary), sdf-ascii (surface_ascii.sdf, the same
    /// as text), xyz (surface_x.tiff, surface_y.tiff and surface_z.tiff: right, down, away from the camera, in floats).
    ///
    /// labels (labels.png): 1 where I1 is sharper, 2 where I2 is sharper, 3 where V is within its standard deviation of
    /// 0, 0 where not valid; of a sweep the number of the frame whose focus is nearest to the pixel.
    #[arg(long = "export", value_name = "KIND,...", help_heading = OUTPUT, value_enum, value_delimiter = ',', hide_possible_values = true)]
    kinds: Vec<Kind>,
    /// Vertices of a mesh along its longer side, at most (2 to 65536) [default: one for each pixel]
    #[arg(long, value_name = "N", help_heading = OUTPUT, value_parser = clap::value_parser!(u32).range(2..=65536))]
    mesh_cells: Option<u32>,
    /// Height of the surface for each px² of V or each setting of a sweep (px, 1e-6 to 1e6)
    ///
    /// Without it, the surface is in mm from the lens if the lens is known; else its relief is 15 % of the longer side.
    #[arg(long, value_name = "PX", help_heading = OUTPUT, value_parser = within(Z_SCALES, "give a number from 1e-6 to 1e6"))]
    z_scale: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, ValueEnum)]
enum Kind {
    Ply,
    Cloud,
    Glb,
    Stl,
    Obj,
    X3p,
    Sdf,
    SdfAscii,
    Xyz,
    Depth16,
    Npy,
    Tiff,
    Zarr,
    Labels,
}

impl Kind {
    /// The names of the files.
    fn files(&self) -> &'static [&'static str] {
        match self {
            Kind::Ply => &["surface.ply"],
            Kind::Cloud => &["points.ply"],
            Kind::Glb => &["surface.glb"],
            Kind::Stl => &["surface.stl"],
            Kind::Obj => &["surface.obj"],
            Kind::X3p => &["surface.x3p"],
            Kind::Sdf => &["surface.sdf"],
            Kind::SdfAscii => &["surface_ascii.sdf"],
            Kind::Xyz => &COORDINATE_FILES,
            Kind::Depth16 => &["depth16.png", "depth16.tiff"],
            Kind::Npy => ArrayKind::Npy.files(),
            Kind::Tiff => ArrayKind::Tiff.files(),
            Kind::Zarr => ArrayKind::Zarr.files(),
            Kind::Labels => &["labels.png"],
        }
    }
}

/// The kinds that write depth as 32-bit floats.
const ARRAYS: [(Kind, ArrayKind); 3] =
    [(Kind::Npy, ArrayKind::Npy), (Kind::Tiff, ArrayKind::Tiff), (Kind::Zarr, ArrayKind::Zarr)];

/// The kinds of surface texture.
const TOPOGRAPHIES: [(Kind, TopographyKind); 3] =
    [(Kind::X3p, TopographyKind::X3p), (Kind::Sdf, TopographyKind::Sdf), (Kind::SdfAscii, TopographyKind::SdfAscii)];

/// The kinds of surfaces.
const MODELS: [(Kind, Model); 5] = [
    (Kind::Ply, Model::Ply),
    (Kind::Cloud, Model::Cloud),
    (Kind::Glb, Model::Glb),
    (Kind::Stl, Model::Stl),
    (Kind::Obj, Model::Obj),
];

/// The range of `--z-scale`.
const Z_SCALES: RangeInclusive<f64> = 1e-6..=1e6;

/// The fused image and the points of a surface.
pub(crate) struct Surface {
    fused: Frame,
    points: Points,
}

impl Exports {
    /// The additional files that a report lists, to be written again.
    pub(crate) fn of_report(report: &Report) -> Self {
        let (mesh_cells, z_scale) =
            report.surface.as_ref().map_or((None, None), |stated| (stated.mesh_cells, stated.z_scale));
        let is_there = |kind: &Kind| kind.files().iter().all(|name| report.has_file(name));
        let models = MODELS.iter().map(|(kind, _)| *kind).chain([Kind::Xyz]);
        let fields = ARRAYS.map(|(kind, _)| kind).into_iter().chain(TOPOGRAPHIES.map(|(kind, _)| kind));
        let kinds = models.chain(fields).filter(is_there).collect();
        // The writer of the report has checked these numbers.
        Self {
            kinds,
            mesh_cells: mesh_cells.map(|cells| cells.max(2)),
            z_scale: z_scale.filter(|z| Z_SCALES.contains(z)),
        }
    }

    /// The surface, if a file of it is requested.
    pub(crate) fn surface(&self, results: &Results<'_>) -> Result<Option<Surface>, Error> {
        if self.models().next().is_none() && !self.kinds.contains(&Kind::Xyz) {
            return Ok(None);
        }
        let fused = results.fused()?;
        let points = Points::of(results, &fused, self.z_scale)?;
        Ok(Some(Surface { fused, points }))
    }

    /// The entry of the report for a surface.
    pub(crate) fn report(&self, surface: Option<&Surface>) -> Option<SurfaceReport> {
        let (mesh_cells, z_scale) = (self.mesh_cells, self.z_scale);
        surface.map(|surface| SurfaceReport { unit: surface.points.unit.clone(), mesh_cells, z_scale })
    }

    /// Whether depth in 16 bits is requested.
    pub(crate) fn is_depth16(&self) -> bool {
        self.kinds.contains(&Kind::Depth16)
    }

    /// The requested files of the surface.
    pub(crate) fn surface_files<'a>(&self, surface: Option<&'a Surface>) -> Vec<Extra<'a>> {
        let Some(Surface { fused, points }) = surface else { return Vec::new() };
        let nodes = self.mesh_cells.map(|n| n as usize);
        let coordinates = self.kinds.contains(&Kind::Xyz).then(|| points.coordinate_files());
        let models = self.models().map(|model| points.file(model, fused, nodes));
        models.chain(coordinates.into_iter().flatten()).collect()
    }

    /// The requested files of depth in floats, and of surface texture.
    pub(crate) fn array_files<'a>(&self) -> Vec<Extra<'a>> {
        let kinds = ARRAYS.iter().filter(|(kind, _)| self.kinds.contains(kind));
        let topographies = TOPOGRAPHIES.iter().filter(|(kind, _)| self.kinds.contains(kind));
        kinds.flat_map(|(_, kind)| kind.extras()).chain(topographies.map(|(_, kind)| kind.extra())).collect()
    }

    /// Refuses metric formats unless depth will be in mm and the size of a pixel is known, and with an exaggeration.
    pub(crate) fn check_metric(&self, is_metric: bool) -> Result<(), Failure> {
        let kinds = TOPOGRAPHIES.iter().map(|(kind, _)| kind).chain([&Kind::Xyz]);
        let Some(name) = kinds.filter(|kind| self.kinds.contains(kind)).find_map(ValueEnum::to_possible_value) else {
            return Ok(());
        };
        let problem = match (is_metric, self.z_scale) {
            (true, None) => return Ok(()),
            (true, Some(_)) => "has heights in mm, without an exaggeration; leave --z-scale out",
            (false, _) => {
                "needs depth in mm and the size of a pixel: of a pair the lens, of a sweep --focus-at and --pixel-size"
            }
        };
        Err(Failure::Usage(format!("--export {}: {problem}", name.get_name())))
    }

    /// Whether `labels.png` is requested.
    pub(crate) fn is_labels(&self) -> bool {
        self.kinds.contains(&Kind::Labels)
    }

    /// Refuses labels for more frames than they can represent.
    pub(crate) fn check_labels(&self, frames: usize) -> Result<(), Failure> {
        let most = export::MOST_LABELS;
        if self.kinds.contains(&Kind::Labels) && frames > most {
            let problem =
                format!("--export labels: there are {frames} frames, and labels.png can label {most}; leave it out");
            return Err(Failure::Usage(problem));
        }
        Ok(())
    }

    /// The names of all requested files.
    pub(crate) fn names(&self) -> Vec<&'static str> {
        self.kinds.iter().flat_map(Kind::files).copied().collect()
    }

    /// The requested kinds of surfaces.
    fn models(&self) -> impl Iterator<Item = Model> {
        MODELS.into_iter().filter(|(name, _)| self.kinds.contains(name)).map(|(_, model)| model)
    }
}

/// The files of a folder that are regenerated when its results change: the page, the surface and the arrays.
pub(crate) struct DerivedOutputs {
    page: Option<ExistingPage>,
    models: Exports,
    surface: Option<Surface>,
    /// Whether there is a page that cannot be regenerated.
    is_page_lost: bool,
}

impl DerivedOutputs {
    /// The page alone.
    pub(crate) fn page(results: &Results<'_>) -> Self {
        let listed = results.report.has_file(PAGE_FILE);
        let page = listed.then(|| ExistingPage::read(&results.folder)).flatten();
        Self { is_page_lost: listed && page.is_none(), page, models: Exports::default(), surface: None }
    }

    /// All derived files.
    pub(crate) fn new(results: &Results<'_>) -> Result<Self, Failure> {
        let models = Exports::of_report(&results.report);
        let surface = models.surface(results)?;
        Ok(Self { models, surface, ..Self::page(results) })
    }

    /// The files. The page keeps its colours unless others are passed.
    pub(crate) fn files(&self, palette: Option<Palette>) -> Vec<Extra<'_>> {
        let page = self.page.as_ref().map(|page| page.file(palette));
        let surface = self.models.surface_files(self.surface.as_ref());
        page.into_iter().chain(surface).chain(self.models.array_files()).collect()
    }

    /// The style of pictures.
    pub(crate) fn drawing(&self, palette: Option<Palette>) -> Drawing {
        Drawing { palette: palette.unwrap_or_default(), plotter: Some(PLOTTER) }
    }

    /// The entry of the surface in the report.
    pub(crate) fn surface(&self) -> Option<SurfaceReport> {
        self.models.report(self.surface.as_ref())
    }

    /// A warning that the page will be removed.
    pub(crate) fn warning(&self) -> Option<String> {
        let problem = "cannot be written again from the existing one and is removed; solve again for another";
        self.is_page_lost.then(|| format!("warning        {PAGE_FILE} {problem}"))
    }
}
