//! Depth from defocus on the GPU.
//!
//! Two photographs of a scene, focused at two distances, differ in blur and, because the camera moved or the lens
//! breathed, in position, scale, angle and exposure. Parfocal recovers the relative blur at every pixel and the
//! registration together (Ben-Ari, TPAMI 2014).
//!
//! ```
//! use parfocal::{Engine, EngineOptions, Settings, PairSolver};
//! # use parfocal::Frame;
//! # fn photograph(soft: f32) -> Frame {
//! #     let value = |i: usize| 0.5 + soft * ((i % 64) as f32 * 1.1).sin() * ((i / 64) as f32 * 0.9).cos();
//! #     Frame::gray(64, 48, (0..64 * 48).map(value).collect()).unwrap()
//! # }
//!
//! # fn main() -> Result<(), parfocal::Error> {
//! // From files: let (i1, i2) = parfocal::image_io::read_pair("near.png".as_ref(), "far.png".as_ref())?;
//! # let (i1, i2) = (photograph(0.4), photograph(0.3));
//! let engine = Engine::new(&EngineOptions::default())?;
//! let mut solver = PairSolver::for_pair(&engine, &i1, &i2, &Settings::default())?;
//! let solution = solver.solve(&i1, &i2)?;
//! println!("{:?}, V at the first pixel {} px²", solution.transform, solution.relative_blur[0]);
//! # assert_eq!(solution.relative_blur.len(), 64 * 48);
//! # Ok(())
//! # }
//! ```
//!
//! An [`Engine`] is a device, a [`PairSolver`] a size and settings, prepared once and used for any number of pairs. Every
//! failure is an [`Error`]; a pair that can be read but not solved is a [`Solution`] that has not converged and says why.
//!
//! All of this is there with `default-features = false`: it needs some 30 crates, and nothing but Rust to be built. The
//! feature `serde` makes settings and lenses readable and writable; `files` adds `image_io`, `export` and `model`, `page`
//! what is drawn, `lab` scenes, experiments and `baseline`, `program` the command line, each with those before it.
//! `compile-shaders` compiles the shaders anew instead of taking the SPIR-V that comes with the crate.

// What only the rooms above use of a room is dead where they are not built; the default build has them all, and warns.
#![cfg_attr(not(feature = "program"), allow(dead_code, unused_imports))]

mod base;
mod engine;
#[cfg(feature = "files")]
mod files;
#[cfg(feature = "lab")]
mod lab;
mod metric;
#[cfg(feature = "page")]
mod page;
mod solve;

/// The examples in the guide, which are compiled with those of the documentation.
#[cfg(all(doctest, feature = "files"))]
#[doc = include_str!("../docs/guide/src/embedding.md")]
mod guide {}

#[doc(hidden)]
pub use base::Setting;
pub use base::{
    Aperture, BlurToDepth, Brightness, CancellationToken, Channels, Decode, Depth, DeviceInfo, Error, Estimate, Format,
    Frame, Homography, Kernel, Lens, Mask, Method, Motion, Photometric, PixelFormat, Region, RegistrationStep,
    RowLayout, Samples, Settings, Shading, Similarity, centre,
};
#[cfg(target_os = "linux")]
pub use engine::DmaBuf;
pub use engine::{
    Engine, EngineOptions, Findings, HostMemory, KeyPoints, LevelHistory, OtherMotion, PairSolver, Progress,
    Registered, SharedMemory, Solution, SolutionRef, Source, Ticket, Timings, interop, reference, stages,
};
#[cfg(feature = "files")]
pub use files::{bounded_read, export, image_io, model};
#[cfg(feature = "lab")]
pub use lab::{baseline, bench, contact_sheet, evaluate, scene};
pub use metric::{CalibratedParameter, Calibration, LensParameter, MetricDepth, Target, calibrate, inspect, measure};
#[cfg(feature = "page")]
pub use page::{batch_html, figure, inspection, report_html, view};
pub use solve::{FieldCurvature, QueueFull, SolveOptions, SolverCache, Stream, focus_stack, resample};
