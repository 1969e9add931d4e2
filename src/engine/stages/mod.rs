//! The passes of the method: for each shader its push constants, bindings and CPU reference.
//!
//! A CPU reference is the shader in plain Rust, a pure function over [`Raster`]s. Those of double precision
//! ([`Field`]s) are for tests of the shaders and for the [reference solver](crate::internals::reference); those of
//! single precision are what the CPU device runs. During solves on a GPU the host uses a few: for the halves of pairs
//! in parts, and for the start, the masks and the uncertainty of sweeps.

pub mod align;
pub mod ambiguity;
pub mod appearance;
pub mod apply_shading;
pub mod blur;
pub mod blur_matched_pair;
pub mod cascade;
pub mod copy;
pub(crate) mod edge;
pub mod edge_agree;
pub mod edge_apply;
pub mod edge_cells;
pub mod edge_coarsen;
pub mod edge_costs;
pub mod edge_decide;
pub mod edge_fuse;
pub mod edge_refine;
pub mod edge_straighten;
pub mod exposure;
pub mod fuse;
pub mod grid;
pub mod half_pair;
pub mod halve_grid;
#[cfg(test)]
pub(crate) mod harness;
pub mod ingest;
mod interface;
pub mod law;
pub mod lens;
pub mod lens_windows;
pub mod linearise;
mod links;
pub mod mask;
pub mod noise;
mod number;
pub mod pair_samples;
pub mod parallax;
pub mod parallax_windows;
pub(crate) mod pass;
pub mod prolong;
pub mod relax;
pub mod relax_grid_tiles;
pub mod relax_tiles;
pub mod residual;
mod rows;
pub mod scale_deviation;
pub(crate) mod segments;
pub mod separable;
pub mod shape;
pub mod spline;
pub mod stack;
pub mod state;
pub mod subdivide;
pub mod sums;
pub mod system;
pub mod system_tiles;
pub mod total_deviation;
pub mod uncertainty;
pub mod uncertainty_terms;
pub mod unit;
pub mod unpack;
pub mod update;
pub mod update_transform;
pub mod warp;

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

pub use number::{Number, Real};
pub use spline::{Field, Raster};

use crate::base::{Error, workers};
use crate::engine::vulkan::{Device, Pipeline, Stage, Variant};

/// The workgroup of passes over pixels: wider than high, since rows are contiguous in memory, and a multiple of the
/// subgroup wide, so that subgroups are full. On lavapipe with 16x16, 32x8, 64x4 and 128x2 the heat sink took 16.0,
/// 12.3, 12.2 and 15.2 s, its relaxation 3.5, 2.6, 2.0 and 2.5 s.
pub(crate) const WORKGROUP: [u32; 2] = [64, 4];

/// The variant with no specialization constant set.
pub(crate) const NO_VARIANT: Variant = Variant::NONE;

/// The number of pixels of an image.
pub(crate) fn pixels(width: u32, height: u32) -> u64 {
    u64::from(width) * u64::from(height)
}

/// The pipelines of a device. Each variant of a stage is compiled when it is first used: sweeps use other ones than
/// pairs.
pub(crate) struct Pipelines {
    compiled: Mutex<HashMap<(&'static str, Variant), Arc<Pipeline>>>,
    device: Arc<Device>,
}

impl Pipelines {
    pub(crate) fn new(device: &Arc<Device>) -> Self {
        Self { compiled: Mutex::default(), device: device.clone() }
    }

    /// The number of pipelines compiled so far.
    #[cfg(test)]
    pub(crate) fn count(&self) -> usize {
        self.compiled.lock().unwrap().len()
    }

    /// Compiles those that are missing, in parallel: drivers compile on the calling thread.
    pub(crate) fn prepare<'a>(&self, wanted: impl Iterator<Item = (&'a Stage, Variant)>) -> Result<(), Error> {
        let mut missing: Vec<(&Stage, Variant)> =
            wanted.filter(|&(stage, variant)| self.known(stage, variant).is_none()).collect();
        missing.sort_by_key(|&(stage, variant)| (stage.shader.name, variant));
        missing.dedup_by_key(|&mut (stage, variant)| (stage.shader.name, variant));
        let compiled = workers::map(missing.len(), |n| self.get(missing[n].0, missing[n].1));
        compiled.into_iter().try_for_each(|pipeline| pipeline.map(drop))
    }

    /// The pipeline of a variant of a stage.
    pub(crate) fn get(&self, stage: &Stage, variant: Variant) -> Result<Arc<Pipeline>, Error> {
        if let Some(known) = self.known(stage, variant) {
            return Ok(known);
        }
        // Not under the lock. If two threads compile the same, one of the two is kept.
        let compiled = Arc::new(Pipeline::variant(&self.device, stage, variant)?);
        let mut all = self.compiled.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(all.entry((stage.shader.name, variant)).or_insert(compiled).clone())
    }

    fn known(&self, stage: &Stage, variant: Variant) -> Option<Arc<Pipeline>> {
        let all = self.compiled.lock().unwrap_or_else(PoisonError::into_inner);
        all.get(&(stage.shader.name, variant)).cloned()
    }
}
