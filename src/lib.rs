//! Depth from defocus, on a GPU or on the processor.
//!
//! Two photographs of a scene, focused at two distances, differ in blur and, because the camera moved or the lens
//! breathed, in position, scale, angle and exposure. Parfocal recovers the relative blur at every pixel and the
//! registration together (Ben-Ari, TPAMI 2014).
//!
//! ```
//! use parfocal::{Engine, EngineOptions, PairSolver, Settings, SolveOptions};
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
//! let mut solver = PairSolver::new(&engine, &Settings::default())?;
//! let solution = solver.solve([&i1, &i2], &SolveOptions::default())?;
//! println!("{:?}, V at the first pixel {} px²", solution.transform, solution.relative_blur[0]);
//! # assert_eq!(solution.relative_blur.len(), 64 * 48);
//! # Ok(())
//! # }
//! ```
//!
//! An [`Engine`] is a device. A [`PairSolver`] prepares memory and passes once and reuses them for any number of pairs.
//! Every failure is an [`Error`]. A pair that can be read but not solved is a [`Solution`] that has not converged and
//! says why.
//!
//! With `default-features = false` the crate needs some 30 others and only Rust to be built. The feature `serde` makes
//! settings and lenses readable and writable; `files` adds `image_io`, `export` and `model`; `page` plots and HTML
//! pages; `program`, the default, the command line. Each includes those before it.
//! `compile-shaders` compiles the shaders instead of using the SPIR-V that comes with the crate.

// Without the features that use them, some items of the lower rooms are dead. The default build warns.
#![cfg_attr(not(feature = "program"), allow(dead_code, unused_imports))]

mod base;
mod engine;
#[cfg(feature = "files")]
mod files;
#[cfg(feature = "program")]
mod lab;
pub mod metric;
#[cfg(feature = "page")]
pub mod page;
mod solve;

/// The examples in the guide, which are compiled with those of the documentation.
#[cfg(all(doctest, feature = "files"))]
#[doc = include_str!("../docs/guide/src/embedding.md")]
mod guide {}

pub use base::{CancellationToken, Error, Frame, Lens, Mask, PixelFormat, Progress, Region, Settings};
pub use engine::interop;
pub use engine::{Engine, EngineOptions, Pending, Solution, SolutionRef};
#[cfg(feature = "files")]
pub use files::{export, image_io, model};
pub use solve::sweep::{Sweep, SweepSolver};
pub use solve::{PairSolver, QueueFull, SolveOptions, Stream};

/// The types of [`Settings`], [`EngineOptions`] and [`SolveOptions`].
pub mod settings {
    pub use crate::base::{Decode, DeviceInfo, Kernel, Method, Motion, ParallaxSearch, Photometric, RegistrationStep};
    pub use crate::engine::KeyPoints;
    pub use crate::solve::FieldCurvature;
}

/// The types of a [`Frame`], and where photographs are taken from.
pub mod frame {
    pub use crate::base::{Channels, Depth, Format, RowLayout, Samples};
    pub use crate::engine::Source;
}

/// Geometric transforms between photographs, and their differences in brightness.
pub mod transform {
    pub use crate::base::{Brightness, Homography, Parallax, Shading, Similarity, centre};
}

/// The options and results of a [`SweepSolver`].
pub mod sweep {
    pub use crate::solve::sweep::{Positions, RegisteredSweep, Sweep, SweepDepth, SweepOptions, SweepSolver};
}

/// The parts of a [`Solution`], and registrations.
pub mod results {
    pub use crate::engine::{ColorShift, Findings, LevelHistory, OtherMotion, Registered, Timings, TransformDeviation};
}

/// Resamples photographs.
pub mod resample {
    pub use crate::solve::resample::registered;
}

/// For the program, the laboratory and the tests of this crate: no public API.
#[doc(hidden)]
pub mod internals {
    pub use crate::base::color::{LUMINANCE, linear_to_srgb};
    pub use crate::base::{Setting, random::Random, statistics::median};
    pub use crate::engine::available_memory;
    #[cfg(feature = "program")]
    pub use crate::engine::model;
    #[cfg(any(test, debug_assertions, feature = "reference"))]
    pub use crate::engine::reference;
    pub use crate::engine::stages;
    #[cfg(feature = "files")]
    pub use crate::files::bounded_read;
    #[cfg(feature = "program")]
    pub use crate::lab::{bench, device_check, key_points::key_points, scene};
    pub use crate::solve::resample::{brightened, luminance, onto};

    /// The canvas of figures.
    #[cfg(feature = "page")]
    pub mod canvas {
        pub use crate::page::figure::canvas::{Align, Area, BLACK, Canvas, Color, GRAY, LIGHT, text_width};
    }
}
