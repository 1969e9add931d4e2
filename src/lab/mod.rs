//! Synthetic scenes with ground truth, experiments, CPU methods for comparison, and benchmarks.

pub mod baseline;
pub mod bench;
pub mod evaluate;
pub mod scene;
