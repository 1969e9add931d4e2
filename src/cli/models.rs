//! The surface and its depth for other programs.

use clap::ValueEnum;
use parfocal::export::{self, Depth16, Extra, Nearer, Palette};
use parfocal::focus_stack::Sweep;
use parfocal::model::{Model, Points};
use parfocal::{Error, Frame, MetricDepth, Solution};
use serde::Serialize;

use super::failure::Failure;
use super::headings::OUTPUT;

/// Which files beside the usual ones are written, and how.
#[derive(clap::Args, Clone, Debug)]
pub(super) struct ModelArguments {
    /// Also write, several with commas
    #[arg(long, value_name = "KIND,...", help_heading = OUTPUT, value_enum, value_delimiter = ',')]
    export: Vec<Kind>,
    /// Most vertices of a mesh along its longer side, 2 to 65536; default: one for each pixel
    #[arg(long, value_name = "N", help_heading = OUTPUT, value_parser = clap::value_parser!(u32).range(2..=65536))]
    mesh_cells: Option<u32>,
    /// Height of the surface for each px² of V, or each setting of a sweep, px; default: so that the relief is 15 % of the longer side
    #[arg(long, value_name = "PX", help_heading = OUTPUT, value_parser = positive)]
    z_scale: Option<f64>,
}

impl ModelArguments {
    pub(super) fn models(&self) -> Models {
        Models { kinds: self.export.clone(), mesh_cells: self.mesh_cells, z_scale: self.z_scale }
    }
}

/// What to write, and how.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Models {
    kinds: Vec<Kind>,
    mesh_cells: Option<u32>,
    z_scale: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, ValueEnum)]
enum Kind {
    /// surface.ply, a mesh with colour and normals
    Ply,
    /// points.ply, points with both
    Cloud,
    /// surface.glb, glTF with the best-focus image as texture
    Glb,
    /// depth16.png and depth16.tiff: depth in mm where it is known, else V or focus, in 16-bit grey, 0 where not valid; scale and offset
    /// are in the files and in report.json
    Depth16,
    /// labels.png: 1 where I1 is the sharper, 2 where I2 is, 3 where V is within its standard deviation of 0, 0 where not
    /// valid; of a sweep the number of the frame that is focused next to the pixel
    Labels,
}

/// The kinds that show the surface.
const MODELS: [(Kind, Model); 3] = [(Kind::Ply, Model::Ply), (Kind::Cloud, Model::Cloud), (Kind::Glb, Model::Glb)];

fn positive(text: &str) -> Result<f64, String> {
    let good = |value: &f64| (1e-6..=1e6).contains(value);
    text.parse().ok().filter(good).ok_or_else(|| "give a number from 1e-6 to 1e6".to_string())
}

impl Models {
    /// The points of the surface, if any file of it is asked for.
    pub(super) fn points(&self, solution: &Solution, fused: &Frame, nearer: Nearer) -> Result<Option<Points>, Error> {
        if self.shown().next().is_none() {
            return Ok(None);
        }
        let blur = &solution.relative_blur;
        let exaggeration = self.z_scale.unwrap_or_else(|| Points::exaggeration(blur, solution.width, solution.height));
        Points::of_relative_blur(blur, fused, nearer, exaggeration).map(Some)
    }

    /// Depth in 16 bits, if it is asked for.
    pub(super) fn depth16(&self, solution: &Solution, metric: Option<&MetricDepth>) -> Option<Depth16> {
        let size = (solution.width, solution.height);
        let of_blur = || Depth16::of_relative_blur(size, &solution.relative_blur);
        self.is_depth16().then(|| metric.map_or_else(of_blur, Depth16::of_depth))
    }

    /// The same of a sweep.
    pub(super) fn points_of_sweep(
        &self,
        sweep: &Sweep,
        fused: &Frame,
        nearer: Nearer,
    ) -> Result<Option<Points>, Error> {
        if self.shown().next().is_none() {
            return Ok(None);
        }
        let exaggeration = self.z_scale.unwrap_or_else(|| Points::sweep_exaggeration(sweep, nearer));
        Points::of_sweep(sweep, fused, nearer, exaggeration).map(Some)
    }

    /// Whether depth in 16 bits is asked for.
    pub(super) fn is_depth16(&self) -> bool {
        self.kinds.contains(&Kind::Depth16)
    }

    /// The files of the surface that are asked for, each once.
    pub(super) fn files<'a>(&self, points: Option<&'a Points>, fused: &'a Frame) -> Vec<Extra<'a>> {
        let Some(points) = points else { return Vec::new() };
        let nodes = self.mesh_cells.map(|n| n as usize);
        self.shown().map(|model| points.file(model, fused, nodes)).collect()
    }

    /// `labels.png`, if it is asked for.
    pub(super) fn labels<'a>(&self, solution: &'a Solution) -> Option<Extra<'a>> {
        self.kinds.contains(&Kind::Labels).then(|| export::labels(solution))
    }

    /// The same of a sweep.
    pub(super) fn labels_of_sweep<'a>(
        &self,
        sweep: &'a Sweep,
        nearer: Nearer,
        palette: Palette,
    ) -> Result<Option<Extra<'a>>, Error> {
        let asked = self.kinds.contains(&Kind::Labels);
        asked.then(|| export::sweep_labels(sweep, nearer, palette)).transpose()
    }

    /// Refuses, before any work, labels for more frames than they tell apart.
    pub(super) fn check_labels(&self, frames: usize) -> Result<(), Failure> {
        let most = export::MOST_LABELS;
        if self.kinds.contains(&Kind::Labels) && frames > most {
            let problem = format!("--export labels: tells {most} frames apart, and there are {frames}; leave it out");
            return Err(Failure::Usage(problem));
        }
        Ok(())
    }

    /// The names of all files that are asked for.
    pub(super) fn names(&self) -> Vec<&'static str> {
        let of = |name: &Kind| match name {
            Kind::Ply => &["surface.ply"][..],
            Kind::Cloud => &["points.ply"],
            Kind::Glb => &["surface.glb"],
            Kind::Depth16 => &["depth16.png", "depth16.tiff"],
            Kind::Labels => &["labels.png"],
        };
        self.kinds.iter().flat_map(of).copied().collect()
    }

    /// The kinds that show the surface and are asked for.
    fn shown(&self) -> impl Iterator<Item = Model> {
        MODELS.into_iter().filter(|(name, _)| self.kinds.contains(name)).map(|(_, model)| model)
    }
}
