//! Synthetic scenes with ground truth, benchmarks, checks of devices, and registration by key-points, for the program and
//! `tools/lab`.

pub mod bench;
pub mod device_check;
pub mod key_points;
pub mod scene;
