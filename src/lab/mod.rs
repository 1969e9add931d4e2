//! Synthetic scenes with ground truth, benchmarks, and registration by key-points, for the program and `tools/lab`.

pub mod bench;
pub mod key_points;
pub mod scene;
