//! Depth from defocus on the GPU.
//!
//! Two photographs of a scene, focused at two distances, differ in blur and, because the camera moved or the lens
//! breathed, in position, scale, angle and exposure. Parfocal recovers the relative blur at every pixel and the
//! registration together (Ben-Ari, TPAMI 2014).

mod engine;
mod error;
pub mod export;
mod frame;
pub mod image_io;
mod kernel;
mod plan;
mod record;
pub mod reference;
mod settings;
mod shaders;
mod similarity;
mod solution;
mod solver;
pub mod stages;
#[cfg(test)]
mod testing;
#[allow(unsafe_code, reason = "the one room that talks to Vulkan")]
mod vulkan;
mod workspace;

pub use engine::{DeviceInfo, Engine, EngineOptions};
pub use error::Error;
pub use frame::{Channels, Depth, Format, Frame, Samples};
pub use settings::{Decode, Method, Photometric, Settings};
pub use similarity::{Similarity, centre};
pub use solution::{Level, Solution, Timings};
pub use solver::{Progress, Solver};
