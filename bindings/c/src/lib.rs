//! The C interface of parfocal: `include/parfocal.h` is made of this, `include/parfocal.hpp` wraps it for C++.
//!
//! Every function checks its pointers, returns a status, and stops panics. All that is `unsafe` here is what C hands over.
//! The contract of every exported function, which its documentation does not repeat: each pointer is NULL, or what the
//! header says that it is, and lives through the call; a handle was given out by this library, is not freed, and no other
//! thread uses it meanwhile, an engine, a stream, a parfocal_cancel and what is only read excepted.

#![allow(non_camel_case_types, reason = "the names are those of the header")]
#![allow(clippy::missing_safety_doc, reason = "it is above, once")]

mod cancel;
mod engine;
mod fault;
mod handle;
mod image;
mod measure;
mod settings;
mod sized;
mod solution;
mod solver;
mod stream;
mod sweep;
mod vulkan;

pub use cancel::{parfocal_cancel, parfocal_cancel_free, parfocal_cancel_new, parfocal_cancel_now, parfocal_progress};
pub use engine::*;
pub use fault::{parfocal_last_error, parfocal_status};
pub use image::{parfocal_depth, parfocal_image};
pub use measure::*;
pub use settings::*;
pub use solution::*;
pub use solver::*;
pub use stream::*;
pub use sweep::*;
pub use vulkan::{parfocal_engine_from_vulkan, parfocal_vulkan};
