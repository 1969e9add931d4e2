//! Tests of the public library. They are one test program because linking takes long.

#[path = "../common/mod.rs"]
mod common;

mod baseline;
mod contrast;
mod coverage;
mod cpu;
#[cfg(target_os = "linux")]
mod fuzz;
mod in_flight;
mod interop;
mod large;
mod masks;
mod motion;
mod properties;
mod rooms;
mod scope;
mod soak;
mod solver;
mod sources;
mod stream;
mod sweep;
