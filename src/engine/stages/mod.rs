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
pub mod mask;
pub mod prolong;
pub mod refine;
pub mod relax;
pub mod relax_level;
pub mod residual;
pub mod spline;
pub mod stack;
pub mod state;
pub mod step;
pub mod update;
pub mod warp;

use std::sync::{Arc, OnceLock};

pub use field::Field;

use crate::base::Error;
use crate::engine::vulkan::{Device, Pipeline};

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
    pub(crate) mask: Arc<Pipeline>,
    pub(crate) ingest: Arc<Pipeline>,
    pub(crate) ingest_srgb: Arc<Pipeline>,
    pub(crate) convolve: Arc<Pipeline>,
    pub(crate) convolve_long: Arc<Pipeline>,
    pub(crate) refine: Arc<Pipeline>,
    pub(crate) prolong: Arc<Pipeline>,
    pub(crate) step: Arc<Pipeline>,
    pub(crate) relax: Arc<Pipeline>,
    pub(crate) relax_first: Arc<Pipeline>,
    pub(crate) relax_level: Arc<Pipeline>,
    pub(crate) update: Arc<Pipeline>,
    pub(crate) warp: Arc<Pipeline>,
    pub(crate) evidence: Arc<Pipeline>,
    pub(crate) residual: Arc<Pipeline>,
    pub(crate) residual_any_kernel: Arc<Pipeline>,
    pub(crate) residual_warped: Arc<Pipeline>,
    pub(crate) confidence: Arc<Pipeline>,
    pub(crate) fuse: Arc<Pipeline>,
    weighing: [OnceLock<Weighing>; 2],
    device: Arc<Device>,
}

/// Those that weigh pixels: where some are masked or clipped, variants do, which take longer.
pub(crate) struct Weighing {
    pub(crate) expose: Arc<Pipeline>,
    pub(crate) appearance: Arc<Pipeline>,
    pub(crate) linearise: Arc<Pipeline>,
    pub(crate) linearise_any_kernel: Arc<Pipeline>,
    pub(crate) linearise_warped: Arc<Pipeline>,
}

impl Pipelines {
    pub(crate) fn new(device: &Arc<Device>) -> Result<Self, Error> {
        let compile = |stage| Pipeline::new(device, stage).map(Arc::new);
        let variant = |stage, constants| Pipeline::variant(device, stage, constants).map(Arc::new);
        Ok(Self {
            mask: compile(&mask::STAGE)?,
            ingest: compile(&ingest::STAGE)?,
            ingest_srgb: variant(&ingest::STAGE, [true, false, false])?,
            convolve: compile(&convolve::STAGE)?,
            convolve_long: variant(&convolve::STAGE, [true, false, false])?,
            refine: compile(&refine::STAGE)?,
            prolong: compile(&prolong::STAGE)?,
            step: compile(&step::STAGE)?,
            relax: compile(&relax::STAGE)?,
            relax_level: compile(&relax_level::STAGE)?,
            relax_first: variant(&relax::STAGE, [true, false, false])?,
            update: compile(&update::STAGE)?,
            warp: compile(&warp::STAGE)?,
            evidence: compile(&evidence::STAGE)?,
            residual: compile(&residual::STAGE)?,
            residual_any_kernel: variant(&residual::STAGE, [true, false, false])?,
            residual_warped: variant(&residual::STAGE, [false, true, false])?,
            confidence: compile(&confidence::STAGE)?,
            fuse: compile(&fuse::STAGE)?,
            weighing: Default::default(),
            device: device.clone(),
        })
    }

    /// Those that weigh pixels, compiled when they are first asked for.
    pub(crate) fn weighing(&self, masked: bool) -> Result<&Weighing, Error> {
        let made = &self.weighing[usize::from(masked)];
        if let Some(weighing) = made.get() {
            return Ok(weighing);
        }
        let weighing = Weighing::new(&self.device, masked)?;
        Ok(made.get_or_init(|| weighing))
    }
}

impl Weighing {
    fn new(device: &Arc<Device>, masked: bool) -> Result<Self, Error> {
        let variant = |stage, [a, b]: [bool; 2]| Pipeline::variant(device, stage, [a, b, masked]).map(Arc::new);
        Ok(Self {
            expose: variant(&expose::STAGE, [false, false])?,
            appearance: variant(&appearance::STAGE, [false, false])?,
            linearise: variant(&linearise::STAGE, [false, false])?,
            linearise_any_kernel: variant(&linearise::STAGE, [true, false])?,
            linearise_warped: variant(&linearise::STAGE, [false, true])?,
        })
    }
}
