//! One shader, one file, one test: each pass of the method with its constants, what it binds, and its CPU twin.
//!
//! A twin is the shader in plain Rust and double precision, a pure function over [`Field`]s, for tests and for the
//! [reference solver](crate::reference), never a fallback.

pub mod align;
pub mod appearance;
pub mod apply_shading;
pub mod blur;
pub mod blur_matched_pair;
pub mod convolve;
pub mod copy;
pub mod exposure;
pub mod field;
pub mod fuse;
pub mod half_pair;
#[cfg(test)]
pub(crate) mod harness;
pub mod ingest;
pub mod linearise;
pub mod mask;
pub(crate) mod memory;
pub mod noise;
pub(crate) mod pass;
pub mod prolong;
pub mod relax;
pub mod relax_level;
pub(crate) mod resample_pair;
pub mod residual;
pub mod shape;
pub mod shape_median;
pub mod shape_windows;
pub mod spline;
pub mod stack;
pub mod state;
pub mod subdivide;
pub mod sums;
pub mod system;
pub mod uncertainty;
pub mod uncertainty_terms;
pub mod unpack;
pub mod update;
pub mod update_transform;
pub mod warp;

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::{Arc, Mutex, PoisonError};

pub use field::Field;

use crate::base::Error;
use crate::engine::vulkan::{Device, Pipeline, Stage, Variant};

/// Workgroup of the passes over pixels: wider than high, since rows are what memory keeps together, and a multiple of the
/// subgroup wide, so that subgroups are full. Of 16x16, 32x8, 64x4 and 128x2, 64x4 was the fastest on lavapipe: the heat
/// sink took 16.0, 12.3, 12.2 and 15.2 s, its relaxation 3.5, 2.6, 2.0 and 2.5 s.
pub(crate) const WORKGROUP: [u32; 2] = [64, 4];

/// No specialization constant is set.
pub(crate) const NO_VARIANT: Variant = [false; 4];

/// Pixels of a field.
pub(crate) fn pixels(width: u32, height: u32) -> u64 {
    u64::from(width) * u64::from(height)
}

/// The compiled stages, each and each variant once, when it is first asked for: a sweep takes other ones than a pair.
pub(crate) struct Pipelines {
    compiled: Mutex<HashMap<(&'static str, Variant), Arc<Pipeline>>>,
    device: Arc<Device>,
}

impl Pipelines {
    pub(crate) fn new(device: &Arc<Device>) -> Self {
        Self { compiled: Mutex::default(), device: device.clone() }
    }

    /// How many were asked for so far.
    #[cfg(test)]
    pub(crate) fn count(&self) -> usize {
        self.compiled.lock().unwrap().len()
    }

    /// A variant of a stage.
    pub(crate) fn get(&self, stage: &Stage, variant: Variant) -> Result<Arc<Pipeline>, Error> {
        let mut compiled = self.compiled.lock().unwrap_or_else(PoisonError::into_inner);
        match compiled.entry((stage.shader.name, variant)) {
            Entry::Occupied(known) => Ok(known.get().clone()),
            Entry::Vacant(place) => {
                Ok(place.insert(Arc::new(Pipeline::variant(&self.device, stage, variant)?)).clone())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::vulkan::{Access, Kind};

    const STAGES: [&Stage; 27] = [
        &align::STAGE,
        &appearance::STAGE,
        &convolve::STAGE,
        &copy::STAGE,
        &apply_shading::STAGE,
        &uncertainty_terms::STAGE,
        &exposure::STAGE,
        &fuse::STAGE,
        &half_pair::STAGE,
        &ingest::STAGE,
        &linearise::STAGE,
        &mask::STAGE,
        &prolong::STAGE,
        &relax::STAGE,
        &relax_level::STAGE,
        &residual::STAGE,
        &shape::STAGE,
        &shape_median::STAGE,
        &shape_windows::STAGE,
        &blur_matched_pair::STAGE,
        &update_transform::STAGE,
        &subdivide::STAGE,
        &system::STAGE,
        &uncertainty::STAGE,
        &unpack::STAGE,
        &update::STAGE,
        &warp::STAGE,
    ];

    /// What a line of a shader declares: a binding's number and how it is bound.
    fn declared(line: &str) -> Option<(usize, Kind, Access)> {
        let (layout, rest) = line.strip_prefix("layout(binding = ")?.split_once(')')?;
        let number = layout.split(',').next()?.trim().parse().ok()?;
        let kind = match rest {
            _ if rest.contains("image2DArray") => Kind::Image,
            _ if rest.contains("uniform") => Kind::Uniform,
            _ => Kind::Buffer,
        };
        let access = match rest {
            _ if rest.contains("readonly") || kind == Kind::Uniform => Access::Read,
            _ if rest.contains("writeonly") => Access::Write,
            _ => Access::Update,
        };
        Some((number, kind, access))
    }

    #[test]
    fn stages_bind_what_their_shaders_declare_and_as_they_declare_it() {
        for stage in STAGES {
            let name = stage.shader.name;
            let text = std::fs::read_to_string(format!("{}/glsl/{name}.comp", env!("CARGO_MANIFEST_DIR"))).unwrap();
            let mut found: Vec<_> = text.lines().filter_map(declared).collect();
            found.sort_by_key(|(number, ..)| *number);
            let bound = stage.bindings.iter().enumerate().map(|(n, binding)| (n, binding.kind, binding.access));
            assert_eq!(found, bound.collect::<Vec<_>>(), "{name}");
        }
    }
}
