//! The library as an embedding program sees it. One test program, since each takes long to link.

#[path = "../common/mod.rs"]
mod common;

mod baseline;
mod masks;
mod motion;
mod rooms;
mod scope;
mod solver;
mod sweep;
