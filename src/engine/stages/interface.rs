//! The bindings and the layout of each shader, in a table that `build.rs` writes from the shaders' texts.
//!
//! The module `interface::NAME` has what a stage exports:
//!
//! - `Bindings`, with a field of the same name for each image, and for the member of each buffer;
//! - `STAGE`, the layout of the shader and its workgroup;
//! - what `shaders::NAME` has: the push constants and literal constants.

#[allow(dead_code, missing_docs, unused_imports, clippy::all, reason = "generated; Rust uses some of it")]
#[rustfmt::skip]
mod table {
    use super::super::pass;
    use crate::engine::shaders;
    use crate::engine::slot::{Bound, Reads, Slot, Updates, Writes};
    use crate::engine::vulkan::{Access, Binding, Kind, Stage, Variant};

    include!(concat!(env!("OUT_DIR"), "/stages.rs"));
}

pub use table::*;
