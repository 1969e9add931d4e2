//! The surface and its depth for other programs.

use clap::ValueEnum;
use parfocal::export::{self, ArrayKind, Arrays, Depth16, Extra, Nearer, Palette, SurfaceReport};
use parfocal::model::{Model, Points};
use parfocal::sweep::Sweep;
use parfocal::{Error, Frame, Region, Solution, metric::MetricDepth};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::cli::options::headings::OUTPUT;
use crate::cli::output::failure::Failure;

/// Which files beside the usual ones are written, and how.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct ModelArguments {
    /// Also write, with commas: ply, cloud, glb, stl, obj, depth16, npy, tiff, zarr, labels
    ///
    /// The surface, in mm with a lens: ply, surface.ply, a mesh with colour and normals; cloud, points.ply, points with both; glb,
    /// surface.glb, glTF with the best-focus image as texture; stl, surface.stl, triangles alone; obj, surface.obj, a mesh with
    /// colour and normals, in letters.
    ///
    /// Depth in mm where it is known, else V or focus: depth16, depth16.png and depth16.tiff, 16-bit grey, 0 where not valid, scale
    /// and offset in the files and in report.json; npy, depth.npy and deviation.npy, with its standard deviation, 32-bit floats, NaN
    /// where not measured; tiff, depth.tiff and deviation.tiff, the same; zarr, depth.zarr.zip, the same in one file.
    ///
    /// labels, labels.png: 1 where I1 is the sharper, 2 where I2 is, 3 where V is within its standard deviation of 0, 0 where not
    /// valid; of a sweep the number of the frame that is focused next to the pixel.
    #[arg(long, value_name = "KIND,...", help_heading = OUTPUT, value_enum, value_delimiter = ',', hide_possible_values = true)]
    export: Vec<Kind>,
    /// Most vertices of a mesh along its longer side, 2 to 65536; default: one for each pixel
    #[arg(long, value_name = "N", help_heading = OUTPUT, value_parser = clap::value_parser!(u32).range(2..=65536))]
    mesh_cells: Option<u32>,
    /// Height of the surface for each px² of V, or each setting of a sweep, px
    ///
    /// Default: with a lens the surface is metric, in mm from the lens; else its relief is 15 % of the longer side.
    #[arg(long, value_name = "PX", help_heading = OUTPUT, value_parser = positive)]
    z_scale: Option<f64>,
}

impl ModelArguments {
    pub(crate) fn models(&self) -> Models {
        Models { kinds: self.export.clone(), mesh_cells: self.mesh_cells, z_scale: self.z_scale }
    }
}

/// What to write, and how.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Models {
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
    /// The names of its files.
    fn files(&self) -> &'static [&'static str] {
        match self {
            Kind::Ply => &["surface.ply"],
            Kind::Cloud => &["points.ply"],
            Kind::Glb => &["surface.glb"],
            Kind::Stl => &["surface.stl"],
            Kind::Obj => &["surface.obj"],
            Kind::Depth16 => &["depth16.png", "depth16.tiff"],
            Kind::Npy => Arrays::names(ArrayKind::Npy),
            Kind::Tiff => Arrays::names(ArrayKind::Tiff),
            Kind::Zarr => Arrays::names(ArrayKind::Zarr),
            Kind::Labels => &["labels.png"],
        }
    }
}

/// What the surface of a pair is made of.
#[derive(Clone, Copy)]
pub(crate) struct SurfaceOf<'a> {
    /// V without what was filled in, px².
    pub(crate) blur: &'a [f32],
    /// Depth likewise, where it is known.
    pub(crate) metric: Option<&'a MetricDepth>,
    /// The part of I1 that they are of.
    pub(crate) part: Region,
    /// Width and height of I1.
    pub(crate) photograph: [u32; 2],
    /// The fused image.
    pub(crate) fused: &'a Frame,
    pub(crate) nearer: Nearer,
}

/// The kinds that hold depth in floats.
const ARRAYS: [(Kind, ArrayKind); 3] =
    [(Kind::Npy, ArrayKind::Npy), (Kind::Tiff, ArrayKind::Tiff), (Kind::Zarr, ArrayKind::Zarr)];

/// The kinds that show the surface.
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

impl Models {
    /// Those that a report says are there, to be made anew.
    pub(crate) fn of_report(report: &Value) -> Self {
        let stated = SurfaceReport::deserialize(&report["surface"]).ok();
        let (mesh_cells, z_scale) = stated.map_or((None, None), |stated| (stated.mesh_cells, stated.z_scale));
        let is_there = |kind: &Kind| {
            let listed = report["files"].as_array().into_iter().flatten();
            kind.files().iter().all(|name| listed.clone().any(|file| file == name))
        };
        let kinds = MODELS.iter().map(|(kind, _)| *kind).chain(ARRAYS.map(|(kind, _)| kind)).filter(is_there).collect();
        // What a report holds was checked when it was asked for, by whoever wrote it.
        Self {
            kinds,
            mesh_cells: mesh_cells.map(|cells| cells.max(2)),
            z_scale: z_scale.filter(|z| positive_number(*z)),
        }
    }

    /// The points of the surface, if any file of it is asked for: in mm where depth is known and no exaggeration is asked
    /// for.
    pub(crate) fn points(&self, of: &SurfaceOf<'_>) -> Result<Option<Points>, Error> {
        if !self.show_the_surface() {
            return Ok(None);
        }
        let SurfaceOf { blur, metric, part, photograph, fused, nearer } = *of;
        if let (Some(metric), None) = (metric, self.z_scale) {
            return Points::of_depth(metric, part, photograph, fused).map(Some);
        }
        let exaggeration = self.z_scale.unwrap_or_else(|| Points::exaggeration(blur, part.width, part.height));
        Points::of_relative_blur(blur, fused, nearer, exaggeration).map(Some)
    }

    /// What the report says of these points.
    pub(crate) fn report(&self, points: Option<&Points>) -> Option<SurfaceReport> {
        let (mesh_cells, z_scale) = (self.mesh_cells, self.z_scale);
        points.map(|points| SurfaceReport { unit: points.unit.clone(), mesh_cells, z_scale })
    }

    /// Depth in 16 bits, if it is asked for.
    pub(crate) fn depth16(&self, solution: &Solution, metric: Option<&MetricDepth>) -> Option<Depth16> {
        let size = (solution.width, solution.height);
        let of_blur = || Depth16::of_relative_blur(size, &solution.relative_blur);
        self.is_depth16().then(|| metric.map_or_else(of_blur, Depth16::of_depth))
    }

    /// The same of a sweep.
    pub(crate) fn points_of_sweep(
        &self,
        sweep: &Sweep,
        fused: &Frame,
        nearer: Nearer,
    ) -> Result<Option<Points>, Error> {
        if !self.show_the_surface() {
            return Ok(None);
        }
        let exaggeration = self.z_scale.unwrap_or_else(|| Points::sweep_exaggeration(sweep, nearer));
        Points::of_sweep(sweep, fused, nearer, exaggeration).map(Some)
    }

    /// Whether depth in 16 bits is asked for.
    pub(crate) fn is_depth16(&self) -> bool {
        self.kinds.contains(&Kind::Depth16)
    }

    /// The files of the surface that are asked for, each once.
    pub(crate) fn files<'a>(&self, points: Option<&'a Points>, fused: &'a Frame) -> Vec<Extra<'a>> {
        let Some(points) = points else { return Vec::new() };
        let nodes = self.mesh_cells.map(|n| n as usize);
        self.shown().map(|model| points.file(model, fused, nodes)).collect()
    }

    /// Whether depth in floats is asked for.
    pub(crate) fn hold_arrays(&self) -> bool {
        ARRAYS.iter().any(|(kind, _)| self.kinds.contains(kind))
    }

    /// The files of depth in floats that are asked for.
    pub(crate) fn array_files<'a>(&self, arrays: Option<&'a Arrays>) -> Vec<Extra<'a>> {
        let kinds = ARRAYS.iter().filter(|(kind, _)| self.kinds.contains(kind));
        arrays.map_or(Vec::new(), |arrays| kinds.flat_map(|(_, kind)| arrays.files(*kind)).collect())
    }

    /// `labels.png`, if it is asked for.
    pub(crate) fn labels<'a>(&self, solution: &'a Solution) -> Option<Extra<'a>> {
        self.kinds.contains(&Kind::Labels).then(|| export::labels(solution))
    }

    /// The same of a sweep.
    pub(crate) fn labels_of_sweep<'a>(
        &self,
        sweep: &'a Sweep,
        nearer: Nearer,
        palette: Palette,
    ) -> Result<Option<Extra<'a>>, Error> {
        let asked = self.kinds.contains(&Kind::Labels);
        asked.then(|| export::sweep_labels(sweep, nearer, palette)).transpose()
    }

    /// Refuses, before any work, labels for more frames than they tell apart.
    pub(crate) fn check_labels(&self, frames: usize) -> Result<(), Failure> {
        let most = export::MOST_LABELS;
        if self.kinds.contains(&Kind::Labels) && frames > most {
            let problem = format!("--export labels: tells {most} frames apart, and there are {frames}; leave it out");
            return Err(Failure::Usage(problem));
        }
        Ok(())
    }

    /// The names of all files that are asked for.
    pub(crate) fn names(&self) -> Vec<&'static str> {
        self.kinds.iter().flat_map(Kind::files).copied().collect()
    }

    /// Whether any does.
    pub(crate) fn show_the_surface(&self) -> bool {
        self.shown().next().is_some()
    }

    /// The kinds that show the surface and are asked for.
    fn shown(&self) -> impl Iterator<Item = Model> {
        MODELS.into_iter().filter(|(name, _)| self.kinds.contains(name)).map(|(_, model)| model)
    }
}
