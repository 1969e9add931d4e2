//! One shader, one file, one test: each pass of the method with its constants, what it binds, and its CPU twin.
//!
//! A twin is the shader in plain Rust and double precision, a pure function over [`Field`]s, for tests and for the
//! [reference solver](crate::reference), never a fallback.

pub mod appearance;
pub mod blur;
pub mod confidence;
pub mod convolve;
pub mod copy;
pub mod evidence;
pub mod expose;
pub mod field;
pub mod fuse;
#[cfg(test)]
pub(crate) mod harness;
pub mod ingest;
pub mod linearise;
pub mod prolong;
pub mod refine;
pub mod relax;
pub mod relax_level;
pub mod spline;
pub mod stack;
pub mod state;
pub mod step;
pub mod update;
pub mod warp;

use std::sync::Arc;

pub use field::Field;

use crate::Error;
use crate::vulkan::{Device, Pipeline};

/// Workgroup of the passes over pixels: wider than high, since rows are what memory keeps together, and a multiple of the
/// subgroup wide, so that subgroups are full. Of 16x16, 32x8, 64x4 and 128x2, 64x4 was the fastest on lavapipe: the heat
/// sink took 16.0, 12.3, 12.2 and 15.2 s, its relaxation 3.5, 2.6, 2.0 and 2.5 s.
pub(crate) const WORKGROUP: [u32; 2] = [64, 4];

/// Pixels of a field.
pub(crate) fn pixels(width: u32, height: u32) -> u64 {
    u64::from(width) * u64::from(height)
}

/// The compiled passes.
pub(crate) struct Pipelines {
    pub(crate) ingest: Arc<Pipeline>,
    pub(crate) ingest_srgb: Arc<Pipeline>,
    pub(crate) convolve: Arc<Pipeline>,
    pub(crate) convolve_long: Arc<Pipeline>,
    pub(crate) refine: Arc<Pipeline>,
    pub(crate) expose: Arc<Pipeline>,
    pub(crate) prolong: Arc<Pipeline>,
    pub(crate) appearance: Arc<Pipeline>,
    pub(crate) linearise: Arc<Pipeline>,
    pub(crate) linearise_any_kernel: Arc<Pipeline>,
    pub(crate) linearise_warped: Arc<Pipeline>,
    pub(crate) step: Arc<Pipeline>,
    pub(crate) relax: Arc<Pipeline>,
    pub(crate) relax_first: Arc<Pipeline>,
    pub(crate) relax_level: Arc<Pipeline>,
    pub(crate) update: Arc<Pipeline>,
    pub(crate) warp: Arc<Pipeline>,
    pub(crate) evidence: Arc<Pipeline>,
    pub(crate) confidence: Arc<Pipeline>,
    pub(crate) fuse: Arc<Pipeline>,
}

impl Pipelines {
    pub(crate) fn new(device: &Arc<Device>) -> Result<Self, Error> {
        let compile = |stage| Pipeline::new(device, stage).map(Arc::new);
        let variant = |stage, constants| Pipeline::variant(device, stage, constants).map(Arc::new);
        Ok(Self {
            ingest: compile(&ingest::STAGE)?,
            ingest_srgb: variant(&ingest::STAGE, [true, false])?,
            convolve: compile(&convolve::STAGE)?,
            convolve_long: variant(&convolve::STAGE, [true, false])?,
            refine: compile(&refine::STAGE)?,
            expose: compile(&expose::STAGE)?,
            prolong: compile(&prolong::STAGE)?,
            appearance: compile(&appearance::STAGE)?,
            linearise: compile(&linearise::STAGE)?,
            linearise_any_kernel: variant(&linearise::STAGE, [true, false])?,
            linearise_warped: variant(&linearise::STAGE, [false, true])?,
            step: compile(&step::STAGE)?,
            relax: compile(&relax::STAGE)?,
            relax_level: compile(&relax_level::STAGE)?,
            relax_first: variant(&relax::STAGE, [true, false])?,
            update: compile(&update::STAGE)?,
            warp: compile(&warp::STAGE)?,
            evidence: compile(&evidence::STAGE)?,
            confidence: compile(&confidence::STAGE)?,
            fuse: compile(&fuse::STAGE)?,
        })
    }
}
