//! Depth from defocus on the GPU.
//!
//! Two photographs of a scene, focused at two distances, differ in blur and, because the camera moved or the lens
//! breathed, in position, scale, angle and exposure. Parfocal recovers the relative blur at every pixel and the
//! registration together (Ben-Ari, TPAMI 2014).
//!
//! ```
//! use parfocal::{Engine, EngineOptions, Settings, Solver};
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
//! let mut solver = Solver::for_pair(&engine, &i1, &i2, &Settings::default())?;
//! let solution = solver.solve(&i1, &i2)?;
//! println!("{:?}, V at the first pixel {} px²", solution.transform, solution.relative_blur[0]);
//! # assert_eq!(solution.relative_blur.len(), 64 * 48);
//! # Ok(())
//! # }
//! ```
//!
//! An [`Engine`] is a device, a [`Solver`] a size and settings, prepared once and used for any number of pairs. Every
//! failure is an [`Error`]; a pair that can be read but not solved is a [`Solution`] that has not converged and says why.

mod aperture;
mod baseline;
pub mod bench;
mod calibrate;
mod device_info;
mod engine;
mod error;
pub mod evaluate;
pub mod export;
mod field_curvature;
pub mod figure;
mod filter;
pub mod focus_stack;
mod frame;
pub mod image_io;
mod kernel;
mod lens;
mod mask;
pub mod measure;
mod metric;
pub mod model;
mod plan;
mod profile;
mod record;
pub mod reference;
mod region;
mod registered;
pub mod report_html;
pub mod resample;
pub mod scene;
mod scope;
mod settings;
mod shaders;
mod similarity;
mod smooth_field;
mod solution;
mod solver;
pub mod stages;
mod statistics;
#[cfg(test)]
mod testing;
pub mod view;
mod vignetting;
#[allow(unsafe_code, reason = "the one room that talks to Vulkan")]
mod vulkan;
mod workspace;

/// The examples in the guide, which are compiled with those of the documentation.
#[cfg(doctest)]
#[doc = include_str!("../docs/guide/src/embedding.md")]
mod guide {}

pub use calibrate::{Calibration, Found, Target, Unknown, calibrate};
pub use device_info::DeviceInfo;
pub use engine::{Engine, EngineOptions};
pub use error::Error;
pub use field_curvature::FieldCurvature;
pub use frame::{Channels, Depth, Format, Frame, Samples};
pub use kernel::{Aperture, Kernel};
pub use lens::{Inverse, Lens};
pub use mask::Mask;
pub use metric::MetricDepth;
pub use region::Region;
pub use registered::Registered;
pub use scope::{Kept, Scope, Scoped};
pub use settings::{Decode, Method, Photometric, RegistrationStep, Settings};
pub use similarity::{Similarity, centre};
pub use solution::{Level, Solution, Timings};
pub use solver::{Progress, Solver};
pub use statistics::Estimate;
pub use vignetting::GainField;
