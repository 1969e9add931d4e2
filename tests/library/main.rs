//! The library as an embedding program sees it. One test program, since each takes long to link.

#[path = "../common/mod.rs"]
mod common;

mod baseline;
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
