//! Synthetic scenes with ground truth, experiments, CPU methods to compare with, and benchmarks.

pub mod baseline;
pub mod bench;
pub mod contact_sheet;
pub mod evaluate;
pub mod scene;
