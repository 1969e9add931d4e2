//! What is done around a solve: a part of the frame, brightness and field curvature, focus sweeps, other photographs on
//! I1's pixels, many pairs one after the other. Nothing here knows Vulkan or a pass.

mod field_curvature;
pub mod focus_stack;
pub mod resample;
mod scope;
mod smooth_field;
mod stream;

pub use field_curvature::FieldCurvature;
pub use scope::{SolveOptions, SolverCache};
pub use stream::{QueueFull, Stream};
