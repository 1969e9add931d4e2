//! The option `--export`: the surface and its depth for other programs.

use clap::ValueEnum;
use parfocal::export::{self, ArrayKind, Extra, Report, Results, SurfaceReport};
use parfocal::model::{Model, Points};
use parfocal::{Error, Frame};
use serde::Serialize;

use crate::cli::help::OUTPUT;
use crate::cli::output::failure::Failure;

/// The options of additional files.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct ExportArguments {
    /// Write also (comma-separated): ply, cloud, glb, stl, obj, depth16, npy, tiff, zarr, labels
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
    /// labels (labels.png): 1 where I1 is sharper, 2 where I2 is sharper, 3 where V is within its standard deviation of
    /// 0, 0 where not valid; of a sweep the number of the frame whose focus is nearest to the pixel.
    #[arg(long, value_name = "KIND,...", help_heading = OUTPUT, value_enum, value_delimiter = ',', hide_possible_values = true)]
    export: Vec<Kind>,
    /// Vertices of a mesh along its longer side, at most (2 to 65536) [default: one for each pixel]
    #[arg(long, value_name = "N", help_heading = OUTPUT, value_parser = clap::value_parser!(u32).range(2..=65536))]
    mesh_cells: Option<u32>,
    /// Height of the surface for each px² of V or each setting of a sweep (px, 1e-6 to 1e6)
    ///
    /// Without it, the surface is in mm from the lens if the lens is known; else its relief is 15 % of the longer side.
    #[arg(long, value_name = "PX", help_heading = OUTPUT, value_parser = positive)]
    z_scale: Option<f64>,
}

impl ExportArguments {
    pub(crate) fn models(&self) -> Exports {
        Exports { kinds: self.export.clone(), mesh_cells: self.mesh_cells, z_scale: self.z_scale }
    }
}

/// The requested additional files.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct Exports {
    kinds: Vec<Kind>,
    mesh_cells: Option<u32>,
    z_scale: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, ValueEnum)]
enum Kind {
    Ply,
    Cloud,
    Glb,
    Stl,
    Obj,
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
            Kind::Depth16 => &["depth16.png", "depth16.tiff"],
            Kind::Npy => ArrayKind::Npy.files(),
            Kind::Tiff => ArrayKind::Tiff.files(),
            Kind::Zarr => ArrayKind::Zarr.files(),
            Kind::Labels => &["labels.png"],
        }
    }
}

/// The kinds with depth in floats.
const ARRAYS: [(Kind, ArrayKind); 3] =
    [(Kind::Npy, ArrayKind::Npy), (Kind::Tiff, ArrayKind::Tiff), (Kind::Zarr, ArrayKind::Zarr)];

/// The kinds of surfaces.
const MODELS: [(Kind, Model); 5] = [
    (Kind::Ply, Model::Ply),
    (Kind::Cloud, Model::Cloud),
    (Kind::Glb, Model::Glb),
    (Kind::Stl, Model::Stl),
    (Kind::Obj, Model::Obj),
];

fn positive_number(value: f64) -> bool {
    (1e-6..=1e6).contains(&value)
}

fn positive(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|value| positive_number(*value))
        .ok_or_else(|| "give a number from 1e-6 to 1e6".to_string())
}

impl Exports {
    /// The additional files that a report lists, to be written again.
    pub(crate) fn of_report(report: &Report) -> Self {
        let (mesh_cells, z_scale) =
            report.surface.as_ref().map_or((None, None), |stated| (stated.mesh_cells, stated.z_scale));
        let is_there = |kind: &Kind| kind.files().iter().all(|name| report.has_file(name));
        let kinds = MODELS.iter().map(|(kind, _)| *kind).chain(ARRAYS.map(|(kind, _)| kind)).filter(is_there).collect();
        // The writer of the report has checked these numbers.
        Self {
            kinds,
            mesh_cells: mesh_cells.map(|cells| cells.max(2)),
            z_scale: z_scale.filter(|z| positive_number(*z)),
        }
    }

    /// The points of the surface, if a file of it is requested.
    pub(crate) fn points(&self, results: &Results<'_>, fused: &Frame) -> Result<Option<Points>, Error> {
        self.show_the_surface().then(|| Points::of(results, fused, self.z_scale)).transpose()
    }

    /// The entry of the report for these points.
    pub(crate) fn report(&self, points: Option<&Points>) -> Option<SurfaceReport> {
        let (mesh_cells, z_scale) = (self.mesh_cells, self.z_scale);
        points.map(|points| SurfaceReport { unit: points.unit.clone(), mesh_cells, z_scale })
    }

    /// Whether depth in 16 bits is requested.
    pub(crate) fn is_depth16(&self) -> bool {
        self.kinds.contains(&Kind::Depth16)
    }

    /// The requested files of the surface.
    pub(crate) fn files<'a>(&self, points: Option<&'a Points>, fused: &'a Frame) -> Vec<Extra<'a>> {
        let Some(points) = points else { return Vec::new() };
        let nodes = self.mesh_cells.map(|n| n as usize);
        self.shown().map(|model| points.file(model, fused, nodes)).collect()
    }

    /// The requested files of depth in floats.
    pub(crate) fn array_files<'a>(&self) -> Vec<Extra<'a>> {
        let kinds = ARRAYS.iter().filter(|(kind, _)| self.kinds.contains(kind));
        kinds.flat_map(|(_, kind)| kind.extras()).collect()
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

    /// Whether a file of the surface is requested.
    pub(crate) fn show_the_surface(&self) -> bool {
        self.shown().next().is_some()
    }

    /// The requested kinds of surfaces.
    fn shown(&self) -> impl Iterator<Item = Model> {
        MODELS.into_iter().filter(|(name, _)| self.kinds.contains(name)).map(|(_, model)| model)
    }
}
