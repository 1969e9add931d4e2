//! The C interface of parfocal. cbindgen makes `include/parfocal.h` from it; `include/parfocal.hpp` wraps it for C++.
//!
//! Every function checks its pointers, returns a status, and stops panics. The unsafe code handles the caller's pointers.
//!
//! All exported functions have this contract, called "the C contract" below. Each pointer is NULL or points to what the
//! header states, for the duration of the call. A handle was returned by this library and is not freed. No other thread
//! uses a handle meanwhile, except an engine, a stream, a cancellation token, or a handle that is only read.

#![allow(non_camel_case_types, reason = "names of the C header")]
#![allow(clippy::missing_safety_doc, reason = "stated once, above")]

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
mod texture;
mod vulkan;

pub use cancel::{
    parfocal_cancellation_token, parfocal_cancellation_token_cancel, parfocal_cancellation_token_free,
    parfocal_cancellation_token_new, parfocal_progress,
};
pub use engine::*;
pub use fault::{parfocal_last_error, parfocal_status};
pub use image::{parfocal_depth, parfocal_image};
pub use measure::*;
pub use settings::*;
pub use solution::*;
pub use solver::*;
pub use stream::*;
pub use sweep::*;
pub use texture::*;
pub use vulkan::{parfocal_engine_from_vulkan, parfocal_vulkan};
