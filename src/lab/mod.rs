//! The paper's laboratory: synthetic scenes with their truth, the experiments, registration by key-points, benchmarks.

pub mod baseline;
pub mod bench;
pub mod contact_sheet;
pub mod evaluate;
pub mod scene;
