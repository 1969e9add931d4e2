//! The surface for other programs.

use clap::ValueEnum;
use parfocal::export::{Extra, Nearer};
use parfocal::model::{Model, Points};
use parfocal::{Error, Frame, Solution};

/// Which files of the surface are written, and how.
#[derive(clap::Args, Clone, Debug)]
pub(super) struct ModelArguments {
    /// Also write the surface: ply (surface.ply, a mesh with colour and normals), cloud (points.ply, points with both),
    /// glb (surface.glb, glTF with the best-focus image as texture); several with commas
    #[arg(long, value_name = "KIND", value_enum, value_delimiter = ',')]
    export: Vec<ModelName>,
    /// Most vertices of a mesh along its longer side, 2 to 65536; default: one for each pixel
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=65536))]
    mesh_cells: Option<u32>,
    /// Height of the surface for each px² of V, px; default: so that the relief is 15 % of the longer side
    #[arg(long, value_name = "PX", value_parser = positive)]
    z_scale: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum ModelName {
    Ply,
    Cloud,
    Glb,
}

impl From<ModelName> for Model {
    fn from(name: ModelName) -> Self {
        match name {
            ModelName::Ply => Self::Ply,
            ModelName::Cloud => Self::Cloud,
            ModelName::Glb => Self::Glb,
        }
    }
}

fn positive(text: &str) -> Result<f64, String> {
    let good = |value: &f64| (1e-6..=1e6).contains(value);
    text.parse().ok().filter(good).ok_or_else(|| "give a number from 1e-6 to 1e6".to_string())
}

impl ModelArguments {
    /// The points of the surface, if any file is asked for.
    pub(super) fn points(&self, solution: &Solution, fused: &Frame, nearer: Nearer) -> Result<Option<Points>, Error> {
        if self.export.is_empty() {
            return Ok(None);
        }
        let blur = &solution.relative_blur;
        let exaggeration = self.z_scale.unwrap_or_else(|| Points::exaggeration(blur, solution.width, solution.height));
        Points::of_relative_blur(blur, fused, nearer, exaggeration).map(Some)
    }

    /// The files that are asked for, each once.
    pub(super) fn files<'a>(&self, points: Option<&'a Points>, fused: &'a Frame) -> Vec<Extra<'a>> {
        let Some(points) = points else { return Vec::new() };
        let nodes = self.mesh_cells.map(|n| n as usize);
        let asked = [ModelName::Ply, ModelName::Cloud, ModelName::Glb].into_iter().filter(|n| self.export.contains(n));
        asked.map(|name| points.file(name.into(), fused, nodes)).collect()
    }
}
