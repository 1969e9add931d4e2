//! Everything about running a solve: pairs, streams, focus sweeps, and resampling onto the pixels of I1.

#[cfg(test)]
mod faults;
mod field_curvature;
pub(crate) mod fill;
mod pair_solver;
mod queue;
pub mod resample;
mod stream;
pub mod sweep;

pub use field_curvature::FieldCurvature;
pub use pair_solver::{PairSolver, SolveOptions};
pub use stream::{QueueFull, Stream};
